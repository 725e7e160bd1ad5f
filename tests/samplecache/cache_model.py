"""Sample caches of random contents, the passes that reproject them, and what these should find, in NumPy."""

import zlib
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from helpers import cube, icosphere, make_scene, moved

from clcache.device import Device, fill
from clcache.passes.reproject import (
    COUNTERS,
    cache_buffers,
    listed_length,
    mask_words,
    pixel_diagonal,
    reproject_buffers,
    reproject_passes,
)
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import Camera, Scene

NONE = 0xFFFFFFFF
FIXED_ONE = 0xFFFFFF
VISIBLE = np.uint32(1 << 31)
STRETCHED = np.array([[0.5, 0.2, 0.0, -1.2], [0.0, -0.9, 0.0, 0.9], [0.1, 0.0, -0.6, 0.0]])
TURNED = np.array([[0.0, 0.0, 1.0, 2.0], [0.0, 1.0, 0.0, 0.3], [-1.0, 0.0, 0.0, -1.0]])


def objects() -> Scene:
    """Three meshes, two of them placed twice, one of these stretched and mirrored."""
    meshes = icosphere(2), cube(), moved(cube(), 0.3, (0.5, 2.0, -1.0))
    places = [(0, np.eye(4)[:3]), (0, STRETCHED), (1, TURNED), (2, np.eye(4)[:3])]
    return make_scene(*meshes, instances=places)


@dataclass(frozen=True)
class Content:
    """What a cache of `slots` slots holds. mask: (pixels,) uint64. first_hit, shading: (slots, pixels, 4) uint32; the radiance's
    words say whose they are."""

    slots: int
    mask: np.ndarray
    first_hit: np.ndarray
    shading: np.ndarray

    @property
    def occupied(self) -> np.ndarray:
        """(slots, pixels) bool."""
        return (self.mask >> np.arange(self.slots, dtype=np.uint64)[:, None] & np.uint64(1)).astype(bool)

    @property
    def visible(self) -> np.ndarray:
        """(slots, pixels) bool."""
        return (self.mask >> np.arange(self.slots, 2 * self.slots, dtype=np.uint64)[:, None] & np.uint64(1)).astype(
            bool
        )

    @property
    def words(self) -> np.ndarray:
        """The masks as a device holds them."""
        return split_mask(self.mask, self.slots)


def split_mask(mask: np.ndarray, slots: int) -> np.ndarray:
    """(pixels, words) uint32."""
    return (mask[:, None] >> np.arange(0, 32 * mask_words(slots), 32, dtype=np.uint64) & np.uint64(NONE)).astype(
        np.uint32
    )


def join_mask(words: np.ndarray) -> np.ndarray:
    """(pixels,) uint64."""
    return (words.astype(np.uint64) << np.arange(0, 32 * words.shape[1], 32, dtype=np.uint64)).sum(
        axis=1, dtype=np.uint64
    )


def identity_words(sample: np.ndarray) -> np.ndarray:
    """(..., 4) uint32: radiance that says of which sample it is; the last word is a count."""
    sample = sample.astype(np.uint32)
    return np.stack([sample, ~sample, sample * np.uint32(2654435761), sample & np.uint32(0xFFFF)], axis=-1)


def random_content(
    scene: Scene, pixels: int, slots: int, part: float = 0.4, seen: float = 0.7, background: float = 0.1, seed: int = 1
) -> Content:
    """A cache in which so large a part of the slots hold samples: random points of random triangles, or of the background."""
    rng = np.random.default_rng(seed)
    shape = slots, pixels
    occupied = rng.random(shape) < part
    visible = occupied & (rng.random(shape) < seen)
    weights = np.uint64(1) << np.arange(slots, dtype=np.uint64)[:, None]
    mask = (occupied * weights).sum(axis=0, dtype=np.uint64)
    mask |= (visible * weights).sum(axis=0, dtype=np.uint64) << np.uint64(slots)
    instance = rng.integers(len(scene.instances), size=shape)
    triangles = np.array([len(scene.meshes[i.mesh].triangles) for i in scene.instances])
    u, v = np.sort(rng.random((2, *shape)), axis=0)
    fixed = (np.stack([u, v - u]) * FIXED_ONE).astype(np.uint32)
    is_far = rng.random(shape) < background
    words = [*fixed, rng.integers(triangles[instance]), instance]
    words[2], words[3] = np.where(is_far, NONE, words[2]), np.where(is_far, NONE, words[3])
    words[0] = words[0] | rng.integers(256, size=shape, dtype=np.uint32) << np.uint32(24)
    shading = identity_words(np.arange(slots * pixels).reshape(shape))
    shading[..., 3] |= rng.integers(65536, size=shape).astype(np.uint32) << np.uint32(16)
    return Content(slots, mask, np.stack(words, axis=-1).astype(np.uint32), shading)


