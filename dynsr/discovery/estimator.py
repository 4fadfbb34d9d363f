"""Estimator: the scikit-learn face of dynsr, one target at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data
from sympy import Expr, Float

from dynsr.arguments import checked
from dynsr.data import Samples
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine, refuse_idle
from dynsr.errors import InputError
from dynsr.expression import (
    check_name,
    counting,
    evaluate,
    read_own_bits,
    shown,
    to_latex_formula,
)
from dynsr.fit import (
    LossFunction,
    ParetoFront,
    choose,
    choose_by_loss,
    description_length,
    noise_of,
    read_loss,
    score_candidate,
    score_snapped,
    tidy,
)
from dynsr.methods import AUTO, DEFAULT_PRESET, AbstractMethod, choose_methods, make_method

if TYPE_CHECKING:
    import pandas as pd

# Weights that are no whole numbers repeat each row so often in the mean.
_COPIES = 8
# What misses the target by less than this share of its spread is exact.
_EXACT = 1e-6


@checked
class DynsrRegressor(RegressorMixin, BaseEstimator):
    """Find y = f(X) as a formula; slopes of a state for y make it one equation of a system.

    Parameters
    ----------
    method : the name of a method, a method with its settings, or several; "auto" runs those of
        the preset, and with preset "best" the whole of DynAIFeynman where they find nothing exact.
    preset : "best", "quick" or "paper", see :data:`dynsr.methods.registry.PRESETS`.
    select : "description length" or "lowest error": which formula of the front is used.
    snap : replace constants by simple numbers where the description length says so.
    most_snapped : so many formulas, those of least description length, are snapped.
    random_state : seed of all chance.
    engine : "embedded", "julia" or an engine: what regresses for SINDy. Another than the embedded
        one needs a method that solves regressions.
    loss : "squared", "absolute", "huber", "cauchy", or a function of predicted and actual values
        (n,) that gives the loss of each row. It decides on the front and the choice, and fits the
        constants of the best formulas; the searches before go by least squares. The units of
        "huber" and "cauchy" are 1.345 and 2.385 times the size of the errors.
    complexity : function or operator -> bits that each of it costs more, such as {"sin": 8}; in
        the searches, the front and the choice alike.

    Attributes
    ----------
    expr_ : the formula (SymPy) in the names of the columns, ``x0, x1, ...`` without names.
    front_ : all formulas found (:class:`dynsr.fit.candidates.ParetoFront`).
    equations_ : the same as a data frame, simplest first: ``complexity`` in bits, ``loss`` (mean
        squared error, or the mean of ``loss``), ``score`` (drop of the logarithm of the loss a
        bit), ``equation``, ``sympy_format`` and ``source``.

    >>> X = np.linspace(0.5, 2.0, 80)[:, None]
    >>> model = DynsrRegressor().fit(X, 3 * X[:, 0] ** 2)
    >>> model.sympy(), model.latex()
    (3*x0**2, '3 x_{0}^{2}')
    """

    def __init__(
        self,
        method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO,
        preset: str = DEFAULT_PRESET,
        select: str = "description length",
        snap: bool = True,
        most_snapped: int = 6,
        random_state: int | np.random.RandomState | None = 0,
        engine: str | AbstractEngine = DEFAULT_ENGINE,
        loss: str | LossFunction | None = None,
        complexity: Mapping[str, float] | None = None,
    ) -> None:
        """Keep the settings; they are checked in :meth:`fit`."""
        self.method = method
        self.preset = preset
        self.select = select
        self.snap = snap
        self.most_snapped = most_snapped
        self.random_state = random_state
        self.engine = engine
        self.loss = loss
        self.complexity = complexity

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> DynsrRegressor:
        """Search for a formula.

        Parameters
        ----------
        X : (n, p) columns, an array or a frame.
        y : (n,) values of the target.
        sample_weight : (n,) weights, not negative; a row of weight 2 counts as two rows. Weights
            that are no multiples of the smallest one are rounded to an eighth of their mean.

        Raises InputError (a ValueError) when a setting is unknown or the engine would have nothing
        to do, EngineUnavailable when it is absent.
        """
        X, y = validate_data(self, X, y, y_numeric=True, dtype=np.float64, ensure_min_samples=2)
        if self.select not in ("description length", "lowest error"):
            raise InputError(
                f"unknown select {self.select!r}; use 'description length' or 'lowest error'"
            )
        y = np.asarray(y, dtype=np.float64)
        if sample_weight is not None:
            rows = _repeated(_check_sample_weight(sample_weight, X, ensure_non_negative=True))
            X, y = X[rows], y[rows]
        samples, loss = self._samples(X, y), read_loss(self.loss)
        with counting(read_own_bits(self.complexity)):
            front = ParetoFront([score_candidate(Float(float(np.mean(y))), samples, "the mean")])
            front = self._search(front, samples)
            if loss is not None:
                pool, samples = choose_by_loss([*front, *front.best_by_source], samples, loss)
                front = ParetoFront(pool)
            self.expr_, self.front_ = self._choose(front, samples)
        self.equations_ = _list_equations(self.front_)
        return self

    def _search(self, front: ParetoFront, samples: Samples) -> ParetoFront:
        engine = find_engine(self.engine)
        seed = check_random_state(self.random_state).randint(2**31)
        methods = [m.with_engine(engine) for m in choose_methods(self.method, self.preset).values()]
        if all(method.engine is None for method in methods):
            refuse_idle(engine, "no method here solves regressions")

        def run(method: AbstractMethod) -> ParetoFront:
            # Where most rows are met exactly, their median miss is 0 and weights overflow to 0.
            with np.errstate(over="ignore"):
                return method.search(samples, np.random.default_rng(seed))

        for method in methods:
            front = front.merge(run(method))
        whole = isinstance(self.method, str) and (self.method, self.preset) == (AUTO, "best")
        if whole and front.best_fit.loss > _EXACT * float(np.std(samples.y)):
            front = front.merge(run(make_method("dynaifeynman", "best").with_engine(engine)))
        return front

    def _samples(self, X: np.ndarray, y: np.ndarray) -> Samples:
        self.names_ = _names(self)
        return Samples(X, y, self.names_, "y", "given", np.arange(len(y), dtype=float))

    def _choose(self, front: ParetoFront, samples: Samples) -> tuple[Expr, ParetoFront]:
        if self.select == "lowest error":
            return front.best_fit.expr, front
        noise = noise_of(front, samples)
        if self.snap:
            ranked = sorted(front, key=lambda c: description_length(c, samples, noise))
            # Numbers are simple by the errors of the target, whatever a miss counts.
            plain = replace(samples, loss=None)
            level = noise if samples.loss is None else noise_of(front, plain)
            snapped = [score_snapped(c, plain, level) for c in ranked[: self.most_snapped]]
            front = front.add(*(score_candidate(tidy(c.expr), samples, c.source) for c in snapped))
        return choose(front, samples, noise).expr, front

    def predict(self, X: Any, index: int | None = None) -> np.ndarray:
        """Evaluate a formula; where it is not finite the nearest number is given.

        Parameters
        ----------
        X : (n, p) columns.
        index : the formula's row in ``equations_``; the chosen one by default.

        Gives (n,) values.
        """
        check_is_fitted(self, "expr_")
        X = validate_data(self, X, dtype=np.float64, reset=False)
        columns = {name: X[:, j] for j, name in enumerate(self.names_)}
        return np.nan_to_num(evaluate(self.sympy(index), columns))

    def sympy(self, index: int | None = None) -> Expr:
        """Give a formula as a SymPy expression.

        Parameters
        ----------
        index : its row in ``equations_``; the chosen one by default.

        Raises InputError where there is no such row.
        """
        check_is_fitted(self, "expr_")
        if index is None:
            return self.expr_
        if not -len(self.front_) <= index < len(self.front_):
            raise InputError(f"there are {len(self.front_)} formulas; index {index} is none")
        return self.front_[index].expr

    def latex(self, index: int | None = None) -> str:
        """Write a formula as LaTeX, constants to six digits.

        Parameters
        ----------
        index : its row in ``equations_``; the chosen one by default.
        """
        return to_latex_formula(self.sympy(index))

    def __sklearn_is_fitted__(self) -> bool:
        """Say whether :meth:`fit` has ended."""
        return hasattr(self, "expr_")


def _names(estimator: DynsrRegressor) -> tuple[str, ...]:
    """Names of the columns that formulas can use."""
    given = getattr(estimator, "feature_names_in_", None)
    generic = tuple(f"x{j}" for j in range(estimator.n_features_in_))
    if given is None:
        return generic
    try:
        names = tuple(check_name(str(name), "column") for name in given)
    except InputError:
        return generic
    return names if len(set(names)) == len(names) else generic


def _repeated(weights: np.ndarray) -> np.ndarray:
    """Give the numbers of the rows, each as often as its weight says.

    >>> _repeated(np.array([2.0, 0.0, 1.0])).tolist(), _repeated(np.array([0.5, 0.25])).tolist()
    ([0, 0, 2], [0, 0, 1])
    """
    rows = np.flatnonzero(weights)
    own, most = weights[rows], _COPIES * len(rows)
    for times in (own, own / own.min()):
        if np.all(np.abs(times - np.round(times)) < 1e-9) and times.sum() <= max(most, 2**16):
            return np.repeat(rows, np.round(times).astype(int))
    # Rounded along their sum, so that no error adds up.
    ends = np.round(np.cumsum(own) * (most / own.sum())).astype(int)
    return np.repeat(rows, np.diff(ends, prepend=0))


def _list_equations(front: ParetoFront) -> pd.DataFrame:
    import pandas as pd

    losses = np.array([c.loss**2 for c in front])
    bits = np.array([c.complexity for c in front])
    with np.errstate(divide="ignore", invalid="ignore"):
        drops = -np.diff(np.log(losses)) / np.diff(bits)
    return pd.DataFrame(
        {
            "complexity": bits,
            "loss": losses,
            "score": [0.0, *drops],
            "equation": [shown(c.expr) for c in front],
            "sympy_format": [c.expr for c in front],
            "source": [c.source for c in front],
        }
    )
