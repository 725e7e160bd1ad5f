"""The atrium: a courtyard with two storeys of arcades. `python tools/make_atrium.py` writes data/atrium.

The court is 24 x 9 m, open to the sky, with a gallery on all four sides: groin vaults on the ground floor, a timber
ceiling above. One bay (column, arch, vault, rib, pilaster) is modelled once and instanced along the four sides, so the
glTF file is small and exercises shared meshes and a hierarchy of nodes.

Frames: +Y is up and the unit is a metre. A side of the court is modelled in its own frame: x runs along the wall, z = 0
is the middle plane of the arcade, and z grows away from the court, into the gallery.
"""

import numpy as np
import shapes
from make_atrium_textures import TEXTURES
from painting import write_textures
from scene_files import Gltf, Material, key_frames, output_folder, write_text
from scipy.interpolate import CubicSpline
from shapes import (
    ALONG_X,
    ALONG_Z,
    Profile,
    Surface,
    box,
    centred_box,
    clean,
    copies,
    curve,
    grid,
    merged,
    profile,
    quad,
    rotation_y,
    sheet,
    torus,
)

# Plan: bays along and across the court, and the distance from the arcade's middle plane to the back wall.
BAY = 3.0
BAYS_LONG, BAYS_SHORT = 8, 3
HALF_X, HALF_Z = BAYS_LONG * BAY / 2, BAYS_SHORT * BAY / 2
GALLERY = 3.65
WALL = 0.5  # thickness of the arcades

# Section: heights above the court's floor.
GROUND = 0.16
SPRING = 3.2
PANEL_TOP = 4.85
UPPER = 5.1
RAIL = UPPER + 1.0
UPPER_SPRING = UPPER + 2.55
UPPER_TOP = UPPER + 3.6
CEILING = UPPER + 3.55
EAVES = UPPER + 4.05

ARCH_RADIUS, UPPER_ARCH_RADIUS = 1.2, 0.58
VAULT_RISE = 1.4

FRAMES, FPS = 64, 30

MATERIALS = {
    "plaster": Material(texture="plaster"),
    "whitewash": Material(texture="whitewash"),
    "limestone": Material(texture="limestone"),
    "ashlar": Material(texture="ashlar"),
    "brick": Material(texture="brick"),
    "marble": Material(texture="marble"),
    "court tiles": Material(texture="court_tiles"),
    "terracotta": Material(texture="terracotta"),
    "pottery": Material((0.72, 0.36, 0.23), "plaster"),
    "wood": Material(texture="wood"),
    "iron": Material((0.03, 0.03, 0.035)),
    "red cloth": Material((0.62, 0.07, 0.06), "damask"),
    "blue cloth": Material((0.07, 0.16, 0.42), "damask"),
    "green cloth": Material((0.10, 0.30, 0.14), "damask"),
    "leaf": Material(texture="leaf"),
    "orange": Material((0.85, 0.32, 0.02)),
    "earth": Material((0.09, 0.06, 0.04)),
}


def metres(material: str) -> float:
    """The size of the material's texture tile; 1 for a material without texture."""
    texture = MATERIALS[material].texture
    return TEXTURES[texture].metres if texture else 1.0


def revolved(material: str, line: Profile, segments: int, start: float = 0.0, stop: float = 360.0) -> Surface:
    """As `shapes.revolved`, fitted to the material's texture."""
    return shapes.revolved(material, line, segments, start, stop, metres(material))


def arch(material: str, line: Profile, segments: int) -> Surface:
    """The profile (radius, z) turned by half a circle in the xy plane, around the z axis."""
    return revolved(material, line, segments, 180.0, 360.0).moved(matrix=ALONG_Z)


def ring(material: str, line: Profile, planar: bool = False) -> Surface:
    """The profile (distance outwards from the arcade's middle plane, height) swept around the court, with mitres.

    It faces to the right of the direction of drawing. planar: lay the texture out over x and z, as floors want it,
    instead of along the walls.
    """
    sides = []
    for number, (half_x, half_z) in enumerate([(HALF_X, HALF_Z), (HALF_Z, HALF_X)] * 2):
        turn = rotation_y(90.0 * number)
        outwards, height = line.points[..., 0, None], line.points[..., 1, None]
        ends = np.array([-1.0, 1.0])
        points = np.stack(np.broadcast_arrays(ends * (half_x + outwards), height, half_z + outwards), axis=-1) @ turn.T
        flat = np.zeros_like(line.normals[..., 0])
        normals = np.stack([flat, line.normals[..., 1], line.normals[..., 0]], axis=-1) @ turn.T
        normals = np.broadcast_to(normals[..., None, :], points.shape)
        if planar:
            lengths = points[..., [0, 2]]
        else:
            lengths = np.stack(np.broadcast_arrays(ends * (half_x + outwards), -line.length[..., None]), axis=-1)
        sides += [grid(material, p, w, n) for p, w, n in zip(points, lengths, normals, strict=True)]
    return merged(sides)


# ---------------------------------------------------------------------------------------------------------------------
# Architecture


