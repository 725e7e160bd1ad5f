"""Radiance in voxels of the world, kept in a hash table (SampleCache, section 4, where it is HashCache; `cl/voxelhash/`).

Samples ask: `asked` lists them, one of a pixel at most, and `asked_stream` says which pixel. Each finds its voxel, or makes it;
of those that ask the same one, one is traced and updates it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..program import Kernel, Program
from ..resources import SceneResources
from .materials import ASKED_VALUES, DESCRIBED_VALUES, FIRST_VALUES, NEW_VALUES, SEEN_VALUES, values_as
from .radiance import Choose
from .reconstruct import seen
from .reproject import GROUP, listed_length
from .retrace import batch, draws
from .trace import HITS, stamp

COUNTERS = ("lookups", "hits", "inserted", "evicted", "discarded", "occupied", "capacity", "shaded")
TABLE = ("voxel_key", "voxel_radiance", "voxel_occupied")
TILE = 16  # entries of a block, as in cl/voxelhash/table.cl
RUN = 64  # entries of a list that one work-item goes through, as in cl/samplecache/groups.cl
_RESOLVED = ("sample_value", "sample_weight", "sample_albedo")
_ASKED = {"shaded": "asked", "stream": "asked_stream", "listed": "asked_listed"}


def table_buffers(capacity: int) -> list[Buffer]:
    """The table, which both eyes share, and how many of its entries are in use: 24 bytes for each of so many entries.

    `voxel_key`: check hash << 32 | stamp of the last access, 0 where there never was an entry. `voxel_radiance`: the mean of
    linear RGB radiance without albedo, and of how many values.
    """
    return [
        Buffer("voxel_key", (capacity,), "u8", persistent=True),
        Buffer("voxel_radiance", (capacity, 4), persistent=True),
        Buffer("voxel_occupied", (1,), "u4", persistent=True),
    ]


def voxel_buffers(pixels: int, capacity: int, rays: int) -> list[Buffer]:
    """What the passes work with."""
    lists = ("asked", "asked_stream", "voxel_place", "voxel_check", "voxel", "shaded", "stream", "shaded_voxel")
    return [
        *(Buffer(name, (pixels,), "u4") for name in lists),
        Buffer("asked_listed", (4,), "u4"),
        Buffer("voxel_claim", (capacity,), "u4"),
        Buffer("voxel_start", (pixels, 4)),
        Buffer("own_light", (pixels, 4), "u4", persistent=True, per_eye=True),
        Buffer("path_stream", (rays,), "u4"),
        Buffer("seen_place", (2, rays), "u4"),
        Buffer("seen_check", (2, rays), "u4"),
        Buffer("answer_count", (rays,)),
    ]


def voxel_aov_buffers(pixels: int) -> list[Buffer]:
    """The AOVs of the voxels that pixels ask."""
    numbers = (Buffer(f"aov_{name}", (pixels,)) for name in ("level", "count", "age"))
    return [Buffer("aov_voxel", (pixels, 3)), *numbers]


@dataclass(frozen=True)
class Voxels:
    """What the passes have in common. settings: all, by dotted name. counts: the places in `counters`, for kernels."""

    device: Device
    scene: SceneResources
    settings: Mapping[str, bool | int | float | str]
    is_hybrid: bool
    counts: Mapping[str, int]

    def program(self, source: str) -> Program:
        """One of the sources in cl/voxelhash/."""
        asks = {
            "JITTER": self.settings["voxelhash.jitter"] and not self.is_hybrid,
            "COIN": self.is_hybrid,
            "GATE": self.settings["voxelhash.gate"],
            "LOD_BY_INCIDENCE": self.settings["voxelhash.lod"] == "incidence",
        }
        inherits = {"INHERIT": self.inherits}
        return self.device.program(f"voxelhash/{source}.cl", **asks, **inherits, **self.counts, **self.scene.defines)

    @property
    def inherits(self) -> bool:
        """Whether new voxels start from those of another level. With Hybrid the parent has its say anyway."""
        return self.settings["voxelhash.inherit"] and not self.is_hybrid

    def level(self, capacity: int) -> dict[str, float | int]:
        """The scalars by which a point's voxel is found."""
        return {"factor": 2.0 ** self.settings["voxelhash.level_bias"], "blocks": max(capacity // TILE, 1)}

    def table(self, state) -> dict[str, int]:
        """The scalars by which the table is searched. Both eyes' stamps of an update follow each other."""
        lifetime = 2 * self.settings["voxelhash.lifetime"]
        return {"probe": self.settings["voxelhash.probe"], "stamp": stamp(state), "lifetime": lifetime}


def voxel_counts(names: Sequence[str] = COUNTERS) -> dict[str, int]:
    """The places in `counters`, for kernels. names: of the method's counters; where samples are counted, too, `voxels` is how
    many of the table's entries are occupied."""
    occupied = "voxels" if "voxels" in names else "occupied"
    counted = ("lookups", "hits", "inserted", "evicted", "discarded", "capacity", "shaded")
    return {f"COUNT_{name.upper()}": names.index(name) for name in counted} | {"COUNT_VOXELS": names.index(occupied)}


class KeepFirstHits(Pass):
    """The first hits of this frame's rays, and counters that begin anew."""

    name = "first_hits"
    reads = ("pixel", "ray_direction", *HITS)
    writes = ("mask", "first_hit", "counters")

    def __init__(self, voxels: Voxels):
        self._scene = voxels.scene
        self._kernel = voxels.program("first_hits")["keep_first_hits"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each pixel."""
        yield fill(arrays["counters"], 0)
        n, rays = arrays["pixel"].size, arrays["hit_t"].size
        yield self._kernel.run(n, arrays, self._scene.arrays, n=n, rays=rays)


class KeepSurface(Pass):
    """The first hits as what filters follow."""

    name = "surface"
    reads = ("first_hit",)
    writes = ("surface",)

    def __init__(self, voxels: Voxels):
        self._kernel = voxels.program("first_hits")["keep_surface"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each pixel."""
        pixels = arrays["surface"].shape[0]
        yield self._kernel.run(pixels, arrays, pixels=pixels)


class AskAll(Pass):
    """Every pixel's first hit asks."""

    name = "ask"
    reads = ("pixel", "first_hit")
    writes = tuple(_ASKED.values())

    def __init__(self, voxels: Voxels):
        self._kernel = voxels.program("first_hits")["ask_all"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield fill(arrays["asked_listed"], 0)
        n = arrays["pixel"].size
        groups = -(-n // GROUP)
        yield self._kernel.run(groups, arrays, n=n, groups=groups)


class AskSamples(Choose):
    """One sample of each pixel asks, by turns."""

    name = "ask"

    def __init__(self, device: Device, defines: Mapping[str, int | bool]):
        super().__init__(device, defines, "uniform", 1.0)
        self.writes = (*_ASKED.values(), "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        lists = {name: arrays[buffer] for name, buffer in _ASKED.items()}
        yield from super().run({**arrays, **lists}, state)


class _VoxelPass(Pass):
    """A kernel over the list of what asks, or of what is traced."""

    def __init__(self, voxels: Voxels, source: str, kernel: str):
        self._voxels, self._kernel = voxels, voxels.program(source)[kernel]
        self._values: tuple[str, ...] = ()

    def _reads_values(self, buffer: str) -> None:
        """Take what graphs returned from this buffer, where the scene has any."""
        self._values = (buffer,) if self._voxels.scene.graphs else ()
        self.reads += self._values

    def _over_asked(self, arrays, state, run: int = 1, kernel: Kernel | None = None) -> cl.Event | None:
        entries = listed_length({"listed": arrays["asked_listed"]}, 1)
        return self._launch(arrays, state, -(-entries // run), kernel, entries=entries)

    def _launch(self, arrays, state, count: int, kernel: Kernel | None = None, **scalars) -> cl.Event | None:
        voxels = self._voxels
        capacity = arrays["voxel_key"].size
        known = {"capacity": capacity, **voxels.level(capacity), **voxels.table(state), "camera": state.camera}
        known |= {"n": arrays["ray_length"].size}
        arrays = values_as(arrays, *self._values)
        return (kernel or self._kernel).run(count, arrays, voxels.scene.arrays, **(known | draws(state) | scalars))


class AddressAsked(_VoxelPass):
    """Where the voxels of what asks are to be found."""

    name = "address"
    reads = ("asked", "asked_stream", "asked_listed", "first_hit")
    writes = ("voxel_place", "voxel_check")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "look_up", "address_asked")
        self._reads_values(ASKED_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each entry."""
        yield self._over_asked(arrays, state)


class LookUp(_VoxelPass):
    """Find the voxels, make those that are not there, and claim them. Before it nothing is claimed: at first it sees to that, later
    `ListClaimed` has."""

    name = "look_up"
    reads = ("asked_stream", "asked_listed", "voxel_place", "voxel_check", *TABLE, "counters")
    writes = ("voxel", *TABLE, "voxel_claim", "counters")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "look_up", "look_up")
        self._tally = voxels.program("look_up")["tally"]
        self._has_claims = False

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run."""
        if not self._has_claims:
            yield fill(arrays["voxel_claim"], 0)
            self._has_claims = True
        yield self._over_asked(arrays, state, RUN)
        yield self._tally.run(1, arrays, capacity=arrays["voxel_key"].size)


class ListClaimed(_VoxelPass):
    """List what is traced; then nothing is claimed any more."""

    name = "claim"
    reads = ("asked", "asked_stream", "asked_listed", "voxel", "voxel_claim", "counters")
    writes = ("shaded", "stream", "shaded_voxel", "listed", "voxel_claim", "counters")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "look_up", "list_claimed")
        self._release = voxels.program("look_up")["release"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run; then entry by entry."""
        yield fill(arrays["listed"], 0)
        yield self._over_asked(arrays, state, RUN)
        yield self._over_asked(arrays, state, kernel=self._release)


class Inherit(_VoxelPass):
    """From what voxels without values start."""

    name = "inherit"
    reads = ("shaded", "stream", "shaded_voxel", "listed", "first_hit", "voxel_key", "voxel_radiance")
    writes = ("voxel_start",)

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "look_up", "inherit")
        self._reads_values(NEW_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run."""
        entries = listed_length(arrays, 1)
        yield self._launch(arrays, state, -(-entries // RUN), entries=entries)


class UpdateVoxels(_VoxelPass):
    """Add what the paths brought to their voxels."""

    name = "update"

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "answer", "update_voxels")
        start = ("voxel_start",) if voxels.inherits else ()
        self.reads = ("shaded", "stream", "shaded_voxel", "listed", "first_hit", "radiance", *start, "voxel_radiance")
        self.writes = ("voxel_radiance", "own_light")
        self._reads_values(FIRST_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One voxel for each path."""
        part, fixed = batch(arrays, state, 1), self._voxels.settings["voxelhash.alpha"]
        yield self._launch(arrays, state, part["entries"], n=arrays["ray_length"].size, fixed_part=fixed, **part)


class _AnswerPass(_VoxelPass):
    """A kernel over the list of visible samples."""

    def _over_seen(self, arrays, state, run: int = 1) -> cl.Event | None:
        lists = seen(arrays)
        part, n = batch(lists, state, 0), arrays["ray_length"].size
        pixels = arrays["first_hit"].shape[1]
        scalars = {"n": n, "pixels": pixels, "environment": self._voxels.scene.environment, **part}
        return self._launch(lists, state, -(-part["entries"] // run), **scalars)


class AnswerAsked(_AnswerPass):
    """What is known of each visible sample by the voxel that it asked."""

    name = "answer"
    reads = ("seen", "seen_listed", "first_hit", "voxel", "voxel_radiance", "own_light")
    writes = (*_RESOLVED, "answer_count")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "answer", "answer_asked")
        self._reads_values(SEEN_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_seen(arrays, state)


class AddressSeen(_AnswerPass):
    """Where voxel and parent of each visible sample are to be found."""

    name = "address_seen"
    reads = ("seen", "seen_listed", "first_hit")
    writes = ("seen_place", "seen_check", *_RESOLVED)

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "answer", "address_seen")
        self._reads_values(SEEN_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_seen(arrays, state)


class FindSeen(_AnswerPass):
    """Find them."""

    name = "find_seen"
    reads = ("seen_listed", "seen_place", "seen_check", "voxel_key")
    writes = ("seen_place",)

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "answer", "find_seen")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run."""
        yield self._over_seen(arrays, state, RUN)


class AnswerSeen(_AnswerPass):
    """What is known of each visible sample by its voxel and that one's parent."""

    name = "answer"
    reads = ("seen", "seen_listed", "seen_place", "voxel_radiance", "own_light", *_RESOLVED)
    writes = (*_RESOLVED, "answer_count")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "answer", "answer_seen")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_seen(arrays, state)


class FindAge(_VoxelPass):
    """How long ago voxels were accessed."""

    name = "aovs"
    reads = ("asked_stream", "asked_listed", "voxel_place", "voxel_check", "voxel_key")
    writes = ("aov_age",)

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "describe", "find_age")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Before any is accessed in this frame."""
        yield fill(arrays["aov_age"], float("inf"))
        yield self._over_asked(arrays, state, RUN)


class DescribeVoxels(_VoxelPass):
    """The voxel that each pixel asked."""

    name = "aovs"
    reads = ("asked", "asked_stream", "asked_listed", "first_hit", "voxel", "voxel_radiance")
    writes = ("aov_voxel", "aov_level", "aov_count")

    def __init__(self, voxels: Voxels):
        super().__init__(voxels, "describe", "describe_voxels")
        self._reads_values(DESCRIBED_VALUES)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each entry; elsewhere there is none."""
        for name, nothing in (("aov_voxel", 0), ("aov_level", float("inf")), ("aov_count", 0)):
            yield fill(arrays[name], nothing)
        yield self._over_asked(arrays, state)
