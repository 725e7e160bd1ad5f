"""`clcache render --resume`: what goes on is what would have been, whatever stopped it; and what else the state is for."""

import functools
import json
import signal
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from clcache import Renderer
from clcache.cli import main, render, resume
from clcache.device import Device
from clcache.errors import DeviceError, Error
from clcache.output.state import STATE_FILE, StateFile

CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")
SMALL = "--size 8x6 --mono --set pathtrace.bounces=0 --aov Z"
CACHED = "--method samplecache"
OCTREE = "--method octree --set octree.resolution=64"


@pytest.fixture(scope="module", autouse=True)
def device():
    """All renders share a device, and so what one has compiled serves the others."""
    shared = functools.cache(Device)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clcache.renderer.Device", lambda *arguments: shared(*arguments[:3]))
        yield


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working folder; renders write to its folder o."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(options, frames="0:4", out="o", code=0):
    assert main(["render", CORNELL, *SMALL.split(), *options.split(), "--frames", frames, "-o", out]) == code


def refused(capsys, options, **arguments):
    """What stderr says last of a render that must be refused; nothing is changed by it."""
    before = {path: path.read_bytes() for path in Path("o").iterdir()} if Path("o").exists() else {}
    run(options, code=2, **arguments)
    assert {path: path.read_bytes() for path in before} == before
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("clcache: error: ")
    return line


def names(out="o"):
    return sorted(path.name for path in Path(out).iterdir())


def picture(number, out="o"):
    with OpenEXR.File(f"{out}/frame_{number:04d}.exr", separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


def assert_same(count, out="o", expected="whole"):
    for number in range(count):
        found, other = picture(number, out), picture(number, expected)
        assert found.keys() == other.keys()
        for name in found:
            np.testing.assert_array_equal(found[name], other[name])


def state_frame(out="o"):
    with StateFile(out) as state:
        return state.meta["frame"]


class Stop:
    """Ends the render at a frame: before its file is written if `early`, else after."""

    def __init__(self, monkeypatch, number, do, early=False):
        self.calls, write = [], render._write

        def stopping(frame, *arguments):
            self.calls.append(frame.number)
            if frame.number == number and early:
                do()
            write(frame, *arguments)
            if frame.number == number and not early:
                do()

        monkeypatch.setattr(render, "_write", stopping)


def fail():
    raise DeviceError("trace: out of resources")


def ctrl_c():
    signal.raise_signal(signal.SIGINT)


# Going on


@pytest.mark.parametrize(
    "options", ["", "--temporal taa", CACHED, f"{CACHED} --temporal varianceblend", "--method isrt", OCTREE]
)
def test_more_frames_later(options):
    """A render in two parts is the whole one, bit for bit."""
    run(options, out="whole")
    assert STATE_FILE not in names("whole")
    run(f"{options} --save-state" if options else options, "0:2")
    run(f"{options} --resume", "0:4")
    assert_same(4)
    assert (STATE_FILE in names()) == bool(options)


def test_only_what_is_missing_is_rendered(capsys):
    run(f"{CACHED} --save-state", "0:3")
    capsys.readouterr()
    run(f"{CACHED} --resume", "0:5")
    out, err = capsys.readouterr()
    assert [line.split(":")[0] for line in err.splitlines() if line.startswith("frame")] == [
        "frame 3 (1 of 2)",
        "frame 4 (2 of 2)",
    ]
    assert out.startswith("o: 2 frames of 8x6")


@pytest.mark.parametrize("options", ["", CACHED])
def test_if_all_frames_are_there_nothing_is_done(capsys, options):
    run(options, "0:2")
    before = {name: Path("o", name).stat().st_mtime_ns for name in names()}
    capsys.readouterr()
    run(f"{options} --resume", "0:2")
    assert capsys.readouterr().out == "o: all 2 frames are there\n"
    run(f"{options} --resume --stats s.json", "0:2")
    assert capsys.readouterr().out == "o: all 2 frames are there; s.json is not written\n"
    assert not Path("s.json").exists()
    assert {name: Path("o", name).stat().st_mtime_ns for name in names()} == before


def test_what_is_not_there_is_begun(capsys):
    run(f"{CACHED} --resume", "0:2")
    assert "note" not in capsys.readouterr().err
    assert names() == ["frame_0000.exr", "frame_0001.exr", STATE_FILE]


def test_after_a_failure_it_goes_on_after_the_state(monkeypatch, capsys):
    """The state is of frame 1; frame 2, which was written after it, is written again."""
    run(CACHED, out="whole")
    monkeypatch.setattr(resume, "SAVE_EVERY", 0)
    monkeypatch.setattr(resume, "_LEAST_WORK", 0)
    with monkeypatch.context() as patch:
        save, saved = Renderer.save, []
        patch.setattr(Renderer, "save", lambda self, path: saved.append(path) or (len(saved) < 3 and save(self, path)))
        Stop(patch, 3, fail, early=True)
        run(CACHED, code=1)
    assert len(saved) == 3 and state_frame() == 1
    assert names() == ["frame_0000.exr", "frame_0001.exr", "frame_0002.exr", STATE_FILE]
    capsys.readouterr()
    run(f"{CACHED} --resume")
    said = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in said if line.startswith("frame")] == ["frame 2 (1 of 2)", "frame 3 (2 of 2)"]
    assert_same(4)


