"""The scenes in data/: their scripts give the stored files, they load, and their measures are believable."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from clcache import load_scene
from clcache.scene.model import DirectionalLight
from clcache.scene.motion import pose_at

ROOT = Path(__file__).parents[1]
DATA = ROOT / "data"
SCRIPTED = ("cornell", "atrium", "fence", "city", "classroom", "landscape", "kitchen", "spinning", "spheres")
MOVING_CAMERA = ("atrium", "city", "classroom", "landscape", "kitchen", "spheres")


@pytest.fixture(scope="module")
def cornell():
    return load_scene(DATA / "cornell" / "scene.toml")


@pytest.fixture(scope="module")
def atrium():
    return load_scene(DATA / "atrium" / "scene.toml")


def world_positions(scene, instance):
    linear, offset = instance.transform[:, :3], instance.transform[:, 3]
    return scene.meshes[instance.mesh].positions @ linear.T + offset


def triangle_areas(corners):
    """corners: (t, 3, 3) -> (t,)"""
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


@pytest.mark.parametrize("name", SCRIPTED)
def test_script_gives_the_stored_files(name, tmp_path):
    script = ROOT / "tools" / f"make_{name}.py"
    subprocess.run([sys.executable, script, "--out", tmp_path], check=True)
    made = {file.relative_to(tmp_path) for file in tmp_path.rglob("*") if file.is_file()}
    assert made == {file.relative_to(DATA / name) for file in (DATA / name).rglob("*") if file.is_file()}
    for file in made:
        if file.suffix in (".jpg", ".png"):  # encoders differ, pictures do not
            new, stored = (np.asarray(Image.open(folder / file), dtype=float) for folder in (tmp_path, DATA / name))
            assert np.abs(new - stored).mean() < 0.25, file
        else:
            assert (tmp_path / file).read_bytes() == (DATA / name / file).read_bytes(), file


def test_data_is_small():
    sizes = {name: sum(f.stat().st_size for f in (DATA / name).rglob("*") if f.is_file()) for name in SCRIPTED}
    assert max(size for name, size in sizes.items() if name != "atrium") < 1_000_000
    assert sum(sizes.values()) < 6_000_000


@pytest.mark.parametrize("name", (*SCRIPTED, "hairball"))
def test_scene_is_complete(name):
    scene = load_scene(DATA / name / "scene.toml")
    assert scene.dropped == {}
    assert scene.notes == ()
    assert scene.defaults.stereo == (name != "fence")
    assert scene.defaults.eye_distance == 0.063
    used = {index for i in scene.instances for index in np.unique(scene.meshes[i.mesh].material)}
    assert used == set(range(len(scene.materials)))
    assert all(np.ptp(texture.pixels[..., :3]) > 8 for texture in scene.textures)
    assert len({material.name for material in scene.materials}) == len(scene.materials)


def positions_over_time(motion, defaults):
    """(frames, 3, 4) poses at the frames' times."""
    return np.array([pose_at(motion, frame / defaults.fps) for frame in range(*defaults.frames)])


@pytest.mark.parametrize("name", MOVING_CAMERA)
def test_camera_moves_smoothly_and_through_all_frames(name):
    """No frame jumps: steps and turns between frames are small, and each frame shows something new."""
    scene = load_scene(DATA / name / "scene.toml")
    assert scene.defaults.frames[1] >= 64
    poses = positions_over_time(scene.camera.motion, scene.defaults)
    steps = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    ahead = -poses[:, :, 2]
    turns = np.degrees(np.arccos(np.clip((ahead[1:] * ahead[:-1]).sum(axis=1), -1.0, 1.0)))
    assert (steps > 1e-5).all()
    assert steps.max() < 1.5
    assert turns.max() < 3.0


@pytest.mark.parametrize("name", MOVING_CAMERA)
def test_camera_keeps_clear_of_the_scene(name):
    """No vertex comes nearer to the camera's path than 15 cm, and it stays within the scene."""
    scene = load_scene(DATA / name / "scene.toml")
    points = np.concatenate([world_positions(scene, i) for i in scene.instances])
    path = positions_over_time(scene.camera.motion, scene.defaults)[::8, :, 3]
    for eye in path:
        assert np.linalg.norm(points - eye, axis=1).min() > 0.15
    if name != "spheres":  # which is looked at from outside
        assert (points.min(axis=0) < path).all() and (path < points.max(axis=0)).all()


