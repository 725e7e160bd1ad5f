"""The tables and figures of "Practical temporal and stereoscopic filtering for real-time ray tracing" (Philippi, Frisvad, Jensen 2023), section 5,
measured here.

The paper's fence is data/fence, its classroom data/classroom, whose camera is a head's, and data/city stands for rungholt, its
flight over a town. Its Cornell box with spheres is data/spheres; data/kitchen, of shining things, stands for its dragon on a glossy plane. Its
TAA keeps a history or discards it: `taa.validation=reject`. DLSS, which is a product, is not here; where the paper joins it with stereo blending, TAA
that clamps histories to their neighbourhood, the default of this project, stands in its place.

RMSE is of linear RGB, as the paper has it, and of values clipped to [0, 1], which fireflies do not dominate; SSIM is of linear values clipped to
[0, 1], and of what a display shows. References have noise of their own, which adds to RMSE: of 512 samples in all it is a
500th of the squared error of one sample. The differences are mean squared ones of radiance: to the frame before (flicker;
what moves in the scene counts, too), and between the eyes, where the references have one, too. Times are the device's, of both eyes.
"""

from dataclasses import replace

from .configuration import Configuration
from .experiment import Calls, Claim, Column, Experiment, Plot, Sequences, Table, Truth

SOURCE = "Philippi, Frisvad, Jensen 2023"

# Every pass of all that is measured here is in exactly one stage.
STAGES = {
    "paths": (
        *("order", "clear", "generate", "trace_camera", "shade", "trace", "shadow", "compact", "finish"),
        *("color_sum", "color"),
    ),
    "temporal": ("surface", "distance", "motion", "lay_out", "filter"),
    "stereo": ("near", "stereo"),
}
METRICS = ("rmse", "rmse_clipped", "ssim", "ssim_display", "relmse")


# ---------------------------------------------------------------------------------------------------------------------
# Configurations


def filtered(name: str, temporal: str, stereo_blend: str = "none", spp: int = 1, **settings: object) -> Configuration:
    """Path tracing and filters. settings: of varianceblend or taa."""
    own = {f"{temporal}.{key}": value for key, value in settings.items()}
    return Configuration(name, "pathtrace", own, spp=spp, temporal=temporal, stereo_blend=stereo_blend)


def plain(spp: int) -> Configuration:
    """Path tracing alone."""
    return filtered(f"{spp} spp", "none", spp=spp)


TAA = filtered("taa", "taa", validation="reject")
OURS = filtered("ours", "varianceblend", estimate="published")
CORRECTED = filtered("corrected", "varianceblend", estimate="corrected")
COMBINED = (
    plain(1),
    CORRECTED,
    filtered("corrected stereo", "varianceblend", "varianceblend", estimate="corrected"),
    OURS,
    filtered("ours stereo", "varianceblend", "varianceblend", estimate="published"),
    filtered("taa", "taa"),
    filtered("taa stereo", "taa", "varianceblend"),
)

# ---------------------------------------------------------------------------------------------------------------------
# Columns

ERRORS = (
    Column("rmse", "RMSE", ".4f"),
    Column("rmse_clipped", "RMSE, clipped", ".4f"),
    Column("ssim", "SSIM", ".4f"),
    Column("ssim_display", "SSIM, display", ".4f"),
    Column("relmse", "relMSE", ".4f"),
)
FLICKER = Column("difference", "flicker", ".3e")
STEREO = (
    Column("stereo", "stereo difference", ".3e"),
    Column("stereo_reference", "the reference's", ".3e"),
)
FRAME = Column("seconds", "frame, ms", ".1f", 1e3)
STAGE_COLUMNS = {stage: Column(f"stage.{stage}", f"{stage}, ms", ".2f", 1e3) for stage in STAGES}

# ---------------------------------------------------------------------------------------------------------------------
# Section 5.1: the temporal filter

SCENES = {"fence": "fence", "classroom": "classroom", "rungholt": "city"}  # the paper's, and ours
RUNGS = (2, 4, 8)
TEMPORAL = Sequences(
    scenes=tuple(SCENES.values()),
    configurations=(plain(1), TAA, OURS, filtered("taa, clamped", "taa"), CORRECTED),
    size=(384, 216),
    frames=(0, 32),
    skip=8,
    truth=Truth(256, (29, 31)),
    metrics=METRICS,
    stages=STAGES,
    pictures=(31,),
    quick={"size": (128, 72), "frames": (0, 6), "skip": 2, "truth": Truth(32, (5,)), "pictures": (5,)},
)


