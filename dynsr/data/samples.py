"""Samples: states paired with slopes, one scalar regression problem; and the difference schemes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


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
    """

    X: np.ndarray
    y: np.ndarray
    names: tuple[str, ...]
    target: str
    scheme: str
    t: np.ndarray
    noise: float | None = None

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.y)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Every column of ``X`` by name."""
        return {name: self.X[:, j] for j, name in enumerate(self.names)}

    def select(self, rows: slice | np.ndarray) -> Samples:
        """Give the samples of some rows."""
        return replace(self, X=self.X[rows], y=self.y[rows], t=self.t[rows])


def _samples(
    trajectory: Trajectory, target: str, scheme: str, rows: slice | np.ndarray, slopes: np.ndarray
) -> Samples:
    return Samples(
        trajectory.columns[rows], slopes, trajectory.names, target, scheme, trajectory.t[rows]
    )


def _need_rows(trajectory: Trajectory, rows: int, scheme: str) -> None:
    if len(trajectory) < rows:
        raise InputError(
            f"{len(trajectory)} rows are too few for {scheme} differences; give at least {rows}"
        )


def forward_difference(trajectory: Trajectory, target: str) -> Samples:
    """Pair each state with the slope that leads away from it.

    Row i is ``x(t[i])`` with ``(x(t[i+1]) - x(t[i])) / (t[i+1] - t[i])``; the last time has no
    future and is dropped. First order in the step (the paper's fitness function, section 4).

    >>> line = Trajectory([0.0, 0.5, 1.0], [[0.0], [1.0], [3.0]], ("x",))
    >>> forward_difference(line, "x").y.tolist()
    [2.0, 4.0]
    """
    _need_rows(trajectory, 2, "forward")
    column = trajectory.x[:, trajectory.index(target)]
    slopes = np.diff(column) / np.diff(trajectory.t)
    return _samples(trajectory, target, "forward", slice(None, -1), slopes)


def backward_difference(trajectory: Trajectory, target: str) -> Samples:
    """Pair each state with the slope that leads to it (the paper's section 3).

    >>> line = Trajectory([0.0, 0.5, 1.0], [[0.0], [1.0], [3.0]], ("x",))
    >>> backward_difference(line, "x").y.tolist()
    [2.0, 4.0]
    """
    _need_rows(trajectory, 2, "backward")
    column = trajectory.x[:, trajectory.index(target)]
    slopes = np.diff(column) / np.diff(trajectory.t)
    return _samples(trajectory, target, "backward", slice(1, None), slopes)


def finite_difference(trajectory: Trajectory, target: str, order: int) -> Samples:
    """Pair each state with a central difference of even ``order`` on any grid of times.

    Weights of the ``order + 1`` times around each are those of the interpolating polynomial
    (Fornberg 1988); the first and last ``order / 2`` times are dropped.

    >>> t = np.array([0.0, 0.1, 0.3, 0.4, 0.6])
    >>> square = Trajectory(t, (t**2)[:, None], ("x",))
    >>> bool(np.allclose(finite_difference(square, "x", 2).y, 2 * t[1:-1]))
    True
    """
    half = order // 2
    if order < 2 or order % 2:
        raise InputError(f"difference order {order} must be an even number from 2 up")
    _need_rows(trajectory, order + 1, f"central order-{order}")
    column = trajectory.x[:, trajectory.index(target)]
    windows = np.lib.stride_tricks.sliding_window_view(trajectory.t, order + 1)
    values = np.lib.stride_tricks.sliding_window_view(column, order + 1)
    weights = derivative_weights(windows - windows[:, [half]], half)
    slopes = np.einsum("ij,ij->i", weights, values)
    return _samples(trajectory, target, f"central{order}", slice(half, -half), slopes)


def derivative_weights(nodes: np.ndarray, at: int) -> np.ndarray:
    """Weights of the first derivative at node ``at`` (barycentric form), for each row of nodes."""
    gaps = nodes[:, :, None] - nodes[:, None, :]
    diagonal = np.arange(nodes.shape[1])
    gaps[:, diagonal, diagonal] = 1.0
    # Scale so that products of many small gaps neither under- nor overflow.
    scale = np.abs(gaps).max(axis=(1, 2), keepdims=True)
    barycentric = 1.0 / np.prod(gaps / scale, axis=2)
    weights = barycentric / barycentric[:, [at]] / gaps[:, at, :]
    weights[:, at] = 0.0
    weights[:, at] = -weights.sum(axis=1)
    return weights


SCHEMES: dict[str, Callable[[Trajectory, str], Samples]] = {
    "forward": forward_difference,
    "backward": backward_difference,
    "central2": lambda trajectory, target: finite_difference(trajectory, target, 2),
    "central4": lambda trajectory, target: finite_difference(trajectory, target, 4),
    "central6": lambda trajectory, target: finite_difference(trajectory, target, 6),
    "central8": lambda trajectory, target: finite_difference(trajectory, target, 8),
}


def make_samples(
    trajectories: Trajectory | Sequence[Trajectory], target: str, scheme: str = "forward"
) -> Samples:
    """Make the samples of one target from one or many trajectories by a scheme of SCHEMES.

    Raises InputError when the scheme is unknown or the trajectories have different columns.

    >>> line = Trajectory([0.0, 0.5, 1.0], [[0.0], [1.0], [3.0]], ("x",))
    >>> len(make_samples([line, line], "x"))
    4
    """
    if scheme not in SCHEMES:
        raise InputError(f"unknown scheme {scheme!r}; the schemes are: {', '.join(SCHEMES)}")
    if isinstance(trajectories, Trajectory):
        return SCHEMES[scheme](trajectories, target)
    if not trajectories:
        raise InputError("no trajectory was given; give at least one")
    parts = [SCHEMES[scheme](trajectory, target) for trajectory in trajectories]
    if any(part.names != parts[0].names for part in parts):
        raise InputError("the trajectories have different columns; give all the same columns")
    return join(parts)


def join(parts: Sequence[Samples]) -> Samples:
    """Put samples of the same columns and target below each other."""
    first = parts[0]
    return replace(
        first,
        X=np.concatenate([p.X for p in parts]),
        y=np.concatenate([p.y for p in parts]),
        t=np.concatenate([p.t for p in parts]),
    )
