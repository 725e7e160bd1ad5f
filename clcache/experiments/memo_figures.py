"""The tables and figures of chapter 6 of MaterialMemo (Urbach 2023), on scenes whose materials are all replaced by graphs.

Frames are those of the scene's own motion, at one sample for each pixel. What is compared renders in turn, frame by frame, in one
process, beside no memoization. Capacities are entries: texels, or tiles. All graphs are memoized (`memo.auto` is off) but where the name
says auto. A star: only where paths go on, and not what the camera sees itself.

The rate of hits is that of a frame's lookups, and of frames the median. How scarce a capacity is depends on the keys that a frame looks up,
which grow with its pixels and samples: the thesis's capacities are many times as large as what is as scarce here.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ..settings import SETTINGS
from .configuration import Configuration
from .experiment import Calls, Claim, Column, Experiment, Plot, Sequences, Table

CLASSROOM, LANDSCAPE, NOISE = "classroom (memory)", "landscape (memory)", "classroom (compute)"  # as rows are labelled
TEXELS = 1 << 21  # for which all caches have room, where nothing else is said
NONE = Configuration("none", "pathtrace")


def choices(setting: str) -> tuple[str, ...]:
    """The values of a setting."""
    return SETTINGS[setting].choices


def texel(name: str, **settings: object) -> Configuration:
    """A cache of texels, and some of its settings."""
    return cached(name, "texel", settings)


def tile(name: str, **settings: object) -> Configuration:
    """A cache of tiles, and some of its settings."""
    return cached(name, "tile", settings)


MAKERS = {"texel": texel, "tile": tile}


def cached(name: str, kind: str, settings: Mapping[str, object]) -> Configuration:
    """A cache of all graphs, with room for TEXELS and the thesis's eviction, unless the settings say more."""
    width, height = map(int, str(settings.get("tile", "4x4")).split("x"))
    capacity = TEXELS // (width * height if kind == "tile" else 1)
    given = {"auto": False, "capacity": capacity, "eviction": "lru-counter", **settings}
    return Configuration(name, "pathtrace", {f"memo.{key}": value for key, value in given.items()}, memo=kind)


def secondary(configuration: Configuration) -> Configuration:
    """The same, but only where paths go on."""
    settings = {**configuration.settings, "memo.primary": False}
    return replace(configuration, name=f"{configuration.name}*", settings=settings)


# ---------------------------------------------------------------------------------------------------------------------
# How it is shown

HIT_RATE = Column("memo.hit_rate", "hit rate, %", ".3f", 100.0)
TIMES = (
    Column("seconds", "frame, ms", ".1f", 1e3),
    Column("seconds", "speed-up", ".2f", over="none", inverse=True),
    Column("pass.materials", "materials, ms", ".1f", 1e3),
    HIT_RATE,
)
COUNTED = tuple(
    Column(f"memo.{counter}", head, ".0f")
    for counter, head in (
        ("built", "built in a frame"),
        ("duplicates", "of them twice"),
        ("evicted", "evicted"),
        ("discarded", "discarded"),
        ("occupied", "occupied"),
    )
)
TABLE = Table("Times and hit rates", (*TIMES, *COUNTED))
BARS = (
    Plot("Frame times", "configuration", "seconds", "bars", y_head="seconds for a frame"),
    Plot("Hit rates", "configuration", "memo.hit_rate", "bars", y_head="hits of lookups"),
)
DIFFERS = (
    "The scenes are the project's own, and their graphs generated: 75 of them in the classroom, 3 in the landscape. Frames are smaller, and have"
    " one path for each pixel, on a CPU's cores; the thesis has 1920x1080 pixels of 6 paths in its classroom and 18 in its landscape, on"
    " an NVIDIA RTX 4070 Ti, where also neighbours with other graphs hold a path up."
)


