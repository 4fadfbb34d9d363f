"""Writing: files appear whole or not at all, and replace none that dynsr did not write."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from dynsr.data.temporary import open_part
from dynsr.errors import InputError

# A larger file is none of dynsr's, and is not read to find out.
_MOST_BYTES = 1 << 30
_SEAL = "<!-- dynsr sha256:"


def write_bytes(path: Path, content: bytes, links: bool = True) -> None:
    """Write a file in one move: whoever reads it sees all of it or nothing new.

    Parameters
    ----------
    path : where. A file keeps its permissions; what is no regular file, such as /dev/stdout, is
        written to as it is.
    content : all of it.
    links : whether a link of that name is followed, as where a user gave the name; else the file
        takes its place.

    Raises OSError that names the file.
    """
    try:
        _write(path, content, links)
    except OSError as error:
        # A full disk is reported without a name.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None
    except RuntimeError:  # before Python 3.13
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from None


def _write(path: Path, content: bytes, links: bool) -> None:
    if links and path.exists() and not path.is_file() and not path.is_dir():
        with path.open("wb") as device:
            device.write(content)
        return
    target = path.resolve() if links else path
    part, file = open_part(target.parent)
    try:
        with file:
            if target.is_file() and not target.is_symlink():
                # Before anything is in it: what was private stays so all the time.
                with suppress(OSError):
                    own = file.fileno() if os.chmod in os.supports_fd else part
                    os.chmod(own, stat.S_IMODE(target.stat().st_mode))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, links: bool = True) -> None:
    """Write a text file in one move, as :func:`write_bytes` does.

    Halves of pairs of UTF-16, which no file can hold, are written as their numbers.
    """
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"), links)


def check_replaceable(path: Path, ours: Callable[[bytes], bool]) -> None:
    """Check that where a file is to be written there is nothing but what dynsr wrote itself.

    Parameters
    ----------
    path : where it is to be written.
    ours : knows the content of dynsr's own, by a digest of it: what was changed since is not.

    Raises InputError that names the file.
    """
    if not path.is_file() or not (size := path.stat().st_size):
        return
    if size > _MOST_BYTES or not ours(path.read_bytes()):
        raise InputError(
            f"{str(path)!r} is there and not of dynsr; give another name, or move it away if it "
            "was changed since dynsr wrote it"
        )


def write_own(path: Path, text: str, ours: Callable[[bytes], bool]) -> None:
    """Write a text file in one move; folders above it that are not there are made.

    Parameters
    ----------
    path : where; what is there is replaced if it is dynsr's own.
    text : the content.
    ours : how dynsr's own are known, as for :func:`check_replaceable`.

    Raises InputError when a file that dynsr did not write is there, or it cannot be written.
    """
    try:
        check_replaceable(path, ours)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        raise _unwritable(path, error) from None


def write_new(path: Path, text: str, force: bool) -> None:
    """Write a text file in one move where none is yet, or with ``force`` in the place of any.

    Raises InputError when a file is there, or it cannot be written.
    """
    try:
        check_new(path, force)
        write_text(path, text)
    except OSError as error:
        raise _unwritable(path, error) from None


def check_new(path: Path, force: bool) -> None:
    """Check that no file is where one is to be written, unless ``force`` replaces it.

    An empty file and a device do not count. Raises InputError that names the file.
    """
    if not force and path.is_file() and path.stat().st_size:
        raise InputError(
            f"{str(path)!r} is there already; give another name, or --force to replace it "
            "(in Python force=True)"
        )


def _unwritable(path: Path, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    return InputError(f"cannot write {str(path)!r}: {reason}; choose another file")


def write_page(path: Path, page: str) -> None:
    """Write an HTML page with a seal, by which dynsr knows it again as long as nobody changes it.

    Raises InputError as :func:`write_own` does.
    """
    content = page.encode("utf-8", errors="backslashreplace")
    write_own(path, f"{content.decode()}{_seal(content)}\n", is_own_page)


def is_own_page(content: bytes) -> bool:
    """Whether this is all of a page that :func:`write_page` wrote."""
    page, mark, _ = content.rpartition(_SEAL.encode())
    return bool(mark) and content == page + f"{_seal(page)}\n".encode()


def _seal(page: bytes) -> str:
    return f"{_SEAL}{hashlib.sha256(page).hexdigest()} -->"
