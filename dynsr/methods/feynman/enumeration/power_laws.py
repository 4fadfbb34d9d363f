"""Power laws inside one function.

Nested: y = v T^-1(C x_1^a_1 ... x_p^a_p), v one variable or 1. Of one combination:
y = C x_1^a_1 ... x_p^a_p f(z) with z = x_1^b_1 ... x_p^b_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy
from scipy.optimize import least_squares

from dynsr.fit import fit_robustly
from dynsr.methods.feynman.enumeration.alphabet import make_letters
from dynsr.methods.feynman.enumeration.backend import Backend
from dynsr.methods.feynman.enumeration.finishing import (
    Finisher,
    Finishing,
    Found,
    Writer,
    as_power,
    measure,
    signs_of,
    snap_all,
    write_power,
)
from dynsr.methods.feynman.enumeration.formation import Enumerator
from dynsr.methods.feynman.enumeration.screening import Screen
from dynsr.methods.feynman.enumeration.sums import best_pairs, make_gram
from dynsr.methods.feynman.problem import (
    CHANGES,
    Problem,
    Target,
    has_logarithm,
    make_problems,
    make_targets,
)


@dataclass(frozen=True)
class Combinations:
    """The search for laws C x_1^a_1 ... x_p^a_p f(z) of one product z of powers.

    Parameters
    ----------
    degree : of the polynomial that stands for log f while z is looked for.
    unexplained : share of log |y| (of its standard deviation) that a law may leave unexplained.
    max_size : most letters of f.
    max_candidates : functions formed at most for f.
    max_memory : megabytes for them.
    probes : rows on which they are distinguished and screened.
    keep : functions of each level that are fitted on all rows.
    paired : simplest functions of which all pairs are tried as sums.
    paired_rows : rows on which the pairs are compared.
    """

    degree: int = 7
    unexplained: float = 0.02
    max_size: int = 7
    max_candidates: float = 300_000
    max_memory: int = 128
    probes: int = 48
    keep: int = 16
    paired: int = 250
    paired_rows: int = 400


def find_nested(
    X: np.ndarray,
    y: np.ndarray,
    symbols: Sequence[sympy.Expr],
    finishing: Finishing | None = None,
) -> list[Found]:
    """Give the best formula for every change and variable.

    Parameters
    ----------
    X : (n, p) values of the variables.
    y : (n,) target.
    symbols : the p variables.
    finishing : how formulas are priced and snapped.

    >>> X = np.random.default_rng(0).uniform(1.0, 2.0, (50, 3))
    >>> y = X[:, 0] * np.exp(-X[:, 1] / X[:, 2])
    >>> best = min(find_nested(X, y, sympy.symbols("a b c")), key=lambda f: f.loss)
    >>> bool(best.loss < 1e-12)
    True
    """
    usable = [j for j in range(X.shape[1]) if has_logarithm(X[:, j])]
    targets = make_targets(y, tuple(CHANGES))[1:]
    for j in usable:
        targets += make_targets(y, tuple(CHANGES), X[:, j], symbols[j])[1:]
    settings = finishing or Finishing()
    return [found for target in targets for found in _fit(target, X, y, symbols, usable, settings)]


def _fit(
    target: Target,
    X: np.ndarray,
    y: np.ndarray,
    symbols: Sequence[sympy.Expr],
    usable: Sequence[int],
    settings: Finishing,
) -> list[Found]:
    size = np.abs(target.values)
    if size.min() <= 1e-9 * size.max() or not usable:
        return []
    logs = np.log(np.abs(X[:, usable]))
    design = np.column_stack([np.ones(len(y)), logs])[None]
    fitted = fit_robustly(design, np.log(size), size * target.weights)[:, 1:]
    powers = snap_all(fitted, len(usable), settings.snap)
    law = np.exp(logs @ powers[0])
    for j, power in zip(usable, powers[0], strict=True):
        law = law * signs_of(X[:, j], np.array([power]))[0]
    factor = fit_robustly(law[None, :, None], target.values, target.weights)[0, 0]

    def write(k: int) -> tuple[float, Writer]:
        numbers = [as_power(power) for power in powers[0]]
        factors = [
            write_power(symbols[j], X[:, j], n) for j, n in zip(usable, numbers, strict=True)
        ]
        letters = 8.0 + 3 * sum(n != 0 for n in numbers) + 4 * sum(n.is_Float for n in numbers)
        return letters, lambda: target.build(sympy.Mul(sympy.Float(factor), *factors))

    return measure(target.invert(factor * law)[None], y, write, settings.each)


def find_exponents(
    X: np.ndarray,
    y: np.ndarray,
    search: Combinations | None = None,
    finishing: Finishing | None = None,
) -> np.ndarray | None:
    """Give the (p,) exponents of z, the first above 0, the largest +-1; None if there is none.

    With l = log x a law is log |y| = a . l + g(b . l). The cross terms of a quadratic fit are
    nearly proportional to b_i b_j; from there b is fitted with a polynomial for g.

    >>> X = np.random.default_rng(0).uniform(1.0, 3.0, (500, 3))
    >>> find_exponents(X, X[:, 2] * np.tanh(X[:, 0] / X[:, 1])).tolist()
    [1.0, -1.0, 0.0]
    """
    search, finishing = search or Combinations(), finishing or Finishing()
    size = np.abs(y)
    usable = [j for j in range(X.shape[1]) if has_logarithm(X[:, j])]
    if len(usable) < 2 or size.min() <= 1e-9 * size.max():
        return None
    logs = np.log(np.abs(X[:, usable]))
    logs, target = logs - logs.mean(axis=0), np.log(size)
    target = target - target.mean()
    linear = np.column_stack([np.ones(len(y)), logs])

    def rest(direction: np.ndarray) -> np.ndarray:
        along = logs @ (direction / np.linalg.norm(direction))
        along = along / np.abs(along).max()
        columns = np.column_stack([linear, _legendre(along, search.degree)])
        return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]

    fitted = least_squares(rest, _most_curved(logs, target), max_nfev=40).x
    left = rest(fitted)
    if not left @ left < search.unexplained**2 * (target @ target):
        return None
    fitted = fitted / fitted[np.argmax(np.abs(fitted))]
    simple = snap_all(fitted[None], len(fitted), finishing.snap)[0]
    simple = simple * np.sign(simple[simple != 0][0]) + 0.0
    if not all(as_power(b).is_Rational for b in simple):
        return None
    exponents = np.zeros(X.shape[1])
    exponents[usable] = simple
    return exponents


def _most_curved(logs: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(p,) direction in which a quadratic fit curves most."""
    first, second = np.triu_indices(logs.shape[1])
    design = np.column_stack([np.ones(len(logs)), logs, logs[:, first] * logs[:, second]])
    curved = np.linalg.lstsq(design, target, rcond=None)[0][1 + logs.shape[1] :]
    matrix = np.zeros((logs.shape[1],) * 2)
    matrix[first, second] += curved / 2
    matrix[second, first] += curved / 2
    values, vectors = np.linalg.eigh(matrix)
    return vectors[:, np.argmax(np.abs(values))]


