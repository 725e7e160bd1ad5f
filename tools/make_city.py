"""A town of blocks: `python tools/make_city.py` writes data/city.

Houses, towers, trees, lamps and stalls are built of cubes of one metre with coarse pictures on them, each once, and placed
some hundreds of times along streets that rise in terraces from a main street. The camera flies down that street to the
harbour, where a ship with thin rigging lies before far hills: much small and contrasting detail at all distances, under sun
and sky.
"""

import numpy as np
from painting import SIZE, Texture, write_textures
from scene_files import Gltf, Material, key_frames, output_folder, write_text
from scipy.interpolate import CubicSpline
from shapes import Surface, box, clean, quad

FRAMES, FPS = 128, 30
STREET = 5.5  # metres from the middle to the houses' side
PLOT_X, PLOT_Z = 14.0, 13.0
COLUMNS, ROWS = 5, 14
GATE = 3  # the row before which it stands
QUAY = -ROWS * PLOT_Z - 4.0
SEA = -1.5
CELLS = 16  # of a picture along a side


def cells(color, deviation: float, pattern: np.ndarray | None = None, dark: float = 0.62):
    """A painter of CELLS x CELLS squares of about one colour, darker where the pattern (CELLS, CELLS) is set."""

    def paint(rng: np.random.RandomState) -> np.ndarray:
        tone = 1.0 + deviation * rng.uniform(-1.0, 1.0, (CELLS, CELLS))
        if pattern is not None:
            tone *= np.where(pattern, dark, 1.0)
        return np.kron(np.asarray(color) * tone[..., None], np.ones((SIZE // CELLS, SIZE // CELLS, 1)))

    return paint


ROW, COLUMN = np.indices((CELLS, CELLS))
JOINTS = (ROW % 4 == 3) | ((COLUMN + 4 * (ROW // 4 % 2)) % 8 == 7)
BOARDS = (ROW % 4 == 3) | ((COLUMN == 3) & (ROW // 4 % 2 == 0)) | ((COLUMN == 11) & (ROW // 4 % 2 == 1))
TILES = (ROW % 4 == 3) | ((COLUMN + 2 * (ROW // 4 % 2)) % 4 == 3)
COBBLES = ((COLUMN + 3 * (ROW // 5)) % 5 == 0) | (ROW % 5 == 4)
BARK = (COLUMN * 7 + ROW // 5 * 3) % 5 < 2
FRAME = (COLUMN % 15 == 0) | (ROW % 15 == 0) | (COLUMN == 7) | (ROW == 7)


def window(rng: np.random.RandomState) -> np.ndarray:
    """Dark panes in a pale frame."""
    panes = cells((0.16, 0.22, 0.30), 0.25)(rng)
    frame = np.kron(FRAME, np.ones((SIZE // CELLS, SIZE // CELLS)))[..., None]
    return np.where(frame > 0, np.asarray((0.62, 0.55, 0.44)), panes)


def leaves(rng: np.random.RandomState) -> np.ndarray:
    """Green squares, a third of them missing."""
    color = cells((0.25, 0.44, 0.14), 0.35)(rng)
    alpha = np.kron(rng.random_sample((CELLS, CELLS)) > 0.34, np.ones((SIZE // CELLS, SIZE // CELLS)))
    return np.concatenate([color, alpha[..., None]], axis=-1)


def block(paint) -> Texture:
    return Texture(paint, 1.0, 64, "png")


TEXTURES = {
    "stone": block(cells((0.56, 0.56, 0.55), 0.10, JOINTS)),
    "plaster": block(cells((0.86, 0.82, 0.73), 0.05)),
    "sandstone": block(cells((0.83, 0.74, 0.55), 0.07, ROW % 8 == 7, 0.8)),
    "brick": block(cells((0.61, 0.34, 0.27), 0.12, JOINTS, 0.7)),
    "planks": block(cells((0.64, 0.48, 0.29), 0.09, BOARDS)),
    "dark_planks": block(cells((0.34, 0.23, 0.14), 0.12, BOARDS)),
    "roof": block(cells((0.66, 0.30, 0.20), 0.13, TILES)),
    "slate": block(cells((0.33, 0.36, 0.42), 0.13, TILES)),
    "cobble": block(cells((0.50, 0.48, 0.46), 0.16, COBBLES)),
    "grass": block(cells((0.36, 0.53, 0.21), 0.18)),
    "log": block(cells((0.38, 0.29, 0.18), 0.12, BARK, 0.75)),
    "wool": block(cells((0.88, 0.87, 0.84), 0.04)),
    "window": block(window),
    "leaves": block(leaves),
}
MATERIALS = {
    **{name: Material(texture=name, specular=0.0) for name in TEXTURES if name not in ("window", "leaves")},
    "window": Material(texture="window", roughness=0.12),
    "leaves": Material(texture="leaves", cutoff=0.5, specular=0.0),
    "red wool": Material((0.75, 0.10, 0.07), "wool", specular=0.0),
    "iron": Material((0.05, 0.05, 0.055), specular=0.0),
    "lantern": Material((0.9, 0.6, 0.3), specular=0.0, emission=(9.0, 5.4, 2.2)),
}
INDEX = {name: i for i, name in enumerate(MATERIALS, 1)}  # in an array of blocks; 0 is air

SCENE = f"""\
# A town of blocks. Written by tools/make_city.py, as are the files beside it.

[environment.sky]
turbidity = 2.6
elevation = 40
azimuth = 152
scale = 0.042

[materials.sea]
base_color = [0.02, 0.07, 0.09]
roughness = 0.16
ior = 1.33

[meshes.sea]
generator = "plane"
size = [20000, 20000]

[meshes.city]
file = "city.gltf"

[[instances]]
mesh = "sea"
material = "sea"
translation = [0, {SEA}, 0]

[[instances]]
mesh = "city"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 16
stereo = true
eye_distance = 0.063
"""


# ---------------------------------------------------------------------------------------------------------------------
# Blocks


def cubes(filled: np.ndarray, size: float = 1.0) -> list[Surface]:
    """The visible faces of an array (x, y, z) of blocks, centred on the y axis, on the ground, which hides what touches it.

    size: of a block. Along each row, faces of one material side by side are one quad.
    """
    filled = np.pad(filled, 1)
    filled[:, 0] = filled[:, 1]
    origin = np.array([filled.shape[0] / 2, 1.0, filled.shape[2] / 2])
    corners, normals, materials = [], [], []
    for axis, other, run in ((0, 1, 2), (1, 2, 0), (2, 1, 0)):  # faces across `axis` are joined along `run`
        for side in (-1, 1):
            seen = np.where(np.roll(filled, -side, axis) == 0, filled, 0)
            seen[:, 0] = 0
            line = np.moveaxis(seen, (axis, other, run), (0, 1, 2))
            layer, row, start = np.nonzero((line != np.roll(line, 1, 2)) & (line > 0))
            stop = np.nonzero((line != np.roll(line, -1, 2)) & (line > 0))[2] + 1
            near, far = layer + (side > 0), row + 1
            face = np.stack(
                [
                    np.stack(c, axis=-1)
                    for c in ((near, row, start), (near, row, stop), (near, far, stop), (near, far, start))
                ],
                axis=1,
            )
            corners.append(face[..., np.argsort([axis, other, run])] - origin)
            normals.append(np.broadcast_to(side * np.eye(3)[axis], (len(face), 3)))
            materials.append(line[layer, row, start])
    corners, normals, materials = map(np.concatenate, (corners, normals, materials))
    return [
        _faces(name, size * corners[materials == i], normals[materials == i])
        for name, i in INDEX.items()
        if (materials == i).any()
    ]


def _faces(material: str, corners: np.ndarray, normals: np.ndarray) -> Surface:
    """Quads (n, 4, 3), each with the joined blocks along its first edge, as a surface; v runs down its last edge."""
    count = len(corners)
    u, v = (np.linalg.norm(corners[:, i] - corners[:, 0], axis=1) for i in (1, 3))
    uvs = np.stack([np.stack(p, axis=-1) for p in ((0 * u, v), (u, v), (u, 0 * v), (0 * u, 0 * v))], axis=1)
    first = 4 * np.arange(count)[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return clean(
        Surface(material, corners.reshape(-1, 3), np.repeat(normals, 4, axis=0), uvs.reshape(-1, 2), triangles)
    )


def air(width: int, height: int, depth: int) -> np.ndarray:
    return np.zeros((width, height, depth), dtype=np.int64)


# ---------------------------------------------------------------------------------------------------------------------
# What the town is made of; the front is towards +Z, y = 0 is the ground


def house(width: int, depth: int, storeys: int, wall: str, frame: str, roof: str) -> list[Surface]:
    """A house with corner posts, windows on all sides, a door, and a roof in steps with its ridge along z."""
    top = 4 * storeys
    a = air(width + 2, top + width // 2 + 5, depth + 2)
    body = a[1:-1, :top, 1:-1]
    body[:] = INDEX[wall]
    body[:, 3::4] = INDEX[frame]
    for x in (0, -1):
        for z in (0, -1):
            body[x, :, z] = INDEX[frame]
    for storey in range(storeys):
        for y in (4 * storey + 1, 4 * storey + 2):
            for i in range(2, width - 2, 3):
                body[i, y, [0, -1]] = INDEX["window"]
            for k in range(2, depth - 2, 3):
                body[[0, -1], y, k] = INDEX["window"]
    middle = width // 2
    body[middle - 1 : middle + 1, :3, -1] = INDEX["dark_planks"]
    for step in range(width // 2 + 1):
        a[step : width + 2 - step, top + step, :] = INDEX[roof]
        a[step + 1 : width + 1 - step, top + step, 1:-1] = INDEX[wall]
        a[step + 1 : width + 1 - step, top + step, [0, -1]] = 0
        a[[step, width + 1 - step], top + step, :] = INDEX[roof]
    a[width // 4 + 1, top : top + width // 2 + 3, depth // 3] = INDEX["brick"]
    return cubes(a)


def tower(width: int, height: int, wall: str) -> list[Surface]:
    """A square tower with slit windows and battlements that stand out."""
    a = air(width + 2, height + 3, width + 2)
    a[1:-1, :height, 1:-1] = INDEX[wall]
    for y in range(4, height - 4, 5):
        middle = (width + 2) // 2
        a[middle, y : y + 2, [1, -2]] = INDEX["window"]
        a[[1, -2], y : y + 2, middle] = INDEX["window"]
    a[:, height] = INDEX[wall]
    edge = air(width + 2, 2, width + 2)
    edge[[0, -1]] = edge[:, :, [0, -1]] = INDEX["stone"]
    edge[1::2, 1, [0, -1]] = edge[[0, -1], 1, 1::2] = 0
    a[:, height + 1 :] = edge
    return cubes(a)


def church() -> list[Surface]:
    """A nave with a slate roof and a tower with a tall spire and a thin cross."""
    a = air(13, 44, 26)
    a[2:11, :12, 2:20] = INDEX["sandstone"]
    for z in range(4, 18, 3):
        a[[2, 10], 3:10, z] = INDEX["window"]
    for step in range(6):
        a[1 + step : 12 - step, 12 + step, 1:20] = INDEX["slate"]
    a[3:10, :26, 18:25] = INDEX["sandstone"]
    a[3:10, 20, 18:25] = INDEX["stone"]
    a[5:8, 22:25, [18, 24]] = a[[3, 9], 22:25, 20:23] = INDEX["window"]
    a[5:8, :4, 24] = INDEX["dark_planks"]
    a[5:8, 10:13, 24] = INDEX["window"]
    for step in range(16):
        inset = step // 4
        a[3 + inset : 10 - inset, 26 + step, 18 + inset : 25 - inset] = INDEX["slate"]
    cross = box("iron", (-0.06, 42.0, 8.44), (0.06, 45.0, 8.56)) + box("iron", (-0.7, 43.9, 8.44), (0.7, 44.02, 8.56))
    return [*cubes(a), *cross]


def tree(seed: int, height: int) -> list[Surface]:
    """A trunk and a ragged ball of leaves."""
    rng = np.random.RandomState(seed)
    a = air(7, height + 4, 7)
    x, y, z = np.indices(a.shape)
    distance = np.sqrt((x - 3) ** 2 + (1.25 * (y - height)) ** 2 + (z - 3) ** 2)
    a[distance + rng.uniform(0.0, 0.9, a.shape) < 3.7] = INDEX["leaves"]
    a[3, : height + 1, 3] = INDEX["log"]
    return cubes(a)


def lamp() -> list[Surface]:
    """A thin post with a lantern under an arm."""
    return [
        *box("dark_planks", (-0.09, 0.0, -0.09), (0.09, 4.0, 0.09)),
        *box("dark_planks", (-0.06, 3.7, 0.09), (0.06, 3.82, 1.0)),
        *box("iron", (-0.02, 3.45, 0.83), (0.02, 3.7, 0.87)),
        *box("lantern", (-0.15, 3.05, 0.70), (0.15, 3.40, 1.00)),
        *box("iron", (-0.19, 3.40, 0.66), (0.19, 3.45, 1.04)),
    ]


def stall() -> list[Surface]:
    """A market stall: four posts, a counter, a striped awning."""
    pieces = [*box("planks", (-1.6, 0.0, 0.4), (1.6, 1.0, 1.1))]
    for x in (-1.7, 1.7):
        for z in (-1.0, 1.0):
            pieces += box("log", (x - 0.08, 0.0, z - 0.08), (x + 0.08, 2.5, z + 0.08))
    for i in range(8):
        cloth = "red wool" if i % 2 else "wool"
        pieces += box(cloth, (-2.0 + 0.5 * i, 2.5, -1.3), (-1.5 + 0.5 * i, 2.62, 1.4))
    return pieces


def arch() -> list[Surface]:
    """A gate across the main street with rooms above."""
    a = air(16, 15, 5)
    a[:, :12] = INDEX["stone"]
    a[4:12, :6] = 0
    a[5:11, 6] = 0
    a[6:10, 7] = 0
    a[3:13:3, 9:11, [0, -1]] = INDEX["window"]
    a[:, 12] = INDEX["brick"]
    a[::2, 13, [0, -1]] = INDEX["stone"]
    return cubes(a)


def ship() -> list[Surface]:
    """A three-master with rigging of thin lines; y = 0 is the water line, the bow points towards +X."""
    a = air(38, 8, 10)
    x, y, z = np.indices(a.shape)
    half = (
        4.6
        * np.sqrt(np.clip(1.0 - np.abs((x - 17.0) / 20.0) ** 3, 0.0, 1.0))
        * (0.72 + 0.28 * np.minimum(y / 4.0, 1.0))
    )
    deck = 4 + 2 * (x < 8) + (x > 31)
    a[(np.abs(z - 4.5) < half) & (y < deck)] = INDEX["dark_planks"]
    a[(np.abs(z - 4.5) < half) & (y == deck - 1)] = INDEX["planks"]
    pieces = cubes(a)
    for mast, height in ((-10.0, 20.0), (1.0, 26.0), (11.0, 22.0)):
        pieces += box("log", (mast - 0.25, 4.0, -0.25), (mast + 0.25, height + 5.0, 0.25))
        for level, spread in ((0.35, 7.0), (0.62, 5.5), (0.85, 4.0)):
            y = 5.0 + level * height
            pieces += box("log", (mast + 0.3, y, -spread), (mast + 0.5, y + 0.2, spread))
            pieces += box("wool", (mast + 0.38, y - 0.20 * height, 0.9 - spread), (mast + 0.44, y, spread - 0.9))
        for side in (-1.0, 1.0):
            for reach in (-2.0, -1.0, 1.0, 2.0):
                pieces += line((mast + reach, 4.0, side * 4.2), (mast, 0.8 * height + 5.0, 0.0), 0.06)
    pieces += line((11.0, 25.0, 0.0), (25.0, 7.0, 0.0), 0.06) + line((19.0, 5.0, 0.0), (26.0, 8.0, 0.0), 0.3)
    return pieces


def line(start, stop, width: float) -> list[Surface]:
    """A rope: two crossed ribbons from start to stop."""
    start, stop = np.asarray(start), np.asarray(stop)
    along = (stop - start) / np.linalg.norm(stop - start)
    ribbons = []
    for axis in np.eye(3)[[0, 2] if abs(along[1]) > 0.8 else [1, 2]]:
        aside = np.cross(along, axis)
        aside *= width / 2 / np.linalg.norm(aside)
        ribbons.append(quad("iron", [start - aside, start + aside, stop + aside, stop - aside]))
    return ribbons


def hill(seed: int) -> list[Surface]:
    """A hill of cubes of 4 m, bare at its top."""
    rng = np.random.RandomState(seed)
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, 30), np.linspace(-1.0, 1.0, 30), indexing="ij")
    height = 15.0 * np.clip(1.0 - x**2 - z**2, 0.0, 1.0)
    for _ in range(6):
        k, phase = rng.uniform(-7.0, 7.0, 2), rng.uniform(0.0, 6.3)
        height *= 1.0 + 0.16 * np.sin(k[0] * x + k[1] * z + phase)
    a = air(30, 24, 30)
    level = np.minimum(np.round(height).astype(int), 23)
    y = np.arange(24)[None, :, None]
    a[y < level[:, None, :]] = INDEX["grass"]
    a[(y < level[:, None, :] - 1) | ((y >= 11) & (y < level[:, None, :]))] = INDEX["stone"]
    return cubes(a, 4.0)


# ---------------------------------------------------------------------------------------------------------------------
# The town


def terrace(column: int) -> float:
    """Height of the ground in a column of plots, numbered from the main street."""
    return float((0, 1, 3, 4, 7)[column])


def ground() -> list[Surface]:
    """The main street, the terraces to both sides with their walls, and the quay's wall."""
    south, pieces = 40.0, []
    edges = [STREET + 0.5, *(STREET + 0.5 + PLOT_X * (i + 1) for i in range(COLUMNS - 1)), 130.0]

    def flat(material, x0, x1, y):
        pieces.append(quad(material, [(x0, y, south), (x1, y, south), (x1, y, QUAY), (x0, y, QUAY)]))

    def quay(x0, x1, y):
        pieces.append(quad("stone", [(x1, SEA - 1.5, QUAY), (x0, SEA - 1.5, QUAY), (x0, y, QUAY), (x1, y, QUAY)]))

    flat("cobble", -edges[0], edges[0], 0.0)
    quay(-edges[0], edges[0], 0.0)
    for side in (-1, 1):
        below = 0.0
        for column, (near, far) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            y, x0, x1 = terrace(column), *sorted((side * near, side * far))
            flat("cobble" if column == 0 else "grass", x0, x1, y)
            quay(x0, x1, y)
            if y > below:
                x = side * near
                pieces.append(quad("stone", [(x, below, south), (x, below, QUAY), (x, y, QUAY), (x, y, south)]))
            below = y
    return pieces


def build() -> Gltf:
    """The whole town."""
    gltf = Gltf("make_city.py", MATERIALS, TEXTURES, quantum=1 / 128)
    houses = {
        "plaster house": house(8, 9, 2, "plaster", "log", "roof"),
        "tall house": house(8, 8, 3, "plaster", "dark_planks", "slate"),
        "brick house": house(9, 10, 2, "brick", "sandstone", "slate"),
        "wooden house": house(7, 9, 2, "planks", "log", "roof"),
        "stone house": house(9, 9, 3, "stone", "planks", "roof"),
        "sandstone house": house(10, 8, 2, "sandstone", "dark_planks", "roof"),
    }
    others = {
        "tower": tower(6, 30, "stone"),
        "brick tower": tower(5, 22, "brick"),
        "church": church(),
        "arch": arch(),
        "oak": tree(1, 6),
        "tall oak": tree(2, 8),
        "lamp": lamp(),
        "stall": stall(),
        "ship": ship(),
        "hill": hill(4),
        "other hill": hill(9),
    }
    meshes = {name: gltf.mesh(name, parts) for name, parts in (houses | others).items()}
    gltf.node("ground", mesh=gltf.mesh("ground", ground()))
    rng = np.random.RandomState(7)
    plots(gltf, meshes, list(houses), rng)
    street(gltf, meshes, rng)
    horizon(gltf, meshes, rng)
    return gltf


def plots(gltf: Gltf, meshes: dict[str, int], houses: list[str], rng: np.random.RandomState) -> None:
    """A house on most plots, trees or a tower on the others."""
    for side in (-1, 1):
        for column in range(COLUMNS):
            for row in range(ROWS):
                x = side * (STREET + 6.5 + PLOT_X * column + (0.5 if column else 0.0))
                at = np.array([x, terrace(column), -PLOT_Z * (row + 0.5)])
                kind = rng.random_sample()
                if column == 2 and row in (4, 5) and side > 0:
                    if row == 5:
                        gltf.node("church", None, meshes["church"], at + [0.0, 0.0, 6.0], turn=180.0)
                    continue
                if kind < 0.78 or column == 0:
                    name = houses[rng.randint(len(houses))]
                    turn = -90.0 * side + 180.0 * (column % 2) if kind < 0.5 else 0.0
                    gltf.node(name, None, meshes[name], at, turn=turn)
                elif kind < 0.86:
                    name = ("tower", "brick tower")[rng.randint(2)]
                    gltf.node(name, None, meshes[name], at)
                else:
                    for dx, dz in ((-3.5, -2.0), (2.5, -3.5), (1.0, 4.0)):
                        name = ("oak", "tall oak")[rng.randint(2)]
                        gltf.node(name, None, meshes[name], at + [dx, 0.0, dz], turn=90.0 * rng.randint(4))


def street(gltf: Gltf, meshes: dict[str, int], rng: np.random.RandomState) -> None:
    """The gate, lamps and stalls along the main street, trees behind the houses."""
    gltf.node("arch", None, meshes["arch"], (0.03, 0.0, -PLOT_Z * GATE - 0.3))
    for row in range(ROWS):
        for side in (-1, 1):
            z = -PLOT_Z * row - 0.4
            if row != GATE:
                gltf.node("lamp", None, meshes["lamp"], (side * 5.6, 0.0, z), turn=-90.0 * side)
            if rng.random_sample() < 0.4:
                gltf.node("stall", None, meshes["stall"], (side * 4.2, 0.0, z - 6.0), turn=-90.0 * side)
            for column in range(1, COLUMNS):
                if rng.random_sample() < 0.6:
                    x = side * (STREET + PLOT_X * column - 0.9 + 0.01 * row)
                    name = ("oak", "tall oak")[rng.randint(2)]
                    at = (x + side * 3.0, terrace(column), z)
                    gltf.node(name, None, meshes[name], at, turn=90.0 * rng.randint(4))


def horizon(gltf: Gltf, meshes: dict[str, int], rng: np.random.RandomState) -> None:
    """Ships in the harbour, and hills beyond it and around the town."""
    gltf.node("ship", None, meshes["ship"], (-6.0, SEA, QUAY - 42.0), turn=28.0)
    gltf.node("far ship", None, meshes["ship"], (70.0, SEA, QUAY - 150.0), turn=-35.0)
    for i, angle in enumerate(np.radians(np.linspace(-155.0, 155.0, 23))):
        name = ("hill", "other hill")[i % 2]
        distance, lift = (430.0 + 60.0 * (i % 3), -8.0) if abs(angle) < 0.9 else (230.0 + 30.0 * (i % 3), -3.0)
        at = (distance * np.sin(angle), lift, -60.0 - distance * np.cos(angle))
        gltf.node(name, None, meshes[name], at, turn=90.0 * rng.randint(4), scale=1.0 + 0.5 * rng.random_sample())


def camera() -> str:
    """A flight down the main street that climbs until the harbour is seen."""
    way = np.array(
        [
            (0.5, 3.2, 12.0),
            (1.2, 3.4, -8.0),
            (-1.0, 3.6, -28.0),
            (0.0, 3.4, -44.0),
            (1.5, 5.5, -62.0),
            (0.0, 11.0, -84.0),
        ]
    )
    goal = np.array(
        [
            (-2.0, 4.0, -20.0),
            (1.0, 3.0, -45.0),
            (0.0, 3.0, -65.0),
            (2.0, 6.0, -85.0),
            (-1.0, 6.5, -120.0),
            (-3.0, 6.0, -190.0),
        ]
    )
    times = np.linspace(0.0, FRAMES / FPS, 33)
    knots = np.linspace(0.0, FRAMES / FPS, len(way))
    path, looks = (CubicSpline(knots, points)(times) for points in (way, goal))
    return "\n[camera]\nfov_y = 60\n" + key_frames(times, position=path, look_at=looks)


def main() -> None:
    out = output_folder(__doc__, "city")
    write_textures(out / "textures", TEXTURES)
    build().write(out / "city.gltf")
    write_text(out / "scene.toml", SCENE + camera())


if __name__ == "__main__":
    main()
