"""A valley with a lake: `python tools/make_landscape.py` writes data/landscape.

Open terrain under sun and sky, with few materials: the ground's, which covers most of the picture and is the expensive one
(colour, bumps and roughness from textures), bark, two kinds of leaves cut out by alpha masks, rock and water. The ground is a
grid whose lines are close together around the camera and far apart elsewhere; trees, tufts and rocks are instances. The camera
strolls along the shore.
"""

import numpy as np
from painting import SIZE, Texture, bumps, mix, noise, smoothstep, write_textures
from scene_files import Gltf, Material, key_frames, output_folder, write_text
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates
from shapes import Surface, clean, profile, revolved, sheet

FRAMES, FPS = 64, 30
HALF = 700.0  # metres from the middle to the edge of the ground
CELLS = 120  # along a side of the ground


def ground_height(rng: np.random.RandomState) -> np.ndarray:
    """The small relief of the ground: clods, and flat stones in it, in metres."""
    stones = smoothstep(0.9, 1.3, noise(rng, 1.1, 6))
    return 0.05 * noise(rng, 1.6, 2) + 0.06 * stones + 0.006 * noise(rng, 0.5, 30)


def ground(rng: np.random.RandomState) -> np.ndarray:
    """Short grass, bare earth and stones, 8 m wide."""
    stones = smoothstep(0.9, 1.3, noise(rng, 1.1, 6))  # drawn first, as in `ground_height`
    bare = smoothstep(0.2, 1.2, noise(rng, 1.3, 2))
    blades = noise(rng, 0.25, 40)
    color = mix(
        mix((0.34, 0.42, 0.17), (0.46, 0.47, 0.22), smoothstep(-1.0, 1.5, noise(rng, 0.9, 3))),
        (0.47, 0.37, 0.25),
        0.85 * bare,
    )
    color = color * (1.0 + 0.16 * blades)[..., None]
    return mix(color, (0.56, 0.54, 0.50), stones) + (0.02 * noise(rng, 0.6, 10))[..., None]


def seeded(paint, seed: int):
    """The painter with a random state of its own, so that several textures show the same pattern."""
    return lambda _: paint(np.random.RandomState(seed))


def ground_surface(rng: np.random.RandomState) -> np.ndarray:
    """Green: roughness, lower on the stones. Blue: metallic, none."""
    stones = smoothstep(0.9, 1.3, noise(rng, 1.1, 6))
    return np.stack([0 * stones + 1.0, 0.95 - 0.45 * stones, 0 * stones], axis=-1)


def bark(rng: np.random.RandomState) -> np.ndarray:
    """Furrowed bark; furrows run along v."""
    furrow = smoothstep(-0.3, 1.2, noise(rng, 0.9, 4, (8.0, 1.0)))
    return mix((0.42, 0.34, 0.26), (0.20, 0.15, 0.11), furrow) + (0.03 * noise(rng, 0.4, 30))[..., None]


def rock(rng: np.random.RandomState) -> np.ndarray:
    """Grey rock with lichen."""
    color = mix((0.55, 0.53, 0.50), (0.38, 0.37, 0.36), smoothstep(-1.0, 1.5, noise(rng, 1.0, 3)))
    return mix(color, (0.58, 0.58, 0.38), 0.7 * smoothstep(1.2, 1.8, noise(rng, 1.0, 6)))


def twig(color, paler, length: float, width: float, count: int):
    """A painter of a twig with leaves on both sides, on nothing."""

    def paint(rng: np.random.RandomState) -> np.ndarray:
        t = (np.arange(SIZE) + 0.5) / SIZE
        u, v = np.meshgrid(t, t)
        mask, tone = np.abs(u - 0.5) < 0.008, np.zeros((SIZE, SIZE))
        mask &= v > 0.12
        for i in range(count):
            side = 1 if i % 2 else -1
            foot = 0.98 - 0.86 * (i + 1) / count
            angle = np.radians(rng.uniform(28.0, 68.0)) * side if i < count - 1 else 0.0
            along = (u - 0.5) * np.sin(angle) - (v - foot - 0.02) * np.cos(angle)
            across = (u - 0.5) * np.cos(angle) + (v - foot - 0.02) * np.sin(angle)
            size = length * rng.uniform(0.8, 1.1)
            shape = width * size * np.sin(np.pi * np.clip(along / size, 0.0, 1.0)) ** 0.8
            inside = (np.abs(across) < shape) & (along > 0.0) & (along < size)
            tone = np.where(inside, rng.uniform(0.0, 0.8) + 0.25 * (np.abs(across) < 0.006), tone)
            mask |= inside
        return np.concatenate([mix(color, paler, tone), mask[..., None].astype(float)], axis=-1)

    return paint


