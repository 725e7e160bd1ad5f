"""Materials without a graph in scenes that have some: they are what they are in others."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import one_device
from graph_materials import by_graph
from render_helpers import BLACK, everything, image, lit, shape_mesh, view

from clcache.graph import OUTPUTS
from clcache.scene.generators import plane, sphere
from clcache.scene.model import Material

FAR = np.column_stack([1e-4 * np.eye(3), [4e4, -3e4, 5e4]])
SURFACES = {
    "bright highlights": Material("", BLACK, specular=1.0, specular_color=(8.0, 4.0, 2.0), roughness=0.5),
    "metal": Material("", (0.9, 0.5, 0.2), metallic=1.0, roughness=0.3),
    "glass": Material("", specular=1.0, transmission=1.0, roughness=0.2, ior=1.4),
    "lamp": Material("", (0.2, 0.2, 0.2), emission=(30.0, 1e4, 2e-3)),
}


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def beside(scene, other):
    """The scene, and far outside of it something small of this material."""
    speck = shape_mesh(plane((1, 1)), len(scene.materials))
    instances = (*scene.instances, replace(scene.instances[0], mesh=len(scene.meshes), transform=FAR))
    return replace(scene, meshes=(*scene.meshes, speck), materials=(*scene.materials, other), instances=instances)


def assert_no_change(scene):
    plain = Material("plain", metallic=0.5, specular=0.5)
    everywhere = by_graph(*OUTPUTS, scale=5.0)
    expected, found = (image(beside(scene, other), (24, 16), 8) for other in (plain, everywhere))
    assert expected.max() > 0.05
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("material", SURFACES.values(), ids=SURFACES)
def test_surfaces_are_what_they_are_without_graphs(material):
    ball = shape_mesh(sphere(1.0, 2), smooth=True)
    assert_no_change(lit(ball, camera=view((0, 0, 3), (0, 0, 0)), materials=[material], environment=(0.5, 0.7, 1.0)))


def test_scenes_are_what_they_are_without_graphs():
    assert_no_change(everything())
