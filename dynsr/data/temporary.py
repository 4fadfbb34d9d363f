"""Temporary files: one maker of their names, which nobody can foresee, and one recogniser."""

from __future__ import annotations

import re
import secrets
import stat
import time
from pathlib import Path
from typing import BinaryIO

_NAME = re.compile(r"\.dynsr-[0-9a-f]{16}\.part")
_STALE_SECONDS = 3600.0


def open_part(folder: Path) -> tuple[Path, BinaryIO]:
    """Make a new file beside those that it will replace; gives its path and the open file.

    The name is drawn by chance. A file or a link of that name is never opened.
    """
    path = folder / f".dynsr-{secrets.token_hex(8)}.part"
    return path, path.open("xb")


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
