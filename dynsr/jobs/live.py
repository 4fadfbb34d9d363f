"""Live: what running parts say of themselves, and how they are asked to stop.

Every running part keeps one small file in a folder that all processes see. Where a process does
not see it (a far machine), its parts run all the same and only their end is heard of.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynsr.expression import shown
from dynsr.fit import ParetoFront, tidy
from dynsr.methods import Progress
from dynsr.selection import write_candidates

_SECONDS_BETWEEN = 0.5
# Writing may take this share of a search's time at most.
_SHARE = 0.02
_DIGITS = 4


@dataclass(frozen=True)
class LiveFolder:
    """The folder of running parts' files; ``None`` keeps nothing."""

    path: Path | None = None

    def stop(self) -> None:
        """Ask every part to stop."""
        if self.path is not None:
            with suppress(OSError):
                (self.path / "stop").touch()

    @property
    def stopped(self) -> bool:
        """Whether parts were asked to stop."""
        return self.path is not None and (self.path / "stop").exists()

    def write(self, name: str, record: Mapping[str, Any]) -> None:
        """Keep what a part says; a folder that is not there is no error."""
        if self.path is None:
            return
        draft = self.path / f".{name}-{os.getpid()}"
        with suppress(OSError):
            draft.write_text(json.dumps(record), "utf-8")
            os.replace(draft, self.path / f"{name}.json")

    def remove(self, name: str) -> None:
        """Forget a part."""
        if self.path is not None:
            with suppress(OSError):
                (self.path / f"{name}.json").unlink(missing_ok=True)

    def read(self) -> list[dict[str, Any]]:
        """Give what the running parts last said, by name."""
        found = []
        for path in sorted(self.path.glob("[!.]*.json")) if self.path is not None else ():
            with suppress(OSError, ValueError):
                found.append(json.loads(path.read_text("utf-8")))
        return found


class Teller:
    """Takes the reports of one running part and keeps them live, not too often.

    Raises KeyboardInterrupt once the parts are asked to stop, which a search answers with its
    front so far.
    """

    def __init__(self, live: LiveFolder, name: str, about: Mapping[str, str]) -> None:
        """Say that the part has begun."""
        self.live, self.name = live, name
        self.record: dict[str, Any] = {"part": name, **about, "began": time.time(), "stage": ""}
        self.record |= {"done": 0, "total": None, "best": "", "loss": None, "front": []}
        self.front, self.next = ParetoFront(), 0.0
        live.write(name, self.record)

    def __call__(self, progress: Progress) -> None:
        """Keep a report."""
        if self.live.stopped:
            raise KeyboardInterrupt
        if self.live.path is None or time.monotonic() < self.next:
            return
        began = time.monotonic()
        self.record |= {"stage": progress.stage, "done": progress.done, "total": progress.total}
        if progress.front is not self.front and len(progress.front):
            self.front = progress.front
            knee = self.front.knee
            self.record |= {
                "best": shown(tidy(knee.expr), _DIGITS),
                "loss": knee.loss,
                "front": write_candidates(self.front),
            }
        self.live.write(self.name, self.record)
        ended = time.monotonic()
        self.next = ended + max(_SECONDS_BETWEEN, (ended - began) / _SHARE)

    def end(self, record: Mapping[str, Any]) -> None:
        """Keep what the part has come to until its end is heard of.

        Raises KeyboardInterrupt when it was asked to stop before.
        """
        stopped = self.live.stopped
        self.live.write(self.name, {**self.record, "front": record.get("front", [])})
        if stopped:
            raise KeyboardInterrupt
