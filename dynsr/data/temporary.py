"""Temporary files and folders: one maker of each, names that nobody can foresee, one recogniser."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_NAME = re.compile(r"\.dynsr-[0-9a-f]{16}\.part")
_STALE_SECONDS = 3600.0


def open_part(folder: Path) -> tuple[Path, BinaryIO]:
    """Make a new file next to those that it will replace; gives its path and the open file.

    The name is drawn by chance. A file or a link of that name is never opened. A signal that falls
    in between leaves no file.
    """
    path = folder / f".dynsr-{secrets.token_hex(8)}.part"
    try:
        return path, path.open("xb")
    except OSError:  # what stands there is another's
        raise
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def is_part(path: Path) -> bool:
    """Whether a regular file has a name as :func:`open_part` makes them."""
    try:
        return bool(_NAME.fullmatch(path.name)) and stat.S_ISREG(path.lstat().st_mode)
    except OSError:  # it went just now
        return False


def remove_stale(folder: Path) -> None:
    """Remove what a killed process left half written in a folder an hour ago or earlier."""
    for path in folder.iterdir():
        if is_part(path) and time.time() - path.lstat().st_mtime > _STALE_SECONDS:
            path.unlink(missing_ok=True)


# The name of the file by whose lock a folder's owner is known to live.
_OWNER = "owner"


@contextmanager
def own_folder(prefix: str) -> Iterator[Path]:
    """Give a temporary folder that goes at the end; those whose owners were killed go now.

    Parameters
    ----------
    prefix : the beginning of its name, such as "dynsr-app-". Folders of that name go when they are
        this user's and nobody has the lock in them any more.
    """
    _remove_left_over(prefix)
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    lock = (folder / f"{_OWNER}-to-be").open("xb")
    try:
        # Where nothing can be locked the folder has no owner, and nobody else removes it.
        with suppress(OSError):
            if _lock(lock.fileno()):
                os.rename(lock.name, folder / _OWNER)
        yield folder
    finally:
        # Windows removes no file that is open.
        lock.close()
        shutil.rmtree(folder, ignore_errors=True)


def _lock(number: int) -> bool:
    """Lock an open file until it is closed, as it is when its process ends in any way."""
    if sys.platform == "win32":
        return False
    import fcntl

    fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return True


def _remove_left_over(prefix: str) -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        # It may be a link, somebody else's, or go in this moment.
        with suppress(OSError, AttributeError):
            about = folder.lstat()
            if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid():
                continue
            number = os.open(folder / _OWNER, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if _lock(number):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(number)
