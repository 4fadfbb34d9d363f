"""Writing: files appear whole or not at all, and replace none that dynsr did not write."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from dynsr.errors import InputError

# By these words at its beginning dynsr knows a file of its own again.
PAGE_MARK = '<meta name="generator" content="dynsr">'
RECORD_MARK = '"format": "dynsr '
_HEAD_BYTES = 4096
# Names have 255 bytes at most; the name of the file's first state takes part of them.
_LONGEST_STEM = 60


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file in one move: whoever reads it sees all of it or nothing new.

    A link stays one, and a file its permissions; what is no regular file, such as /dev/stdout, is
    written to as it is. Raises OSError that names the file.
    """
    try:
        _write(path, content)
    except OSError as error:
        # A full disk is reported without a name.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def _write(path: Path, content: bytes) -> None:
    if path.exists() and not path.is_file() and not path.is_dir():
        with path.open("wb") as file:
            file.write(content)
        return
    target = path.resolve()
    stem = target.name[:_LONGEST_STEM]
    part = target.with_name(f".{stem}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            with suppress(OSError):
                part.chmod(stat.S_IMODE(target.stat().st_mode))
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file in one move."""
    write_bytes(path, text.encode("utf-8"))


def check_replaceable(path: Path, ours: str | Callable[[str], bool]) -> None:
    """Check that nothing stands where a file is to be written but what dynsr wrote itself.

    Parameters
    ----------
    path : where it is to be written.
    ours : the mark at the beginning of dynsr's own, or what knows them from their beginning.

    Raises InputError that names the file.
    """
    if not path.is_file() or path.stat().st_size == 0:
        return
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES).decode("utf-8", errors="replace")
    if not (ours in head if isinstance(ours, str) else ours(head)):
        raise InputError(f"{str(path)!r} is there and not of dynsr; give another name")


def write_own(
    path: Path, text: str, ours: str | Callable[[str], bool], folders: bool = True
) -> None:
    """Write a text file in one move.

    Parameters
    ----------
    path : where; what stands there is replaced if it is dynsr's own.
    text : the content.
    ours : how dynsr's own are known, as for :func:`check_replaceable`.
    folders : make the folders above it that are not there.

    Raises InputError when a file that dynsr did not write stands there, or it cannot be written.
    """
    try:
        check_replaceable(path, ours)
        if folders:
            path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot write {str(path)!r}: {reason}; choose another file") from None
