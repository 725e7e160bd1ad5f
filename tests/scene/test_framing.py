import math

import numpy as np
import pytest
import trimesh

from clcache.scene import DirectionalLight, PointLight, load_scene
from clcache.scene.framing import _cast, _gather
from clcache.scene.part import Part

RED = "[materials.a]\nbase_color = [1, 0, 0]\n"


def box(name, size, at, turned_in=False, extra=""):
    """A TOML box; one that is mirrored shows its faces to the inside."""
    scale = -1 if turned_in else 1
    return (
        f'[meshes.{name}]\ngenerator = "box"\nsize = {size}\n[[instances]]\nmesh = "{name}"\n'
        f"scale = [{scale}, {scale}, {scale}]\ntranslation = {at}\n{extra}"
    )


def room(width, height, depth, open_sides=""):
    """Walls about the origin that face inwards, on a floor at y = 0, without those named by their axis and sign."""
    walls = {
        "-y": ([width, depth], [0, 0, 0], [1, 0, 0], 0),
        "+y": ([width, depth], [0, height, 0], [1, 0, 0], 180),
        "-z": ([width, height], [0, height / 2, -depth / 2], [1, 0, 0], 90),
        "+z": ([width, height], [0, height / 2, depth / 2], [1, 0, 0], -90),
        "-x": ([height, depth], [-width / 2, height / 2, 0], [0, 0, 1], -90),
        "+x": ([height, depth], [width / 2, height / 2, 0], [0, 0, 1], 90),
    }
    text = ""
    for number, (side, (size, at, axis, degrees)) in enumerate(walls.items()):
        if side not in open_sides:
            text += (
                f'[meshes.wall{number}]\ngenerator = "grid"\nsize = {list(size)}\ncells = [4, 4]\n'
                f'[[instances]]\nmesh = "wall{number}"\ntranslation = {at}\n'
                f"rotation = {{axis = {axis}, degrees = {degrees}}}\n"
            )
    return text


def load(tmp_path, text):
    (tmp_path / "scene.toml").write_text(text)
    return load_scene(tmp_path / "scene.toml")


def in_picture(scene):
    """(n, 2) places of all vertices in the picture, whose sides are at -1 and 1; nan behind the camera."""
    points = np.concatenate(
        [scene.meshes[i.mesh].positions @ i.transform[:, :3].T + i.transform[:, 3] for i in scene.instances]
    )
    camera = scene.camera
    seen = (points - camera.transform[:, 3]) @ camera.transform[:, :3]
    half = math.tan(camera.fov_y / 2) * np.array([scene.defaults.size[0] / scene.defaults.size[1], 1])
    return np.where(seen[:, 2:] < 0, seen[:, :2] / -seen[:, 2:] / half, np.nan)


def eye(scene):
    return scene.camera.transform[:, 3]


def ahead(scene):
    return -scene.camera.transform[:, 2]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("centre", [0.0, 1000.0])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 20, 1), (30, 0.2, 10)])
def test_an_object_fills_the_picture_from_outside(tmp_path, shape, centre, scale):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.apply_scale(np.multiply(shape, scale))
    mesh.apply_translation([centre * scale] * 3)
    mesh.export(tmp_path / "a.ply")
    scene = load_scene(tmp_path / "a.ply")
    places = in_picture(scene)
    assert 0.85 < np.abs(places).max() <= 0.95
    assert np.allclose(places.min(axis=0), -places.max(axis=0), atol=0.15)
    assert eye(scene)[1] > mesh.bounds[:, 1].mean() and eye(scene)[2] > mesh.bounds[:, 2].mean()
    assert any("stands outside" in note for note in scene.notes)


def test_a_needle_along_the_line_of_sight_stays_before_the_camera(tmp_path):
    tip = 10 * np.array([0.5, 0.4, 0.8])
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv {tip[0]} {tip[1]} {tip[2]}\nv 0 1e-6 0\nf 1 2 3\n")
    places = in_picture(load_scene(tmp_path / "a.obj"))
    assert np.abs(places).max() <= 0.95  # fails for nan too


