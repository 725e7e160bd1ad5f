"""The trade of speed for accuracy in one scene: configurations of all methods, each measured by a job, and what is best of them.

What can be chosen: the settings that have values to try (`Setting.trade`), and the options of a render beside them. A configuration is a
point of that space. Those that are measured are, in this order and always the same: each method as it is by default; the same with one
thing changed, which tells how much each matters; points spread over the whole space by a scrambled Sobol sequence, for what only
several changes together bring; and on request points near the best so far, which a tree-structured Parzen estimator proposes (Bergstra
et al. 2011; for several objectives Ozaki et al. 2020). A point is put into its shortest form first, without what has no effect in it, so that none
is measured twice.

Each job renders its configuration and path tracing with one sample for each pixel in turn, frame by frame, so that times can be told as
multiples of that one's, whatever the machine did meanwhile.
"""

import hashlib
import importlib.util
import itertools
import json
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from ..errors import Error, SettingError
from ..metrics.image import METRICS as IMAGE_METRICS
from ..passes.denoise import PACKAGE as DENOISER
from ..settings import CACHED_METHODS, DEFAULT_TEMPORALS, MEMOS, SETTINGS, STEREO_BLENDS, TEMPORALS, resolve
from . import sequence
from .configuration import Configuration
from .experiment import Sequences, Truth
from .job import Job, Machine, Result, open_scene

METHODS = ("pathtrace", *CACHED_METHODS)
# What a configuration is judged by, lower being better, beside its time: by name, in words.
METRICS = {
    "relmse": "relMSE",
    "flip": "FLIP",
    "flicker": "difference between frames",
    "stereo": "difference between eyes",
    "memory": "memory in bytes",
}
DEFAULT, CHANGE, SPREAD, REFINED = "default", "change", "spread", "refined"  # where a configuration is from

# Beside the settings: samples of each pixel, or updates of a cache.
_SPP = {"pathtrace": (1, 2, 4, 8)} | dict.fromkeys(CACHED_METHODS, (1, 2))
# Which settings a method reads, by the beginnings of their names, and which of those it does not.
_READS = {
    "pathtrace": ("pathtrace.",),
    "samplecache": ("pathtrace.", "samplecache."),
    "isrt": ("pathtrace.", "isrt.", "samplecache."),
    "voxelhash": ("pathtrace.", "voxelhash."),
    "hybrid": ("pathtrace.", "voxelhash.", "samplecache."),
    "octree": ("pathtrace.", "octree."),
}
_OF_ALL = ("temporal.", "taa.", "varianceblend.", "stereo.", "memo.", "device.")
_IGNORES = {
    "isrt": ("samplecache.slots",),
    "hybrid": (
        "samplecache.shading",
        "samplecache.shading_rate",
        "samplecache.demodulate",
        "samplecache.sharpness",
        "voxelhash.jitter",
        "voxelhash.inherit",
    ),
}
_HAS_SAMPLES = ("samplecache", "isrt")  # methods whose samples a stereo blend can share
# What has an effect only where one of these has one of these values, by the beginning of its name.
_NEEDS: dict[str, dict[str, tuple]] = {
    "temporal.": {"temporal": ("taa", "varianceblend")},
    "taa.": {"temporal": ("taa",)},
    "taa.gamma": {"taa.validation": ("clip",)},
    "varianceblend.": {"temporal": ("varianceblend",), "stereo_blend": ("varianceblend",)},
    "varianceblend.estimate": {"temporal": ("varianceblend",)},
    "stereo.": {"stereo_blend": ("constant",)},
    "samplecache.sharpness": {"stereo_blend": ("samples",)},
    "octree.layered": {"octree.filter": ("bilateral", "oidn")},
    "memo.": {"memo": ("texel", "tile")},
    "memo.tile": {"memo": ("tile",)},
    "memo.filter": {"memo": ("tile",)},
}
_OPTIONS = ("spp", "temporal", "stereo_blend", "memo")  # fields of a Configuration
_YARDSTICK = Configuration("yardstick", "pathtrace")
_OWN = "own"
REFINE_BATCH = 8  # proposed at once; the same whatever the number of workers, on which results must not depend
_TRUTH = Truth(spp=64, seeds=2)
_TRUE_FRAMES = 5  # of those that count, as many have references

