"""Mitsuba 3 at its best beside clcache: the same sequences in stereo, raw and denoised, in the same time.

What is best for Mitsuba was measured on the scenes of the experiment, on one thread of a processor, by error at equal time:

- The variant llvm_ad_rgb; the scene with few shapes (`mitsuba_export`), loaded once; both eyes side by side in one launch (a `batch` sensor),
  whose cameras are moved; and the launch recorded once (`drjit.freeze`), as tracing its Python anew for each frame costs from 20 ms to,
  with the classroom's materials, half of the time.
- The sampler multijitter: with 4 and 16 samples it errs as much as independent does in the same time, or up to a quarter less;
  orthogonal and ldsampler, which take none but some numbers of samples, are no better; with one sample all are the same.
- Roulette from the fifth segment on, as it is by default: earlier it costs as much error as it saves time.
- Open Image Denoise by colour, albedo and normals, the latter two from a launch of their own with AUXILIARY samples, which costs a tenth
  of what they cost together with the paths. Without them, by colour alone, errors are from a quarter to twice as large; denoising them
  first, or taking them for clean, selects a network that takes more time than another sample does, and gains less.

Both renderers take the same paths, up to the number of bounces that the scene says, and both are held against their own truth: what
Mitsuba renders with many samples, for Mitsuba; so that surfaces that the two understand differently count for neither. Mitsuba is measured with
several numbers of samples. Of these the cheapest that takes no less time than a configuration of clcache is set beside it, so that
Mitsuba is given at least as much.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from types import ModuleType

import numpy as np

from .. import settings as settings_module
from ..bvh.tracer import Tracer
from ..errors import Error
from ..passes.denoise import Denoiser
from ..renderer import Frame
from ..scene.model import Camera, Scene
from ..scene.motion import pose_at
from ..scene.transform import rigid
from .configuration import Configuration
from .experiment import Claim, Column, Experiment, Labelled, Plot, Sequences, Table, Truth
from .job import Job, Machine, Result, open_scene
from .reference import timeline
from .sequence import EYES, Depths, Judge, alternating, measured, of_memory, reference_pictures, references_of

RAW, DENOISED = "mitsuba", "mitsuba + OIDN"
ROULETTE = 5  # the segment from which on Mitsuba's paths may end, unless it is told otherwise
SAMPLER = "multijitter"
AUXILIARY = 4  # samples of albedo and normals for each pixel
ROUND = 16  # samples for each pixel that a launch of a reference takes: memory is in proportion


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Render all frames by clcache's configurations and by Mitsuba in turn: rows as of `sequence.run`, but that metrics are against
    the renderer's own truth, and `other.METRIC` against the other's; and, for each configuration, rows of what of Mitsuba is set beside it.

    parameters: as of `sequence.run`, in stereo; spp: Mitsuba's samples for each pixel, several. needed: references by
    ours/FRAME/SEED and theirs/FRAME/SEED. Raises SceneError, SettingError, DeviceError, Error.
    """
    told = parameters
    scene, offset = timeline(open_scene(told["scene"]), told["slower"], told["still"])
    first, last = told["frames"]
    counted, size, device = first + told["skip"], tuple(told["size"]), machine.open()
    ours = {
        c.name: c.renderer(scene, size, True, told["seed"], machine.device, machine.threads)
        for c in map(Configuration.of, told["configurations"])
    }
    mitsuba = Mitsuba(scene, size, device.threads)
    theirs = {
        f"{name} {spp} spp": Peer(mitsuba, spp, told["seed"], denoiser)
        for name, denoiser in ((RAW, None), (DENOISED, Denoiser(device.threads)))
        for spp in told["spp"]
    }
    truth = {
        whose: references_of({n.removeprefix(f"{whose}/"): r for n, r in needed.items() if n.startswith(f"{whose}/")})
        for whose in ("ours", "theirs")
    }
    judges = {
        name: TwoTruths(*(Judge(truth[whose], told["metrics"], counted) for whose in order))
        for names, order in ((ours, ("ours", "theirs")), (theirs, ("theirs", "ours")))
        for name in names
    }
    frames = alternating(ours | theirs, first + offset, last + offset)
    depths = Depths(Tracer(scene, device))
    rows, arrays = measured(frames, offset, counted, judges, depths, told["stages"], told["pictures"])
    for row in rows:
        name = row["configuration"]
        row |= of_memory(ours[name]) if name in ours else {"spp": theirs[name].spp}
    beside = set_beside(rows, list(ours), list(theirs))
    rows += [row | {"configuration": name} for name, of in beside.items() for row in rows if row["configuration"] == of]
    for name, of in beside.items():
        same = {n: a for n, a in arrays.items() if n.split("/")[1] == of}
        arrays |= {n.replace(f"/{of}/", f"/{name}/"): a for n, a in same.items()}
    return Result(rows, arrays | reference_pictures(truth["ours"], told["pictures"]))