class Reprojection:
    """The passes of one variant with arrays of their own. superresolution: as of `reproject_passes`."""

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneResources,
        size: tuple[int, int],
        slots: int,
        variant: str = "deterministic",
        has_radiance: bool = True,
        superresolution: int | None = None,
    ):
        self.scene = scene if isinstance(scene, SceneResources) else SceneResources(device, scene)
        self.device, self.size, self.slots, self.superresolution = device, size, slots, superresolution
        pixels = size[0] * size[1]
        options = slots, variant
        buffers = cache_buffers(pixels, slots, has_radiance)
        buffers += reproject_buffers(pixels, *options, superresolution=superresolution)
        self.arrays = {b.name: device.empty(b.shape, b.dtype, b.name) for b in buffers}
        for array in self.arrays.values():
            fill(array, 0xA5)  # no pass counts on what is there
        self.list, self.project, *self.choose = reproject_passes(
            device, self.scene, size, *options, has_radiance=has_radiance, superresolution=superresolution
        )

    def run_passes(self, passes, state) -> None:
        """Run them and wait."""
        for p in passes:
            for _ in p.run(self.arrays, state):
                pass
        self.device.queue.finish()

    def put(self, content: Content) -> None:
        """Let this be the cache of the last frame."""
        self.arrays["mask_before"].set(content.words)
        self.arrays["first_hit_before"].set(content.first_hit)
        if "shading_before" in self.arrays:
            self.arrays["shading_before"].set(content.shading)

    def find(self, camera: Camera | np.void) -> dict[str, np.ndarray]:
        """List and project; what is known of each listed sample then."""
        record = camera_record(camera, self.size) if isinstance(camera, Camera) else camera
        self.run_passes([self.list, self.project], SimpleNamespace(camera=record))
        names = ("samples", "target", "distance", "slope", *(("cell",) if self.superresolution else ()))
        length = listed_length(self.arrays)
        return {name: self.arrays[name].get()[:length] for name in names}

    def fill_slots(self, found: dict[str, np.ndarray] | None = None) -> Content:
        """Give the listed samples slots, as `found` says where it is given: the cache that results. Radiance is zero where the
        cache has none."""
        for name, values in (found or {}).items():
            array = self.arrays[name]
            array.set(np.concatenate([values, np.zeros(array.size - len(values), values.dtype)]))
        self.run_passes(self.choose, None)
        first_hit = self.arrays["first_hit"].get()
        shading = self.arrays["shading"].get() if "shading" in self.arrays else np.zeros_like(first_hit)
        return Content(self.slots, join_mask(self.arrays["mask"].get()), first_hit, shading)

    def counters(self) -> dict[str, int]:
        """By name."""
        return dict(zip(COUNTERS, map(int, self.arrays["counters"].get()), strict=True))

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """nearest and farthest."""
        return self.arrays["nearest"].get(), self.arrays["farthest"].get()

    def release(self) -> None:
        """Give back the arrays."""
        self.device.release(*self.arrays.values())


@dataclass(frozen=True)
class Projected:
    """Of samples: x, y in pixels, distance (infinite for the background), slope, whether in front of the near plane."""

    x: np.ndarray
    y: np.ndarray
    distance: np.ndarray
    slope: np.ndarray
    in_front: np.ndarray


def project(scene: Scene, camera: Camera, size: tuple[int, int], hits: np.ndarray, to_world=None) -> Projected:
    """Where first hits (m, 4) appear, in float64. to_world: (i, 3, 4), where the instances are, if not as at rest."""
    to_world = np.array([i.transform for i in scene.instances]) if to_world is None else to_world
    to_world = to_world.astype(np.float32).astype(float)
    is_far = hits[:, 3] == NONE
    u, v = (hits[:, :2] & FIXED_ONE).T / FIXED_ONE
    towards, normal = np.zeros((2, len(hits), 3))
    towards[is_far] = from_octahedral(u[is_far], v[is_far])
    normal[is_far] = towards[is_far]
    for number, instance in enumerate(scene.instances):
        own = ~is_far & (hits[:, 3] == number)
        mesh = scene.meshes[instance.mesh]
        corners = mesh.positions.astype(float)[mesh.triangles[hits[own, 2]]]
        a, b, c = (corners @ to_world[number, :, :3].T + to_world[number, :, 3]).transpose(1, 0, 2)
        towards[own] = a + u[own, None] * (b - a) + v[own, None] * (c - a) - camera.transform[:, 3]
        normal[own] = np.cross(b - a, c - a)
    view = towards @ camera.transform[:, :3]
    slope = np.tan(camera.fov_y / 2)
    aspect = size[0] / size[1]
    with np.errstate(all="ignore"):
        x = (0.5 + 0.5 * view[:, 0] / (-view[:, 2] * slope * aspect)) * size[0]
        y = (0.5 - 0.5 * view[:, 1] / (-view[:, 2] * slope)) * size[1]
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.abs((towards * normal).sum(axis=1)) / (distance * np.linalg.norm(normal, axis=1))
        theta = np.arccos(np.minimum(cosine, 1))
        phi = np.arctan2(*(pixel_diagonal(camera_record(camera, size))[name] for name in ("phi_sine", "phi_cosine")))
        difference = distance * np.abs(1 - np.cos(theta) / np.cos(theta - phi))
    in_front = -view[:, 2] > np.where(is_far, 0, camera.near)
    return Projected(x, y, np.where(is_far, np.inf, distance), np.where(is_far, 0, difference), in_front)


