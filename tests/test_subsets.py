import itertools

import numpy as np
from scipy.optimize import least_squares

from dynsr.fit.linear import fit_ratio
from dynsr.methods.rational import SubsetSearch


def _problem(seed: int, denominators: int = 0) -> SubsetSearch:
    rng = np.random.default_rng(seed)
    numerators = rng.normal(size=(9, 120))
    y = 2 * numerators[1] - numerators[4] + 0.5 * numerators[7] + 0.3 * rng.normal(size=120)
    below = rng.uniform(0, 1, size=(denominators, 120))
    return SubsetSearch(numerators, below, y, np.ones(120), width=30)


def test_best_subsets_are_those_of_exhaustive_search():
    """For sums, the best subset of each size is the one that trying all of them finds."""
    for seed in range(5):
        problem = _problem(seed)
        for size, found in enumerate(problem.search(4), start=1):

            def error(columns: tuple[int, ...], problem: SubsetSearch = problem) -> float:
                a = problem.numerators[list(columns)].T
                return float(np.linalg.lstsq(a, problem.y, rcond=None)[1][0])

            assert tuple(sorted(found[0])) == min(itertools.combinations(range(9), size), key=error)


def test_extension_scores_are_those_of_least_squares():
    """Every score of extend() is the squared error of the full fit over the mean of D squared."""
    problem = _problem(3, denominators=3)
    scores = problem.extend([frozenset({1, 10}), frozenset({2, 3})])[0]
    columns = np.vstack([problem.numerators, problem.denominators * problem.y])
    for added in (0, 4, 9, 11):
        chosen = [1, 10, added]
        b = np.linalg.lstsq(columns[chosen].T, problem.y, rcond=None)[0]
        error = np.sum((problem.y - b @ columns[chosen]) ** 2)
        below = [(c - 9, v) for c, v in zip(chosen, b, strict=True) if c >= 9]
        d = 1 - sum(v * problem.denominators[j] for j, v in below)
        np.testing.assert_allclose(scores[added], error / np.mean(d**2), rtol=1e-9)


def test_ratio_fit_agrees_with_nonlinear_least_squares():
    """The repeated linear fit ends at the least-squares ratio of an exact relation."""
    x = np.linspace(0.1, 3, 100)
    y = (2 * x - 0.5) / (1 + 0.7 * x**2)
    fit = fit_ratio(np.array([np.ones(100), x]), np.array([x**2]), y)
    solution = least_squares(
        lambda p: (p[0] + p[1] * x) / (1 + p[2] * x**2) - y, [0.0, 1.0, 0.0], xtol=1e-15
    ).x
    np.testing.assert_allclose([*fit.numerator, *fit.denominator], solution, rtol=1e-7)
    assert np.abs(fit.residual).max() < 1e-13


def test_a_vanishing_denominator_does_not_win():
    """y (1 - d) = 0 with d nearly 1 fits trivially; the score counts the error of N / D instead."""
    rng = np.random.default_rng(4)
    x = rng.uniform(-0.3, 0.3, 300)
    y = np.sin(7 * x) + rng.normal(size=300)
    nearly_one = np.cos(x)[None]
    problem = SubsetSearch(np.array([np.sin(7 * x)]), nearly_one, y, np.ones(300))
    scores = problem.extend([frozenset()])[0]
    assert scores[0] < scores[1]
