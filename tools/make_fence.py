"""An iron fence in a moving sun: `python tools/make_fence.py` writes data/fence.

The camera stands still and nothing moves but the sun, which sinks a little and goes round, so that the shadows of the thin
bars travel over the paving. Nothing on the screen has motion of its own: what was seen in the
last frame is found again at once, and is wrong where a shadow's edge has passed.
"""

import numpy as np
from painting import Texture, blocks, brick, limestone, mix, noise, smoothstep, wood, write_textures
from scene_files import Gltf, Material, key_frames, numbers, output_folder, write_text
from shapes import Surface, box, copies, curve, grid, profile, quad, revolved, torus

FRAMES, FPS = 64, 30
BAY = 2.4  # metres from post to post
BARS = 19  # in a bay
BAYS = 6
HEIGHT = 1.5  # of the bars' tips, above the plinth
PLINTH = 0.22
WALL_Z, WALL_HEIGHT = -6.0, 1.5


def paving(rng: np.random.RandomState) -> np.ndarray:
    """Concrete slabs of 0.5 m in a running bond."""
    pattern = blocks(4, 4, 2.0, 0.5)
    color = mix((0.60, 0.58, 0.55), (0.52, 0.505, 0.48), pattern.tone(rng))
    color = color + (0.02 * noise(rng, 0.9, 3) + 0.02 * noise(rng, 0.3, 40))[..., None]
    return mix((0.33, 0.31, 0.28), color, smoothstep(0.003, 0.008, pattern.distance + 0.001 * noise(rng, 1.0, 8)))


TEXTURES = {
    "paving": Texture(paving, 2.0, 256),
    "brick": Texture(brick, 1.6, 256),
    "limestone": Texture(limestone, 2.0, 256),
    "wood": Texture(wood, 1.6, 256),
}
MATERIALS = {
    "paving": Material(texture="paving", specular=0.0),
    "brick": Material(texture="brick", specular=0.0),
    "limestone": Material(texture="limestone", specular=0.0),
    "planks": Material((0.9, 0.75, 0.6), "wood", specular=0.0),
    "iron": Material((0.035, 0.04, 0.04), roughness=0.5),
}

SCENE = f"""\
# An iron fence in a moving sun. Written by tools/make_fence.py, as are the files beside it.

[camera]
position = [-0.7, 1.7, 4.1]
look_at = [0.15, 0.42, 0.0]
fov_y = 48

[environment]
color = [0.30, 0.40, 0.54]

[meshes.fence]
file = "fence.gltf"

[[instances]]
mesh = "fence"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 16
stereo = false
"""


def bar() -> list[Surface]:
    """A round bar of 14 mm with a collar and a spear's head; y = 0 is the lower rail."""
    top = HEIGHT - 0.12
    line = profile(
        (0.007, 0.0), (0.007, top - 0.02), torus(0.007, top - 0.02, top, 3), (0.006, top),
        curve(0.0, top + 0.035, 0.026, 0.035, -70.0, 0.0, 3), (0.0, HEIGHT),
    )  # fmt: skip
    return [revolved("iron", line, 8)]


def bay() -> list[Surface]:
    """Two rails and a row of small rings between the upper two, from post to post; y = 0 is the plinth's top."""
    half = BAY / 2
    around, across = np.radians(np.linspace(0.0, 360.0, 17))[:, None], np.radians(np.linspace(0.0, 360.0, 6))[None, :]
    radius = 0.05 + 0.006 * np.cos(across)
    ring = np.stack(
        np.broadcast_arrays(radius * np.cos(around), radius * np.sin(around), -0.006 * np.sin(across)), axis=-1
    )
    out = np.stack(
        np.broadcast_arrays(np.cos(across) * np.cos(around), np.cos(across) * np.sin(around), -np.sin(across)), axis=-1
    )
    rings = grid("iron", ring, np.zeros((*ring.shape[:2], 2)), out)
    step = BAY / (BARS + 1)
    places = np.array([[step * (i + 0.5) - half, HEIGHT - 0.31, 0.0] for i in range(1, BARS)])
    rails = [box("iron", (-half, y, -0.011), (half, y + 0.012, 0.011)) for y in (0.10, HEIGHT - 0.38, HEIGHT - 0.252)]
    return [copies(rings, places), *sum(rails, [])]


