"""Reading and writing one entry at once (MaterialMemo, section 5.3.4): all orders in which a reader and two writers can go on."""

from itertools import combinations

import numpy as np
import pytest
from memo_model import EVICTIONS
from memo_on_device import run_source, table_defines

SOURCE = """
#include "memo/table.cl"

#define OF_A 10u
#define OF_B 20u

typedef struct Thread {
    uint step, check, entry, version;
    uint values[2];
} Thread;

// Values that say whose they are.
uint word_of(uint check, uint k)
{
    return check * 1000u + k;
}

// Lock, write one word, the other, publish.
void go_on_writing(const Table *table, Thread *self, MemoCounts *counts)
{
    uint step = self->step++;
    if (step == 0) self->entry = lock_entry(table, 0, self->check, 0, counts);
    if (self->entry == NONE) return;
    if (step == 1 || step == 2) record_of(table, self->entry)[RECORD_WORDS + step - 1] = word_of(self->check, step - 1);
    if (step == 3) publish_entry(table, 0, self->entry, self->check, counts);
}

// Search, begin to read, read one word, the other, see whether they are good. False where they are thought to be, and are not.
bool go_on_reading(const Table *table, Thread *self)
{
    uint step = self->step++;
    if (step == 0) self->entry = find_entry(table, 0, self->check);
    if (self->entry == NONE) return true;
    if (step == 1) self->version = begin_reading(table, self->entry);
    if (step == 2 || step == 3) self->values[step - 2] = record_of(table, self->entry)[RECORD_WORDS + step - 2];
    if (step != 4 || !is_unchanged(table, self->entry, self->check, self->version)) return true;
    return self->values[0] == word_of(self->check, 0) && self->values[1] == word_of(self->check, 1);
}

// One work-item per order, each with a table of its own, in which A stands. who: 0 reads A, 1 writes B, 2 writes A.
__kernel void interleaved(
    __global const uchar *who,     // (n, steps)
    __global uint *memory,         // (n, words)
    __global uint *is_right,       // (n)
    __global uint *left,           // (n)
    __global volatile ulong *clock,  // (1)
    uint capacity,
    uint steps,
    uint words,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Table table = { memory + (size_t)i * words, clock, capacity, capacity, 5 };
    MemoCounts counts = { 0, 0, 0, 0, 0, 0, 0, 0, 0 };
    Thread threads[3] = { { 0, OF_A, NONE, 0, { 0, 0 } }, { 0, OF_B, NONE, 0, { 0, 0 } }, { 0, OF_A, NONE, 0, { 0, 0 } } };
    Thread first = threads[2];
    for (uint k = 0; k < 4; k++) go_on_writing(&table, &first, &counts);
    bool right = true;
    for (uint k = 0; k < steps; k++) {
        uint thread = who[i * steps + k];
        if (thread == 0) right = go_on_reading(&table, threads) && right;
        else go_on_writing(&table, threads + thread, &counts);
    }
    is_right[i] = right;
    // What is left: no entry that is locked, none with another's value, no key twice.
    uint seen = 0;
    for (uint entry = 0; entry < capacity; entry++) {
        __global volatile uint *record = record_of(&table, entry);
        if (record[0] < KEYS_FROM) seen += record[0] == LOCKED ? 100 : 0;
        else if (record[RECORD_WORDS] != word_of(record[0], 0) || record[RECORD_WORDS + 1] != word_of(record[0], 1)) seen += 100;
        else seen += record[0] == OF_A ? 1 : 10;
    }
    left[i] = seen;
}
"""
READER, WRITER = 5, 4  # steps


def orders():
    """(n, 13) uint8: every order of the steps of a reader and two writers."""
    steps = READER + 2 * WRITER
    found = []
    for reader in combinations(range(steps), READER):
        rest = np.setdiff1d(np.arange(steps), reader)
        for writer in combinations(range(len(rest)), WRITER):
            order = np.zeros(steps, np.uint8)
            order[rest] = 2
            order[rest[list(writer)]] = 1
            found.append(order)
    return np.array(found)


@pytest.fixture(scope="module")
def all_orders():
    return orders()


def interleave(device, who, read, capacity, eviction="lru-frame"):
    defines = table_defines(eviction, read)
    kernel = run_source(device, SOURCE, **defines)["interleaved"]
    n, steps = who.shape
    words = capacity * defines["RECORD_STRIDE"]
    memory, clock = device.upload(np.zeros((n, words), np.uint32)), device.upload(np.zeros(1, np.uint64))
    right, left = (device.empty(n, np.uint32) for _ in range(2))
    arrays = {"who": device.upload(who), "memory": memory, "is_right": right, "left": left, "clock": clock}
    kernel.run(n, arrays, capacity=capacity, steps=steps, words=words, n=n)
    return right.get().astype(bool), left.get()


@pytest.mark.parametrize("capacity", [1, 2])
@pytest.mark.parametrize("eviction", EVICTIONS)
def test_whoever_counts_writes_never_reads_a_value_of_another_key(device, all_orders, capacity, eviction):
    right, left = interleave(device, all_orders, "counter", capacity, eviction)
    assert right.all(), all_orders[~right][0]
    assert np.isin(left, (1, 10, 11)).all()


def test_whoever_looks_at_the_key_alone_may_be_deceived_by_one_that_came_back(device, all_orders):
    """Where it went and came back between two looks at it, and only then; the table itself is as it should be."""
    right, left = interleave(device, all_orders, "key", 1)
    assert np.isin(left, (1, 10)).all()
    assert 0 < np.count_nonzero(~right) < 0.1 * len(right)
    for order in all_orders[~right]:
        reads = np.flatnonzero(order == 0)
        both_wrote = [np.flatnonzero(order == writer) for writer in (1, 2)]
        assert all((reads[0] < steps[-1]) & (steps[-1] < reads[-1]) for steps in both_wrote)
        assert both_wrote[0][-1] < both_wrote[1][0]
