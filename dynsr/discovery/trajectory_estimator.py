"""Trajectory estimator: a discovery behind the interface of PySINDy."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from sklearn.base import BaseEstimator
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_is_fitted

from dynsr.arguments import checked
from dynsr.data import Trajectory, decide_hold
from dynsr.discovery.orders import form_of, write_lines
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.errors import DynsrWarning, InputError
from dynsr.expression import bare_term, evaluate, expand_terms, shown
from dynsr.methods import AUTO, DEFAULT_PRESET, AbstractMethod

Arrays = Any
# Rows of a map that is iterated.
_MOST_STEPS = 1_000_000


@checked
class TrajectoryRegressor(BaseEstimator):
    """Find the equations of trajectories: an estimator with the interface of ``pysindy.SINDy``.

    It takes what scripts for PySINDy 1 and 2 give. :func:`dynsr.discover` does the work, so that it
    finds terms that no library lists, and other constants than least squares of slopes.

    Parameters
    ----------
    optimizer, feature_library : PySINDy's own; they have no effect, with a DynsrWarning, since the
        data choose terms and thresholds here.
    differentiation_method : function of (n, k) states and (n,) times that gives the (n, k) slopes,
        such as one of PySINDy's objects or one of your own; by default the data choose.
    feature_names : names of the states, or of the states and the inputs, where :meth:`fit` is given
        none, as in PySINDy 1.
    t_default : the step between rows where none is given, as in PySINDy 1.
    method : "auto", the name of a method, a method with its settings, or several.
    preset : "best", "quick" or "paper".
    hold : input -> what it does between rows: "previous", "linear" or "smooth"; or one word for
        all. By default the values show it.
    discrete_time : whether to find a map from row to row instead of slopes.
    random_state : seed of all chance.
    jobs : searches at a time; -1 uses every core.

    Attributes
    ----------
    discovery_ : what was found (:class:`dynsr.Discovery`), with fronts, intervals and a verdict.
    equations_ : state -> right-hand side (SymPy).
    feature_names : names of the states, then of the inputs, once it is fitted.

    >>> t = np.linspace(0, 3, 301)
    >>> model = TrajectoryRegressor(preset="quick", jobs=1).fit(np.exp(-0.5 * t), t=t)
    >>> model.print()
    (x0)' = -0.5*x0
    """

    def __init__(
        self,
        optimizer: Any = None,
        feature_library: Any = None,
        differentiation_method: Any = None,
        feature_names: Sequence[str] | None = None,
        t_default: float | None = None,
        *,
        method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO,
        preset: str = DEFAULT_PRESET,
        hold: Mapping[str, str] | str | None = None,
        discrete_time: bool = False,
        random_state: int = 0,
        jobs: int = -1,
    ) -> None:
        """Keep the settings; they are checked in :meth:`fit`."""
        self.optimizer = optimizer
        self.feature_library = feature_library
        self.differentiation_method = differentiation_method
        self.feature_names = feature_names
        self.t_default = t_default
        self.method = method
        self.preset = preset
        self.hold = hold
        self.discrete_time = discrete_time
        self.random_state = random_state
        self.jobs = jobs

    def fit(
        self,
        x: Arrays,
        t: Any = None,
        x_dot: Arrays = None,
        u: Arrays = None,
        feature_names: Sequence[str] | None = None,
    ) -> TrajectoryRegressor:
        """Search for the equations.

        Parameters
        ----------
        x : (n, k) states of a trajectory, or a list of such arrays.
        t : the step between rows, or the (n,) times, or a list of these, one a trajectory.
        x_dot : (n, k) slopes, or a list of them; made from the data by default.
        u : (n, m) inputs, or a list of them.
        feature_names : names of the states, or of the states and the inputs; by default those of
            the estimator, else ``x0, x1, ...`` and ``u0, u1, ...``.

        Raises InputError (a ValueError) when the data cannot be used or a setting is unknown.
        """
        for name in ("optimizer", "feature_library"):
            _say_unused(name, getattr(self, name))
        if feature_names is None and self.feature_names is not getattr(self, "_named", None):
            # Names of an earlier fit may be those of other data.
            feature_names = self.feature_names
        states, inputs = _name_columns(x, u, feature_names)
        self.feature_names = self._named = [*states, *inputs]
        self._states, self._inputs = states, inputs
        runs = self._take(x, t, u)
        slopes = self._make_slopes(runs) if x_dot is None else self._slopes(x_dot)
        self.discovery_: Discovery = discover(
            runs,
            method=self.method,
            preset=self.preset,
            hold=self.hold,
            discrete=self.discrete_time,
            seed=self.random_state,
            jobs=self.jobs,
            slopes=slopes,
        )
        self.equations_: dict[str, sympy.Expr] = self.discovery_.equations
        return self

    def _make_slopes(self, runs: Sequence[Trajectory]) -> dict[str, list[np.ndarray]] | None:
        """Give the slopes as the user's own method of differentiation makes them, if any."""
        method = self.differentiation_method
        if method is None:
            return None
        if self.discrete_time or not callable(method):
            _say_unused("differentiation_method", method)
            return None
        return self._slopes([method(run.x, run.t) for run in runs])

    def predict(self, x: Arrays, u: Arrays = None) -> Any:
        """Give the slopes of states, (n, k), or a list of such arrays; of a map the next states.

        Parameters
        ----------
        x : (n, k) states, or a list of such arrays.
        u : (n, m) inputs, or a list of them.
        """
        check_is_fitted(self, "discovery_")
        given = [None] * len(x) if u is None and isinstance(x, list) else u
        if isinstance(x, list):
            return [self._evaluate(*pair) for pair in zip(x, given, strict=True)]
        return self._evaluate(x, u)

    def _evaluate(self, x: Any, u: Any) -> np.ndarray:
        table = _table(x) if u is None else np.column_stack([_table(x), _table(u)])
        if table.shape[1] != len(self._named):
            raise InputError(
                f"{table.shape[1]} columns do not fit {len(self._states)} states "
                f"({', '.join(self._states)}) and {len(self._inputs)} inputs"
            )
        columns = dict(zip(self._named, table.T, strict=True))
        return np.column_stack([evaluate(self.equations_[s], columns) for s in self._states])

    def simulate(
        self,
        x0: Any,
        t: Any,
        u: Any = None,
        integrator: Any = None,
        integrator_kws: Any = None,
    ) -> np.ndarray:
        """Integrate the equations and give the states, (n, k).

        Parameters
        ----------
        x0 : (k,) states at the first time.
        t : (n,) times; of a map the times, or the number of rows.
        u : (n, m) inputs at the times, or a function of one time that gives the m of them.
        integrator, integrator_kws : PySINDy's own; they have no effect, with a DynsrWarning.

        Raises InputError when something is missing, EngineError when the solution diverges.
        """
        check_is_fitted(self, "discovery_")
        _say_unused("integrator", integrator)
        _say_unused("integrator_kws", integrator_kws)
        if np.ndim(t) == 0:
            if not self.discrete_time:
                raise InputError(f"t {t!r} must be the times at which to simulate, one per row")
            if not 1 <= t <= _MOST_STEPS:
                raise InputError(f"t {t!r} must be times, or rows from 1 to {_MOST_STEPS}")
            t = np.arange(int(t))
        given = {} if u is None else self._drives(u)
        return self.discovery_.simulate(np.atleast_1d(x0), np.asarray(t), given).x

    def _drives(self, u: Any) -> dict[str, Any]:
        if not callable(u):
            return dict(zip(self._inputs, _table(u).T, strict=True))

        def column(position: int) -> Callable[[float], float]:
            return lambda t: float(np.ravel(u(t))[position])

        return {name: column(i) for i, name in enumerate(self._inputs)}

    def score(
        self,
        x: Arrays,
        t: Any = None,
        x_dot: Arrays = None,
        u: Arrays = None,
        metric: Callable[..., float] = r2_score,
        **metric_kws: Any,
    ) -> float:
        """Score the slopes that the equations give, by R2: 1 is best; the mean over the states.

        Parameters
        ----------
        x, t, u : trajectories, as for :meth:`fit`.
        x_dot : their slopes; made from the data by default, as the discovery makes them.
        metric : function of true and given slopes.
        metric_kws : what else it takes.
        """
        check_is_fitted(self, "discovery_")
        runs = decide_hold(self._take(x, t, u), self.discovery_.hold)
        slopes = {} if x_dot is None else self._slopes(x_dot)
        form = form_of(self.discovery_.settings)
        scores = []
        for state in self._states:
            samples = form.samples(runs, state, **({"slopes": slopes[state]} if slopes else {}))
            found = evaluate(self.equations_[state], samples.timed)
            scores.append(metric(samples.y, found, **metric_kws))
        return float(np.mean(scores))

    def get_feature_names(self) -> list[str]:
        """Give the terms of all equations, each without its coefficient.

        >>> t = np.linspace(0, 3, 301)
        >>> model = TrajectoryRegressor(preset="quick", jobs=1).fit(1 - np.exp(-0.5 * t), t=t)
        >>> sorted(model.get_feature_names()), np.sort(model.coefficients()).tolist()
        (['1', 'x0'], [[-0.5, 0.5]])
        """
        return [shown(term) for term in self._terms()]

    def coefficients(self) -> np.ndarray:
        """Give the coefficient (k, m) of every term of :meth:`get_feature_names` in each equation.

        A term that is no sum, such as a ratio, is one feature with its own constants.
        """
        own = [self._split(self.equations_[state]) for state in self._states]
        return np.array([[terms.get(term, 0.0) for term in self._terms()] for terms in own])

    @property
    def complexity(self) -> int:
        """How many coefficients are not 0."""
        return int(np.count_nonzero(self.coefficients()))

    def _terms(self) -> list[sympy.Expr]:
        check_is_fitted(self, "discovery_")
        found = [self._split(self.equations_[state]) for state in self._states]
        return list(dict.fromkeys(term for terms in found for term in terms))

    def _split(self, expr: sympy.Expr) -> dict[sympy.Expr, float]:
        terms = [] if expr == 0 else sympy.Add.make_args(expand_terms(expr))
        bare = [bare_term(term) for term in terms]
        return {b: float(term / b) for b, term in zip(bare, terms, strict=True)}

    def equations(self, precision: int = 3) -> list[str]:
        """Give the right-hand sides as text.

        Parameters
        ----------
        precision : digits of the constants.
        """
        check_is_fitted(self, "discovery_")
        return [shown(self.equations_[state], precision) for state in self._states]

    def print(self, lhs: Sequence[str] | None = None, precision: int = 3, **kwargs: Any) -> None:
        """Print the equations, one per line.

        Parameters
        ----------
        lhs : the left-hand side of each; ``(x)'`` by default, ``(x)[k+1]`` of a map.
        precision : digits of the constants.
        kwargs : what the builtin ``print`` takes too.
        """
        mark = "[k+1]" if self.discrete_time else "'"
        left = [f"({state}){mark}" for state in self._states] if lhs is None else lhs
        for name, text in zip(left, self.equations(precision), strict=True):
            print(f"{name} = {text}", **kwargs)  # noqa: T201

    def __sklearn_is_fitted__(self) -> bool:
        """Say whether :meth:`fit` has ended."""
        return hasattr(self, "discovery_")

    def __str__(self) -> str:
        """Write the equations once they are found."""
        if not self.__sklearn_is_fitted__():
            return str(super().__repr__())
        return "\n".join(write_lines(self.equations_, self.discovery_.settings))

    def _take(self, x: Arrays, t: Any, u: Arrays) -> list[Trajectory]:
        """Bring arrays of one trajectory, or lists of such, to trajectories."""
        tables = [_table(one) for one in (x if isinstance(x, list) else [x])]
        t = self.t_default if t is None else t
        drives = u if isinstance(u, list) else [u] * len(tables)
        times = t if isinstance(t, list) and isinstance(x, list) else [t] * len(tables)
        if not len(tables) == len(drives) == len(times):
            raise InputError(
                f"{len(tables)} arrays of states, {len(times)} of times and {len(drives)} of "
                "inputs do not fit; give one of each a trajectory"
            )
        return [
            Trajectory(
                _times(own, len(table)),
                table,
                tuple(self._states),
                np.empty((0, 0)) if drive is None else _table(drive),
                tuple(self._inputs),
            )
            for table, own, drive in zip(tables, times, drives, strict=True)
        ]

    def _slopes(self, x_dot: Arrays) -> dict[str, list[np.ndarray]]:
        tables = [_table(one) for one in (x_dot if isinstance(x_dot, list) else [x_dot])]
        return {s: [table[:, i] for table in tables] for i, s in enumerate(self._states)}