TEXTURES = {
    "ground": Texture(seeded(ground, 100), 8.0, 512),
    "ground_bumps": Texture(seeded(lambda rng: bumps(ground_height(rng), 8.0), 100), 8.0, 256),
    "ground_surface": Texture(seeded(ground_surface, 100), 8.0, 256),
    "bark": Texture(bark, 1.0, 128),
    "rock": Texture(rock, 2.0, 256),
    "leaves": Texture(twig((0.24, 0.36, 0.10), (0.46, 0.56, 0.20), 0.34, 0.30, 11), 1.0, 128, "png"),
    "needles": Texture(twig((0.10, 0.22, 0.12), (0.22, 0.36, 0.18), 0.42, 0.09, 30), 1.0, 128, "png"),
}
GROUND = {
    "ground": Material(texture="ground", surface="ground_surface", normals="ground_bumps"),
}
PLANTS = {
    "bark": Material(texture="bark", specular=0.0),
    "leaves": Material(texture="leaves", cutoff=0.5, specular=0.0),
    "needles": Material(texture="needles", cutoff=0.5, specular=0.0),
    "rock": Material(texture="rock", roughness=0.8),
}

SCENE = f"""\
# A valley with a lake. Written by tools/make_landscape.py, as are the files beside it.

[environment.sky]
turbidity = 3.2
elevation = 36
azimuth = 105
scale = 0.045

[materials.water]
base_color = [0.015, 0.035, 0.04]
roughness = 0.09
ior = 1.33

[meshes.water]
generator = "plane"
size = [{2 * HALF - 20.0}, {2 * HALF - 20.0}]

[meshes.terrain]
file = "terrain.gltf"

[meshes.plants]
file = "plants.gltf"

[[instances]]
mesh = "water"
material = "water"

[[instances]]
mesh = "terrain"

[[instances]]
mesh = "plants"

[render]
size = [640, 360]
frames = [0, {FRAMES}]
fps = {FPS}
spp = 16
stereo = true
eye_distance = 0.063
"""


# ---------------------------------------------------------------------------------------------------------------------
# The lie of the land; the lake's level is 0


def relief() -> np.ndarray:
    """Periodic relief of unit deviation, (SIZE, SIZE), over the whole ground."""
    rng = np.random.RandomState(23)
    return 0.93 * noise(rng, 2.2, 1) + 0.07 * noise(rng, 1.5, 10)


RELIEF = relief()


