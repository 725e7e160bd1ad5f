"""Where the entries of a list stand among the places of the path tracer's queue (`cl/samplecache/places.cl`)."""

import numpy as np
import pytest
from kernel_source import build
from render_helpers import ball, floor, grey, image, lit, view

from clcache.renderer import Renderer

CHUNK = 4096
SOURCE = """
#include "samplecache/places.cl"
__kernel void places(
    __global uint *place,  // (n)
    __global uint *entry,  // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    place[i] = place_of_entry(i, n);
    entry[i] = entry_of_place(i, n);
}
"""


@pytest.mark.parametrize("n", [1, 16, CHUNK, CHUNK + 1, 2 * CHUNK, 3 * CHUNK - 5, 3 * CHUNK, 57600, 230400])
def test_each_entry_has_a_place_and_either_half_as_many(device, tmp_path, n):
    place, entry = (device.empty(n, np.uint32) for _ in range(2))
    build(device, SOURCE, tmp_path)["places"](place, entry, n, count=n)
    place, entry = place.get(), entry.get()
    np.testing.assert_array_equal(np.sort(place), np.arange(n))
    np.testing.assert_array_equal(entry[place], np.arange(n))
    np.testing.assert_array_equal(place % CHUNK, np.arange(n) % CHUNK)
    half = (n // CHUNK + 1) // 2 * CHUNK
    for length in range(CHUNK, n // CHUNK * CHUNK + 1, CHUNK):
        first = np.count_nonzero(place[:length] < half)
        assert 0 <= first - (length - first) <= CHUNK


def test_samples_get_the_light_of_their_own_paths():
    """On an image of several chunks, of surfaces that glow, each in its own brightness, and reflect nothing."""
    scene = lit(
        floor(8, 0),
        ball(1, 3, 1),
        camera=view((0.5, 3.0, 5.0), (0, 0.3, 0), degrees=60),
        materials=(grey(0.0, 1.0), grey(0.0, 4.0)),
        environment=(9.0, 9.0, 9.0),
    )
    size, settings = (160, 120), {"samplecache.tracing": "multi", "pathtrace.bounces": 0}
    expected = image(scene, size, spp=64, bounces=0)
    frames = list(Renderer(scene, "samplecache", size=size, stereo=False, settings=settings).frames(0, 4))
    interior = np.isin(expected[..., 0].round(4), (1.0, 4.0, 9.0))
    assert interior.mean() > 0.9
    # 64 paths may have missed what covers next to nothing of a pixel.
    assert np.isclose(frames[-1].color["mono"][interior], expected[interior], rtol=1e-4).mean() > 0.999
