"""The table and figures of "Hash-Based Hierarchical Caching and Layered Filtering for Interactive Previews in Global Illumination Rendering"
(Roth, Weier, Bauszat, Hinkenjann and Li 2020), section 4, measured here.

data/kitchen, of shining things, stands for the paper's Country Kitchen, and data/city for its Streets of Asia. The paper's images have a
million pixels, its fly-throughs 500 frames, its octree 4096 and 2048 cells along an edge; here images are smaller, fly-throughs are a few
frames that lie far apart, and, unless a figure says otherwise, the octree has 1024 cells along its edge. In all sequences the
octree goes on with what the frames before left.

relMSE is without the noise of references, of which there are two with independent samples. MS-SSIM is against the mean of the references. Times are
the device's by pass, of the caching or of the reconstruction; what both need is apart.
"""

from dataclasses import replace

from .configuration import Configuration
from .experiment import Calls, Claim, Column, Experiment, Plot, Sequences, Table, Truth

SOURCE = "Roth et al. 2020"

# Every pass of all that is measured here is in a stage: those of the octree by their prefixes, those that its two stages share as `both`. `paths` is
# path tracing, whose first two passes have the names of what they share.
_TRACING = ("clear", "generate", "trace_camera", "shade", "shadow", "trace", "compact", "finish")
STAGES = {
    "caching": tuple(
        f"caching.{name}" for name in ("order", *_TRACING, "settle", "locate", "sort", "merge", "coarsen")
    ),
    "reconstruction": tuple(
        f"reconstruction.{name}"
        for name in (*_TRACING, "begin", "gather", "look_up", "add_own", "settle", "answer", "filter", "estimate")
    ),
    "both": ("order", "begin", "clear"),
    "paths": ("order", *_TRACING, "color_sum", "color"),
}
METRICS = ("relmse", "ms_ssim")
BIG = (288, 162)  # MS-SSIM needs 161 pixels along a side


def octree(name: str, spp: int = 1, **settings: object) -> Configuration:
    """The octree with some of its settings. spp: updates in a frame."""
    return Configuration(name, "octree", {f"octree.{key}": value for key, value in settings.items()}, spp=spp)


def paths(spp: int) -> Configuration:
    """Path tracing."""
    return Configuration(f"path tracing, {spp} spp", "pathtrace", spp=spp)


# ---------------------------------------------------------------------------------------------------------------------
# Columns

FRAME = Column("seconds", "frame, ms", ".1f", 1e3)
DEVICE = Column("device", "device, ms", ".1f", 1e3)
STAGE_COLUMNS = tuple(Column(f"stage.{stage}", f"{stage}, ms", ".1f", 1e3) for stage in ("caching", "reconstruction"))
ERRORS = (
    Column("relmse", "relMSE", ".5f"),
    Column("relmse_error", "standard error in one image", ".1e"),
    Column("ms_ssim", "MS-SSIM", ".4f"),
)
CACHE_MIB = Column("memory.cache", "cache, MiB", ".1f", 2**-20)

# ---------------------------------------------------------------------------------------------------------------------
# Table 1: what levels take

RESOLUTIONS = (1024, 2048, 4096)
PRINTED_DENSITIES = {
    "kitchen": (1, 0.5, 0.375, 0.193, 0.124, 0.070, 0.038, 0.023, 0.012, 0.006, 0.003, 0.002, 0.001),
    "city": (1, 0.5, 0.266, 0.197, 0.135, 0.074, 0.043, 0.025, 0.014, 0.008, 0.004, 0.003),
}


def builds(resolutions: tuple[int, ...]) -> tuple[dict, ...]:
    """What builds are told; the finest one's levels are shown."""
    return tuple({"resolution": r, "levels": r == max(resolutions)} for r in resolutions)


