"""A kitchen of shining things: `python tools/make_kitchen.py` writes data/kitchen.

A closed room of 5 x 4.4 x 2.6 m, lit by nothing but panels in the ceiling and a strip under the cupboards. Glazed tiles,
lacquer, polished stone, copper and steel pots, a mirror-like kettle, and glasses of solid glass: nearly every path is glossy
or specular somewhere. The camera glides along the counter.
"""

import numpy as np
from painting import Texture, blocks, bumps, marble, mix, noise, smoothstep, wood, write_textures
from scene_files import Gltf, Material, key_frames, output_folder, write_text
from scipy.interpolate import CubicSpline
from shapes import ALONG_X, ALONG_Z, Surface, box, curve, profile, quad, revolved, rotation_y, torus

FRAMES, FPS = 64, 30
HALF_X, HALF_Z, HEIGHT = 2.5, 2.2, 2.6  # the counter runs along -Z
FRONT = -HALF_Z + 0.60  # the face of the lower cupboards
TOP = 0.90  # of the counter
SHELF = 1.45  # the foot of the upper cupboards


def glaze(rng: np.random.RandomState) -> np.ndarray:
    """Hand-made tiles of 0.1 m, sea green, each of its own tone."""
    pattern = blocks(6, 6, 0.6)
    color = mix((0.42, 0.66, 0.62), (0.60, 0.78, 0.72), pattern.tone(rng)) + (0.012 * noise(rng, 1.2, 4))[..., None]
    return mix((0.80, 0.79, 0.75), color, smoothstep(0.0014, 0.0028, pattern.distance))


def glaze_bumps(rng: np.random.RandomState) -> np.ndarray:
    """Rounded edges and an uneven face."""
    pattern = blocks(6, 6, 0.6)
    return bumps(0.0012 * smoothstep(0.0, 0.006, pattern.distance) + 0.00010 * noise(rng, 1.8, 2), 0.6)


def glaze_surface(rng: np.random.RandomState) -> np.ndarray:
    """Green: roughness, low on the tiles and high in the joints. Blue: metallic, none."""
    joint = 1.0 - smoothstep(0.0014, 0.0028, blocks(6, 6, 0.6).distance)
    return np.stack([0 * joint + 1.0, 0.10 + 0.8 * joint, 0 * joint], axis=-1)


def floor_tiles(rng: np.random.RandomState) -> np.ndarray:
    """Black and ivory tiles of 0.3 m in a chequer."""
    pattern = blocks(4, 4, 1.2)
    dark = ((pattern.column + pattern.row) % 2).astype(float)
    color = mix((0.82, 0.79, 0.72), (0.13, 0.13, 0.14), dark) * (0.94 + 0.06 * pattern.tone(rng))[..., None]
    color = color + (0.015 * noise(rng, 1.2, 3))[..., None]
    return mix((0.42, 0.40, 0.37), color, smoothstep(0.001, 0.003, pattern.distance))


def brushed(rng: np.random.RandomState) -> np.ndarray:
    """Green: roughness of steel brushed along u. Blue: metallic, all."""
    grain = 0.30 + 0.05 * noise(rng, 0.4, 20, (1.0, 14.0))
    return np.stack([0 * grain + 1.0, grain, 0 * grain + 1.0], axis=-1)


