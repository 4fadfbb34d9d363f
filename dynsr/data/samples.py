"""Samples: states paired with slopes, one scalar regression problem; and the difference schemes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.arguments import Renamed, checked
from dynsr.data.trajectory import Trajectory, check_rows
from dynsr.errors import InputError


@checked
@dataclass(frozen=True, eq=False)
class Samples:
    """One scalar regression problem: find f with y = f(X).

    Parameters
    ----------
    X : (n, p) states and inputs, one row a time.
    y : (n,) slope of the target in state units per second.
    names : the p names of the columns of ``X``.
    target : name of the state whose slope ``y`` is.
    scheme : how the slopes were made (forward, backward, central, ...).
    t : (n,) times in seconds of the rows.
    noise : typical error of ``y`` (one standard deviation, state units per second); None when
        nobody has estimated it.
    layers : whether the states pass fast layers; large terms cancel each other on the other rows.
    loss : loss of each row (n,) from predicted and actual values, in the place of the square.
    slope_sd : (n,) error of each of ``y``, by the scheme that made them; None when it gives none.

    >>> t = np.arange(3.0)
    >>> len(Samples(t[:, None], -2 * t, ("x",), "x", "given", t))
    3
    """

    X: np.ndarray
    y: np.ndarray
    names: tuple[str, ...]
    target: str
    scheme: str
    t: np.ndarray
    noise: float | None = None
    slope_sd: np.ndarray | None = None
    layers: bool = False
    loss: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.y)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Every column of ``X`` by name."""
        return {name: self.X[:, j] for j, name in enumerate(self.names)}

    misses = Renamed("residuals")

    def residuals(self, predicted: np.ndarray) -> np.ndarray:
        """Give (n,) residuals whose squares are the loss: y - f(X), unless there is an own loss.

        Parameters
        ----------
        predicted : (n,) values of a formula.
        """
        if self.loss is None:
            return self.y - predicted
        with np.errstate(all="ignore"):
            return np.copysign(np.sqrt(self.loss(predicted, self.y)), self.y - predicted)

    @property
    def timed(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of each column, with the time as ``t``."""
        return {**self.columns, "t": self.t}

    def select(self, rows: slice | np.ndarray) -> Samples:
        """Give the samples of some rows.

        Parameters
        ----------
        rows : a slice, (m,) whole numbers or (n,) booleans, one for each row.

        Raises InputError when they are no rows.
        """
        check_rows(rows, len(self))
        sd = None if self.slope_sd is None else self.slope_sd[rows]
        return replace(self, X=self.X[rows], y=self.y[rows], t=self.t[rows], slope_sd=sd)


# The difference schemes; the number of a central one is its order in the step.
CENTRAL_ORDERS = (2, 4, 6, 8, 10, 12, 14)
CENTRAL = tuple(f"central{order}" for order in CENTRAL_ORDERS)
SCHEMES = ("forward", "backward", *CENTRAL)


def difference(t: np.ndarray, x: np.ndarray, scheme: str) -> tuple[slice, np.ndarray]:
    """Differentiate one column by finite differences; nothing is smoothed.

    "forward" pairs ``x(t[i])`` with ``(x(t[i+1]) - x(t[i])) / (t[i+1] - t[i])``, so that the last
    time is dropped (the paper's fitness function, section 4); "backward" pairs that slope with
    ``x(t[i+1])`` (the paper's section 3); "central4" takes the polynomial through the 4 + 1 times
    around each, evenly spaced or not (Fornberg 1988), and drops two times at either end.

    Parameters
    ----------
    t : (n,) times in seconds, strictly increasing.
    x : (n,) values of one state.
    scheme : a name of SCHEMES.

    Returns
    -------
    The rows that have a slope, and the slopes there in state units per second.

    Raises InputError when the scheme is unknown or there are too few rows for it.

    >>> difference(np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 3.0]), "forward")
    (slice(0, 2, None), array([2., 4.]))
    >>> t = np.array([0.0, 0.1, 0.3, 0.4, 0.6])
    >>> bool(np.allclose(difference(t, t**2, "central2")[1], 2 * t[1:-1]))
    True
    """
    if scheme not in SCHEMES:
        raise InputError(f"unknown scheme {scheme!r}; the schemes are: {', '.join(SCHEMES)}")
    order = int(scheme.removeprefix("central")) if scheme in CENTRAL else 1
    if len(t) < order + 1:
        raise InputError(
            f"{len(t)} rows are too few for {scheme} differences; give at least {order + 1}"
        )
    if scheme in CENTRAL:
        half, windows = order // 2, np.lib.stride_tricks.sliding_window_view(x, order + 1)
        slopes = np.einsum("ij,ij->i", central_weights(t, order), windows)
        return slice(half, len(t) - half), slopes
    rows = slice(0, len(t) - 1) if scheme == "forward" else slice(1, len(t))
    return rows, np.diff(x) / np.diff(t)


def central_weights(t: np.ndarray, order: int) -> np.ndarray:
    """Weights (n - order, order + 1) of the central difference at every inner one of n times.

    They are those of the interpolating polynomial in its barycentric form (Berrut and Trefethen
    2004).

    >>> central_weights(np.array([0.0, 1.0, 2.0]), 2)
    array([[-0.5, -0. ,  0.5]])
    """
    middle = order // 2
    nodes = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    gaps, barycentric = barycentric_weights(nodes - nodes[:, [middle]])
    weights = barycentric / barycentric[:, [middle]] / gaps[:, middle, :]
    weights[:, middle] = 0.0
    weights[:, middle] = -weights.sum(axis=1)
    return weights


def barycentric_weights(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gaps between the nodes of each row of (rows, m), and their barycentric weights.

    The gaps (rows, m, m) are 1 on the diagonal; the weights (rows, m) hold up to a factor for
    each row.
    """
    gaps = nodes[:, :, None] - nodes[:, None, :]
    largest = np.maximum(np.abs(gaps).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    diagonal = np.arange(nodes.shape[1])
    gaps[:, diagonal, diagonal] = 1.0
    # Scaled so that products of many small gaps neither under- nor overflow; a power of two rounds
    # nothing.
    scale = np.where(largest < 1, 2.0 ** np.floor(np.log2(largest)), largest)
    return gaps, 1.0 / np.prod(gaps / scale, axis=2)


@checked
def make_samples(
    trajectories: Trajectory | Sequence[Trajectory], target: str, scheme: str = "forward"
) -> Samples:
    """Make the samples of one target by a difference scheme, without smoothing.

    Parameters
    ----------
    trajectories : one or many, of the same columns; no difference reaches from one to the next.
    target : the state whose slope is wanted.
    scheme : a name of SCHEMES; see :func:`dynsr.data.samples.difference`.

    Raises InputError when the scheme or the target is unknown, there are too few rows, or the
    trajectories have different columns.

    >>> line = Trajectory([0.0, 0.5, 1.0], [[0.0], [1.0], [3.0]], ("x",))
    >>> len(make_samples([line, line], "x"))
    4
    """
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("no trajectory was given; give at least one")
    if any(run.names != runs[0].names for run in runs):
        raise InputError("the trajectories have different columns; give all the same columns")
    pieces = []
    for run in runs:
        rows, slopes = difference(run.t, run.x[:, run.index(target)], scheme)
        pieces.append(Samples(run.columns[rows], slopes, run.names, target, scheme, run.t[rows]))
    return join_samples(pieces)


def join_samples(pieces: Sequence[Samples]) -> Samples:
    """Put samples of the same columns and target below each other."""
    errors = [piece.slope_sd for piece in pieces if piece.slope_sd is not None]
    return replace(
        pieces[0],
        X=np.concatenate([piece.X for piece in pieces]),
        y=np.concatenate([piece.y for piece in pieces]),
        t=np.concatenate([piece.t for piece in pieces]),
        slope_sd=np.concatenate(errors) if len(errors) == len(pieces) else None,
    )
