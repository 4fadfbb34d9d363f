"""Watching: a discovery shows how far it is, in a notebook by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dynsr.jobs import Step


@contextmanager
def shown_progress(
    wanted: Callable[[Step], None] | bool | None,
) -> Iterator[Callable[[Step], None] | None]:
    """Give what is called as steps end, and show live lines meanwhile where these are asked for.

    Parameters
    ----------
    wanted : a function of each Step, True to show live lines, False for none, None for lines in
        notebooks alone.
    """
    if wanted is not None and not isinstance(wanted, bool):
        yield wanted
        return
    from dynsr.jobs import NotebookProgress, TerminalProgress, in_notebook

    if wanted is False or (wanted is None and not in_notebook()):
        yield None
        return
    with NotebookProgress() if in_notebook() else TerminalProgress() as lines:
        yield lines