def printed(scene: str, rows: Mapping[str, tuple[float, float | None]]) -> Iterator[dict]:
    """What the thesis prints of a scene. rows: by configuration, milliseconds, and hits in percent of lookups."""
    for configuration, (milliseconds, percent) in rows.items():
        row = {"scene": scene, "configuration": configuration, "seconds": 1e-3 * milliseconds}
        yield row if percent is None else row | {"memo.hit_rate": 0.01 * percent}


def faster(paper: Sequence[Mapping], scene: str, name: str, than: str, says: str, more: bool = False) -> Claim:
    """That one takes less time than the other, or more. paper: rows, as `printed`."""
    seconds = {row["configuration"]: row["seconds"] for row in paper if row["scene"] == scene}
    known = seconds[name] / seconds[than] if name in seconds and than in seconds else None
    bound = {"low": 1.0} if more else {"high": 1.0}
    return Claim(says, "seconds", name, than, paper=known, scenes=(scene,), **bound)


def hits_more(paper: Sequence[Mapping], scene: str, name: str, than: str, says: str) -> Claim:
    """That more of one's lookups hit than of the other's. paper: rows, as `printed`."""
    rates = {row["configuration"]: row.get("memo.hit_rate") for row in paper if row["scene"] == scene}
    known = rates[name] / rates[than] if name in rates else None
    return Claim(says, "memo.hit_rate", name, than, low=1.0, paper=known, scenes=(scene,))


# ---------------------------------------------------------------------------------------------------------------------
# Image quality

QUALITY = (
    texel("texel"),
    texel("texel, unsnapped", snap=False),
    tile("tile, nearest"),
    tile("tile, bilinear", filter="bilinear"),
    texel("texel, bias 1", bias=1.0),
    tile("tile, bilinear, bias 1", filter="bilinear", bias=1.0),
)
STARRED = tuple(secondary(c) for c in QUALITY[:4])


def converged(size: tuple[int, int], spp: int, configurations: Sequence[Configuration]) -> Mapping[str, object]:
    """What a comparison of images is told."""
    entries = [c.entry() | {"spp": spp} for c in (NONE, *configurations)]
    return {"size": list(size), "frame": 32, "configurations": entries}


def quality_claims(scene: str) -> Iterator[Claim]:
    """What section 6.1 says of FLIP."""
    said = (
        ("Snapped, the nearest texel scores better than unsnapped", "texel, unsnapped", "texel", 1.0, None),
        ("Snapped, the nearest texel scores better than bilinear tiles", "tile, bilinear", "tile, nearest", 1.0, None),
        ("Bilinear tiles score slightly better than unsnapped texels", "tile, bilinear", "texel, unsnapped", None, 1.0),
        *(
            (f"Errors come almost all from what the camera sees itself: {c.name}", f"{c.name}*", c.name, None, 0.5)
            for c in QUALITY[:4]
        ),
    )
    for says, of, over, low, high in said:
        yield Claim(says, "flip", of, over, low, high, scenes=(scene,))


FIGURE_2 = Experiment(
    "memo-fig6.2",
    "MaterialMemo, section 6.1, Fig. 6.2, 6.3 and 6.6",
    "What memoization does to images",
    "FLIP and relative error of one frame with memoization, against the same frame without it from the same random numbers. The last row is the"
    " frame without memoization from other random numbers: what noise alone amounts to.",
    (
        Calls(
            "memo_quality",
            (converged((480, 270), 32, (*QUALITY, *STARRED)),),
            ("classroom", "landscape"),
            quick=(converged((96, 54), 4, (*QUALITY, *STARRED)),),
            is_seeded=True,
            graphs="memory",
        ),
    ),
    (
        Table(
            "Difference to the frame without memoization",
            (Column("flip", "FLIP", ".4f"), Column("relmse", "relMSE", ".2e")),
        ),
    ),
    (Plot("FLIP", "configuration", "flip", "bars", y_head="FLIP"),),
    (*quality_claims(CLASSROOM), *quality_claims(LANDSCAPE)),
    DIFFERS
    + " The thesis compares images of 10000 paths for each pixel; here it is a few dozen, by the same random numbers, which leave more"
    " noise in all rows. Its FLIP values stand in pictures alone; the text says their order, which is what is judged.",
)