def test_the_picture_size_of_the_file_counts(tmp_path):
    scene = load(tmp_path, box("a", [1, 1, 1], [0, 0, 0]) + "[render]\nsize = [100, 800]\n")
    assert 0.85 < np.abs(in_picture(scene)).max() <= 0.95


def test_a_huge_ground_does_not_count(tmp_path):
    text = '[meshes.ball]\ngenerator = "sphere"\n[[instances]]\nmesh = "ball"\ntranslation = [0, 1, 0]\n'
    ground = '[meshes.ground]\ngenerator = "plane"\nsize = [500, 500]\n[[instances]]\nmesh = "ground"\n'
    alone, with_ground = (eye(load(tmp_path, t)) - [0, 1, 0] for t in (text, text + ground))
    assert np.linalg.norm(with_ground) == pytest.approx(np.linalg.norm(alone), rel=0.1)


@pytest.mark.parametrize("top", ["", "+y"])
@pytest.mark.parametrize("size", [(4, 3, 12), (12, 3, 4), (6, 5, 9)])
def test_a_room_is_seen_from_inside_along_its_length(tmp_path, size, top):
    width, height, depth = size
    scene = load(tmp_path, room(*size, open_sides=top))
    assert any("stands inside" in note for note in scene.notes)
    assert (np.abs(eye(scene)[[0, 2]]) < np.array([width, depth]) / 2).all() and 0 < eye(scene)[1] < height
    view = ahead(scene)
    assert abs(view[1]) < 1e-6  # level
    # It looks across the middle: the wall that it faces is farther away than the one behind.
    assert view @ (np.array([0, eye(scene)[1], 0]) - eye(scene)) > 0.3 * max(width, depth)
    lamp = scene.lights[0]
    if top:  # open: the sun shines in
        assert isinstance(lamp, DirectionalLight) and scene.environment.radiance.min() > 0
    else:
        assert isinstance(lamp, PointLight) and scene.environment.radiance.max() == 0
        assert (np.abs(np.array(lamp.position) - [0, height / 2, 0]) < np.array(size) / 2).all()


@pytest.mark.parametrize(
    ("side", "direction"), [("+z", [0, 0, -1]), ("-z", [0, 0, 1]), ("+x", [-1, 0, 0]), ("-x", [1, 0, 0])]
)
def test_a_box_with_one_open_side_is_seen_through_it(tmp_path, side, direction):
    scene = load(tmp_path, room(4, 4, 4, open_sides=side))
    assert any("only open side" in note for note in scene.notes)
    assert np.allclose(ahead(scene), direction)
    assert -(eye(scene) @ direction) > 2
    places = in_picture(scene)
    assert np.abs(places).max() <= 0.95 and places[:, 1].max() > 0.85


def test_a_yard_with_low_walls_under_a_mast_is_no_room(tmp_path):
    yard = room(8, 8, 8, open_sides="+y")
    assert any("stands inside" in note for note in load(tmp_path, yard).notes)
    mast = box("mast", [0.2, 20, 0.2], [3.5, 10, 3.5])
    assert any("stands outside" in note for note in load(tmp_path, yard + mast).notes)


def test_of_a_large_scene_a_share_is_looked_at_with_the_largest_triangles(tmp_path, monkeypatch):
    fine = '[meshes.g]\ngenerator = "grid"\ncells = [40, 40]\n'
    copies = "".join(f'[[instances]]\nmesh = "g"\ntranslation = [{n}, 0, 0]\n' for n in range(50))
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.vertices[np.unique(ball.faces[7])] *= 3  # makes some triangles larger than all others
    ball.export(tmp_path / "ball.ply")
    text = fine + copies + '[meshes.ball]\nfile = "ball.ply"\n[[instances]]\nmesh = "ball"\n'
    scene = load(tmp_path, text)
    part = Part(meshes=list(scene.meshes), instances=list(scene.instances))
    assert len(_gather(part).corners) == scene.triangle_count == 50 * 3200 + 1280
    monkeypatch.setattr("clcache.scene.framing._MOST_TRIANGLES", 10_000)
    world = _gather(part)
    assert 5_000 < len(world.corners) < 12_000
    assert len(np.unique(world.instance)) == 51
    corners = world.corners[world.instance == 50]
    kept = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert np.isclose(kept.max() * world.size**2, ball.area_faces.max(), rtol=1e-3)