Point = Mapping[str, object]  # the value of each thing that can be chosen, by its name


# ---------------------------------------------------------------------------------------------------------------------
# The space


@dataclass(frozen=True)
class Choice:
    """A thing that can be chosen: an option or a setting, what it can be, and what it is by default."""

    name: str
    values: tuple
    default: object


@dataclass(frozen=True)
class Space:
    """What can be chosen of a method, options first."""

    method: str
    choices: tuple[Choice, ...]

    @property
    def default(self) -> dict[str, object]:
        """The point that has all defaults."""
        return {choice.name: choice.default for choice in self.choices}

    def at(self, indices: Iterable[int]) -> dict[str, object]:
        """The point that has these of the choices' values."""
        return {choice.name: choice.values[i] for choice, i in zip(self.choices, indices, strict=True)}

    def indices(self, point: Point) -> list[int]:
        """Which of the choices' values a point has."""
        return [choice.values.index(point[choice.name]) for choice in self.choices]

    def configuration(self, point: Point) -> Configuration:
        """A point in its shortest form: without settings that have no effect there, or that are as by default. What graphs return is
        always kept where that is asked for, as `memo.auto` would choose by measured times."""
        has_effect = {choice.name for choice in self.choices if _has_effect(choice.name, point)}
        settings = {
            c.name: point[c.name]
            for c in self.choices
            if c.name not in _OPTIONS and c.name in has_effect and point[c.name] != c.default
        }
        if point["memo"] != "off":
            settings["memo.auto"] = False
        return Configuration(_OWN, self.method, settings, *(point[name] for name in _OPTIONS))


def space(method: str, defaults: Mapping[str, object], is_stereo: bool, has_graphs: bool) -> Space:
    """What can be chosen of a method. defaults: all settings, as the scene has them. has_graphs: whether the scene does."""
    blends = STEREO_BLENDS if method in _HAS_SAMPLES else tuple(b for b in STEREO_BLENDS if b != "samples")
    options = (
        Choice("spp", _SPP[method], 1),
        Choice("temporal", TEMPORALS, DEFAULT_TEMPORALS.get(method, "none")),
        Choice("stereo_blend", blends if is_stereo else blends[:1], "none"),
        Choice("memo", MEMOS if has_graphs else MEMOS[:1], "off"),
    )
    read = (*_READS[method], *_OF_ALL)
    known = {choice.name: choice.values for choice in options}
    chosen = []
    for setting in SETTINGS.values():
        if setting.trade and setting.name.startswith(read) and setting.name not in _IGNORES.get(method, ()):
            values = (*setting.trade, *({defaults[setting.name]} - set(setting.trade)))
            if setting.name == "octree.filter" and importlib.util.find_spec(DENOISER) is None:
                values = tuple(v for v in values if v != "oidn")
            if _can_have_effect(setting.name, known):
                known[setting.name] = values
                chosen.append(Choice(setting.name, values, defaults[setting.name]))
    return Space(method, (*options, *chosen))


def spaces(methods: Sequence[str], scene_settings: Mapping, is_stereo: bool, has_graphs: bool) -> list[Space]:
    """Those of several methods. Raises SettingError."""
    for method in methods:
        if method not in METHODS:
            raise SettingError(f"--methods {method}: unknown; expected some of {', '.join(METHODS)}")
    return [space(method, resolve(scene_settings), is_stereo, has_graphs) for method in methods]


def _needs(name: str) -> Iterator[Mapping[str, tuple]]:
    return (needed for prefix, needed in _NEEDS.items() if name.startswith(prefix))