TABLE1 = Experiment(
    name="octree-table1",
    source=f"{SOURCE}, Table 1",
    title="What the octree's levels take, and what building it does",
    about="Cells, density (part of the cells of a full grid) and memory of each level of the finest octree; and of several octrees time by step and "
    "memory. Each is built in a process of its own. Checked is that levels take 24 bytes for each cell, and tables 32 for each bucket of four.",
    plans=(Calls("octree_build", builds(RESOLUTIONS), scenes=("kitchen", "city"), quick=builds((512, 1024)), is_seeded=True),),
    tables=(
        Table(
            "Levels",
            (
                Column("edge", "cells along the edge", ".0f"),
                Column("level_cells", "cells", ".0f"),
                Column("density", "density", ".4f"),
                Column("level_data_bytes", "data, KiB", ".2f", 1 / 1024),
                Column("level_hash_bytes", "hash, KiB", ".2f", 1 / 1024),
            ),
        ),
        Table(
            "Builds",
            (
                Column("cells", "cells", ".0f"),
                Column("data_bytes", "data, MiB", ".2f", 2**-20),
                Column("hash_bytes", "hash, MiB", ".2f", 2**-20),
                Column("cell_bytes", "data of a cell, B", ".2f"),
                Column("cell_hash_bytes", "hash of a cell, B", ".2f"),
                Column("thinning", "density, of the level above", ".3f"),
                Column("growth", "data, of the level above", ".2f"),
                Column("elapsed", "build, s", ".3f"),
                *(Column(f"seconds.{step}", f"{step}, s", ".3f") for step in ("occupancy", "levels", "tables")),
                Column("attempts", "attempts", ".0f"),
                Column("kept_bytes", "kept, MiB", ".1f", 2**-20),
                Column("before_bytes", "process before, MiB", ".0f", 2**-20),
                Column("peak_bytes", "at most, MiB", ".0f", 2**-20),
            ),
        ),
    ),
    plots=(
        Plot("Density by level", "level", "density", by="scene", log="y", x_head="level", y_head="density"),
        Plot("Time of a build", "resolution", "elapsed", by="scene", log="xy", x_head="cells along the edge", y_head="s"),
    ),
    claims=(
        Claim("its entry in a table takes 4.4 bytes", "cell_hash_bytes", "1024^3", high=4.5, paper=4.4),
        Claim(
            "data density decreases by a factor of roughly 0.5 from level to level (0.4 to 0.65)",
            "thinning", "1024^3", low=0.4, high=0.65, paper=(0.001 / 0.006) ** (1 / 3), scenes=("kitchen",),
        ),
        Claim(
            "data density decreases by a factor of roughly 0.5 from level to level (0.4 to 0.65)", "thinning", "1024^3",
            low=0.4, high=0.65, paper=(0.003 / 0.014) ** (1 / 3), scenes=("city",),
        ),
        Claim(
            "memory still increases by a factor of roughly 4 to 5 from level to level (3.5 to 5.5)",
            "growth", "1024^3", low=3.5, high=5.5, paper=(1.71 * 1024 / 19.43) ** (1 / 3), scenes=("kitchen",),
        ),
        Claim(
            "memory still increases by a factor of roughly 4 to 5 from level to level (3.5 to 5.5)", "growth", "1024^3",
            low=3.5, high=5.5, paper=(543.88 / 5.5) ** (1 / 3), scenes=("city",),
        ),
        Claim(
            "the initial construction of the cache may take a couple of seconds (20 s at most at the highest resolution)",
            "elapsed", "4096^3", high=20.0,
        ),
    ),
    differs="The paper's tables take 4 bytes for an entry and a tenth more for room, and cannot tell a cell that is not there from another; here an "
    "entry has the key as well, so that a lookup is right or finds nothing, for 8.8 bytes. The scenes are others; the octree of data/city does not hold "
    "its sea.",
    paper=(
        *(
            {"scene": scene, "configuration": f"level {level:2}", "level": level, "density": density}
            for scene, densities in PRINTED_DENSITIES.items()
            for level, density in enumerate(densities)
        ),
        {"scene": "kitchen", "configuration": "4096^3", "data_bytes": 2.17 * 2**30, "hash_bytes": 406.92 * 2**20},
        {"scene": "city", "configuration": "2048^3", "data_bytes": 691.37 * 2**20, "hash_bytes": 126.75 * 2**20},
    ),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 11: error by samples

RUNGS = (1, 8, 64, 512)
QUICK_RUNGS = (1, 8, 64)
FLIGHT = Sequences(
    scenes=("kitchen", "city"),
    configurations=tuple(octree(f"octree, {spp} spp", spp) for spp in (1, 8, 64)),
    size=BIG,
    frames=(0, 6),
    skip=2,
    slower=0.5,
    truth=Truth(256, (5,)),
    metrics=METRICS,
    stages=STAGES,
    pictures=(5,),
    quick={
        "configurations": tuple(octree(f"octree, {spp} spp", spp, resolution=256) for spp in (1, 8)),
        "size": (96, 54),
        "frames": (0, 4),
        "skip": 1,
        "truth": Truth(64, (3,)),
        "pictures": (3,),
    },
)
FINE = tuple(octree(f"octree, {spp} spp", spp, resolution=2048) for spp in (1, 8, 64))  # for what is large
FLIGHT_LADDER = replace(
    FLIGHT,
    configurations=tuple(paths(spp) for spp in RUNGS),
    frames=(5, 6),
    skip=0,
    quick=FLIGHT.quick | {"configurations": tuple(paths(spp) for spp in QUICK_RUNGS), "frames": (3, 4), "skip": 0},
)
LADDER = tuple(paths(spp).name for spp in RUNGS)


FIG11 = Experiment(
    name="octree-fig11",
    source=f"{SOURCE}, Fig. 11",
    title="Error by samples, of path tracing and of the octree in a fly-through",
    about="relMSE and MS-SSIM of the last frame of a fly-through, with 1, 8 and 64 updates of the octree and reconstructions of each frame, and with 1, 8, 64 and 512 "
    "samples of path tracing. The error of path tracing falls as 1/N: one that is an eighth of that of 512 samples is that of 4096.",
    plans=(
        replace(FLIGHT, scenes=("kitchen",)),
        replace(FLIGHT, scenes=("city",), configurations=FINE),
        FLIGHT_LADDER,
    ),
    tables=(Table("Errors", ERRORS), Table("Times", (FRAME, *STAGE_COLUMNS, Column("stage.paths", "paths, ms", ".1f", 1e3), CACHE_MIB))),
    plots=(
        Plot("relMSE by time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
        Plot("MS-SSIM by time", "seconds", "ms_ssim", "points", log="x", x_head="s per frame", y_head="MS-SSIM"),
        Plot("Frame time", "frame", "seconds", log="y", x_head="frame", y_head="s"),
    ),
    claims=(
        *(
            Claim(f"with {spp} spp the octree has less error than path tracing", "relmse", f"octree, {spp} spp", paths(spp).name, high=1.0)
            for spp in (1, 8, 64)
        ),
        Claim(
            "the octree at 64 spp has a quality similar to path tracing at 4096 spp: at most an eighth of the error of 512",
            "relmse", "octree, 64 spp", paths(512).name, high=0.125, scenes=("kitchen",),
        ),
        Claim(
            "at 64 spp the error is similar to that of path tracing at 512 spp",
            "relmse", "octree, 64 spp", paths(512).name, high=1.0, scenes=("city",),
        ),
        *(
            Claim(f"with {spp} spp the octree has more MS-SSIM than path tracing", "ms_ssim", f"octree, {spp} spp", paths(spp).name, low=1.0)
            for spp in (1, 8, 64)
        ),
    ),
    differs="The paper compares all of 500 frames of 1024x1024 pixels, here the last of six of 288x162, with 1024 cells along the octree's edge in data/kitchen instead of 4096, and with 2048 in data/city, as many as the paper's. "
    "Its metrics are of tone-mapped images; relMSE here is of radiance. The octree with 512 spp and path tracing with 4096 and more are left out. MS-SSIM has the "
    "references' noise in it.",
    ladder=LADDER,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 13: error by resolution

EDGES = (256, 512, 1024, 2048)
QUICK_EDGES = (128, 256)


def by_resolution(edges: tuple[int, ...], spp: int) -> tuple[Configuration, ...]:
    """With and without jitter and filter."""
    return tuple(
        c
        for edge in edges
        for c in (
            octree(f"{edge}^3", spp, resolution=edge),
            octree(f"{edge}^3, raw", spp, resolution=edge, filter="none", jitter=0.0),
        )
    )


FIG13 = Experiment(
    name="octree-fig13",
    source=f"{SOURCE}, Fig. 13",
    title="Error and pictures by the octree's resolution",
    about="The last frame of a fly-through of 16 frames with octrees of 256 to 2048 cells along an edge, jittered and filtered, and raw.",
    plans=(
        replace(
            FLIGHT,
            scenes=("kitchen",),
            configurations=by_resolution(EDGES, 4),
            frames=(0, 16),
            skip=4,
            slower=1,
            truth=Truth(256, (15,)),
            pictures=(15,),
            quick=FLIGHT.quick | {"configurations": by_resolution(QUICK_EDGES, 2)},
        ),
    ),
    tables=(Table("Errors, times and memory", (*ERRORS, FRAME, *STAGE_COLUMNS, CACHE_MIB)),),
    plots=(
        Plot("relMSE", "configuration", "relmse", "bars", y_head="relMSE"),
        Plot("relMSE by memory", "memory.cache", "relmse", "points", log="xy", x_head="bytes", y_head="relMSE"),
    ),
    claims=(
        *(
            Claim(f"{edge}^3: quantization is effectively hidden by jittering and filtering", "relmse", f"{edge}^3", f"{edge}^3, raw", high=1.0)
            for edge in EDGES
        ),
        Claim("quality improves with the resolution (2048 beside 256)", "relmse", "2048^3", "256^3", high=1.0),
        Claim("unfiltered, too", "relmse", "2048^3, raw", "256^3, raw", high=1.0),
    ),
    differs="The paper shows pictures, and no numbers. Here each frame has four updates.",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 14: a sequence, a frame by itself, and path tracing

SAMPLES = (1, 8, 64)
QUICK_SAMPLES = (1, 8)


def sequence_and_single(samples: tuple[int, ...], **settings: object) -> tuple[tuple[Configuration, ...], ...]:
    """Configurations with frames before, and of a frame by itself beside path tracing."""
    before = tuple(octree(f"sequence, {n} spp", n, **settings) for n in samples)
    return before, tuple(c for n in samples for c in (octree(f"individual, {n} spp", n, **settings), paths(n)))


BEFORE, ALONE = sequence_and_single(SAMPLES)
QUICK_BEFORE, QUICK_ALONE = sequence_and_single(QUICK_SAMPLES, resolution=256)
FIG14 = Experiment(
    name="octree-fig14",
    source=f"{SOURCE}, Fig. 14",
    title="Path tracing, the octree after three more frames, and the octree in a frame by itself",
    about="One frame with 1, 8 and 64 samples: path traced; by the octree with three frames of the sequence before it; and by an octree that begins empty.",
    plans=(
        replace(FLIGHT, configurations=BEFORE, frames=(2, 6), skip=3, quick=FLIGHT.quick | {"configurations": QUICK_BEFORE, "frames": (0, 4), "skip": 3}),
        replace(FLIGHT, configurations=ALONE, frames=(5, 6), skip=0, quick=FLIGHT.quick | {"configurations": QUICK_ALONE, "frames": (3, 4), "skip": 0}),
    ),
    tables=(Table("Errors and times", (*ERRORS, FRAME)),),
    plots=(
        Plot("relMSE", "configuration", "relmse", "bars", y_head="relMSE", log="y"),
        Plot("relMSE by time", "seconds", "relmse", "points", log="xy", x_head="s", y_head="relMSE"),
    ),
    claims=(
        *(
            Claim(f"{n} spp: frames before lower the error", "relmse", f"sequence, {n} spp", f"individual, {n} spp", high=1.0)
            for n in SAMPLES
        ),
        *(
            Claim(f"{n} spp: a frame by itself errs less than path tracing", "relmse", f"individual, {n} spp", paths(n).name, high=1.0)
            for n in SAMPLES
        ),
    ),
    differs="The paper shows pictures, and no numbers; 512 spp, which it has as well, are left out. Here the four frames are of half the scene's rate.",
    ladder=tuple(paths(n).name for n in SAMPLES),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 16: where the view counts


def readings(spp: int, **settings: object) -> tuple[Configuration, ...]:
    """What fills the cache, and ways to read it."""
    return (
        octree("filling", 1, **settings),
        octree("layered", spp, filter="bilateral", layered=True, **settings),
        octree("plain", spp, filter="bilateral", layered=False, **settings),
        octree("none", spp, filter="none", **settings),
    )


FIG16 = Experiment(
    name="octree-fig16",
    source=f"{SOURCE}, Fig. 16",
    title="Layered filtering, plain filtering and none, where surfaces are glossy or let light through",
    about="A cache is filled by 32 frames with one update each, and the last of them is then read from it by 64 reconstructions, without "
    "caching: each layer filtered by itself, the image filtered as a whole, and none. Errors are of all pixels, of those that show metal, glass and "
    "glossy surfaces (roughness below 0.3) first, and of the rest.",
    plans=(
        Sequences(
            kind="octree_reading",
            scenes=("kitchen", "spheres"),
            configurations=readings(64),
            size=BIG,
            frames=(0, 32),
            skip=0,
            slower=0.5,
            truth=Truth(512, (31,)),
            metrics=METRICS,
            stages=STAGES,
            pictures=(31,),
            quick={
                "configurations": readings(8, resolution=256),
                "size": (96, 54),
                "frames": (0, 6),
                "truth": Truth(64, (5,)),
                "pictures": (5,),
            },
        ),
    ),
    tables=(
        Table(
            "Errors by part of the picture",
            (
                *ERRORS,
                Column("share", "glossy and glass, %", ".1f", 100),
                Column("relmse.view", "their relMSE", ".5f"),
                Column("relmse.rest", "the rest's", ".5f"),
                STAGE_COLUMNS[1],
            ),
        ),
    ),
    plots=(
        Plot("relMSE of glossy surfaces and glass", "configuration", "relmse.view", "bars", y_head="relMSE"),
        Plot("relMSE of the rest", "configuration", "relmse.rest", "bars", y_head="relMSE"),
    ),
    claims=(
        Claim("layered filtering removes noise where surfaces are glossy or let light through", "relmse.view", "layered", "none", high=1.0),
        Claim("it does so without loss of details: better than filtering the image", "relmse.view", "layered", "plain", high=1.0),
        Claim("the rest gets better than unfiltered as well", "relmse.rest", "layered", "none", high=1.0),
    ),
    differs="The paper shows pictures, and no numbers. Its cache is filled by a random fly-through of 128 frames, and read by 128 reconstructions.",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 17: times by what is cached

STORES = ((1, 1), (3, 3), (8, 8))
PARTS = (0.25, 0.5, 0.75, 1.0)


def stored(store: int, length: int, parts: tuple[float, ...], edge: int) -> tuple[Configuration, ...]:
    """With several caching resolutions."""
    return tuple(
        octree(f"({store}, {length}), {part:g}", store=store, length=length, caching_resolution=part, resolution=edge)
        for part in parts
    )


FIG17_PLAN = Sequences(
    kind="octree_updates",
    scenes=("kitchen",),
    configurations=(),
    size=BIG,
    frames=(0, 16),
    skip=8,
    metrics=(),
    stages=STAGES,
)
FIG17 = Experiment(
    name="octree-fig17",
    source=f"{SOURCE}, Fig. 17",
    title="Times by how much is cached",
    about="Time by stage, and cells of all levels that an update reaches, by how many vertices of a path store light, of how many bounces, and by the "
    "caching resolution: how many paths there are along the image's edges, as part of its pixels. '(3, 3), 0.5' stands for three vertices, three bounces, "
    "and half the resolution.",
    plans=tuple(
        replace(
            FIG17_PLAN,
            configurations=stored(*pair, PARTS, 2048),
            labels={"vertices": pair[0]},
            quick={"configurations": stored(*pair, (0.5, 1.0), 256), "size": (96, 54), "frames": (0, 4), "skip": 2},
        )
        for pair in STORES
    ),
    tables=(
        Table(
            "Times and cells",
            (
                FRAME,
                *STAGE_COLUMNS,
                Column("updated", "cells updated", ".0f"),
                Column("cache.inserted", "vertices", ".0f"),
                *(Column(f"rays.{kind}", f"{kind} rays, thousands", ".0f", 1e-3) for kind in ("secondary", "shadow")),
            ),
        ),
        Table("Passes of the reconstruction", tuple(
            Column(f"pass.reconstruction.{name}", f"{name}, ms", ".2f", 1e3)
            for name in ("trace_camera", "gather", "shadow", "trace", "look_up", "filter")
        )),
    ),
    plots=(
        Plot("Time of the caching", "configuration", "stage.caching", "bars", y_head="s"),
        Plot("Time of the reconstruction", "configuration", "stage.reconstruction", "bars", y_head="s"),
        Plot("Cells updated", "configuration", "updated", "bars", y_head="cells of all levels"),
    ),
    claims=(
        *(
            Claim(
                f"{pair}: caching behaves quadratically with regard to the caching resolution (a quarter at one half, 0.2 to 0.4)",
                "stage.caching", f"{pair}, 0.5", f"{pair}, 1", 0.2, 0.4,
            )
            for pair in STORES
        ),
        *(
            Claim(
                f"{pair}: reconstruction does not depend on the caching resolution (within a tenth)",
                "stage.reconstruction", f"{pair}, 0.5", f"{pair}, 1", 0.9, 1.1,
            )
            for pair in STORES
        ),
        Claim("storing first vertices only is the fastest", "stage.caching", "(1, 1), 1", "(3, 3), 1", high=1.0),
        Claim("and reaches fewer cells", "updated", "(1, 1), 1", "(3, 3), 1", high=1.0),
        Claim("with eight of each caching is slower than with three", "stage.caching", "(8, 8), 1", "(3, 3), 1", low=1.0),
    ),
    differs="The paper counts cells over 500 frames, here they are those of one update. Each pair of vertices and bounces is a job of its own, one after the other. Paths end by roulette and in the dark; the kitchen's go on for at most six bounces.",
    paper=(
        {
            "scene": "kitchen",
            "configuration": "(3, 3), 1",
            "pass.reconstruction.filter": 22e-3,
            "pass.reconstruction.look_up": 4.5e-3,
            "pass.reconstruction.trace_camera": 31e-3,
        },
    ),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 18: times of each frame

FIG18 = Experiment(
    name="octree-fig18",
    source=f"{SOURCE}, Fig. 18",
    title="Times of each frame of a fly-through, of path tracing and of the octree's stages",
    about="Device time of path tracing with one sample, and of caching and reconstruction with one update, frame by frame; and with a quarter of the caching paths "
    "along each edge of the image.",
    plans=(
        Sequences(
            scenes=("kitchen", "city"),
            configurations=(
                Configuration("path tracing", "pathtrace"),
                octree("octree"),
                octree("octree, 0.25", caching_resolution=0.25),
            ),
            size=(320, 180),
            frames=(0, 40),
            metrics=(),
            stages=STAGES,
            quick={
                "configurations": (
                    Configuration("path tracing", "pathtrace"),
                    octree("octree", resolution=256),
                    octree("octree, 0.25", resolution=256, caching_resolution=0.25),
                ),
                "size": (96, 54),
                "frames": (0, 6),
                "skip": 2,
            },
        ),
    ),
    tables=(
        Table(
            "Times",
            (
                DEVICE,
                *STAGE_COLUMNS,
                Column("device", "of path tracing", ".2f", over="path tracing"),
                FRAME,
                *(Column(f"rays.{kind}", f"{kind} rays, thousands", ".0f", 1e-3) for kind in ("secondary", "shadow")),
            ),
        ),
    ),
    plots=(
        Plot("Device time", "frame", "device", x_head="frame", y_head="s"),
        Plot("Caching", "frame", "stage.caching", x_head="frame", y_head="s"),
        Plot("Reconstruction", "frame", "stage.reconstruction", x_head="frame", y_head="s"),
    ),
    claims=(
        Claim("a frame takes more than one of path tracing (the paper: caching alone does)", "device", "octree", "path tracing", low=1.0),
        Claim("caching takes most of it: with a quarter of the paths along each edge, at most two thirds of the time are left", "device", "octree, 0.25", "octree", high=0.67),
        Claim("with those, a frame takes about as long as a path-traced one (at most half more)", "device", "octree, 0.25", "path tracing", high=1.5),
    ),
    differs="The paper's fly-throughs have 500 frames and begin outside, its paths have up to eight vertices.",
)  # fmt: skip

EXPERIMENTS = (TABLE1, FIG11, FIG13, FIG14, FIG16, FIG17, FIG18)
