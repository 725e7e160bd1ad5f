"""What the memoization of material graphs does to an image (MaterialMemo, section 6.1).

A frame with memoization is compared with the same frame without, from the same random numbers, so that most of their noise is the same
and the rest of the difference is the memoization's. How much noise is left in the comparison tells that of the frame without, and of one
from other random numbers.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .. import metrics
from .configuration import Configuration
from .job import Machine, Result, open_scene
from .sequence import pictures_of

OTHER_SEED = 500  # behind that of the comparison; so far from the seeds of what is measured


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Render a frame by all configurations: a row for each but the first one, with which they are compared. Raises SceneError,
    SettingError, DeviceError, Error.

    parameters: scene, configurations, size, frame, seed. The columns: configuration, frame, flip, relmse. The last row is that of the
    first configuration from other random numbers.
    """
    told = parameters
    scene, number = open_scene(told["scene"]), told["frame"]

    def picture(configuration: Configuration, seed: int) -> np.ndarray:
        size = tuple(told["size"])
        renderer = configuration.renderer(scene, size, False, seed, machine.device, machine.threads)
        (frame,) = renderer.frames(number, number + 1)
        return frame.color["mono"]

    first, *others = (Configuration.of(entry) for entry in told["configurations"])
    reference = picture(first, told["seed"])
    rows, arrays = [], pictures_of("reference", number, {"mono": reference})
    again = replace(first, name=f"{first.name}, other random numbers")
    for configuration in (*others, again):
        shown = picture(configuration, told["seed"] + (OTHER_SEED if configuration is again else 0))
        found = {"flip": metrics.flip(shown, reference), "relmse": metrics.relmse(shown, reference)}
        rows.append({"configuration": configuration.name, "frame": number, **found})
        arrays |= pictures_of(configuration.name, number, {"mono": shown})
    return Result(rows, arrays)