TEXTURES = {
    "glaze": Texture(glaze, 0.6, 256),
    "glaze_bumps": Texture(glaze_bumps, 0.6, 256),
    "glaze_surface": Texture(glaze_surface, 0.6, 256),
    "floor": Texture(floor_tiles, 1.2, 256),
    "marble": Texture(marble, 1.6, 256),
    "wood": Texture(wood, 1.6, 256),
    "brushed": Texture(brushed, 0.4, 256),
}
MATERIALS = {
    "wall": Material((0.78, 0.74, 0.66)),
    "ceiling": Material((0.86, 0.85, 0.82)),
    "glazed tiles": Material(texture="glaze", surface="glaze_surface", normals="glaze_bumps"),
    "floor": Material(texture="floor", roughness=0.16),
    "counter": Material(texture="marble", roughness=0.08),
    "lacquer": Material((0.55, 0.045, 0.05), roughness=0.12),
    "white lacquer": Material((0.84, 0.83, 0.80), roughness=0.18),
    "plinth": Material((0.05, 0.05, 0.055), roughness=0.35),
    "steel": Material((0.66, 0.66, 0.67), surface="brushed", metallic=1.0),
    "mirror steel": Material((0.80, 0.80, 0.81), roughness=0.03, metallic=1.0),
    "copper": Material((0.93, 0.55, 0.40), roughness=0.14, metallic=1.0),
    "brass": Material((0.88, 0.70, 0.36), roughness=0.20, metallic=1.0),
    "iron": Material((0.045, 0.045, 0.05), roughness=0.55),
    "black glass": Material((0.012, 0.012, 0.014), roughness=0.02),
    "glass": Material((1.0, 1.0, 1.0), roughness=0.0, transmission=1.0, solid=True),
    "green glass": Material((0.35, 0.70, 0.38), roughness=0.0, transmission=1.0),
    "frosted glass": Material((0.95, 0.97, 1.0), roughness=0.45, transmission=1.0, solid=True),
    "wood": Material((1.0, 0.85, 0.70), "wood", roughness=0.35),
    "porcelain": Material((0.86, 0.85, 0.82), roughness=0.06),
    "lemon": Material((0.90, 0.72, 0.08), roughness=0.4),
    "apple": Material((0.62, 0.06, 0.04), roughness=0.22),
    "panel": Material((0.8, 0.8, 0.8), emission=(11.0, 10.1, 8.6)),
    "strip": Material((0.8, 0.8, 0.8), emission=(5.0, 3.9, 2.7)),
}

SCENE = f"""\
# A kitchen of shining things. Written by tools/make_kitchen.py, as are the files beside it.

[environment]
color = [0, 0, 0]

[meshes.kitchen]
file = "kitchen.gltf"

[[instances]]
mesh = "kitchen"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 64
stereo = true
eye_distance = 0.063
settings = {{ "pathtrace.bounces" = 6 }}
"""


# ---------------------------------------------------------------------------------------------------------------------
# The room


def room() -> list[Surface]:
    """Floor, walls, ceiling with its lamps, and the tiles behind the counter."""
    x, z, h = HALF_X, HALF_Z, HEIGHT
    pieces = [
        quad("floor", [(-x, 0, z), (x, 0, z), (x, 0, -z), (-x, 0, -z)]),
        quad("ceiling", [(-x, h, -z), (x, h, -z), (x, h, z), (-x, h, z)]),
        quad("wall", [(-x, 0, -z), (x, 0, -z), (x, h, -z), (-x, h, -z)]),
        quad("wall", [(x, 0, z), (-x, 0, z), (-x, h, z), (x, h, z)]),
        quad("wall", [(-x, 0, z), (-x, 0, -z), (-x, h, -z), (-x, h, z)]),
        quad("wall", [(x, 0, -z), (x, 0, z), (x, h, z), (x, h, -z)]),
        *box("glazed tiles", (-x, TOP, -z), (x, SHELF + 0.02, -z + 0.012)),
    ]
    for side in (-1, 1):
        pieces += box("white lacquer", (side * x - 0.015, 0.0, -z + 0.62), (side * x + 0.015, 0.10, z))
    pieces += box("white lacquer", (-x, 0.0, z - 0.015), (x, 0.10, z))
    for px in (-1.3, 0.0, 1.3):
        pieces += box("steel", (px - 0.34, h - 0.03, -0.44), (px + 0.34, h, 0.64))
        pieces.append(
            quad("panel", [(px - 0.3, h - 0.032, -0.4), (px + 0.3, h - 0.032, -0.4), (px + 0.3, h - 0.032, 0.6), (px - 0.3, h - 0.032, 0.6)])
        )  # fmt: skip
    return pieces