# ---------------------------------------------------------------------------------------------------------------------
# Overall performance, and the two kinds of graphs

KINDS = (NONE, texel("texel"), tile("tile, nearest"), tile("tile, bilinear", filter="bilinear"))
OVERALL = (*KINDS, *(secondary(c) for c in KINDS[1:]), Configuration("tile, auto", "pathtrace", memo="tile"))
OVERALL_PLAN = Sequences(
    ("classroom", "landscape"),
    OVERALL,
    (640, 360),
    (0, 12),
    skip=4,
    pictures=(11,),
    graphs="memory",
    quick={"size": (96, 54), "frames": (0, 5), "skip": 2, "pictures": (4,)},
)
TABLE_1_PRINTED = (
    *printed(
        CLASSROOM,
        {
            "none": (136.9, None),
            "texel": (23.1, 99.915),
            "tile, nearest": (20.0, 99.978),
            "tile, bilinear": (26.5, 99.961),
            "texel*": (21.4, 99.994),
            "tile, nearest*": (20.3, 99.999),
            "tile, bilinear*": (25.1, 99.998),
        },
    ),
    *printed(
        LANDSCAPE,
        {
            "none": (41.6, None),
            "texel": (29.0, 99.897),
            "tile, nearest": (28.3, 99.981),
            "tile, bilinear": (33.3, 99.971),
            "texel*": (32.5, 99.955),
            "tile, nearest*": (33.8, 99.995),
            "tile, bilinear*": (35.4, 99.992),
        },
    ),
)


def overall_claims(scene: str) -> Iterator[Claim]:
    """What section 6.2 says of times and hit rates."""
    printed_rows = TABLE_1_PRINTED
    for name in (c.name for c in OVERALL[1:-1]):
        how = "Memoizing only where paths go on" if name.endswith("*") else "Memoization"
        yield faster(printed_rows, scene, name, "none", f"{how} takes less time than none: {name}")
    yield faster(printed_rows, scene, "tile, nearest", "texel", "Nearest tiles take less time than texels")
    yield faster(printed_rows, scene, "tile, bilinear", "texel", "Bilinear tiles take more time than texels", more=True)
    rates = {row["configuration"]: row.get("memo.hit_rate") for row in printed_rows if row["scene"] == scene}
    for name in ("tile, nearest", "tile, bilinear"):
        says = f"More than 99.9 % of lookups hit: {name}"
        yield Claim(says, "memo.hit_rate", name, low=0.999, paper=rates[name], scenes=(scene,))


TABLE_1 = Experiment(
    "memo-table6.1",
    "MaterialMemo, section 6.2, Table 6.1, Fig. 6.7 and 6.8",
    "Memoization beside none",
    "Frame times and hit rates of caches of texels and of tiles, which are large enough for all that is seen. A star: only where paths go on."
    " Auto: what `--memo tile` does by itself, which memoizes only graphs that get faster by it.",
    (OVERALL_PLAN,),
    (TABLE,),
    BARS,
    (*overall_claims(CLASSROOM), *overall_claims(LANDSCAPE)),
    DIFFERS + " The frames are the first dozen of a motion, so that more of what is seen is new.",
    TABLE_1_PRINTED,
)
FIGURE_10 = Experiment(
    "memo-fig6.10",
    "MaterialMemo, section 6.3, Fig. 6.10",
    "Graphs that sample pictures, and graphs of noise",
    "The same scene with graphs of both kinds, which take about as long without memoization.",
    tuple(replace(OVERALL_PLAN, scenes=("classroom",), graphs=kind) for kind in ("memory", "compute")),
    (TABLE,),
    BARS,
    tuple(
        Claim(says.format(scene), "seconds", of, over, high=1.0, scenes=(scene,))
        for scene in (CLASSROOM, NOISE)
        for says, of, over in (
            ("Texels take less time than no memoization: {}", "texel", "none"),
            ("Tiles take less time than texels: {}", "tile, nearest", "texel"),
        )
    ),
    DIFFERS + " The thesis draws the times and does not print them.",
)

