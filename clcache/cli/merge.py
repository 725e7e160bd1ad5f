"""`clcache merge`: renders with different seeds become one of all their samples."""

import argparse
import os
from pathlib import Path

from ..errors import SettingError
from .terminal import printable, say


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "merge",
        help="merge renders that differ in their seeds",
        description="Merge EXR files of one frame, or folders of frames matched by file name, into what one render of all their"
        " samples would be: colour, albedo and normals weighted by samples, the variance of the common mean, the least Z."
        " The files must be of the same scene file, method, settings, frame, size and cameras, each with a seed of its own.",
    )
    parser.add_argument(
        "inputs", metavar="INPUT", nargs="+", type=Path, help="two or more EXR files, or folders of them"
    )
    parser.add_argument(
        "-o", dest="output", metavar="OUT", type=Path, required=True, help="the merged file, or the folder for them"
    )


def run(args: argparse.Namespace) -> int:
    """Merge as the arguments say. Nothing is written unless all frames can be merged. Raises SettingError, Error."""
    from tqdm import tqdm

    from ..output.files import check_target
    from ..output.merge import Source, check_mergeable, merge

    frames = match_files(args.inputs, args.output)
    for files in frames.values():
        check_mergeable([Source.read(file) for file in files])
    for target in frames:
        check_target(target)
    left_out: set[str] = set()
    for target, files in tqdm(frames.items(), unit="frame", disable=None):
        left_out |= merge([Source.read(file) for file in files], target)
    if left_out:
        say(f"note: left out {', '.join(sorted(left_out))}; merged are AOVs that all files have")
    last = Source.read(target)
    samples = " and ".join(str(count) for count in dict.fromkeys(last.spp.values()))
    what = f"{len(frames)} frame{'s' if len(frames) != 1 else ''} of {len(args.inputs)} renders"
    print(printable(f"{args.output}: {what}, {samples} spp, seeds {', '.join(map(str, last.seeds))}"))
    return 0


def match_files(inputs: list[Path], output: Path) -> dict[Path, list[Path]]:
    """What is merged into which file: the inputs, or files of one name in all input folders. Raises SettingError."""
    if len(inputs) < 2:
        raise SettingError(f"{inputs[0]}: is alone; expected two files or folders, or more")
    for path in inputs:
        if not os.path.exists(path):
            raise SettingError(f"{path}: no such file or folder")
        if os.path.realpath(path) == os.path.realpath(output):
            raise SettingError(f"{output}: is merged, too; expected another name for the result")
        if os.path.isdir(path) != os.path.isdir(inputs[0]):
            folder, file = (path, inputs[0]) if os.path.isdir(path) else (inputs[0], path)
            raise SettingError(f"{folder} is a folder and {file} a file; expected files, or folders")
    if not os.path.isdir(inputs[0]):
        return {output: inputs}
    names = {folder: _exr_files(folder) for folder in inputs}
    for folder, found in names.items():
        missing = sorted(set.union(*names.values()) - found)
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise SettingError(f"{folder}: lacks {missing[0]}{more}; expected files of the same names in all folders")
    return {output / name: [folder / name for folder in inputs] for name in sorted(names[inputs[0]])}


def _exr_files(folder: Path) -> set[str]:
    try:
        names = {name for name in os.listdir(folder) if Path(name).suffix.lower() == ".exr"}
    except OSError as error:
        raise SettingError(f"{folder}: cannot be read ({error.strerror})") from None
    if not names:
        raise SettingError(f"{folder}: holds no EXR files; expected those of clcache render")
    return names
