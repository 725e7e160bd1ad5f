"""Changes over the footprint: on the device as by dual numbers, and those as finite differences in float64."""

import numpy as np
import pytest
from graph_nodes import OVERLOADS, NodesOnDevice, Sockets, is_dual, label, run_in_numpy, width_of

from clcache.scene.model import Texture

# Nodes whose outputs can carry changes, and those of them that do not change but in steps.
DUALS = [o for o in OVERLOADS if any(is_dual(t) for t in o.outputs.values())]
KINDS = sorted({o.kind for o in DUALS})
IN_STEPS = {"Sign", "Floor", "Ceil", "Round", "And", "Or", "Xor", "Not", "CellNoise2D", "CellNoise3D"}
INTEGERS = {"Octaves": (1, 3), "Style": (0, 1), "Index": (0, 1, 2, 3), "Texture": (0,)}
ROWS = 400


@pytest.fixture(scope="module")
def picture():
    return Texture("noise", np.random.default_rng(3).integers(0, 256, (8, 8, 4), dtype=np.uint8), srgb=False)


@pytest.fixture(scope="module")
def nodes(device, picture):
    return NodesOnDevice(device, texture=picture)


def cases(kind):
    """Each overload of a kind with each choice of its integer."""
    for overload in DUALS:
        if overload.kind == kind:
            for integer in INTEGERS[overload.integers[0]] if overload.integers else (None,):
                yield overload, dict.fromkeys(overload.integers, integer)


def given_numbers(overload, seed, dtype=np.float32):
    """Numbers on both sides of 0 and in 0 .. 1, with changes."""
    rng = np.random.default_rng(seed)
    values, changes = {}, {}
    for name, type_name in overload.inputs.items():
        shape = (ROWS, width_of(type_name))
        numbers = rng.normal(size=shape) * 1.5
        numbers[: ROWS // 2] = rng.uniform(0.02, 0.97, (ROWS // 2, shape[1]))
        numbers += np.copysign(0.01, numbers)  # away from 0: divisors without thousands of turns in a footprint
        values[name] = numbers.astype(np.float32).astype(dtype)
        if is_dual(type_name):
            changes[name] = rng.normal(size=(2, *shape)).astype(np.float32).astype(dtype)
    return Sockets(values, changes)


def moved(given, by):
    """The same with each value moved by so much of its change along one axis: (axis, part)."""
    axis, part = by
    values = {n: v + part * given.changes[n][axis] if n in given.changes else v for n, v in given.values.items()}
    return Sockets(values, given.changes)


@pytest.mark.parametrize("kind", KINDS)
def test_as_dual_numbers(nodes, picture, kind):
    """Within twenty times what a last bit of the inputs does, and 1e-5."""
    for overload, integers in cases(kind):
        given = given_numbers(overload, 1)
        expected = run_in_numpy(overload, given, integers, picture).changes
        spread = {name: np.zeros_like(c) for name, c in expected.items()}
        rng = np.random.default_rng(2)
        for _ in range(8):
            shaken = {
                n: (v * (1 + 2e-7 * rng.choice([-1, 0, 1], v.shape))).astype(np.float32)
                for n, v in given.values.items()
            }
            other = run_in_numpy(overload, Sockets(shaken, given.changes), integers, picture).changes
            spread = {name: np.maximum(s, np.abs(other[name] - expected[name])) for name, s in spread.items()}
        found = nodes(overload, given, integers).changes
        assert found.keys() == expected.keys()
        for name, change in expected.items():
            margin = 20 * spread[name] + 1e-5 * (1 + np.abs(change))
            assert (np.abs(found[name] - change) <= margin).all(), (label(overload), name)
            assert (margin < 1e-3 * (1 + np.abs(change))).mean() > 0.95  # what is compared at all


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "Image"])  # whose changes are differences by definition
def test_dual_numbers_as_finite_differences(kind):
    """Central differences over a small part of the footprint; where two of them disagree there is a kink."""
    for overload, integers in cases(kind):
        given = given_numbers(overload, 3, np.float64)
        changes = run_in_numpy(overload, given, integers).changes
        for axis in (0, 1):
            wide, narrow = (
                {
                    name: (after - run_in_numpy(overload, moved(given, (axis, -part)), integers).values[name])
                    / (2 * part)
                    for name, after in run_in_numpy(overload, moved(given, (axis, part)), integers).values.items()
                }
                for part in (1e-5, 4e-6)
            )
            for name, change in changes.items():
                is_smooth = np.abs(wide[name] - narrow[name]) <= 1e-4 * (1 + np.abs(narrow[name]))
                assert is_smooth.mean() > 0.9, label(overload)
                difference = np.abs(change[axis] - narrow[name])[is_smooth]
                assert (difference <= 2e-4 * (1 + np.abs(narrow[name][is_smooth]))).all(), (label(overload), name)


@pytest.mark.parametrize("kind", KINDS)
def test_only_steps_do_not_change(nodes, kind):
    for overload, integers in cases(kind):
        given = given_numbers(overload, 4)
        changes = nodes(overload, given, integers).changes
        is_still = kind in IN_STEPS or integers.get("Style") == 1
        assert all(c.any() != is_still for c in changes.values()), label(overload)


def test_a_still_footprint_does_not_change(nodes, picture):
    """Zero changes in, zero changes out, also where slopes are steep or without end."""
    for overload in DUALS:
        for _, integers in [c for c in cases(overload.kind) if c[0] is overload]:
            given = given_numbers(overload, 5)
            still = Sockets(given.values, {name: np.zeros_like(c) for name, c in given.changes.items()})
            assert not any(c.any() for c in nodes(overload, still, integers).changes.values()), label(overload)