def column(radius: float, height: float, base: float, segments: int) -> list[Surface]:
    """A Tuscan column from y = 0 to `height`: square plinth, base, shaft with entasis, capital, square abacus."""
    top = 0.84 * radius
    plinth, abacus = 0.3 * base, 0.32 * base
    neck = height - abacus - 0.62 * base
    t = np.linspace(0.0, 1.0, 9)
    shaft = np.stack([radius + (top - radius) * t**1.8, 1.05 * base + (neck - 1.05 * base) * t], axis=-1)
    line = profile(
        (0.6 * radius, plinth),
        torus(radius * 1.12, plinth, plinth + 0.36 * base, 8),
        (radius * 1.12, plinth + 0.40 * base),
        curve(radius * 1.14, plinth + 0.52 * base, 0.12 * radius, 0.12 * base, -90.0, -180.0, 3),
        torus(radius * 1.02, plinth + 0.52 * base, plinth + 0.70 * base),
        shaft,
        torus(top, neck, neck + 0.14 * base, 6),
        (top, neck + 0.30 * base),
        torus(top * 1.04, neck + 0.30 * base, neck + 0.38 * base, 4),
        curve(top * 1.04, neck + 0.62 * base, 0.36 * base, 0.24 * base, -90.0, 0.0, 5),
        (0.6 * radius, neck + 0.62 * base),
    )
    side = top * 1.04 + 0.44 * base
    return [
        revolved("limestone", line, segments),
        *centred_box("limestone", radius * 1.12 + 0.19 * base, 0.0, plinth),
        *centred_box("limestone", side, height - abacus, height - 0.1 * base),
        *centred_box("limestone", side + 0.04 * base, height - 0.1 * base, height),
    ]


def pierced_wall(material: str, half: float, radius: float, top: float, steps: int) -> list[Surface]:
    """Both faces of a wall of width 2 * half and height `top` around a round arch of `radius`, springing at y = 0."""
    corner = np.degrees(np.arctan2(top, half))
    angle = np.radians(np.unique(np.concatenate([np.linspace(0.0, 180.0, steps + 1), [corner, 180.0 - corner]])))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    reach = np.minimum(half / np.maximum(np.abs(direction[:, 0]), 1e-9), top / np.maximum(direction[:, 1], 1e-9))
    outline = np.stack([direction * (radius + 0.06), direction * reach[:, None]])
    faces = []
    for side in (-1.0, 1.0):
        depth = np.full((*outline.shape[:2], 1), side * WALL / 2)
        points = np.concatenate([outline, depth], axis=-1)
        normals = np.broadcast_to([0.0, 0.0, side], points.shape)
        faces.append(grid(material, points, outline * [1.0, -1.0], normals))
    # The underside on the capital, from the arch to the panel's end.
    z = WALL / 2
    for x0, x1 in ((-half, -radius), (radius, half)):
        faces.append(quad(material, [(x0, 0, -z), (x1, 0, -z), (x1, 0, z), (x0, 0, z)]))
    return faces


def archivolt(radius: float, width: float, relief: float, segments: int) -> Surface:
    """The moulded stone arch itself: intrados and a raised band on both faces."""
    face, front = WALL / 2, WALL / 2 + relief
    half = [
        (radius + width, face - 0.02),
        (radius + width, front),
        (radius + 0.72 * width, front),
        (radius + 0.66 * width, front - 0.4 * relief),
        (radius + 0.1 * width, front - 0.4 * relief),
        (radius, front - 0.6 * relief),
    ]
    mirrored = [(r, -z) for r, z in reversed(half)]
    return arch("limestone", profile(np.array(half), np.array(mirrored)), segments)


def keystone(radius: float, width: float, height: float, relief: float) -> list[Surface]:
    """A wedge at the crown of an arch, standing out from both faces."""
    z = WALL / 2 + relief
    low, high = radius - 0.05, radius + height
    a, b = width * 0.8, width * 1.25
    corner = {
        (x, y, s): (x * (a if y == 0 else b) / 2, (low, high)[y], s * z)
        for x in (-1, 1)
        for y in (0, 1)
        for s in (-1, 1)
    }

    def face(*names):
        return quad("limestone", [corner[n] for n in names])

    return [
        face((-1, 0, 1), (1, 0, 1), (1, 1, 1), (-1, 1, 1)),
        face((1, 0, -1), (-1, 0, -1), (-1, 1, -1), (1, 1, -1)),
        face((-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)),
        face((1, 0, 1), (1, 0, -1), (1, 1, -1), (1, 1, 1)),
        face((-1, 0, -1), (-1, 0, 1), (-1, 1, 1), (-1, 1, -1)),
        face((-1, 1, 1), (1, 1, 1), (1, 1, -1), (-1, 1, -1)),
    ]


def ground_arch() -> list[Surface]:
    """One bay of the lower arcade above its columns; y = 0 is the springing."""
    return [
        *pierced_wall("brick", BAY / 2, ARCH_RADIUS, PANEL_TOP - SPRING, 32),
        archivolt(ARCH_RADIUS, 0.24, 0.05, 32),
        *keystone(ARCH_RADIUS, 0.24, 0.34, 0.09),
    ]


