"""The passes of a frame by a method with a cache, beside a path-traced one of a sample per pixel."""

from collections.abc import Iterator
from functools import partial

from ..errors import SettingError
from ..renderer import Renderer
from ..scene.model import Scene
from .job import Job
from .result import Result

USUAL = ("atrium", "classroom")
FILLED = 8  # frames in which the cache fills, and which do not count


def cached(method: str, job: Job) -> Iterator[Result]:
    """Seconds of each pass in the frames of a scene's own motion, and of the whole frame, rendered by either method in turn.
    Raises SettingError where the scene has fewer frames than are to be measured."""
    for name, scene in job.loaded(*USUAL):
        first, last = measured_frames(scene, job.repeats)
        options = {"size": job.size, "stereo": False, "spp": 1, "seed": 1, "device": job.device, "threads": job.threads}
        rivals = [Renderer(scene, rival, temporal="none", **options) for rival in (method, "pathtrace")]
        running = [renderer.frames(first, last) for renderer in rivals]
        frames = [tuple(frame.stats for frame in pair) for pair in zip(*running, strict=True)][FILLED:]
        pixels = job.size[0] * job.size[1]
        for step in frames[0][0]["eyes"]["mono"]["passes"]:
            seconds = tuple(own["eyes"]["mono"]["passes"][step] for own, _ in frames)
            if any(seconds):
                yield Result(method, step, name, pixels, "pixels", seconds)
        for what, which in (("whole frame", 0), ("path-traced frame", 1)):
            yield Result(method, what, name, pixels, "pixels", tuple(pair[which]["seconds"] for pair in frames))


samplecache, voxelhash, hybrid = (partial(cached, method) for method in ("samplecache", "voxelhash", "hybrid"))


def measured_frames(scene: Scene, repeats: int) -> tuple[int, int]:
    """The frames to render. Behind the scene's own range things stand still, which is the easiest case."""
    first, end = scene.defaults.frames
    last, moving = first + FILLED + repeats, (scene.camera, *scene.instances)
    if last > end and any(each.motion for each in moving):
        left = max(end - first - FILLED, 0)
        raise SettingError(
            f"--repeats {repeats}: {scene.file} moves in frames {first}:{end}, of which the first {FILLED} fill the cache;"
            f" expected {f'at most {left}' if left else 'more frames'}"
        )
    return first, last
