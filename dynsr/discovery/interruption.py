"""Interruption: Ctrl-C stops the searches of a discovery and keeps what they have found."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType

import sympy

from dynsr.data import Samples
from dynsr.discovery.result import Discovery
from dynsr.fit import Candidate, ParetoFront, choose, tidy
from dynsr.jobs import LiveFolder, Record
from dynsr.selection import Pick, read_candidates


@contextmanager
def stopping_at_interrupt(live: LiveFolder) -> Iterator[None]:
    """Have Ctrl-C also tell the parts to stop, so that none of them passes for finished."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        live.stop()
        before(number, frame)

    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def collect_best(
    states: Sequence[str],
    records: Mapping[str, Record],
    running: Sequence[Record],
    samples: Callable[[str], Samples],
    known: Mapping[str, sympy.Expr],
) -> Discovery | None:
    """Give the best formulas of the parts that have ended and of those that ran; None without any.

    A state whose equation was chosen has that one; else the formula of least description length
    among all that its searches have. A state without any has no equation, and words that say so.
    """
    equations, fronts, why = {}, {}, {}
    for state in states:
        ended = [r for name, r in records.items() if name.startswith(f"search-{state}-")]
        ended = [r for r in ended if r["target"] == state]
        others = [said for said in running if said["part"] not in records]
        broken = [said for said in others if said["state"] == state and said["front"]]
        pool = read_candidates(c for r in (*ended, *broken) for c in r["front"])
        best, words = _best(state, pool, records.get(f"pick-{state}"), samples)
        if best is None:
            why[state] = "nothing yet; no search of its equation had a formula."
            continue
        equations[state] = tidy(known.get(state, sympy.S.Zero) + best.expr)
        fronts[state] = ParetoFront(pool)
        why[state] = words or (
            f"the best so far, found by {best.source or 'search'}; searches that had ended: "
            f"{len(ended)}, that still ran: {len(broken)}."
        )
    if not equations:
        return None
    return Discovery(equations, {s: () for s in equations}, fronts, why, complete=False)


def _best(
    state: str, pool: list[Candidate], chosen: Record | None, samples: Callable[[str], Samples]
) -> tuple[Candidate | None, str]:
    if chosen is not None:
        pick = Pick.from_record(state, chosen)
        return pick.candidate, pick.explanation
    return (choose(pool, samples(state)), "") if pool else (None, "")
