"""Fronts as drawings of a page: where each formula, tick and step of a front stands.

Places across are percentages of the drawing's width and places down are pixels, so that the page
can make the drawing as wide as it likes and its letters stay as large as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from dynsr.exports import shown
from dynsr.pareto import Candidate, ParetoFront

HEIGHT = 220.0
_SMALLEST = 1e-16
_MOST_ROWS = 5
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Dot:
    """One formula of a front: its place, its text, what it costs, and whether it was chosen."""

    x: float
    y: float
    formula: str
    detail: str
    chosen: bool
    candidate: Candidate


@dataclass(frozen=True)
class Chart:
    """A front as it is drawn.

    ``rows`` and ``columns`` are (place, label) of the ticks; ``steps`` are (x1, y1, x2, y2) of the
    line that no formula is below.
    """

    dots: tuple[Dot, ...]
    rows: tuple[tuple[float, str], ...]
    columns: tuple[tuple[float, str], ...]
    steps: tuple[tuple[float, float, float, float], ...]


def place_front(front: ParetoFront, chosen: Candidate | str) -> Chart:
    """Place a front over description length (across) and the logarithm of the loss (down).

    ``chosen`` is the text of the equation that was chosen, or a candidate, which is drawn even
    where the front does not hold it.

    >>> import sympy
    >>> x = sympy.Symbol("x")
    >>> front = ParetoFront([Candidate(x, 1.0, 2.0), Candidate(2 * x, 0.1, 4.0)])
    >>> chart = place_front(front, "2*x")
    >>> [(dot.x, dot.y, dot.chosen) for dot in chart.dots]
    [(50.0, 0.0, False), (100.0, 220.0, True)]
    >>> chart.columns
    ((0.0, '0'), (25.0, '1'), (50.0, '2'), (75.0, '3'), (100.0, '4'))
    """
    text = chosen if isinstance(chosen, str) else shown(chosen.expr)
    some = list(front)
    if isinstance(chosen, Candidate) and all(shown(c.expr) != text for c in some):
        some = sorted([*some, chosen], key=lambda c: (c.complexity, -c.loss))
    logs = [math.log10(max(c.loss, _SMALLEST)) for c in some] or [0.0]
    low, high = math.floor(min(logs)), max(math.ceil(max(logs)), math.floor(min(logs)) + 1)
    bits = _ticks(max((c.complexity for c in some), default=1.0))

    def place(candidate: Candidate) -> tuple[float, float]:
        height = (high - math.log10(max(candidate.loss, _SMALLEST))) / (high - low)
        return round(100 * candidate.complexity / bits[-1], 2), round(HEIGHT * height, 1)

    every = math.ceil((high - low) / _MOST_ROWS)
    return Chart(
        tuple(Dot(*place(c), shown(c.expr), _cost(c), shown(c.expr) == text, c) for c in some),
        tuple(
            (round(HEIGHT * (high - power) / (high - low), 1), "10" + str(power).translate(_RAISED))
            for power in range(high, low - 1, -every)
        ),
        tuple((round(100 * b / bits[-1], 2), f"{b:g}") for b in bits),
        tuple(_steps([place(c) for c in front])),
    )


def _cost(candidate: Candidate) -> str:
    source = f", found by {candidate.source}" if candidate.source else ""
    bits = f"{candidate.complexity:.0f} bit" + "s" * (round(candidate.complexity) != 1)
    return f"{bits}, RMSE {candidate.loss:.3g}{source}"


def _steps(places: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float, float, float]]:
    for (x1, y1), (x2, y2) in zip(places, places[1:], strict=False):
        yield x1, y1, x2, y1
        yield x2, y1, x2, y2


def _ticks(largest: float) -> list[float]:
    """Give round numbers from 0 to the first that is not below the largest, at most six of them."""
    power = 10.0 ** math.floor(math.log10(max(largest, 1.0)))
    step = next(s for s in (0.1, 0.2, 0.25, 0.5, 1, 2) if largest <= 5 * s * power) * power
    return [k * step for k in range(max(1, math.ceil(largest / step - 1e-9)) + 1)]
