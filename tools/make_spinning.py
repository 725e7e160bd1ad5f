"""Spinning shapes under a sun: `python tools/make_spinning.py` writes data/spinning.

A cone that lies on its side turns like a windmill's sail, so that each part of it turns towards the sun and away from it; a
gear wheel, a box and a bent pipe turn about other axes, and a ball rolls on a circle through their shadows. The camera stands
still. All shading that changes does so because objects move.
"""

import numpy as np
from scene_files import Gltf, Material, key_frames, output_folder, write_text
from scipy.spatial.transform import Rotation
from shapes import ALONG_X, Surface, grid, merged, profile, quad, revolved, sheet

FRAMES, FPS = 64, 30
BALL = 0.28  # radius
DURATION = FRAMES / FPS
MATERIALS = {
    "red": Material((0.70, 0.12, 0.08), specular=0.0),
    "steel": Material((0.55, 0.57, 0.60), roughness=0.45, metallic=1.0),
    "yellow": Material((0.80, 0.55, 0.06), specular=0.0),
}

SCENE = """\
# Shapes that spin, under a sun. Written by tools/make_spinning.py, as are the files beside it.

[camera]
position = [0.3, 2.7, 7.6]
look_at = [0.0, 1.05, 0.0]
fov_y = 36

[environment]
color = [0.27, 0.38, 0.55]

[[lights]]
type = "directional"
direction = [0.62, -0.66, -0.42]
irradiance = [4.0, 3.7, 3.2]

[render]
size = [640, 360]
frames = [0, {frames}]
fps = {fps}
spp = 16
stereo = true
eye_distance = 0.063

[materials.ground]
base_color = [0.42, 0.40, 0.36]

[materials.plaster]
base_color = [0.60, 0.57, 0.52]

[materials.wood]
base_color = [0.47, 0.28, 0.14]

[materials.blue]
base_color = [0.10, 0.24, 0.62]

[materials.ball]
base_color = [0.78, 0.78, 0.78]
roughness = 0.25

[meshes.ground]
generator = "plane"
size = [60.0, 60.0]

[meshes.wall]
generator = "box"
size = [9.0, 3.6, 0.3]

[meshes.block]
generator = "box"
size = [1.0, 1.0, 1.0]

[meshes.ball]
generator = "sphere"
radius = {ball}
subdivisions = 4

[meshes.cone]
file = "cone.gltf"

[meshes.gear]
file = "gear.gltf"

[meshes.pipe]
file = "pipe.gltf"

[[instances]]
mesh = "ground"
material = "ground"

[[instances]]
mesh = "wall"
material = "plaster"
translation = [0.0, 1.8, -2.6]

[[instances]]
mesh = "block"
material = "wood"
scale = [0.16, 1.30, 0.16]
translation = [-1.9, 0.65, 0.0]

[[instances]]
mesh = "block"
material = "wood"
scale = [0.16, 1.05, 0.16]
translation = [2.45, 0.525, -0.75]
"""


def cone() -> list[Surface]:
    """A cone 1.5 m high about its middle, with its base."""
    return [revolved("red", profile((0.0, -0.75), (0.62, -0.75), (0.0, 0.75)), 64)]


def gear() -> list[Surface]:
    """A wheel of 12 teeth in the xy plane, 0.3 m thick."""
    teeth, half = 12, 0.15
    phase = np.array([0.0, 0.32, 0.42, 0.90])  # foot, foot, tip, tip; in parts of a tooth
    angle = 2 * np.pi * ((np.arange(teeth)[:, None] + phase) / teeth).reshape(-1)
    radius = np.tile([0.50, 0.50, 0.66, 0.66], teeth)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    rim = np.concatenate([rim, rim[:1]])
    hub = 0.16 * rim / np.linalg.norm(rim, axis=1, keepdims=True)

    def at(line, z):
        return np.insert(line, 2, z, axis=1)

    flat = np.zeros((2, len(rim), 2))
    return [
        grid("steel", np.stack([at(rim, half), at(rim, -half)]), flat),
        grid("steel", np.stack([at(hub, -half), at(hub, half)]), flat),
        grid("steel", np.stack([at(hub, half), at(rim, half)]), flat),
        grid("steel", np.stack([at(rim, -half), at(hub, -half)]), flat),
    ]