# ---------------------------------------------------------------------------------------------------------------------
# Storage, eviction, capacity, probing, tiles


QUICK = {"size": (96, 54), "frames": (0, 5), "skip": 2}
QUICK_SHARE = {
    "texel": 0.18,
    "tile": 0.3,
}  # of the keys of real size, so that of capacities as well where they are to be scarce


def group(
    configurations: Sequence[Configuration],
    scenes: Sequence[str] = ("classroom",),
    quick: Sequence[Configuration] | None = None,
    **own: object,
) -> Sequences:
    """A group that renders in turn, beside no memoization. quick: its configurations at small size, if they are not the same."""
    told = {"size": (320, 180), "frames": (0, 20), "skip": 6, "graphs": "memory", **own}
    small = QUICK | {"configurations": (NONE, *(quick or configurations))}
    return Sequences(tuple(scenes), (NONE, *configurations), quick=small, **told)


def scarce(configuration: Configuration) -> Configuration:
    """The same, with the capacity that is as scarce at small size."""
    capacity = int(QUICK_SHARE[configuration.memo] * configuration.settings["memo.capacity"])
    return replace(configuration, settings={**configuration.settings, "memo.capacity": capacity})


def storage(bits: int, kind: str = "nearest") -> Sequences:
    """All layouts of a cache of so many tiles."""
    return group(
        [
            tile(f"{layout} 2^{bits} {kind}", layout=layout, capacity=1 << bits, filter=kind)
            for layout in choices("memo.layout")
        ]
    )


def storage_claims(bits: int) -> Iterator[Claim]:
    """What section 6.4 says of nearest tiles in images."""
    for layout in ("image2d", "image3d"):
        says = f"Nearest tiles in a buffer take less time than in {layout}, of 2^{bits}"
        yield Claim(says, "seconds", f"buffer 2^{bits} nearest", f"{layout} 2^{bits} nearest", high=1.0)


FIGURE_11 = Experiment(
    "memo-fig6.11",
    "MaterialMemo, section 6.4, Fig. 6.11",
    "Where tiles are stored, by capacity",
    "Frame times of tiles behind their keys, in a buffer of their own, and in images of two and three dimensions.",
    tuple(storage(bits) for bits in (14, 16, 18)),
    (TABLE,),
    BARS[:1],
    tuple(claim for bits in (14, 16, 18) for claim in storage_claims(bits)),
    DIFFERS + " The thesis's caches have 2^19 to 2^21 tiles, and it draws the times and does not print them.",
)
FIGURE_12 = Experiment(
    "memo-fig6.12",
    "MaterialMemo, section 6.4, Fig. 6.12",
    "Where tiles are stored, by filter",
    "Frame times of the same, by nearest texels and between four of them.",
    (storage(16), storage(16, "bilinear")),
    (TABLE,),
    BARS[:1],
    tuple(
        Claim(
            f"Bilinear, {layout} takes about as long as a buffer",
            "seconds",
            f"{layout} 2^16 bilinear",
            "buffer 2^16 bilinear",
            0.9,
            1.1,
        )
        for layout in ("entry", "image2d", "image3d")
    ),
    DIFFERS + " The thesis's cache has 2^19 tiles, and it draws the times and does not print them.",
)

# Entries by the kind of cache: the large ones hold what two frames look up, or rather less of tiles, and the small ones about what one does;
# all of them less than the whole motion.
LARGE, SMALL = {"texel": 98304, "tile": 12288}, {"texel": 65536, "tile": 8192}
SIZES = {"large": LARGE, "small": SMALL}


def evicting(kind: str, how_large: str) -> Sequences:
    """All strategies, in a cache of a kind and size: the large ones in the landscape as well, which the camera sees more of."""
    strategies = [
        MAKERS[kind](f"{kind}, {how_large}, {how}", eviction=how, capacity=SIZES[how_large][kind])
        for how in choices("memo.eviction")
    ]
    scenes = ("classroom", "landscape") if how_large == "large" else ("classroom",)
    plan = group(strategies, scenes, quick=[scarce(c) for c in strategies], frames=(0, 24), skip=8)
    return replace(plan, quick=plan.quick | {"scenes": scenes[:1]})