def _has_effect(name: str, point: Point) -> bool:
    return all(any(point.get(n) in values and _has_effect(n, point) for n, values in of.items()) for of in _needs(name))


def _can_have_effect(name: str, known: Mapping[str, tuple]) -> bool:
    return all(any(set(known.get(n, ())) & set(values) for n, values in of.items()) for of in _needs(name))


# ---------------------------------------------------------------------------------------------------------------------
# What is tried


@dataclass(frozen=True)
class Trial:
    """A configuration to measure. origin: DEFAULT, CHANGE, SPREAD or REFINED. changed: of a CHANGE, what. base: the configuration
    without it."""

    space: Space
    point: Point
    origin: str
    changed: str | None = None
    base: "Configuration | None" = None

    @property
    def configuration(self) -> Configuration:
        """In its shortest form."""
        return self.space.configuration(self.point)


def trials(found: Sequence[Space], seed: int, count: int) -> list[Trial]:
    """The first of those that are always the same: no two of the same configuration; one of each method in turn, while there are any."""
    every = [
        _in_turn([_default(of) for of in found]),
        _in_turn([_changes(of, is_first=not number) for number, of in enumerate(found)]),
        _in_turn([_spread(of, seed, number) for number, of in enumerate(found)]),
    ]
    chosen: dict[str, Trial] = {}
    for trial in itertools.chain(*every):
        if len(chosen) == count:
            break
        chosen.setdefault(identity(trial.configuration), trial)
    return list(chosen.values())


def identity(configuration: Configuration) -> str:
    """Short, and the same for the same configuration only, whatever its name is."""
    entry = configuration.entry() | {"name": ""}
    return f"{configuration.method}-{hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:8]}"


def _in_turn(several: Sequence[Iterator[Trial]]) -> Iterator[Trial]:
    for row in itertools.zip_longest(*several):
        yield from (trial for trial in row if trial is not None)


def _default(of: Space) -> Iterator[Trial]:
    yield Trial(of, of.default, DEFAULT)


def _changes(of: Space, is_first: bool) -> Iterator[Trial]:
    """One thing changed. What has no effect by default is changed where it has one; of filters of images and memoization, which are the
    same for all methods, only with the first method. That is path tracing, if it is tried: its images need filters the most."""
    for choice in of.choices:
        base = of.default
        if not _has_effect(choice.name, base):
            if choice.name.startswith(_OF_ALL) and not is_first:
                continue
            base = _with_effect(choice.name, base, {c.name: c.values for c in of.choices})
        for value in choice.values:
            if value != choice.default:
                yield Trial(of, base | {choice.name: value}, CHANGE, choice.name, of.configuration(base))


def _with_effect(name: str, point: Point, known: Mapping[str, tuple]) -> dict[str, object]:
    """The point with the first values that give a choice its effect."""
    found = dict(point)
    for of in _needs(name):
        if not any(found.get(n) in values for n, values in of.items()):
            n, value = next((n, v) for n, values in of.items() for v in values if v in known.get(n, ()))
            found = _with_effect(n, found | {n: value}, known)
    return found


def _spread(of: Space, seed: int, number: int) -> Iterator[Trial]:
    from scipy.stats import qmc

    sizes = np.array([len(choice.values) for choice in of.choices])
    most = int(min(np.prod(sizes.astype(float)), 4096))  # beyond which nobody will wait
    sampler = qmc.Sobol(len(sizes), scramble=True, rng=np.random.default_rng([seed, number]))
    for unit in sampler.random_base2(max(most - 1, 1).bit_length()):
        yield Trial(of, of.at((unit * sizes).astype(int)), SPREAD)