def cupboards() -> list[Surface]:
    """Lower cupboards with the counter around a sink, an oven, upper cupboards with a strip of light, and a hood."""
    x, back = HALF_X, -HALF_Z
    pieces = box("plinth", (-x, 0.0, back), (x, 0.10, FRONT - 0.06))
    pieces += box("white lacquer", (-x, 0.10, back), (x, TOP - 0.04, FRONT - 0.02))
    for i in range(8):
        x0 = -x + 0.625 * i
        if i in (4, 5):
            continue
        pieces += box("lacquer", (x0 + 0.004, 0.11, FRONT - 0.02), (x0 + 0.621, TOP - 0.05, FRONT))
        pieces += box("mirror steel", (x0 + 0.20, TOP - 0.13, FRONT + 0.02), (x0 + 0.425, TOP - 0.118, FRONT + 0.032))
        for dx in (0.205, 0.408):
            pieces += box("mirror steel", (x0 + dx, TOP - 0.13, FRONT), (x0 + dx + 0.012, TOP - 0.118, FRONT + 0.02))
    pieces += oven(0.0, 1.25)
    edge, s0, s1, z0, z1 = FRONT + 0.03, -1.55, -0.85, back + 0.14, back + 0.50
    for low, high in (
        ((-x, back), (s0, edge)),
        ((s1, back), (x, edge)),
        ((s0, back), (s1, z0)),
        ((s0, z1), (s1, edge)),
    ):
        pieces += box("counter", (low[0], TOP - 0.04, low[1]), (high[0], TOP, high[1]))
    pieces += sink(s0, s1, z0, z1)
    for i in range(8):
        x0 = -x + 0.625 * i
        if i in (4, 5):
            continue
        pieces += box("white lacquer", (x0, SHELF, back), (x0 + 0.625, 2.25, back + 0.33))
        pieces += box("lacquer", (x0 + 0.004, SHELF + 0.004, back + 0.33), (x0 + 0.621, 2.246, back + 0.35))
        pieces += box("mirror steel", (x0 + 0.30, SHELF + 0.03, back + 0.37), (x0 + 0.325, SHELF + 0.20, back + 0.38))
        pieces += box("mirror steel", (x0 + 0.305, SHELF + 0.10, back + 0.35), (x0 + 0.32, SHELF + 0.13, back + 0.37))
        light = [(x0, SHELF - 0.003, back + 0.20), (x0 + 0.625, SHELF - 0.003, back + 0.20), (x0 + 0.625, SHELF - 0.003, back + 0.24), (x0, SHELF - 0.003, back + 0.24)]  # fmt: skip
        pieces.append(quad("strip", light))
    pieces += box("steel", (0.05, 1.62, back), (1.20, 1.68, back + 0.52))
    pieces += box("steel", (0.42, 1.68, back), (0.83, HEIGHT, back + 0.32))
    return pieces


def oven(x0: float, x1: float) -> list[Surface]:
    """An oven with a dark glass door and knobs, and hobs on the counter above it."""
    pieces = [
        *box("steel", (x0 + 0.004, 0.11, FRONT - 0.02), (x1 - 0.004, TOP - 0.05, FRONT)),
        *box("black glass", (x0 + 0.10, 0.22, FRONT), (x1 - 0.10, 0.62, FRONT + 0.015)),
        *box("mirror steel", (x0 + 0.12, 0.655, FRONT + 0.03), (x1 - 0.12, 0.675, FRONT + 0.05)),
        *box("black glass", (x0 + 0.20, TOP, -HALF_Z + 0.08), (x1 - 0.20, TOP + 0.006, FRONT - 0.04)),
    ]
    for x in (x0 + 0.14, x1 - 0.155):
        pieces += box("mirror steel", (x, 0.66, FRONT), (x + 0.012, 0.67, FRONT + 0.03))
    knob = revolved("iron", profile((0.022, 0.0), (0.022, 0.025), (0.0, 0.025)), 20)
    pieces += [knob.moved((x0 + 0.2 + 0.17 * i, 0.76, FRONT), ALONG_Z) for i in range(6)]
    return pieces


