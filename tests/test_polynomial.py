import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.fit.linear import eliminate
from dynsr.methods.feynman.stages.base import Context
from dynsr.methods.feynman.stages.polynomial import Polynomial, fit_full, monomial_exponents


def _samples(X: np.ndarray, y: np.ndarray) -> Samples:
    names = tuple(f"x{j}" for j in range(X.shape[1]))
    return Samples(X, y, names, "x0", "given", np.arange(float(len(y))))


def _planted(noise: float = 0.0) -> Samples:
    rng = np.random.default_rng(1)
    X = rng.uniform(-2, 3, size=(400, 3))
    y = 1.5 * X[:, 0] * X[:, 1] - 0.25 * X[:, 2] ** 4 + 2 * X[:, 0]
    return _samples(X, y + noise * rng.normal(size=400))


def test_monomials_are_counted_by_the_binomial_formula():
    """There are (p + d choose d) monomials of p variables up to degree d, all different."""
    found = monomial_exponents(3, 4)
    assert len(found) == 35 == len(set(found))
    assert max(map(sum, found)) == 4


def test_a_polynomial_of_degree_four_is_exact():
    """The full fit reproduces a polynomial of its degree to rounding, far from zero as well."""
    samples = _planted()
    assert fit_full(samples, 4).loss < 1e-11
    far = _samples(samples.X + 1000.0, samples.y)
    assert fit_full(far, 4).loss < 1e-7


@pytest.mark.slow
def test_the_sparse_fit_has_the_terms_of_the_law_alone():
    """Backward elimination passes through the three terms that made the data, with noise."""
    samples = _planted(noise=0.05)
    found = Polynomial().run(samples, Context(np.random.default_rng(0)))
    _x0, _x1, _x2 = (c for c in samples.X.T)
    law = {"x0*x1", "x2**4", "x0"}
    three = [c for c in found if {str(t.as_coeff_Mul()[1]) for t in c.expr.args} == law]
    assert three and min(c.loss for c in three) < 0.06


def test_a_robust_elimination_is_not_steered_by_bad_rows():
    """With a twentieth of the rows wrong by 100 the robust weights stay within 1e-3."""
    samples = _planted(noise=1e-3)
    y = samples.y.copy()
    y[::20] += 100.0
    values = np.column_stack([samples.X[:, 0] * samples.X[:, 1], samples.X[:, 2] ** 4])
    values = np.column_stack([values, samples.X[:, 0]])
    (kept, weights) = next(iter(eliminate(values, y, robust=True)))
    assert kept == (0, 1, 2)
    np.testing.assert_allclose(weights, [1.5, -0.25, 2.0], atol=1e-3)
    (_, plain) = next(iter(eliminate(values, y, robust=False)))
    assert np.abs(plain - [1.5, -0.25, 2.0]).max() > 0.1


@pytest.mark.parametrize("rows", [3, 12])
def test_few_rows_bound_the_degree(rows):
    """A degree with more terms than half the rows is left out rather than interpolated."""
    rng = np.random.default_rng(2)
    samples = _samples(rng.normal(size=(rows, 2)), rng.normal(size=rows))
    found = Polynomial(sparse=False).run(samples, Context(rng))
    assert 1 <= len(found) <= (1 if rows == 3 else 3)


def test_a_polynomial_that_only_follows_the_samples_is_left_out():
    """On a curve in five variables degree 4 fits well and fails ahead; it is not given in full."""
    t = np.linspace(0, 10, 800)
    X = np.column_stack([np.sin(t), np.cos(2 * t), 0.2 * t, np.sin(3 * t + 0.1 * t**2), 0.1 * t**2])
    samples = _samples(X, np.exp(X[:, 0]) * np.cos(2 * X[:, 3]))
    found = Polynomial(sparse=False).run(samples, Context(np.random.default_rng(0)))
    assert fit_full(samples, 4).loss < 0.1 * min(c.loss for c in found)
    assert "polynomial: degree 4" not in {c.source for c in found}
