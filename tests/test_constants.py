"""Claims about constants fitted to samples."""

import numpy as np
import pytest
from scipy.optimize import curve_fit, minimize_scalar
from scipy.stats import cauchy

from dynsr.data.samples import Samples
from dynsr.expression.parsing import parse
from dynsr.fit.constants import Template, refit
from dynsr.fit.linear import cauchy_bits, cauchy_scale


def _samples_of(x: np.ndarray, y: np.ndarray) -> Samples:
    return Samples(x[:, None], y, ("x",), "x", "given", np.arange(len(x), dtype=float))


def _fitted(text: str, samples: Samples, unit: float | None = None) -> np.ndarray:
    template = Template.of(parse(text), samples)
    return template.fit(template.values, unit=unit)


def test_fitted_constants_are_those_of_curve_fit():
    """Without a scale the values and their covariance are those of SciPy's curve_fit."""
    rng = np.random.default_rng(1)
    x = np.linspace(0.1, 4.0, 120)
    y = 2.3 * np.exp(-0.7 * x) + 0.4 + rng.normal(0, 0.01, len(x))
    template = Template.of(parse("2.0*exp(-1.0*x) + 0.5"), _samples_of(x, y))
    got = template.fit(template.values)
    want, covariance = curve_fit(lambda x, a, b, c: a + b * np.exp(c * x), x, y, p0=template.values)
    assert got == pytest.approx(want, rel=1e-6)
    # curve_fit divides by n - k, the template by n.
    assert template.covariance(got) == pytest.approx(covariance * (120 - 3) / 120, rel=1e-4)


def test_a_cauchy_scale_withstands_large_errors():
    """With a tenth of the samples far off, the Cauchy fit finds the slope and least squares not."""
    rng = np.random.default_rng(2)
    x = np.linspace(1.0, 2.0, 300)
    y = 3 * x + rng.normal(0, 1e-3, len(x))
    y[::10] += 1.0
    samples = _samples_of(x, y)
    assert _fitted("2.5*x", samples, 1e-3)[0] == pytest.approx(3, abs=1e-3)
    assert abs(_fitted("2.5*x", samples)[0] - 3) > 0.05


def test_a_formula_without_floats_is_left_as_it_is():
    """Integers and rationals are part of the shape."""
    x = np.linspace(1.0, 2.0, 10)
    samples = _samples_of(x, 2 * x)
    assert refit(parse("3*x/2"), samples, 1e-3) == refit(parse("3*x/2"), samples) == parse("3*x/2")


def test_a_formula_outside_its_domain_does_not_end_the_fit():
    """Where the start has no finite value at some samples, the fit still comes to the right one."""
    x = np.linspace(-1.0, 2.0, 50)
    got = _fitted("1.5*log(x + 0.5)", _samples_of(x, np.log(x + 1.2)))
    assert np.all(np.isfinite(got))


def test_undetermined_parameters_have_infinite_variance():
    """A parameter that no sample depends on has no finite variance."""
    template = Template.of(parse("2.5*x"), _samples_of(np.zeros(10), np.ones(10)))
    assert np.all(np.isinf(template.covariance(template.values)))


def test_the_scale_of_the_loss_comes_down_by_steps():
    """From a start far off, with errors a millionth of it, the robust fit still gets there."""
    rng = np.random.default_rng(6)
    x = np.linspace(0.0, 3.0, 400)
    y = 3 * np.exp(-0.5 * x) + rng.normal(0, 1e-6, len(x))
    y[::7] += 0.3
    got = _fitted("1.0*exp(-2.0*x)", _samples_of(x, y), 1e-6)
    assert sorted(got) == pytest.approx([-0.5, 3.0], abs=1e-5)


def test_parameters_that_are_not_free_stay():
    """Only the free parameters are fitted, and only they have a covariance."""
    x = np.linspace(1.0, 2.0, 60)
    template = Template.of(parse("2.5*x + 1.25"), _samples_of(x, 3 * x + 1))
    free = template.values == 2.5
    got = template.fit(template.values, free)
    assert got[~free] == 1.25
    assert template.covariance(got, free).shape == (1, 1)


def test_the_scale_and_the_bits_of_uneven_errors_are_those_of_a_cauchy_law():
    """SciPy's density has its maximum at it and gives the bits; the scale has a lower limit."""
    values = np.random.default_rng(4).standard_cauchy(300) * 0.02
    expected = minimize_scalar(lambda log: -np.sum(cauchy.logpdf(values, scale=np.exp(log))))
    found = cauchy_scale(values, 0.0)
    assert np.log(found) == pytest.approx(expected.x, abs=1e-5)
    said = -np.mean(cauchy.logpdf(values, scale=found)) / np.log(2)
    assert cauchy_bits(values, found) == pytest.approx(said, rel=1e-12)
    assert cauchy_scale(values, 0.5) == 0.5


def test_uneven_errors_far_above_the_unit_do_not_move_constants():
    """Most errors are small, some are a hundred times as large; the unit is below all of them."""
    rng = np.random.default_rng(2)
    x = np.linspace(0.1, 3.0, 200)
    error = 1e-3 * rng.normal(size=200) * np.where(rng.random(200) < 0.2, 100.0, 1.0)
    samples = _samples_of(x, 1.5 * x - 0.8 * x**2 + error)
    robust = _fitted("1.3*x - 0.7*x^2", samples, unit=1e-7)
    plain = _fitted("1.3*x - 0.7*x^2", samples)
    missed = [np.max(np.abs(np.sort(own) - [-0.8, 1.5])) for own in (robust, plain)]
    assert missed[0] < 1e-3
    assert missed[0] < missed[1] / 5