def eviction_printed() -> Iterator[dict]:
    """Table 6.2."""
    columns = {
        ("texel", "large"): ((41.0, 79.449), (26.3, 99.733), (25.0, 99.820), (22.9, 99.892), (25.7, 99.861), (24.0, 99.894)),
        ("tile", "large"): ((35.0, 79.486), (20.5, 99.824), (20.6, 99.841), (19.9, 99.877), (21.0, 99.894), (20.4, 99.918)),
        ("texel", "small"): ((57.3, 73.834), (29.6, 92.447), (50.5, 86.808), (28.5, 92.229), (30.6, 90.851), (29.3, 90.729)),
        ("tile", "small"): ((49.2, 74.311), (23.8, 96.313), (125.4, 77.864), (125.6, 77.922), (25.2, 96.205), (25.1, 96.205)),
    }  # fmt: skip
    order = ("none", "random", "lrw-frame", "lru-frame", "lrw-counter", "lru-counter")
    yield from printed(CLASSROOM, {"none": (136.9, None)})
    for (kind, how_large), values in columns.items():
        yield from printed(CLASSROOM, {f"{kind}, {how_large}, {how}": v for how, v in zip(order, values, strict=True)})


def eviction_claims() -> Iterator[Claim]:
    """What section 6.5 says."""
    rows = tuple(eviction_printed())
    for scene in (CLASSROOM, LANDSCAPE):
        for kind in MAKERS:
            for how in ("random", "lru-counter"):
                pair = (f"{kind}, large, {how}", f"{kind}, large, none")
                yield hits_more(rows, scene, *pair, f"Of a large cache, {how} hits more than no eviction: {kind}")
                says = f"Of a large cache, {how} takes less time than no eviction: {kind}"
                yield faster(rows, scene, *pair, says)
    for kind in MAKERS:
        pair = (f"{kind}, large, lru-counter", f"{kind}, large, lru-frame")
        says = f"Of a large cache, a counter hits slightly more than the frame's number: {kind}"
        yield hits_more(rows, CLASSROOM, *pair, says)
    for by in ("lrw", "lru"):
        says = f"Of a small cache of tiles, the frame's number takes much longer than a counter: {by}"
        yield faster(rows, CLASSROOM, f"tile, small, {by}-frame", f"tile, small, {by}-counter", says, more=True)


def eviction(name: str, source: str, plots: Sequence[Plot]) -> Experiment:
    """The strategies, as a table or as a figure."""
    return Experiment(
        name,
        source,
        "Strategies of eviction",
        "What makes room where all places are taken: nothing; chance; what was written or used longest ago, by the number of the frame or by a counter"
        " of all accesses. The large caches hold more than a frame's keys, the small ones hardly as many.",
        tuple(evicting(kind, how_large) for how_large in SIZES for kind in MAKERS),
        (TABLE,),
        tuple(plots),
        tuple(eviction_claims()),
        DIFFERS
        + f" The large caches are {LARGE['texel']} texels and {LARGE['tile']} tiles, the small ones {SMALL['texel']} and {SMALL['tile']}: at"
        " 320x180 pixels, 1.9, 1.3, 1.3 and 0.9 times what a frame of the classroom looks up; the thesis's hold 6.5, 4.8, 1.6 and 1.2 times that."
        " The motion is 24 frames, so that a cache without eviction has not yet lost as much; the large caches are measured in the landscape as well.",
        tuple(eviction_printed()),
    )


