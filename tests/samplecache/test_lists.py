"""Lists of samples: a group's entries stay together within a batch, and the list is never longer than its buffer."""

import numpy as np
import pytest
from kernel_source import build
from render_helpers import ball, floor, lit, view

from clcache import Renderer

NONE = 0xFFFFFFFF
GROUP = 64
SOURCE = """
#include "samplecache/groups.cl"

__kernel void fill_list(
    __global const uint *counts,       // (groups)
    __global uint *list,               // (capacity)
    __global volatile uint *length,    // (1)
    __global uint *first,              // (groups)
    uint groups,
    uint batch)
{
    uint group = get_global_id(0);
    if (group >= groups) return;
    uint at = take_together(length, list, counts[group], batch);
    for (uint i = 0; i < counts[group]; i++) list[at + i] = group << 16 | i;
    first[group] = at;
}

__kernel void fill_anyhow(
    __global const uint *counts,       // (groups)
    __global uint *list,               // (capacity)
    __global volatile uint *length,    // (1)
    uint groups)
{
    uint group = get_global_id(0);
    if (group >= groups) return;
    uint at = take(length, counts[group]);
    for (uint i = 0; i < counts[group]; i++) list[at + i] = group << 16 | i;
}
"""


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    return build(device, SOURCE, tmp_path_factory.mktemp("cl"))


def entries_of(counts):
    """What groups of these counts write, each once."""
    group = np.repeat(np.arange(counts.size), counts)
    return (group << 16) + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def counts_of(groups, most, empty, seed):
    """Random; with this part of them 0, some 1, some as many as there can be."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, most + 1, groups)
    counts[rng.random(groups) < 0.1] = most
    counts[rng.random(groups) < 0.1] = 1
    counts[rng.random(groups) < empty] = 0
    return counts.astype(np.uint32)


@pytest.mark.parametrize("part", [1.5, 2, 3, 17])
@pytest.mark.parametrize("most", [1, 5, 256])
@pytest.mark.parametrize(("groups", "empty"), [(1, 0.0), (3000, 0.0), (3000, 0.6)])
def test_groups_lie_within_batches(device, program, most, part, groups, empty):
    """Batches of twice a group's largest part, and larger; what is left over at their ends names no sample. Each end of a batch
    costs at most one group's places where the next try is in the first half of a batch."""
    counts, batch = counts_of(groups, most, empty, 1), int(most * part)
    list_, length = device.upload(np.full(1 << 23, 12345, np.uint32)), device.upload(np.zeros(1, np.uint32))
    first = device.empty(groups, np.uint32)
    program["fill_list"](device.upload(counts), list_, length, first, groups, batch, count=groups)
    written, total, first = list_.get(), int(length.get()[0]), first.get()
    assert part < 2 or total <= counts.sum() + (counts.sum() // (batch - most) + 1) * most
    assert (written[total:] == 12345).all()
    written = written[:total]
    np.testing.assert_array_equal(np.sort(written[written != NONE]), entries_of(counts))
    used = counts > 0
    np.testing.assert_array_equal(first[used] // batch, (first + counts - 1)[used] // batch)
    for group in np.flatnonzero(used)[::37]:
        assert (written[first[group] : first[group] + counts[group]] == (group << 16) + np.arange(counts[group])).all()
    device.release(list_)


def test_groups_that_fit_exactly_leave_nothing_over(device, program):
    """Four groups of 64 to each batch of 256."""
    counts, list_ = np.full(1000, 64, np.uint32), device.upload(np.zeros(1 << 17, np.uint32))
    length, first = device.upload(np.zeros(1, np.uint32)), device.empty(1000, np.uint32)
    program["fill_list"](device.upload(counts), list_, length, first, 1000, 256, count=1000)
    assert length.get()[0] == 64_000


@pytest.mark.parametrize("groups", [1, 3000])
def test_places_of_a_list_without_batches(device, program, groups):
    """One after the other, and none left over."""
    counts = counts_of(groups, 256, 0.3, 2)
    list_, length = device.upload(np.full(1 << 20, NONE, np.uint32)), device.upload(np.zeros(1, np.uint32))
    program["fill_anyhow"](device.upload(counts), list_, length, groups, count=groups)
    total = int(length.get()[0])
    np.testing.assert_array_equal(np.sort(list_.get()[:total]), entries_of(counts))


def length_of(counts, batch):
    """How long the list gets if the groups come one after the other: one that does not fit the rest of a batch begins the next."""
    length = 0
    for count in counts:
        if count > 0 and length // batch != (length + count - 1) // batch:
            length = (length // batch + 1) * batch
        length += count
    return length


def scene():
    return lit(floor(8), ball(1, 2), camera=view((0, 1, 5), (0, 0.5, 0), 50), environment=(0.5, 0.5, 0.5))


@pytest.mark.parametrize(
    ("size", "slots"),
    [
        ((1, 1), 12),
        ((16, 16), 4),
        ((32, 24), 12),
        ((32, 32), 9),
        ((48, 32), 12),
        ((44, 52), 12),
        ((64, 48), 32),
        ((320, 180), 12),
        ((36, 28), 1),
    ],
)
def test_list_has_room_in_the_worst_case(device_spec, size, slots):
    """Whatever part of its samples each group lists: all of them, all but one, any part that leaves the most unused. All of these
    images but the one of a single pixel are of whole blocks."""
    renderer = Renderer(scene(), "samplecache", size, settings={"samplecache.slots": slots}, device=device_spec)
    arrays = renderer._graph.of("mono")
    batch, capacity, groups = (arrays[b].size for b in ("ray_length", "samples", "group_count"))
    full = GROUP * slots
    assert batch >= full
    parts = {full, full - 1, full // 2, full // 2 + 1, full // 3 + 1, *np.linspace(1, full, 40).astype(int).tolist()}
    patterns = [[part] * groups for part in parts]
    patterns += [[full - (k % 2) for k in range(groups)], [full, 1] * groups, *random_parts(full, groups)]
    own = slots * np.clip(size[0] * size[1] - GROUP * np.arange(groups), 0, GROUP)
    patterns = [np.minimum(pattern[:groups], own[: len(pattern)]).tolist() for pattern in patterns]
    too_long = [p[:3] for p in patterns if length_of(p, batch) > capacity]
    assert not too_long, f"{len(too_long)} of {len(patterns)}, such as {too_long[0]}, ..., of at most {full}"


def random_parts(full, groups):
    rng = np.random.default_rng(3)
    return [rng.integers(full // k, full + 1, groups).tolist() for k in (1, 2, 3, 8)]


def test_list_has_room_while_a_small_image_fills_its_slots(device_spec):
    """The slots of a still image fill one by one, each group with as many samples as the others. The lengths of the lists are worked
    out, and no frame is rendered, since kernels do not check where they write."""
    size, slots = (32, 24), 12
    renderer = Renderer(scene(), "samplecache", size, settings={"samplecache.slots": slots}, device=device_spec)
    arrays = renderer._graph.of("mono")
    batch, capacity, groups = (arrays[b].size for b in ("ray_length", "samples", "group_count"))
    lengths = [length_of([GROUP * filled] * groups, batch) for filled in range(1, slots + 1)]
    assert max(lengths) <= capacity