def post() -> list[Surface]:
    """A square post with a ball."""
    ball = profile(curve(0.0, HEIGHT + 0.19, 0.06, 0.06, -80.0, 90.0, 10))
    return [
        *box("iron", (-0.035, 0.0, -0.035), (0.035, HEIGHT + 0.08, 0.035)),
        *box("iron", (-0.05, HEIGHT + 0.08, -0.05), (0.05, HEIGHT + 0.11, 0.05)),
        revolved("iron", profile((0.02, HEIGHT + 0.10), (0.02, HEIGHT + 0.14)), 10),
        revolved("iron", ball, 20),
    ]


def bench() -> list[Surface]:
    """A bench of planks, 1.8 m wide, its back towards -Z."""
    pieces = []
    for z in (0.20, 0.06, -0.08):
        pieces += box("planks", (-0.9, 0.43, z - 0.06), (0.9, 0.46, z + 0.06))
    for y in (0.58, 0.73):
        pieces += box("planks", (-0.9, y, -0.20), (0.9, y + 0.12, -0.17))
    for x in (-0.7, 0.7):
        pieces += box("iron", (x - 0.025, 0.0, 0.18), (x + 0.025, 0.43, 0.23))
        pieces += box("iron", (x - 0.025, 0.0, -0.23), (x + 0.025, 0.88, -0.20))
        pieces += box("iron", (x - 0.025, 0.41, -0.20), (x + 0.025, 0.43, 0.18))
    return pieces


def grounds() -> list[Surface]:
    """Paving, the plinth under the fence, and the wall with its coping."""
    half = BAYS * BAY / 2 + 12.0
    z = WALL_Z
    return [
        quad("paving", [(-half, 0, 8.0), (half, 0, 8.0), (half, 0, z), (-half, 0, z)]),
        *box("limestone", (-half, -0.05, -0.14), (half, PLINTH - 0.04, 0.14)),
        *box("limestone", (-half, PLINTH - 0.04, -0.17), (half, PLINTH, 0.17)),
        *box("brick", (-half, -0.05, z - 0.3), (half, WALL_HEIGHT, z)),
        *box("limestone", (-half, WALL_HEIGHT, z - 0.36), (half, WALL_HEIGHT + 0.1, z + 0.06)),
        *box("limestone", (-half, -0.05, z), (half, 0.30, z + 0.05)),
    ]


def build() -> Gltf:
    """The whole scene but its light and camera."""
    gltf = Gltf("make_fence.py", MATERIALS, TEXTURES)
    gltf.node("grounds", mesh=gltf.mesh("grounds", grounds()))
    bars, rails, posts = (gltf.mesh(name, part()) for name, part in (("bar", bar), ("rails", bay), ("post", post)))
    step = BAY / (BARS + 1)
    for i in range(-BAYS // 2, BAYS // 2):
        frame = gltf.node(f"bay {i + BAYS // 2}", at=(i * BAY, PLINTH, 0.0))
        gltf.node("post", frame, posts)
        gltf.node("rails", frame, rails, (BAY / 2, 0.0, 0.0))
        for k in range(1, BARS + 1):
            gltf.node("bar", frame, bars, (k * step, 0.02, 0.0), turn=11.0 * k)
    gltf.node("post", None, posts, (BAYS * BAY / 2, PLINTH, 0.0))
    gltf.node("bench", None, gltf.mesh("bench", bench()), (1.3, 0.0, -1.9))
    return gltf


def sun() -> str:
    """The sun behind the fence and to the left of it, going round by 40 degrees and down by 8: shadows come forwards."""
    times = np.linspace(0.0, FRAMES / FPS, 17)
    around, up = np.radians(np.linspace(-50.0, -10.0, 17)), np.radians(np.linspace(40.0, 32.0, 17))
    to_sun = np.stack([np.cos(up) * np.sin(around), np.sin(up), -np.cos(up) * np.cos(around)], axis=-1)
    return f'\n[[lights]]\ntype = "directional"\nirradiance = {numbers((5.4, 4.8, 4.0))}\n' + key_frames(
        times, direction=-to_sun
    )


def main() -> None:
    out = output_folder(__doc__, "fence")
    write_textures(out / "textures", TEXTURES)
    build().write(out / "fence.gltf")
    write_text(out / "scene.toml", SCENE + sun())


if __name__ == "__main__":
    main()