class Search:
    """Proposes configurations near the best so far, by time and one metric. What it proposes depends on the seed and on what it was told."""

    def __init__(self, found: Sequence[Space], seed: int) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna, self._spaces = optuna, {of.method: of for of in found}
        sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=0)
        self._study = optuna.create_study(directions=["minimize", "minimize"], sampler=sampler)

    def tell(self, trial: Trial, values: tuple[float, float] | None) -> None:
        """What a trial has found: time and error; None where it failed."""
        params = {"method": trial.space.method}
        distributions = {"method": self._optuna.distributions.CategoricalDistribution(list(self._spaces))}
        for choice, index in zip(trial.space.choices, trial.space.indices(trial.point), strict=True):
            name = f"{trial.space.method}/{choice.name}"
            params[name] = index
            distributions[name] = self._optuna.distributions.IntDistribution(0, len(choice.values) - 1)
        state = self._optuna.trial.TrialState.FAIL if values is None else self._optuna.trial.TrialState.COMPLETE
        told = self._optuna.trial.create_trial(
            state=state, params=params, distributions=distributions, values=None if values is None else list(values)
        )
        self._study.add_trial(told)

    def ask(self) -> Trial:
        """The next to try."""
        asked = self._study.ask()
        of = self._spaces[asked.suggest_categorical("method", list(self._spaces))]
        indices = [asked.suggest_int(f"{of.method}/{c.name}", 0, len(c.values) - 1) for c in of.choices]
        self._study.tell(
            asked, state=self._optuna.trial.TrialState.FAIL
        )  # what it finds is told by `tell`, as of any other
        return Trial(of, of.at(indices), REFINED)


# ---------------------------------------------------------------------------------------------------------------------
# The jobs


