"""Checks that every mesh and transform passes before it enters a scene, whatever file it came from."""

from collections import Counter

import numpy as np

from ..errors import SceneError
from .model import Mesh, Track

ZERO_AREA = "zero-area triangles"

# A cross product of float64 differences carries a rounding error of a few units in the last place of |a||b|; below
# this fraction of |a||b| it is indistinguishable from zero.
_CROSS_EPSILON = 2.0**-50

# Below this ratio of the smallest to the largest stretch, float32 cannot tell a transform from a projection to a plane.
_FLATTEST = 1e-7


def make_mesh(
    where: str,
    name: str,
    positions: np.ndarray,
    triangles: np.ndarray,
    material: np.ndarray | int,
    dropped: Counter[str],
    normals: np.ndarray | None = None,
    uvs: np.ndarray | None = None,
) -> Mesh | None:
    """A checked `Mesh` from arrays of any numeric dtype, shaped as in `Mesh`; None if no triangle has an area.

    where: file (and place in it) that the messages begin with. material: per triangle, or one index for all. dropped:
    counts the triangles left out. Normals are brought to unit length; zero ones stay zero, which means flat shading.
    Raises SceneError that names the mesh and the first offending index.
    """
    where = f"{where}: mesh {name!r}"
    if len(positions) == 0 or len(triangles) == 0:
        raise SceneError(f"{where}: has no {'vertices' if len(positions) == 0 else 'triangles'}")
    positions = _finite(where, "position", positions, 3)
    _check_indices(where, triangles, len(positions))
    triangles = np.ascontiguousarray(triangles, np.uint32)
    material = np.broadcast_to(np.asarray(material, np.uint32), len(triangles))
    keep = has_area(positions, triangles)
    if not keep.all():
        dropped[ZERO_AREA] += int(len(keep) - np.count_nonzero(keep))
        triangles, material = triangles[keep], material[keep]
    if len(triangles) == 0:
        return None
    if normals is not None:
        normals = _unit(_finite(where, "normal", _per_vertex(where, "normals", normals, positions), 3))
    if uvs is not None:
        uvs = _finite(where, "texture coordinate", _per_vertex(where, "texture coordinates", uvs, positions), 2)
    return Mesh(name, positions, triangles, np.ascontiguousarray(material), normals, uvs)


def has_area(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: whether a triangle's corners, as float32, are not on one line. Holds at every scale of float32."""
    a, b, c = (positions[triangles[:, corner]].astype(np.float64) for corner in range(3))
    b -= a
    c -= a
    cross = np.cross(b, c)
    squared = np.einsum("ij,ij->i", cross, cross)
    bound = np.einsum("ij,ij->i", b, b) * np.einsum("ij,ij->i", c, c)
    return squared > bound * _CROSS_EPSILON**2


def check_transform(where: str, transform: np.ndarray) -> np.ndarray:
    """The (3, 4) transform as float64, if it is finite and invertible. Raises SceneError."""
    transform = np.asarray(transform, np.float64)
    if not np.isfinite(transform).all() or np.abs(transform).max() > np.finfo(np.float32).max:
        raise SceneError(f"{where}: the transform has entries that are not finite; expected 12 finite numbers")
    stretch = np.linalg.svd(transform[:, :3], compute_uv=False)
    if not stretch[2] > _FLATTEST * stretch[0]:
        raise SceneError(
            f"{where}: the transform cannot be inverted; it flattens the mesh (stretches by "
            f"{stretch[0]:.3g}, {stretch[1]:.3g}, {stretch[2]:.3g})"
        )
    return transform


def check_chain(where: str, motion: tuple[Track | np.ndarray, ...]) -> tuple[Track | np.ndarray, ...]:
    """The chain, if each fixed transform in it passes `check_transform`. Tracks are checked where they are made."""
    return tuple(link if isinstance(link, Track) else check_transform(where, link) for link in motion)


def _finite(where: str, what: str, values: np.ndarray, width: int) -> np.ndarray:
    if values.ndim != 2 or values.shape[1] != width:
        raise SceneError(f"{where}: {what}s have the shape {values.shape}; expected (n, {width})")
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(values, np.float32)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise SceneError(f"{where}: {what} {first} is {tuple(values[first].tolist())}; expected finite float32 numbers")
    return values


def _per_vertex(where: str, what: str, values: np.ndarray, positions: np.ndarray) -> np.ndarray:
    if len(values) != len(positions):
        raise SceneError(f"{where}: {len(values)} {what} for {len(positions)} positions; expected as many")
    return values


def _check_indices(where: str, triangles: np.ndarray, vertex_count: int) -> None:
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise SceneError(f"{where}: triangles have the shape {triangles.shape}; expected (n, 3) whole numbers")
    bad = (triangles < 0) | (triangles >= vertex_count)
    if bad.any():
        triangle, corner = divmod(int(np.argmax(bad)), 3)
        raise SceneError(
            f"{where}: triangle {triangle} uses vertex {triangles[triangle, corner]}; expected 0 .. {vertex_count - 1}"
        )


def _unit(normals: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    return (normals / np.where(length == 0, 1, length)).astype(np.float32)
