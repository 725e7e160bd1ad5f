"""Kernels against a build of the same source in double precision, at small counts
(clcache/experiments/precision.py)."""

from dataclasses import replace

import numpy as np
import pytest

from clcache.experiments import precision
from clcache.experiments.job import Machine
from clcache.experiments.precision import STUDIES, in_double, measure, ulp, widened
from clcache.layout import STRUCTS

ROWS = 4000
# In ulps of what errors are judged by: the median, 99.9 % and the worst that there may be, some four times those of
# many more rows. What
# cancels where it should not is off by thousands to millions.
BOUNDS = {
    "x": (1, 4, 6),
    "y": (1, 4, 6),
    "distance": (1, 4, 6),
    "slope": (1.5, 40, 60),
    "variance": (4, 120, 400),
    "published alpha": (1, 6, 8),
    "corrected alpha": (1.5, 60, 800),
    "effective N": (1, 30, 80),
    "1 - beta": (3, 80, 200),
    "t": (2, 2000, np.inf),  # rays almost within a triangle's plane have no end of it
    "u": (5, 20000, np.inf),
    "v": (5, 20000, np.inf),
}
MEASURES = ("median", "p99.9", "worst")


@pytest.fixture
def wide_device(device):
    if not device.capabilities.fp64:
        pytest.skip("no double precision here")
    return device


def is_good(row):
    return all(row[m] <= bound for m, bound in zip(MEASURES, BOUNDS[row["quantity"]], strict=True))


@pytest.mark.parametrize("name", STUDIES)
def test_float32_is_as_good_as_can_be(wide_device, name):
    """And float64 agrees with NumPy, to a part of float32's steps."""
    for magnitude in (STUDIES[name].magnitudes[0], STUDIES[name].magnitudes[-1]):
        for row in measure(wide_device, STUDIES[name], magnitude, ROWS, 5):
            assert is_good(row), row
            assert row["median"] > 0 and row["values"] > 0.9 * ROWS
            # Eq. 1 is told an angle's sine and cosine, each rounded, and the model takes the angle.
            assert row["numpy"] < (0.6 if name == "Eq. 1" else 1e-3), row
            if name == "traversal":
                assert row["boxes missed"] == 0 and row["differing"] <= 4, row


@pytest.mark.parametrize(
    ("name", "what", "worse"),
    [
        ("moments", "moments.lo - origin", "moments.lo"),
        ("Eq. 1", "(fabs(sine * phi_sine - cosine * phi_versine) / turned)", "fabs(1.0f - cosine / turned)"),
        ("stereo weights", "value - y : 0.0f", "value : 0.0f"),
        ("reprojection", "0.5f + 0.5f * view.x", "1e3f + 0.5f * view.x - 999.5f * (depth * camera->slope[0])"),
    ],
)
def test_what_cancels_would_be_seen(wide_device, monkeypatch, name, what, worse):
    """The same formulas in forms that are as right, and lose their digits: what float64 says stays what it was."""
    source = precision.read_source

    def spoilt(file):
        text = source(file)
        assert text.count(what) == 1
        return text.replace(what, worse)

    monkeypatch.setattr(precision, "read_source", spoilt)
    study = STUDIES[name]
    rows = [row for m in study.magnitudes for row in measure(wide_device, study, m, ROWS, 5)]
    assert not all(is_good(row) for row in rows)


def test_rewriting():
    """Types, literals, masks of vectors, bits, and the constants of rounding; nothing else."""
    text = (
        "#define UNIT_ROUNDOFF 5.9604645e-8f  // 2^-24\n"
        "inline float3 f(float8 a, int8 b, int c)\n"
        "{ return as_float(as_uint(a.s0) + 0x3F3504F3u) * 1e-3f + 2.0f - .5e0 + (float)c; }\n"
        "float16 g = convert_float16(as_int16(a) & INT_MIN);\n"
    )
    found = in_double(text)
    assert "#define UNIT_ROUNDOFF 1.1102230246251565e-16  // 2^-24" in found
    assert "inline double3 f(double8 a, long8 b, int c)\n" in found
    assert "{ return wide_of_bits(bits_of_narrow(a.s0) + 0x3F3504F3u) * 1e-3 + 2.0 - .5e0 + (double)c; }" in found
    assert "double16 g = convert_double16(as_long16(a) & LONG_MIN);" in found


def test_structs_of_doubles_are_whole_vectors():
    for name in ("Node", "Block"):
        dtype = widened(STRUCTS[name])
        assert dtype.itemsize % 64 == 0
        assert all(base == np.float64 or base.kind in "ui" for base in (dtype.fields[n][0].base for n in dtype.names))
    assert widened(STRUCTS["Block"])["positions"] == np.dtype(("f8", 72))


def test_ulps():
    values = np.float32([1.0, 1.5, 2.0, 1e-3, 1e30, 1280])
    np.testing.assert_array_equal(ulp(values), np.spacing(values).astype(float))


def test_without_double_precision_it_says_so(monkeypatch, device_spec):
    opened = Machine.open

    def narrow(machine, **options):
        device = opened(machine, **options)
        device.capabilities = replace(device.capabilities, fp64=False)
        return device

    monkeypatch.setattr(Machine, "open", narrow)
    rows = precision.run({"study": "moments", "rows": 10, "seed": 1}, {}, Machine(device_spec)).rows
    assert len(rows) == 4 and {row["measured"] for row in rows} == {"no: no fp64"} and "worst" not in rows[0]
