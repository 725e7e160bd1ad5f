"""`clcache settings` lists each setting once, in columns, without loading what only other commands need."""

import os
import subprocess
import sys

from clcache.cli import main
from clcache.settings import SETTINGS


def test_every_setting_is_a_row_of_the_table(capsys):
    assert main(["settings"]) == 0
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split() == ["name", "type", "default", "range", "trade", "meaning"]
    assert [row.split()[0] for row in rows] == list(SETTINGS)
    for row, setting in zip(rows, SETTINGS.values(), strict=True):
        columns = [heading.index(name) for name in heading.split()] + [None]
        cells = [row[start:end].strip() for start, end in zip(columns, columns[1:], strict=False)]
        trade = "yes" if setting.trade else ""
        assert cells[:2] + cells[3:] == [setting.name, setting.type, setting.range, trade, setting.meaning]
        assert setting.parse(cells[2]) == setting.default


def test_whole_numbers_have_all_their_digits():
    assert SETTINGS["voxelhash.capacity"].range == "1 .. 268435456"
    assert SETTINGS["voxelhash.level_bias"].range == "-8 .. 8"


def test_nothing_heavy_is_imported():
    code = """
import sys
from clcache.cli import main
main(["settings"])
sys.exit(", ".join({"pyopencl", "trimesh", "numpy", "OpenEXR", "PIL"} & set(sys.modules)) or 0)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")


def run_into(stdout):
    """`clcache settings` with this stdout, buffered as usual so that the output meets it at the end."""
    code = "import sys; from clcache.cli import main; sys.exit(main(['settings']))"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        [sys.executable, "-c", code], stdout=stdout, stderr=subprocess.PIPE, text=True, env=environment
    )


def test_a_reader_that_has_had_enough_is_no_traceback():
    read_end, write_end = os.pipe()
    os.close(read_end)
    run = run_into(write_end)
    os.close(write_end)
    assert (run.returncode, run.stderr) == (1, "")


def test_a_full_disk_behind_stdout_is_one_line():
    with open("/dev/full", "w") as full:
        run = run_into(full)
    assert run.returncode == 1
    assert run.stderr == "clcache: error: [Errno 28] No space left on device\n"