def upper_arch() -> list[Surface]:
    """Half a bay of the upper arcade above its columns; y = 0 is the springing."""
    return [
        *pierced_wall("plaster", BAY / 4, UPPER_ARCH_RADIUS, UPPER_TOP - UPPER_SPRING, 24),
        archivolt(UPPER_ARCH_RADIUS, 0.14, 0.04, 24),
        *keystone(UPPER_ARCH_RADIUS, 0.13, 0.20, 0.07),
    ]


def vault(width: float, depth: float, steps: int = 12) -> list[Surface]:
    """A groin vault over a rectangle around the y axis, seen from below; y = 0 is the springing.

    Two barrels cross, and the surface is the higher of both: each of the four sectors is part of one barrel, cut along
    the diagonals of the plan.
    """
    sectors = []
    angle = np.radians(np.linspace(-90.0, 90.0, 2 * steps + 1))[None, :]
    across = np.linspace(0.0, 1.0, 5)[:, None]
    reach = np.abs(np.sin(angle)) * (1.0 - across) + across  # from the diagonal to the edge
    for half, other, turn in ((width / 2, depth / 2, 0.0), (depth / 2, width / 2, 90.0)):
        points = np.stack(np.broadcast_arrays(half * np.sin(angle), VAULT_RISE * np.cos(angle), other * reach), axis=-1)
        normals = -np.stack(
            np.broadcast_arrays(np.sin(angle) / half, np.cos(angle) / VAULT_RISE, np.zeros_like(reach)), axis=-1
        )
        around = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[0, :, :2], axis=0), axis=1))])
        lengths = np.stack(np.broadcast_arrays(around[None, :], points[..., 2]), axis=-1)
        sector = grid("whitewash", points, lengths, normals)
        sectors += [sector.moved(matrix=rotation_y(turn)), sector.moved(matrix=rotation_y(turn + 180.0))]
    return sectors


def rib(steps: int = 24) -> list[Surface]:
    """A transverse arch under the vaults, from column to pilaster; y = 0 is the springing, x = 0 its middle."""
    angle = np.radians(np.linspace(0.0, 180.0, steps + 1))
    middle, half = GALLERY / 2, 0.2
    inner = np.stack([(middle - 0.3) * np.cos(angle), (VAULT_RISE - 0.14) * np.sin(angle)], axis=-1)
    outer = np.stack([middle * np.cos(angle), (VAULT_RISE + 0.05) * np.sin(angle)], axis=-1)
    around = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(inner, axis=0), axis=1))])

    def at(x, line):  # (x, (n, 2)) -> (n, 3), the arch standing in the yz plane
        return np.stack([np.full(len(line), x), line[:, 1], middle + line[:, 0]], axis=-1)

    down = -np.stack(
        [np.zeros_like(angle), np.sin(angle) / (VAULT_RISE - 0.14), np.cos(angle) / (middle - 0.3)], axis=-1
    )
    lengths = np.stack([np.stack([around, np.full_like(around, x)], axis=-1) for x in (-half, half)])
    faces = [grid("limestone", np.stack([at(-half, inner), at(half, inner)]), lengths, np.stack([down, down]))]
    for x in (-half, half):
        points = np.stack([at(x, inner), at(x, outer)])
        normals = np.broadcast_to([np.sign(x), 0.0, 0.0], points.shape)
        faces.append(grid("limestone", points, points[..., [2, 1]] * [1.0, -1.0], normals))
    return faces


def pilaster(height: float, material: str = "limestone") -> list[Surface]:
    """A flat pier on the back wall with base and capital, from y = 0; its back is at z = GALLERY."""
    back = GALLERY + 0.05

    def block(half, out, low, high):
        return box(material, (-half, low, GALLERY - out), (half, high, back))

    return [
        *block(0.29, 0.30, 0.0, 0.30),
        *block(0.26, 0.27, 0.30, 0.36),
        *block(0.23, 0.24, 0.36, height - 0.26),
        *block(0.25, 0.26, height - 0.26, height - 0.21),
        *block(0.23, 0.24, height - 0.21, height - 0.12),
        *block(0.29, 0.30, height - 0.12, height),
    ]


def corner_pier() -> list[Surface]:
    """The pier at a corner of the court through both storeys; y = 0 is the gallery's floor."""
    pieces = []

    def block(half, low, high, material="limestone"):
        pieces.extend(centred_box(material, half, low - GROUND, high - GROUND))

    block(0.44, GROUND, GROUND + 0.34)
    block(0.40, GROUND + 0.34, GROUND + 0.42)
    block(0.36, GROUND + 0.42, SPRING - 0.20, "ashlar")
    block(0.40, SPRING - 0.20, SPRING - 0.12)
    block(0.44, SPRING - 0.12, SPRING)
    block(0.36, SPRING, UPPER - 0.02, "ashlar")
    block(0.36, UPPER - 0.02, RAIL - 0.12, "plaster")
    block(0.40, RAIL - 0.12, RAIL)
    block(0.33, RAIL, UPPER_SPRING - 0.13, "plaster")
    block(0.37, UPPER_SPRING - 0.13, UPPER_SPRING)
    block(0.33, UPPER_SPRING, UPPER_TOP, "plaster")
    return pieces