def table1_claims() -> tuple[Claim, ...]:
    """What the table prints of RMSE: ours beside TAA, and beside one sample."""
    printed = {"fence": (0.015, 0.009, 0.006), "classroom": (0.074, 0.048, 0.037), "rungholt": (0.050, 0.032, 0.029)}
    claims = []
    for scene, (one, taa, ours) in printed.items():
        where = (SCENES[scene],)
        claims += [
            Claim(f"{scene}: ours has less RMSE than TAA", "rmse", "ours", "taa", None, 1.0, ours / taa, where),
            Claim(
                f"{scene}: ours has less RMSE than one sample", "rmse", "ours", "1 spp", None, 1.0, ours / one, where
            ),
        ]
    return tuple(claims)


TABLE1 = Experiment(
    name="varianceblend-table1",
    source=f"{SOURCE}, section 5.1, first table",
    title="The temporal filter beside TAA: error over sequences",
    about="RMSE and SSIM of one sample per pixel, by itself, with TAA that keeps or discards the history, and with the weights of Eq. 4; "
    "'ours' has the paper's estimate of them, 'corrected' the one that is this project's default; 'taa, clamped' holds the history within the "
    "range of the 3x3 pixels about. Beside them path tracing with two to eight samples, without a filter.",
    plans=(
        TEMPORAL,
        replace(
            TEMPORAL,
            configurations=tuple(plain(spp) for spp in RUNGS),
            frames=(29, 32),
            skip=0,
            quick=TEMPORAL.quick | {"frames": (4, 6), "skip": 1},
        ),
    ),
    tables=(Table("Errors", (*ERRORS, FLICKER)), Table("Times", (FRAME, *STAGE_COLUMNS.values()))),
    plots=(
        Plot("RMSE", "configuration", "rmse", "bars", y_head="RMSE"),
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("RMSE against time", "seconds", "rmse", "points", log="xy", x_head="s per frame", y_head="RMSE"),
    ),
    claims=(
        *table1_claims(),
        Claim("ours has more SSIM than TAA", "ssim", "ours", "taa", low=1.0),
        Claim("ours has more SSIM than one sample", "ssim", "ours", "1 spp", low=1.0),
        Claim("TAA has less RMSE than one sample", "rmse", "taa", "1 spp", high=1.0),
    ),
    differs="The paper's frames are rasterised or ray traced without noise from paths, but for edges and textures: its RMSE of one sample is 0.015 to 0.074. "
    "Here one sample is that of path tracing, with up to three bounces, whose noise is several times that; so there is more for filters to do. Of the "
    "paper's sequences all frames are compared, here two at the end of 32, at 384x216. city stands for rungholt. The paper prints three "
    "digits, no errors. DLSS, which is in its table (RMSE 0.009, 0.060, 0.033), is not here.",
    paper=tuple(
        {"scene": SCENES[scene], "configuration": name, "rmse": rmse, "ssim": ssim}
        for scene, values in {
            "fence": {"1 spp": (0.015, 0.990), "taa": (0.009, 0.988), "ours": (0.006, 0.997)},
            "classroom": {"1 spp": (0.074, 0.960), "taa": (0.048, 0.985), "ours": (0.037, 0.987)},
            "rungholt": {"1 spp": (0.050, 0.921), "taa": (0.032, 0.967), "ours": (0.029, 0.970)},
        }.items()
        for name, (rmse, ssim) in values.items()
    ),
    ladder=tuple(f"{spp} spp" for spp in (1, *RUNGS)),
    error="rmse",
)

# ---------------------------------------------------------------------------------------------------------------------
# What filters cost, by resolution

DISPLAYS = {"720p": (1280, 720), "1080p": (1920, 1080), "4k": (3840, 2160)}
HEADSETS = {"CV1": (1080, 1200), "Rift S": (1280, 1440), "Quest 1": (1440, 1600)}  # of each eye
# taa and ours, in ms, as the second table prints them; and the stereo blend's, as the third one does.
PRINTED_MS = {
    "720p": (0.12, 0.10),
    "1080p": (0.25, 0.22),
    "4k": (0.96, 0.90),
    "CV1": (0.30, 0.28),
    "Rift S": (0.43, 0.44),
    "Quest 1": (0.54, 0.49),
}
PRINTED_STEREO_MS = {"CV1": 0.31, "Rift S": 0.38, "Quest 1": 0.48}


def direct(configuration: Configuration) -> Configuration:
    """With direct light only: what is filtered costs nothing that counts."""
    return replace(configuration, settings=configuration.settings | {"pathtrace.bounces": 0})


