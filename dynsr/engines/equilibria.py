"""Equilibria: the fixed points of equations, how they go near there, and along one constant.

Fixed points are sought by Newton's method from points that fill a box evenly (Halton 1960), so that
all within are found as far as one start comes to each; what lies on a whole line of them is said
to. Damped steps (Levenberg 1944) are taken from all points at once. From where they end too early,
MINPACK's hybrid goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import sympy

from dynsr.errors import InputError, say_near
from dynsr.expression import compile_columns, compile_numpy, differentiate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Box = Mapping[str, tuple[float, float]]
_EPS = float(np.finfo(float).eps)
# Factors by which the damping of a step falls after a better one, and grows after a worse one.
_LESS, _MORE = 8.0, 4.0


@dataclass(frozen=True)
class EquilibriumSettings:
    """The numbers by which fixed points are searched and distinguished.

    Parameters
    ----------
    starts : points from which a search begins, for each state.
    steps : Newton steps from each of them.
    wide : share of the box by which the search goes beyond it on either side.
    still : slopes below this share of their size in the box count as 0.
    apart : distance, as a share of the box, from which on two points are two: where three meet, a
        point is known to the cube root of ``still`` only.
    singular : smallest singular value of the Jacobian, as a share of the largest, below which a
        point is one of a line of fixed points.
    zero : share of the largest eigenvalue below which a real part counts as 0.
    """

    starts: int = 60
    steps: int = 40
    wide: float = 0.5
    still: float = 1e-9
    apart: float = 2e-3
    singular: float = 1e-9
    zero: float = 1e-7


EQUILIBRIA = EquilibriumSettings()


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Equations near a point: the slope of a small deviation x is A x + B u.

    Parameters
    ----------
    A : (k, k) derivatives of the right-hand sides by the states.
    B : (k, m) derivatives by the inputs.
    states, inputs : names of the rows and columns.
    at : state -> value at the point.
    slopes : (k,) right-hand sides at the point: nothing at a fixed point.
    """

    A: np.ndarray
    B: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    at: Mapping[str, float]
    slopes: np.ndarray

    @property
    def eigenvalues(self) -> np.ndarray:
        """(k,) eigenvalues of A, largest real part first."""
        found = np.linalg.eigvals(self.A)
        return np.asarray(found[np.lexsort((-found.imag, -found.real))])


@dataclass(frozen=True)
class FixedPoint:
    """A point at which the equations do not change the states.

    Parameters
    ----------
    at : state -> value.
    kind : such as "stable node", "saddle", "unstable focus", "centre"; "degenerate" where it is one
        of a line of them, or several meet.
    stable : whether small deviations die out.
    eigenvalues : those of the linearised equations, largest real part first; of a map the largest
        first.
    """

    at: Mapping[str, float]
    kind: str
    stable: bool
    eigenvalues: tuple[complex, ...] = field(repr=False)

    @property
    def text(self) -> str:
        """The point and its kind, to be read."""
        return f"{', '.join(f'{n} = {v:.6g}' for n, v in self.at.items())}: {self.kind}"


def _check_states(given: Iterable[str], states: Collection[str]) -> None:
    for name in given:
        if name not in states:
            known = ", ".join(states)
            raise InputError(f"no state {name!r}{say_near(name, states)}; the states are: {known}")