@pytest.mark.parametrize("options", ["", CACHED])
def test_frames_that_are_missing_or_damaged_are_rendered(options):
    run(options, "0:3", out="whole")
    for harm in (
        Path.unlink,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:100]),
    ):
        run(f"{options} --save-state" if options else "", "0:3")
        harm(Path("o/frame_0001.exr"))
        run(f"{options} --resume", "0:3")
        assert_same(3)


def test_pictures_that_are_missing_are_written():
    run("--png", "0:3", out="whole")
    run("", "0:3")
    run("--png --resume", "0:3")
    assert names() == names("whole")
    Path("o/frame_0001.png").unlink()
    Path("o/frame_0000.exr").touch()
    run("--png --resume", "0:3")
    for name in names("whole"):
        if name.endswith("png"):
            assert Path("o", name).read_bytes() == Path("whole", name).read_bytes()


@pytest.mark.parametrize("is_there", [True, False])
def test_without_a_state_that_fits_it_begins_anew(capsys, is_there):
    run(CACHED, out="whole", frames="0:5")
    run(f"{CACHED} --save-state", "0:3")
    if is_there:
        Path("o/frame_0001.exr").unlink()
    else:
        Path("o", STATE_FILE).unlink()
    capsys.readouterr()
    run(f"{CACHED} --resume", "0:5")
    said = f"o/{STATE_FILE} is of frame 2, but o lacks frame 1" if is_there else f"o has frames, but no {STATE_FILE}"
    assert f"note: {said}" in capsys.readouterr().err
    assert_same(5)


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--seed 5", "seed is 0 there and 5 here"),
        ("--spp 2", "spp is 1 there and 2 here"),
        ("--size 9x6", "size is 8x6 there and 9x6 here"),
        ("--stereo", "eyes is mono there and left, right here"),
        ("--fps 60", "fps is 30.0 there and 60.0 here"),
        ("--set pathtrace.bounces=1", "setting pathtrace.bounces is 0 there and 1 here"),
        ("--method isrt", "method is samplecache there and isrt here"),
        ("--temporal taa", "temporal is none there and taa here"),
    ],
)
def test_frames_of_another_render_are_refused(capsys, options, message):
    run(f"{CACHED} --save-state", "0:2")
    small = SMALL.replace("--mono", "") if "--stereo" in options else SMALL
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.SMALL", small)
        line = refused(capsys, f"{CACHED} {options} --resume")
    assert f"o/frame_0000.exr: {message}; expected frames of the same render" in line


def test_the_devices_settings_do_not_matter():
    run("", "0:2")
    run("--set device.local_size=32 --resume", "0:3")
    assert names() == ["frame_0000.exr", "frame_0001.exr", "frame_0002.exr"]


