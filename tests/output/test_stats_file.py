"""The statistics file is strict JSON, whole or not there."""

import json

import numpy as np
import pytest

from clcache.output.stats import write_stats


def test_round_trip_with_numpy_numbers(tmp_path):
    write_stats(
        tmp_path / "s.json",
        {"method": "pathtrace", "seed": 2**64 - 1},
        [{"frame": np.int32(3), "seconds": np.float32(0.5)}],
    )
    loaded = json.loads((tmp_path / "s.json").read_text())
    assert loaded == {"method": "pathtrace", "seed": 2**64 - 1, "frames": [{"frame": 3, "seconds": 0.5}]}


def test_what_json_cannot_hold_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_stats(tmp_path / "s.json", {"seconds": float("nan")}, [])
    assert list(tmp_path.iterdir()) == []