def balustrade() -> list[Surface]:
    """Plinth, five balusters and handrail between two pedestals of the upper arcade; y = 0 is the floor."""
    line = profile(
        (0.02, 0.10), (0.065, 0.10), (0.065, 0.14),
        curve(0.035, 0.20, 0.03, 0.06, -60.0, 20.0, 3),
        curve(0.045, 0.36, 0.042, 0.13, -60.0, 60.0, 4),
        curve(0.050, 0.66, -0.015, 0.16, -50.0, 50.0, 3),
        (0.055, 0.80), (0.065, 0.83), (0.065, 0.88), (0.02, 0.88),
    )  # fmt: skip
    baluster = revolved("marble", line, 8)
    half = BAY / 4 - 0.15
    positions = np.zeros((5, 3))
    positions[:, 0] = np.linspace(-2, 2, 5) * 0.215
    return [
        copies(baluster, positions),
        *box("limestone", (-half, 0.0, -0.12), (half, 0.10, 0.12)),
        *box("limestone", (-half, 0.88, -0.13), (half, 0.96, 0.13)),
    ]


def upper_column() -> list[Surface]:
    """A pedestal as high as the balustrade, a slender column on it, and a block that bears the wall; y = 0 is the floor."""
    pedestal, height, block = RAIL - UPPER, UPPER_SPRING - UPPER, 0.13
    return [
        *centred_box("limestone", 0.20, 0.0, 0.12),
        *centred_box("limestone", 0.165, 0.12, pedestal - 0.10),
        *centred_box("limestone", 0.20, pedestal - 0.10, pedestal),
        *[s.moved((0.0, pedestal, 0.0)) for s in column(0.105, height - block - pedestal, 0.16, 12)],
        *box("limestone", (-0.185, height - block, -0.27), (0.185, height - 0.03, 0.27)),
        *box("limestone", (-0.20, height - 0.03, -0.31), (0.20, height, 0.31)),
    ]


def beam(depth: float) -> list[Surface]:
    """A ceiling beam across the upper gallery, its top at y = 0."""
    return box("wood", (-0.09, -0.22, 0.1), (0.09, 0.02, depth))


def rafter() -> list[Surface]:
    """The end of a rafter under the eaves; the origin is where it leaves the wall, and it slopes down to the court."""
    slope = np.radians(14.0)
    turn = np.array([[1, 0, 0], [0, np.cos(slope), np.sin(slope)], [0, -np.sin(slope), np.cos(slope)]])
    return [s.moved(matrix=turn) for s in box("wood", (-0.06, -0.16, -0.64), (0.06, 0.012, 0.4))]


