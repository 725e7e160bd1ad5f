"""Whole-or-nothing files: a file is written beside its place under a temporary name, and renamed when it is complete."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ..errors import Error, SettingError


def check_target(path: str | os.PathLike) -> Path:
    """Make the folder of `path` where it is missing, and see that a file of this name can be put there.

    Returns the path with symbolic links followed, so that a link stays one when its file is replaced. Raises
    SettingError where the folder cannot be made or written to, or where the name is taken by something that is no file.
    """
    try:
        target = Path(os.path.realpath(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise SettingError(f"{path}: the folder cannot be written to; expected one where files may be made")
        if target.exists() and not target.is_file():
            raise SettingError(f"{path}: is there and is no regular file; expected a file or a free name")
    except (OSError, ValueError) as error:
        raise SettingError(
            f"{path}: {_reason(error)}; expected a file name in a folder where files may be made"
        ) from error
    return target


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path in the folder of `path`, to be written by the body of the `with`.

    When the body ends well the file takes the place of `path` in one step; when it does not (Ctrl-C too), the temporary
    file is removed and what was at `path` before stays. Raises SettingError as `check_target` does, and Error where
    writing fails (a full disk).
    """
    target = check_target(path)
    part = target.with_name(f".clcache-{secrets.token_hex(8)}.part")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        raise Error(f"{path}: cannot be written: {_reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