def test_fence_only_its_sun_moves():
    scene = load_scene(DATA / "fence" / "scene.toml")
    assert not scene.camera.motion and not any(i.motion for i in scene.instances)
    (sun,) = scene.lights
    assert isinstance(sun, DirectionalLight)
    turns = positions_over_time(sun.motion, scene.defaults)[:, :, :3]
    directions = turns @ np.asarray(sun.direction)
    assert len(directions) == 64
    assert (directions[:, 1] < 0).all()
    swept = np.degrees(np.arccos(np.clip(directions[0] @ directions[-1], -1.0, 1.0)))
    assert 25 < swept < 45
    bars = [scene.meshes[i.mesh] for i in scene.instances if i.name == "bar"]
    assert len(bars) > 100
    assert np.ptp(bars[0].positions[:, 0]) < 0.06 < 1.4 < np.ptp(bars[0].positions[:, 1])


def test_city_is_of_many_instances_near_and_far():
    scene = load_scene(DATA / "city" / "scene.toml")
    assert len(scene.instances) > 250
    assert len(scene.meshes) < 25 and len(scene.textures) >= 10
    stored = sum(len(mesh.triangles) for mesh in scene.meshes)
    assert stored * 5 < scene.triangle_count
    houses = np.array([i.transform[:, 3] for i in scene.instances if i.name.endswith("house")])
    distance = np.linalg.norm(houses - scene.camera.transform[:, 3], axis=1)
    assert distance.min() < 25 and distance.max() > 150


def test_city_houses_stand_on_their_terraces():
    """Each house's lowest vertex is on a horizontal face of the ground."""
    scene = load_scene(DATA / "city" / "scene.toml")
    ground = {
        round(float(y), 3) for i in scene.instances if i.name == "ground" for y in world_positions(scene, i)[:, 1]
    }
    for instance in scene.instances:
        if instance.name.endswith(("house", "tower", "church", "arch")):
            assert round(float(world_positions(scene, instance)[:, 1].min()), 3) in ground, instance.name


def test_classroom_has_a_material_for_everything():
    scene = load_scene(DATA / "classroom" / "scene.toml")
    looks = {
        (m.base_color, m.base_color_texture, m.metallic, m.roughness, m.emission, m.normal_texture)
        for m in scene.materials
    }
    assert len(looks) == len(scene.materials) >= 60
    assert sum(any(m.emission) for m in scene.materials) == 1


def test_classroom_head_is_never_still():
    """The pose file's jitter is of some centimetres and degrees, and as fast as a headset's poses."""
    scene = load_scene(DATA / "classroom" / "scene.toml")
    (track,) = scene.camera.motion
    assert len(track.times) == scene.defaults.frames[1] == 64
    np.testing.assert_allclose(np.diff(track.times), 1 / scene.defaults.fps, atol=2e-6)
    assert 60 <= scene.defaults.fps <= 90
    spread = track.translation.std(axis=0)
    assert (spread > 0.002).all() and (spread < 0.03).all()
    poses = positions_over_time(scene.camera.motion, scene.defaults)
    roll = np.degrees(np.arcsin(poses[:, 1, 0]))
    assert 0.3 < np.ptp(roll) < 8.0


def test_landscape_is_open_with_few_materials():
    scene = load_scene(DATA / "landscape" / "scene.toml")
    assert len(scene.materials) <= 6
    assert sum(m.alpha_cutoff is not None for m in scene.materials) == 2
    (ground,) = (m for m in scene.materials if m.name == "ground")
    assert ground.base_color_texture and ground.normal_texture and ground.metallic_roughness_texture
    assert len(scene.environment.radiance) > 100
    assert scene.triangle_count > 250_000 and len(scene.instances) > 400
    for material in scene.materials:
        if material.alpha_cutoff is not None:
            alpha = scene.textures[material.base_color_texture.index].pixels[..., 3]
            assert 0.1 < (alpha > 127).mean() < 0.8


def test_landscape_plants_are_on_dry_ground():
    scene = load_scene(DATA / "landscape" / "scene.toml")
    (land,) = (i for i in scene.instances if i.name == "terrain")
    corners = world_positions(scene, land)[scene.meshes[land.mesh].triangles]
    water = next(i.transform[1, 3] for i in scene.instances if i.name == "water")
    assert corners[..., 1].min() < water - 5 and corners[..., 1].max() > water + 60
    plants = [i for i in scene.instances if i.name not in ("terrain", "water")]
    for x, y, z in (i.transform[:, 3] for i in plants):
        assert y > water
        over = hits(np.array([x, y + 0.1, z]), np.array([[0.0, -1.0, 0.0]]), corners)[0]
        under = hits(np.array([x, y - 0.1, z]), np.array([[0.0, 1.0, 0.0]]), corners)[0]
        assert over >= 1 and under >= 1, (x, y, z)