def doorway(width: float, spring: float) -> list[Surface]:
    """An arched door in a stone frame on the back wall; y = 0 is the floor."""
    half, wall = width / 2, GALLERY
    section = [(0.0, 0.02), (0.0, -0.08), (0.03, -0.11), (0.13, -0.11), (0.18, -0.09), (0.18, 0.02)]
    line = profile(np.array(section) + [half, 0.0])
    frame = [arch("limestone", line, 24).moved((0.0, spring, wall))]
    for x0, x1 in ((-half - 0.18, -half), (half, half + 0.18)):
        frame += box("limestone", (x0, 0.0, wall - 0.10), (x1, spring, wall + 0.05))
    angle = np.radians(np.linspace(0.0, 180.0, 25))
    top = np.stack([half * np.cos(angle), spring + half * np.sin(angle)], axis=-1)
    bottom = np.stack([top[:, 0], np.zeros(len(top))], axis=-1)
    outline = np.stack([bottom, top])
    points = np.concatenate([outline, np.full((*outline.shape[:2], 1), wall - 0.035)], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    leaves = [grid("wood", points, outline[..., ::-1], normals)]
    leaves += box("wood", (-0.035, 0.0, wall - 0.06), (0.035, spring + half - 0.02, wall - 0.02))
    for y in (0.25, spring - 0.15):
        leaves += box("iron", (-half + 0.02, y, wall - 0.05), (half - 0.02, y + 0.06, wall - 0.03))
    return frame + leaves


# ---------------------------------------------------------------------------------------------------------------------
# Cloth, pots, trees


def banner(material: str, phase: float) -> list[Surface]:
    """A pennant 0.95 m wide on a rod that is fixed to the handrail, in front of a column; y = 0 is the handrail."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 17), np.linspace(0.0, 1.0, 33))
    drop = v * (2.15 + 0.45 * (1.0 - np.abs(2 * u - 1)))
    wave = 0.05 * v * np.sin(2 * np.pi * (1.6 * u + 0.25 * v) + phase)
    billow = 0.07 * np.sin(np.pi * np.minimum(v * 1.2, 1.0)) + 0.05 * v * np.sin(3.0 * v + phase)
    hang = np.stack([0.95 * (u - 0.5), -0.06 - drop, -0.605 - wave - billow], axis=-1)
    over = np.radians(np.linspace(0.0, 180.0, 7))[:-1, None]  # half around the rod
    loop = np.stack(
        np.broadcast_arrays(hang[:1, :, 0], -0.06 + 0.025 * np.sin(over), -0.58 + 0.025 * np.cos(over)), axis=-1
    )
    lengths = np.stack(
        [np.concatenate([loop[..., 0], hang[..., 0]]), np.concatenate([np.zeros(loop.shape[:2]), drop])], axis=-1
    )
    rod = revolved("wood", profile((0.0, -0.56), (0.02, -0.56), (0.02, 0.56), (0.0, 0.56)), 10)
    brackets = [face for x in (-0.5, 0.5) for face in box("iron", (x - 0.012, -0.085, -0.6), (x + 0.012, -0.055, -0.1))]
    return [sheet(material, np.concatenate([loop, hang]), lengths), rod.moved((0.0, -0.06, -0.58), ALONG_X), *brackets]


def curtain(material: str) -> list[Surface]:
    """A curtain in an arch of the lower arcade, gathered at +x; y = 0 is the springing.

    It hangs in folds from the rod, narrows to a tie at breast height and widens again below.
    """
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 61), np.linspace(0.0, 1.0, 25))
    height, tie = SPRING - GROUND - 0.06, 0.58
    above, below = np.minimum(v / tie, 1.0), np.maximum(v - tie, 0.0) / (1.0 - tie)
    pull = 0.5 - 0.5 * np.cos(np.pi * above) - 0.42 * below**0.7
    width = 1.15 * (1.0 - pull) + 0.30 * pull
    x = ARCH_RADIUS - 0.02 - width * u + 0.015 * np.cos(2 * np.pi * 14 * u)
    y = -0.04 - v * height - 0.22 * pull * u * (1.0 - v) * (1.0 - below)
    z = (
        (0.055 + 0.03 * pull)
        * np.sin(2 * np.pi * 7 * u + 0.6 * np.sin(5.0 * v))
        * (1.0 + 0.25 * np.sin(15.0 * u + 1.0))
    )
    cloth = sheet(material, np.stack([x, y, z], axis=-1), np.stack([2.2 * u, height * v], axis=-1))
    around, across = np.radians(np.linspace(0.0, 360.0, 25))[None, :], np.linspace(-1.0, 1.0, 5)[:, None]
    bulge = 1.0 + 0.15 * np.sqrt(1.0 - across**2)
    band = np.broadcast_arrays(
        ARCH_RADIUS - 0.17 + 0.16 * bulge * np.cos(around),
        -0.09 - tie * height + 0.04 * across,
        0.11 * bulge * np.sin(around),
    )
    lengths = np.stack(np.broadcast_arrays(0.14 * around, 0.04 * across), axis=-1)
    return [cloth, sheet(material, np.stack(band, axis=-1), lengths)]


def curtain_rod() -> list[Surface]:
    """The rod across an arch; y = 0 is the springing."""
    rod = revolved("iron", profile((0.0, -1.25), (0.018, -1.25), (0.018, 1.25), (0.0, 1.25)), 10)
    return [rod.moved((0.0, -0.03, 0.0), ALONG_X)]


def pot() -> list[Surface]:
    """A terracotta pot, 0.62 m high, with earth in it."""
    line = profile(
        (0.0, 0.0), (0.22, 0.0), (0.22, 0.05),
        curve(0.20, 0.05, 0.02, 0.02, 0.0, 90.0, 2),
        curve(-0.18, 0.58, 0.51, 0.60, -52.0, -12.0, 10),
        torus(0.315, 0.45, 0.50, 5), (0.32, 0.54), (0.36, 0.56), (0.375, 0.60),
        curve(0.365, 0.605, 0.012, 0.015, 0.0, 90.0, 2),
        (0.33, 0.62), (0.32, 0.54),
    )  # fmt: skip
    earth = profile((0.33, 0.56), (0.15, 0.585), (0.0, 0.59))
    return [revolved("pottery", line, 24), revolved("earth", earth, 24)]


def tree(seed: int) -> list[Surface]:
    """A clipped orange tree for the pot: trunk, a round crown of leaves, fruit. y = 0 is the pot's foot."""
    rng = np.random.RandomState(seed)
    t = np.linspace(0.0, 1.0, 6)
    trunk = profile(np.stack([0.035 - 0.012 * t, 0.55 + 1.05 * t], axis=-1))
    count, centre, radius = 1100, np.array([0.0, 1.85, 0.0]), 0.5

    def directions(n):
        z, angle = rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 2 * np.pi, n)
        return np.stack([np.sqrt(1 - z * z) * np.cos(angle), z, np.sqrt(1 - z * z) * np.sin(angle)], axis=-1)

    def unit(v):
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    # A leaf is two triangles folded along its midrib; it points outwards and down, most of them near the crown's hull.
    out = directions(count)
    foot = centre + out * (radius * rng.uniform(0.35, 1.0, count) ** (1 / 2.5))[:, None]
    tip = unit(out + 0.9 * directions(count) + [0.0, -0.25, 0.0])
    across = unit(np.cross(tip, directions(count)))
    face = np.cross(across, tip)
    size = rng.uniform(0.08, 0.13, count)[:, None]
    middle = foot + 0.5 * size * tip + 0.06 * size * face
    points = np.stack([foot, middle + 0.22 * size * across, foot + size * tip, middle - 0.22 * size * across], axis=1)
    normals = np.repeat(unit(face * np.sign((face * out).sum(axis=1, keepdims=True))), 4, axis=0)
    uvs = np.tile([[0.5, 0.0], [1.0, 0.5], [0.5, 1.0], [0.0, 0.5]], (count, 1))
    first = 4 * np.arange(count)[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    leaves = clean(Surface("leaf", points.reshape(-1, 3), normals, uvs, triangles))

    fruit = revolved("orange", profile(curve(0.0, 0.0, 0.036, 0.036, -90.0, 90.0, 6)), 10)
    places = centre + directions(16) * radius * 0.96
    return [revolved("wood", trunk, 8), leaves, copies(fruit, places)]


def vase() -> list[Surface]:
    """A marble vase on a square pedestal, 1.75 m high."""
    line = profile(
        (0.0, 0.90), (0.15, 0.90), (0.15, 0.93),
        curve(0.13, 1.02, -0.065, 0.09, -60.0, 60.0, 6),
        torus(0.085, 1.095, 1.125, 4),
        curve(0.03, 1.42, 0.24, 0.29, -75.0, 20.0, 14),
        curve(0.22, 1.60, -0.06, 0.09, -50.0, 60.0, 6),
        curve(0.25, 1.70, 0.03, 0.025, -90.0, 90.0, 5),
        (0.20, 1.70), (0.14, 1.55), (0.0, 1.45),
    )  # fmt: skip
    pedestal = [
        (0.31, 0.0, 0.14),
        (0.27, 0.14, 0.18),
        (0.235, 0.18, 0.74),
        (0.27, 0.74, 0.78),
        (0.30, 0.78, 0.84),
        (0.24, 0.84, 0.90),
    ]
    blocks = [face for half, low, high in pedestal for face in centred_box("limestone", half, low, high)]
    return [revolved("marble", line, 40), *blocks]


def well() -> list[Surface]:
    """The well in the middle of the court: two octagonal steps, a carved well-head and its iron arch with a pulley."""
    steps = []
    for half, low, high in ((1.45, 0.0, 0.15), (1.12, 0.15, 0.30)):
        angle = np.radians(22.5 + 45.0 * np.arange(9))
        corner = half / np.cos(np.radians(22.5)) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        side = np.stack([np.insert(corner, 1, y, axis=1) for y in (high, low)])
        length = np.linalg.norm(corner[1] - corner[0]) * np.arange(9)
        steps.append(
            grid("limestone", side, np.stack([np.stack([length, np.full(9, y)], axis=-1) for y in (0.0, high - low)]))
        )
        top = np.stack([np.insert(corner, 1, high, axis=1), np.insert(corner * 0.3, 1, high, axis=1)])
        steps.append(grid("limestone", top, top[..., [0, 2]], np.broadcast_to([0.0, 1.0, 0.0], top.shape)))
    line = profile(
        (0.5, 0.28), (0.74, 0.30), (0.74, 0.38),
        torus(0.70, 0.38, 0.46, 6), (0.66, 0.48),
        curve(0.66, 0.78, 0.06, 0.30, -88.0, 60.0, 12),
        (0.68, 1.05), torus(0.68, 1.05, 1.09, 4), (0.74, 1.13), (0.80, 1.15), (0.80, 1.24),
        curve(0.77, 1.24, 0.03, 0.03, 0.0, 90.0, 4),
        (0.58, 1.27), (0.56, 1.25), (0.56, 0.35),
    )  # fmt: skip
    bottom = profile((0.57, 0.5), (0.0, 0.5))
    hoop = arch("iron", profile(curve(0.70, 0.0, 0.03, 0.03, 0.0, 360.0, 10)), 32).moved((0.0, 1.95, 0.0))
    posts = [revolved("iron", profile((0.03, 1.2), (0.03, 1.95)), 10).moved((x, 0.0, 0.0)) for x in (-0.70, 0.70)]
    wheel = revolved("wood", profile(torus(0.09, -0.03, 0.0), torus(0.09, 0.0, 0.03), (0.0, 0.03)), 20)
    rope = revolved("pottery", profile((0.009, 0.6), (0.009, 2.45)), 6).moved((0.09, 0.0, 0.0))
    return [
        *steps, revolved("marble", line, 48), revolved("earth", bottom, 24), hoop, *posts,
        wheel.moved((0.0, 2.45, 0.0), ALONG_Z), rope,
        *box("iron", (-0.012, 2.45, -0.045), (0.012, 2.66, -0.03)), *box("iron", (-0.012, 2.45, 0.03), (0.012, 2.66, 0.045)),
    ]  # fmt: skip


def shell() -> list[Surface]:
    """All that runs around the court without a break: floors, steps, walls, cornices, ceilings, roof."""
    floor = np.array(
        [
            [(-HALF_X + 0.2, 0, HALF_Z - 0.2), (HALF_X - 0.2, 0, HALF_Z - 0.2)],
            [(-HALF_X + 0.2, 0, -HALF_Z + 0.2), (HALF_X - 0.2, 0, -HALF_Z + 0.2)],
        ]
    )
    edge, wall = -0.62, GALLERY
    string_course = profile(
        (-0.20, PANEL_TOP - 0.12), (-0.28, PANEL_TOP - 0.12), (-0.28, PANEL_TOP - 0.06),
        curve(-0.40, PANEL_TOP - 0.06, 0.12, 0.12, 0.0, 90.0, 5),
        (-0.48, PANEL_TOP + 0.06), (-0.48, UPPER - 0.06), (-0.51, UPPER - 0.06), (-0.51, UPPER),
    )  # fmt: skip
    entablature = profile(
        (-0.20, UPPER_TOP - 0.28), (-0.29, UPPER_TOP - 0.28), (-0.29, UPPER_TOP - 0.20), (-0.26, UPPER_TOP - 0.18),
        (-0.26, UPPER_TOP + 0.06), (-0.30, UPPER_TOP + 0.06),
        curve(-0.44, UPPER_TOP + 0.06, 0.14, 0.14, 0.0, 90.0, 5),
        (-0.50, UPPER_TOP + 0.20), (-0.50, UPPER_TOP + 0.29), (-0.10, UPPER_TOP + 0.29),
    )  # fmt: skip
    rise = np.tan(np.radians(14.0))
    low, high = (-0.98, EAVES - 0.70 * rise), (wall + 0.5, EAVES + (wall + 0.78) * rise)
    up = np.array([0.0, 0.03])
    skirting = profile(
        (wall + 0.05, GROUND + 0.30), (wall - 0.03, GROUND + 0.30), (wall - 0.05, GROUND + 0.27), (wall - 0.05, GROUND)
    )
    upper_skirting = profile((wall + 0.05, UPPER + 0.18), (wall - 0.03, UPPER + 0.18), (wall - 0.03, UPPER))
    return [
        grid("court tiles", floor, floor[..., [0, 2]] + 0.3),
        ring("limestone", profile((edge, 0.0), (edge, GROUND - 0.03), (edge + 0.03, GROUND), (0.40, GROUND))),
        ring("terracotta", profile((0.40, GROUND), (wall, GROUND)), planar=True),
        ring("whitewash", profile((wall, UPPER - 0.1), (wall, GROUND))),
        ring("limestone", skirting),
        ring("limestone", string_course),
        ring("limestone", profile((-0.51, UPPER), (0.30, UPPER))),
        ring("terracotta", profile((0.30, UPPER), (wall, UPPER)), planar=True),
        ring("plaster", profile((wall, CEILING + 0.1), (wall, UPPER))),
        ring("limestone", upper_skirting),
        ring("wood", profile((wall, CEILING), (0.0, CEILING))),
        ring("limestone", entablature),
        ring("wood", profile(high, low)),
        ring("terracotta", profile(low, low + up, high + up)),
        ring("plaster", profile((wall + 0.5, 0.0), (wall + 0.5, high[1]))),
    ]


def add_side(gltf: Gltf, parent: int, meshes: dict[str, int], bays: int) -> None:
    """One side of the court under the node `parent`, bay by bay."""
    left = -bays * BAY / 2
    for i in range(bays + 1):
        frame = gltf.node(f"frame {i}", parent, at=(left + i * BAY, GROUND, 0.0))
        if 0 < i < bays:
            gltf.node("column", frame, meshes["column"])
        gltf.node("rib", frame, meshes["rib"], (0.0, SPRING - GROUND, 0.0))
        gltf.node("pilaster", frame, meshes["pilaster"])
        gltf.node("upper pilaster", frame, meshes["upper pilaster"], (0.0, UPPER - GROUND, 0.0))
    for i in range(bays):
        bay = gltf.node(f"bay {i}", parent, at=(left + (i + 0.5) * BAY, SPRING, 0.0))
        gltf.node("arch", bay, meshes["arch"])
        gltf.node("vault", bay, meshes["vault"], (0.0, 0.0, GALLERY / 2))
        if i % 2 == bays // 2 % 2:
            gltf.node("door", bay, meshes["door"], (0.0, GROUND - SPRING, 0.0))
            gltf.node("upper door", bay, meshes["upper door"], (0.0, UPPER - SPRING, 0.0))
    for i in range(2 * bays):
        bay = gltf.node(f"upper bay {i}", parent, at=(left + (i + 0.5) * BAY / 2, UPPER, 0.0))
        gltf.node("upper arch", bay, meshes["upper arch"], (0.0, UPPER_SPRING - UPPER, 0.0))
        gltf.node("balustrade", bay, meshes["balustrade"])
        if i > 0:
            gltf.node("upper column", bay, meshes["upper column"], (-BAY / 4, 0.0, 0.0))
        gltf.node("beam", bay, meshes["beam"], (0.0, CEILING - UPPER, 0.0))
        for k in (-1, 1):
            gltf.node("rafter", bay, meshes["rafter"], (k * BAY / 8, EAVES - UPPER, -0.28))


def build() -> Gltf:
    """The whole atrium as a glTF document."""
    gltf = Gltf("make_atrium.py", MATERIALS, TEXTURES)
    parts = {
        "column": column(0.235, SPRING - GROUND, 0.26, 28),
        "arch": ground_arch(),
        "vault": vault(BAY, GALLERY),
        "corner vault": vault(GALLERY, GALLERY),
        "rib": rib(),
        "pilaster": pilaster(SPRING - GROUND),
        "upper pilaster": pilaster(CEILING - UPPER + 0.02, "plaster"),
        "corner pier": corner_pier(),
        "upper arch": upper_arch(),
        "upper column": upper_column(),
        "balustrade": balustrade(),
        "beam": beam(GALLERY + 0.05),
        "rafter": rafter(),
        "door": doorway(1.5, 2.0),
        "upper door": doorway(1.0, 1.75),
        "red banner": banner("red cloth", 0.3),
        "blue banner": banner("blue cloth", 1.9),
        "green curtain": curtain("green cloth"),
        "red curtain": curtain("red cloth"),
        "curtain rod": curtain_rod(),
        "pot": pot(),
        "orange tree": tree(11),
        "vase": vase(),
        "well": well(),
        "shell": shell(),
    }
    meshes = {name: gltf.mesh(name, surfaces) for name, surfaces in parts.items()}

    root = gltf.node("atrium")
    gltf.node("shell", root, meshes["shell"])
    sides = []
    for name, turn, half, bays in (
        ("south side", 0.0, HALF_Z, BAYS_LONG),
        ("east side", 90.0, HALF_X, BAYS_SHORT),
        ("north side", 180.0, HALF_Z, BAYS_LONG),
        ("west side", 270.0, HALF_X, BAYS_SHORT),
    ):
        offset = rotation_y(turn) @ [0.0, 0.0, half]
        sides.append(gltf.node(name, root, at=np.round(offset, 6), turn=turn))
        add_side(gltf, sides[-1], meshes, bays)
    for x in (-1, 1):
        for z in (-1, 1):
            corner = gltf.node("corner", root, at=(x * HALF_X, GROUND, z * HALF_Z))
            gltf.node("corner pier", corner, meshes["corner pier"])
            gltf.node(
                "corner vault", corner, meshes["corner vault"], (x * GALLERY / 2, SPRING - GROUND, z * GALLERY / 2)
            )
    furnish(gltf, root, sides, meshes)
    return gltf


def furnish(gltf: Gltf, root: int, sides: list[int], meshes: dict[str, int]) -> None:
    """Banners, curtains, trees, vases and the well."""
    court = gltf.node("furnishings", root)
    gltf.node("well", court, meshes["well"], turn=67.0)
    for side in (sides[0], sides[2]):
        for i, x in enumerate((-9.0, -3.0, 3.0, 9.0)):
            cloth = "red banner" if i % 2 == 0 else "blue banner"
            gltf.node(cloth, side, meshes[cloth], (x, RAIL, 0.0))
        for i, x in enumerate((-10.5, -7.5, -1.5, 1.5, 7.5, 10.5)):
            cloth = "green curtain" if i % 2 == 0 else "red curtain"
            rod = gltf.node("curtain rod", side, meshes["curtain rod"], (x, SPRING, 0.0))
            gltf.node(cloth, rod, meshes[cloth])
            gltf.node(cloth, rod, meshes[cloth], turn=180.0)
    rng = np.random.RandomState(5)
    for i, x in enumerate((-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)):
        for z in (-1, 1):
            place = (x, 0.0, z * (HALF_Z - 1.15))
            if i in (1, 4):
                gltf.node("vase", court, meshes["vase"], place)
                continue
            planter = gltf.node(
                "planter", court, None, place, turn=rng.uniform(0.0, 360.0), scale=rng.uniform(0.92, 1.08)
            )
            gltf.node("pot", planter, meshes["pot"])
            gltf.node("orange tree", planter, meshes["orange tree"])


SCENE = f"""\
# A courtyard with two storeys of arcades. Written by tools/make_atrium.py, as are the files beside it.

[environment]
color = [1.15, 1.6, 2.3]

[[lights]]
type = "directional"
direction = [0.38, -0.80, -0.46]
irradiance = [11.0, 9.9, 8.2]

[meshes.atrium]
file = "atrium.gltf"

[[instances]]
mesh = "atrium"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 16
stereo = true
eye_distance = 0.063
"""


def camera() -> str:
    """A walk at 1.4 m/s from the court's west end towards the north arcade, the head turning to its columns."""
    way = np.array([(-10.6, 1.65, 1.1), (-10.14, 1.65, 0.19), (-9.53, 1.65, -0.63), (-8.75, 1.65, -1.35)])
    goal = np.array([(0.0, 3.0, -0.5), (-1.3, 2.7, -2.9), (-3.1, 2.5, -4.6), (-5.2, 2.3, -5.7)])
    times, knots = np.linspace(0.0, FRAMES / FPS, 33), np.linspace(0.0, FRAMES / FPS, len(way))
    path, looks = (CubicSpline(knots, points)(times) for points in (way, goal))
    path[:, 1] += 0.02 * np.sin(4 * np.pi * times)  # the head's bobbing, two steps in a second
    return "\n[camera]\nfov_y = 62\n" + key_frames(times, position=path, look_at=looks)


def main() -> None:
    out = output_folder(__doc__, "atrium")
    write_textures(out / "textures", TEXTURES)
    build().write(out / "atrium.gltf")
    write_text(out / "scene.toml", SCENE + camera())


if __name__ == "__main__":
    main()
