"""A Cornell box with a metal and a glass sphere: `python tools/make_spheres.py` writes data/spheres.

The room, its lamp and its camera's place are those of tools/make_cornell.py. The camera slides sideways and looks at one
point, so that all that the spheres show depends on the view. The roughness of both spheres stands once in each of their
materials: 0 in scene.toml, and GGX's alpha = 0.2 and 0.4 in alpha-0.2/scene.toml and alpha-0.4/scene.toml; --alpha writes another one.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from make_cornell import CAMERA_DISTANCE, DEPTH, HEIGHT, LAMP_RADIANCE, MATERIALS, material, room
from scene_files import DATA, key_frames, write_text

SPHERES = (("metal", 0.62, -0.78, -0.35), ("glass", 0.52, 0.72, 0.30))  # material, radius, x, z
SLIDE = 0.22  # metres to either side
FRAMES, FPS = 64, 30
ALPHAS = {".": 0.0, "alpha-0.2": 0.2, "alpha-0.4": 0.4}  # by folder

HEADER = """\
# A Cornell box with a metal and a glass sphere. Written by tools/make_spheres.py.
"""


def camera() -> str:
    """The tables of the camera, of the light from outside and of the render."""
    angle = np.linspace(0.0, 2 * np.pi, 17)
    times = np.linspace(0.0, FRAMES / FPS, 17)
    z = DEPTH / 2 + CAMERA_DISTANCE
    positions = np.stack([SLIDE * np.sin(angle), HEIGHT / 2 + 0.1 * SLIDE * np.sin(2 * angle), 0 * angle + z], axis=-1)
    return f"""
[camera]
look_at = [0.0, {HEIGHT / 2}, 0.0]
fov_y = 37
{key_frames(times, position=positions)}
[environment]
color = [0.35, 0.38, 0.42]

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 64
stereo = true
eye_distance = 0.063
settings = {{ "pathtrace.bounces" = 6 }}
"""


def sphere_materials(alpha: float) -> str:
    """The materials of the spheres. alpha: GGX's, whose square root the scene file holds."""
    roughness = round(math.sqrt(alpha), 4)
    return f"""
# Roughness is the square root of GGX's alpha: 0, 0.4472 and 0.6325 are alpha = 0, 0.2 and 0.4.
[materials.metal]
base_color = [0.91, 0.80, 0.62]
metallic = 1.0
roughness = {roughness}

[materials.glass]
base_color = [1.0, 1.0, 1.0]
transmission = 1.0
ior = 1.5
roughness = {roughness}
"""


def spheres() -> str:
    """One mesh of unit radius and its instances, each standing just above the floor."""
    text = '\n[meshes.sphere]\ngenerator = "sphere"\nradius = 1.0\nsubdivisions = 6\n'
    for name, radius, x, z in SPHERES:
        at = [x, round(radius + 0.001, 4), z]
        text += f'\n[[instances]]\nmesh = "sphere"\nmaterial = "{name}"\nscale = {radius}\ntranslation = {at}\n'
    return text


def scene(alpha: float) -> str:
    """The scene file. alpha: GGX roughness of both spheres."""
    walls = "".join(material(name, color) for name, color in MATERIALS.items())
    lamp = material("lamp", (0.0, 0.0, 0.0), LAMP_RADIANCE)
    return HEADER + camera() + walls + lamp + sphere_materials(alpha) + room() + spheres()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA / "spheres", help="folder to write to")
    parser.add_argument(
        "--alpha", type=float, help="GGX roughness of both spheres, 0 to 1 (default: each of the project's)"
    )
    args = parser.parse_args()
    for name, alpha in (ALPHAS if args.alpha is None else {".": args.alpha}).items():
        folder = args.out / name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "scene.toml", scene(alpha))


if __name__ == "__main__":
    main()