def set_beside(rows: Sequence[Mapping], ours: Sequence[str], theirs: Sequence[str]) -> dict[str, str]:
    """What of Mitsuba is set beside each configuration, raw and denoised: the cheapest that takes no less time, by the median of the
    frames that count. By the name that it gets there; where all take less, there is none."""
    seconds = {
        name: median(r["seconds"] for r in rows if r["counted"] and r["configuration"] == name)
        for name in (*ours, *theirs)
    }
    found = {}
    for name in ours:
        for kind in (RAW, DENOISED):
            enough = [n for n in theirs if n.startswith(f"{kind} ") and n[len(kind) + 1].isdigit()]
            enough = [n for n in enough if seconds[n] >= seconds[name]]
            if enough:
                found[beside(kind, name)] = min(enough, key=seconds.__getitem__)
    return found


def beside(kind: str, name: str) -> str:
    """What Mitsuba is called where it is set beside a configuration."""
    return f"{kind} beside {name}"


def run_reference(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """One frame by Mitsuba with many samples: arrays by eye, (H, W, 3) float32. parameters: as of `reference.run`. Raises SceneError,
    SettingError, DeviceError, Error."""
    told = parameters
    scene, offset = timeline(open_scene(told["scene"]), told["slower"], told["still"])
    number = told["frame"] + offset
    mitsuba = Mitsuba(scene, tuple(told["size"]), machine.open().threads)
    start = time.perf_counter()
    total, done = np.zeros((), np.float64), 0
    while done < told["spp"]:
        spp = min(ROUND, told["spp"] - done)
        cameras = eye_cameras(scene, number / scene.defaults.fps)
        total = total + spp * mitsuba.color(cameras, spp, _random(told["seed"], number, done)).astype(np.float64)
        done += spp
    row = {"frame": told["frame"], "spp": told["spp"], "seconds": time.perf_counter() - start}
    return Result([row], split((total / done).astype(np.float32)))


@dataclass
class TwoTruths:
    """A judge by a renderer's own references, who also says how far it is from the other's."""

    own: Judge
    other: Judge

    def judge(self, number: int, color: Mapping[str, np.ndarray], views: Sequence) -> dict[str, float]:
        """As of `Judge`."""
        of_other = self.other.judge(number, color, views)
        names = {*self.other.metrics, "relmse_error"}
        return self.own.judge(number, color, views) | {f"other.{n}": v for n, v in of_other.items() if n in names}


# ---------------------------------------------------------------------------------------------------------------------
# Mitsuba


class Mitsuba:
    """A scene in Mitsuba, of which it renders two eyes at once. size: of each. Raises SceneError, and Error where there is no Mitsuba."""

    def __init__(self, scene: Scene, size: tuple[int, int], threads: int) -> None:
        self.scene = scene
        self._export, self._mi, self._dr = _modules()
        self._export.set_llvm_variant(threads)
        bounces = settings_module.resolve(scene.defaults.settings, {})["pathtrace.bounces"]
        self._world = self._export.to_mitsuba(scene, size, 1, bounces)
        paths = self._export.integrator(scene, bounces, ROULETTE)
        self._paths = self._mi.load_dict(paths)
        self._auxiliary = self._mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
        self._size = size
        self._launches: dict[tuple[object, int], tuple] = {}

    def color(self, cameras: Mapping[str, Camera], spp: int, seed: int) -> np.ndarray:
        """(H, 2 W, 3) float32: radiance, the eyes side by side."""
        return self._render(self._paths, cameras, spp, seed)

    def auxiliary(self, cameras: Mapping[str, Camera], spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Albedo in 0 .. 1 and normals, as of `color`."""
        both = self._render(self._auxiliary, cameras, spp, seed)
        return np.clip(both[..., :3], 0.0, 1.0), both[..., 3:]

    def _render(self, integrator: object, cameras: Mapping[str, Camera], spp: int, seed: int) -> np.ndarray:
        mi = self._mi
        if (integrator, spp) not in self._launches:
            self._launches[integrator, spp] = self._launch(integrator, cameras, spp)
        launch, sensor, parameters, places = self._launches[integrator, spp]
        for place, camera in zip(places, cameras.values(), strict=True):
            parameters[place] = mi.Transform4f(self._export.to_world(camera))
        parameters.update()
        return np.array(launch(self._world, sensor, mi.UInt32(seed)), np.float32)

    def _launch(self, integrator: object, cameras: Mapping[str, Camera], spp: int) -> tuple:
        """What renders so many samples; its sensor, with that one's parameters, and which of them are the eyes' places."""
        sampler = {"type": SAMPLER, "sample_count": spp}
        described = self._export.side_by_side(self.scene, list(cameras.values()), self._size, sampler)
        # Of two views that are alike only one would be kept.
        sensor = self._mi.load_dict(described, optimize=False)
        parameters = self._mi.traverse(sensor)
        places = [name for name, _ in parameters if name.endswith("to_world")]

        def render(world, sensor, seed):
            return integrator.render(world, sensor=sensor, seed=seed, spp=spp)

        return self._dr.freeze(render), sensor, parameters, places


def _modules() -> tuple[ModuleType, ModuleType, ModuleType]:
    """What exports scenes, Mitsuba, and its compiler."""
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise Error(
            f"experiment mitsuba: needs the package mitsuba ({error}); to install it: pip install mitsuba"
        ) from None
    from . import mitsuba_export

    return mitsuba_export, mitsuba, drjit


@dataclass
class Peer:
    """Frames by Mitsuba, with so many samples for each pixel."""

    mitsuba: Mitsuba
    spp: int
    seed: int
    denoiser: Denoiser | None = None

    def frames(self, begin: int, end: int) -> Iterator[Frame]:
        """Frames begin .. end - 1, with the wall clock's time for both eyes."""
        scene = self.mitsuba.scene
        for number in range(begin, end):
            start = time.perf_counter()
            cameras = eye_cameras(scene, number / scene.defaults.fps)
            color = self.mitsuba.color(cameras, self.spp, _random(self.seed, number, 0))
            if self.denoiser:
                auxiliary = self.mitsuba.auxiliary(cameras, AUXILIARY, _random(self.seed, number, 1))
                eyes = zip(*(split(picture).values() for picture in (np.maximum(color, 0.0), *auxiliary)), strict=True)
                colors = dict(zip(EYES, (self.denoiser(*pictures) for pictures in eyes), strict=True))
            else:
                colors = split(color)
            stats = {"frame": number, "seconds": time.perf_counter() - start, "eyes": {}}
            yield Frame(number, colors, cameras, stats, {})


def split(both: np.ndarray) -> dict[str, np.ndarray]:
    """The eyes' pictures of two side by side."""
    return dict(zip(EYES, np.split(both, 2, axis=1), strict=True))


def eye_cameras(scene: Scene, seconds: float) -> dict[str, Camera]:
    """The eyes' cameras at a time: moved along the head's x axis, looking in parallel, as `Renderer` has them."""
    camera = scene.camera
    place = rigid(pose_at(camera.motion, seconds)) if camera.motion else np.array(camera.transform, np.float64)
    aside = 0.5 * scene.defaults.eye_distance * np.outer(place[:, 0], [0, 0, 0, 1])
    return {
        eye: replace(camera, transform=place + side * aside, motion=()) for eye, side in zip(EYES, (-1, 1), strict=True)
    }


def _random(*key: int) -> int:
    """A seed for each key."""
    return int(np.random.SeedSequence(key).generate_state(1)[0])


# ---------------------------------------------------------------------------------------------------------------------
# The experiment


@dataclass(frozen=True)
class Beside(Sequences):
    """Sequences that Mitsuba renders as well. spp: its samples for each pixel, in turn; by each it is both raw and denoised."""

    spp: tuple[int, ...] = (1, 2, 4, 6)
    stereo: bool = field(default=True, init=False)

    def jobs(self, data: Path, seeds: Sequence[int], is_quick: bool) -> Iterator[Labelled]:
        """One for each scene and seed. Raises SceneError."""
        spp = self.quick.get("spp", self.spp) if is_quick else self.spp
        for labelled in super().jobs(data, seeds, is_quick):
            job = labelled.job
            ours = {f"ours/{name}": of for name, of in job.needs.items()}
            theirs = {f"theirs/{name}": Job("mitsuba_reference", of.parameters) for name, of in job.needs.items()}
            parameters = {**job.parameters, "spp": list(spp)}
            yield Labelled(labelled.labels, Job("mitsuba", parameters, ours | theirs))


SCENES = ("atrium", "classroom", "kitchen")
SPP = (1, 2, 4, 6)
# Each with the filters that are made for it, and all else as it is by default.
OURS = (
    Configuration("pathtrace, filtered", "pathtrace", spp=1, temporal="varianceblend", stereo_blend="varianceblend"),
    Configuration("samplecache", "samplecache", temporal="varianceblend", stereo_blend="samples"),
    Configuration("octree", "octree", temporal="varianceblend"),
)
METRICS = {
    "relmse": "relMSE against its own truth",
    "flip": "FLIP against its own truth",
    "difference": "difference between frames",
    "stereo": "difference between eyes",
}


# That each configuration is better than what of Mitsuba takes as long.
CLAIMS = tuple(
    Claim(
        f"{c.name}: {METRICS[measure]} is lower than that of {kind} in the same time",
        measure,
        c.name,
        beside(kind, c.name),
        high=1.0,
    )
    for kind in (RAW, DENOISED)
    for measure in ("difference", "stereo", "relmse")
    for c in OURS
)


EXPERIMENTS = (
    Experiment(
        name="mitsuba",
        source="Mitsuba 3, Open Image Denoise",
        title="Beside Mitsuba 3, raw and denoised, in the same time",
        about=(
            "Sequences in stereo by three of clcache's methods, and by Mitsuba 3 (LLVM) with its best settings, raw and denoised by Intel's Open "
            "Image Denoise with albedo and normals. Errors are against each renderer's own truth, so that surfaces which the two understand "
            "differently count for neither; what they are against the other's stands beside. Times are the wall clock's for both eyes, on the "
            "same threads, in turn. 'mitsuba beside X' is the cheapest of Mitsuba's numbers of samples that takes no less time than X; where it "
            "is missing, X takes longer than all of them."
        ),
        differs=(
            "Surfaces between metal, glass and matt are Mitsuba's 'principled', which is alike and not the same; metal has one reflectance for "
            "all angles; normal maps are left out; pictures have no mip levels; the truths differ by as much."
        ),
        plans=(
            Beside(
                SCENES,
                OURS,
                size=(320, 180),
                frames=(0, 24),
                skip=8,
                truth=Truth(128, (15, 23)),
                metrics=("relmse", "flip"),
                pictures=(23,),
                spp=SPP,
                quick={
                    "scenes": ("kitchen",),
                    "size": (96, 54),
                    "frames": (0, 4),
                    "skip": 2,
                    "truth": Truth(16, (3,)),
                    "pictures": (3,),
                    "spp": (1, 2, 4),
                },
            ),
        ),
        tables=(
            Table(
                "Both renderers",
                (
                    Column("seconds", "ms per stereo frame", ".1f", 1e3),
                    Column("spp", "Mitsuba's samples", ".0f"),
                    *(Column(name, head) for name, head in METRICS.items()),
                    Column("stereo_reference", "truth's difference between eyes"),
                    Column("other.relmse", "relMSE against the other's truth"),
                    Column("other.flip", "FLIP against the other's truth"),
                ),
            ),
        ),
        plots=tuple(
            Plot(head, "seconds", name, kind="points", log="xy", x_head="seconds per stereo frame", y_head=head)
            for name, head in METRICS.items()
        ),
        claims=CLAIMS,
        ladder=tuple(f"{DENOISED} {spp} spp" for spp in SPP),
    ),
)
