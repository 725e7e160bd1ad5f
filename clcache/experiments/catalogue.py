"""All experiments, by name, in the order of the papers."""

import importlib

from .experiment import Experiment

_MODULES = (
    "samplecache_figures",
    "varianceblend_figures",
    "memo_figures",
    "octree_figures",
    "mitsuba",
    "extremes",
    "precision",
    "requires",
)


EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for module in _MODULES
    for experiment in importlib.import_module(f".{module}", __package__).EXPERIMENTS
}
