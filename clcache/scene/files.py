"""Which files a scene may read: those in the folder of the file that the user named, and below it."""

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from ..errors import SceneError

LONGEST_SHOWN = 255  # characters of a reference, in messages


@dataclass(frozen=True)
class Folder:
    """The folder that references may not leave. root: resolved path. allow_outside: lift that limit."""

    root: Path
    allow_outside: bool = False

    def find(self, reference: str, beside: Path, where: str) -> Path:
        """The regular file that `reference`, written in the file `beside`, names.

        where: the place of the reference, for the message. Raises SceneError if the file is missing, is no regular file,
        is named by a URL, or lies outside the folder once `..` and symbolic links are followed.
        """
        shown = repr(reference[:LONGEST_SHOWN]) + ("…" if len(reference) > LONGEST_SHOWN else "")
        try:
            if len(urlsplit(reference).scheme) > 1:  # one letter is a drive, not a URL scheme
                raise SceneError(f"{where}: {shown} is a URL; expected the path of a file in the scene's folder")
            path = (beside.parent / reference.replace("\\", "/")).resolve()
            is_file = path.is_file()
        except (OSError, ValueError, RuntimeError) as error:
            what = error.strerror if isinstance(error, OSError) else ascii(str(error)[:LONGEST_SHOWN])[1:-1]
            raise SceneError(f"{where}: {shown} is not a usable path ({what})") from None
        if not self.allow_outside and not path.is_relative_to(self.root):
            raise SceneError(
                f"{where}: {shown} leaves the scene's folder {self.root}; "
                "move the file there, or allow it with allow_outside"
            )
        if not is_file:
            raise SceneError(f"{where}: {shown}: " + ("not a regular file" if path.exists() else "no such file"))
        return path


def read_bytes(path: Path, where: str, most: int | None = None) -> bytes:
    """The file's content. Raises SceneError, without reading it, if it has more than `most` bytes."""
    try:
        size = path.stat().st_size
        if most is not None and size > most:
            raise SceneError(f"{where}: {size:,} bytes; expected at most {most:,}")
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f"{where}: cannot be read ({error.strerror})") from None


def read_text(path: Path, where: str, most: int | None = None) -> str:
    """The file's content as UTF-8, with any byte-order mark removed. most: as of `read_bytes`. Raises SceneError."""
    try:
        return read_bytes(path, where, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{where}: byte {error.start} is not UTF-8 text") from None
