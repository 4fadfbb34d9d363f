"""Estimator: the scikit-learn face of dynsr, one target at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from dynsr.data import Samples
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine
from dynsr.errors import InputError
from dynsr.expression import check_name, evaluate
from dynsr.fit import (
    Candidate,
    ParetoFront,
    choose,
    description_length,
    noise_of,
    score_candidate,
    score_snapped,
    tidy,
)
from dynsr.methods import DEFAULT_PRESET, AbstractMethod, choose_methods


class DynsrRegressor(RegressorMixin, BaseEstimator):
    """Find y = f(X) as a formula; slopes of a state for y make it one equation of a system.

    Parameters
    ----------
    method : the name of a method, a method with its settings, or several; "auto" runs those of
        the preset.
    preset : "best", "quick" or "paper", see :data:`dynsr.methods.registry.PRESETS`.
    select : "description length" or "lowest error": which formula of the front is used.
    snap : replace constants by simple numbers where the description length says so.
    most_snapped : so many formulas, those of least description length, are snapped.
    random_state : seed of all chance.
    engine : "embedded", "julia" or an engine: what regresses for SINDy.

    Attributes
    ----------
    expr_ : the formula (SymPy) in the names of the columns, ``x0, x1, ...`` without names.
    front_ : all formulas found (:class:`dynsr.fit.candidates.ParetoFront`).

    >>> X = np.linspace(0.5, 2.0, 80)[:, None]
    >>> DynsrRegressor().fit(X, 3 * X[:, 0] ** 2).expr_
    3*x0**2
    """

    def __init__(
        self,
        method: str | AbstractMethod | Sequence[str | AbstractMethod] = "rational",
        preset: str = DEFAULT_PRESET,
        select: str = "description length",
        snap: bool = True,
        most_snapped: int = 6,
        random_state: int | np.random.RandomState | None = 0,
        engine: str | AbstractEngine = DEFAULT_ENGINE,
    ) -> None:
        """Keep the settings; they are checked in :meth:`fit`."""
        self.method = method
        self.preset = preset
        self.select = select
        self.snap = snap
        self.most_snapped = most_snapped
        self.random_state = random_state
        self.engine = engine

    def fit(self, X: Any, y: Any) -> DynsrRegressor:
        """Search for a formula.

        Parameters
        ----------
        X : (n, p) columns, an array or a frame.
        y : (n,) values of the target.

        Raises InputError (a ValueError) when a setting is unknown, EngineUnavailable when the
        engine is absent.
        """
        X, y = validate_data(self, X, y, y_numeric=True, dtype=np.float64, ensure_min_samples=2)
        if self.select not in ("description length", "lowest error"):
            raise InputError(
                f"unknown select {self.select!r}; use 'description length' or 'lowest error'"
            )
        engine = find_engine(self.engine)
        samples = self._samples(X, np.asarray(y, dtype=np.float64))
        front = ParetoFront([score_candidate(sympy.Float(float(np.mean(y))), samples, "the mean")])
        seed = check_random_state(self.random_state).randint(2**31)
        for method in choose_methods(self.method, self.preset).values():
            rng = np.random.default_rng(seed)
            front = front.merge(method.with_engine(engine).search(samples, rng))
        self.expr_, self.front_ = self._choose(front, samples)
        return self

    def _samples(self, X: np.ndarray, y: np.ndarray) -> Samples:
        self.names_ = _names(self)
        return Samples(X, y, self.names_, "y", "given", np.arange(len(y), dtype=float))

    def _choose(self, front: ParetoFront, samples: Samples) -> tuple[sympy.Expr, ParetoFront]:
        if self.select == "lowest error":
            return front.best_fit.expr, front
        noise = noise_of(front, samples)
        if self.snap:
            ranked = sorted(front, key=lambda c: description_length(c, samples, noise))
            front = front.add(*self._snapped(ranked[: self.most_snapped], samples, noise))
        return choose(front, samples, noise).expr, front

    def _snapped(self, ranked: list[Candidate], samples: Samples, noise: Any) -> list[Candidate]:
        snapped = [score_snapped(c, samples, noise) for c in ranked]
        return [score_candidate(tidy(c.expr), samples, c.source) for c in snapped]

    def predict(self, X: Any) -> np.ndarray:
        """Evaluate the formula on (n, p) ``X``, (n,); where it is not finite the nearest number."""
        check_is_fitted(self, "expr_")
        X = validate_data(self, X, dtype=np.float64, reset=False)
        columns = {name: X[:, j] for j, name in enumerate(self.names_)}
        return np.nan_to_num(evaluate(self.expr_, columns))

    def __sklearn_is_fitted__(self) -> bool:
        """Say whether :meth:`fit` has ended."""
        return hasattr(self, "expr_")


def _names(estimator: DynsrRegressor) -> tuple[str, ...]:
    """Names of the columns that can stand in a formula."""
    given = getattr(estimator, "feature_names_in_", None)
    generic = tuple(f"x{j}" for j in range(estimator.n_features_in_))
    if given is None:
        return generic
    try:
        names = tuple(check_name(str(name), "column") for name in given)
    except InputError:
        return generic
    return names if len(set(names)) == len(names) else generic
