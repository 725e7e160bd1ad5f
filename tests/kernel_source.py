"""Kernels written for a test, that call the device's functions: built from a string beside the sources of the package."""

from pathlib import Path

import pytest

from clcache import program as module
from clcache.device import Device
from clcache.program import Program


def build(device: Device, source: str, folder: Path, **defines: int | float | bool) -> Program:
    """The program of `source`, whose includes are those of `clcache/cl`. folder: an empty one, which stays as long as the
    program may be built again."""
    for part in module.SOURCE_FOLDER.iterdir():
        (folder / part.name).symlink_to(part)
    (folder / "test.cl").write_text(source)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SOURCE_FOLDER", folder)
        patch.setattr(device, "_programs", {})  # another test's program has the same name
        return device.program("test.cl", **defines)