def test_kitchen_is_closed_and_shines():
    scene = load_scene(DATA / "kitchen" / "scene.toml")
    assert scene.lights == () and not scene.environment.radiance.any()
    glossy = [m for m in scene.materials if m.roughness < 0.25 or m.metallic_roughness_texture is not None]
    assert len(glossy) > len(scene.materials) / 2
    assert sum(m.transmission > 0 for m in scene.materials) == 3
    assert sum(m.metallic == 1 for m in scene.materials) >= 4
    (room,) = (world_positions(scene, i) for i in scene.instances if i.name == "room")
    rng = np.random.RandomState(1)
    directions = rng.standard_normal((200, 3))
    (faces,) = (scene.meshes[i.mesh].triangles for i in scene.instances if i.name == "room")
    eye = scene.camera.transform[:, 3]
    assert (hits(eye, directions, room[faces]) > 0).all()


def hits(origin, directions, corners):
    """How many of the triangles (t, 3, 3) each of the rays (n, 3) from origin meets: (n,)."""
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(directions[:, None], other[None])
    det = (p * edge).sum(axis=-1)
    det = np.where(det == 0, np.nan, det)
    s = origin - corners[:, 0]
    u = (p * s).sum(axis=-1) / det
    q = np.cross(s, edge)
    v = (directions @ q.T) / det
    t = (q * other).sum(axis=-1)[None] / det
    return ((u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6) & (t > 0)).sum(axis=1)


def test_spinning_objects_turn_and_keep_clear_of_each_other():
    scene = load_scene(DATA / "spinning" / "scene.toml")
    moving = [i for i in scene.instances if i.motion]
    assert len(moving) == 5
    assert not scene.camera.motion and len(scene.lights) == 1
    last = (scene.defaults.frames[1] - 1) / scene.defaults.fps
    for time in np.linspace(0.0, last, 33):
        bodies = []
        for instance in moving:
            pose = pose_at(instance.motion, time)
            bodies.append(scene.meshes[instance.mesh].positions @ pose[:, :3].T + pose[:, 3])
        assert all(body[:, 1].min() > -1e-3 for body in bodies)
        for i, body in enumerate(bodies):
            for other in bodies[:i]:
                assert cKDTree(body).query(other)[0].min() > 0.02
    for instance in moving:
        start, later = (pose_at(instance.motion, t)[:, :3] for t in (0.0, last / 5))
        assert np.abs(start - later).max() > 0.2


def test_spinning_ball_rolls():
    """The point of the ball that touches the ground stands still there."""
    scene = load_scene(DATA / "spinning" / "scene.toml")
    (ball,) = (i for i in scene.instances if i.name == "ball")
    step = 1e-4
    for time in (0.35, 1.0, 1.7):
        before, after = (pose_at(ball.motion, t) for t in (time, time + step))
        foot = before[:, :3].T @ [0.0, -before[1, 3], 0.0]
        slip = (after[:, :3] @ foot + after[:, 3] - before[:, :3] @ foot - before[:, 3]) / step
        speed = np.linalg.norm(after[:, 3] - before[:, 3]) / step
        assert speed > 0.5
        assert np.linalg.norm(slip) < 0.1 * speed


def test_spheres_are_of_metal_and_of_glass():
    scene = load_scene(DATA / "spheres" / "scene.toml")
    balls = {scene.materials[scene.meshes[i.mesh].material[0]].name: i for i in scene.instances if i.name == "sphere"}
    assert set(balls) == {"metal", "glass"}
    metal, glass = (next(m for m in scene.materials if m.name == name) for name in ("metal", "glass"))
    assert (metal.metallic, metal.roughness) == (1.0, 0.0)
    assert (glass.transmission, glass.ior, glass.roughness, glass.thin) == (1.0, 1.5, 0.0, False)
    points = [world_positions(scene, i) for i in balls.values()]
    centres, radii = [p.mean(axis=0) for p in points], [np.ptp(p[:, 1]) / 2 for p in points]
    assert np.linalg.norm(centres[0] - centres[1]) > sum(radii)
    assert all(0 < p[:, 1].min() < 0.01 for p in points)  # apart from the floor, so that glass borders on air


def test_spheres_script_writes_other_roughnesses(tmp_path):
    script = ROOT / "tools" / "make_spheres.py"
    subprocess.run([sys.executable, script, "--alpha", "0.2", "--out", tmp_path], check=True)
    scene = load_scene(tmp_path / "scene.toml")
    for material in scene.materials:
        if material.name in ("metal", "glass"):
            assert material.roughness**2 == pytest.approx(0.2, abs=1e-4)


def test_hairball_has_a_million_triangles():
    scene = load_scene(DATA / "hairball" / "scene.toml")
    counts = {instance.name: len(scene.meshes[instance.mesh].triangles) for instance in scene.instances}
    assert counts == {"hairball": 1_000_000, "floor": 2}
    lowest = {instance.name: world_positions(scene, instance)[:, 1].min() for instance in scene.instances}
    assert lowest["floor"] < lowest["hairball"] < lowest["floor"] + 0.1