def height(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Height of the ground in metres at places in metres."""
    place = np.stack(np.broadcast_arrays(z, x)) * (SIZE / (2 * HALF))
    bumpy = map_coordinates(RELIEF, place, order=3, mode="grid-wrap")
    edge = np.hypot(x, z) / HALF
    lake = np.exp(-(((x - 30.0) / 95.0) ** 2) - ((z + 120.0) / 80.0) ** 2)
    near = smoothstep(10.0, 160.0, np.hypot(x, z))
    land = 3.0 + (3.0 + 19.0 * near) * (bumpy - RELIEF[0, 0]) + 14.0 * near
    return land - 34.0 * lake + 120.0 * smoothstep(0.35, 1.05, edge) * (1.0 + 0.45 * bumpy)


def spread(count: int) -> np.ndarray:
    """(count,) coordinates from -HALF to HALF, close together around 0."""
    t = np.linspace(-1.0, 1.0, count)
    return HALF * (0.13 * t + 0.87 * np.sign(t) * np.abs(t) ** 2.4)


def terrain() -> list[Surface]:
    x, z = np.meshgrid(spread(CELLS + 1), spread(CELLS + 1)[::-1])
    points = np.stack([x, height(x, z), z], axis=-1)
    return [sheet("ground", points, np.stack([x, z], axis=-1))]


# ---------------------------------------------------------------------------------------------------------------------
# What grows and lies on it; y = 0 is the ground


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def cards(material: str, foot: np.ndarray, along: np.ndarray, size: np.ndarray, rng: np.random.RandomState) -> Surface:
    """Square pictures (n) that grow from `foot` (n, 3) along unit vectors (n, 3), turned about them at random."""
    aside = unit(np.cross(along, unit(rng.standard_normal(along.shape))))
    face = np.cross(aside, along)
    up, half = along * size[:, None], 0.5 * aside * size[:, None]
    points = np.stack([foot - half, foot + half, foot + half + up, foot - half + up], axis=1)
    outwards = np.where((face * (foot - foot.mean(axis=0))).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    first = 4 * np.arange(len(foot))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    uvs = np.tile([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], (len(foot), 1))
    return clean(Surface(material, points.reshape(-1, 3), np.repeat(face * outwards, 4, axis=0), uvs, triangles))


def limb(start, stop, radius: float, end_radius: float) -> Surface:
    """A tapering piece of wood from start to stop."""
    start, stop = np.asarray(start, dtype=float), np.asarray(stop, dtype=float)
    length = np.linalg.norm(stop - start)
    y = (stop - start) / length
    x = unit(np.cross(y, [0.31, 0.11, 0.94]))
    turn = np.stack([x, y, np.cross(x, y)], axis=1)
    return revolved("bark", profile((radius, -0.1), (end_radius, length)), 7).moved(start, turn)


def broadleaf(seed: int, tall: float) -> list[Surface]:
    """A tree with a round crown."""
    rng = np.random.RandomState(seed)
    top = np.array([0.2, 0.62 * tall, 0.1])
    pieces, ends = [limb((0.0, -0.3, 0.0), top, 0.045 * tall, 0.022 * tall)], [top]
    for i in range(8):
        around = 2.4 * i + rng.uniform(-0.3, 0.3)
        start = top * rng.uniform(0.55, 0.95)
        stop = start + tall * np.array([0.24 * np.cos(around), rng.uniform(0.12, 0.26), 0.24 * np.sin(around)])
        pieces.append(limb(start, stop, 0.014 * tall, 0.004 * tall))
        ends.append(stop)
    ends = np.array(ends)[rng.randint(0, len(ends), 330)]
    foot = ends + tall * rng.normal(0.0, 0.085, ends.shape)
    along = unit(unit(foot - [0.0, 0.62 * tall, 0.0]) + 0.7 * rng.standard_normal(foot.shape))
    return [*pieces, cards("leaves", foot, along, rng.uniform(0.09, 0.14, len(foot)) * tall, rng)]


def conifer(seed: int, tall: float) -> list[Surface]:
    """A tree like a cone, in whorls."""
    rng = np.random.RandomState(seed)
    level = np.sqrt(rng.random_sample(300))  # 0 at the tip
    around, part = rng.uniform(0.0, 2 * np.pi, 300), rng.uniform(0.05, 0.85, 300)
    level = np.round(level * 11) / 11
    reach = 0.21 * tall * level * part
    out = np.stack([np.cos(around), 0 * around, np.sin(around)], axis=-1)
    foot = out * reach[:, None] + np.stack([0 * reach, tall * (0.97 - 0.83 * level) - 0.35 * reach, 0 * reach], axis=-1)
    along = unit(out + [0.0, -0.3, 0.0] + 0.25 * rng.standard_normal(out.shape))
    tip = cards(
        "needles", np.array([[0.0, 0.9 * tall, 0.0]] * 2), np.array([[0.0, 1.0, 0.0]] * 2), np.full(2, 0.12 * tall), rng
    )
    size = (0.06 + 0.10 * level) * tall
    return [
        limb((0.0, -0.3, 0.0), (0.0, 0.95 * tall, 0.0), 0.028 * tall, 0.005),
        cards("needles", foot, along, size, rng),
        tip,
    ]


def tuft(seed: int) -> list[Surface]:
    """High grass: narrow blades, bent."""
    rng = np.random.RandomState(seed)
    return [cards("leaves", np.c_[rng.normal(0.0, 0.16, 14), np.full(14, -0.06), rng.normal(0.0, 0.16, 14)], unit(np.array([0.0, 1.0, 0.0]) + 0.35 * rng.standard_normal((14, 3))), rng.uniform(0.28, 0.5, 14), rng)]  # fmt: skip


def boulder(seed: int) -> list[Surface]:
    """A lump of rock, 1 m across, its foot below the ground."""
    rng = np.random.RandomState(seed)
    v, u = np.meshgrid(np.linspace(0.0, np.pi, 13), np.linspace(0.0, 2 * np.pi, 21), indexing="ij")
    way = np.stack([np.sin(v) * np.cos(u), np.cos(v), -np.sin(v) * np.sin(u)], axis=-1)
    radius = np.full(u.shape, 0.5)
    for _ in range(14):
        axis = unit(rng.standard_normal(3))
        radius = np.minimum(radius, rng.uniform(0.36, 0.46) / np.maximum(way @ axis, 0.2))
    points = way * radius[..., None] * [1.0, 0.75, 0.9] + [0.0, 0.12, 0.0]
    lengths = np.stack([3.0 * u / (2 * np.pi), 1.5 * v / np.pi], axis=-1)
    return [sheet("rock", points[:, ::-1], lengths[:, ::-1])]


def plants() -> Gltf:
    """Trees, tufts and boulders, each a few times by mesh and many times by instance."""
    gltf = Gltf("make_landscape.py", PLANTS, {n: TEXTURES[n] for n in TEXTURES if not n.startswith("ground")}, 1 / 500)
    meshes = {
        "broadleaf": gltf.mesh("broadleaf", broadleaf(1, 7.5)),
        "other broadleaf": gltf.mesh("other broadleaf", broadleaf(2, 6.0)),
        "conifer": gltf.mesh("conifer", conifer(3, 11.0)),
        "tuft": gltf.mesh("tuft", tuft(4)),
        "boulder": gltf.mesh("boulder", boulder(5)),
    }
    rng = np.random.RandomState(77)
    stand(gltf, meshes["broadleaf"], "broadleaf", rng, 70, (14.0, 260.0), 0.5, (0.8, 1.3))
    stand(gltf, meshes["other broadleaf"], "other broadleaf", rng, 70, (12.0, 230.0), 0.5, (0.7, 1.25))
    stand(gltf, meshes["conifer"], "conifer", rng, 190, (30.0, 420.0), 0.75, (0.7, 1.3))
    stand(gltf, meshes["tuft"], "tuft", rng, 170, (2.0, 34.0), 0.6, (0.6, 1.4))
    stand(gltf, meshes["boulder"], "boulder", rng, 60, (3.0, 90.0), 0.8, (0.3, 2.4))
    return gltf


def stand(gltf: Gltf, mesh: int, name: str, rng, count: int, ring, steepest: float, scales) -> None:
    """Instances at random places between two distances from the middle, on dry ground that is not too steep."""
    distance = ring[0] + (ring[1] - ring[0]) * rng.random_sample(12 * count) ** 0.8
    around = rng.uniform(0.0, 2 * np.pi, len(distance))
    x, z = np.round(distance * np.cos(around), 2), np.round(distance * np.sin(around), 2)
    slope = np.hypot(height(x + 1, z) - height(x - 1, z), height(x, z + 1) - height(x, z - 1)) / 2
    off_the_way = np.abs(x - way_x(z)) > 1.8
    dry = np.nonzero((height(x, z) > 0.5) & (slope < steepest) & off_the_way)[0][:count]
    for i in dry:
        at = (x[i], drawn_height(x[i], z[i]), z[i])
        gltf.node(name, None, mesh, at, turn=round(rng.uniform(0.0, 360.0), 2), scale=rng.uniform(*scales))


def drawn_height(x: float, z: float) -> float:
    """Height of the ground's triangles, which smooth over what lies between the grid's lines."""
    lines = spread(CELLS + 1)
    i, k = np.searchsorted(lines, x) - 1, np.searchsorted(lines, z) - 1
    a, b = (x - lines[i]) / (lines[i + 1] - lines[i]), (lines[k + 1] - z) / (lines[k + 1] - lines[k])
    near, right, far, left = height(lines[[i, i + 1, i + 1, i]], lines[[k + 1, k + 1, k, k]])
    rise = a * (right - near) + b * (far - right) if a > b else b * (left - near) + a * (far - left)
    return round(float(near + rise), 3)


def way_x(z):
    """The path that the camera takes, x over z."""
    return 2.2 * np.sin(0.11 * np.asarray(z)) - 3.0


def camera() -> str:
    """A stroll of 16 m towards the lake at the height of the eyes, the view turning along the shore."""
    count = 17
    z = np.linspace(27.0, 11.0, count)
    x = way_x(z)
    y = CubicSpline(z[::-1], [drawn_height(*p) for p in zip(x[::-1], z[::-1], strict=True)])(z) + 1.68
    turn = np.radians(np.linspace(-6.0, 20.0, count))
    looks = np.stack([x + 40.0 * np.sin(turn), y - 4.5, z - 40.0 * np.cos(turn)], axis=-1)
    return "\n[camera]\nfov_y = 58\n" + key_frames(
        np.linspace(0.0, FRAMES / FPS, count), position=np.stack([x, y, z], axis=-1), look_at=looks
    )


def main() -> None:
    out = output_folder(__doc__, "landscape")
    write_textures(out / "textures", TEXTURES)
    land = Gltf(
        "make_landscape.py", GROUND, {name: TEXTURES[name] for name in TEXTURES if name.startswith("ground")}, 1 / 32
    )
    land.node("terrain", mesh=land.mesh("terrain", terrain()))
    land.write(out / "terrain.gltf")
    plants().write(out / "plants.gltf")
    write_text(out / "scene.toml", SCENE + camera())


if __name__ == "__main__":
    main()
