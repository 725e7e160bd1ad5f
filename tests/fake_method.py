"""A method whose passes compute nothing that is worth seeing: they leave numbers from which follows what they were told and what
they found."""

import numpy as np
from render_helpers import everything

from clcache.frame import Buffer, Pass
from clcache.methods import Method

SIZE = (3, 2)
PIXELS = 6
EYES = ("left", "right")
DIGIT = {"mono": 3, "left": 1, "right": 2}
COUNTERS = ("occupied", "created", "retraced")


class Step(Pass):
    """A pass of one function of arrays and state."""

    def __init__(self, name, reads, writes, do):
        self.name, self.reads, self.writes, self._do = name, reads, writes, do

    def run(self, arrays, state):
        self._do(arrays, state)
        yield None


def put(array, value):
    array.set(np.ascontiguousarray(np.broadcast_to(np.asarray(value, array.dtype), array.shape)))


class Fake:
    """A method whose history is one digit for each update, the eye's own, and whose colour is that history.

    states: what its passes were told. told: what the blend's were. reads: what the blend reads.
    """

    def __init__(self, reads=("color", "other_color", "history", "other_history"), counters=COUNTERS):
        self.states, self.told, self.reads, self.counters = [], [], reads, counters

    def __call__(self, setup):
        self.stereo_blend, n = setup.stereo_blend, setup.size[0] * setup.size[1]
        passes = (
            Step("remember", ("history_before",), ("history", "color", "aov_age"), self.remember),
            Step("count", (), ("ray_counts", "counters"), self.count),
            Step(
                "surface",
                ("color",),
                ("surface",),
                lambda arrays, _: put(arrays["surface"], arrays["color"].get()[0, 0]),
            ),
            Step("idle", (), ("aov_visible", "scratch"), lambda arrays, state: put(arrays["aov_visible"], 7)),
        )
        buffers = (
            *(Buffer(b, (n,), persistent=True, per_eye=True) for b in ("history", "history_before")),
            Buffer("color", (n, 3), per_eye=True),
            Buffer("surface", (n, 4), "u4", per_eye=True),
            Buffer("aov_age", (n,)),
            Buffer("aov_visible", (n,)),
            Buffer("scratch", (n,)),
            Buffer("ray_counts", (2, 4), "u4"),
            Buffer("counters", (len(COUNTERS),), "u4"),
        )
        return Method(
            passes, buffers,
            exchanged=(("history", "history_before"),),
            cache=("history", "history_before"),
            counters=self.counters,
            levels=("occupied",) if self.counters else (),
            primary=("created", "retraced") if self.counters else (),
            blend=(Step("blend", self.reads, ("blended",), self.blend),) if setup.stereo_blend != "none" else (),
            blend_buffers=(Buffer("blended", (n, 3)),),
        )  # fmt: skip

    def remember(self, arrays, state):
        self.states.append(state)
        history = 10 * arrays["history_before"].get() + self.digit(state.camera)
        put(arrays["history"], history)
        put(arrays["color"], history[:, None])
        put(arrays["aov_age"], history)

    def digit(self, camera):
        """Which eye this is, told from where it stands."""
        aside = camera["to_world"][3] - everything().camera.transform[0, 3]
        return DIGIT["mono" if abs(aside) < 1e-3 else "left" if aside < 0 else "right"]

    def count(self, arrays, state):
        put(arrays["ray_counts"], [[state.update + 1], [1]])
        put(arrays["counters"], [100 + state.update, 20, state.update])

    def blend(self, arrays, state):
        self.told.append(state)
        color, other = arrays["color"].get(), arrays["other_color"].get()
        assert (arrays["history"].get()[:, None] == color).all()
        assert (arrays["other_history"].get()[:, None] == other).all()
        put(arrays["blended"], color + 1000 * other)
