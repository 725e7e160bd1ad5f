"""What tells scenes apart: everything that they show, and apart from that where they are seen from."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import yard
from render_helpers import everything, view

from clcache.scene.digest import camera_digest, scene_digest
from clcache.scene.model import Environment, Track


def first(items, **changes):
    """The items, with the first one changed."""
    return (replace(items[0], **changes), *items[1:])


def moved(scene, by):
    """The last instance's first track, shifted."""
    track = scene.instances[-1].motion[0]
    instance = replace(scene.instances[-1], motion=(replace(track, translation=track.translation + by),))
    return replace(scene, instances=(*scene.instances[:-1], instance))


CHANGES = {
    "a vertex": lambda s: replace(s, meshes=first(s.meshes, positions=s.meshes[0].positions + np.float32(1e-6))),
    "a triangle": lambda s: replace(s, meshes=first(s.meshes, triangles=s.meshes[0].triangles[:, ::-1])),
    "normals": lambda s: replace(s, meshes=(s.meshes[0], replace(s.meshes[1], normals=None), *s.meshes[2:])),
    "an instance": lambda s: replace(s, instances=s.instances[:-1]),
    "a transform": lambda s: replace(s, instances=first(s.instances, transform=s.instances[0].transform * 1.5)),
    "a material": lambda s: replace(s, materials=first(s.materials, roughness=0.99)),
    "a map": lambda s: replace(s, materials=first(s.materials, base_color_texture=None)),
    "a texel": lambda s: replace(s, textures=first(s.textures, pixels=s.textures[0].pixels ^ np.uint8(1))),
    "a wrap mode": lambda s: replace(s, textures=first(s.textures, wrap=("clamp", "repeat"))),
    "a light": lambda s: replace(s, lights=s.lights[1:]),
    "a light's kind of number": lambda s: replace(s, lights=first(s.lights, position=(2, 3, 2.5))),
    "the environment": lambda s: replace(s, environment=Environment.constant((0.2, 0.3, 0.6))),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_shown_tells_scenes_apart(change):
    scene = everything()
    assert scene_digest(CHANGES[change](scene)) != scene_digest(scene)
    assert camera_digest(CHANGES[change](scene)) == camera_digest(scene)


def test_motion_tells_scenes_apart():
    assert scene_digest(moved(yard(), 0.0)) == scene_digest(yard())
    assert scene_digest(moved(yard(), 0.1)) != scene_digest(yard())


def test_neighbouring_arrays_are_not_mixed_up():
    """The same numbers, divided differently between two arrays."""
    scene = everything()
    mesh = scene.meshes[0]
    joined = np.concatenate([mesh.positions, mesh.normals]) if mesh.normals is not None else mesh.positions
    a = replace(scene, meshes=(replace(mesh, positions=joined[:2], normals=joined[2:]),))
    b = replace(scene, meshes=(replace(mesh, positions=joined[:3], normals=joined[3:]),))
    assert scene_digest(a) != scene_digest(b)


@pytest.mark.parametrize(
    "change",
    [
        lambda s: replace(s, camera=view((0, 1, 5), (0, 0, 0))),
        lambda s: replace(s, camera=replace(s.camera, fov_y=0.5)),
        lambda s: replace(
            s, camera=replace(s.camera, motion=(Track(np.zeros(1), np.zeros((1, 3)), np.eye(4)[3:], np.ones((1, 3))),))
        ),
        lambda s: replace(s, defaults=replace(s.defaults, fps=25.0)),
        lambda s: replace(s, defaults=replace(s.defaults, eye_distance=0.2)),
    ],
)
def test_the_way_of_looking_is_told_apart_by_itself(change):
    scene = everything()
    assert camera_digest(change(scene)) != camera_digest(scene)
    assert scene_digest(change(scene)) == scene_digest(scene)


def test_names_of_files_and_defaults_that_show_nothing_are_left_out():
    scene = everything()
    other = replace(scene, file="elsewhere.toml", notes=("a note",), defaults=replace(scene.defaults, spp=9, seed=4))
    assert (scene_digest(other), camera_digest(other)) == (scene_digest(scene), camera_digest(scene))