def linearise(
    equations: Mapping[str, sympy.Expr],
    at: Mapping[str, float],
    inputs: Mapping[str, float] | None = None,
    t: float = 0.0,
) -> Linearisation:
    """Linearise equations at a point.

    Parameters
    ----------
    equations : state -> right-hand side, in numbers.
    at : state -> value.
    inputs : input -> value.
    t : the time, where the equations hold it.

    Raises InputError when a value is missing or the equations have no slope there.

    >>> w, v, u = sympy.symbols("w v u")
    >>> found = linearise({"w": v, "v": -sympy.sin(w) + 2 * u}, {"w": 0.0, "v": 0.0}, {"u": 0.0})
    >>> found.A.tolist(), found.B.tolist()
    ([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [2.0]])
    """
    states, driven = tuple(equations), tuple(inputs or {})
    _check_states(at, states)
    values = {**{s: float(at[s]) for s in states if s in at}, **(inputs or {}), "t": float(t)}
    needed = {str(s) for e in equations.values() for s in e.free_symbols} | {*states}
    if missing := sorted(needed - values.keys()):
        raise InputError(f"nothing says what {missing[0]!r} is at the point; give its value")
    columns = [sympy.Symbol(name) for name in (*states, *driven)]
    entries = [differentiate(e, c) for e in equations.values() for c in columns]
    point = np.array(list(values.values()))
    found = compile_numpy([*entries, *equations.values()], list(values))(point)
    k = len(states)
    matrix = found[: len(entries)].reshape(k, len(columns))
    if not np.all(np.isfinite(found)):
        where = ", ".join(f"{name} = {value:g}" for name, value in values.items())
        raise InputError(f"the equations have no slope at {where}; give another point")
    return Linearisation(
        matrix[:, :k],
        matrix[:, k:],
        states,
        driven,
        {s: values[s] for s in states},
        found[len(entries) :],
    )


def find_fixed_points(
    equations: Mapping[str, sympy.Expr],
    box: Box,
    discrete: bool = False,
    near: Sequence[Mapping[str, float]] = (),
    settings: EquilibriumSettings = EQUILIBRIA,
) -> tuple[FixedPoint, ...]:
    """Find the fixed points of equations in a box, and some beyond it.

    Parameters
    ----------
    equations : state -> right-hand side in the states alone, in numbers.
    box : state -> (low, high) of the search; half as much is on either side.
    discrete : whether they are a map.
    near : points where a search begins as well.
    settings : the numbers by which they are sought.

    Raises InputError when the equations hold more than their states.

    >>> x = sympy.Symbol("x")
    >>> for one in find_fixed_points({"x": x - x**3}, {"x": (-2.0, 2.0)}):
    ...     print(one.text)
    x = -1: stable node
    x = 0: unstable node
    x = 1: stable node
    """
    from scipy.optimize import root
    from scipy.stats.qmc import Halton

    states = list(equations)
    _check_states(box, states)
    others = sorted({str(s) for e in equations.values() for s in e.free_symbols} - {*states})
    if others:
        raise InputError(
            f"the equations hold {others[0]!r}; give its value, for it is given nowhere"
        )
    shift = [sympy.Symbol(s) if discrete else sympy.S.Zero for s in states]
    still = [e - s for e, s in zip(equations.values(), shift, strict=True)]
    columns = [sympy.Symbol(s) for s in states]
    entries = [differentiate(e, c) for e in still for c in columns]
    rhs, jacobian = compile_columns(still, states), compile_columns(entries, states)
    k = len(states)
    low, high = np.array([box[s] for s in states], dtype=float).T
    span = np.where(high > low, high - low, np.maximum(np.abs(high), 1.0))
    begin, whole = low - settings.wide * span, (1 + 2 * settings.wide) * span
    sample = Halton(k, scramble=False).random(settings.starts * k + 1)[1:]
    starts = np.concatenate(
        [np.array([[p[s] for s in states] for p in near]).reshape(-1, k), begin + sample * whole]
    )
    sizes = np.abs(rhs(*starts.T))
    finite = np.where(np.isfinite(sizes), sizes, 0.0)
    scale = np.maximum(np.mean(finite, axis=1), np.finfo(float).tiny)
    found = []

    def slopes(y: np.ndarray) -> np.ndarray:
        """(..., k) slopes at points (..., k), in shares of their size and of the box."""
        return np.asarray(rhs(*(low + y * span).T).T / scale)

    def by_states(y: np.ndarray) -> np.ndarray:
        """(..., k, k) their derivatives."""
        own = jacobian(*(low + y * span).T).T
        return np.asarray(own.reshape(*y.shape, k) * span / scale[:, None])

    with np.errstate(all="ignore"):
        begun = (starts[np.all(np.isfinite(sizes), axis=0)] - low) / span
        for end in _distinct(
            _descend(slopes, by_states, begun, settings.steps), settings.apart / 2
        ):
            ended = np.all(np.abs(slopes(end)) <= settings.still)
            point = low + span * (end if ended else root(slopes, end, jac=by_states).x)
            inside = np.all((point >= begin) & (point <= begin + whole))
            if inside and np.all(np.abs(rhs(*point)) <= settings.still * scale):
                found.append(np.where(np.abs(point) <= settings.still * span, 0.0, point))
    ordered = sorted(
        _distinct(found, settings.apart * span), key=lambda p: tuple(np.round(p / span, 6))
    )
    points = [_describe(p, jacobian(*p).reshape(k, k), states, discrete, settings) for p in ordered]
    # Of a line of fixed points one stands for all.
    alone = [p for p in points if p.kind != DEGENERATE]
    middle = dict(zip(states, (low + high) / 2, strict=True))
    lines = sorted(
        (p for p in points if p.kind == DEGENERATE),
        key=lambda p: sum(
            ((p.at[s] - middle[s]) / w) ** 2 for s, w in zip(states, span, strict=True)
        ),
    )
    return (*alone, *lines[:1])


