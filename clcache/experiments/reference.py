"""References: frames by path tracing, true but for their noise, each a job of its own.

A frame shows the scene at a time of the sequence that it belongs to: a sequence may be slowed down, so that there are several frames for
each of the scene's, or stand still at one of these.
"""

from collections.abc import Mapping
from dataclasses import replace

from ..scene.model import Scene
from .configuration import Configuration
from .job import Machine, Result, open_scene

_STILL = 1_000_000  # frames for each of the scene's where all show one of them: the camera all but stands, and is not known to


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """One frame by path tracing, whatever method the scene asks for: arrays by eye, (H, W, 3) float32. Raises SceneError, SettingError,
    DeviceError.

    parameters: scene, size, frame, stereo, slower, still, spp, seed. Samples are added up one by one, so that their number takes no memory.
    """
    told = parameters
    scene, offset = timeline(open_scene(told["scene"]), told["slower"], told["still"])
    configuration = Configuration("reference", "pathtrace", spp=told["spp"])
    renderer = configuration.renderer(
        scene, tuple(told["size"]), told["stereo"], told["seed"], machine.device, machine.threads
    )
    number = told["frame"] + offset
    (frame,) = renderer.frames(number, number + 1)
    row = {"frame": told["frame"], "spp": told["spp"], "seconds": frame.stats["seconds"]}
    return Result([row], frame.color)


def timeline(scene: Scene, slower: float, still: int | None) -> tuple[Scene, int]:
    """The scene in a sequence's time, and what is added to the sequence's frame numbers to have the scene's.

    slower: frames for each of the scene's, whose times the first of them have. still: the scene's own frame that all show.
    """
    factor = slower if still is None else _STILL
    defaults = replace(scene.defaults, fps=scene.defaults.fps * factor)
    return replace(scene, defaults=defaults), 0 if still is None else still * factor
