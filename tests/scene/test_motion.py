"""Key frames: of tracks, glTF animations, and scene files."""

import math
from pathlib import Path

import numpy as np
import pytest
from gltf_files import GltfFile
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from clcache import SceneError, load_scene
from clcache.scene.model import Track
from clcache.scene.motion import pose_at
from clcache.scene.transform import turns_between

TURN = [0.0, math.sin(math.pi / 4), 0.0, math.cos(math.pi / 4)]  # a quarter about +Y


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(-0.2, 1.2), st.booleans())
def test_poses_agree_with_scipy(seed, count, part, step):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.1, 1, count))
    track = Track(
        times, rng.normal(size=(count, 3)), Rotation.random(count, rng).as_quat(), rng.uniform(0.5, 2, (count, 3)), step
    )
    asked = times[0] + part * (times[-1] - times[0])
    time = float(np.clip(asked, times[0], times[-1]))
    if step:
        time = times[np.searchsorted(times, time, side="right") - 1]
    turns = Rotation.from_quat(track.rotation)
    turn = turns[0] if count == 1 else Slerp(times, turns)(time)
    place, scale = (np.array([np.interp(time, times, c) for c in v.T]) for v in (track.translation, track.scale))
    assert pose_at((track,), asked) == pytest.approx(
        np.column_stack([turn.as_matrix() @ np.diag(scale), place]), abs=1e-9
    )


def test_turns_follow_great_circles():
    directions = np.array([[0, 0, -1], [0, -1, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0.0]])
    turns = Rotation.from_quat(turns_between(directions))
    assert turns.apply(directions[0]) == pytest.approx(directions, abs=1e-12)
    between = Slerp([0, 1], turns[:2])(0.5).apply(directions[0])
    assert between == pytest.approx([0, -math.sqrt(0.5), -math.sqrt(0.5)])


def _load(tmp_path: Path, file: GltfFile):
    return load_scene(file.write(tmp_path / "a.gltf"))


def test_animated_parent_moves_its_children(tmp_path):
    file = GltfFile()
    file.document["nodes"] = [
        {"children": [1], "translation": [10, 0, 0]},
        {"children": [2], "scale": [2, 2, 2]},
        {"mesh": 0, "translation": [0, 0, 1]},
    ]
    file.animate((1, "rotation", [0, 1], [[0, 0, 0, 1], TURN], "LINEAR"))
    motion = _load(tmp_path, file).instances[0].motion
    assert len(motion) == 3  # fixed, track, fixed
    assert pose_at(motion, 0)[:, 3] == pytest.approx([10, 0, 2])
    assert pose_at(motion, 1)[:, 3] == pytest.approx([12, 0, 0])
    half = math.sqrt(0.5)
    assert pose_at(motion, 0.5)[:, 3] == pytest.approx([10 + 2 * half, 0, 2 * half])
    assert np.linalg.norm(pose_at(motion, 0.5)[:, :3], axis=0) == pytest.approx([2, 2, 2])


def test_channels_with_their_own_times(tmp_path):
    file = GltfFile()
    file.document["nodes"][0]["rotation"] = TURN
    file.animate(
        (0, "translation", [0, 2], [[0, 0, 0], [2, 0, 0]], "LINEAR"),
        (0, "scale", [0, 1], [[1, 1, 1], [3, 3, 3]], "STEP"),
    )
    motion = _load(tmp_path, file).instances[0].motion
    expected = np.column_stack([Rotation.from_quat(TURN).as_matrix(), [0.9, 0, 0]])
    assert pose_at(motion, 0.9) == pytest.approx(expected)
    assert pose_at(motion, 1.5)[:, :3] == pytest.approx(3 * expected[:, :3])


def test_cubic_spline(tmp_path):
    file = GltfFile()
    times, values, slopes = (
        [0, 1, 3],
        np.array([[0, 0, 0], [1, 2, 3], [4, 0, 1.0]]),
        np.array([[1, 0, 0], [0, 1, 0], [0, 0, 2.0]]),
    )
    keys = np.stack([slopes, values, slopes], axis=1).reshape(-1, 3)
    file.animate((0, "translation", times, keys, "CUBICSPLINE"))
    motion = _load(tmp_path, file).instances[0].motion
    exact = CubicHermiteSpline(times, values, slopes)
    for time in np.linspace(0, 3, 50):
        assert pose_at(motion, time)[:, 3] == pytest.approx(exact(time), abs=0.01)
    assert pose_at(motion, 1)[:, 3] == pytest.approx(values[1], abs=1e-6)


