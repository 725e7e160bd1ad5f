"""What holds for every experiment that is written down."""

from clcache.experiments.experiment import Calls, Experiment, Sequences
from clcache.experiments.summary import is_time


def configurations(experiment: Experiment) -> set[str]:
    """The names of those that sequences render at real size."""
    return {c.name for plan in experiment.plans if isinstance(plan, Sequences) for c in plan.configurations}


def scenes(experiment: Experiment) -> set[str]:
    """Their folders."""
    return {scene for plan in experiment.plans for scene in plan.scenes}


def check_names(experiment: Experiment, others: set[str] = frozenset()) -> None:
    """All that claims, ladders, columns and the paper's rows speak of is there. others: names of configurations that no sequence has."""
    known = configurations(experiment) | others
    for claim in experiment.claims:
        assert {claim.of, claim.over or claim.of} <= known, claim.says
        assert set(claim.scenes) <= scenes(experiment), claim.says
        assert (claim.low, claim.high) != (None, None), claim.says
        is_known = all(plan.is_seeded for plan in experiment.plans if isinstance(plan, Calls))
        assert is_known or not is_time(claim.measure), f"{claim.says}: a time of one run has no interval"
    overs = {c.over for table in experiment.tables for c in table.columns if c.over}
    assert overs | set(experiment.ladder) <= known
    assert {row["scene"] for row in experiment.paper if "scene" in row} <= scenes(experiment)
    assert {row["configuration"] for row in experiment.paper} <= known


def check_plans(experiment: Experiment, data, is_quick: bool) -> None:
    """Jobs can be made of all plans; what they are told is in keeping with itself."""
    jobs = experiment.jobs(data, [1, 2], is_quick)
    assert jobs
    for labelled in jobs:
        told = labelled.job.parameters
        if "frames" in told:
            first, last = told["frames"]
            assert last - first > told["skip"]
            numbers = {int(name.partition("/")[0]) for name in labelled.job.needs}
            assert numbers <= set(range(first, last)) and set(told["pictures"]) <= numbers
            assert bool(numbers) == bool(told["metrics"])
            names = [c["name"] for c in told["configurations"]]
            assert len(set(names)) == len(names)
            passes = [name for of in told["stages"].values() for name in of]
            assert passes