TABLE_2 = eviction("memo-table6.2", "MaterialMemo, section 6.5, Table 6.2", ())
FIGURE_13 = eviction("memo-fig6.13", "MaterialMemo, section 6.5, Fig. 6.13", BARS)
HISTORY = tuple(
    MAKERS[kind](f"{kind}, {how}", eviction=how, capacity=entries)
    for kind, entries in LARGE.items()
    for how in ("lru-counter", "none")
)
FIGURE_14 = Experiment(
    "memo-fig6.14",
    "MaterialMemo, section 6.5, Fig. 6.14",
    "Hit rates over time",
    "The hit rate and the time of each frame, with eviction and without.",
    (
        Sequences(
            ("landscape",),
            HISTORY,
            (320, 180),
            (0, 64),
            skip=2,
            graphs="memory",
            quick={"size": (96, 54), "frames": (0, 16), "configurations": tuple(scarce(c) for c in HISTORY)},
        ),
    ),
    (Table("All frames", (*TIMES[:1], *TIMES[2:], *COUNTED)),),
    (
        Plot("Hit rates", "frame", "memo.hit_rate", x_head="frame", y_head="hits of lookups"),
        Plot("Frame times", "frame", "seconds", x_head="frame", y_head="seconds for a frame"),
    ),
    tuple(
        Claim(says, measure, f"{kind}, none", f"{kind}, lru-counter", **bound)
        for kind in MAKERS
        for says, measure, bound in (
            (f"Without eviction fewer lookups hit: {kind}", "memo.hit_rate", {"high": 1.0}),
            (f"Without eviction frames take more time: {kind}", "seconds", {"low": 1.0}),
        )
    ),
    DIFFERS + " The thesis draws several hundred frames, smoothed, and does not print them.",
)

CAPACITY_TEXELS = tuple(texel(f"texel 2^{bits}", capacity=1 << bits) for bits in range(10, 23))
CAPACITY_TILES = tuple(tile(f"tile 2^{bits}", capacity=1 << bits) for bits in range(10, 19))
CAPACITY_PLANS = tuple(
    group(of, ("classroom", "landscape"), (*of[:8:2], of[-1]), frames=(0, 12), skip=4, labels={"cache": kind})
    for kind, of in (("texels", CAPACITY_TEXELS), ("tiles", CAPACITY_TILES))
)


def capacity_printed() -> Iterator[dict]:
    """Table 6.3, of the capacities that are measured here. Columns: milliseconds and percent, from 2^10 on."""
    columns = {
        ("texel", CLASSROOM): (
            (212.1, 48.70), (159.0, 58.80), (96.1, 66.66), (60.7, 73.03), (42.4, 81.68), (32.7, 88.10), (29.6, 89.88),
            (28.4, 90.21), (27.8, 90.36), (28.3, 90.44), (28.5, 90.49), (28.8, 90.73), (26.9, 97.50),
        ),
        ("texel", LANDSCAPE): (
            (48.1, 12.53), (44.7, 15.56), (44.1, 17.12), (44.5, 20.57), (43.9, 36.28), (41.3, 62.91), (37.4, 84.25),
            (34.7, 89.52), (34.4, 89.90), (34.9, 89.94), (35.4, 89.96), (35.5, 90.71), (33.4, 97.58),
        ),
        ("tile", CLASSROOM): (
            (286.1, 57.28), (184.4, 66.76), (108.6, 76.76), (51.0, 91.39), (27.2, 95.78), (25.1, 96.20), (24.4, 96.30),
            (24.1, 96.34), (23.4, 96.98),
        ),
        ("tile", LANDSCAPE): (
            (69.3, 30.61), (59.0, 48.17), (42.8, 80.47), (31.4, 95.39), (30.7, 96.26), (30.5, 96.31), (30.7, 96.32),
            (30.6, 96.38), (28.8, 98.41),
        ),
    }  # fmt: skip
    for scene, milliseconds in ((CLASSROOM, 136.9), (LANDSCAPE, 42.0)):
        yield from printed(scene, {"none": (milliseconds, None)})
    for (kind, scene), values in columns.items():
        for bits, value in enumerate(values, 10):
            (row,) = printed(scene, {f"{kind} 2^{bits}": value})
            yield row | {"cache": f"{kind}s", "memo.capacity": 1 << bits}


