"""The figures of "Stable Sample Caching for Interactive Stereoscopic Ray Tracing" (Philippi, Jensen and Frisvad 2025), measured here.

The paper's scenes are not the project's to give away: data/atrium stands for sponza, data/city for the bistro, data/classroom, whose camera is a
head's, for san-miguel. Its GPU is a CPU here, its full HD a fraction of it, its 500 frames a few dozen; so times compare by their ratios, and
errors by what is better than what. Its HashCache is `voxelhash`; its DLAA, which is a product, `--temporal taa`; its TAA, which weighs
frames by variance, `--temporal varianceblend`. Unless a figure says otherwise, caches have the paper's settings: 12 slots, 4 samples
for each pixel, tracing by need, one sample of each pixel shaded in a frame; and one setting that is not the paper's, the reprojection in which no order of
threads matters, which has no races to look for.

Where a figure compares quality, path tracing with more and more samples stands beside it, at the same frames, so that each
configuration can be set beside the path tracing that takes as long, or that errs as much.
"""

from collections.abc import Mapping
from dataclasses import replace

from .configuration import Configuration
from .experiment import Calls, Claim, Column, Experiment, Plot, Sequences, Table, Truth

SOURCE = "Philippi, Jensen, Frisvad 2025"
UNIFORM = {"shading": "uniform", "shading_rate": 1.0}
SIZE = (480, 270)
FILTER = "varianceblend"  # section 4 has it on top of all methods

# The stages of Fig. 7 and 13, and the passes that each has; every pass of all that is measured here is in exactly one. As in the paper,
# looking up and updating a cache of light is part of tracing the paths that it saves.
STAGES = {
    "reprojection": ("clear", "list", "project", "reserve", "copy"),
    "tracing": ("order", "generate", "trace_camera", "first_hits", "assess", "plan", "aim", "retrace", "settle"),
    "shading": (
        *("importance", "choose", "ask", "address", "look_up", "claim", "inherit", "begin"),
        *("shade", "trace", "shadow", "compact", "finish", "accumulate", "update"),
    ),
    "resolve": (
        *("list_visible", "address_seen", "find_seen", "answer", "resolve", "average"),
        *("color_sum", "color", "moments", "aovs", "describe"),
    ),
    "temporal": ("surface", "distance", "motion", "lay_out", "filter"),
    "stereo": ("near", "stereo", "blend"),
}
# Fig. 7 leaves shading out. Here it is done, so that there is an error to speak of, and not counted.
UNSHADED = {"unshaded": tuple(name for stage, names in STAGES.items() if stage != "shading" for name in names)}


# ---------------------------------------------------------------------------------------------------------------------
# Configurations


def samples(name: str, *, temporal: str = "none", stereo_blend: str = "none", **settings: object) -> Configuration:
    """The sample cache as the paper has it, but for some of its settings."""
    own = {f"samplecache.{key}": value for key, value in (UNIFORM | settings).items()}
    return Configuration(name, "samplecache", own, temporal=temporal, stereo_blend=stereo_blend)


def voxels(name: str, method: str = "voxelhash", temporal: str = "none", **settings: object) -> Configuration:
    """A method with a cache of voxels, and some of its settings."""
    return Configuration(
        name, method, {f"voxelhash.{key}": value for key, value in settings.items()}, temporal=temporal
    )


def paths(spp: int, temporal: str = "none", settings: Mapping[str, object] | None = None) -> Configuration:
    """Path tracing, which is the baseline."""
    name = f"{spp} spp" if temporal == "none" else f"{spp} spp, TAA"
    return Configuration(name, "pathtrace", settings or {}, spp=spp, temporal=temporal)


LADDER = tuple(paths(spp) for spp in (1, 2, 4, 8, 16))
RUNGS = tuple(c.name for c in LADDER)

# What most figures are measured on: half a second of the paper's kind of motion, at 60 frames per second, the last two of which are compared
# with the truth. Path tracing has no memory: the frames that are compared, and one before them, are enough.
WALK = Sequences(
    scenes=("atrium", "city"),
    configurations=(),
    size=SIZE,
    frames=(0, 24),
    skip=8,
    slower=2,
    truth=Truth(128, (22, 23)),
    metrics=("relmse", "flip"),
    stages=STAGES | UNSHADED,
    pictures=(23,),
    quick={"size": (96, 54), "frames": (0, 6), "skip": 2, "truth": Truth(32, (5,)), "pictures": (5,)},
)
WALK_LADDER = replace(
    WALK,
    configurations=LADDER,
    frames=(21, 24),
    skip=1,
    stages=STAGES,
    quick=WALK.quick | {"frames": (4, 6), "skip": 1, "configurations": LADDER[:4]},
)

# ---------------------------------------------------------------------------------------------------------------------
# Columns