def test_camera_and_light_move_with_their_node(tmp_path):
    file = GltfFile()
    file.document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    file.document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    file.document["nodes"] += [{"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}]
    file.document["scenes"][0]["nodes"].append(1)
    file.animate((1, "translation", [0, 1], [[0, 0, 0], [0, 0, 4]], "LINEAR"))
    scene = _load(tmp_path, file)
    assert pose_at(scene.camera.motion, 0.25)[:, 3] == pytest.approx([0, 0, 1])
    light = scene.lights[0]
    pose = pose_at(light.motion, 0.25)
    assert pose[:, :3] @ light.position + pose[:, 3] == pytest.approx([0, 0, 1])
    assert scene.instances[0].motion == ()


def test_a_scale_of_zero_stays_invertible(tmp_path):
    file = GltfFile()
    file.animate((0, "scale", [0, 1], [[0, 0, 0], [2, 2, 2]], "STEP"))
    pose = pose_at(_load(tmp_path, file).instances[0].motion, 0)
    assert 0 < np.linalg.det(pose[:, :3]) < 1e-12


def test_only_the_first_animation_is_played(tmp_path):
    file = GltfFile()
    file.animate((0, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "LINEAR"))
    file.animate((0, "translation", [0, 1], [[9, 9, 9], [9, 9, 9]], "LINEAR"))
    scene = _load(tmp_path, file)
    assert pose_at(scene.instances[0].motion, 1)[:, 3] == pytest.approx([1, 0, 0])
    assert any("2 animations" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([1, 0], [[0, 0, 0]] * 2, "times that do not ascend"),
        ([0, math.nan], [[0, 0, 0]] * 2, "times that do not ascend"),
        ([0, 1], [[0, 0, 0]] * 3, "has 3 elements; expected 1 for each of 2 times"),
        ([0, 1], [[0, 0, 0], [math.inf, 0, 0]], "not finite"),
    ],
)
def test_damaged_animations(tmp_path, times, values, message):
    file = GltfFile()
    file.animate((0, "translation", times, values, "LINEAR"))
    with pytest.raises(SceneError, match=rf"animations\[0\].channels\[0\].*{message}"):
        _load(tmp_path, file)


SCENE = """
[meshes.ball]
generator = "sphere"
subdivisions = 0
"""


def _load_toml(tmp_path: Path, text: str):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + text)
    return load_scene(path)


def test_instance_keys_take_the_rest_from_the_instance(tmp_path):
    scene = _load_toml(
        tmp_path,
        """
[[instances]]
mesh = "ball"
scale = 2
keys = [{ time = 0, translation = [0, 0, 0] }, { time = 2, translation = [4, 0, 0], rotation = { axis = [0, 1, 0], degrees = 90 } }]
""",
    )
    pose = pose_at(scene.instances[0].motion, 1)
    assert pose[:, 3] == pytest.approx([2, 0, 0])
    assert pose[:, :3] == pytest.approx(2 * Rotation.from_euler("y", 45, degrees=True).as_matrix())
    assert scene.instances[0].transform[:, 3] == pytest.approx([0, 0, 0])


def test_step(tmp_path):
    scene = _load_toml(
        tmp_path,
        """
[[instances]]
mesh = "ball"
step = true
[[instances.keys]]
time = 0
translation = [0, 0, 0]
[[instances.keys]]
time = 1
translation = [1, 0, 0]
""",
    )
    places = [pose_at(scene.instances[0].motion, t)[0, 3] for t in (-1, 0, 0.99, 1, 2)]
    assert places == [0, 0, 0, 1, 1]


def test_camera_keys(tmp_path):
    scene = _load_toml(
        tmp_path,
        """
[[instances]]
mesh = "ball"
[camera]
look_at = [0, 0, 0]
keys = [
  { time = 0, position = [0, 0, 5] },
  { time = 1, position = [5, 0, 0] },
  { time = 2, position = [0, 1, 0], quaternion = [0, 0, 0, 1] },
]
""",
    )
    assert scene.camera.transform == pytest.approx(np.column_stack([np.eye(3), [0, 0, 5]]))
    quarter = pose_at(scene.camera.motion, 1)
    assert -quarter[:, 2] == pytest.approx([-1, 0, 0])
    assert pose_at(scene.camera.motion, 3) == pytest.approx(np.column_stack([np.eye(3), [0, 1, 0]]))


