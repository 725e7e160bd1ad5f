"""One thing that was measured, and the figures that follow from it."""

import statistics
from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """family, name, scene: what was measured ("" where no scene is). items, unit: how many of what one run handles. seconds: of
    each run. nbytes: what a run must move between memory and the processor at least, its arguments once each; None where
    that says nothing. peer_seconds: of Embree's runs, where it did the same. agree: the part of the hits on which both agree.
    bytes_per_triangle: of a tree."""

    family: str
    name: str
    scene: str
    items: int
    unit: str
    seconds: tuple[float, ...]
    nbytes: int | None = None
    peer_seconds: tuple[float, ...] | None = None
    agree: float | None = None
    bytes_per_triangle: float | None = None

    @property
    def median(self) -> float:
        """Seconds of the run in the middle, at least a tick of the device's clock."""
        return max(statistics.median(self.seconds), 1e-9)

    @property
    def rate(self) -> float:
        """Items per second, by the median."""
        return self.items / self.median

    @property
    def bytes_per_second(self) -> float | None:
        """By the median."""
        return None if self.nbytes is None else self.nbytes / self.median

    @property
    def ratio(self) -> float | None:
        """How many times faster than Embree, by the medians."""
        return None if self.peer_seconds is None else statistics.median(self.peer_seconds) / self.median

    def entry(self, bandwidth: float) -> dict:
        """All of it for JSON. bandwidth: bytes per second that a copy reaches on the same device and threads."""
        moved = {}
        if self.nbytes is not None:
            bound = self.nbytes / bandwidth
            moved = {
                "bytes": self.nbytes,
                "bytes_per_second": self.bytes_per_second,
                "bandwidth_bound": bound,
                "of_bound": self.median / bound,
            }
        peer = {}
        if self.peer_seconds is not None:
            embree = {"seconds": spread(self.peer_seconds), "rate": self.items / statistics.median(self.peer_seconds)}
            peer = {"embree": embree, "ratio": self.ratio}
        others = {"agree": self.agree, "bytes_per_triangle": self.bytes_per_triangle}
        return {
            "family": self.family,
            "name": self.name,
            "scene": self.scene,
            "items": self.items,
            "unit": self.unit,
            "seconds": spread(self.seconds) | {"median": self.median},
            "rate": self.rate,
            **moved,
            **peer,
            **{key: value for key, value in others.items() if value is not None},
        }


def spread(seconds: tuple[float, ...]) -> dict[str, float]:
    """The least, the middle and the most of some runs."""
    return {"min": min(seconds), "median": statistics.median(seconds), "max": max(seconds)}
