"""What the renderer makes of cells in an octree: their settings, what it reports of them, what it tells a method that keeps its pace,
and the digest of light by which a cache knows that it is of other light.

The method here computes nothing that is worth seeing.
"""

import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cache_renders import along, at, orbit
from fake_method import SIZE, Fake
from render_helpers import everything

from clcache import Renderer, SettingError
from clcache.cli import main
from clcache.device import Device
from clcache.methods import METHODS
from clcache.resources import SceneResources
from clcache.scene.model import PointLight, Track
from clcache.settings import SETTINGS, find, resolve

# Settings


@pytest.mark.parametrize("edge", [64, 128, 256, 512, 1024, 2048, 4096])
def test_resolutions_are_powers_of_two(edge):
    assert resolve({"octree.resolution": str(edge)})["octree.resolution"] == edge
    assert find("octree.resolution").parse(edge) == edge


@pytest.mark.parametrize("value", ["100", 100, "32", 8192, "1024.0", 1024.0, "fine", True, -64])
def test_other_resolutions_are_refused(value):
    with pytest.raises(SettingError) as caught:
        resolve({"octree.resolution": value})
    expected = "is not an int in range; expected 64, 128, 256, 512, 1024, 2048, 4096"
    assert str(caught.value) == f"setting octree.resolution: {value!r} {expected}"


@pytest.mark.parametrize(
    "assignment",
    [
        "octree.resolution=1000",
        "octree.store=0",
        "octree.length=-2",
        "octree.paths=light",
        "octree.caching_resolution=1.5",
        "octree.samples=0",
        "octree.gate=maybe",
        "octree.filter=median",
        "octree.filter_depth=nan",
    ],
)
def test_bad_values_are_one_line(capsys, assignment):
    with pytest.raises(SystemExit) as caught:
        sys.exit(main(["render", "none.toml", "--set", assignment]))
    out, err = capsys.readouterr()
    name, value = assignment.split("=")
    assert (caught.value.code, out, err.count("\n")) == (2, "", 1)
    assert f"setting {name}: {value!r} is not a" in err and f"expected {SETTINGS[name].range}" in err


def test_what_is_kept_of_the_world_does_not_depend_on_how_it_is_read():
    of = {name: setting.of for name, setting in SETTINGS.items()}
    cells = {name for name in of if name.startswith("octree.") and of[name] == "world"}
    assert cells == {"octree.resolution", "octree.store", "octree.length"}
    filters = {name for name in of if name.split(".")[0] in ("temporal", "taa", "varianceblend", "stereo")}
    assert {of[name] for name in filters} == {"image"}
    assert {name for name in of if of[name] == "speed"} == {"device.local_size"}
    assert {*of.values()} == {"world", "image", "speed"}
    assert all(of[name] == "world" for name in of if name.split(".")[0] in ("pathtrace", "voxelhash", "memo"))


# What is reported, and told


class Celled(Fake):
    """A method with cells. observed: what its pace was told, by run."""

    def __call__(self, setup):
        self.observed = []
        octree = SimpleNamespace(nbytes=1000, seconds=0.25, report=lambda: {"resolution": 64, "levels": []})
        pace = SimpleNamespace(observe=lambda passes, is_moving: self.observed.append((passes, is_moving)))
        return replace(super().__call__(setup), octree=octree, pace=pace)


@pytest.fixture
def method(monkeypatch):
    found = Celled()
    monkeypatch.setitem(METHODS, "samplecache", found)
    return found


def renderer(scene=None, **options):
    return Renderer(everything() if scene is None else scene, "samplecache", SIZE, **({"stereo": True} | options))


def test_stats_have_the_octree_its_memory_and_its_time(method, monkeypatch):
    found = renderer().stats()
    assert found["octree"] == {"resolution": 64, "levels": []}
    assert found["seconds"]["octree"] == 0.25
    monkeypatch.setitem(METHODS, "samplecache", Fake())
    plain = renderer().stats()
    assert "octree" not in plain and "octree" not in plain["seconds"]
    assert found["memory"]["cache"] == plain["memory"]["cache"] + 1000


def test_a_pace_is_told_of_each_run_of_an_eye(method):
    of = renderer(spp=2)
    frames = list(of.frames(0, 2))
    assert len(method.observed) == 2 * 2 * 2
    for passes, is_moving in method.observed:
        assert passes.keys() == frames[0].stats["eyes"]["left"]["passes"].keys() and is_moving is False


