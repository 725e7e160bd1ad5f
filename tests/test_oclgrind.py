"""The kernels under Oclgrind (tools/race_check.py): no data race, nothing out of bounds, nothing uninitialised."""

import importlib.util
import shutil
from pathlib import Path

import pytest

TOOL = Path(__file__).parent.parent / "tools" / "race_check.py"
specification = importlib.util.spec_from_file_location("race_check", TOOL)
race_check = importlib.util.module_from_spec(specification)
specification.loader.exec_module(race_check)

pytestmark = pytest.mark.skipif(shutil.which("oclgrind") is None, reason="the command oclgrind is not installed")


@pytest.mark.parametrize("case", race_check.CASES)
def test_kernels_have_no_defects(case):
    assert race_check.run(case) == []


@pytest.mark.parametrize(
    ("case", "report"),
    [
        ("racy", "Write-write data race"),
        ("outside", "Invalid write of size 4"),
        ("uninitialised", "uninitialized value"),
    ],
)
def test_defects_are_reported(case, report):
    reports = race_check.run(case)
    assert reports
    assert all(report in r and "Kernel: defect" in r for r in reports)


def test_a_case_that_fails_is_not_a_case_without_reports():
    with pytest.raises(RuntimeError, match="case missing failed"):
        race_check.run("missing")


def test_the_exit_code_says_whether_there_are_reports(capsys):
    assert race_check.main(["racy"]) == 1
    assert "racy: 7 reports" in capsys.readouterr().out
    assert race_check.main(["no such case"]) == 2