def _descend(
    slopes: Callable[[np.ndarray], np.ndarray],
    by_states: Callable[[np.ndarray], np.ndarray],
    begun: np.ndarray,
    steps: int,
) -> np.ndarray:
    """Give where damped Newton steps from (n, k) points end."""
    points, values = begun.copy(), slopes(begun)
    sizes, damping = np.sum(values**2, axis=1), np.ones(len(begun))
    for _ in range(steps):
        matrix = by_states(points)
        gram = np.einsum("nji,njl->nil", matrix, matrix)
        pull = np.einsum("nji,nj->ni", matrix, values)
        fine = np.all(np.isfinite(gram), axis=(1, 2)) & np.all(np.isfinite(pull), axis=1)
        own = np.einsum("nii->ni", gram).max(axis=1)
        # Where nothing is left, and where nothing changes, there is no step.
        told = np.flatnonzero(fine & (sizes > 0) & (own > 0))
        if not len(told):
            break
        eye = np.eye(begun.shape[1])
        gram = gram[told] + (np.maximum(damping, _EPS)[told] * own[told])[:, None, None] * eye
        moved = points[told] - np.linalg.solve(gram, pull[told][..., None])[..., 0]
        there = slopes(moved)
        left = np.sum(there**2, axis=1)
        better = left < sizes[told]
        kept = told[better]
        points[kept], values[kept], sizes[kept] = moved[better], there[better], left[better]
        damping[kept] /= _LESS
        damping[told[~better]] *= _MORE
    return points


def _distinct(points: Iterable[np.ndarray], apart: float | np.ndarray) -> list[np.ndarray]:
    """Give the first of each group of (k,) points that are no further apart, state by state."""
    found: list[np.ndarray] = []
    for point in points:
        if all(np.any(np.abs(point - own) > apart) for own in found):
            found.append(point)
    return found


DEGENERATE = "degenerate"


def _describe(
    point: np.ndarray,
    slope: np.ndarray,
    states: Sequence[str],
    discrete: bool,
    settings: EquilibriumSettings,
) -> FixedPoint:
    at = dict(zip(states, map(float, point), strict=True))
    own = np.linalg.eigvals(slope + np.eye(len(states)) if discrete else slope)
    rate = np.abs(own) - 1 if discrete else own.real
    order = np.lexsort((-own.imag, -rate))
    own, rate = own[order], rate[order]
    values = tuple(complex(v) for v in own)
    sizes = np.linalg.svd(slope, compute_uv=False)
    if sizes[-1] <= settings.singular * sizes[0] or not sizes[0]:
        return FixedPoint(at, DEGENERATE, False, values)
    zero = settings.zero * (1.0 if discrete else float(np.max(np.abs(own))))
    turns = bool(np.any(np.abs(own.imag) > settings.zero * np.max(np.abs(own))))
    shape = "focus" if turns else "node"
    if np.all(rate < -zero):
        return FixedPoint(at, f"stable {shape}", True, values)
    if np.all(rate > zero):
        return FixedPoint(at, f"unstable {shape}", False, values)
    if np.any(rate > zero):
        return FixedPoint(at, "saddle", False, values)
    return FixedPoint(at, "centre" if turns else "at the edge of stability", False, values)


