"""The filters' benchmark: what it measures, and the bytes that it counts."""

import pytest

from clcache.bench import Job
from clcache.bench.filters import PAIRS, filters

SCENE = """
[meshes.wall]
generator = "plane"
size = [4.0, 4.0]
[[instances]]
mesh = "wall"
[environment]
color = [0.5, 0.6, 0.7]
[camera]
position = [0.0, 3.0, 3.0]
look_at = [0.0, 0.0, 0.0]
fov_y = 45.0
"""


@pytest.mark.parametrize(("size", "padded"), [((32, 16), 64 * 20), ((48, 20), 80 * 24)])
def test_all_passes_of_both_kinds(tmp_path, size, padded):
    """For each filter the passes and their sum, with the bytes of their images: of motion, a pixel's surface, its vector and
    depth, what it takes to find the point, and, to find what was hidden or mixed, from where to where the frame before reached, with
    padding."""
    file, pixels = tmp_path / "wall.toml", size[0] * size[1]
    file.write_text(SCENE)
    results = {r.name: r for r in filters(Job(("filters",), None, None, 2, size, (str(file),)))}
    for temporal, blend in PAIRS:
        for kind in (temporal, f"stereo {blend}"):
            total = results[kind]
            steps = [r for name, r in results.items() if name.startswith(f"{kind} ")]
            assert len(steps) >= 2
            assert all(len(r.seconds) == 2 and r.items == pixels and min(r.seconds) > 0 for r in (total, *steps))
            assert total.nbytes == sum(r.nbytes for r in steps)
        reach = 8 * padded if temporal == "varianceblend" else 0
        motion = results[f"{temporal} motion"].nbytes - reach
        assert pixels * (16 + 12 + 48) <= motion <= pixels * (16 + 12 + 48) + 500
        assert results[f"{temporal} filter"].nbytes - reach >= pixels * (28 + 16 + 12 + 4 + 16)
        assert results[f"stereo {blend} near"].nbytes == 2 * pixels * (16 + 4 + 48)