@pytest.mark.parametrize("options", ["", CACHED])
@pytest.mark.parametrize(
    ("before", "after", "message"),
    [("0.63", "0.5", "content of the scene"), ("fov_y = 40", "fov_y = 41", "camera's path")],
)
def test_another_scene_of_the_same_name_is_refused(capsys, options, before, after, message):
    text = Path(CORNELL).read_text()
    assert before in text
    Path("s.toml").write_text(text)
    arguments = [*SMALL.split(), *options.split(), "-o", "o"]
    assert main(["render", "s.toml", *arguments, "--frames", "0:2"]) == 0
    Path("s.toml").write_text(text.replace(before, after))
    assert main(["render", "s.toml", *arguments, "--frames", "0:3", "--resume"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert f"o/frame_0000.exr: {message} is " in line and "here; expected frames of the same render" in line


@pytest.mark.parametrize(
    ("before", "now", "message"),
    [
        (
            "--mono --aov Z",
            "--mono --aov Z,N",
            "lacks channel N.X; expected frames of the same --aov, which is Z,N here",
        ),
        ("--mono --aov Z,samples", "--mono --aov Z", "has channel samples; expected frames of the same --aov"),
        ("--stereo --aov N", "--stereo --aov albedo", "lacks channel albedo.left.R; expected frames of the same --aov"),
    ],
)
@pytest.mark.parametrize("end", [2, 3])
def test_frames_with_other_aovs_are_refused(capsys, before, now, message, end):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.SMALL", "--size 8x6 --set pathtrace.bounces=0")
        run(before, "0:2")
        assert f"o/frame_0000.exr: {message}" in refused(capsys, f"{now} --resume", frames=f"0:{end}")
        run(f"{before} --resume", f"0:{end}")


def test_frames_that_do_not_say_of_which_scene_they_are_are_refused(capsys):
    run("", "0:1")
    with OpenEXR.File("o/frame_0000.exr", separate_channels=True) as file:
        header = {name: value for name, value in file.header().items() if name not in ("sceneDigest", "channels")}
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
    with OpenEXR.File(header, channels) as file:
        file.write("o/frame_0000.exr")
    line = refused(capsys, "--resume")
    assert (
        "o/frame_0000.exr: content of the scene is not in its header; expected frames of the same render and version"
        in line
    )


def test_files_of_other_programs_are_refused(capsys):
    Path("o").mkdir()
    image = {name: np.zeros((6, 8), np.float32) for name in "RGB"}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, image) as file:
        file.write("o/frame_0000.exr")
    assert "o/frame_0000.exr: software is not in its header; expected" in refused(capsys, "--resume")


def test_a_state_of_other_frames_is_refused(capsys):
    run(f"{CACHED} --save-state", "0:3")
    line = refused(capsys, f"{CACHED} --resume", frames="1:5")
    assert f"o/{STATE_FILE}: is of a render that began with frame 0; expected to begin with frame 1" in line


def test_a_damaged_state_is_refused(capsys):
    run(f"{CACHED} --save-state", "0:2")
    content = Path("o", STATE_FILE).read_bytes()
    Path("o", STATE_FILE).write_bytes(content[: len(content) // 2])
    line = refused(capsys, f"{CACHED} --resume")
    assert f"o/{STATE_FILE}: is damaged, or no state of a render" in line


def test_what_has_no_state_cannot_save_it(capsys):
    assert "--save-state: the frames of method pathtrace do not depend on each other" in refused(capsys, "--save-state")


# Interruptions


def test_ctrl_c_waits_for_the_frame_and_its_state(monkeypatch, capsys):
    run(CACHED, out="whole")
    with monkeypatch.context() as patch:
        Stop(patch, 1, ctrl_c, early=True)
        run(CACHED, code=130)
    err = capsys.readouterr().err.splitlines()
    assert "clcache: the frame is being finished; Ctrl-C again interrupts it" in err
    assert err[-1] == "clcache: interrupted; o has 2 of 4 frames, each complete; --resume goes on"
    assert names() == ["frame_0000.exr", "frame_0001.exr", STATE_FILE] and state_frame() == 1
    with monkeypatch.context() as patch:
        Stop(patch, 2, ctrl_c)
        run(f"{CACHED} --resume", code=130)
    assert capsys.readouterr().err.splitlines()[-1].startswith("clcache: interrupted; o has 3 of 4 frames")
    run(f"{CACHED} --resume")
    assert_same(4)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("options", ["", "--save-state"])
def test_ctrl_c_in_the_last_frame_leaves_a_complete_render(monkeypatch, capsys, options):
    run(CACHED, out="whole")
    capsys.readouterr()
    Stop(monkeypatch, 3, ctrl_c, early=True)
    run(f"{CACHED} {options} --stats s.json")
    out, err = capsys.readouterr()
    assert out.startswith("o: 4 frames of 8x6") and "interrupted;" not in err
    assert [frame["frame"] for frame in json.loads(Path("s.json").read_text())["frames"]] == [0, 1, 2, 3]
    assert (STATE_FILE in names()) == bool(options)
    assert_same(4)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_does_not_wait(monkeypatch, capsys):
    def twice():
        ctrl_c()
        ctrl_c()

    Stop(monkeypatch, 1, twice, early=True)
    run(CACHED, code=130)
    assert names() == ["frame_0000.exr", STATE_FILE]
    assert capsys.readouterr().err.splitlines()[-1].startswith("clcache: interrupted; o has 1 of 4 frames")


def test_frames_without_a_state_are_interrupted_at_once(monkeypatch):
    Stop(monkeypatch, 1, ctrl_c, early=True)
    run("", code=130)
    assert names() == ["frame_0000.exr"]


def test_within_a_frame_there_is_no_state(monkeypatch, capsys):
    """The one before it stays."""
    run(f"{CACHED} --save-state", "0:2")
    monkeypatch.setattr(Renderer, "_update", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    run(f"{CACHED} --resume", code=130)
    err = capsys.readouterr().err
    assert f"note: o/{STATE_FILE}: a frame was broken off" in err and err.endswith("--resume goes on\n")
    assert state_frame() == 1
    run(CACHED, out="anew", code=130)
    assert capsys.readouterr().err.endswith("--resume begins anew, there being no state to go on from\n")


# What is left behind


def test_the_state_is_saved_from_time_to_time_and_goes_at_the_end(monkeypatch):
    monkeypatch.setattr(resume, "SAVE_EVERY", 0)
    monkeypatch.setattr(resume, "_LEAST_WORK", 0)
    saved, save = [], Renderer.save
    monkeypatch.setattr(Renderer, "save", lambda self, path: saved.append(str(path)) or save(self, path))
    run(CACHED, "0:3")
    assert saved == [f"o/{STATE_FILE}"] * 2  # the last frame's would be of no use
    assert names() == ["frame_0000.exr", "frame_0001.exr", "frame_0002.exr"]
    saved.clear()
    run("", "0:3", out="none")
    assert not saved


def test_saving_takes_a_small_part_of_the_time(monkeypatch):
    """Of saves that take 10 s each, and frames of 70 s, every third one is made: after 200 s."""
    now, saved = [0.0], []

    class Clock:
        monotonic = staticmethod(lambda: now[0])

    class Slow:
        has_state = True

        def save(self, path):
            saved.append(round(now[0]))
            now[0] += 10

    monkeypatch.setattr(resume, "time", Clock)
    keeper = resume.StateKeeper(Slow(), Path("o"))
    for _ in range(8):
        now[0] += 70
        keeper.frame_done()
    assert saved == [70, 290, 510]


def test_a_state_that_cannot_be_saved_ends_no_render(monkeypatch, capsys):
    def full(self, path):
        raise Error(f"{path}: cannot be written: No space left on device")

    monkeypatch.setattr(resume, "SAVE_EVERY", 0)
    monkeypatch.setattr(Renderer, "save", full)
    run(CACHED, "0:2")
    assert f"note: o/{STATE_FILE}: cannot be written: No space left on device" in capsys.readouterr().err
    run(f"{CACHED} --save-state", "0:2", code=1)


# Warm starts


def test_a_warm_start_is_for_what_begins_anew(monkeypatch, capsys):
    started = []
    monkeypatch.setattr(Renderer, "warm_start", lambda self, path: started.append(path))
    run(f"{CACHED} --warm-start w --save-state", "0:2")
    assert started == [Path("w")]
    run(f"{CACHED} --warm-start w --resume", "0:3")
    assert started == [Path("w")]


def test_a_warm_start_that_cannot_be_is_one_line(capsys):
    assert "w: method pathtrace keeps nothing that another sequence could begin with" in refused(
        capsys, "--warm-start w"
    )


def test_cells_filled_by_one_render_are_read_by_another(capsys):
    """Of another size, with other settings of reading; but not of other cells."""
    run(f"{OCTREE} --spp 8 --save-state", "0:1")
    run(f"{OCTREE} --warm-start o --set octree.caching_resolution=0 --size 12x9 --stats s.json", "0:1", out="read")
    cache = json.loads(Path("s.json").read_text())["frames"][0]["eyes"]["mono"]["cache"]
    assert cache["inserted"] == 0 and cache["hits"] > 0.5 * cache["lookups"] > 0
    line = refused(capsys, f"{OCTREE} --warm-start o --set octree.store=1", out="other")
    assert "settings octree.store is " in line and " there and 1 here; expected the same" in line
    line = refused(capsys, f"{OCTREE} --set octree.samples=1 --resume")
    assert "octree.samples is " in line and " there and 1 here" in line


def test_what_memo_kept_is_saved_and_begun_with():
    """Of a method whose frames do not depend on each other, too."""
    graphs = str(Path(CORNELL).parents[1] / "graphs" / "scene.toml")
    options = [
        "--size",
        "16x9",
        "--mono",
        "--spp",
        "1",
        "--memo",
        "texel",
        "--set",
        "memo.auto=false",
        "--set",
        "pathtrace.bounces=0",
    ]
    for out, more in (("kept", ["--save-state"]), ("warm", ["--warm-start", "kept"]), ("cold", [])):
        command = ["render", graphs, *options, *more, "--frames", "0:1", "-o", out, "--stats", f"{out}.json"]
        assert main(command) == 0
    assert STATE_FILE in names("kept") and STATE_FILE not in names("warm")
    memo = {
        out: json.loads(Path(f"{out}.json").read_text())["frames"][0]["eyes"]["mono"]["memo"]
        for out in ("warm", "cold")
    }
    assert (
        memo["warm"]["inserted"] <= 0.02 * memo["cold"]["inserted"] > 0
    )  # what two threads wanted to keep at once may be missing
