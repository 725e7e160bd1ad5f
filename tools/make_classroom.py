"""A classroom: `python tools/make_classroom.py` writes data/classroom.

A closed room of 9 x 7 x 3.2 m with three windows, whose panes are open to sun and sky: desks and chairs, a chalkboard, shelves
full of books, a map, a globe, a clock, a plant. Almost everything has a material of its own, as in scenes by artists. The
camera is the head of somebody who sits in the back row: a recorded path is imitated by smoothed noise of some centimetres and
degrees, at the rate of a headset, with the tremor that never stops.
"""

import numpy as np
from painting import SIZE, Texture, blocks, bumps, mix, noise, smoothstep, wood, write_textures
from scene_files import Gltf, Material, output_folder, write_text
from scipy.spatial.transform import Rotation
from shapes import ALONG_X, Surface, box, curve, profile, quad, revolved, rotation_y, sheet, torus

FRAMES, FPS = 64, 72
HALF_X, HALF_Z, HEIGHT = 4.5, 3.5, 3.2  # the board is at -Z, the windows at -X
WALL = 0.3
SILL, LINTEL = 0.95, 2.75
WINDOWS = ((-2.2, 1.9), (0.25, 1.9), (2.6, 1.3))  # middle along z, width
HEAD = (1.15, 1.28, 2.55)


def covers(count: int) -> dict[str, Material]:
    """Materials of books, each of its own colour and gloss."""
    rng = np.random.RandomState(31)
    colors, roughness = 0.02 + 0.75 * rng.beta(0.9, 1.6, (count, 3)), rng.uniform(0.3, 0.9, count)
    return {
        f"book {i}": Material(tuple(np.round(color, 3).tolist()), roughness=round(float(rough), 2))
        for i, (color, rough) in enumerate(zip(colors, roughness, strict=True))
    }


BOOKS = covers(26)


def parquet(rng: np.random.RandomState) -> np.ndarray:
    """Oak boards of 0.1 x 0.5 m; the grain runs along u."""
    pattern = blocks(2, 10, 1.0, 0.5)
    color = mix((0.62, 0.44, 0.27), (0.50, 0.33, 0.19), pattern.tone(rng))
    color = color + (0.04 * noise(rng, 0.9, 4, (1.0, 16.0)))[..., None]
    return mix((0.20, 0.13, 0.08), color, smoothstep(0.0006, 0.003, pattern.distance))


def parquet_bumps(rng: np.random.RandomState) -> np.ndarray:
    """The joints of `parquet`."""
    return bumps(0.0015 * smoothstep(0.0, 0.006, blocks(2, 10, 1.0, 0.5).distance), 1.0)


def paint(rng: np.random.RandomState) -> np.ndarray:
    """Rolled wall paint, to be tinted."""
    return np.full((SIZE, SIZE, 3), 0.93) + (0.012 * noise(rng, 1.4, 2) + 0.012 * noise(rng, 0.3, 30))[..., None]


def acoustic(rng: np.random.RandomState) -> np.ndarray:
    """Ceiling panels of 0.6 m with holes and joints."""
    pattern = blocks(2, 2, 1.2)
    holes = smoothstep(1.5, 1.9, noise(rng, 0.2, 30))
    color = mix((0.90, 0.90, 0.88), (0.55, 0.55, 0.54), 0.7 * holes)
    return mix((0.60, 0.60, 0.60), color, smoothstep(0.003, 0.008, pattern.distance))


def chalk(rng: np.random.RandomState) -> np.ndarray:
    """A green board, wiped in long strokes."""
    wiped = smoothstep(-0.6, 2.6, noise(rng, 1.5, 1, (1.0, 4.0)))
    return mix((0.10, 0.21, 0.17), (0.30, 0.40, 0.36), 0.75 * wiped) + (0.012 * noise(rng, 0.3, 30))[..., None]


def cork(rng: np.random.RandomState) -> np.ndarray:
    """Pressed cork."""
    return mix((0.70, 0.51, 0.32), (0.46, 0.30, 0.17), smoothstep(0.0, 1.8, noise(rng, 0.6, 14)))


