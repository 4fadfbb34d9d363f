"""Garbage: how often a process that is ours alone looks for it."""

from __future__ import annotations

import gc


def let_garbage_wait() -> None:
    """Look for garbage a hundred times less often than Python does by itself.

    Imports and formulas are many small objects that live, and looking for garbage in them takes
    a tenth of a short command. Only for processes of our own: what a user's does is theirs.
    """
    gc.set_threshold(100_000, 20, 10)
