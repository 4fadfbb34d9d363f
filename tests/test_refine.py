"""Claims about constants fitted to samples."""

import numpy as np
import pytest
import sympy
from scipy.optimize import curve_fit

from dynsr.expression import parse
from dynsr.methods.feynman.refine import Template, fixed, refine
from dynsr.samples import Samples


def _samples_of(x: np.ndarray, y: np.ndarray) -> Samples:
    return Samples(x[:, None], y, ("x",), "x", "given", np.arange(len(x), dtype=float))


def test_refined_constants_are_those_of_curve_fit():
    """Without a scale the values and their covariance are those of SciPy's curve_fit."""
    rng = np.random.default_rng(1)
    x = np.linspace(0.1, 4.0, 120)
    y = 2.3 * np.exp(-0.7 * x) + 0.4 + rng.normal(0, 0.01, len(x))
    got = refine(parse("2.0*exp(-1.0*x) + 0.5"), _samples_of(x, y))
    want, covariance = curve_fit(
        lambda x, a, b, c: b + c * np.exp(a * x), x, y, p0=[-1.0, 0.5, 2.0]
    )
    assert got.values == pytest.approx(want, rel=1e-6)
    # curve_fit divides by n - k, refine by n.
    assert got.covariance == pytest.approx(covariance * (120 - 3) / 120, rel=1e-4)


def test_a_cauchy_scale_withstands_large_errors():
    """With a tenth of the samples far off, the Cauchy fit finds the slope and least squares not."""
    rng = np.random.default_rng(2)
    x = np.linspace(1.0, 2.0, 300)
    y = 3 * x + rng.normal(0, 1e-3, len(x))
    y[::10] += 1.0
    samples = _samples_of(x, y)
    assert refine(parse("2.5*x"), samples, 1e-3).values[0] == pytest.approx(3, abs=1e-3)
    assert abs(refine(parse("2.5*x"), samples).values[0] - 3) > 0.05


def test_a_formula_without_floats_is_left_as_it_is():
    """Integers and rationals are part of the shape."""
    x = np.linspace(1.0, 2.0, 10)
    got = refine(parse("3*x/2"), _samples_of(x, 2 * x))
    assert got.expr == parse("3*x/2")
    assert got.residual == pytest.approx(0.5 * x)


def test_a_formula_outside_its_domain_does_not_end_the_fit():
    """Where the start has no finite value at some samples, the fit still gives finite numbers."""
    x = np.linspace(-1.0, 2.0, 50)
    got = refine(parse("1.5*log(x + 0.5)"), _samples_of(x, np.log(x + 1.2)))
    assert np.all(np.isfinite(got.values))


def test_undetermined_parameters_have_infinite_variance():
    """A parameter that no sample depends on has no finite variance."""
    x = np.zeros(10)
    got = refine(parse("2.5*x"), _samples_of(x, np.ones(10)))
    assert np.all(np.isinf(got.covariance))


def test_fixed_parameters_leave_the_template():
    """Fixing a factor to zero also drops the parameters that stood only beside it."""
    template = Template.of(parse("2.5*x*(x + 0.5) + 1.25"), ("x",))
    index = template.values.tolist().index(2.5)
    left = fixed(template, {index: sympy.Integer(0)}, template.values)
    assert left.values.tolist() == [1.25]