@dataclass(frozen=True)
class Conditions:
    """Under which all configurations are measured. scene: the entry of a job. frames: the first and the one behind the last. skip: those at the
    start that count for nothing."""

    scene: Mapping
    size: tuple[int, int]
    frames: tuple[int, int]
    skip: int
    is_stereo: bool
    seed: int

    def job(self, configuration: Configuration) -> Job:
        """That of a configuration."""
        is_flip = IMAGE_METRICS["flip"].installed
        parameters = {
            "scene": self.scene,
            "configuration": replace(configuration, name=_OWN).entry(),
            "size": list(self.size),
            "frames": list(self.frames),
            "skip": self.skip,
            "stereo": self.is_stereo,
            "seed": self.seed,
            "metrics": ["relmse", *(["flip"] if is_flip else [])],
        }
        return Job("tradeoff", parameters, self._references())

    def _references(self) -> dict[str, Job]:
        first, last = self.frames[0] + self.skip, self.frames[1]
        frames = tuple(sorted(set(np.linspace(first, last - 1, _TRUE_FRAMES).round().astype(int).tolist())))
        plan = Sequences((), (), size=self.size, stereo=self.is_stereo, truth=replace(_TRUTH, frames=frames))
        return {f"{of['frame']}/{of['seed']}": Job("reference", of) for of in plan.references(self.scene)}


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Measure one configuration beside the yardstick: one row, with `seconds` for each frame (both eyes), `relative` to path tracing
    with one sample for each pixel, what that one took as `yardstick`, the METRICS, and for all of these NAME_error, their standard errors; `stereo_reference`, what the eyes of
    references differ by; `cache` in bytes. Where the device or the settings do not allow it, or pixels are not finite, the row says why in
    `failed`. Raises SceneError, SettingError, DeviceError, Error.

    parameters: scene, configuration, size, frames, skip, stereo, seed, metrics. needed: references by FRAME/SEED.
    """
    # What is wrong with the scene or the device is wrong with all configurations.
    open_scene(parameters["scene"])
    machine.open()
    told = {**parameters, "slower": 1, "still": None, "stages": {}, "pictures": []}
    told["configurations"] = [_YARDSTICK.entry(), parameters["configuration"]]
    try:
        rows = sequence.run(told, needed, machine).rows
    except Error as error:
        return failure(str(error))
    except MemoryError:
        return failure("out of memory")
    own, yardstick = ([r for r in rows if r["configuration"] == n and r["counted"]] for n in (_OWN, _YARDSTICK.name))
    return Result([summary(own, yardstick)])


def failure(reason: str) -> Result:
    """What is kept of a configuration that cannot be measured here."""
    return Result([{"failed": reason}])


def summary(own: Sequence[Mapping], yardstick: Sequence[Mapping]) -> dict:
    """The row of a configuration. own, yardstick: the frames that count of it, and of what its times are told as multiples of."""
    seconds = [row["seconds"] for row in own]
    found = {
        "seconds": statistics.median(seconds),
        # Of a median; of normal deviates it is so much larger than that of a mean.
        "seconds_error": math.sqrt(math.pi / 2) * _standard_error(seconds),
        # Frame by frame, as they were rendered one after the other: what the machine did meanwhile both had to bear.
        "yardstick": statistics.median(row["seconds"] for row in yardstick),
        "relative": statistics.median(a["seconds"] / b["seconds"] for a, b in zip(own, yardstick, strict=True)),
    }
    for name, column in (("relmse", "relmse"), ("flip", "flip"), ("flicker", "difference"), ("stereo", "stereo")):
        values = [row[column] for row in own if column in row]
        if values:
            found |= {name: statistics.fmean(values), f"{name}_error": _standard_error(values)}
    errors = [row["relmse_error"] for row in own if "relmse_error" in row]
    if errors:  # over the pictures; those of neighbouring frames are not independent, as caches and histories go on
        found["relmse_error"] = statistics.fmean(errors)
    references = [row["stereo_reference"] for row in own if "stereo_reference" in row]
    if references:
        found["stereo_reference"] = statistics.fmean(references)
    return found | {"memory": own[-1]["memory.total"], "cache": own[-1]["memory.cache"]}


def _standard_error(values: Sequence[float]) -> float | None:
    return statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None


# ---------------------------------------------------------------------------------------------------------------------
# What is best


def pareto_front(time: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Of points by (n,) time and error, lower being better: (n,) whether none is as good in both and better in one. Points that are not
    finite never are."""
    on_front = np.zeros(len(time), bool)
    (used,) = np.nonzero(np.isfinite(time) & np.isfinite(error))
    if not used.size:
        return on_front
    times, group = np.unique(time[used], return_inverse=True)
    least = np.full(len(times), np.inf)
    np.minimum.at(least, group, error[used])
    before = np.concatenate(([np.inf], np.minimum.accumulate(least)[:-1]))
    on_front[used] = (error[used] == least[group]) & (least < before)[group]
    return on_front


@dataclass(frozen=True)
class Goal:
    """What is asked for. seconds: at most, for each frame. metric: what is to be least, or at most `error`."""

    seconds: float | None = None
    metric: str = "relmse"
    error: float | None = None


@dataclass(frozen=True)
class Advice:
    """What is recommended. row: its number; None where nothing was measured. is_met: whether it is what was asked for, or what comes nearest."""

    row: int | None
    is_met: bool


def advise(goal: Goal, time: np.ndarray, error: np.ndarray) -> list[Advice]:
    """What meets a goal: where a time is given, the least error within it; where only an error is, the fastest that has no more. Where nothing
    meets it: what has the least error within the time, else the fastest; and the fastest within the error, else what has the least.

    time: (n,) seconds. error: (n,) of the goal's metric.
    """
    known = np.isfinite(time) & np.isfinite(error)
    if not known.any():
        return [Advice(None, False)]
    in_time = known & (time <= (np.inf if goal.seconds is None else goal.seconds))
    good = known & (error <= (np.inf if goal.error is None else goal.error))
    if (in_time & good).any():
        least = (error, time) if goal.seconds is not None or goal.error is None else (time, error)
        return [Advice(_first_of(in_time & good, *least), True)]
    nearest = []
    if goal.seconds is not None:
        nearest.append(_first_of(in_time, error, time) if in_time.any() else _first_of(known, time, error))
    if goal.error is not None:
        nearest.append(_first_of(good, time, error) if good.any() else _first_of(known, error, time))
    return [Advice(row, False) for row in dict.fromkeys(nearest)]


