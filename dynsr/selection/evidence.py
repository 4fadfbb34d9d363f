"""Evidence: what data say about the right-hand side of one equation, as a linear model.

No slopes are used. The right-hand side is integrated and compared with the measured states, which
are free within their noise. The residuals are a linear map of the values of the right-hand side
along the curves (the weak form with every window at once). The map and its target represent all
rows of the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import sympy
from scipy.interpolate import CubicSpline
from scipy.linalg import LinAlgError

from dynsr.data import Samples
from dynsr.expression import evaluate, free_constants
from dynsr.fit import (
    FLOOR,
    Collocation,
    CollocationFit,
    Mesh,
    Probes,
    precision_bits,
)
from dynsr.selection.subsets import SINGULAR, without


@dataclass(frozen=True, eq=False)
class Evidence:
    """A linear view of one equation.

    Parameters
    ----------
    names : the columns, the time the last.
    points : (names, n) their values where a right-hand side is asked for.
    y : (r,) what its mapped values are to be.
    maps : (r, n) how values at the points are mapped; (n,) where each is only weighted.
    beside : sum of squares that is left whatever they are, in units of the noise.
    rows : rows of the data.
    """

    names: tuple[str, ...]
    points: np.ndarray
    y: np.ndarray
    maps: np.ndarray
    beside: float
    rows: float

    @classmethod
    def of(
        cls, still: Collocation, names: tuple[str, ...], rows: float, softness: float, nodes: int
    ) -> Evidence | None:
        """Take the last equation of a system along the curves; None where it is not determined.

        Parameters
        ----------
        still : the system, with 0 for that equation; constants of the others are free.
        names : the columns, the time the last.
        rows : measured rows.
        softness : weight of the defects.
        nodes : points at most, between which values are interpolated.
        """
        mesh = first_part(still.mesh, nodes)
        still = replace(still, mesh=mesh)
        places, spread = spread_over(mesh, nodes)
        probes = Probes(np.full(len(spread), len(mesh.states) - 1), spread)
        constants = still.constants
        try:
            gram = still.normal(mesh.start, constants, probes, softness).gram
        except LinAlgError:
            return None
        if count := len(constants):
            gram = without(gram, range(count), count)
        points = still.points(mesh.start, constants)[:, places]
        return cls._of_gram(names, points, gram, rows)

    @classmethod
    def of_slopes(cls, samples: Samples, errors: np.ndarray) -> Evidence:
        """Take slopes that are known at the points themselves.

        Parameters
        ----------
        samples : the slopes.
        errors : (n,) of each.
        """
        points = np.column_stack([samples.X, samples.t]).T
        rows = float(len(samples))
        return cls((*samples.names, "t"), points, samples.y / errors, 1 / errors, rows, rows)

    @classmethod
    def in_place(
        cls,
        fit: CollocationFit,
        problem: Collocation,
        parts: Mapping[str, tuple[float, sympy.Expr]],
        names: tuple[str, ...],
        nodes: int,
        softness: float | None,
    ) -> Evidence | None:
        """Take what is to replace parts of a system, with all the rest free.

        The states of a system that follows the data are better curves than smoothed ones, and
        nothing has to compensate for errors of the other equations.

        Parameters
        ----------
        fit, problem : the system.
        parts : state -> factor of what is sought in its equation, and the sum of terms of the
            equation in the place of which it is.
        names : the columns, the time the last.
        nodes : points at most, between which values are interpolated.
        softness : weight of the defects; None for that of the fit.

        None where the data do not determine it, or jump more often than there are points.
        """
        mesh = problem.mesh
        if np.count_nonzero(mesh.h == 0) > nodes:
            return None
        places, spread = spread_over(mesh, nodes)
        owners = np.repeat([mesh.states.index(state) for state in parts], len(spread))
        probes = Probes(owners, np.tile(spread, (len(parts), 1)))
        try:
            gram = problem.normal(fit.states, fit.constants, probes, softness).gram
        except (LinAlgError, ValueError):
            return None
        if not np.all(np.isfinite(gram)):
            return None
        points = problem.points(fit.states, fit.constants)[:, places]
        columns = dict(zip(names, points, strict=True))
        # What was there is taken out, and the misses are left to what takes its place.
        count, width = len(fit.constants), len(spread)
        step = np.zeros((count + width + 1, len(gram)))
        step[:count, :count] = np.eye(count)
        for place, (factor, part) in enumerate(parts.values()):
            own = slice(count + place * width, count + (place + 1) * width)
            step[count:-1, own] = factor * np.eye(width)
            step[-1, own] = -evaluate(part, columns)
        step[-1, -1] = 1.0
        constants = [
            (s, v) for s, e in fit.exprs.items() for v in free_constants(e, "c")[1].values()
        ]
        out = {(s, float(v)) for s, (_, part) in parts.items() for v in part.atoms(sympy.Float)}
        others = [place for place, (s, v) in enumerate(constants) if (s, float(v)) not in out]
        left = without(step @ gram @ step.T, others, count)
        return cls._of_gram(names, points, left, float(mesh.rows.sum()))

    @classmethod
    def _of_gram(
        cls, names: tuple[str, ...], points: np.ndarray, gram: np.ndarray, rows: float
    ) -> Evidence:
        """Give the view that has these products of values at the points, and of the residuals."""
        values, directions = np.linalg.eigh(gram[:-1, :-1])
        told = values > SINGULAR * values[-1]
        roots = np.sqrt(values[told])
        maps = roots[:, None] * directions[:, told].T
        y = -(directions[:, told].T @ gram[:-1, -1]) / roots
        beside = max(float(gram[-1, -1]) - float(y @ y), 0.0)
        return cls(names, points, y, maps, beside, rows)

    def mapped(self, values: np.ndarray) -> np.ndarray:
        """(..., r) what values (..., n) at the points are mapped to."""
        return np.asarray(values * self.maps if self.maps.ndim == 1 else values @ self.maps.T)

    @property
    def constant_bits(self) -> float:
        """Bits of a constant: of what the whole is worth in the data, each has that precision."""
        return float(precision_bits(np.array([[self.y @ self.y]]), np.ones(1)))

    def misses(self, left: np.ndarray | float) -> np.ndarray:
        """Bits of the residuals, where ``left`` is their sum of squares."""
        return np.asarray(
            self.rows / 2 * np.log2(np.maximum(left + self.beside, FLOOR) / self.rows)
        )


def first_part(mesh: Mesh, nodes: int) -> Mesh:
    """Give a mesh up to so many jumps that values between them need no more rows than usual.

    Parameters
    ----------
    mesh, nodes : the mesh, and rows at most.
    """
    jumps = mesh.left[mesh.h == 0]
    if len(jumps) <= nodes:
        return mesh
    count = int(jumps[nodes]) + 1
    n, some = len(mesh.t), mesh.left < count - 1
    at, between = mesh.driven[:, :count], mesh.driven[:, n:][:, some]
    return replace(
        mesh,
        t=mesh.t[:count],
        left=mesh.left[some],
        x=mesh.x[:count],
        weights=mesh.weights[:count],
        start=mesh.start[:count],
        driven=np.concatenate([at, between], axis=1),
        censored=None if mesh.censored is None else mesh.censored.at(np.arange(n) < count),
    )


def spread_over(mesh: Mesh, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Give rows (N,) of a mesh, and (N, n + m) what a value at each is at its rows and between.

    What lies between the rows that are taken is interpolated by cubic splines, run by run and
    from jump to jump, where a row is there twice.

    Parameters
    ----------
    mesh, nodes : the mesh, and rows at most.
    """
    count, twice = len(mesh.t), mesh.left[mesh.h == 0] + 1
    first = np.union1d(np.setdiff1d(np.arange(count), mesh.left + 1), twice)
    chosen: list[np.ndarray] = []
    places = np.concatenate([np.arange(count), mesh.left])
    times = np.concatenate([mesh.t, (mesh.t[mesh.left] + mesh.t[mesh.left + 1]) / 2])
    blocks = []
    for begin, end in zip(first, [*first[1:], count], strict=True):
        most = max(4, round(nodes * (end - begin) / count))
        own = np.unique(np.linspace(begin, end - 1, min(end - begin, most)).astype(int))
        inside = (places >= begin) & (places < end)
        block = np.zeros((len(own), len(times)))
        if len(own) > 1:
            spline = CubicSpline(mesh.t[own], np.eye(len(own)))
            block[:, inside] = spline(times[inside]).T
        chosen.append(own)
        blocks.append(block)
    return np.concatenate(chosen), np.concatenate(blocks)