def test_a_solid_box_is_no_room(tmp_path):
    assert any("stands outside" in n for n in load(tmp_path, box("a", [4, 3, 12], [0, 0, 0])).notes)


def test_normals_of_the_file_outvote_its_winding(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    lines = [f"v {x} {y} {z}\nvn {x} {y} {z}\n" for x, y, z in ball.vertices]
    lines += [f"f {c}//{c} {b}//{b} {a}//{a}\n" for a, b, c in ball.faces + 1]  # turned inside out
    (tmp_path / "a.obj").write_text("".join(lines))
    assert any("stands outside" in note for note in load_scene(tmp_path / "a.obj").notes)


def test_a_camera_of_the_file_stays_and_only_light_is_chosen(tmp_path):
    scene = load(tmp_path, room(4, 3, 4) + "[camera]\nposition = [1, 1, 1]\nlook_at = [0, 1, 0]\n")
    assert eye(scene).tolist() == [1, 1, 1]
    assert isinstance(scene.lights[0], PointLight)
    assert len(scene.notes) == 1 and "lamp" in scene.notes[0]


def test_emission_is_light(tmp_path):
    scene = load(tmp_path, box("a", [1, 1, 1], [0, 0, 0], extra='material = "a"\n') + RED + "emission = [1, 1, 1]\n")
    assert scene.lights == () and not scene.environment.radiance.any()


def test_emission_of_a_material_that_nothing_has_is_none(tmp_path):
    scene = load(tmp_path, box("a", [1, 1, 1], [0, 0, 0]) + RED + "emission = [1, 1, 1]\n")
    assert len(scene.lights) == 1 and scene.environment.radiance.min() > 0


def test_the_same_file_gives_the_same_view(tmp_path):
    text = room(7, 3, 8) + box("table", [2, 1, 1], [1, 0.5, 1])
    first, again = (load(tmp_path, text).camera for _ in range(2))
    assert np.array_equal(first.transform, again.transform)


def test_casting_agrees_with_an_independent_solution(tmp_path):
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1, 1, (30, 3, 3))
    lines = [f"v {x} {y} {z}\n" for x, y, z in corners.reshape(-1, 3)]
    lines += [f"f {n} {n + 1} {n + 2}\n" for n in range(1, 91, 3)]
    (tmp_path / "a.obj").write_text("".join(lines))
    scene = load_scene(tmp_path / "a.obj")
    world = _gather(Part(meshes=list(scene.meshes), instances=list(scene.instances)))
    directions = rng.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = np.array([0.05, 0.02, -0.03])
    found, _ = _cast(world, np.arange(30), origin, directions)
    a, b, c = world.corners.transpose(1, 0, 2).astype(float)
    system = np.stack([a - c, b - c, np.zeros_like(a)], axis=2)[None].repeat(300, axis=0)
    system[:, :, :, 2] = -directions[:, None]
    solution = np.linalg.solve(system, (origin - c)[None, :, :, None].repeat(300, axis=0))[..., 0]
    u, v, t = np.moveaxis(solution, -1, 0)
    expected = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf).min(axis=1)
    close = np.isclose(found, expected, rtol=1e-3, atol=1e-4) | (np.isinf(found) & np.isinf(expected))
    assert np.mean(close) > 0.99 and np.isfinite(expected).any() and np.isinf(expected).any()