def capacity_claims() -> Iterator[Claim]:
    """What section 6.6.1 says."""
    rows = tuple(capacity_printed())
    for scene in (CLASSROOM, LANDSCAPE):
        for small, large in (("texel 2^10", "texel 2^22"), ("tile 2^10", "tile 2^18")):
            yield faster(rows, scene, large, small, f"A large cache takes less time than a small one: {large}, {small}")
    says = "A cache of 2^12 entries takes less time than none in the classroom: {}"
    for name in ("texel 2^12", "tile 2^12"):
        yield faster(rows, CLASSROOM, name, "none", says.format(name))
    says = "In the landscape a larger one is needed, at 2^10 it takes more time than none: {}"
    for name in ("texel 2^10", "tile 2^10"):
        yield faster(rows, LANDSCAPE, name, "none", says.format(name), more=True)


def capacities(name: str, source: str, plots: Sequence[Plot]) -> Experiment:
    """The capacities, as a table or as a figure."""
    return Experiment(
        name,
        source,
        "Capacity",
        "Frame times and hit rates by the number of entries, from far too few to more than are ever looked up.",
        CAPACITY_PLANS,
        (TABLE,),
        tuple(plots),
        tuple(capacity_claims()),
        DIFFERS
        + " As frames have fewer keys here, all happens at smaller capacities; those beyond 2^22 texels and 2^18 tiles, which the thesis has as well,"
        " hold no more.",
        tuple(capacity_printed()),
    )


TABLE_3 = capacities("memo-table6.3", "MaterialMemo, section 6.6.1, Table 6.3", ())
FIGURE_15 = capacities(
    "memo-fig6.15",
    "MaterialMemo, section 6.6.1, Fig. 6.15",
    (
        Plot(
            "Frame times",
            "memo.capacity",
            "seconds",
            by="cache",
            log="xy",
            x_head="entries",
            y_head="seconds for a frame",
        ),
        Plot(
            "Hit rates",
            "memo.capacity",
            "memo.hit_rate",
            by="cache",
            log="x",
            x_head="entries",
            y_head="hits of lookups",
        ),
    ),
)


def probing(kind: str) -> Sequences:
    """A large cache of a kind, by how far entries may lie from their places."""
    distances = [MAKERS[kind](f"{kind}, {probe}", probe=probe, capacity=LARGE[kind]) for probe in (1, 2, 4, 8, 16)]
    return group(distances, quick=[scarce(c) for c in distances])


FIGURE_16 = Experiment(
    "memo-fig6.16",
    "MaterialMemo, section 6.6.2, Fig. 6.16",
    "Places that are looked at",
    "Frame times by how far from its place an entry may lie, in the large caches of memo-table6.2.",
    tuple(probing(kind) for kind in MAKERS),
    (TABLE,),
    BARS,
    tuple(
        Claim(
            f"No probing takes more time than {probe} places: {kind}",
            "seconds",
            f"{kind}, 1",
            f"{kind}, {probe}",
            low=1.0,
        )
        for kind in MAKERS
        for probe in (2, 4, 8, 16)
    ),
    DIFFERS + " The thesis draws the times and does not print them.",
)
FIGURE_17 = Experiment(
    "memo-fig6.17",
    "MaterialMemo, section 6.6.3, Fig. 6.17",
    "Sizes of tiles",
    "Frame times by the size of tiles, at the same number of texels in all. Bilinear tiles share a row and a column of texels.",
    tuple(
        group([tile(f"{shape} {kind}", tile=shape, filter=kind) for shape in choices("memo.tile")])
        for kind in choices("memo.filter")
    ),
    (TABLE,),
    BARS,
    tuple(
        Claim(
            f"Tiles of 8x4 take less time than those of 2x2: {kind}", "seconds", f"8x4 {kind}", f"2x2 {kind}", high=1.0
        )
        for kind in choices("memo.filter")
    ),
    DIFFERS + " The thesis draws the times and does not print them.",
)