def map_of_the_world(rng: np.random.RandomState) -> np.ndarray:
    """Continents that never were, in the colours of an atlas, under a graticule."""
    height = noise(rng, 1.7, 1)
    land = smoothstep(0.35, 0.40, height)[..., None]
    shallow = smoothstep(0.0, 0.35, height)
    sea = mix((0.42, 0.62, 0.78), (0.66, 0.82, 0.89), shallow)
    ground = mix(mix((0.45, 0.63, 0.38), (0.84, 0.76, 0.50), smoothstep(0.5, 1.2, height)), (0.60, 0.42, 0.27), smoothstep(1.2, 2.2, height))  # fmt: skip
    t = np.arange(SIZE) % (SIZE // 8) < 2
    return np.where(t[:, None, None] | t[None, :, None], 0.72, 1.0) * (sea + (ground - sea) * land)


def weave(rng: np.random.RandomState) -> np.ndarray:
    """Coarse cloth, to be tinted."""
    t = 2 * np.pi * (np.arange(SIZE) + 0.5) / SIZE * 48
    thread = np.sin(t)[:, None] * np.sin(t)[None, :]
    return 0.82 + (0.10 * thread + 0.03 * noise(rng, 0.4, 20))[..., None] * np.ones(3)


def speckle(rng: np.random.RandomState) -> np.ndarray:
    """Laminate with small specks, to be tinted."""
    return 0.88 - (0.12 * smoothstep(1.2, 2.0, noise(rng, 0.3, 40)))[..., None] * np.ones(3)


def clock_face(rng: np.random.RandomState) -> np.ndarray:
    """Twelve strokes on white."""
    t = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    radius, angle = np.hypot(t[None, :], t[:, None]), np.arctan2(t[:, None], t[None, :])
    near = np.abs((angle / (2 * np.pi) * 12 + 0.5) % 1.0 - 0.5) * radius * 2 * np.pi / 12
    stroke = (near < 0.008) & (radius > 0.36) & (radius < 0.44)
    return np.where(stroke[..., None], 0.08, 0.93) * np.ones(3)


def grass(rng: np.random.RandomState) -> np.ndarray:
    """A lawn."""
    return mix((0.25, 0.38, 0.13), (0.40, 0.48, 0.20), smoothstep(-1.0, 1.5, noise(rng, 0.5, 4)))


TEXTURES = {
    "parquet": Texture(parquet, 1.0, 256),
    "parquet_bumps": Texture(parquet_bumps, 1.0, 256),
    "paint": Texture(paint, 2.0, 128),
    "acoustic": Texture(acoustic, 1.2, 256),
    "chalk": Texture(chalk, 4.0, 256),
    "cork": Texture(cork, 0.8, 256),
    "map": Texture(map_of_the_world, 2.0, 512),
    "weave": Texture(weave, 0.4, 128),
    "speckle": Texture(speckle, 0.4, 128),
    "clock": Texture(clock_face, 0.36, 256),
    "wood": Texture(wood, 1.6, 256),
    "grass": Texture(grass, 4.0, 128),
}

MATERIALS = {
    "wall": Material((0.90, 0.87, 0.78), "paint"),
    "wainscot": Material((0.45, 0.58, 0.56), "paint", roughness=0.5),
    "ceiling": Material(texture="acoustic"),
    "floor": Material(texture="parquet", normals="parquet_bumps", roughness=0.38),
    "skirting": Material((0.30, 0.20, 0.12), roughness=0.5),
    "window frame": Material((0.82, 0.82, 0.80), roughness=0.4),
    "sill": Material((0.72, 0.70, 0.66), "speckle", roughness=0.35),
    "radiator": Material((0.78, 0.76, 0.70), roughness=0.45),
    "chalkboard": Material(texture="chalk", roughness=0.85),
    "board frame": Material((0.60, 0.61, 0.62), roughness=0.35, metallic=1.0),
    "white chalk": Material((0.90, 0.90, 0.88)),
    "yellow chalk": Material((0.90, 0.80, 0.35)),
    "red chalk": Material((0.85, 0.38, 0.35)),
    "sponge": Material((0.85, 0.65, 0.20)),
    "desk top": Material((0.88, 0.80, 0.66), "speckle", roughness=0.42),
    "desk edge": Material((0.40, 0.26, 0.14), "wood", roughness=0.6),
    "desk frame": Material((0.13, 0.22, 0.30), roughness=0.4),
    "orange seat": Material((0.80, 0.33, 0.07), roughness=0.4),
    "blue seat": Material((0.10, 0.25, 0.55), roughness=0.4),
    "green seat": Material((0.16, 0.42, 0.20), roughness=0.4),
    "chair frame": Material((0.72, 0.72, 0.73), roughness=0.22, metallic=1.0),
    "big desk": Material((0.62, 0.45, 0.30), "wood", roughness=0.45),
    "leather": Material((0.06, 0.045, 0.04), roughness=0.5),
    "door": Material((0.60, 0.42, 0.28), "wood", roughness=0.55),
    "door frame": Material((0.35, 0.36, 0.37), roughness=0.5),
    "brass": Material((0.83, 0.66, 0.33), roughness=0.25, metallic=1.0),
    "shelf": Material((0.85, 0.68, 0.48), "wood", roughness=0.6),
    **BOOKS,
    "paper": Material((0.86, 0.85, 0.80)),
    "globe": Material(texture="map", roughness=0.3),
    "globe stand": Material((0.20, 0.12, 0.07), roughness=0.4),
    "map": Material(texture="map"),
    "map rod": Material((0.09, 0.07, 0.06), roughness=0.5),
    "clock face": Material(texture="clock", roughness=0.6),
    "clock rim": Material((0.04, 0.04, 0.04), roughness=0.3),
    "lamp housing": Material((0.80, 0.80, 0.78), roughness=0.5),
    "tube": Material((0.8, 0.8, 0.8), emission=(12.0, 11.2, 9.9)),
    "cork": Material(texture="cork"),
    "pink note": Material((0.88, 0.45, 0.55)),
    "yellow note": Material((0.92, 0.85, 0.35)),
    "blue note": Material((0.40, 0.62, 0.85)),
    "bin": Material((0.16, 0.17, 0.18), roughness=0.45),
    "pot": Material((0.62, 0.32, 0.20)),
    "earth": Material((0.07, 0.05, 0.035)),
    "plant": Material((0.10, 0.30, 0.08), roughness=0.5),
    "curtain": Material((0.70, 0.42, 0.18), "weave"),
    "pencil": Material((0.88, 0.62, 0.06), roughness=0.4),
    "red bag": Material((0.60, 0.08, 0.08), "weave"),
    "navy bag": Material((0.06, 0.09, 0.26), "weave"),
    "lawn": Material(texture="grass", specular=0.0),
    "hedge": Material((0.10, 0.22, 0.06), "weave", specular=0.0),
}

SCENE = f"""\
# A classroom. Written by tools/make_classroom.py, as are the files beside it.

[camera]
poses = "head.csv"
fov_y = 66

[environment.sky]
turbidity = 3.0
elevation = 34
azimuth = 287
scale = 0.06

[meshes.classroom]
file = "classroom.gltf"

[[instances]]
mesh = "classroom"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 16
stereo = true
eye_distance = 0.063
"""


# ---------------------------------------------------------------------------------------------------------------------
# The room


def room() -> list[Surface]:
    """Floor, ceiling, walls with the windows' openings, wainscot, and the ground outside."""
    x, z, h = HALF_X, HALF_Z, HEIGHT
    pieces = [
        quad("floor", [(-x, 0, z), (x, 0, z), (x, 0, -z), (-x, 0, -z)]),
        quad("ceiling", [(-x, h, -z), (x, h, -z), (x, h, z), (-x, h, z)]),
        *box("wall", (-x - WALL, -0.1, -z - WALL), (x + WALL, h + 0.2, -z)),
        *box("wall", (-x - WALL, -0.1, z), (x + WALL, h + 0.2, z + WALL)),
        *box("wall", (x, -0.1, -z), (x + WALL, h + 0.2, z)),
        *box("wall", (-x - WALL, -0.1, -z), (-x, SILL - 0.03, z)),
        *box("wall", (-x - WALL, LINTEL, -z), (-x, h + 0.2, z)),
        quad("ceiling", [(-x - WALL, h + 0.2, z), (x + WALL, h + 0.2, z), (x + WALL, h + 0.2, -z), (-x - WALL, h + 0.2, -z)]),
        quad("lawn", [(-12.5, -0.4, 7.5), (-x, -0.4, 7.5), (-x, -0.4, -7.5), (-12.5, -0.4, -7.5)]),
        *box("hedge", (-12.5, -0.4, -7.5), (-11.6, 1.25, 7.5)),
    ]  # fmt: skip
    edges = [-z, *(e for middle, width in WINDOWS for e in (middle - width / 2, middle + width / 2)), z]
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        pieces += box("wall", (-x - WALL, SILL - 0.03, low), (-x, LINTEL, high))
    for y, top, out, material in ((0.10, 1.05, 0.012, "wainscot"), (0.0, 0.10, 0.02, "skirting")):
        pieces += box(material, (-x, y, -z), (x, top, -z + out))
        pieces += box(material, (-x, y, z - out), (x, top, z))
        pieces += box(material, (x - out, y, -z + out), (x, top, z - out))
    pieces += box("skirting", (-x, 0.0, -z + 0.02), (-x + 0.02, 0.10, z - 0.02))
    return pieces


def window(width: float) -> list[Surface]:
    """Frame, sill, and radiator below; the origin is on the wall's inner face at the middle of the opening's foot."""
    half, top, out = width / 2, LINTEL - SILL, -0.18
    pieces = []
    for z in (-half, half - 0.06):
        pieces += box("window frame", (out, 0.0, z), (out + 0.07, top, z + 0.06))
    for z0, z1 in ((-half + 0.06, -0.035), (0.035, half - 0.06)):
        for y in (0.0, 1.18, top - 0.06):
            pieces += box("window frame", (out, y, z0), (out + 0.07, y + 0.06, z1))
    pieces += box("window frame", (out, 0.0, -0.035), (out + 0.07, top, 0.035))
    pieces += box("sill", (-WALL - 0.04, -0.03, -half - 0.04), (0.16, 0.0, half + 0.04))
    for i in range(int(width / 0.09) - 2):
        z = -half + 0.12 + 0.09 * i
        pieces += box("radiator", (0.04, -0.75, z), (0.12, -0.18, z + 0.06))
    pieces += box("radiator", (0.06, -0.70, -half + 0.08), (0.10, -0.66, half - 0.08))
    pieces += box("radiator", (0.06, -0.27, -half + 0.08), (0.10, -0.23, half - 0.08))
    return pieces


def curtain() -> list[Surface]:
    """A gathered curtain, 0.35 m wide along z, hanging from y = 0."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 49), np.linspace(0.0, 1.0, 9))
    x = 0.05 * np.sin(2 * np.pi * 6 * u + 0.8 * v) * (0.7 + 0.3 * v)
    points = np.stack([x, -2.35 * v, 0.35 * (u - 0.5) * (1.0 - 0.15 * np.sin(np.pi * v))], axis=-1)
    return [sheet("curtain", points, np.stack([1.1 * u, 2.35 * v], axis=-1))]


def board() -> list[Surface]:
    """The chalkboard with its ledge, chalk, a sponge, and something written; z = 0 is the wall, y = 0 the board's foot."""
    pieces = [
        *box("chalkboard", (-2.0, 0.0, 0.0), (2.0, 1.2, 0.03)),
        *box("board frame", (-2.04, -0.04, 0.0), (2.04, 0.0, 0.05)),
        *box("board frame", (-2.04, 1.2, 0.0), (2.04, 1.24, 0.05)),
        *box("board frame", (-2.04, 0.0, 0.0), (-2.0, 1.2, 0.05)),
        *box("board frame", (2.0, 0.0, 0.0), (2.04, 1.2, 0.05)),
        *box("board frame", (-1.2, -0.06, 0.05), (1.2, -0.045, 0.14)),
        *box("sponge", (0.7, -0.045, 0.065), (0.86, 0.0, 0.125)),
    ]
    for i, name in enumerate(("white chalk", "yellow chalk", "red chalk", "white chalk")):
        pieces += box(name, (-0.4 + 0.14 * i, -0.045, 0.08), (-0.31 + 0.14 * i, -0.033, 0.092))
    rng = np.random.RandomState(3)
    for row in range(4):
        x = -1.75
        while x < -0.35 + 0.2 * row:
            size = rng.uniform(0.02, 0.06)
            y = 1.0 - 0.16 * row + rng.uniform(-0.008, 0.008)
            pieces += box("white chalk", (x, y, 0.03), (x + size, y + 0.006, 0.032))
            pieces += box("white chalk", (x, y - 0.03, 0.03), (x + 0.006, y + 0.03, 0.032))
            x += size + rng.choice([0.025, 0.025, 0.07])
    # A triangle with the squares over its short sides.
    for (x0, y0), (x1, y1) in (((0.75, 0.3), (1.35, 0.3)), ((0.745, 0.3), (0.745, 0.75)), ((0.3, 0.3), (0.3, 0.75))):
        pieces += box("yellow chalk", (x0, y0, 0.03), (max(x1, x0 + 0.008), max(y1, y0 + 0.008), 0.032))
    for y in (0.3, 0.742):
        pieces += box("red chalk", (0.308, y, 0.03), (0.745, y + 0.008, 0.032))
    slope = [(1.35, 0.300, 0.0315), (1.35, 0.310, 0.0315), (0.75, 0.760, 0.0315), (0.75, 0.750, 0.0315)]
    return [*pieces, quad("red chalk", slope)]


def leg(material: str, x: float, z: float, height: float, radius: float = 0.013) -> Surface:
    return revolved(material, profile((radius, 0.0), (radius, height)), 10).moved((x, 0.0, z))


def desk() -> list[Surface]:
    """A desk for two, 1.3 x 0.55 m, with a shelf and a few things on it; pupils sit at +Z."""
    pieces = [
        *box("desk top", (-0.65, 0.725, -0.275), (0.65, 0.74, 0.275)),
        *box("desk edge", (-0.65, 0.705, -0.275), (0.65, 0.725, 0.275)),
        *box("desk frame", (-0.58, 0.56, -0.22), (0.58, 0.57, 0.10)),
        *box("desk frame", (-0.60, 0.30, -0.24), (0.60, 0.66, -0.23)),
    ]
    return pieces + [leg("desk frame", x, z, 0.705, 0.016) for x in (-0.60, 0.60) for z in (-0.235, 0.235)]


def chair(seat: str) -> list[Surface]:
    """A chair of bent shells on steel tubes; it faces -Z."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 1.0, 9))
    shell = np.stack([0.19 * u, 0.44 + 0.012 * u**2 - 0.02 * np.sin(np.pi * v), -0.20 + 0.38 * v], axis=-1)
    back = np.stack([0.18 * u, 0.62 + 0.22 * v, 0.19 + 0.05 * v - 0.035 * u**2], axis=-1)
    lengths = np.stack([0.19 * u, 0.38 * v], axis=-1)
    pieces = [sheet(seat, shell, lengths), sheet(seat, back, lengths)]
    pieces += [leg("chair frame", x, -0.17, 0.435) for x in (-0.17, 0.17)]
    pieces += [leg("chair frame", x, 0.205, 0.82) for x in (-0.17, 0.17)]
    bars = revolved("chair frame", profile((0.011, -0.17), (0.011, 0.17)), 10).moved(matrix=ALONG_X)
    return [*pieces, bars.moved((0.0, 0.42, -0.17)), bars.moved((0.0, 0.42, 0.205))]


def big_desk() -> list[Surface]:
    """The teacher's desk with books and papers, a mug, and a chair behind it."""
    pieces = box("big desk", (-0.8, 0.72, -0.38), (0.8, 0.76, 0.38))
    for x in (-0.78, 0.36):
        pieces += box("big desk", (x, 0.0, -0.34), (x + 0.42, 0.72, 0.34))
        for y in (0.08, 0.30, 0.52):
            pieces += box("shelf", (x + 0.02, y, -0.36), (x + 0.40, y + 0.18, -0.34))
            pieces += box("brass", (x + 0.17, y + 0.085, -0.38), (x + 0.25, y + 0.10, -0.36))
    pieces += box("big desk", (-0.36, 0.25, 0.30), (0.36, 0.72, 0.33))
    for i, y in enumerate((0.76, 0.79, 0.815)):
        turn = rotation_y(12.0 * i - 8.0)
        book = box(f"book {3 + 5 * i}", (-0.10, y, -0.14), (0.10, y + 0.03 - 0.005 * (i > 0), 0.14))
        pieces += [s.moved((0.5, 0.0, 0.1), turn) for s in book]
    pieces += [
        s.moved((-0.05, 0.0, 0.05), rotation_y(7.0)) for s in box("paper", (-0.105, 0.76, -0.15), (0.105, 0.766, 0.15))
    ]
    mug = profile((0.0, 0.76), (0.036, 0.76), (0.04, 0.85), (0.036, 0.85), (0.033, 0.77), (0.0, 0.77))
    pieces.append(revolved("blue seat", mug, 20).moved((-0.5, 0.0, 0.12)))
    return pieces


def big_chair() -> list[Surface]:
    """The teacher's chair; it faces +Z."""
    return [
        *box("leather", (-0.24, 0.44, -0.22), (0.24, 0.52, 0.24)),
        *box("leather", (-0.23, 0.56, -0.26), (0.23, 1.08, -0.20)),
        *box("chair frame", (-0.03, 0.40, -0.30), (0.03, 0.72, -0.26)),
        *box("chair frame", (-0.03, 0.39, -0.30), (0.03, 0.44, 0.05)),
        revolved("chair frame", profile((0.03, 0.06), (0.03, 0.39)), 12),
        *box("clock rim", (-0.28, 0.0, -0.03), (0.28, 0.06, 0.03)),
        *box("clock rim", (-0.03, 0.0, -0.28), (0.03, 0.06, -0.03)),
        *box("clock rim", (-0.03, 0.0, 0.03), (0.03, 0.06, 0.28)),
    ]


def bookcase(seed: int, levels: int = 5, width: float = 1.5) -> list[Surface]:
    """A bookcase full of books against the wall z = 0, open towards +Z; y = 0 is the floor."""
    rng = np.random.RandomState(seed)
    step, depth, half = 0.37, 0.30, width / 2
    top = 0.08 + levels * step
    pieces = [
        *box("shelf", (-half, 0.0, 0.0), (-half + 0.025, top + 0.025, depth)),
        *box("shelf", (half - 0.025, 0.0, 0.0), (half, top + 0.025, depth)),
        *box("shelf", (-half + 0.025, 0.0, 0.0), (half - 0.025, top + 0.025, 0.012)),
    ]
    for level in range(levels + 1):
        y = 0.08 + level * step
        pieces += box("shelf", (-half + 0.025, y, 0.012), (half - 0.025, y + 0.025, depth - 0.005))
    for level in range(levels):
        y, x = 0.105 + level * step, -half + 0.03
        while x < half - 0.09:
            if rng.random_sample() < 0.06:
                x += rng.uniform(0.05, 0.18)
                continue
            thick, tall, deep = rng.uniform(0.015, 0.055), rng.uniform(0.19, 0.31), rng.uniform(0.14, 0.22)
            name, front = f"book {rng.randint(len(BOOKS))}", depth - 0.03 - rng.uniform(0.0, 0.02)
            pieces += box(name, (x, y, front - deep), (x + thick, y + tall, front))
            pieces += box(
                "paper",
                (x + 0.003, y + tall, front - deep + 0.004),
                (x + thick - 0.003, y + tall + 0.0015, front - 0.004),
            )
            x += thick + 0.0015
    return pieces


def door() -> list[Surface]:
    """A door with its frame and handle, on the wall z = 0, seen from +Z."""
    rod = revolved("brass", profile((0.0, 0.0), (0.011, 0.0), (0.011, 0.12), (0.0, 0.12)), 10)
    return [
        *box("door", (-0.48, 0.005, 0.0), (0.48, 2.08, 0.03)),
        *box("door frame", (-0.56, 0.0, 0.0), (-0.48, 2.16, 0.06)),
        *box("door frame", (0.48, 0.0, 0.0), (0.56, 2.16, 0.06)),
        *box("door frame", (-0.48, 2.08, 0.0), (0.48, 2.16, 0.06)),
        *box("brass", (0.38, 0.96, 0.03), (0.42, 1.12, 0.035)),
        rod.moved((0.29, 1.06, 0.07), ALONG_X),
        *box("brass", (0.39, 1.05, 0.035), (0.41, 1.07, 0.075)),
    ]


def wall_map() -> list[Surface]:
    """A map of the world between two rods; z = 0 is the wall."""
    rod = revolved("map rod", profile((0.0, -1.05), (0.018, -1.05), (0.018, 1.05), (0.0, 1.05)), 10).moved(
        matrix=ALONG_X
    )
    lengths = [[0.0, 1.2], [2.0, 1.2], [2.0, 0.0], [0.0, 0.0]]
    sheet_ = quad("map", [(-1.0, 0.0, 0.02), (1.0, 0.0, 0.02), (1.0, 1.2, 0.02), (-1.0, 1.2, 0.02)], lengths)
    return [sheet_, rod.moved((0.0, 0.0, 0.02)), rod.moved((0.0, 1.2, 0.02))]


def pin_board() -> list[Surface]:
    """Cork with notes on it; z = 0 is the wall."""
    pieces = [
        *box("shelf", (-0.75, -0.02, 0.0), (0.75, 0.92, 0.02)),
        *box("cork", (-0.73, 0.0, 0.0), (0.73, 0.90, 0.024)),
    ]
    rng = np.random.RandomState(12)
    names = ("paper", "pink note", "yellow note", "blue note", "paper")
    for i in range(5):
        for k in range(3):
            x, y = -0.60 + 0.28 * i + rng.uniform(-0.03, 0.03), 0.10 + 0.28 * k + rng.uniform(-0.02, 0.02)
            name = names[rng.randint(len(names))]
            pieces += box(name, (x - 0.07, y - 0.05, 0.024), (x + 0.07, y + rng.uniform(0.05, 0.12), 0.0255))
    return pieces


def clock() -> list[Surface]:
    """A clock; z = 0 is the wall."""
    rim = profile((0.16, 0.0), (0.18, 0.0), torus(0.17, 0.0, 0.05, 5), (0.165, 0.05), (0.165, 0.02))
    lengths = [[0.0, 0.36], [0.36, 0.36], [0.36, 0.0], [0.0, 0.0]]
    face = quad(
        "clock face",
        [(-0.125, -0.125, 0.03), (0.125, -0.125, 0.03), (0.125, 0.125, 0.03), (-0.125, 0.125, 0.03)],
        lengths,
    )
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    back = revolved("paper", profile((0.17, 0.02), (0.0, 0.02)), 32)
    hands = [
        *box("clock rim", (-0.005, 0.0, 0.034), (0.005, 0.09, 0.036)),
        *box("clock rim", (0.0, -0.005, 0.037), (0.06, 0.005, 0.039)),
    ]
    return [revolved("clock rim", rim, 32).moved(matrix=turn), back.moved(matrix=turn), face, *hands]


def lamp() -> list[Surface]:
    """A ceiling lamp, 1.5 m along z, that shines downwards; y = 0 is the ceiling."""
    wire = revolved("clock rim", profile((0.006, -0.40), (0.006, 0.0)), 6)
    return [
        *box("lamp housing", (-0.17, -0.46, -0.75), (0.17, -0.40, 0.75)),
        quad("tube", [(-0.15, -0.465, -0.73), (0.15, -0.465, -0.73), (0.15, -0.465, 0.73), (-0.15, -0.465, 0.73)]),
        *(wire.moved((0.0, 0.0, z)) for z in (-0.5, 0.5)),
    ]


def globe() -> list[Surface]:
    """A globe on a stand; y = 0 is what it stands on."""
    ball = revolved("globe", profile(curve(0.0, 0.0, 0.16, 0.16, -90.0, 90.0, 20)), 32, tile=2.0)
    u = ball.uvs * [2.0 / ball.uvs[:, 0].max(), 1.0 / 0.502]
    ball = Surface("globe", ball.positions, ball.normals, u, ball.triangles)
    tilt = Rotation.from_euler("z", 23.4, degrees=True).as_matrix()
    foot = profile((0.0, 0.0), (0.10, 0.0), (0.10, 0.015), (0.02, 0.03), (0.012, 0.06), (0.012, 0.10), (0.0, 0.10))
    return [ball.moved((0.0, 0.25, 0.0), tilt), revolved("globe stand", foot, 24)]


def plant(seed: int) -> list[Surface]:
    """A plant with long arching leaves in a pot; y = 0 is what it stands on."""
    rng = np.random.RandomState(seed)
    pot = profile((0.0, 0.0), (0.08, 0.0), (0.115, 0.18), (0.125, 0.18), (0.125, 0.21), (0.11, 0.21), (0.105, 0.17))
    earth = profile((0.108, 0.19), (0.0, 0.195))
    t, side = np.meshgrid(np.linspace(0.0, 1.0, 9), np.linspace(-1.0, 1.0, 3), indexing="ij")
    leaves = []
    for i in range(26):
        reach, rise = rng.uniform(0.18, 0.38), rng.uniform(0.25, 0.55)
        width = 0.022 * np.sin(np.pi * np.minimum(t + 0.08, 1.0)) ** 0.7
        points = np.stack([reach * t**1.3, 0.19 + rise * np.sin(2.2 * t) - 0.01 * side**2, width * side], axis=-1)
        leaf = sheet("plant", points, np.stack([reach * t, 0.02 * side], axis=-1))
        leaves.append(leaf.moved(matrix=rotation_y(137.5 * i)))
    return [revolved("pot", pot, 24), revolved("earth", earth, 24), *leaves]


def bag(material: str) -> list[Surface]:
    """A school bag on the floor."""
    return [
        *box(material, (-0.16, 0.0, -0.10), (0.16, 0.36, 0.10)),
        *box(material, (-0.12, 0.03, 0.10), (0.12, 0.18, 0.15)),
        *box("clock rim", (-0.03, 0.36, -0.02), (0.03, 0.40, -0.01)),
    ]


def bin_() -> list[Surface]:
    line = profile((0.0, 0.0), (0.12, 0.0), (0.15, 0.32), (0.145, 0.32), (0.117, 0.01), (0.0, 0.01))
    return [revolved("bin", line, 24)]


def open_book(name: str) -> list[Surface]:
    """An open book and a pencil; y = 0 is the desk."""
    pencil = revolved("pencil", profile((0.0, -0.085), (0.004, -0.085), (0.004, 0.075), (0.0, 0.09)), 6)
    pages = [s for x in (-0.15, 0.004) for s in box("paper", (x, 0.004, -0.10), (x + 0.146, 0.014, 0.10))]
    cover = box(name, (-0.155, 0.0, -0.105), (0.155, 0.004, 0.105))
    return [*cover, *pages, pencil.moved((0.24, 0.005, 0.02), ALONG_X)]


# ---------------------------------------------------------------------------------------------------------------------
# Everything in its place


def build() -> Gltf:
    """The whole room."""
    gltf = Gltf("make_classroom.py", MATERIALS, TEXTURES, quantum=1 / 2000)
    seats = ("orange seat", "blue seat", "green seat")
    parts = {
        "room": room(),
        "window": window(1.9),
        "narrow window": window(1.3),
        "curtain": curtain(),
        "board": board(),
        "desk": desk(),
        **{f"{name.split()[0]} chair": chair(name) for name in seats},
        "big desk": big_desk(),
        "big chair": big_chair(),
        "bookcase": bookcase(21),
        "other bookcase": bookcase(22),
        "low bookcase": bookcase(23, 2),
        "door": door(),
        "map": wall_map(),
        "pin board": pin_board(),
        "clock": clock(),
        "lamp": lamp(),
        "globe": globe(),
        "plant": plant(4),
        "red bag": bag("red bag"),
        "navy bag": bag("navy bag"),
        "bin": bin_(),
        "open book": open_book("book 7"),
        "other open book": open_book("book 12"),
    }
    meshes = {name: gltf.mesh(name, surfaces) for name, surfaces in parts.items()}

    def put(name, *at, turn=0.0):
        gltf.node(name, None, meshes[name], at, turn)

    put("room", 0.0, 0.0, 0.0)
    for middle, width in WINDOWS:
        put("window" if width > 1.5 else "narrow window", -HALF_X, SILL, middle)
        for side in (-1, 1):
            put("curtain", -HALF_X + 0.19, 2.95, middle + side * (width / 2 + 0.12))
    for i, x in enumerate((-2.6, 0.0, 2.6)):
        for z in (-1.7, 1.3):
            put("lamp", x, HEIGHT, z)
        seat_rows(put, i, x)
    put("board", -0.3, 0.95, -HALF_Z + 0.012)
    put("big desk", 1.9, 0.0, -2.15, turn=180.0)
    put("big chair", 1.9, 0.0, -2.85)
    put("globe", 2.45, 0.76, -2.1)
    put("map", HALF_X - 0.012, 1.35, 0.9, turn=-90.0)
    put("door", HALF_X - 0.025, 0.0, -2.3, turn=-90.0)
    put("clock", 2.75, 2.5, -HALF_Z)
    put("pin board", 3.55, 1.25, -HALF_Z + 0.012)
    put("low bookcase", HALF_X - 0.03, 0.0, 0.9, turn=-90.0)
    put("bookcase", HALF_X - 0.03, 0.0, 2.6, turn=-90.0)
    put("bookcase", -3.5, 0.0, -HALF_Z + 0.025)
    put("other bookcase", -1.9, 0.0, HALF_Z - 0.025, turn=180.0)
    put("bin", 2.95, 0.0, -2.8)
    for z, turn in ((-2.6, 0.0), (0.05, 70.0), (2.5, 200.0)):
        put("plant", -HALF_X + 0.02, SILL, z, turn=turn)
    return gltf


def seat_rows(put, i: int, x: float) -> None:
    """A column of four desks, each with two chairs and some of a pupil's things."""
    rng = np.random.RandomState(40 + i)
    for row in range(4):
        z = -1.25 + 1.15 * row
        put("desk", x + rng.uniform(-0.03, 0.03), 0.0, z, turn=rng.uniform(-2.0, 2.0))
        for side in (-0.32, 0.32):
            name = ("orange chair", "blue chair", "green chair")[rng.randint(3)]
            put(name, x + side, 0.0, z + rng.uniform(0.30, 0.48), turn=rng.uniform(-14.0, 14.0))
            if rng.random_sample() < 0.6:
                name = ("open book", "other open book")[rng.randint(2)]
                put(name, x + side * 0.95, 0.741, z + 0.06, turn=rng.uniform(-12.0, 12.0))
            if rng.random_sample() < 0.4:
                put(
                    ("red bag", "navy bag")[rng.randint(2)],
                    x + 2.55 * side,
                    0.0,
                    z + 0.25,
                    turn=rng.uniform(-30.0, 30.0),
                )


def head() -> str:
    """The pose file: a head that tries to be still, and one slow glance to the side."""
    rng = np.random.RandomState(72)
    width = 9.0  # frames
    reach = np.arange(-40, 41)
    kernel = np.exp(-0.5 * (reach / width) ** 2)
    raw = np.stack([np.convolve(rng.standard_normal(FRAMES + 80), kernel, "valid") for _ in range(6)], axis=-1)
    raw /= np.sqrt((kernel**2).sum())
    tremor = rng.standard_normal((FRAMES, 6))
    position = np.array(HEAD) + 0.012 * raw[:, :3] + 0.0004 * tremor[:, :3]
    pitch, yaw, roll = (1.2 * raw[:, 3:] + 0.03 * tremor[:, 3:]).T
    glance = 6.0 * np.sin(np.pi * np.linspace(0.0, 1.0, FRAMES)) ** 2
    angles = np.stack([yaw + 16.0 + glance, pitch - 7.0, roll], axis=-1)
    quaternions = Rotation.from_euler("YXZ", angles, degrees=True).as_quat(canonical=True)
    rows = np.concatenate([np.arange(FRAMES)[:, None] / FPS, position, quaternions], axis=1)
    return "time,px,py,pz,qx,qy,qz,qw\n" + "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in rows)


def main() -> None:
    out = output_folder(__doc__, "classroom")
    write_textures(out / "textures", TEXTURES)
    build().write(out / "classroom.gltf")
    write_text(out / "head.csv", head())
    write_text(out / "scene.toml", SCENE)


if __name__ == "__main__":
    main()