@dataclass(frozen=True, eq=False)
class Branches:
    """Fixed points along one parameter, as a search at each of its values finds them.

    Parameters
    ----------
    parameter : its name.
    values : (n,) its values.
    points : the fixed points at each of them.
    """

    parameter: str
    values: np.ndarray
    points: tuple[tuple[FixedPoint, ...], ...]

    def plot(self, state: str) -> Figure:
        """Draw the fixed points of a state along the parameter; those that are stable are filled.

        Parameters
        ----------
        state : the state on the vertical axis.

        Raises InputError where the points have no such state.
        """
        from dynsr.report import draw_branches

        for point in next(filter(None, self.points), ())[:1]:
            _check_states([state], point.at)
        return draw_branches(self, state)

    def changes(self) -> list[tuple[float, str]]:
        """Give (value, what changes there) wherever points come, go, or change their stability.

        >>> p = FixedPoint({"x": 0.0}, "stable node", True, (-1 + 0j,))
        >>> q = FixedPoint({"x": 0.0}, "unstable node", False, (1 + 0j,))
        >>> Branches("k", np.array([0.0, 1.0]), ((p,), (q,))).changes()
        [(0.5, '1 stable -> 1 unstable')]
        """
        found = []
        told = [_count(points) for points in self.points]
        for i in range(1, len(told)):
            if told[i] != told[i - 1]:
                middle = float(self.values[i - 1] + self.values[i]) / 2
                found.append((middle, f"{told[i - 1]} -> {told[i]}"))
        return found


def _count(points: Sequence[FixedPoint]) -> str:
    # A node that turns into a focus goes the same way.
    kinds = [point.kind.removesuffix(" node").removesuffix(" focus") for point in points]
    return ", ".join(f"{kinds.count(k)} {k}" for k in sorted(set(kinds))) or "none"


def follow_parameter(
    equations: Mapping[str, sympy.Expr],
    parameter: str,
    values: np.ndarray,
    box: Box,
    discrete: bool = False,
    settings: EquilibriumSettings = EQUILIBRIA,
) -> Branches:
    """Find the fixed points at each value of a parameter, beginning also where those before were.

    Parameters
    ----------
    equations : state -> right-hand side in the states and the parameter.
    parameter : its name.
    values : (n,) its values.
    box : state -> (low, high) of the search.
    discrete : whether they are a map.
    settings : the numbers by which they are sought.

    Raises InputError where a value is not finite, and as :func:`find_fixed_points` does.

    >>> x, k = sympy.symbols("x k")
    >>> found = follow_parameter({"x": k - x**2}, "k", np.array([-1.0, 1.0]), {"x": (-2.0, 2.0)})
    >>> found.changes()
    [(0.0, 'none -> 1 stable, 1 unstable')]
    """
    if not np.all(np.isfinite(values)):
        raise InputError(f"a value of {parameter!r} is no finite number; leave it out")
    symbol, points = sympy.Symbol(parameter), []
    near: list[Mapping[str, float]] = []
    for value in values:
        put = {s: e.xreplace({symbol: sympy.Float(float(value))}) for s, e in equations.items()}
        there = find_fixed_points(put, box, discrete, near, settings)
        near = [dict(point.at) for point in there]
        points.append(there)
    return Branches(parameter, np.asarray(values, dtype=float), tuple(points))
