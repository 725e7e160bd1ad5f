"""The same bits for any number of threads, any work-group size, any run; other bits for another seed or frame."""

import os
import subprocess
import sys

import numpy as np
import pytest
from render_helpers import everything, image, render

from clcache import Renderer

SIZE = (37, 23)  # no work-group size divides 37 * 23 but 1
SPP = 3

RENDER_IN_CHILD = """
import sys
from render_helpers import everything, render
frame = render(everything(), {size}, {spp}, threads={threads}, aovs=("albedo", "N", "Z"))
sys.stdout.buffer.write(frame.color["mono"].tobytes())
for name in ("albedo", "N", "Z"):
    sys.stdout.buffer.write(frame.aov(name, "mono").tobytes())
print(frame.stats["eyes"]["mono"]["rays"], file=sys.stderr)
"""


def render_in_child(threads: int) -> tuple[bytes, str]:
    """Colour, AOVs and ray counts from a process of its own: PoCL fixes its number of threads once in a process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")}
    environment["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
    code = RENDER_IN_CHILD.format(size=SIZE, spp=SPP, threads=threads)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout, done.stderr.decode().splitlines()[-1]


def bits(frame) -> bytes:
    return b"".join(frame.color[eye].tobytes() for eye in frame.color)


@pytest.fixture(scope="module")
def scene():
    return everything()


@pytest.fixture(scope="module")
def usual(scene):
    return image(scene, SIZE, SPP)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_one_and_two_threads(usual):
    one, two = render_in_child(1), render_in_child(2)
    assert one == two
    assert one[0].startswith(usual.tobytes())


@pytest.mark.parametrize("local_size", [1, 7, 256])
def test_work_group_size(scene, usual, local_size):
    other = image(scene, SIZE, SPP, settings={"device.local_size": local_size})
    np.testing.assert_array_equal(other.view(np.uint32), usual.view(np.uint32))


def test_the_scene_is_not_trivial(usual):
    assert np.isfinite(usual).all()
    assert len(np.unique(usual.reshape(-1, 3), axis=0)) > 0.6 * SIZE[0] * SIZE[1]


def test_two_runs(scene, usual):
    np.testing.assert_array_equal(image(scene, SIZE, SPP), usual)


def test_the_same_renderer_twice(scene):
    renderer = Renderer(scene, size=SIZE, spp=SPP)
    first, second = (next(renderer.frames(0, 1)) for _ in range(2))
    assert bits(first) == bits(second)


def test_seed_and_frame_change_the_noise(scene, usual):
    others = [
        image(scene, SIZE, SPP, seed=1),
        image(scene, SIZE, SPP, frame=1),
        image(scene, SIZE, SPP, frame=1, seed=1),
    ]
    images = [usual, *others]
    for i, a in enumerate(images):
        for b in images[:i]:
            assert (a != b).any(axis=2).mean() > 0.6


def test_a_frame_alone_equals_the_frame_of_a_sequence(scene):
    sequence = list(Renderer(scene, size=SIZE, spp=SPP).frames(3, 6))
    assert [f.number for f in sequence] == [3, 4, 5]
    for frame in sequence:
        assert bits(render(scene, SIZE, SPP, frame.number)) == bits(frame)


def test_two_renderers_interleaved(scene):
    options = [{"size": SIZE, "seed": 1}, {"size": (16, 9), "seed": 2, "stereo": True}]
    alone = [[bits(f) for f in Renderer(scene, spp=2, **o).frames(0, 3)] for o in options]
    first, second = (Renderer(scene, spp=2, **o) for o in options)
    together = [(bits(a), bits(b)) for a, b in zip(first.frames(0, 3), second.frames(0, 3), strict=True)]
    assert together == list(zip(*alone, strict=True))


def test_samples_go_on_where_fewer_end(scene):
    """The first samples of a longer run are those of a shorter one: sums of n and m - n samples make that of m."""
    one, two = (image(scene, SIZE, spp).astype(float) for spp in (1, 2))
    second = 2 * two - one
    assert second.min() > -1e-5
    assert (np.abs(second - one) > 1e-6).mean() > 0.5
