"""Light of surfaces whose emission a graph computes: it is found by rays alone, and counts once."""

from dataclasses import replace

import numpy as np
import pytest
from graph_materials import by_graph
from render_helpers import BLACK, MODELLED, grey, image, lit, shape_mesh, view

from clcache.scene.generators import plane
from clcache.scene.model import PointLight

RADIANCE = 2.0


def lamp(by):
    """Of the same radiance all over, computed by a graph or said by a constant."""
    if by == "graph":
        return by_graph("emission", scale=0.0, offset=RADIANCE, base_color=BLACK)
    return grey(0.0, RADIANCE)


def room(*lamps, lights=()):
    """A floor and, close above it, a lamp that covers it, of the first of these materials; the others stand aside, out of sight."""
    meshes = [shape_mesh(plane((4, 4)))]
    meshes += [shape_mesh(plane((3, 3)), material + 1) for material in range(len(lamps))]
    aside = [np.array([[1.0, 0, 0, 9 * k], [0, -1, 0, 1], [0, 0, -1, 0]]) for k in range(len(lamps))]
    instances = [(0, np.eye(4)[:3]), *((k + 1, matrix) for k, matrix in enumerate(aside))]
    camera = view((0, 0.5, 0), (0, 0, 0), up=(0, 0, 1), degrees=60)
    return lit(*meshes, camera=camera, materials=[grey(0.5), *lamps], lights=lights, instances=instances)


def measured(scene, **options):
    """Mean of all pixels, and its standard error."""
    pixels = image(scene, (48, 48), 8, sampler=MODELLED, bounces=0, **options).mean(axis=2).astype(float).ravel()
    return pixels.mean(), pixels.std() / np.sqrt(pixels.size)


def apart(a, b):
    """By how many standard errors two means differ."""
    return abs(a[0] - b[0]) / np.hypot(a[1], b[1])


@pytest.mark.parametrize(
    "others", [{}, {"lights": (PointLight((0, 0.9, 0), (1.0, 1.0, 1.0)),)}], ids=["alone", "beside a sampled light"]
)
def test_it_lights_as_a_lamp_does(others):
    """The lamp by a constant is sampled, and found by rays, too; their weights add up to 1."""
    sampled, found = (measured(room(lamp(by), **others)) for by in ("constant", "graph"))
    assert found[1] > sampled[1] > 0  # the one is noisier, having rays alone
    assert apart(sampled, found) < 3.3
    assert apart(sampled, (2 * found[0], 2 * found[1])) > 10


def test_lamps_of_both_kinds_light_together():
    """A second lamp, which is sampled, changes nothing of what rays find of the first."""
    far = room(lamp("graph"), grey(0.0, 1.0))
    both, sampled = measured(far), measured(room(lamp("constant"), grey(0.0, 1.0)))
    assert apart(both, sampled) < 3.3


def test_it_is_seen():
    """Of the radiance that the graph computes; black from behind where it is single-sided."""
    camera = view((0, 0.5, 0), (0, 1, 0), up=(0, 0, 1), degrees=30)
    front = replace(room(lamp("graph")), camera=camera)
    np.testing.assert_allclose(image(front, (8, 8), 1), RADIANCE, rtol=1e-6)
    one_sided = tuple(replace(m, double_sided=False) for m in front.materials)
    np.testing.assert_allclose(image(replace(front, materials=one_sided), (8, 8), 1), RADIANCE, rtol=1e-6)
    above = replace(front, materials=one_sided, camera=view((0, 1.5, 0), (0, 1, 0), up=(0, 0, 1), degrees=30))
    assert not image(above, (8, 8), 1).any()
