"""Watching: a discovery shows how far it is, in a notebook by itself."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

from dynsr.discovery.result import Discovery

Search = TypeVar("Search", bound=Callable[..., Discovery])


def with_progress(search: Search) -> Search:
    """Let a search show its progress in the notebook that it runs in, or where it is asked to.

    Parameters
    ----------
    search : takes, by name, ``progress``: a function of each Step, True to show live lines, False
        for none, None for lines in notebooks alone.
    """

    @functools.wraps(search)
    def shown(data: Any, **settings: Any) -> Discovery:
        wanted = settings.pop("progress", None)
        if wanted is not None and not isinstance(wanted, bool):
            return search(data, progress=wanted, **settings)
        from dynsr.jobs import NotebookProgress, TerminalProgress, in_notebook

        if wanted is False or (wanted is None and not in_notebook()):
            return search(data, **settings)
        with NotebookProgress() if in_notebook() else TerminalProgress() as lines:
            return search(data, progress=lines, **settings)

    return cast("Search", shown)
