"""Fixtures for all tests: every OpenCL device of this machine that works."""

import pytest
from hypothesis import settings

from clcache import drivers
from clcache.device import Device

# How long an example takes depends on what else the machine does.
settings.register_profile("clcache", deadline=None)
settings.load_profile("clcache")


def _usable() -> list[drivers.Candidate]:
    """Simulators are left out: they are too slow for anything but tests/test_oclgrind.py."""
    return [c for c in drivers.candidates() if "Oclgrind" not in c.platform and drivers.probe(c).usable]


# Where no device works, the one test parameter is the default device, so that the tests fail with the reason.
_CANDIDATES = _usable()
_SPECS = [str(c.index) for c in _CANDIDATES] or [None]
_NAMES = [f"{c.platform.split()[0]}-{c.index}" for c in _CANDIDATES] or ["none"]


@pytest.fixture(scope="session", params=_SPECS, ids=_NAMES)
def device_spec(request: pytest.FixtureRequest) -> str | None:
    """What selects each usable device in turn."""
    return request.param


@pytest.fixture(scope="session")
def device(device_spec: str | None) -> Device:
    """Each usable device in turn."""
    return Device(device_spec)


@pytest.fixture(scope="session")
def other_groups(device_spec: str | None) -> Device:
    """The same device once more, in a context of its own and with another work-group size."""
    return Device(device_spec, local_size=7)
