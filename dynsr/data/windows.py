"""Windows: the most informative stretches of a long record.

Of a table of a million rows a search needs a few thousand, but not any. Equations that are linear
in their coefficients, ``x' = sum_p c_p phi_p``, integrate to ``x = x(0) + sum_p c_p G_p(t)`` with
the integrals G of the features. What a window says of c is then the information matrix
``G^T C G / s^2``, where C takes out the mean, because the start of each window is not known, and s
is the error of a row. The windows are a D-optimal design (Wald 1943): those whose information has
the sum of largest determinant. It is found greedily, which is within 1 - 1/e of the best for a
function of decreasing returns (Nemhauser, Wolsey and Fisher 1978).

A window may also take every second row, every fourth, ...: it is longer and sees more of
slow motion, but what happens between its rows is lost. The error of a row is therefore its noise
and, added up over the window, by how much a cubic through the rows misses those between them. Where
states go further than their spread from row to row, that miss of the slope acts for many times the
time that a spread takes, and counts as many times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from dynsr.data.noise_model import measurement_noise
from dynsr.data.observation import carry
from dynsr.data.trajectory import FEWEST_ROWS, Trajectory

# Features of a design at most; with more columns their products are left out.
_FEATURES = 66
# Share of the mean information that every direction has before a window is taken.
_PRIOR = 1e-6
# Noise below this share of a state's spread is rounding.
_ROUNDING = 1e-10
# Variance of the distance of a noisy row from the cubic through four others: 1 + (81 + 81 + 2)/256.
_OF_CUBIC = 1.640625
# Numbers that are worked on at a time.
_AT_ONCE = 2_000_000


@dataclass(frozen=True)
class WindowSettings:
    """Which rows of a long record are searched.

    Parameters
    ----------
    above : rows of all trajectories from which on windows are searched, and not all rows.
    count : windows.
    rows : rows of each.
    tried : windows that are compared, at most.
    block : rows that the last fit to all rows takes at a time.

    >>> WindowSettings(above=10**9).count
    5
    """

    above: int = 5_000
    count: int = 5
    rows: int = 200
    tried: int = 1000
    block: int = 20_000


@dataclass(frozen=True)
class Window:
    """A stretch of one trajectory.

    Parameters
    ----------
    run : place of the trajectory.
    first, last : its first row, and the row after its last.
    stride : one row in so many is taken.
    """

    run: int
    first: int
    last: int
    stride: int = 1

    @property
    def rows(self) -> slice:
        """Its rows among those of the trajectory."""
        return slice(self.first, self.last, self.stride)

    def __len__(self) -> int:
        """Count the rows that are taken."""
        return len(range(self.first, self.last, self.stride))


def choose_windows(
    runs: Sequence[Trajectory], settings: WindowSettings | None = None, thinned: bool = True
) -> list[Window]:
    """Choose the stretches of trajectories that are most informative of their equations.

    Parameters
    ----------
    runs : trajectories of the same columns.
    settings : how many stretches of how many rows.
    thinned : whether a stretch may be one row in many. A map goes from each row to the next.

    Gives them in the order of the data. A trajectory that is shorter than a window is taken whole.

    >>> t = np.linspace(0, 100, 10001)
    >>> rest = Trajectory(t, np.exp(-t)[:, None], ("x",))
    >>> choose_windows([rest], WindowSettings(count=1, rows=100))[0].first
    0
    """
    settings = settings or WindowSettings()
    records = [_Record.of(run) for run in carry(runs)]
    columns = np.concatenate([record.columns for record in records])
    centre, scale = np.mean(columns, axis=0), np.std(columns, axis=0)
    scale[scale == 0] = 1.0
    records = [record.scaled(centre, scale) for record in records]
    noise = np.maximum(_noise_of(runs) / scale[: len(runs[0].states)], _ROUNDING)
    best: tuple[float, list[Window]] | None = None
    # The error of rows next to each other is known from that of every second one.
    errors, pace = _errors(records, noise, 2) / 2.0**8, np.zeros(len(noise))
    for stride in _strides(runs, settings) if thinned else [1]:
        # Rows that are whole periods apart lie on smooth curves and near each other.
        if stride > 1:
            errors = np.maximum(errors, _errors(records, noise, stride))
        pace = np.maximum(pace, _steps(records, noise, stride) / stride)
        windows, gain, terms = _design(records, settings, stride)
        length = np.mean([len(window) for window in windows])
        missed = np.log(noise**2 + length * errors * np.maximum(stride * pace, 1.0) ** 2)
        value = len(noise) * gain - terms * float(np.sum(missed))
        if best is None or value > best[0]:
            best = value, windows
    assert best is not None
    return sorted(best[1], key=lambda window: (window.run, window.first))


def _strides(runs: Sequence[Trajectory], settings: WindowSettings) -> list[int]:
    """Give 1, 2, 4, ... as far as enough windows are left to choose among.

    Held inputs step at rows, and a state with gaps has rows of its own: those are all taken.
    """
    held = any("previous" in run.holds.values() for run in runs)
    if held or any(run.unmeasured.size for run in runs):
        return [1]
    longest, found = max(map(len, runs)), [1]
    while longest >= 2 * found[-1] * settings.rows * settings.count:
        found.append(2 * found[-1])
    return found


@dataclass(frozen=True, eq=False)
class _Record:
    """Times (n,) and columns (n, p) of a run, of which the first k are states."""

    t: np.ndarray
    columns: np.ndarray
    states: int

    @classmethod
    def of(cls, run: Trajectory) -> _Record:
        return cls(run.t, run.columns, len(run.states))

    def scaled(self, centre: np.ndarray, scale: np.ndarray) -> _Record:
        return _Record(self.t, (self.columns - centre) / scale, self.states)


def _noise_of(runs: Sequence[Trajectory]) -> np.ndarray:
    """(k,) median noise of the states over runs that are long enough to show it; 0 without one."""
    long = [measurement_noise(run) for run in runs if len(run) > FEWEST_ROWS]
    if not long:
        return np.zeros(len(runs[0].states))
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.nanmedian(long, axis=0))


def _errors(records: Sequence[_Record], noise: np.ndarray, stride: int) -> np.ndarray:
    """(k,) mean squared distance of rows from the cubic through others ``stride`` rows apart.

    Less that of the noise, whose own chance is never believed to be an error.
    """
    half = stride // 2

    def missed(x: np.ndarray) -> np.ndarray:
        n = len(x) - 6 * half
        inner = x[2 * half : n + 2 * half] + x[4 * half : n + 4 * half]
        inner *= 9 / 16
        inner -= (x[:n] + x[6 * half :]) / 16
        return np.subtract(x[3 * half : n + 3 * half], inner, out=inner)

    return _mean_squares(records, 6 * half, missed, _OF_CUBIC * noise**2)


def _steps(records: Sequence[_Record], noise: np.ndarray, stride: int) -> np.ndarray:
    """(k,) how far states go in so many rows: root mean square, less that of the noise."""
    return np.sqrt(_mean_squares(records, stride, lambda x: x[stride:] - x[:-stride], 2 * noise**2))


def _mean_squares(
    records: Sequence[_Record],
    lost: int,
    take: Callable[[np.ndarray], np.ndarray],
    noise: np.ndarray,
) -> np.ndarray:
    """(k,) mean squares of what is taken of columns, whose rows it shortens, less noise (k,)."""
    long = [record for record in records if len(record.t) > lost]
    count = sum(len(record.t) - lost for record in long)
    if not count:
        return np.zeros(len(noise))
    squares = np.zeros(len(noise))
    for j in range(len(noise)):
        for record in long:
            own = take(record.columns[:, j])
            squares[j] += float(own @ own)
    found: np.ndarray = np.maximum(squares / count - (1 + 4 / np.sqrt(count)) * noise, 0.0)
    return found


def _design(
    records: Sequence[_Record], settings: WindowSettings, stride: int
) -> tuple[list[Window], float, int]:
    """Give windows, the logarithm of the determinant of what they determine, and its order."""
    tried = _candidates(records, settings, stride)
    told = np.concatenate(
        [
            _information(records[group[0].run], group)
            for group in _groups(tried, records[0].columns.shape[1])
        ]
    )
    terms = told.shape[1]
    mean = np.trace(told.mean(axis=0)) / terms
    whole = _PRIOR * mean * np.eye(terms)
    chosen: list[int] = []
    left = settings.count * settings.rows
    lengths = np.array([len(window) for window in tried])
    value = float(np.linalg.slogdet(whole)[1])
    while True:
        open_ = np.setdiff1d(np.flatnonzero(lengths <= left), chosen)
        if not len(open_):
            break
        values = np.linalg.slogdet(whole + told[open_])[1]
        # Short runs cost less, and more of them are taken.
        place = int(np.argmax((values - value) / lengths[open_]))
        best, value = int(open_[place]), float(values[place])
        chosen.append(best)
        whole = whole + told[best]
        left -= int(lengths[best])
    return [tried[i] for i in chosen], value, terms


def _candidates(records: Sequence[_Record], settings: WindowSettings, stride: int) -> list[Window]:
    """Cut runs into windows that do not overlap, evenly thinned where they are many."""
    length, found = settings.rows * stride, []
    for place, record in enumerate(records):
        n = len(record.t)
        if n <= length:
            own = stride if n >= stride * FEWEST_ROWS else 1
            last = min(n, settings.rows * own)
            found.append(Window(place, 0, last, own))
        else:
            found += [
                Window(place, i, i + length, stride) for i in range(0, n - length + 1, length)
            ]
    if len(found) > settings.tried:
        found = [found[i] for i in np.linspace(0, len(found) - 1, settings.tried).astype(int)]
    return found


def _groups(windows: Sequence[Window], columns: int) -> list[list[Window]]:
    """Put windows of one run and one length together, as many as are worked on at a time."""
    found: list[list[Window]] = []
    features = 1 + len(_products(columns)) + columns
    for window in windows:
        last = found[-1] if found else []
        size = (len(last) + 1) * len(window) * features
        alike = bool(last) and (last[-1].run, len(last[-1])) == (window.run, len(window))
        if alike and size <= _AT_ONCE:
            last.append(window)
        else:
            found.append([window])
    return found


def _products(columns: int) -> list[tuple[int, int]]:
    """Give the pairs of columns whose products are features."""
    pairs = list(combinations_with_replacement(range(columns), 2))
    return pairs if 1 + columns + len(pairs) <= _FEATURES else [(i, i) for i in range(columns)]


def _information(record: _Record, windows: Sequence[Window]) -> np.ndarray:
    """(w, P, P) information on the coefficients of features, at an error of 1 of each row."""
    rows = np.array([np.arange(w.first, w.last, w.stride) for w in windows])
    t, z = record.t[rows], record.columns[rows]
    left, right = np.array(_products(z.shape[2])).T
    features = np.concatenate([np.ones((*z.shape[:2], 1)), z, z[..., left] * z[..., right]], axis=2)
    steps = np.diff(t, axis=1)[..., None] * (features[:, 1:] + features[:, :-1]) / 2
    integrals = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    integrals -= integrals.mean(axis=1, keepdims=True)
    found: np.ndarray = integrals.transpose(0, 2, 1) @ integrals
    return found


def cut_to_windows(runs: Sequence[Trajectory], windows: Sequence[Window]) -> list[Trajectory]:
    """Give the windows as trajectories.

    Parameters
    ----------
    runs : the trajectories that the windows were chosen in.
    windows : which stretches.

    >>> run = Trajectory(np.arange(10.0), np.ones((10, 1)), ("x",))
    >>> cut_to_windows([run], [Window(0, 2, 8, 2)])[0].t.tolist()
    [2.0, 4.0, 6.0]
    """
    return [runs[window.run].select(window.rows) for window in windows]
