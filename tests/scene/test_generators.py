import numpy as np
import pytest
import trimesh

from clcache.scene import generators


def areas(shape):
    a, b, c = (np.asarray(shape.positions, float)[shape.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def volume(shape):
    a, b, c = (np.asarray(shape.positions, float)[shape.triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def is_closed(shape):
    """Whether every edge is used once in each direction, once vertices at the same place are one."""
    _, same = np.unique(np.round(shape.positions, 9), axis=0, return_inverse=True)
    corners = same.ravel()[shape.triangles]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    forth, back = (np.sort(e[:, 0].astype(np.int64) * same.size + e[:, 1]) for e in (edges, edges[:, ::-1]))
    return len(np.unique(forth)) == len(forth) and np.array_equal(forth, back)


@pytest.mark.parametrize("subdivisions", range(6))
def test_sphere(subdivisions):
    shape = generators.sphere(2.0, subdivisions)
    assert len(shape.triangles) == 20 * 4**subdivisions
    assert is_closed(shape)
    assert np.allclose(np.linalg.norm(shape.positions, axis=1), 2)
    assert np.allclose(shape.normals * 2, shape.positions)
    area = np.linalg.norm(areas(shape), axis=1)
    # An inscribed polyhedron falls short by a fraction that each subdivision nearly quarters.
    short = 1 - np.array([area.sum() / (16 * np.pi), volume(shape) / (32 * np.pi / 3)])
    assert (short > 0).all() and (short < 0.4 / 3**subdivisions).all()
    assert area.max() / area.min() < 2.1


def test_sphere_against_an_independent_one():
    theirs = trimesh.creation.icosphere(subdivisions=0)
    ours = generators.sphere(1.0, 0)
    assert np.isclose(volume(ours), theirs.volume) and np.isclose(
        np.linalg.norm(areas(ours), axis=1).sum(), theirs.area
    )


@pytest.mark.parametrize("subdivisions", [0, 3])
def test_sphere_coordinates_are_latitude_and_longitude_without_a_jump(subdivisions):
    shape = generators.sphere(1.0, subdivisions)
    u, v = shape.uvs.T
    assert np.allclose(np.cos(np.pi * v), shape.positions[:, 1], atol=1e-6)
    around = np.hypot(shape.positions[:, 0], shape.positions[:, 2])
    assert np.allclose(around * np.sin(2 * np.pi * u), shape.positions[:, 0], atol=1e-6)
    assert np.allclose(around * np.cos(2 * np.pi * u), shape.positions[:, 2], atol=1e-6)
    corners = shape.uvs[shape.triangles]
    assert np.ptp(corners[:, :, 0], axis=1).max() <= 0.5
    edge_a, edge_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    covered = np.abs(edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]).sum() / 2
    assert 1 - 0.36 / 2**subdivisions < covered < 1  # all but a half of the row at each pole


def test_box():
    shape = generators.box((1.0, 2.0, 3.0))
    assert is_closed(shape) and len(shape.triangles) == 12
    assert np.isclose(volume(shape), 6)
    assert np.isclose(np.linalg.norm(areas(shape), axis=1).sum(), 2 * (2 + 3 + 6))
    assert shape.positions.min(axis=0).tolist() == [-0.5, -1, -1.5]
    assert shape.uvs.min() == 0 and shape.uvs.max() == 1


@pytest.mark.parametrize("cells", [(1, 1), (3, 5)])
def test_grid_faces_up(cells):
    shape = generators.grid((2.0, 4.0), cells)
    assert len(shape.triangles) == 2 * cells[0] * cells[1]
    assert np.allclose(areas(shape), [0, 4 / (cells[0] * cells[1]), 0])
    assert np.allclose(
        shape.positions, np.column_stack([shape.uvs[:, 0] * 2 - 1, 0 * shape.uvs[:, 0], shape.uvs[:, 1] * 4 - 2])
    )


def test_plane_is_a_grid_of_one_cell():
    for ours, theirs in zip(generators.plane((2.0, 4.0)), generators.grid((2.0, 4.0), (1, 1)), strict=True):
        assert ours is theirs is None or np.array_equal(ours, theirs)


@pytest.mark.parametrize(("triangles", "segments"), [(1, 1), (7, 3), (1000, 50), (1001, 7)])
def test_hairball_has_the_triangles_asked_for(triangles, segments):
    shape = generators.hairball(triangles, segments, 2.0, 0.01, 3)
    assert shape.triangles.shape == (triangles, 3) and shape.triangles.max() < len(shape.positions)
    assert np.isfinite(shape.positions).all()
    assert np.linalg.norm(shape.positions, axis=1).max() <= 2.0
    assert (np.linalg.norm(areas(shape), axis=1) > 0).all()


def test_hairball_follows_its_seed():
    first, again, other = (generators.hairball(500, 10, 1.0, 0.01, seed).positions for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_hairball_reaches_from_the_core_to_the_surface():
    distance = np.linalg.norm(generators.hairball(20_000, 20, 1.0, 0.001, 1).positions, axis=1)
    assert distance.min() < 0.1 and distance.max() > 0.95


def test_hairs_are_as_thick_as_asked_for():
    positions = generators.hairball(1000, 10, 1.0, 0.01, 1).positions.reshape(-1, 2, 3)
    assert np.allclose(np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1), 0.01, rtol=1e-3)
