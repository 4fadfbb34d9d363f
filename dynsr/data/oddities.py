"""Oddities: what looks odd in the times and the values of one run, from these numbers alone.

Each look is a pure function of times and values. It gives what it saw in words that follow
the name of a column, and what that means for equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isclose, sqrt

import numpy as np

from dynsr.data.noise_model import NoiseSettings, robust_scale
from dynsr.data.trajectory import Trajectory


@dataclass(frozen=True)
class OddSettings:
    """The numbers that decide what looks odd.

    Parameters
    ----------
    gap : a step of the time this many times longer than the steps around it is a gap.
    even : steps that differ by a smaller share of the longest are even.
    chance : what comes about by chance in at most this share of sound tables looks odd.
    spike : a row that lies this many times further off than the rows around it lie apart is one.
    edge : steps of the resolution by which a column enters or leaves the rows that all have one
        value. A rounded parabola that keeps its top for three rows enters it by three at most.
    rows : fewer rows an oscillation are too few for slopes.
    rounding : error of rounding, as a share of the spread, that is called coarse.
    looks : columns of runs that are looked at; of more, evenly spaced runs.
    """

    gap: float = 10.0
    even: float = 1e-3
    chance: float = 0.01
    spike: float = 4.0
    edge: float = 3.0
    rows: float = 10.0
    rounding: float = 0.01
    looks: int = 200


_SETTINGS = OddSettings()
# Shortest and longest days of months, quarters, half years and years.
_CALENDAR = ((28, 31), (90, 92), (181, 184), (365, 366))
_DAYS = {"days": 1.0, "years": 365.25}
# Standard deviation of the error of rounding, in steps.
_ROUNDING = 1 / sqrt(12)
# Rows of a median absolute value that are worth as much as one of a mean square.
_EFFICIENCY = 0.37
# Numbers of more digits than people write are not rounded.
_DIGITS = 12


@dataclass(frozen=True)
class Oddity:
    """Something odd in a column of one run.

    Parameters
    ----------
    kind : "gap", "uneven", "mark", "stuck", "saturated", "repeated", "rounded", "spike" or
        "coarse".
    words : what is seen, to follow the name of the column.
    meaning : what it means, and what to do.
    rows : the first and the last row of it, from 0; of several places, those of the first.
    """

    kind: str
    words: str
    meaning: str
    rows: tuple[int, int]


def one_step(
    steps: np.ndarray, unit: str = "", settings: OddSettings = _SETTINGS
) -> tuple[float, float]:
    """Give the shortest and the longest step of the time that count as the usual one.

    Parameters
    ----------
    steps : (n,) steps of the time.
    unit : that of the time. Months, quarters and years differ in days and are one step each.
    settings : the numbers that decide.

    >>> [round(step) for step in one_step(np.array([31.0, 28.0, 31.0]), "days")]
    [28, 31]
    """
    usual = float(np.median(steps))
    days, uneven = usual * _DAYS.get(unit, np.nan), settings.even * usual
    for low, high in _CALENDAR:
        if low <= np.round(days, 3) <= high:
            return low * usual / days - uneven, high * usual / days + uneven
    return usual - uneven, usual + uneven


def odd_times(t: np.ndarray, settings: OddSettings = _SETTINGS, unit: str = "") -> list[Oddity]:
    """Say what looks odd in the times of one run.

    Parameters
    ----------
    t : (n,) increasing times.
    settings : the numbers that decide.
    unit : that of the times; steps of months and years are even.

    >>> [odd.words for odd in odd_times(np.array([0.0, 1, 2, 3, 20, 21, 22]))]
    ['jumps by 17 in row 5, where a step is 1']
    """
    steps = np.diff(t)
    if len(steps) < 2 or np.any(steps <= 0):
        return []
    gaps = np.flatnonzero(steps > settings.gap * _steps_around(steps))
    if gaps.size:
        usual = float(np.median(np.delete(steps, gaps)))
        return [
            Oddity(
                "gap",
                f"jumps by {steps[gaps[0]]:.4g} in {_rows(gaps[0] + 1, gaps.size)}, where a step "
                f"is {usual:.4g}",
                "nothing is known of the time between; where the system was changed or started "
                "again there, name the pieces in a column of labels (--trajectory)",
                (int(gaps[0]), int(gaps[0]) + 1),
            )
        ]
    shortest, longest = one_step(steps, unit, settings)
    uneven = np.ptp(steps) > settings.even * float(np.max(steps))
    if uneven and not (shortest <= steps.min() and steps.max() <= longest):
        return [
            Oddity(
                "uneven",
                f"runs in uneven steps of {steps.min():.3g} to {steps.max():.3g}",
                "slopes and fits take the times as they are; a map (--map) needs even ones",
                (0, len(t) - 1),
            )
        ]
    return []


def _steps_around(steps: np.ndarray) -> np.ndarray:
    """Give the median of the seven steps around each one: those of times in powers of 2 rise."""
    width = min(7, len(steps) - 1 + len(steps) % 2)
    padded = np.pad(steps, width // 2, mode="reflect" if len(steps) > width // 2 else "edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)


# Numbers of cells may be of any size; what overflows is no evidence of anything.
@np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore")
def odd_values(t: np.ndarray, x: np.ndarray, settings: OddSettings = _SETTINGS) -> list[Oddity]:
    """Say what looks odd in one column of one run.

    Parameters
    ----------
    t : (n,) increasing times.
    x : (n,) values at these times; rows that are not finite are passed over.
    settings : the numbers that decide.

    >>> t = np.arange(40.0)
    >>> x = np.sin(0.3 * t)
    >>> x[10:20] = x[10]
    >>> [odd.words for odd in odd_values(t, x)]
    ['is 0.1411 in rows 11 to 20']
    """
    there = np.flatnonzero(np.isfinite(x))
    marks = _marks(x[there], settings)
    found = list(_marked(x, there[marks], there[~marks]))
    there = there[~marks]
    if len(there) < settings.rows or np.ptp(x[there]) == 0:
        return found
    column = _Column(t[there], x[there], there, resolution(x[there]), _stretches(x[there]))
    looks: tuple[Callable[[_Column, OddSettings], Iterator[Oddity]], ...] = (
        _repeated,
        _at_its_end,
        _rounded,
        _spikes,
        _coarse,
    )
    found += [odd for look in looks for odd in look(column, settings)]
    return found


def odd_marks(runs: Sequence[Trajectory], settings: OddSettings = _SETTINGS) -> list[str]:
    """Say which numbers of states are so far from all others that they may stand for no value.

    Parameters
    ----------
    runs : trajectories of the same states.
    settings : the numbers that decide.

    >>> x = np.where(np.arange(30) % 9 == 4, -999.0, np.sin(np.arange(30.0)))
    >>> odd_marks([Trajectory(np.arange(30.0), x[:, None], ("x",))])[0][:26]
    'x is -999 in 3 of 30 rows,'
    """
    notes = []
    for place, state in enumerate(runs[0].states):
        seen = []
        for number, run in enumerate(runs, start=1):
            there = np.flatnonzero(run.measured[:, place])
            x = run.x[:, place]
            marks = _marks(x[there], settings)
            name = str(run.origin.get("name", number))
            seen += [(name, odd) for odd in _marked(x, there[marks], there[~marks])]
        notes += merge_places(seen, state, len(runs) == 1)
    return notes


def _marked(x: np.ndarray, rows: np.ndarray, others: np.ndarray) -> Iterator[Oddity]:
    if rows.size:
        yield Oddity(
            "mark",
            f"is {x[rows[0]]:.6g} in {len(rows)} of {len(x)} rows, where all others are "
            f"{x[others].min():.4g} to {x[others].max():.4g}",
            f"such a number often stands for no value; then say so (--missing {x[rows[0]]:.6g})",
            (int(rows[0]), int(rows[-1])),
        )


def _marks(x: np.ndarray, settings: OddSettings) -> np.ndarray:
    """Say which rows have one number, several times, that is far from all others."""
    levels, counts = np.unique(x, return_counts=True)
    marks = np.zeros(len(x), dtype=bool)
    if len(levels) < settings.rows:
        return marks
    for end, rest in ((0, levels[1:]), (-1, levels[:-1])):
        far = abs(levels[end] - rest[end]) > settings.spike * np.ptp(rest)
        if far and 1 < counts[end] < len(x) / 2:
            marks |= x == levels[end]
    return marks


def resolution(x: np.ndarray) -> float:
    """Give the step that all values are whole multiples of, but for an offset; 0 where none is.

    Parameters
    ----------
    x : (n,) finite values.

    A step is seen where numbers are written with fewer digits than float64 holds, or where they
    come from a converter of few bits.

    >>> resolution(np.array([0.5, 0.75, 1.25, 0.5])), resolution(np.array([0.1, 1 / 3]))
    (0.25, 0.0)
    """
    levels = np.unique(x)
    if len(levels) < 2:
        return 0.0
    size = float(np.max(np.abs(levels)))
    if not 10.0**-_DIGITS < size < 10.0**_DIGITS:
        return 0.0
    whole = max(_DIGITS - int(np.ceil(np.log10(size))), 0)
    # Most columns that are not rounded show it in their first rows.
    if not _has_digits(levels[:20], whole) or not _has_digits(levels, whole):
        return 0.0
    digits = next(d for d in range(whole + 1) if _has_digits(levels, d))
    counts = np.rint(levels * 10.0**digits).astype(np.int64)
    step = float(np.gcd.reduce(np.diff(counts))) / 10.0**digits
    return _of_converter(np.diff(levels), step, 10.0**-digits)


def _has_digits(x: np.ndarray, digits: int) -> bool:
    """Whether numbers have no more than so many digits behind the point."""
    return bool(np.all(np.abs(np.round(x, digits) - x) <= 1e-14 * np.abs(x)))


def _of_converter(steps: np.ndarray, step: float, last: float) -> float:
    """Give the step of a converter whose values were rounded once more, to ``last``."""
    least = steps[steps <= steps.min() + 2 * last]
    wider = float(np.mean(least))
    counts = np.rint(steps / wider)
    fits = np.all(np.abs(steps - counts * wider) <= last * (1 + counts * _ROUNDING))
    return wider if wider > 4 * max(step, last) and len(steps) > 2 and fits else step


@dataclass(frozen=True, eq=False)
class _Column:
    """A column of one run: ``step`` is its resolution, ``stretches`` (m, 2) where it is constant.

    The first and the last row of each stretch are in it, of those of a single row too. ``place``
    (n,) are its rows in the run.
    """

    t: np.ndarray
    x: np.ndarray
    place: np.ndarray
    step: float
    stretches: np.ndarray

    @property
    def lengths(self) -> np.ndarray:
        return self.stretches[:, 1] - self.stretches[:, 0] + 1

    def rows(self, first: int, last: int) -> tuple[int, int]:
        """Give rows of the run."""
        return int(self.place[first]), int(self.place[last])

    def edges(self, stretches: np.ndarray) -> np.ndarray:
        """Give the steps by which the column enters and leaves stretches."""
        first, last = stretches.T
        inside = np.concatenate([first[first > 0], last[last < len(self.x) - 1] + 1])
        return np.abs(self.x[inside] - self.x[inside - 1])


def _stretches(x: np.ndarray) -> np.ndarray:
    changes = np.flatnonzero(np.diff(x) != 0)
    return np.column_stack([np.append(0, changes + 1), np.append(changes, len(x) - 1)])


def _repeated(column: _Column, settings: OddSettings) -> Iterator[Oddity]:
    """See a column whose values are usually repeated in several rows, and else one that sticks."""
    lengths = column.lengths
    usual = int(np.median(lengths))
    if usual > 1:
        yield Oddity(
            "repeated",
            f"changes in {len(lengths) - 1} of {len(column.x) - 1} rows only",
            "it is written more often than it is measured, or more coarsely than it moves: keep "
            f"one of about {usual} rows; where it is set and keeps its value, make it an input "
            "(--inputs)",
            column.rows(0, -1),
        )
        return
    again = (np.sum(lengths > 1) + 1) / (len(lengths) + 2)
    by_chance = len(lengths) * again ** (lengths - 1.0)
    long = column.stretches[(by_chance < settings.chance) & (lengths > 2)]
    ends = (column.x.min(), column.x.max())
    stuck = [s for s in long if _is_abrupt(column, s[None], settings)]
    stuck = [s for s in stuck if column.x[s[0]] not in ends]
    if stuck:
        first, last = column.rows(*stuck[0])
        many = f" and {len(stuck) - 1} more times such" if len(stuck) > 1 else ""
        yield Oddity(
            "stuck",
            f"is {column.x[stuck[0][0]]:.4g} in rows {first + 1} to {last + 1}{many}",
            "a sensor that was stuck, a gap that was filled, or a rest; leave these rows out, or "
            "split the run there",
            (first, last),
        )


def _is_abrupt(column: _Column, stretches: np.ndarray, settings: OddSettings) -> bool:
    """Whether a column usually enters and leaves these rows by more than its rounding."""
    edges = column.edges(stretches)
    return bool(edges.size and np.median(edges) > settings.edge * column.step)


def _at_its_end(column: _Column, settings: OddSettings) -> Iterator[Oddity]:
    """See many rows at exactly the largest or the smallest value.

    A rounded maximum, or the approach of a rest, enters its last value by the least step; what is
    cut off enters it by any.
    """
    from scipy.special import pdtrc

    levels, counts = np.unique(column.x, return_counts=True)
    for at, word in ((0, "smallest"), (-1, "largest")):
        often = float(np.mean(np.delete(counts, at)))
        if counts[at] < 3 or 2 * pdtrc(counts[at] - 1, often) > settings.chance:
            continue
        own = column.stretches[column.x[column.stretches[:, 0]] == levels[at]]
        if _is_abrupt(column, own, settings):
            yield Oddity(
                "saturated",
                f"is at its {word} value, {levels[at]:.4g}, in {counts[at]} of "
                f"{len(column.x)} rows",
                "a rest, a limit of detection, or a sensor at the end of its range, whose values "
                "are cut off: no equation follows those, so leave such rows out",
                column.rows(own[0, 0], own[-1, 1]),
            )


def _rounded(column: _Column, settings: OddSettings) -> Iterator[Oddity]:
    """See values that are multiples of a coarse step."""
    spread = float(np.std(column.x))
    usual = float(np.median(column.lengths))
    if usual == 1 and column.step * _ROUNDING > settings.rounding * spread:
        yield Oddity(
            "rounded",
            f"has values in steps of {column.step:.4g}, {100 * column.step / spread:.0f} % of "
            "its spread",
            "rounding is noise too, so that no equation can be exact; take more digits where the "
            "instrument has them",
            column.rows(0, -1),
        )


def _spikes(column: _Column, settings: OddSettings) -> Iterator[Oddity]:
    """See single rows far from both neighbours, which agree with each other and with the next."""
    from scipy.special import stdtrit

    t, x = column.t, column.x
    if len(x) < 7:
        return
    between = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = np.abs(x[1:-1] - x[:-2] - between * (x[2:] - x[:-2]))
    steps = np.pad(np.abs(np.diff(x)), 1)
    around = np.max([np.abs(x[2:] - x[:-2]), steps[:-3], steps[3:]], axis=0)
    # Rows that hold one value say nothing of how far rows usually are off.
    moved = off[off > 0] if off.any() else off
    chance = float(stdtrit(_EFFICIENCY * len(moved), settings.chance / 2 / len(x)))
    usual = -chance * float(robust_scale(moved))
    far = 1 + np.flatnonzero(off > np.maximum(usual, settings.spike * (around + column.step)))
    if 0 < far.size <= NoiseSettings().share * len(x):
        worst = int(far[np.argmax(off[far - 1])])
        yield Oddity(
            "spike",
            f"is {x[worst]:.4g} in {_rows(column.place[worst], far.size)}, between "
            f"{x[worst - 1]:.4g} and {x[worst + 1]:.4g}",
            "single rows so far off are outliers or jumps too short for these rows; check them, "
            "and leave those out that are wrong",
            column.rows(worst, worst),
        )


def _coarse(column: _Column, settings: OddSettings) -> Iterator[Oddity]:
    """See an oscillation of few rows, by the share of the variance that one frequency explains.

    The chance of a peak as high in noise is that of Baluev (2008) with a straight line.
    """
    # Beyond a gap nobody knows how often it went round.
    steps = np.diff(column.t)
    gaps = np.flatnonzero(steps > settings.gap * np.median(steps)) + 1
    ends = np.concatenate([[0], gaps, [len(column.t)]])
    longest = int(np.argmax(np.diff(ends)))
    piece = slice(ends[longest], min(ends[longest + 1], ends[longest] + 1000))
    t, x = column.t[piece], column.x[piece]
    if len(x) < settings.rows or not np.ptp(x) > 0:
        return
    fastest = 0.5 / float(np.median(np.diff(t)))
    slowest = 2 * fastest / settings.rows
    rough = (1 - np.cos(2 * np.pi / settings.rows)) * np.var(x)
    if not np.mean(np.diff(x) ** 2) / 2 >= rough:
        return
    from scipy.signal import detrend, lombscargle

    apart = (fastest - slowest) * sqrt(4 * np.pi * np.var(t))
    frequencies = np.linspace(slowest, fastest, max(int(10 * apart), 8))
    power = lombscargle(t, detrend(x), 2 * np.pi * frequencies, normalize=True)
    best = int(np.argmax(power))
    high = min(float(power[best]), 1.0)
    by_chance = apart * (1 - high) ** ((len(t) - 5) / 2) * sqrt((len(t) - 2) * high / 2)
    rows = float(f"{2 * fastest / frequencies[best]:.2g}")
    if high > 0.5 and by_chance < settings.chance and rows < settings.rows:
        yield Oddity(
            "coarse",
            f"oscillates with about {rows:g} rows an oscillation",
            f"slopes need {settings.rows:g} and more: measure more often, or try a map (--map)",
            column.rows(0, -1),
        )


@np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore")
def odd_states(
    columns: Mapping[str, np.ndarray], settings: OddSettings = _SETTINGS
) -> list[tuple[str, str]]:
    """Say which states follow from the others by a straight line, to their last digit.

    Parameters
    ----------
    columns : state -> (n,) finite values.
    settings : the numbers that decide.

    Gives (state, sentence) pairs, each state in terms of those before it.

    >>> s = np.linspace(0, 1, 20) ** 2
    >>> odd_states({"S": s, "R": 1 - s})[0]
    ('R', 'R is 1 - S in every row')
    """
    names = [name for name, x in columns.items() if 0 < np.std(x) < np.inf]
    if len(names) < 2 or len(columns[names[0]]) < len(names) + settings.rows:
        return []
    found: list[tuple[str, str]] = []
    free = names[:1]
    for name in names[1:]:
        text = _line_through(columns[name], {own: columns[own] for own in free})
        if text:
            found.append((name, f"{name} is {text} in every row"))
        else:
            free.append(name)
    return found


def _line_through(x: np.ndarray, others: Mapping[str, np.ndarray]) -> str:
    """Give x as a sum of other columns and a number; "" where it is not, to its rounding."""
    scales = {name: float(np.std(own)) for name, own in others.items()}
    table = np.column_stack([(own - np.mean(own)) / scales[name] for name, own in others.items()])
    centred = x - np.mean(x)
    weights, *_ = np.linalg.lstsq(table, centred, rcond=None)
    slopes = {
        name: float(weight) / scales[name] for name, weight in zip(others, weights, strict=True)
    }
    rounding = [resolution(x), *(slopes[n] * resolution(own) for n, own in others.items())]
    # Twice the error of rounding, or that of sums in float64.
    spread = float(np.std(x))
    bound = 2 * _ROUNDING * float(np.linalg.norm(rounding)) + 1e-9 * spread
    if bound > 0.1 * spread or np.sqrt(np.mean((centred - table @ weights) ** 2)) > bound:
        return ""
    kept = {name: slope for name, slope in slopes.items() if abs(slope) * scales[name] > bound}
    # Several smooth columns of few digits fit many others by chance, but not with whole numbers.
    if len(kept) > 1 and bound > 1e-6 * spread:
        kept = {name: round(2 * slope) / 2 for name, slope in kept.items()}
    left = x - sum(slope * others[name] for name, slope in kept.items())
    number = float(np.mean(left))
    if np.std(left) > bound:
        return ""
    return _as_sum(kept, number if abs(number) > 10 * bound else 0.0)


def _as_sum(slopes: Mapping[str, float], number: float) -> str:
    terms = [(number, f"{abs(number):.4g}")] if number else []
    for name, slope in slopes.items():
        size = f"{abs(slope):.4g}"
        terms.append((slope, name if isclose(float(size), 1) else f"{size}*{name}"))
    text = "".join(f" {'-' if value < 0 else '+'} {term}" for value, term in terms)
    return text.removeprefix(" + ").removeprefix(" ")


def _rows(first: int | np.intp, count: int) -> str:
    """Name a row, from 1, and say how many more there are."""
    return f"row {int(first) + 1}" + (f" and {count - 1} more" if count > 1 else "")


def merge_places(odd: Sequence[tuple[str, Oddity]], column: str, single: bool) -> list[str]:
    """Say what looks odd in a column of several runs, a sentence for each kind.

    Parameters
    ----------
    odd : (name of the run, what was seen there).
    column : what the sentences call the column.
    single : whether there is one run only, which then needs no name.
    """
    sentences = []
    for kind in dict.fromkeys(one.kind for _, one in odd):
        own = [(run, one) for run, one in odd if one.kind == kind]
        run, one = own[0]
        where = "" if single else f" (trajectory {run}"
        where += f", and {len(own) - 1} more)" if len(own) > 1 else "" if single else ")"
        sentences.append(f"{column} {one.words}{where}: {one.meaning}")
    return sentences
