"""What an experiment is: which jobs it has, at real size and at small, and how what they find is shown and judged.

Every experiment is data of the kinds below. Jobs find rows; each row is labelled with the scene and the seed of its job; what belongs
to a configuration in one scene is brought together over frames (times, rays and counters by the median, all else by the mean) for each
seed by itself, and then over seeds, with the standard error of the mean. Tables, plots and claims speak of columns of these.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..errors import SettingError
from .configuration import Configuration
from .job import Job, scene_entry

REFERENCE_SEED = 1000  # and those after it; so far from the seeds of what is measured


@dataclass(frozen=True)
class Labelled:
    """A job, and what its rows are labelled with: scene and seed at least."""

    labels: Mapping[str, object]
    job: Job


def scene_label(name: str, graphs: str | None) -> str:
    """What rows are labelled with as their scene: its folder, and the kind of its graphs where they replace all materials."""
    return f"{name} ({graphs})" if graphs else name


@dataclass(frozen=True)
class Truth:
    """The references of a sequence: path-traced frames, by so many seeds with spp samples each, whose noise cancels in errors."""

    spp: int = 256
    frames: tuple[int, ...] = ()
    seeds: int = 2


@dataclass(frozen=True)
class Sequences:
    """Sequences of frames that configurations render in turn, frame by frame, in one job for each scene and seed.

    kind: of the jobs, which are told the same. scenes: names of folders of data/. skip: frames at the start, in which caches fill, that count
    for nothing. slower: frames for each of the scene's; below 1, those between are left out. still: the scene's frame that all frames show,
    instead of going on. stages: names of passes, of which the seconds are added up as `stage.NAME`. pictures: frames that are kept, to be
    shown. graphs: "memory" or "compute": all materials replaced by graphs of this kind. labels: what rows are labelled with beside scene and
    seed. quick: what is otherwise at small size.
    """

    scenes: tuple[str, ...]
    configurations: tuple[Configuration, ...]
    size: tuple[int, int] = (640, 360)
    frames: tuple[int, int] = (0, 64)
    skip: int = 8
    stereo: bool = False
    slower: float = 1
    still: int | None = None
    truth: Truth | None = None
    metrics: tuple[str, ...] = ("relmse",)
    stages: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    pictures: tuple[int, ...] = ()
    graphs: str | None = None
    labels: Mapping[str, object] = field(default_factory=dict)
    kind: str = "sequence"
    quick: Mapping[str, object] = field(default_factory=dict)

    def jobs(self, data: Path, seeds: Sequence[int], is_quick: bool) -> Iterator[Labelled]:
        """One for each scene and seed. data: the folder that has the scenes'. Raises SceneError."""
        plan = replace(self, **self.quick) if is_quick else self
        for name in plan.scenes:
            scene = scene_entry(data / name / "scene.toml", plan.graphs)
            needs = {f"{of['frame']}/{of['seed']}": Job("reference", of) for of in plan.references(scene)}
            for seed in seeds:
                parameters = {
                    "scene": scene,
                    "configurations": [c.entry() for c in plan.configurations],
                    "size": list(plan.size),
                    "frames": list(plan.frames),
                    "skip": plan.skip,
                    "stereo": plan.stereo,
                    "slower": plan.slower,
                    "still": plan.still,
                    "seed": seed,
                    "metrics": list(plan.metrics),
                    "stages": {stage: list(passes) for stage, passes in plan.stages.items()},
                    "pictures": list(plan.pictures),
                }
                labels = {"scene": scene_label(name, plan.graphs), "seed": seed, **plan.labels}
                yield Labelled(labels, Job(plan.kind, parameters, needs))

    def references(self, scene: Mapping) -> Iterator[dict]:
        """The parameters of the references' jobs: one for each frame and seed."""
        for frame in self.truth.frames if self.truth else ():
            for number in range(self.truth.seeds):
                yield {
                    "scene": scene,
                    "size": list(self.size),
                    "frame": frame,
                    "stereo": self.stereo,
                    "slower": self.slower,
                    "still": self.still,
                    "spp": self.truth.spp,
                    "seed": REFERENCE_SEED + number,
                }