def _legendre(along: np.ndarray, degree: int) -> np.ndarray:
    return np.polynomial.legendre.legvander(along, degree)[:, 2:]


class CombinationSearch:
    """Searches f once z is known; ``found`` has the formulas."""

    def __init__(
        self,
        X: np.ndarray,
        y: np.ndarray,
        symbols: Sequence[sympy.Expr],
        exponents: np.ndarray,
        operators: Sequence[str],
        backend: Backend,
        settings: Combinations,
        finishing: Finishing,
    ) -> None:
        """Take all rows, the variables and the exponents of z."""
        self.y, self.settings = y, settings
        self.found: list[Found] = []
        factors = [as_power(b) for b in exponents]
        column = np.exp(np.log(np.abs(X)) @ exponents)
        name = sympy.Mul(*map(write_power, symbols, X.T, factors))
        self.Z = np.column_stack([column, 1 / column])
        self.problems = [q for q in make_problems(X, y, (), True) if q.powers]
        self.probes = np.unique(
            np.linspace(0, len(y) - 1, min(len(y), settings.probes)).astype(int)
        )
        letters, nested = make_letters((*operators, *_more(operators)), False)
        self.screen = Screen(self.problems, self.probes, backend)
        self.enumerator = Enumerator(
            self.Z[self.probes],
            [name, 1 / name, sympy.S.One],
            letters,
            nested,
            backend,
            settings.max_memory << 20,
            int(settings.max_candidates),
        )
        self.finisher = Finisher(self.enumerator.bank, self.Z, y, finishing, (X, symbols))

    def run(self, deadline: float, exact: float) -> list[Found]:
        """Search until a formula's RMSE is at most ``exact``, all is tried, or the deadline."""
        bank, settings = self.enumerator.bank, self.settings
        for size in range(1, settings.max_size + 1):
            last = size == settings.max_size
            best = self.enumerator.form(
                size, self.screen, settings.keep, settings.max_candidates, deadline, last
            )
            for place, problem in enumerate(self.problems):
                numbers = [(bank.number(*winner),) for winner in best.winners(place)]
                self.found += self.finisher.finish(problem, numbers)
            if self._ended(exact):
                return self.found
        for problem in self.problems:
            self._pair(problem)
        return self.found

    def _ended(self, exact: float) -> bool:
        done = any(found.loss <= exact for found in self.found)
        return done or bool(self.enumerator.stopped)

    def _pair(self, problem: Problem) -> None:
        levels = self.enumerator.bank.levels
        fresh = [level.start + np.flatnonzero(level.fresh) for level in levels]
        numbers = np.concatenate(fresh)[: self.settings.paired]
        rows = np.unique(
            np.linspace(0, len(self.y) - 1, min(len(self.y), self.settings.paired_rows)).astype(int)
        )
        values = self.enumerator.bank.evaluate_all(self.Z[rows], len(levels))[numbers]
        gram = make_gram(values, problem, rows, np.ones(len(rows)))
        pairs = [
            (int(numbers[i]), int(numbers[j])) for i, j in best_pairs(gram, self.settings.keep)
        ]
        self.found += self.finisher.finish(problem, pairs)


def _more(operators: Sequence[str]) -> list[str]:
    """Letters that one variable can afford with the others."""
    return [token for token in ("tanh",) if token not in operators and "exp" in operators]