def sink(x0: float, x1: float, z0: float, z1: float) -> list[Surface]:
    """A steel basin let into the counter, and a tap."""
    x0, x1, z0, z1 = x0 + 0.002, x1 - 0.002, z0 + 0.002, z1 - 0.002  # so that it stands before the counter's cut edges
    low, high = TOP - 0.20, TOP + 0.002
    pieces = [
        quad("steel", [(x0, low, z1), (x1, low, z1), (x1, low, z0), (x0, low, z0)]),
        quad("steel", [(x0, low, z0), (x1, low, z0), (x1, high, z0), (x0, high, z0)]),
        quad("steel", [(x1, low, z1), (x0, low, z1), (x0, high, z1), (x1, high, z1)]),
        quad("steel", [(x0, low, z1), (x0, low, z0), (x0, high, z0), (x0, high, z1)]),
        quad("steel", [(x1, low, z0), (x1, low, z1), (x1, high, z1), (x1, high, z0)]),
    ]
    middle, back = (x0 + x1) / 2, -HALF_Z + 0.08
    stem = revolved("mirror steel", profile((0.028, 0.0), (0.028, 0.03), (0.014, 0.04), (0.014, 0.30)), 16)
    bow = revolved("mirror steel", profile(curve(0.10, 0.0, 0.013, 0.013, 0.0, 360.0, 12)), 16, 0.0, 180.0)
    turn = rotation_y(90.0) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]).T
    spout = revolved("mirror steel", profile((0.013, 0.0), (0.013, 0.07), (0.0, 0.07)), 16)
    return [
        *pieces,
        stem.moved((middle, TOP, back)),
        bow.moved((middle, TOP + 0.30, back + 0.10), turn),
        spout.moved((middle, TOP + 0.23, back + 0.20)),
        *box("mirror steel", (middle + 0.02, TOP + 0.07, back - 0.008), (middle + 0.10, TOP + 0.082, back + 0.008)),
    ]


# ---------------------------------------------------------------------------------------------------------------------
# Things; y = 0 is what they stand on


def pot(material: str, radius: float, height: float, lid: bool) -> list[Surface]:
    """A pot with two handles, with a lid or open."""
    line = profile(
        (0.0, 0.0), (radius - 0.02, 0.0), curve(radius - 0.02, 0.02, 0.02, 0.02, -90.0, 0.0, 4),
        (radius, height), torus(radius, height, height + 0.006, 3),
        (radius - 0.004, height), (radius - 0.004, 0.02), (0.0, 0.012),
    )  # fmt: skip
    handle = revolved("brass", profile(curve(0.035, 0.0, 0.006, 0.006, 0.0, 360.0, 8)), 10, -90.0, 90.0)
    pieces = [revolved(material, line, 40)]
    for turn in (0.0, 180.0):
        pieces.append(handle.moved((radius, 0.78 * height, 0.0)).moved(matrix=rotation_y(turn)))
    if lid:
        cover = profile(
            (radius + 0.004, height + 0.006), curve(0.0, height + 0.006, radius + 0.004, 0.035, 4.0, 90.0, 8)
        )
        knob = profile(
            (0.010, height + 0.035),
            (0.010, height + 0.05),
            torus(0.012, height + 0.05, height + 0.07, 5),
            (0.0, height + 0.07),
        )
        pieces += [revolved(material, cover, 40), revolved("brass", knob, 16)]
    return pieces


def pan() -> list[Surface]:
    """A copper pan with an iron handle."""
    line = profile((0.0, 0.0), (0.10, 0.0), curve(0.10, 0.03, 0.03, 0.03, -90.0, 0.0, 5), (0.135, 0.055), (0.130, 0.055), (0.125, 0.03), (0.095, 0.005), (0.0, 0.005))  # fmt: skip
    return [revolved("copper", line, 40), *box("iron", (0.13, 0.042, -0.012), (0.36, 0.052, 0.012))]


def kettle() -> list[Surface]:
    """A round kettle like a mirror."""
    line = profile(
        (0.0, 0.0),
        (0.09, 0.0),
        curve(0.0, 0.095, 0.115, 0.085, -60.0, 70.0, 16),
        (0.03, 0.18),
        (0.03, 0.19),
        (0.0, 0.19),
    )
    knob = profile((0.006, 0.19), (0.006, 0.20), curve(0.0, 0.212, 0.014, 0.014, -60.0, 90.0, 6))
    grip = revolved("iron", profile(curve(0.085, 0.0, 0.008, 0.008, 0.0, 360.0, 8)), 20, 180.0, 360.0).moved(
        matrix=ALONG_Z
    )
    slope = np.radians(35.0)
    turn = np.array([[np.cos(slope), np.sin(slope), 0.0], [-np.sin(slope), np.cos(slope), 0.0], [0.0, 0.0, 1.0]])
    spout = revolved("mirror steel", profile((0.024, -0.02), (0.012, 0.10), (0.008, 0.10), (0.016, 0.0)), 16)
    return [
        revolved("mirror steel", line, 48),
        revolved("iron", knob, 16),
        grip.moved((0.0, 0.17, 0.0)),
        spout.moved((0.085, 0.12, 0.0), turn),
    ]