def test_an_eye_moves_where_its_camera_is_another_than_in_the_frame_before(method, tmp_path):
    """Of the first frame nothing is known; a frame that is rendered again, or left out, says what the others do."""
    a, b, *_ = orbit(2)
    of = renderer(along(everything(), [a, b, b, a]), spp=1, stereo=False)
    for number in (0, 1, 2, 3, 3, 0, 2):
        next(of.frames(number, number + 1))
    assert [moving for _, moving in method.observed] == [False, True, False, True, False, False, True]
    assert [state.is_moving for state in method.states] == [moving for _, moving in method.observed]
    assert [state.camera_before is None for state in method.states] == [True, False, False, False, True, True, True]


# The digest of light


@pytest.fixture(scope="module")
def device():
    return Device()


def shining(**changes):
    """A scene whose first light is otherwise."""
    scene = everything()
    return replace(scene, lights=(replace(scene.lights[0], **changes), *scene.lights[1:]))


def lighting(device, scene, *times):
    resources = SceneResources(device, scene)
    found = [resources.lighting.tolist()]
    for time in times:
        resources.set_time(time)
        found.append(resources.lighting.tolist())
    return found


def sliding(track):
    scene = everything()
    return replace(scene, instances=(*scene.instances[:-1], replace(scene.instances[-1], motion=(track,))))


def track(places):
    n = len(places)
    return Track(np.arange(n, dtype=float), np.array(places, float), np.tile([0, 0, 0, 1.0], (n, 1)), np.ones((n, 3)))


SLIDE = track([(0, 1, 0), (1, 1, 0), (1, 1, 0), (0, 1, 0)])


def test_where_nothing_moves_the_light_stays(device):
    (first, *others) = lighting(device, everything(), 0.0, 1.0, 1e6)
    assert others == [first] * 3 and len(first) == 2
    assert SceneResources(device, everything()).lighting.dtype == np.uint32


@pytest.mark.parametrize("moving", ["instance", "light"])
def test_what_moves_changes_the_light_until_it_is_back(device, moving):
    scene = sliding(SLIDE) if moving == "instance" else shining(motion=(SLIDE,))
    at_first, start, half, end, rest, back = lighting(device, scene, 0.0, 0.5, 1.0, 2.0, 3.0)
    assert at_first == start == back and end == rest
    assert start != half and half != end and start != end


def test_the_digest_is_the_same_in_every_process():
    code = (
        "from clcache.device import Device; from clcache.resources import SceneResources\n"
        "from render_helpers import everything\nprint(*SceneResources(Device(), everything()).lighting)"
    )
    command = f"import sys; sys.path[:0] = {sys.path!r}\n{code}"
    runs = [subprocess.run([sys.executable, "-c", command], capture_output=True, text=True) for _ in range(2)]
    assert runs[0].stdout == runs[1].stdout and len(runs[0].stdout.split()) == 2, runs[0].stderr


def test_other_light_has_another_digest(device):
    scene = everything()
    lamp = replace(scene.materials[2], emission=(3.0, 3.0, 3.1))
    moved = replace(scene.instances[1], transform=scene.instances[1].transform + at((1e-6, 0, 0), 0))
    others = [
        scene,
        shining(intensity=(20.0, 15.0, 10.001)),
        shining(position=(2.0, 3.0, 2.0001)),
        replace(scene, lights=scene.lights[1:]),
        replace(scene, lights=(*scene.lights, PointLight((9, 9, 9), (1e-3,) * 3))),
        replace(scene, materials=(*scene.materials[:2], lamp)),
        replace(scene, instances=(scene.instances[0], moved, *scene.instances[2:])),
    ]
    found = [tuple(lighting(device, other)[0]) for other in others]
    assert len({*found}) == len(others)


def test_which_instances_are_static(device):
    resources = SceneResources(device, sliding(SLIDE))
    assert resources.is_static.tolist() == [True, True, True, False]
    assert resources.arrays["is_static"].get().tolist() == [1, 1, 1, 0]
    assert resources.geometry.to_world[3, 0, 3] == 0
    resources.set_time(1.0)
    assert resources.geometry.to_world[3, 0, 3] == 1
    assert resources.is_static.tolist() == [True, True, True, False]