def _table(values: Any) -> np.ndarray:
    """Give (n,) or (n, k) values as (n, k)."""
    table = np.asarray(values, dtype=float)
    return table[:, None] if table.ndim == 1 else table


def _times(t: Any, rows: int) -> np.ndarray:
    if t is None:
        raise InputError("x needs its times: give t=, the step between rows or the time of each")
    if np.ndim(t) == 0:
        return float(t) * np.arange(rows)
    return np.asarray(t)


def _name_columns(x: Arrays, u: Arrays, names: Sequence[str] | None) -> tuple[list[str], list[str]]:
    counts = [
        0 if arrays is None else _table(arrays[0] if isinstance(arrays, list) else arrays).shape[-1]
        for arrays in (x, u)
    ]
    inputs = [f"u{i}" for i in range(counts[1])]
    if names is None:
        return [f"x{i}" for i in range(counts[0])], inputs
    given = list(map(str, names))
    if len(given) not in (counts[0], sum(counts)):
        raise InputError(
            f"{len(given)} feature_names do not fit {counts[0]} states and {counts[1]} inputs"
        )
    return given[: counts[0]], given[counts[0] :] or inputs


def _say_unused(name: str, value: Any) -> None:
    if value is not None:
        warnings.warn(
            f"{name} has no effect here: the data choose; see TrajectoryRegressor",
            DynsrWarning,
            stacklevel=3,
        )