def goblet(material: str) -> list[Surface]:
    """A stemmed glass with walls of 2 mm."""
    line = profile(
        (0.0, 0.0), (0.034, 0.0), (0.034, 0.002), (0.006, 0.010), (0.004, 0.03), (0.004, 0.075),
        curve(0.0, 0.13, 0.036, 0.05, -75.0, 25.0, 12), (0.030, 0.175), (0.028, 0.175),
        curve(0.0, 0.13, 0.034, 0.048, 25.0, -90.0, 12),
    )  # fmt: skip
    return [revolved(material, line, 32)]


def tumbler(material: str) -> list[Surface]:
    """A drinking glass with a thick foot."""
    return [
        revolved(
            material, profile((0.0, 0.0), (0.030, 0.0), (0.036, 0.11), (0.0335, 0.11), (0.028, 0.012), (0.0, 0.012)), 32
        )
    ]


def bottle() -> list[Surface]:
    """A bottle of thin green glass with a cork."""
    line = profile(
        (0.0, 0.0),
        (0.036, 0.0),
        (0.038, 0.01),
        (0.038, 0.18),
        curve(0.014, 0.18, 0.024, 0.05, 0.0, 80.0, 6),
        (0.014, 0.30),
    )
    cork = profile((0.013, 0.285), (0.013, 0.315), (0.0, 0.315))
    return [revolved("green glass", line, 28), revolved("wood", cork, 12)]


def bowl() -> list[Surface]:
    """A glass bowl full of lemons and apples."""
    shell = profile(
        (0.0, 0.0),
        (0.06, 0.0),
        curve(0.0, 0.14, 0.15, 0.14, -62.0, -8.0, 12),
        curve(0.0, 0.14, 0.145, 0.135, -8.0, -90.0, 14),
    )
    lemon = revolved("lemon", profile(curve(0.0, 0.0, 0.032, 0.042, -90.0, 90.0, 12)), 20)
    apple = revolved(
        "apple", profile((0.0, -0.032), curve(0.016, 0.0, 0.022, 0.036, -70.0, 80.0, 12), (0.004, 0.022)), 24
    )
    fruit = [
        apple.moved((0.05, 0.075, 0.02)), apple.moved((-0.045, 0.075, 0.035)), lemon.moved((0.0, 0.07, -0.055), ALONG_X),
        lemon.moved((0.0, 0.135, 0.0), ALONG_Z), apple.moved((0.055, 0.13, -0.04)), lemon.moved((-0.06, 0.125, -0.03), ALONG_X),
    ]  # fmt: skip
    return [revolved("glass", shell, 40), *fruit]


def plates() -> list[Surface]:
    """A pile of plates, and a cup on it."""
    plate = profile(
        (0.0, 0.004), (0.05, 0.0), (0.06, 0.004), (0.11, 0.018), (0.11, 0.021), (0.055, 0.008), (0.0, 0.008)
    )
    cup = profile(
        (0.0, 0.0),
        (0.025, 0.0),
        curve(0.0, 0.045, 0.042, 0.045, -55.0, 20.0, 8),
        (0.036, 0.06),
        (0.022, 0.01),
        (0.0, 0.008),
    )
    pile = [revolved("porcelain", plate, 40).moved((0.0, 0.009 * i, 0.0)) for i in range(6)]
    return [*pile, revolved("porcelain", cup, 32).moved((0.0, 0.054, 0.0))]


def board() -> list[Surface]:
    """A wooden board with a knife."""
    return [
        *box("wood", (-0.20, 0.0, -0.13), (0.20, 0.02, 0.13)),
        *box("mirror steel", (-0.12, 0.0205, -0.012), (0.06, 0.0225, 0.02)),
        *box("iron", (0.06, 0.0205, -0.012), (0.17, 0.036, 0.012)),
    ]


def jar(material: str) -> list[Surface]:
    """A jar with a steel lid."""
    lid = profile((0.052, 0.14), (0.052, 0.165), (0.0, 0.165))
    line = profile((0.0, 0.0), (0.045, 0.0), (0.05, 0.01), (0.05, 0.14), (0.045, 0.14), (0.045, 0.012), (0.0, 0.008))
    return [revolved(material, line, 32), revolved("mirror steel", lid, 32)]


