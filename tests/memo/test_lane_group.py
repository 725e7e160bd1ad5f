"""Lane groups (`cl/common/lane_group.cl`): by local memory everywhere, as sub-groups where there are any that can."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kernel_source import build
from tile_on_device import has_sub_groups

from clcache import drivers
from clcache import probe as prober

LANES = 32
SOURCE = """
#include "common/lane_group.cl"
#include "probe_lanes.cl"

// Rounds in a loop that all lanes leave together: (rounds, n), the least of the values that are left, until none is.
__kernel __attribute__((reqd_work_group_size(32, 1, 1) IN_LANES)) void sort(
    __global const uint *value,  // (n)
    __global uint *sorted,       // (32, n)
    __global uint *first,        // (32, n)
    uint n)
{
    __local uint words[2 * LANES];
    Lanes lanes = lanes_of(words);
    uint i = get_global_id(0), round = 0;
    uint left = lane_ballot(&lanes, i < n);
    while (left != 0) {
        bool is_left = (left >> lane_id(&lanes) & 1u) != 0;
        uint least = lane_min(&lanes, is_left ? value[i] : 0xFFFFFFFFu);
        uint lane = first_lane(lane_ballot(&lanes, is_left && value[i] == least));
        lane_offer(&lanes, 0, i);
        lane_offer(&lanes, 1, i < n ? value[i] : 0u);
        lane_barrier();
        uint item = lane_take(&lanes, 0, i, lane), found = lane_take(&lanes, 1, i < n ? value[i] : 0u, lane);
        lane_barrier();
        if (i < n) {
            sorted[round * n + i] = found;
            first[round * n + i] = item;
        }
        left &= ~(1u << lane);
        round++;
    }
}
"""


@pytest.fixture(scope="module")
def programs(device, tmp_path_factory):
    """By local memory; and by sub-groups where they exchange values."""
    forms = [False, True] if has_sub_groups(device) else [False]
    return [build(device, SOURCE, tmp_path_factory.mktemp("lanes"), NATIVE_SUBGROUPS=native) for native in forms]


def probed(device, program, values):
    found = device.empty((7, len(values)), np.uint32)
    program["probe"].run(len(values), {"value": device.upload(values), "found": found}, n=len(values))
    return found.get()


words = st.one_of(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2**31, 2**32 - 1]))


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(words, min_size=2 * LANES, max_size=2 * LANES))
def test_lanes_see_each_others_values(device, programs, values):
    values = np.array(values, np.uint32)
    lanes = values.reshape(-1, LANES)
    for program in programs:
        ballot, broadcast, shuffled, as_float, least, *_ = probed(device, program, values).reshape(7, -1, LANES)
        for group in range(2):
            v = lanes[group]
            mask = sum(int(x & 1) << lane for lane, x in enumerate(v))
            assert (ballot[group] == mask).all()
            assert (broadcast[group] == v[5]).all()
            assert (least[group] == v.min()).all()
            assert [int(x) for x in shuffled[group]] == [int(v[(x >> 7) % LANES]) for x in v.tolist()]
            chosen = np.float32([v[(x >> 7) % LANES] >> 8 for x in v.tolist()])
            np.testing.assert_array_equal(as_float[group], chosen.astype(np.uint32))
        np.testing.assert_array_equal(prober.lanes_expected(values)[:5], probed(device, program, values)[:5])
    np.testing.assert_array_equal(prober.lanes_expected(values), probed(device, programs[0], values))


@pytest.mark.parametrize("n", [1, 31, 32, 33, 100])
def test_values_survive_a_loop_that_lanes_leave_together(device, programs, n):
    rng = np.random.default_rng(n)
    values = rng.integers(0, 10, n).astype(np.uint32)
    for program in programs:
        arrays = {"value": device.upload(values)}
        arrays |= {name: device.upload(np.zeros((LANES, n), np.uint32)) for name in ("sorted", "first")}
        program["sort"].run(n, arrays, n=n)
        for begin in range(0, n, LANES):
            own = values[begin : begin + LANES]
            order = np.argsort(own, kind="stable")
            for i in range(begin, begin + len(own)):
                np.testing.assert_array_equal(arrays["sorted"].get()[: len(own), i], own[order])
                np.testing.assert_array_equal(arrays["first"].get()[: len(own), i], begin + order)


def test_the_probe_tells_what_sub_groups_lack_or_get_wrong(device, monkeypatch):
    whole = device.context.devices[0]
    if not has_sub_groups(device):
        missing = prober.LANE_EXTENSIONS - set(whole.extensions.split())
        assert all(name in prober.lanes_failure(whole) for name in missing)
        return
    assert prober.lanes_failure(whole) in (None, "wrong numbers: calls")
    expected = prober.lanes_expected
    monkeypatch.setattr(prober, "lanes_expected", lambda values: expected(values) + np.uint32(1))
    assert prober.lanes_failure(whole) == f"wrong numbers: {', '.join(dict.fromkeys(prober.LANE_FUNCTIONS))}"


def test_the_probe_of_images_reads_what_it_wrote(device, monkeypatch):
    whole = device.context.devices[0]
    assert prober.images_failure(whole) is None
    source = prober.IMAGE_KERNEL.read_text()

    class Wrong:
        def read_text(self):
            return source.replace(
                "write_imagef(written3d, (int4)(i, 1, 1, 0)", "write_imagef(written3d, (int4)(i, 1, 0, 0)"
            )

    monkeypatch.setattr(prober, "IMAGE_KERNEL", Wrong())
    assert prober.images_failure(whole) == "wrong numbers"


def test_a_device_is_asked_in_a_child_process_once(device_spec, monkeypatch):
    asked = []
    monkeypatch.setattr(
        drivers, "_run_child", lambda arguments, environment: asked.append(arguments) or drivers.Verdict(False, "")
    )
    drivers.proves.cache_clear()
    candidate = drivers.candidates()[int(device_spec)]
    assert [drivers.proves(candidate, f) for f in ("lanes", "lanes", "images")] == [False] * 3
    assert asked == [[str(candidate.index), "lanes"], [str(candidate.index), "images"]]
    drivers.proves.cache_clear()


def test_a_device_without_images_says_so():
    class Device:
        image_support = False

    assert prober.images_failure(Device()) == "it lacks images"