def _first_of(mask: np.ndarray, first: np.ndarray, second: np.ndarray) -> int:
    """Of those in the mask the one with the least of the first, and of several the second."""
    (rows,) = np.nonzero(mask)
    return int(rows[np.lexsort((second[rows], first[rows]))[0]])


def sensitivities(tried: Sequence[Trial], found: Mapping[str, Mapping]) -> list[dict]:
    """What each change does: method, changed, value, and for time and each metric the factor over the configuration without it, with
    its standard error in NAME_error, where there is one. found: rows by identity."""
    rows = []
    for trial in tried:
        if trial.origin != CHANGE:
            continue
        own, base = found.get(identity(trial.configuration), {}), found.get(identity(trial.base), {})
        factors = {name: _factor(own.get(of), base.get(of)) for name, of in _SENSED.items()}
        if any(factor is not None for factor in factors.values()):
            value = trial.point[trial.changed]
            without = trial.space.default[trial.changed]
            row = {
                "method": trial.space.method,
                "changed": trial.changed,
                "value": value,
                "default": without,
                **factors,
            }
            errors = {f"{n}_error": _factor_error(f, n, own, base) for n, f in factors.items() if n != "memory"}
            rows.append(row | errors)
    return rows


# The times of different jobs are compared as multiples of the yardstick's, which what else the machine does meets alike.
_SENSED = {"time": "relative", **{name: name for name in METRICS}}


def _factor(own: float | None, base: float | None) -> float | None:
    return own / base if own is not None and base is not None and base > 0 and math.isfinite(own) else None


def _factor_error(factor: float | None, name: str, own: Mapping, base: Mapping) -> float | None:
    """As if the two had nothing in common; where they have, as all have the same references, that is too much."""
    of = "seconds" if name == "time" else name
    errors = own.get(f"{of}_error"), base.get(f"{of}_error")
    if factor is None or None in errors or not own[of]:
        return None
    return abs(factor) * math.hypot(errors[0] / own[of], errors[1] / base[of])


def refine(
    found: Sequence[Space], tried: Sequence[Trial], rows: Mapping[str, Mapping], seed: int, count: int
) -> Iterator[list[Trial]]:
    """So many more trials, in batches; after each, `rows`, by identity, has what it found, before the next one is asked for."""
    search = Search(found, seed)
    known: set[str] = set()

    def tell(trials: Iterable[Trial]) -> None:
        for trial in trials:
            row = rows.get(identity(trial.configuration), {})
            values = (row.get("relative"), row.get("relmse"))
            search.tell(trial, None if None in values else values)
            known.add(identity(trial.configuration))

    tell(tried)
    random = np.random.default_rng(seed)
    left = count
    while left > 0:
        batch: dict[str, Trial] = {}
        for _ in range(min(REFINE_BATCH, left)):
            trial = _unknown(search.ask(), known | batch.keys(), random)
            if trial is None:
                break
            batch[identity(trial.configuration)] = trial
        if not batch:
            return
        yield list(batch.values())
        tell(batch.values())
        left -= len(batch)


def _unknown(trial: Trial, known: Set[str], random: np.random.Generator) -> Trial | None:
    """The trial, with one thing after the other changed at random until it is of a configuration that is not known; None where there seems to be
    none. An estimator proposes the best again and again."""
    indices = trial.space.indices(trial.point)
    for _ in range(1000):
        if identity(trial.configuration) not in known:
            return trial
        place = random.integers(len(indices))
        indices[place] = int(random.integers(len(trial.space.choices[place].values)))
        trial = replace(trial, point=trial.space.at(indices))
    return None