def table() -> list[Surface]:
    """A round table of planks on a steel foot."""
    top = revolved("wood", profile((0.0, 0.73), (0.545, 0.73), (0.55, 0.74), (0.545, 0.75), (0.0, 0.75)), 64)
    return [
        Surface("wood", top.positions, top.normals, top.positions[:, [0, 2]], top.triangles),
        revolved(
            "mirror steel",
            profile((0.0, 0.0), (0.28, 0.0), (0.28, 0.012), (0.05, 0.03), (0.035, 0.06), (0.035, 0.73)),
            48,
        ),
    ]


def build() -> Gltf:
    """The whole kitchen."""
    gltf = Gltf("make_kitchen.py", MATERIALS, TEXTURES)
    parts = {
        "room": room(),
        "cupboards": cupboards(),
        "copper pot": pot("copper", 0.13, 0.14, True),
        "steel pot": pot("mirror steel", 0.11, 0.19, False),
        "small pot": pot("copper", 0.085, 0.09, False),
        "pan": pan(),
        "kettle": kettle(),
        "goblet": goblet("glass"),
        "tumbler": tumbler("glass"),
        "bottle": bottle(),
        "bowl": bowl(),
        "plates": plates(),
        "board": board(),
        "jar": jar("porcelain"),
        "frosted tumbler": tumbler("frosted glass"),
        "table": table(),
    }
    meshes = {name: gltf.mesh(name, surfaces) for name, surfaces in parts.items()}

    def put(name, *at, turn=0.0):
        gltf.node(name, None, meshes[name], at, turn)

    put("room", 0.0, 0.0, 0.0)
    put("cupboards", 0.0, 0.0, 0.0)
    hob, z = TOP + 0.0065, -HALF_Z + 0.32
    put("copper pot", 0.40, hob, z - 0.06, turn=30.0)
    put("pan", 0.70, hob, z + 0.08, turn=-75.0)
    put("kettle", 0.92, hob, z - 0.08, turn=140.0)
    put("steel pot", 1.55, TOP + 0.0005, z - 0.10, turn=70.0)
    put("small pot", 1.80, TOP + 0.0005, z + 0.10, turn=10.0)
    put("bottle", 2.15, TOP + 0.0005, z - 0.12)
    put("bottle", 2.25, TOP + 0.0005, z - 0.02)
    put("plates", -0.55, TOP + 0.0005, z - 0.02)
    put("board", -0.10, TOP + 0.0005, z + 0.06, turn=8.0)
    for i in range(4):
        put("jar", -2.30 + 0.13 * i, TOP + 0.0005, -HALF_Z + 0.12)
    for i, (x, dz) in enumerate(((-2.15, 0.12), (-2.02, 0.05), (-1.90, 0.16))):
        put("frosted tumbler", x, TOP + 0.0005, z + dz, turn=40.0 * i)
    put("table", 0.55, 0.0, 0.15)
    put("bowl", 0.60, 0.7505, 0.05)
    put("goblet", 0.22, 0.7505, 0.22)
    put("goblet", 0.36, 0.7505, 0.42)
    put("tumbler", 0.85, 0.7505, 0.36)
    put("bottle", 0.90, 0.7505, 0.12)
    return gltf


def camera() -> str:
    """A slow glide from left to right, towards the counter."""
    way = np.array([(-1.05, 1.50, 1.10), (-0.65, 1.47, 1.15), (-0.25, 1.44, 1.15), (0.10, 1.42, 1.10)])
    goal = np.array([(0.25, 0.85, -1.0), (0.30, 0.85, -1.0), (0.35, 0.85, -1.0), (0.45, 0.85, -1.0)])
    times, knots = np.linspace(0.0, FRAMES / FPS, 17), np.linspace(0.0, FRAMES / FPS, 4)
    path, looks = (CubicSpline(knots, points)(times) for points in (way, goal))
    return "\n[camera]\nfov_y = 55\n" + key_frames(times, position=path, look_at=looks)


def main() -> None:
    out = output_folder(__doc__, "kitchen")
    write_textures(out / "textures", TEXTURES)
    build().write(out / "kitchen.gltf")
    write_text(out / "scene.toml", SCENE + camera())


if __name__ == "__main__":
    main()