def from_octahedral(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(m, 3) unit vectors."""
    x, y = 2 * u - 1, 2 * v - 1
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    direction = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


@dataclass(frozen=True)
class Chosen:
    """Who gets which slot. sample, entry: (slots, pixels), the number in the cache of the last frame, the place in the list; NONE
    where there is none. lost: how many did not get one; stolen: how many of these count as such."""

    sample: np.ndarray
    entry: np.ndarray
    lost: int
    stolen: int


def choose(found: dict[str, np.ndarray], slots: int, pixels: int) -> Chosen:
    """The deterministic variant's choice: by visibility, then by number."""
    sample, entry = np.full((2, slots, pixels), NONE, np.uint32)
    number, seen, lost, stolen = found["samples"] & ~VISIBLE, found["samples"] >= VISIBLE, 0, 0
    for pixel in np.unique(found["target"][found["target"] != NONE]):
        arrivals = np.flatnonzero(found["target"] == pixel)
        arrivals = arrivals[np.lexsort([number[arrivals], ~seen[arrivals]])]
        places = [arrivals] if "cell" not in found else [arrivals[found["cell"][arrivals] == c] for c in range(slots)]
        room = slots if "cell" not in found else 1
        for first, here in enumerate(places):
            kept = here[:room]
            sample[first : first + len(kept), pixel] = number[kept]
            entry[first : first + len(kept), pixel] = kept
            hidden = int((~seen[here]).sum())
            lost += len(here) - len(kept)
            if len(here) > room:
                stolen += min(hidden, room) - max(room - (len(here) - hidden), 0)
    return Chosen(sample, entry, lost, stolen)


def is_consistent(after: Content, before: Content) -> np.ndarray:
    """(samples,) bool, for each occupied slot: first hit, radiance and visibility are those of one sample, one frame older."""
    words, hits = after.shading[after.occupied], after.first_hit[after.occupied]
    sample = np.minimum(words[:, 0], before.occupied.size - 1)
    aged = before.shading.reshape(-1, 4)[sample].copy()
    aged[:, 3] += np.where(aged[:, 3] < 0xFFFF0000, np.uint32(0x10000), np.uint32(0))
    same = (words == aged).all(axis=1) & (hits == before.first_hit.reshape(-1, 4)[sample]).all(axis=1)
    return same & (after.visible[after.occupied] == before.visible.ravel()[sample])


# PoCL hands a thread so many entries of a list at a time: those this far apart are reached by two threads at the same time.
CHUNK = 4096


def contended(threads: int, variant: str, runs: int) -> dict[str, object]:
    """Reproject a cache, samples that threads reach at the same time going to the same pixels, until twice as many have come as
    there is room for; and where they belong. How many are left of the crowds, how many inconsistent, of all runs together; of
    the deterministic variant the checksums of what the runs leave, once where they leave the same."""
    camera, device = Camera(np.column_stack([np.eye(3), [0.0, 0.5, 4.0]]), 1.0), Device(threads=threads)
    size, slots, scene = (320, 180), 12, objects()
    before = random_content(scene, size[0] * size[1], slots, part=0.8, seen=0.5)
    passes = Reprojection(device, scene, size, slots, variant)
    passes.put(before)
    samples, inconsistent, crowded, usual = 0, 0, set(), set()
    for _ in range(runs):
        found = passes.find(camera)
        usual.add(checksum(passes, passes.fill_slots()))
        order = np.argsort(found["samples"] & ~VISIBLE)
        entry = np.arange(order.size)
        found = {name: values[order] for name, values in found.items()}
        found["target"] = (entry // (2 * slots * CHUNK) * CHUNK + entry % CHUNK).astype(np.uint32)
        after = passes.fill_slots(found)
        good = is_consistent(after, before)
        samples, inconsistent = samples + len(good), inconsistent + int((~good).sum())
        crowded.add(checksum(passes, after))
    sums = (crowded, usual) if variant == "deterministic" else None
    return {"inconsistent": inconsistent, "sums": sums, "samples": samples // runs}


def checksum(passes: Reprojection, after: Content) -> int:
    """Of all that a reprojection leaves."""
    kept = after.mask, after.first_hit[after.occupied], after.shading[after.occupied], *passes.extent()
    return zlib.crc32(b"".join(values.tobytes() for values in kept))