FRAME = Column("seconds", "frame, ms", ".1f", 1e3)
STAGE_COLUMNS = tuple(Column(f"stage.{stage}", f"{stage}, ms", ".1f", 1e3) for stage in list(STAGES)[:4])
ERRORS = (
    Column("relmse", "relMSE", ".4f"),
    Column("flip", "FLIP", ".4f"),
    Column("difference", "flicker", ".3e"),
)
SHARPNESS = (Column("cpbd", "CPBD", ".3f"), Column("cpbd_reference", "CPBD of the reference", ".3f"))
RAYS = tuple(
    Column(f"rays.{kind}", f"{head}, thousands", ".1f", 1e-3)
    for kind, head in (("primary", "first-hit rays"), ("secondary", "secondary rays"), ("shadow", "shadow rays"))
)


def counter(name: str, head: str) -> Column:
    """What caches count in a frame."""
    return Column(f"cache.{name}", head, ".0f")


KEPT = tuple(
    counter(name, name)
    for name in ("occupied", "visible", "created", "purged", "retraced", "shaded", "dropped", "stolen", "overflow")
)

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 6: reprojection

FIG6 = Experiment(
    name="samplecache-fig6",
    source=f"{SOURCE}, Fig. 6 and Table 1",
    title="Reprojection of the cache in one pass, in two, and deterministic; with and without radiance",
    about="Milliseconds of reprojecting a cache with four samples in each pixel after a small step of the camera: listing, projecting and taking slots, and"
    " copying what is kept. Beside it a simple reprojection of one sample for each pixel, without any choice of slots. And the part of the slots that races"
    " have left inconsistent, in that step and in a crowd of samples that is made for it.",
    plans=(
        Calls(
            "reprojection",
            ({"size": [640, 360], "repeats": 21, "runs": 10},),
            scenes=("cornell", "city"),
            quick=({"size": [128, 72], "repeats": 5, "runs": 2},),
            is_seeded=True,
        ),
    ),
    tables=(
        Table(
            "Times",
            (
                Column("stage.reserve", "reserve, ms", ".2f", 1e3), Column("stage.copy", "copy, ms", ".2f", 1e3), Column("seconds", "total, ms", ".2f", 1e3),
                Column("seconds", "of single-pass", ".2f", over="single-pass"), Column("samples", "samples", ".0f"),
            ),
        ),
        Table(
            "Inconsistent slots, per million",
            (Column("step", "a step", ".3g", 1e6), Column("crowd", "a crowd", ".3g", 1e6), Column("threads", "threads", ".0f")),
        ),
    ),
    plots=(Plot("Time", "configuration", "seconds", "bars", y_head="s"),),
    claims=(
        Claim("2-pass reprojection has almost twice the overhead of 1-pass (3.50 ms beside 2.10 ms)", "seconds", "two-pass", "single-pass", low=1.0, paper=3.50 / 2.10),
        Claim("the same without shading (2.79 ms beside 1.48 ms)", "seconds", "two-pass-no-shade", "single-pass-no-shade", low=1.0, paper=2.79 / 1.48),
        Claim("without shading the cache carries less, and takes less (1.48 ms beside 2.10 ms)", "seconds", "single-pass-no-shade", "single-pass", high=1.0, paper=1.48 / 2.10),
        Claim("taking slots costs more than a simple reprojection (2.10 ms beside 1.00 ms)", "seconds", "single-pass", "simple", low=1.0, paper=2.10 / 1.00),
        Claim("artefacts are rare with 1-pass (of the slots filled: at most one in ten thousand)", "step", "single-pass", high=1e-4),
        Claim("2-pass is correct", "crowd", "two-pass", high=0.0),
        Claim("the deterministic one, which is not the paper's, is correct as well", "crowd", "deterministic", high=0.0),
    ),
    differs="640x360 on a CPU instead of 1080p on a GPU. The deterministic variant, the default of this project, is not in the paper. Of races there are more the more"
    " threads there are; with one there are none, and they are not measured.",
    paper=(
        {"configuration": "single-pass-no-shade", "stage.reserve": 1.48e-3, "seconds": 1.48e-3},
        {"configuration": "single-pass", "stage.reserve": 2.10e-3, "seconds": 2.10e-3},
        {"configuration": "two-pass-no-shade", "stage.reserve": 1.12e-3, "stage.copy": 1.68e-3, "seconds": 2.79e-3},
        {"configuration": "two-pass", "stage.reserve": 1.01e-3, "stage.copy": 2.49e-3, "seconds": 3.50e-3},
        {"configuration": "simple", "stage.reserve": 1.00e-3, "seconds": 1.00e-3},
    ),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 7: which samples are traced again

FIG7 = Experiment(
    name="samplecache-fig7",
    source=f"{SOURCE}, Fig. 7",
    title="Which samples of the cache are traced again in a frame: one of each pixel, all, or those where visibility may have changed",
    about="Time by stage, rays, error and flicker of samplecache.tracing = single, multi and adaptive, in a walk and a flight; beside them path"
    " tracing with 1 to 16 samples. One sample of each pixel is shaded in each frame; the column 'without shading' is what the paper's total is.",
    plans=(
        replace(
            WALK,
            configurations=(
                samples("single", tracing="single"),
                samples("multi", tracing="multi"),
                samples("adaptive", tracing="adaptive"),
            ),
        ),
        WALK_LADDER,
    ),
    tables=(
        Table(
            "Times and errors",
            (
                FRAME,
                Column("stage.unshaded", "without shading, ms", ".1f", 1e3),
                *STAGE_COLUMNS,
                RAYS[0],
                *ERRORS,
            ),
        ),
        Table("Samples in a frame", KEPT),
    ),
    plots=(
        Plot(
            "Time without shading", "configuration", "stage.unshaded", "bars",
            y_head="s",
        ),
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
    ),
    claims=(
        Claim(
            "multi-sampling increases the tracing cost significantly (7.15 ms beside 1.95 ms)",
            "stage.tracing", "multi", "single", low=1.0, paper=7.15 / 1.95,
        ),
        Claim(
            "adaptive sampling traces fewer rays than multi-sampling",
            "rays.primary", "adaptive", "multi", high=1.0,
        ),
        Claim(
            "multi-sampling removes the artefacts at the cost of lower performance than adaptive sampling (10.37 ms beside 5.79 ms)",
            "stage.unshaded", "multi", "adaptive", low=1.0, paper=10.37 / 5.79,
        ),
        Claim(
            "adaptive sampling has a performance close to single-sampling (5.79 ms beside 5.06 ms; close: within a quarter)",
            "stage.unshaded", "adaptive", "single", high=1.25, paper=5.79 / 5.06,
        ),
        Claim(
            "with single-sampling geometric edges exhibit temporal lag during movement, which multi-sampling removes",
            "relmse", "single", "multi", low=1.0,
        ),
        Claim(
            "adaptive sampling exhibits very few artefacts (its error: no more than 5 % above that of multi-sampling)",
            "relmse", "adaptive", "multi", high=1.05,
        ),
        Claim("single-sampling improves temporal stability over tracing each frame anew", "difference", "single", "1 spp", high=1.0),
    ),
    differs="The paper measures without shading, on an RTX 3060 at 1080p, in a scene that it does not name. Here samples are shaded, so that errors are of"
    " whole images; its total is the sum of all stages but shading. Reprojection is the project's deterministic one, the same for all three.",
    paper=(
        {"configuration": "single", "stage.reprojection": 1.43e-3, "stage.tracing": 1.95e-3, "stage.unshaded": 5.06e-3},
        {"configuration": "multi", "stage.reprojection": 1.49e-3, "stage.tracing": 7.15e-3, "stage.unshaded": 10.37e-3},
        {"configuration": "adaptive", "stage.reprojection": 2.47e-3, "stage.tracing": 1.46e-3, "stage.unshaded": 5.79e-3},
    ),
    ladder=RUNGS,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 8: antialiasing

FIG8 = Experiment(
    name="samplecache-fig8",
    source=f"{SOURCE}, Fig. 8",
    title="Antialiasing: a ball of thin hairs under a sun",
    about="Error, sharpness (CPBD, wanted as the reference has it), flicker and time of 1 and 4 samples per pixel, of 4 with temporal antialiasing, and of the sample"
    " cache. There is no light but a sun's, and none that has bounced, so that all noise is of edges. The camera goes round the ball.",
    plans=(
        Sequences(
            scenes=("hairball/sun",),
            configurations=(paths(1), samples("SampleCache"), paths(4), paths(4, "taa")),
            size=(320, 180),
            frames=(0, 20),
            skip=12,
            slower=2,
            truth=Truth(64, (19,)),
            metrics=("relmse", "flip", "cpbd", "cpbd_reference"),
            stages=STAGES,
            pictures=(19,),
            quick={"size": (116, 65), "frames": (0, 5), "skip": 2, "truth": Truth(16, (4,)), "pictures": (4,)},
        ),
    ),
    tables=(Table("Quality and time", (FRAME, *ERRORS, *SHARPNESS)), Table("Samples in a frame", KEPT)),
    plots=(
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("Sharpness", "configuration", "cpbd", "bars", y_head="CPBD"),
    ),
    claims=(
        Claim("slightly worse antialiasing than 4 spp rendering", "relmse", "SampleCache", "4 spp", low=1.0),
        Claim("but less flicker", "difference", "SampleCache", "4 spp", high=1.0),
        Claim("the temporal integration of DLAA (here: TAA) makes its result the most stable", "difference", "4 spp, TAA", "SampleCache", high=1.0),
        Claim("at the cost of excessive blurring", "cpbd", "4 spp, TAA", "SampleCache", high=1.0),
        Claim("the performance impact of DLAA (here: TAA) is slightly higher than that of our method", "seconds", "4 spp, TAA", "SampleCache", low=1.0),
    ),
    differs="DLAA is a trained product; --temporal taa, which clamps the history to the neighbours' range, stands for it. The reference has many samples, and not 16. 320x180 pixels,"
    " of which hairs are a smaller part than at 1080p.",
    ladder=("1 spp", "4 spp"),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 9: a still view


def resting(lod: str) -> tuple[Configuration, Configuration]:
    """HashCache with this choice of a voxel's size, without and with the filter."""
    return voxels(f"HashCache, {lod}", lod=lod), voxels(f"HashCache, {lod}, TAA", temporal=FILTER, lod=lod)


FIG9 = Experiment(
    name="samplecache-fig9",
    source=f"{SOURCE}, Fig. 9",
    title="A still view: the sample cache, and voxels whose size follows the distance, or the distance and the slant",
    about="Flicker, error and sharpness (CPBD, wanted as the reference has it) of a view at rest, after caches have filled for 24 frames: SampleCache, HashCache with"
    " voxelhash.lod = distance and incidence, each without and with the temporal filter.",
    plans=(
        Sequences(
            scenes=("atrium", "city"),
            configurations=(samples("SampleCache"), samples("SampleCache, TAA", temporal=FILTER), *resting("distance"), *resting("incidence")),
            size=SIZE,
            frames=(0, 36),
            skip=24,
            still=7,
            truth=Truth(128, (35,)),
            metrics=("relmse", "flip", "cpbd", "cpbd_reference"),
            stages=STAGES,
            pictures=(35,),
            quick={"size": (116, 65), "frames": (0, 8), "skip": 4, "truth": Truth(32, (7,)), "pictures": (7,)},
        ),
    ),
    tables=(
        Table("Steadiness, quality and time", (ERRORS[2], ERRORS[0], ERRORS[1], *SHARPNESS, FRAME)),
        Table("Caches", (counter("occupied", "samples, or voxels of HashCache"), counter("shaded", "paths traced"))),
    ),
    plots=(
        Plot("Flicker", "configuration", "difference", "bars", log="y", y_head="mean squared difference"),
        Plot("Sharpness", "configuration", "cpbd", "bars", y_head="CPBD"),
    ),
    claims=(
        Claim("our method is temporally stable without relying on TAA: beside HashCache without it", "difference", "SampleCache", "HashCache, distance", high=1.0),
        Claim("the same beside HashCache with TAA", "difference", "SampleCache", "HashCache, distance, TAA", high=1.0),
        Claim(
            "temporal stability of the HashCache can be significantly improved by choosing the LoD based on the angle of incidence",
            "difference", "HashCache, incidence", "HashCache, distance", high=1.0,
        ),
        Claim("albeit at the cost of blurring the shadow edges further", "cpbd", "HashCache, incidence, TAA", "HashCache, distance, TAA", high=1.0),
        Claim("our method shows less aliasing", "relmse", "SampleCache", "HashCache, distance", high=1.0),
    ),
    differs="The paper has a close-up of a shadow's edge; here whole pictures are compared, in which the sharpness of all edges counts. HashCache jitters first hits and voxels,"
    " which it needs TAA for.",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 10: interactive stable ray tracing


def stable(factor: int, **settings: object) -> Configuration:
    """The layout and the reprojection of interactive stable ray tracing, with so many samples by so many."""
    own = {f"samplecache.{key}": value for key, value in (UNIFORM | {"tracing": "single"} | settings).items()}
    return Configuration(f"isrt, M={factor}", "isrt", {"isrt.superresolution": factor, **own})


FIG10 = Experiment(
    name="samplecache-fig10",
    source=f"{SOURCE}, Fig. 10",
    title="The cache's slots beside the grids of interactive stable ray tracing",
    about="Time, error and flicker of isrt, whose samples lie in cells of a grid of 3x3 or 4x4 in each pixel, and of samplecache with as many slots (9 and 16) and the"
    " same target (4 and 6). Both trace one sample of each pixel again, and shade one.",
    plans=(
        replace(
            WALK,
            configurations=(
                stable(3, target=4), samples("N=9", slots=9, target=4, tracing="single"),
                stable(4, target=6), samples("N=16", slots=16, target=6, tracing="single"),
            ),
        ),
        WALK_LADDER,
    ),
    tables=(Table("Times and errors", (FRAME, *STAGE_COLUMNS, *ERRORS)), Table("Samples in a frame", KEPT)),
    plots=(
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
    ),
    claims=tuple(
        Claim(f"our method {says}: {ours} beside {theirs}", measure, ours, theirs, **bound)
        for ours, theirs in (("N=9", "isrt, M=3"), ("N=16", "isrt, M=4"))
        for says, measure, bound in (
            ("is faster", "seconds", {"high": 1.0}),
            ("is more stable, which is seen in the lower temporal differences", "difference", {"high": 1.0}),
            ("shows better quality", "relmse", {"high": 1.0}),
            ("keeps more visibility samples alive after each reprojection, and so creates fewer", "cache.created", {"high": 1.0}),
            ("has a faster reprojection, as its samples lie closer in memory", "stage.reprojection", {"high": 1.0}),
        )
    ),
    differs="480x270 on a CPU, whose caches are larger beside the picture than a GPU's. Two scenes instead of one.",
    ladder=RUNGS,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 12 and 13: the methods on a moving camera

MOVING = (
    paths(1, FILTER),
    samples("SampleCache", temporal=FILTER),
    voxels("HashCache", temporal=FILTER),
    voxels("Hybrid", "hybrid", temporal=FILTER),
    samples("SC-adaptive", temporal=FILTER, shading="adaptive", shading_rate=0.7),
    paths(2, FILTER),
    paths(4, FILTER),
)
FLIGHT = Sequences(
    scenes=("city",),
    configurations=MOVING,
    size=SIZE,
    frames=(0, 24),
    skip=2,
    slower=2,
    truth=Truth(64, (3, 7, 13, 23)),
    metrics=("relmse",),
    stages=STAGES,
    pictures=(23,),
    quick={"size": (96, 54), "frames": (0, 6), "skip": 1, "truth": Truth(16, (2, 5)), "pictures": (5,)},
)
BREAKDOWN = (
    FRAME,
    Column("device", "device, ms", ".1f", 1e3),
    *STAGE_COLUMNS,
    Column("stage.temporal", "filter, ms", ".1f", 1e3),
)
MOVING_TIMES = (
    Claim(
        "the overhead of the caching methods on top of 1 spp tracing is significant but fairly modest (SampleCache: at most twice the time)",
        "seconds", "SampleCache", "1 spp, TAA", high=2.0,
    ),
    Claim("the overhead of Hybrid is significant but fairly modest", "seconds", "Hybrid", "1 spp, TAA", high=2.0),
    Claim("the overhead of HashCache is significant but fairly modest", "seconds", "HashCache", "1 spp, TAA", high=2.0),
    Claim(
        "performance was consistently lower for SampleCache than for HashCache, due to reprojection overhead",
        "seconds", "SampleCache", "HashCache", low=1.0,
    ),
    Claim("performance was consistently lower for Hybrid than for HashCache", "seconds", "Hybrid", "HashCache", low=1.0),
)  # fmt: skip
FIG12 = Experiment(
    name="samplecache-fig12",
    source=f"{SOURCE}, Fig. 12",
    title="Caches of samples and of voxels while the camera moves: error and time of each frame",
    about="relMSE and frame times of one sample per pixel, SampleCache, HashCache (voxels no larger than a pixel), Hybrid and SampleCache with adaptive"
    " shading, all with the temporal filter, from an empty cache on: a walk, a flight, and a head's motion. Beside them two and four samples per pixel with"
    " the same filter.",
    plans=(
        replace(FLIGHT, scenes=("atrium",)),
        FLIGHT,
        replace(FLIGHT, scenes=("classroom",), slower=1),
    ),
    tables=(
        Table("Errors, times and rays", (FRAME, *ERRORS[::2], *RAYS)),
        Table("Times by stage", BREAKDOWN),
        Table(
            "Caches",
            (
                counter("occupied", "samples, or voxels of HashCache"), counter("voxels", "voxels of Hybrid"), counter("shaded", "paths traced"),
                counter("lookups", "look-ups"), counter("hits", "found"), counter("evicted", "evicted"), counter("discarded", "no room"),
                Column("memory.cache", "memory, MiB", ".1f", 2**-20),
            ),
        ),
    ),
    plots=(
        Plot("Error of each frame", "frame", "relmse", log="y", x_head="frame", y_head="relMSE"),
        Plot("Time of each frame", "frame", "seconds", x_head="frame", y_head="s"),
        Plot("Flicker of each frame", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
    ),
    claims=(
        Claim(
            "SampleCache achieves the same error levels as state-of-the-art hash-based radiance caching (at most 10 % more)",
            "relmse", "SampleCache", "HashCache", high=1.1,
        ),
        Claim("radiance caching significantly reduces noise: SampleCache beside one sample per pixel", "relmse", "SampleCache", "1 spp, TAA", high=1.0),
        Claim("HashCache significantly reduces noise", "relmse", "HashCache", "1 spp, TAA", high=1.0),
        Claim("Hybrid significantly reduces noise", "relmse", "Hybrid", "1 spp, TAA", high=1.0),
        Claim("temporal flickering is reduced with our method", "difference", "SampleCache", "HashCache", high=1.0),
        *MOVING_TIMES,
    ),
    differs="24 frames instead of 500, from which the paper's slow convergence cannot be seen, and no sudden turn of the head; 480x270 pixels. Errors are taken in four"
    " frames, against two path-traced references of 64 samples whose noise cancels. HashCache traces one path for all hits that ask the same voxel in a frame"
    " and follows paths on where a voxel is not to be trusted; the paper gives no such gate.",
    ladder=("1 spp, TAA", "2 spp, TAA", "4 spp, TAA"),
)  # fmt: skip
FIG13 = Experiment(
    name="samplecache-fig13",
    source=f"{SOURCE}, Fig. 13",
    title="Where the time of a frame goes",
    about="Milliseconds by stage of one sample per pixel, SampleCache, HashCache, Hybrid and SampleCache with adaptive shading, on the flight of samplecache-fig12, with"
    " which it shares its measurement.",
    plans=(FLIGHT,),
    tables=(Table("Times by stage", BREAKDOWN), Table("Rays", RAYS)),
    plots=tuple(
        Plot(title, "configuration", f"stage.{stage}", "bars", y_head="s")
        for title, stage in (
            ("Reprojection", "reprojection"), ("Tracing first hits", "tracing"), ("Shading, with the cache's upkeep", "shading"),
            ("Resolve", "resolve"), ("Temporal filter", "temporal"),
        )
    ),
    claims=(
        Claim("HashCache has a lower shading load because nearby pixels may hit the same voxel", "rays.secondary", "HashCache", "SampleCache", high=1.0),
        Claim(
            "cache lookups and updates run with similar execution times for both SampleCache and HashCache (within a quarter)",
            "stage.shading", "SampleCache", "HashCache", low=0.75, high=1.25,
        ),
        Claim("Hybrid's lookups add overhead in resolve", "stage.resolve", "Hybrid", "SampleCache", low=1.0),
        Claim("adaptive shading shades less", "stage.shading", "SC-adaptive", "SampleCache", high=1.0),
        *MOVING_TIMES,
    ),
    differs="As of samplecache-fig12. Where path tracing has its first and secondary hits in one stage in the paper, they are two here.",
    ladder=("1 spp, TAA", "2 spp, TAA", "4 spp, TAA"),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 14: which samples are shaded

FIG14 = Experiment(
    name="samplecache-fig14",
    source=f"{SOURCE}, Fig. 14",
    title="Adaptive shading: fewer paths, and those where least is known",
    about="One sample of each pixel shaded in turn (uniform), beside 0.7 of them on average, those of pixels with the fewest radiance samples first"
    " (adaptive), and beside the project's default rate of 0.9. No temporal filter.",
    plans=(
        replace(
            WALK,
            configurations=(
                samples("uniform 1.0"),
                samples("adaptive 0.7", shading="adaptive", shading_rate=0.7),
                samples("adaptive 0.9", shading="adaptive", shading_rate=0.9),
            ),
        ),
        WALK_LADDER,
    ),
    tables=(
        Table("Times and errors", (FRAME, *STAGE_COLUMNS, *RAYS[1:], *ERRORS)),
        Table("Samples in a frame", KEPT),
    ),
    plots=(
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
    ),
    claims=(
        Claim(
            "despite adaptive shading using only 70% of the shading rate used for uniform shading, the error is equally low (within 5 %)",
            "relmse", "adaptive 0.7", "uniform 1.0", high=1.05,
        ),
        Claim("adaptive shading improves the performance of SampleCache", "seconds", "adaptive 0.7", "uniform 1.0", high=1.0),
    ),
    differs="1080p on an RTX 4090 in the paper. How much comes into view in a frame, which is what adaptive shading is for, depends on the camera's speed.",
    ladder=RUNGS,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 15: stereo blending

GLOSSY = 0.1  # the weight of a new radiance sample in section 5.2


def blended(name: str, stereo_blend: str, **settings: object) -> Configuration:
    """The sample cache, forgetting as fast as section 5.2 lets it, its eyes joined in some way."""
    own = {key: value for key, value in settings.items() if "." in key}
    inner = {key: value for key, value in settings.items() if "." not in key}
    made = samples(name, stereo_blend=stereo_blend, alpha=GLOSSY, **inner)
    return replace(made, settings={**made.settings, **own})


# What each kind of blending needs, moments or surfaces, is part of it.
BLENDING = ("moments", "surface", "distance", "near", "stereo", "blend")
STEREO_STAGES = {
    stage: tuple(name for name in names if name not in BLENDING)
    for stage, names in STAGES.items()
    if stage not in ("temporal", "stereo")
} | {"stereo": BLENDING}
STEREO = Sequences(
    scenes=("kitchen", "spheres"),
    configurations=(
        blended("none", "none"),
        blended("samples, R=1", "samples", sharpness=1.0),
        blended("samples, R=0.8", "samples", sharpness=0.8),
        blended("samples, R=0", "samples", sharpness=0.0),
        blended("neighbourhood", "varianceblend"),
        blended("halves", "constant", **{"stereo.beta": 0.5}),
    ),
    size=(320, 360),
    frames=(0, 24),
    skip=12,
    stereo=True,
    truth=Truth(128, (23,)),
    metrics=("relmse", "flip", "cpbd", "cpbd_reference"),
    stages=STEREO_STAGES,
    pictures=(23,),
    quick={
        "scenes": ("spheres",),
        "size": (64, 72),
        "frames": (0, 6),
        "skip": 2,
        "truth": Truth(32, (5,)),
        "pictures": (5,),
    },
)
FIG15 = Experiment(
    name="samplecache-fig15",
    source=f"{SOURCE}, Fig. 15",
    title="Stereo blending by the variance of a pixel's samples, beside that of its neighbourhood",
    about="relMSE, sharpness (CPBD, wanted as the reference has it), the difference between the eyes where both show the same point, and time: without blending;"
    " with weights from the moments of a pixel's samples (Eq. 8), not blurred (R=1), the most (R=0), and as by default; with weights from 3x3 pixels"
    " (Philippi, Frisvad and Jensen 2023); and with equal weights. All of the same cache, in which new light counts a tenth.",
    plans=(
        STEREO,
        replace(
            STEREO, configurations=LADDER, frames=(22, 24), skip=1,
            quick=STEREO.quick | {"frames": (4, 6), "skip": 1, "configurations": LADDER[:4]},
        ),
    ),
    tables=(
        Table(
            "Quality and time of both eyes",
            (
                ERRORS[0], ERRORS[1],
                *SHARPNESS,
                Column("stereo", "stereo difference", ".3e"), Column("stereo_reference", "of the reference", ".3e"),
                ERRORS[2], FRAME, Column("stage.stereo", "blending, ms", ".2f", 1e3),
            ),
        ),
    ),
    plots=(
        Plot("Stereo difference against error", "relmse", "stereo", "points", log="xy", x_head="relMSE", y_head="stereo difference"),
        Plot("Sharpness", "configuration", "cpbd", "bars", y_head="CPBD"),
        Plot("Stereo difference", "configuration", "stereo", "bars", y_head="mean squared difference"),
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
    ),
    claims=(
        Claim("best quality is achieved with R = 0, which improves RSE as compared with the related work", "relmse", "samples, R=0", "neighbourhood", high=1.0),
        Claim("it improves sharpness", "cpbd", "samples, R=0", "neighbourhood", low=1.0),
        Claim("it improves stereo discrepancy", "stereo", "samples, R=0", "neighbourhood", high=1.0),
        Claim("with no significant performance overhead (at most 5 %)", "seconds", "samples, R=0", "neighbourhood", high=1.05),
        Claim("R = 1 does not perform as well in terms of error", "relmse", "samples, R=1", "samples, R=0", low=1.0),
        Claim("R = 1 does not perform as well in terms of stereo discrepancy", "stereo", "samples, R=1", "samples, R=0", low=1.0),
        Claim("R = 1 is slightly cheaper, as it needs fewer texture fetches", "stage.stereo", "samples, R=1", "samples, R=0", high=1.0),
        Claim("blending reduces the stereo discrepancy", "stereo", "samples, R=0", "none", high=1.0),
    ),
    differs="The paper has the bistro with glossy materials at 2x960x1080; here it is a kitchen of glazed and metal things, and a metal and a glass sphere in a box, at"
    " 2x320x360. Equal weights, which the paper does not show, tell what the weights are worth. Path tracing beside them has two eyes as well, and no blending.",
    ladder=RUNGS,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 18 and 19: where light that was kept is no longer true

SPHERES = Sequences(
    scenes=("spheres", "spheres/alpha-0.2", "spheres/alpha-0.4"),
    configurations=(samples("clamped"), samples("fixed 0.1", alpha=0.1)),
    size=SIZE,
    frames=(0, 24),
    skip=8,
    slower=2,
    truth=Truth(64, (22, 23)),
    metrics=("relmse", "flip"),
    stages=STAGES,
    pictures=(23,),
    quick={"size": (96, 54), "frames": (0, 6), "skip": 2, "truth": Truth(32, (5,)), "pictures": (5,)},
)
FIG18 = Experiment(
    name="samplecache-fig18",
    source=f"{SOURCE}, Fig. 18",
    title="A metal and a glass sphere of three roughnesses: how fast the cache is to forget",
    about="Error and flicker of the sample cache where new light counts for at least as much as Appendix C says, which is less the rougher a surface is (clamped: the"
    " default), and where it counts a tenth everywhere (fixed 0.1). GGX's alpha is 0, 0.2 and 0.4 (the scene's folder); the camera slides sideways.",
    plans=(
        SPHERES,
        replace(
            SPHERES, configurations=LADDER[:4], frames=(21, 24), skip=1,
            quick=SPHERES.quick | {"frames": (4, 6), "skip": 1, "configurations": LADDER[:3]},
        ),
    ),
    tables=(Table("Errors, flicker and time", (*ERRORS, FRAME)),),
    plots=(
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("Error", "configuration", "relmse", "bars", y_head="relMSE"),
    ),
    claims=(
        Claim("our method still significantly improves temporal stability over multisampling (4 samples)", "difference", "clamped", "4 spp", high=1.0),
        Claim(
            "caching materials with high roughness is possible without introducing large errors (no more than one sample per pixel has)",
            "relmse", "clamped", "1 spp", high=1.0, scenes=("spheres/alpha-0.4",),
        ),
        Claim("the blending factor controls the tradeoff between variance and bias: kept longer, light flickers less", "difference", "fixed 0.1", "clamped", high=1.0, scenes=("spheres",)),
    ),
    differs="The clamp weighs by how much of what a surface reflects follows the view; diffuse surfaces keep all light in the one configuration, and a tenth of the new in the other,"
    " where the paper has its fixed factor on the spheres alone. Its pictures are of the spheres; here errors are of the whole picture.",
    ladder=RUNGS[:4],
)  # fmt: skip

SPINNING = Sequences(
    scenes=("spinning",),
    configurations=(
        samples("all alike"), samples("fixed 0.1", alpha=0.1), samples("fixed 0.25", alpha=0.25),
        voxels("HashCache", temporal=FILTER), voxels("Hybrid", "hybrid", temporal=FILTER),
    ),
    size=SIZE,
    frames=(0, 24),
    skip=8,
    truth=Truth(64, (15, 22, 23)),
    metrics=("relmse", "flip"),
    stages=STAGES,
    pictures=(23,),
    quick={"size": (96, 54), "frames": (0, 6), "skip": 2, "truth": Truth(32, (5,)), "pictures": (5,)},
)  # fmt: skip
FIG19 = Experiment(
    name="samplecache-fig19",
    source=f"{SOURCE}, Fig. 19",
    title="Things that turn: the light that they keep lags behind",
    about="Error of the sample cache on a cone, a gear wheel, a box and a pipe that turn under a sun, where all light counts alike, and where new light counts a tenth (as in the"
    " paper) or a quarter; beside it HashCache and Hybrid, whose voxels stay where they are, and path tracing.",
    plans=(
        SPINNING,
        replace(
            SPINNING, configurations=LADDER, frames=(21, 24), skip=1, truth=Truth(64, (22, 23)),
            quick=SPINNING.quick | {"frames": (4, 6), "skip": 1, "configurations": LADDER[:3]},
        ),
    ),
    tables=(Table("Errors, flicker and time", (*ERRORS, FRAME)), Table("Samples in a frame", KEPT)),
    plots=(
        Plot("Error", "configuration", "relmse", "bars", log="y", y_head="relMSE"),
        Plot("Error against time", "seconds", "relmse", "points", log="xy", x_head="s per frame", y_head="relMSE"),
    ),
    claims=(
        Claim("object animations can lead to temporal lag in the shading, which a fixed temporal filter bounds", "relmse", "all alike", "fixed 0.1", low=1.0),
        Claim("the faster the cache forgets, the less it lags", "relmse", "fixed 0.1", "fixed 0.25", low=1.0),
    ),
    differs="The paper has a picture and a video, and no numbers. Flicker is the difference to the frame before where the same place is seen, so that whatever turns counts as flicker: it is"
    " the same for all.",
    ladder=RUNGS,
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Section 6: convergence of a still view

RESTING = Sequences(
    scenes=("cornell",),
    configurations=(
        samples("4 samples of 12"),
        samples("8 samples of 12", target=8),
        samples("15 samples of 16", slots=16, target=15),
    ),
    size=(320, 180),
    frames=(0, 64),
    skip=0,
    still=0,
    truth=Truth(256, (0, 3, 15, 63)),
    stages=STAGES,
    pictures=(63,),
    quick={"size": (96, 54), "frames": (0, 16), "truth": Truth(64, (0, 3, 15)), "pictures": (15,)},
)
STILL = Experiment(
    name="samplecache-still",
    source=f"{SOURCE}, section 6",
    title="A view at rest: the cache beside path tracing with as many paths",
    about="relMSE after 1, 4, 16 and 64 frames, in each of which one sample of each pixel is shaded, beside path tracing with 1, 4, 16 and 64 samples; for 4 samples"
    " in each pixel, as usual, and for more, which bound how smooth edges can become.",
    plans=(
        RESTING,
        *(
            replace(
                RESTING, configurations=(paths(n),), frames=(n - 1, n), truth=Truth(256, (n - 1,)), pictures=(n - 1,),
                quick=RESTING.quick
                | {"frames": (n - 1, n), "truth": Truth(64, (n - 1,)), "pictures": (n - 1,)},
            )
            for n in (1, 4, 16)
        ),
        replace(
            RESTING, configurations=(paths(64),), frames=(63, 64), truth=Truth(256, (63,)),
            quick=RESTING.quick | {"frames": (63, 64), "truth": Truth(64, (63,)), "pictures": (63,)},
        ),
    ),
    tables=(Table("Mean error over these frames, and time", (ERRORS[0], FRAME, counter("shaded", "paths in a frame"))),),
    plots=(Plot("Error after so many frames", "frame", "relmse", log="y", x_head="frame", y_head="relMSE"),),
    differs="The paper speaks of practical convergence times and has no figure of them. Path tracing with n samples is shown at frame n - 1, when a cache has shaded as"
    " many.",
)  # fmt: skip

EXPERIMENTS: tuple[Experiment, ...] = (
    *(FIG6, FIG7, FIG8, FIG9, FIG10, FIG12, FIG13, FIG14, FIG15, FIG18, FIG19),
    STILL,
)
