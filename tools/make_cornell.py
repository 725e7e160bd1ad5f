"""A Cornell box with two spheres, 16:9: `python tools/make_cornell.py` writes data/cornell/scene.toml.

The room is 4.00 x 2.25 x 2.40 m, open towards the camera, whose frame it fills for both eyes. All of it is generated
when the scene is loaded, from planes and spheres; this script works out where the planes stand. The ceiling is laid
around the lamp, so that the lamp's upper side, which shines as well, lights nothing. The lamp is wide, and dim light
enters through the open side, so that a path tracer that finds lamps by chance alone also gives a picture soon.
"""

import argparse
from pathlib import Path

WIDTH, HEIGHT, DEPTH = 4.0, 2.25, 2.4  # of the room; its floor is centred on the origin
LAMP_WIDTH, LAMP_DEPTH = 2.8, 1.6
LAMP_RADIANCE = (4.2, 3.8, 3.2)
MATERIALS = {"white": (0.73, 0.72, 0.69), "red": (0.63, 0.065, 0.05), "green": (0.14, 0.45, 0.09)}
SPHERES = (  # radius, x, z, material
    (0.62, -0.85, -0.40, "white"),
    (0.48, 0.80, 0.25, "white"),
)
CAMERA_DISTANCE = 3.0  # from the open side

HEADER = """\
# A Cornell box with two spheres. Written by tools/make_cornell.py.
"""


def camera_and_light() -> str:
    """The tables that are not geometry."""
    height, z = HEIGHT / 2, DEPTH / 2 + CAMERA_DISTANCE
    return f"""
[camera]
position = [0.0, {height}, {z}]
look_at = [0.0, {height}, 0.0]
fov_y = 40

[environment]
color = [0.35, 0.38, 0.42]

[render]
size = [320, 180]
spp = 64
stereo = true
eye_distance = 0.063
"""


def material(name: str, color: tuple[float, ...], emission: tuple[float, ...] | None = None) -> str:
    """A table in [materials]."""
    return f"\n[materials.{name}]\nbase_color = {list(color)}\n" + (
        f"emission = {list(emission)}\n" if emission else ""
    )


def rectangle(
    name: str, size: tuple[float, float], material: str, at: tuple[float, ...], turn: tuple[str, int] | None
) -> str:
    """A plane of its own, facing +Y before it is turned by `turn` = (axis, degrees)."""
    at = tuple(round(v, 6) for v in at)
    axes = {"x": [1, 0, 0], "z": [0, 0, 1]}
    rotation = f"rotation = {{ axis = {axes[turn[0]]}, degrees = {turn[1]} }}\n" if turn else ""
    return (
        f'\n[meshes.{name}]\ngenerator = "plane"\nsize = {list(size)}\n'
        f'\n[[instances]]\nmesh = "{name}"\nmaterial = "{material}"\n{rotation}translation = {list(at)}\n'
    )


def room() -> str:
    """Floor, walls, and the ceiling in four pieces around the lamp."""
    middle = HEIGHT / 2
    beside, before = (WIDTH - LAMP_WIDTH) / 2, (DEPTH - LAMP_DEPTH) / 2
    to_side, to_end = (LAMP_WIDTH + beside) / 2, (LAMP_DEPTH + before) / 2
    planes = [
        ("floor", (WIDTH, DEPTH), "white", (0.0, 0.0, 0.0), None),
        ("back", (WIDTH, HEIGHT), "white", (0.0, middle, -DEPTH / 2), ("x", 90)),
        ("left", (HEIGHT, DEPTH), "red", (-WIDTH / 2, middle, 0.0), ("z", -90)),
        ("right", (HEIGHT, DEPTH), "green", (WIDTH / 2, middle, 0.0), ("z", 90)),
        ("ceiling_left", (beside, DEPTH), "white", (-to_side, HEIGHT, 0.0), ("x", 180)),
        ("ceiling_right", (beside, DEPTH), "white", (to_side, HEIGHT, 0.0), ("x", 180)),
        ("ceiling_back", (LAMP_WIDTH, before), "white", (0.0, HEIGHT, -to_end), ("x", 180)),
        ("ceiling_front", (LAMP_WIDTH, before), "white", (0.0, HEIGHT, to_end), ("x", 180)),
        ("lamp", (LAMP_WIDTH, LAMP_DEPTH), "lamp", (0.0, HEIGHT, 0.0), ("x", 180)),
    ]
    return "".join(rectangle(*plane) for plane in planes)


def spheres() -> str:
    """One mesh of unit radius and its instances, each standing on the floor."""
    text = '\n[meshes.sphere]\ngenerator = "sphere"\nradius = 1.0\nsubdivisions = 5\n'
    for radius, x, z, name in SPHERES:
        text += f'\n[[instances]]\nmesh = "sphere"\nmaterial = "{name}"\nscale = {radius}\ntranslation = [{x}, {radius}, {z}]\n'
    return text


def scene() -> str:
    """The whole scene file."""
    materials = "".join(material(name, color) for name, color in MATERIALS.items())
    lamp = material("lamp", (0.0, 0.0, 0.0), LAMP_RADIANCE)
    return HEADER + camera_and_light() + materials + lamp + room() + spheres()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parents[1] / "data" / "cornell", help="folder to write to"
    )
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    (out / "scene.toml").write_text(scene(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