def at(resolution: str, size: tuple[int, int], stereo: bool, *configurations: Configuration) -> Sequences:
    """A few frames at a resolution, whose name their rows have."""
    return Sequences(
        scenes=("fence",),
        configurations=tuple(replace(direct(c), name=f"{resolution} {c.name}") for c in configurations),
        size=size,
        frames=(0, 5),
        skip=2,
        stereo=stereo,
        metrics=(),
        stages=STAGES,
        labels={"resolution": resolution},
        quick={"size": (size[0] // 16, size[1] // 16)},
    )


TABLE2 = Experiment(
    name="varianceblend-table2",
    source=f"{SOURCE}, section 5.1, second table",
    title="What the temporal filters cost, by resolution",
    about="Time of TAA and of the filter with the weights of Eq. 4 on the device, with the passes that give them motion and surfaces, at resolutions of "
    "displays and, of two eyes, of headsets. What is filtered is direct light in data/fence, and does not count.",
    plans=(
        *(at(name, size, False, TAA, OURS) for name, size in DISPLAYS.items()),
        *(at(name, size, True, TAA, OURS) for name, size in HEADSETS.items()),
    ),
    tables=(
        Table(
            "Times",
            (
                STAGE_COLUMNS["temporal"],
                Column("pass.filter", "the filter's pass, ms", ".2f", 1e3),
                Column("stage.paths", "paths, ms", ".1f", 1e3),
            ),
            by=("configuration",),
        ),
    ),
    plots=(Plot("Time of the temporal filter", "configuration", "stage.temporal", "bars", y_head="s", log="y"),),
    claims=tuple(
        Claim(
            f"{name}: the performance of ours is equivalent to that of TAA (within a fifth)",
            "stage.temporal", f"{name} ours", f"{name} taa", 0.8, 1.2, ours / taa,
        )
        for name, (taa, ours) in PRINTED_MS.items()
    ),
    differs="The paper's device is an RTX 3090. It prints 95 % intervals, which are 0.00 to 0.16 ms.",
    paper=tuple(
        {"configuration": f"{name} {filtered}", "stage.temporal": value * 1e-3}
        for name, values in PRINTED_MS.items()
        for filtered, value in zip(("taa", "ours"), values, strict=True)
    ),
)  # fmt: skip

STEREO_ALONE = filtered("stereo", "none", "varianceblend")
TABLE3 = Experiment(
    name="varianceblend-table3",
    source=f"{SOURCE}, section 5.2, table",
    title="What stereo blending costs, by resolution",
    about="Time of the stereo blend on the device, of both eyes, at resolutions of headsets. What is blended is direct light in data/fence, and does not count.",
    plans=tuple(at(name, size, True, STEREO_ALONE) for name, size in HEADSETS.items()),
    tables=(
        Table(
            "Times",
            (STAGE_COLUMNS["stereo"], Column("stage.paths", "paths, ms", ".1f", 1e3)),
            by=("configuration",),
        ),
    ),
    plots=(Plot("Time of the stereo blend", "configuration", "stage.stereo", "bars", y_head="s"),),
    claims=tuple(
        Claim(
            f"{name}: the overhead grows with the pixels (within a quarter), {pixels / first:.2f} times those of CV1",
            "stage.stereo", f"{name} stereo", "CV1 stereo",
            0.75 * pixels / first, 1.25 * pixels / first, PRINTED_STEREO_MS[name] / PRINTED_STEREO_MS["CV1"],
        )
        for first in (HEADSETS["CV1"][0] * HEADSETS["CV1"][1],)
        for name, pixels in ((name, w * h) for name, (w, h) in HEADSETS.items() if name != "CV1")
    ),
    differs="The paper's device is an RTX 3090. It prints 95 % intervals of 0.09 to 0.12 ms. Each resolution is a job of its own here, one after the other: what "
    "else the machine does may be not the same for all.",
    paper=tuple({"configuration": f"{n} stereo", "stage.stereo": ms * 1e-3} for n, ms in PRINTED_STEREO_MS.items()),
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Section 5.2: the stereo blend

FIG5_FRAME = 15
FIG5 = Experiment(
    name="varianceblend-fig5",
    source=f"{SOURCE}, Fig. 5",
    title="Stereo blending of an image of 16 samples: by a constant, and by the weights of Eq. 4",
    about="Error and stereo difference of one frame of both eyes with 16 samples for each pixel, as it is, blended half and half, and blended by the "
    "weights of Eq. 4. A difference that is far from the reference's misleads depth perception.",
    plans=(
        Sequences(
            scenes=("spheres",),
            configurations=(
                plain(16),
                filtered("constant", "none", "constant", spp=16),
                filtered("ours", "none", "varianceblend", spp=16),
            ),
            size=(480, 270),
            frames=(0, 1),
            skip=0,
            stereo=True,
            still=FIG5_FRAME,
            truth=Truth(512, (0,)),
            metrics=METRICS,
            stages=STAGES,
            pictures=(0,),
            quick={"size": (128, 72), "truth": Truth(64, (0,))},
        ),
    ),
    tables=(Table("Errors and stereo difference", (*ERRORS, *STEREO, STAGE_COLUMNS["stereo"])),),
    plots=(
        Plot("RMSE", "configuration", "rmse", "bars", y_head="RMSE"),
        Plot("Stereo difference", "configuration", "stereo", "bars", y_head="mean squared difference"),
    ),
    claims=(
        Claim("adaptive blending lowers the error", "rmse", "ours", "16 spp", high=1.0),
        Claim("the bias of a fixed weight worsens the error (beside that of adaptive blending)", "rmse", "constant", "ours", low=1.0),
        Claim("the stereo difference is improved significantly (by a fifth or more)", "stereo", "ours", "16 spp", high=0.8),
        Claim("a fixed weight takes away differences that tell depth: less than is left by adaptive blending", "stereo", "constant", "ours", high=1.0),
    ),
    differs="The paper prints no numbers here. Its pictures are data/spheres' model; RMSE of unclipped values is mostly that of fireflies, so see the clipped "
    "one as well.",
    error="rmse",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Fig. 6: the estimate beside true moments

FIG6 = Experiment(
    name="varianceblend-fig6",
    source=f"{SOURCE}, Fig. 6",
    title="The stereo blend's estimate of beta beside the beta of true moments",
    about="Many renders of one frame give the moments of 16 samples, and so the beta of Eq. 4: 'reference' by looking up the other eye's moments where the "
    "disparity says, as the paper does; 'resampled' by the moments of what the filter makes of the other eye. 'estimate' is the filter's beta of one "
    "render, 'mean estimate' the mean over several. RMSE is that of renders blended with each of these, "
    "with one half, and with none. White is 1 in the pictures; red is what the other eye does not show.",
    plans=(
        Calls(
            "reference_beta",
            ({"size": [160, 90], "frame": 15, "spp": 16, "renders": 64, "tests": 8},),
            scenes=("spheres",),
            quick=({"size": [96, 54], "frame": 15, "spp": 4, "renders": 12, "tests": 2},),
            is_seeded=True,
        ),
    ),
    tables=(
        Table(
            "Beta, and what it brings",
            (
                Column("beta", "mean beta", ".3f"),
                Column("deviation", "deviation", ".3f"),
                Column("rmse", "RMSE", ".4f"),
                Column("variance", "variance of X, of that looked up", ".3f"),
            ),
        ),
        Table(
            "Estimates beside true moments",
            (
                Column("excess", "mean difference", "+.3f"),
                Column("correlation", "correlation", ".3f"),
                Column("higher", "part of pixels where it is higher", ".3f"),
            ),
        ),
    ),
    plots=(
        Plot("Mean beta", "configuration", "beta", "bars", y_head="beta"),
        Plot("RMSE of 16 samples, blended", "configuration", "rmse", "bars", y_head="RMSE"),
    ),
    claims=(
        Claim("on average beta is higher in the estimate than in the reference", "beta", "estimate", "reference", low=1.0),
        Claim("resampling blurs reprojected samples and so lowers their variance", "variance", "resampled", high=1.0),
        Claim("blending by the estimate lowers the error", "rmse", "estimate", "none", high=1.0),
        Claim("the estimate is better than a fixed weight", "rmse", "estimate", "0.5", high=1.0),
    ),
    differs="The paper prints no numbers here. Compared are the pixels whose point both eyes see. The errors are against the mean of all renders.",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------------------
# Section 5.3: both filters

COMBINED_PLAN = Sequences(
    scenes=("spheres", "kitchen"),
    configurations=COMBINED,
    size=(320, 180),
    frames=(0, 32),
    skip=8,
    stereo=True,
    truth=Truth(256, (15, 31)),
    metrics=METRICS,
    stages=STAGES,
    pictures=(31,),
    quick={
        "size": (96, 54),
        "frames": (0, 6),
        "skip": 2,
        "truth": Truth(32, (5,)),
        "pictures": (5,),
    },
)
# The fourth table's columns; its spheres are data/spheres, data/kitchen stands for its dragon. The estimates are the paper's.
PRINTED = {
    "spheres": {"1 spp": (0.071, 0.591), "ours": (0.023, 0.910), "ours stereo": (0.016, 0.958)},
    "kitchen": {"1 spp": (0.046, 0.749), "ours": (0.018, 0.960), "ours stereo": (0.017, 0.980)},
}
COMBINED_DIFFERS = (
    "data/kitchen stands for the dragon on a glossy plane, with noisier light: more of it comes after several bounces. Of the paper's sequences all frames "
    "are compared, here two of 32. DLSS, which the paper joins with stereo blending as well (RMSE 0.017 without and 0.016 with it, and "
    "0.020 and 0.021), is not here; TAA that clamps histories is in its place. Path tracing's fireflies dominate RMSE of unclipped values; see the clipped one."
)
TABLE4 = Experiment(
    name="varianceblend-table4",
    source=f"{SOURCE}, section 5.3, table",
    title="Temporal filter and stereo blend together: error over sequences",
    about="RMSE and SSIM of one sample per pixel with the temporal filter, and with the stereo blend on top of it; with the paper's estimate of the temporal "
    "weights ('ours'), with the one that is this project's default ('corrected'), and with TAA.",
    plans=(COMBINED_PLAN,),
    tables=(Table("Errors", ERRORS), Table("Differences and times", (FLICKER, *STEREO, FRAME, *STAGE_COLUMNS.values()))),
    plots=(
        Plot("RMSE, clipped", "configuration", "rmse_clipped", "bars", y_head="RMSE of values in [0, 1]"),
        Plot("SSIM", "configuration", "ssim", "bars", y_head="SSIM"),
        Plot("Flicker", "frame", "difference", log="y", x_head="frame", y_head="mean squared difference"),
    ),
    claims=(
        *(
            Claim(f"{says} ({scene})", "rmse", of, over, None, 1.0, PRINTED[scene][of][0] / PRINTED[scene][over][0], (scene,))
            for scene in PRINTED
            for says, of, over in (
                ("the temporal filter has less RMSE than none", "ours", "1 spp"),
                ("stereo blending lowers it again", "ours stereo", "ours"),
            )
        ),
        Claim("the temporal filter has more SSIM than none", "ssim", "ours", "1 spp", low=1.0),
        Claim("stereo blending raises SSIM", "ssim", "ours stereo", "ours", low=1.0),
        Claim("stereo blending raises SSIM after the corrected estimate", "ssim", "corrected stereo", "corrected", low=1.0),
        Claim("with another filter (there DLSS, here TAA), the error's reduction by stereo blending is low: a tenth at most", "rmse", "taa stereo", "taa", 0.9, 1.0),
    ),
    differs=COMBINED_DIFFERS,
    paper=tuple(
        {"scene": scene, "configuration": name, "rmse": rmse, "ssim": ssim}
        for scene, values in PRINTED.items()
        for name, (rmse, ssim) in values.items()
    ),
    error="rmse",
)  # fmt: skip

FIG7 = Experiment(
    name="varianceblend-fig7",
    source=f"{SOURCE}, Fig. 7",
    title="Temporal filter and stereo blend together: closeups, stereo differences and frame times",
    about="The sequences of the fourth table: pictures with closeups, mean frame times, and the difference between the eyes beside that of the references.",
    plans=(COMBINED_PLAN,),
    tables=(
        Table("Frame times", (FRAME, Column("device", "device, ms", ".1f", 1e3), *STAGE_COLUMNS.values())),
        Table("Stereo differences", (*STEREO, Column("stereo", "of that of one sample", ".3f", over="1 spp"))),
    ),
    plots=(
        Plot("Stereo difference", "frame", "stereo", log="y", x_head="frame", y_head="mean squared difference"),
        Plot("Frame time", "configuration", "seconds", "bars", y_head="s"),
    ),
    claims=(
        *(
            Claim(f"stereo blending brings the eyes nearer to each other ({name})", "stereo", f"{name} stereo", name, high=1.0)
            for name in ("ours", "corrected", "taa")
        ),
        Claim("stereo blending is cheap beside rendering (a tenth at most)", "seconds", "ours stereo", "ours", high=1.1),
    ),
    differs=COMBINED_DIFFERS + " The paper prints frame times within its pictures, of an RTX 3090.",
    error="rmse",
)  # fmt: skip

EXPERIMENTS = (TABLE1, TABLE2, TABLE3, TABLE4, FIG5, FIG6, FIG7)
