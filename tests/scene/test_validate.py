from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from clcache.errors import SceneError
from clcache.scene.validate import check_transform, has_area, make_mesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], float)
ONE = np.array([[0, 1, 2]])


def make(positions=CORNERS, triangles=ONE, material=0, **more):
    return make_mesh("file", "thing", positions, triangles, material, Counter(), **more)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_area_is_judged_alike_at_every_scale(scale):
    rng = np.random.default_rng(5)
    thin = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]])
    rotations = np.linalg.qr(rng.standard_normal((50, 3, 3)))[0]
    corners = np.einsum("kij,cj->kci", rotations, thin).reshape(-1, 3) * scale
    triangles = np.arange(150).reshape(-1, 3)
    assert has_area(np.float32(corners), triangles).all()
    steps = np.float32(rng.standard_normal((50, 3)) * scale)
    on_a_line = np.stack([np.zeros_like(steps), steps, steps * np.float32(-2)], axis=1)  # exact in float32
    assert not has_area(on_a_line.reshape(-1, 3), triangles).any()


def test_a_line_is_one_where_even_float64_rounds():
    rng = np.random.default_rng(1)
    far = 2.0**34 + rng.integers(0, 2**20, (200, 1)) * 2.0**14
    near = 1 + rng.integers(0, 2**20, (200, 2)) * 2.0**-20
    corners = np.hstack([far, near])[:, :, None] * [1, 3, 5]
    assert np.array_equal(np.float32(corners), corners)
    assert not has_area(np.float32(corners).reshape(-1, 3), np.arange(600).reshape(-1, 3)).any()


@given(
    hnp.arrays(np.float32, 3, elements=st.floats(-1e6, 1e6, width=32)),
    hnp.arrays(np.float32, 3, elements=st.floats(-1e6, 1e6, width=32)),
)
def test_two_equal_corners_never_have_an_area(a, b):
    for corners in ([a, a, b], [a, b, a], [b, a, a]):
        assert not has_area(np.array(corners, np.float32), ONE).any()


def test_dropped_triangles_take_their_material_along():
    dropped = Counter()
    triangles = np.array([[0, 1, 2], [0, 1, 3], [1, 3, 2]])
    mesh = make_mesh("file", "thing", CORNERS, triangles, np.array([4, 5, 6]), dropped)
    assert mesh.triangles.tolist() == [[0, 1, 2], [1, 3, 2]] and mesh.material.tolist() == [4, 6]
    assert dropped == {"zero-area triangles": 1}


def test_a_mesh_without_area_is_none():
    assert make(triangles=np.array([[0, 1, 3]])) is None


def test_empty_meshes_are_refused():
    with pytest.raises(SceneError, match="file: mesh 'thing': has no vertices"):
        make(positions=np.zeros((0, 3)))
    with pytest.raises(SceneError, match="file: mesh 'thing': has no triangles"):
        make(triangles=np.zeros((0, 3), int))


@pytest.mark.parametrize("bad", [-1, 4, 2**32])
def test_indices_out_of_range_name_the_first_triangle(bad):
    triangles = np.array([[0, 1, 2], [0, bad, 2], [bad, 1, 2]])
    with pytest.raises(SceneError, match=rf"mesh 'thing': triangle 1 uses vertex {bad}; expected 0 \.\. 3"):
        make(triangles=triangles)


@pytest.mark.parametrize("more", [{"normals": np.zeros((3, 3))}, {"uvs": np.zeros((5, 2))}, {"uvs": np.zeros((4, 3))}])
def test_attributes_that_do_not_fit_are_refused(more):
    with pytest.raises(SceneError, match="expected"):
        make(**more)


@given(hnp.arrays(np.float64, (4, 3), elements=st.floats(-1e30, 1e30)))
def test_normals_have_unit_length_or_none(normals):
    with np.errstate(under="ignore"):
        length = np.linalg.norm(make(normals=normals).normals.astype(float), axis=1)
    given_length = np.linalg.norm(np.float32(normals).astype(float), axis=1)
    assert np.allclose(length[given_length > 0], 1, atol=1e-6) and (length[given_length == 0] == 0).all()


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_invertible_transforms_pass_whatever_their_size(scale):
    matrix = np.array([[1, 0.5, 0, 1], [0, -1, 0, 2], [0.1, 0, 1, 3]]) * scale
    assert np.array_equal(check_transform("here", matrix), matrix)


@pytest.mark.parametrize("column", [[0, 0, 0], [1, 0, 0], [1, 1e-9, 0], [np.nan, 0, 1], [np.inf, 0, 1], [1e39, 0, 1]])
def test_other_transforms_are_refused(column):
    matrix = np.eye(4)[:3]
    matrix[:, 1] = column
    with pytest.raises(SceneError, match="^here: the transform"):
        check_transform("here", matrix)