@dataclass(frozen=True)
class Calls:
    """Jobs of any kind, one for each scene and seed and each of the parameters. parameters, quick: what a job is told beside scene and seed.
    scenes: as of Sequences; none for jobs that are about no scene. is_seeded: whether what a job finds depends on a seed, or is a time that
    claims speak of, which has no interval otherwise; if not it is done once, of the first one."""

    kind: str
    parameters: tuple[Mapping[str, object], ...] = ({},)
    scenes: tuple[str, ...] = ()
    quick: tuple[Mapping[str, object], ...] | None = None
    is_seeded: bool = False
    graphs: str | None = None

    def jobs(self, data: Path, seeds: Sequence[int], is_quick: bool) -> Iterator[Labelled]:
        """All of them. data: the folder that has the scenes'. Raises SceneError."""
        told = self.quick if is_quick and self.quick is not None else self.parameters
        for name in self.scenes or (None,):
            entry = {}
            if name is not None:
                entry = {"scene": scene_entry(data / name / "scene.toml", self.graphs)}
            for seed in seeds if self.is_seeded else seeds[:1]:
                own = {"seed": seed} if self.is_seeded else {}
                labels = {"scene": scene_label(name or "", self.graphs), "seed": seed}
                for parameters in told:
                    yield Labelled(labels, Job(self.kind, {**parameters, **entry, **own}))


@dataclass(frozen=True)
class Column:
    """A column of a table. of: the rows' column. head: in words, with the unit. form: of numbers. scale: what they are multiplied by.
    over: the configuration that all are divided by. inverse: whether that one is divided by all instead, as times are for speed-ups."""

    of: str
    head: str
    form: str = ".4g"
    scale: float = 1.0
    over: str | None = None
    inverse: bool = False


@dataclass(frozen=True)
class Table:
    """A table: a line for each value of `by`."""

    title: str
    columns: tuple[Column, ...]
    by: tuple[str, ...] = ("scene", "configuration")


@dataclass(frozen=True)
class Plot:
    """A plot of y by x, a line (or bars) for each value of `by`, a picture for each of `facet`. kind: line, points or bars. log: "", "x", "y" or
    "xy". x: a column, or "frame", for which nothing is brought together over frames. paper: whether the paper's values are drawn as well."""

    title: str
    x: str
    y: str
    kind: str = "line"
    by: str = "configuration"
    facet: str = "scene"
    log: str = ""
    x_head: str = ""
    y_head: str = ""


@dataclass(frozen=True)
class Claim:
    """What the paper says, as a bound on a value. measure: a column. of: the configuration. over: what its value is divided by: another
    configuration, in the same scene, by the same seed. low, high: what is claimed, at least and at most. paper: its own value, if it
    prints one. scenes: where; all, if none are named. It holds where the 95 % interval over seeds lies within, fails where it lies
    without, and is open else."""

    says: str
    measure: str
    of: str
    over: str | None = None
    low: float | None = None
    high: float | None = None
    paper: float | None = None
    scenes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """An experiment. name: as users ask for it. source: paper and place. title, about: what is measured. differs: what is otherwise than in
    the paper. paper: what it prints, as rows with the columns of ours. ladder: configurations of one method with more and more samples, cheapest
    first, beside which all others are set at equal time and at equal error (`error`: which column says that)."""

    name: str
    source: str
    title: str
    about: str
    plans: tuple[Sequences | Calls, ...]
    tables: tuple[Table, ...]
    plots: tuple[Plot, ...] = ()
    claims: tuple[Claim, ...] = ()
    differs: str = ""
    paper: tuple[Mapping[str, object], ...] = ()
    ladder: tuple[str, ...] = ()
    error: str = "relmse"

    def jobs(self, data: Path, seeds: Sequence[int], is_quick: bool = False) -> list[Labelled]:
        """All jobs of all plans, but for what they need. Raises SceneError, SettingError."""
        if not data.is_dir():
            raise SettingError(f"--data {data}: is no folder; expected the project's data/, with the scenes")
        return [labelled for plan in self.plans for labelled in plan.jobs(data, seeds, is_quick)]
