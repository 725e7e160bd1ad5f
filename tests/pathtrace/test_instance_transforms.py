"""A placed mesh against the same mesh with the transform applied to its vertices: the same image, normals and depth."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import MODELLED, ball, camera_rays, floor, lit, render, view

from clcache.scene.model import DirectionalLight, Material, Mesh, PointLight
from clcache.scene.transform import rotation_matrix

SIZE = (48, 36)
TURN = rotation_matrix([0.2, 0.5, -0.3, 0.8])


def placed(matrix, offset=(0.3, 1.2, -0.2)):
    return np.column_stack([matrix, offset])


TRANSFORMS = {
    "translation": placed(np.eye(3)),
    "rotation": placed(TURN),
    "scale": placed(0.4 * np.eye(3)),
    "stretch": placed(np.diag([1.3, 0.4, 0.7])),
    "rotation and stretch": placed(TURN @ np.diag([1.3, 0.4, 0.7])),
    "mirror": placed(np.diag([-1.0, 1.0, 1.0])),
    "mirror, rotation, stretch": placed(TURN @ np.diag([-1.2, 0.5, 0.8]) @ TURN),
    "shear": placed([[1, 0.6, 0], [0, 0.8, 0.3], [0.2, 0, 0.9]]),
    "point reflection": placed(-0.8 * np.eye(3)),
}


def half_ball(smooth: bool) -> Mesh:
    """Lopsided, so that no turn or mirror maps it onto itself, and coloured by triangle."""
    mesh = ball(1, 3, smooth=smooth)
    keep = (mesh.positions[mesh.triangles].mean(axis=1) @ [0.5, 0.7, 0.2]) > -0.4
    triangles = mesh.triangles[keep]
    return replace(mesh, triangles=triangles, material=(1 + np.arange(len(triangles)) % 2).astype(np.uint32))


def transformed(mesh: Mesh, transform: np.ndarray) -> Mesh:
    """Normals keep the length that the transform gives them, so that the same is interpolated between them."""
    positions = mesh.positions @ transform[:, :3].T + transform[:, 3]
    normals = None if mesh.normals is None else (mesh.normals @ np.linalg.inv(transform[:, :3])).astype(np.float32)
    return replace(mesh, positions=positions.astype(np.float32), normals=normals)


def world(mesh: Mesh, transform: np.ndarray):
    return lit(
        floor(),
        mesh,
        camera=view((1, 2.5, 4), (0.2, 0.9, 0)),
        materials=[Material("a", (0.8, 0.8, 0.8)), Material("b", (0.9, 0.3, 0.2)), Material("c", (0.2, 0.4, 0.9))],
        lights=[PointLight((2, 4, 1), (15.0,) * 3), DirectionalLight((-0.6, -0.8, 0.0), (1.0, 2.0, 1.0))],
        environment=(0.3, 0.3, 0.4),
        instances=[(0, IDENTITY), (1, transform)],
    )


@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_same_image(name, smooth):
    """Pixels differ where a sample falls on the other side of an outline or of a shadow's edge, or chooses the other light
    because its share depends on the scene's box: at most 1 in 200."""
    transform, mesh = TRANSFORMS[name], half_ball(smooth)
    options = {"size": SIZE, "spp": 4, "aovs": ("N", "Z", "albedo"), "bounces": 1}
    instanced, baked = (
        render(world(mesh, transform), **options),
        render(world(transformed(mesh, transform), IDENTITY), **options),
    )
    for what in ("color", "N", "Z", "albedo"):
        a, b = ((f.color["mono"] if what == "color" else f.aov(what, "mono")) for f in (instanced, baked))
        finite = np.isfinite(a) & np.isfinite(b)
        assert (np.isfinite(a) == np.isfinite(b)).mean() > 0.999
        differs = np.abs(a[finite] - b[finite]) > 1e-3 * (1 + np.abs(b[finite]))
        assert differs.mean() < 0.005, what


def test_many_instances_of_a_mesh():
    """Twelve placements of one mesh as one mesh."""
    rng = np.random.default_rng(2)
    base = half_ball(False)
    moves = [
        np.column_stack([rotation_matrix(rng.normal(size=4)) * 0.3, rng.uniform(-1, 1, 3) + [0, 1, 0]])
        for _ in range(12)
    ]
    parts = [transformed(base, m) for m in moves]
    count = len(base.positions)
    joined = Mesh(
        "joined",
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.triangles + np.uint32(k * count) for k, p in enumerate(parts)]),
        np.concatenate([p.material for p in parts]),
    )
    instanced = replace(world(base, IDENTITY), instances=world(base, IDENTITY).instances[:1] + tuple(
        replace(world(base, IDENTITY).instances[1], transform=m) for m in moves
    ))  # fmt: skip
    a, b = (render(s, SIZE, 2, bounces=1, aovs=("Z",)) for s in (instanced, world(joined, IDENTITY)))
    differs = (np.abs(a.color["mono"] - b.color["mono"]) > 1e-3).any(axis=2)
    assert differs.mean() < 0.01
    assert np.isfinite(a.aov("Z", "mono")).any()


def test_normals_of_a_stretched_sphere():
    """Those of the ellipsoid x^2/a^2 + y^2/b^2 + z^2/c^2 = 1: along (x/a^2, y/b^2, z/c^2)."""
    axes = np.array([2.0, 0.5, 1.0])
    camera = view((1, 2, 5), (0, 0, 0), 30)
    scene = lit(ball(1, 5, smooth=True), camera=camera, instances=[(0, np.column_stack([np.diag(axes), np.zeros(3)]))])
    frame = render(scene, SIZE, aovs=("N", "Z"), sampler=MODELLED)
    origin, directions = camera_rays(camera, SIZE)
    depth = frame.aov("Z", "mono")
    hit = np.isfinite(depth)
    points = origin + directions[hit] * (depth[hit] / (directions[hit] @ -camera.transform[:, 2]))[:, None]
    expected = points / axes**2
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    facing = -np.sum(expected * directions[hit], axis=1) > 0.1
    np.testing.assert_allclose(frame.aov("N", "mono")[hit][facing], expected[facing], atol=0.01)