def test_light_keys(tmp_path):
    scene = _load_toml(
        tmp_path,
        """
[[instances]]
mesh = "ball"
[[lights]]
type = "directional"
irradiance = [1, 1, 1]
keys = [{ time = 0, direction = [0, 0, -2] }, { time = 1, direction = [0, -1, 0] }]
[[lights]]
type = "spot"
intensity = [1, 1, 1]
outer_angle = 30
keys = [{ time = 0, position = [0, 0, 0], direction = [0, 0, -1] }, { time = 1, position = [0, 2, 0], direction = [1, 0, 0] }]
""",
    )
    sun, spot = scene.lights
    half = math.sqrt(0.5)
    assert pose_at(sun.motion, 0.5)[:, :3] @ sun.direction == pytest.approx([0, -half, -half])
    pose = pose_at(spot.motion, 0.5)
    assert pose[:, :3] @ spot.position + pose[:, 3] == pytest.approx([0, 1, 0])
    assert pose[:, :3] @ spot.direction == pytest.approx([half, 0, -half])
    assert spot.outer_angle == pytest.approx(math.radians(30))


@pytest.mark.parametrize(("animated", "place"), [("true", 1.5), ("false", 0.5)])
def test_an_included_animation_under_a_moving_instance(tmp_path, animated, place):
    file = GltfFile()
    file.animate((0, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]], "LINEAR"))
    file.write(tmp_path / "a.gltf")
    scene = _load_toml(
        tmp_path,
        f"""
[meshes.a]
file = "a.gltf"
animated = {animated}
[[instances]]
mesh = "a"
keys = [{{ time = 0, translation = [0, 0, 0] }}, {{ time = 1, translation = [1, 0, 0] }}]
""",
    )
    assert pose_at(scene.instances[0].motion, 0.5)[0, 3] == pytest.approx(place)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[instances]]\nmesh = "ball"\nkeys = [{ time = 1 }, { time = 1 }]',
            r":7: instances.0.keys: .*time 1.0 after 1.0",
        ),
        ('[[instances]]\nmesh = "ball"\nkeys = []', r":7: instances.0.keys"),
        (
            '[[instances]]\nmesh = "ball"\nkeys = [{ time = 0, scale = 0 }]',
            r":7: instances.0.keys.0: the transform cannot be",
        ),
        ('[[instances]]\nmesh = "ball"\nkeys = [{ time = 0, moved = 0 }]', r"instances.0.keys.0.moved: unknown key"),
        ('[[lights]]\ntype = "point"\nintensity = [1, 1, 1]', r"expected position, or keys"),
        ("[camera]\nkeys = [{ time = 0, position = [0, 0, 0] }]", r"neither look_at nor rotation nor quaternion"),
        ("[camera]\nkeys = [{ time = 0, look_at = [0, 0, 0] }]", r"has no position"),
        (
            "[camera]\nkeys = [{ time = 0, position = [1, 1, 1], look_at = [1, 1, 1] }]",
            r"camera.keys.0.look_at: gives no view",
        ),
    ],
)
def test_key_errors(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        _load_toml(tmp_path, text)


def test_an_included_moving_light_is_placed_by_its_instance(tmp_path):
    file = GltfFile()
    file.document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    file.document["nodes"].append({"extensions": {"KHR_lights_punctual": {"light": 0}}})
    file.document["scenes"][0]["nodes"].append(1)
    file.animate((1, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]], "LINEAR"))
    file.write(tmp_path / "a.gltf")
    text = '[meshes.a]\nfile = "a.gltf"\n[[instances]]\nmesh = "a"\nrotation = { axis = [0, 1, 0], degrees = 90 }\n'
    (light,) = _load_toml(tmp_path, text).lights
    pose = pose_at(light.motion, 0.5)
    assert pose[:, :3] @ light.position + pose[:, 3] == pytest.approx([0, 0, -1])
