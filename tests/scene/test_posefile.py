"""Recorded camera paths."""

import numpy as np
import pytest

from clcache import SceneError, load_scene
from clcache.scene.motion import pose_at
from clcache.scene.posefile import read_pose_file

HEADER = "time,px,py,pz,qx,qy,qz,qw\n"
ROW = "0,1,2,3,0,0,0,1\n"


def test_round_trip(tmp_path):
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(20, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    rows = np.column_stack([np.arange(20) / 90, rng.normal(size=(20, 3)), quaternions])
    path = tmp_path / "head.csv"
    path.write_text("\ufeff" + HEADER + "".join(",".join(f"{x:.5f}" for x in row) + "\n" for row in rows) + "\n")
    track = read_pose_file(path, "head.csv")
    assert track.times == pytest.approx(rows[:, 0], abs=1e-5)
    assert track.translation == pytest.approx(rows[:, 1:4], abs=1e-5)
    assert track.rotation == pytest.approx(quaternions, abs=1e-4)
    assert np.linalg.norm(track.rotation, axis=1) == pytest.approx(np.ones(20), abs=1e-12)


def test_a_scene_s_camera_follows_the_file(tmp_path):
    (tmp_path / "head.csv").write_text(HEADER + ROW + "1,3,2,3,0,1,0,0\n")
    (tmp_path / "a.toml").write_text(
        '[meshes.a]\ngenerator = "box"\n[[instances]]\nmesh = "a"\n[camera]\nposes = "head.csv"\nfov_y = 90\n'
    )
    camera = load_scene(tmp_path / "a.toml").camera
    assert camera.fov_y == pytest.approx(np.pi / 2)
    assert camera.transform[:, 3] == pytest.approx([1, 2, 3])
    assert pose_at(camera.motion, 0.5)[:, 3] == pytest.approx([2, 2, 3])
    assert -pose_at(camera.motion, 2)[:, 2] == pytest.approx([0, 0, 1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"head.csv:1: .*expected the columns time,px"),
        ("t,x,y,z\n", r"head.csv:1: 't,x,y,z' is wrong"),
        (HEADER, r"head.csv: has no poses"),
        (HEADER + ROW + "1,2,3\n", r"head.csv:3: 3 values; expected 8"),
        (HEADER + ROW + "1,2,x,0,0,0,0,1\n", r"head.csv:3: py: 'x' is wrong"),
        (HEADER + ROW + "1,2,0,0,0,0,nan,1\n", r"head.csv:3: qz: 'nan' is wrong"),
        (HEADER + ROW + "1,1e999,0,0,0,0,0,1\n", r"head.csv:3: px: '1e999' is wrong"),
        (HEADER + ROW + "\n1,2,0,0,0,0,0,0.9\n", r"head.csv:4: the quaternion has length 0.9; expected 1"),
        (
            HEADER + ROW + "1,0,0,0,0,0,0,1\n" + "1,0,0,0,0,0,0,1\n",
            r"head.csv:4: time 1 after 1; expected times that ascend",
        ),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    path = tmp_path / "head.csv"
    path.write_text(text)
    with pytest.raises(SceneError, match=message):
        read_pose_file(path, "head.csv")


def test_too_large_files_are_refused_unread(tmp_path):
    path = tmp_path / "head.csv"
    with path.open("wb") as file:
        file.truncate((1 << 27) + 1)
    with pytest.raises(SceneError, match="expected at most 134,217,728"):
        read_pose_file(path, "head.csv")
