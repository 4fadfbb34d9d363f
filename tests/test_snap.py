"""Claims about constants snapped to simple numbers."""

import numpy as np
import pytest
import sympy

from dynsr.expression import parse
from dynsr.methods.feynman.description import Noise
from dynsr.methods.feynman.snap import polish, simple_numbers, skeleton, snap, tidy
from dynsr.pareto import score_candidate
from dynsr.samples import Samples


def _pendulum_samples(noise: np.ndarray) -> Samples:
    t = np.linspace(0.0, 10.0, len(noise))
    angle, speed = np.sin(2.5 * t) * np.exp(-0.05 * t), 2.5 * np.cos(2.5 * t)
    y = -9.81 * np.sin(angle) - 0.1 * speed + noise
    return Samples(np.column_stack([angle, speed]), y, ("a", "v"), "v", "given", t)


def _heavy_tailed(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Errors as those of an adaptive solver: small, but for a few stretches."""
    return 2e-3 * rng.standard_t(1.5, rows)


def test_snapping_one_constant_frees_the_others():
    """Both constants come out exact though each fit alone is off in the third digit."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(3), 1000))
    got = snap(parse("-9.79*sin(a) - 0.104*v"), samples, Noise(2e-3, 300.0))
    assert got == parse("-9.81*sin(a)") - sympy.Rational(1, 10) * sympy.Symbol("v")


def test_a_term_of_no_use_is_snapped_to_zero():
    """A small extra term that follows only noise disappears."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(4), 1000))
    got = snap(parse("-9.79*sin(a) - 0.104*v + 0.002*a**3"), samples, Noise(2e-3, 300.0))
    assert not got.has(parse("a**3"))


def test_a_constant_that_is_not_simple_keeps_its_digits():
    """With exact samples pi times e is not replaced by a short number."""
    x = np.linspace(1.0, 2.0, 100)
    samples = Samples(x[:, None], np.pi * np.e * x, ("x",), "x", "given", x)
    got = snap(parse("8.5*x"), samples, Noise(1e-12, 100.0))
    assert float(got.coeff(sympy.Symbol("x"))) == pytest.approx(np.pi * np.e, rel=1e-10)


@pytest.mark.parametrize("value", [0.333337, -2.00001, 9.8099, 1e-9, 1234.6])
def test_simple_numbers_lie_near_or_are_zero(value):
    """Every simple number but zero lies within five percent, and zero is always looked at."""
    numbers = simple_numbers(value)
    assert 0 in numbers
    assert all(n == 0 or abs(float(n) - value) <= 0.05 * abs(value) for n in numbers)


def test_polish_puts_the_true_shape_first():
    """Among a polynomial, a needlessly long and the true shape, the true one leads, exact."""
    samples = _pendulum_samples(_heavy_tailed(np.random.default_rng(5), 1000))
    shapes = ("-9.6*a - 0.1*v + 1.4*a**3", "-9.7*sin(a) - 0.11*v", "-9.7*sin(a) - 0.1*v + 0.01*a*v")
    candidates = [score_candidate(parse(s), samples) for s in shapes]
    best = polish(candidates, samples)[0]
    assert skeleton(best.expr) == skeleton(tidy(parse("-9.81*sin(a)") - parse("v/10")))
    assert best.loss <= min(c.loss for c in candidates) * 1.01


def test_polish_of_nothing_is_nothing():
    """No candidate, no result."""
    assert polish([], _pendulum_samples(np.zeros(50))) == []
