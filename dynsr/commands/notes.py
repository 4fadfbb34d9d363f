"""Notes: what was guessed and what was warned of in a run, said at once and again at its end."""

from __future__ import annotations

import warnings
from types import TracebackType
from typing import Any

from dynsr.commands import output
from dynsr.errors import DynsrWarning


class Notes:
    """Keeps the guesses that are said to it and, as a context, the warnings about the data."""

    def __init__(self, quiet: bool = False) -> None:
        """Take whether guesses are shown; warnings always are."""
        self._quiet = quiet
        self.guessed: list[str] = []
        self.warned: list[str] = []

    @property
    def told(self) -> dict[str, list[str]]:
        """Give both lists by name."""
        return {"guessed": self.guessed, "warned": self.warned}

    def say(self, words: str) -> None:
        """Keep a guess and show it on stderr."""
        self.guessed.append(words)
        if not self._quiet:
            output.note(words)

    def __enter__(self) -> Notes:
        """Begin to listen."""
        self._before = warnings.showwarning
        warnings.showwarning = self._hear
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Listen no more."""
        warnings.showwarning = self._before

    def _hear(
        self, message: Warning | str, category: type[Warning], *where: Any, **more: Any
    ) -> None:
        if issubclass(category, DynsrWarning):
            self.warned.append(" ".join(str(message).split()))
        self._before(message, category, *where, **more)