def pipe() -> list[Surface]:
    """A pipe bent to three quarters of a ring of 0.45 m radius in the xy plane, its ends closed."""
    along, around = np.radians(np.linspace(0.0, 270.0, 41))[:, None], np.radians(np.linspace(0.0, 360.0, 21))[None, :]
    radius = 0.45 + 0.13 * np.cos(around)
    points = np.stack(
        np.broadcast_arrays(radius * np.cos(along), radius * np.sin(along), -0.13 * np.sin(around)), axis=-1
    )
    pieces = [sheet("yellow", points, np.zeros((*points.shape[:2], 2)))]
    for ring, centre in ((points[0][::-1], (0.45, 0.0, 0.0)), (points[-1], (0.0, -0.45, 0.0))):
        caps = [quad("yellow", [centre, a, b, b]) for a, b in zip(ring[:-1], ring[1:], strict=True)]
        pieces.append(merged(caps))
    return pieces


def instance(mesh: str, material: str | None, placement: str, keys: str) -> str:
    """A moving instance."""
    painted = f'material = "{material}"\n' if material else ""
    return f'\n[[instances]]\nmesh = "{mesh}"\n{painted}{placement}\n{keys}'


def turning(axis: list[float], turns: float, start: float = 0.0) -> str:
    """Keys of a rotation at constant speed, in steps of an eighth of a turn."""
    count = round(8 * abs(turns)) + 1
    degrees = start + np.linspace(0.0, 360.0 * turns, count)
    rotations = [f"{{ axis = {axis}, degrees = {round(float(d), 3)} }}" for d in degrees]
    return key_frames(np.linspace(0.0, DURATION, count), rotation=rotations)


def rolling() -> str:
    """Keys of a ball that rolls once around on an ellipse, without slipping."""
    angle = np.linspace(0.0, 2 * np.pi, 65)
    positions = np.stack([1.75 * np.sin(angle), BALL + 0 * angle, 1.15 + 0.75 * np.cos(angle)], axis=-1)
    steps = np.diff(positions, axis=0)
    turns = [Rotation.identity()]
    for x, _, z in steps:
        turns.append(Rotation.from_rotvec(np.array([z, 0.0, -x]) / BALL) * turns[-1])
    quaternions = np.array([turn.as_quat(canonical=True) for turn in turns])
    return key_frames(np.linspace(0.0, DURATION, len(angle)), translation=positions, quaternion=quaternions)


def main() -> None:
    out = output_folder(__doc__, "spinning")
    lying = [s.moved(matrix=ALONG_X) for s in cone()]
    for name, shape in (("cone", lying), ("gear", gear()), ("pipe", pipe())):
        used = {m: MATERIALS[m] for m in MATERIALS if any(s.material == m for s in shape)}
        gltf = Gltf("make_spinning.py", used, {})
        gltf.node(name, mesh=gltf.mesh(name, shape))
        gltf.write(out / f"{name}.gltf")
    moving = [
        instance("cone", None, "translation = [-1.9, 1.36, 0.25]", turning([0, 0, 1], 1.0, 20.0)),
        instance("gear", None, "translation = [0.0, 1.25, -0.9]", turning([0, 0, 1], -0.5)),
        instance(
            "block", "blue", "scale = 0.75\ntranslation = [0.55, 1.45, 0.55]", turning([0.5774, 0.5774, 0.5774], 0.75)
        ),
        instance("pipe", None, "translation = [2.45, 1.62, -0.75]", turning([0, 1, 0], 1.5)),
        instance("ball", "ball", "", rolling()),
    ]
    write_text(out / "scene.toml", SCENE.format(frames=FRAMES, fps=FPS, ball=BALL) + "".join(moving))


if __name__ == "__main__":
    main()
