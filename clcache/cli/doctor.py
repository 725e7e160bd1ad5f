"""`clcache doctor`: every OpenCL device, whether it works, which one is used, and what to install where none works."""

import argparse
import os
from typing import TYPE_CHECKING

from ..errors import Error

if TYPE_CHECKING:
    from ..device import Capabilities
    from ..drivers import Candidate, Verdict


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the command line."""
    subparsers.add_parser(
        "doctor",
        help="find the OpenCL devices that work",
        description="List every OpenCL device, build and run a probe kernel on each, and say which device is used; "
        "where none works, say what to install. Exit code 0 only if the device that is used works.",
    )


def run(args: argparse.Namespace) -> int:
    """Print the report; 0 if the device that is used works, else 1."""
    from .. import advice, device, drivers, probe

    for file in probe.driver_files():
        verdict = drivers.check_driver_file(file)
        if not verdict.usable:
            print(f"driver file {file}: {verdict.reason}")
    loading = drivers.check_loading()
    if loading.crashed:
        print(f"loading the OpenCL drivers fails: {loading.reason}")
        print("remove the driver file at fault, or set OCL_ICD_VENDORS to the only driver file to use")
        return 1

    for platform in probe.empty_platforms():
        print(f"platform {platform.name} ({platform.version}) lists no device")
        if "PoCL" in platform.version:
            print("    PoCL lists none where it cannot write its cache; XDG_CACHE_HOME names the folder for caches")
    verdicts = {candidate: drivers.probe(candidate, use_caches=False) for candidate in drivers.candidates()}
    for candidate, verdict in verdicts.items():
        _print_device(candidate, verdict)
        if verdict.usable:
            _print_capabilities(device.probe_capabilities(candidate.device))
    if not any(verdict.usable for verdict in verdicts.values()):
        print(
            f"no OpenCL device {'works' if verdicts else 'was found'}; what to do:",
            *advice.install_driver(),
            sep="\n    ",
        )
        return 1

    setting = os.environ.get("CLCACHE_DEVICE")
    try:
        chosen = drivers.choose()
    except Error as error:
        print(f"CLCACHE_DEVICE={setting}: {error}" if setting else error)
        return 1
    reason = f"CLCACHE_DEVICE={setting} names it" if setting else "the first that works; --device takes another"
    print(f"used: device {chosen}: {reason}")
    return 0 if verdicts[chosen].usable else 1


def _print_device(candidate: "Candidate", verdict: "Verdict") -> None:
    print(f"device {candidate}")
    print(f"    driver         {candidate.driver_version}; {candidate.platform_version}")
    print(f"    {'works         ' if verdict.usable else 'DOES NOT WORK '} {verdict.reason}")


def _print_capabilities(can: "Capabilities") -> None:
    optional = {
        "sub-groups": can.sub_groups,
        "C11 atomics": can.c11_atomics,
        "64-bit atomics": can.int64_atomics,
        "images": can.images,
        "fp64": can.fp64,
    }
    print(f"    compute units  {can.compute_units}; work-groups of up to {can.max_work_group_size} work-items")
    print(
        f"    memory         {can.global_memory / 2**30:.1f} GiB; one buffer up to {can.max_allocation / 2**30:.1f} GiB"
    )
    print(f"    has            {', '.join(name for name, has in optional.items() if has) or 'nothing optional'}")
    print(f"    lacks          {', '.join(name for name, has in optional.items() if not has) or 'nothing'}")