def test_cornell_fills_the_frame_of_both_eyes(cornell):
    """The rays through the frame's corners pass through the open side of the room."""
    points = np.concatenate([world_positions(cornell, i) for i in cornell.instances])
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(high - low, [4.0, 2.25, 2.4], atol=1e-5)
    pose, (width, height) = cornell.camera.transform, cornell.defaults.size
    half = np.tan(cornell.camera.fov_y / 2)
    for eye in (-0.5, 0.5):
        origin = pose[:, 3] + pose[:, 0] * eye * cornell.defaults.eye_distance
        for x in (-1, 1):
            for y in (-1, 1):
                direction = pose[:, :3] @ [x * half * width / height, y * half, -1.0]
                at_opening = origin + direction * (high[2] - origin[2]) / direction[2]
                assert (low[:2] < at_opening[:2]).all() and (at_opening[:2] < high[:2]).all()


def test_cornell_is_lit_by_one_lamp_in_the_ceiling(cornell):
    assert cornell.lights == ()
    lit = [
        i
        for i in cornell.instances
        if any(cornell.materials[m].emission != (0, 0, 0) for m in cornell.meshes[i.mesh].material)
    ]
    assert [i.name for i in lit] == ["lamp"]
    positions = world_positions(cornell, lit[0])
    assert triangle_areas(positions[cornell.meshes[lit[0].mesh].triangles]).sum() == pytest.approx(2.8 * 1.6)
    np.testing.assert_allclose(positions[:, 1], 2.25)


def test_cornell_spheres_stand_on_the_floor_and_apart(cornell):
    balls = [world_positions(cornell, i) for i in cornell.instances if i.name == "sphere"]
    assert len(balls) == 2
    for ball in balls:
        assert ball[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    centres = [(ball.max(axis=0) + ball.min(axis=0)) / 2 for ball in balls]
    radii = [np.ptp(ball[:, 1]) / 2 for ball in balls]
    assert np.linalg.norm(centres[0] - centres[1]) > sum(radii)


def test_atrium_is_instanced_and_of_human_scale(atrium):
    assert 50_000 < atrium.triangle_count < 500_000
    stored = sum(len(mesh.triangles) for mesh in atrium.meshes)
    assert stored * 10 < atrium.triangle_count
    assert len(atrium.instances) > 10 * len(atrium.meshes)
    points = np.concatenate([world_positions(atrium, i) for i in atrium.instances])
    np.testing.assert_allclose(points.max(axis=0) - points.min(axis=0), [32.3, 10.3, 17.3], atol=0.1)
    eye = atrium.camera.transform[:, 3]
    assert 1.5 < eye[1] < 1.8
    assert np.linalg.norm(points - eye, axis=1).min() > 0.5


def test_atrium_normals_are_unit_and_agree_with_the_faces(atrium):
    for mesh in atrium.meshes:
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
        corners = mesh.positions[mesh.triangles].astype(float)
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((face[:, None, :] * mesh.normals[mesh.triangles]).sum(axis=(1, 2)) > 0).all(), mesh.name


def test_atrium_textures_are_not_stretched(atrium):
    """Texture area over surface area is one constant for each material, whatever the mesh (leaves excepted)."""
    names = {material.name for material in atrium.materials if material.base_color_texture is not None}
    assert len(names) > 10
    for index, material in enumerate(atrium.materials):
        if material.base_color_texture is None or material.name == "leaf":
            continue
        density, weight = [], []
        for mesh in atrium.meshes:
            triangles = mesh.triangles[mesh.material == index]
            surface = triangle_areas(mesh.positions[triangles].astype(float))
            flat = np.pad(mesh.uvs[triangles].astype(float), [(0, 0), (0, 0), (0, 1)])
            density.append(triangle_areas(flat) / surface)
            weight.append(surface)
        density, weight = np.concatenate(density), np.concatenate(weight)
        usual = np.average(density, weights=weight)
        even = (density > usual / 2.5) & (density < usual * 2.5)
        assert weight[even].sum() > 0.9 * weight.sum(), material.name


def test_atrium_textures_tile(atrium):
    """The step over a texture's border is no larger than the steps inside it (a leaf does not tile)."""
    for texture in atrium.textures:
        assert texture.wrap == ("repeat", "repeat")
        if "leaf" in texture.name:
            continue
        pixels = texture.pixels[..., :3].astype(float)
        for axis in (0, 1):
            step = np.abs(pixels - np.roll(pixels, 1, axis)).mean(axis=(1 - axis, 2))
            assert step[0] <= 1.1 * step[1:].max(), texture.name