# ---------------------------------------------------------------------------------------------------------------------
# Modifications of the tiled cache

PASSES_PLAN = group([tile(f"passes {how}", passes=how) for how in choices("memo.passes")])
BUILDERS_PLAN = group(
    [
        tile("serial", builder="serial"),
        tile("lanes", builder="lanes"),
        tile("lanes, grouped", builder="lanes", grouped=True),
    ]
)
DUPLICATES = Column("memo.duplicate_rate", "built twice, %", ".3f", 100.0)
THREADS = (
    " Tiles are built twice where threads look for the same one at once: a driver with one thread has none of these."
)
FIGURE_18 = Experiment(
    "memo-fig6.18",
    "MaterialMemo, section 6.7.2, Fig. 6.18",
    "Tiles that are built twice",
    "The share of tiles built in a frame that were built in it before, because paths that run at once miss the same tile: with frames in one,"
    " two and four passes, and after the paths of one pixel in each 2x2, 4x4 and 8x8.",
    (PASSES_PLAN,),
    (Table("Duplicates", (DUPLICATES, *COUNTED)),),
    (Plot("Duplicates", "configuration", "memo.duplicate_rate", "bars", y_head="of the tiles built"),),
    tuple(
        Claim(
            f"Frames in {n} passes build fewer tiles twice",
            "memo.duplicate_rate",
            f"passes {n}",
            "passes 1",
            high=1.0,
            paper=known,
        )
        for n, known in ((2, 0.0148 / 0.134), (4, 0.0023 / 0.134))
    ),
    DIFFERS + THREADS,
    tuple(
        {"scene": CLASSROOM, "configuration": f"passes {n}", "memo.duplicate_rate": rate}
        for n, rate in ((1, 0.134), (2, 0.0148), (4, 0.0023))
    ),
)
PASSES_PRINTED = tuple(
    printed(
        CLASSROOM,
        {
            "passes 1": (20.2, None),
            "passes 2": (20.5, None),
            "passes 4": (20.7, None),
            "passes prepass2": (24.5, None),
            "passes prepass4": (23.9, None),
            "passes prepass8": (23.6, None),
        },
    )
)
FIGURE_19 = Experiment(
    "memo-fig6.19",
    "MaterialMemo, section 6.7.2, Fig. 6.19",
    "Frames in several passes",
    "Frame times where hits are looked up in turns, of which later ones find what earlier ones stored, or after the paths of a few pixels.",
    (PASSES_PLAN,),
    (TABLE,),
    BARS[:1],
    tuple(
        faster(PASSES_PRINTED, CLASSROOM, name, "passes 1", f"It takes no less time: {name}", more=True)
        for name in (row["configuration"] for row in PASSES_PRINTED[1:])
    ),
    DIFFERS + THREADS,
    PASSES_PRINTED,
)
GROUPING_PRINTED = tuple(printed(CLASSROOM, {"lanes": (20.1, None), "lanes, grouped": (20.3, None)}))
GROUPING = Experiment(
    "memo-section6.7.1",
    "MaterialMemo, section 6.7.1",
    "Who builds tiles",
    "Frame times where one lane builds a tile, where the lanes of a sub-group do so together, and where these take tiles of the same graph first.",
    (BUILDERS_PLAN,),
    (TABLE,),
    BARS[:1],
    (
        faster(
            GROUPING_PRINTED,
            CLASSROOM,
            "lanes, grouped",
            "lanes",
            "Grouping tiles by graph takes no less time",
            more=True,
        ),
    ),
    DIFFERS + " The thesis has no builder of one lane.",
    GROUPING_PRINTED,
)

EXPERIMENTS = (
    TABLE_1,
    TABLE_2,
    TABLE_3,
    FIGURE_2,
    FIGURE_10,
    FIGURE_11,
    FIGURE_12,
    FIGURE_13,
    FIGURE_14,
    FIGURE_15,
    FIGURE_16,
    FIGURE_17,
    GROUPING,
    FIGURE_18,
    FIGURE_19,
)
