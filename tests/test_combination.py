import numpy as np
import pytest

from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, search_values
from dynsr.methods.feynman.enumeration.power_laws import find_exponents


def planted(formula: str, names: str, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rows of one-letter variables from (1, 3), and the formula's values."""
    X = np.random.default_rng(seed).uniform(1.0, 3.0, (600, len(names)))
    return X, evaluate(parse(formula, list(names)), dict(zip(names, X.T, strict=True)))


@pytest.mark.parametrize(
    ("formula", "exponents"),
    [
        ("a/(exp(b*c/(d*e))-1)", [0, 1, 1, -1, -1]),
        ("a*b/sqrt(1+c^2/d)", [0, 0, 1, -0.5]),
        ("c*log(1+a*b)", [1, 1, 0]),
    ],
)
def test_the_combination_is_found(formula, exponents):
    """The exponents of the one product inside come out, up to their common factor."""
    X, y = planted(formula, "abcde"[: len(exponents)])
    found = find_exponents(X, y)
    scale = found @ found / (found @ exponents)
    assert np.allclose(found, scale * np.array(exponents))


def test_other_laws_have_none():
    """A function of two separate combinations is refused."""
    X, y = planted("a*b + sin(c)*b^2", "abc")
    assert find_exponents(X, y) is None


@pytest.mark.parametrize("formula", ["a*b^3/(c^2*(exp(b/(d*e))-1))", "a*b*tanh(b*c/(d*e))"])
def test_a_law_of_one_combination_is_found_exactly(formula):
    """Laws too long to be enumerated come out to rounding, at points outside the samples too."""
    X, y = planted(formula, "abcde")
    settings = BruteForce(max_size=1, sums=(), beam=0, combinations=True, device="cpu")
    result = search_values(X, y, tuple("abcde"), settings)
    fresh, truth = planted(formula, "abcde", seed=1)
    best = min(result.candidates, key=lambda c: c.loss)
    values = evaluate(best.expr, dict(zip("abcde", fresh.T, strict=True)))
    assert np.allclose(values, truth, rtol=1e-9)
    alone = BruteForce(max_size=1, sums=(), beam=0, device="cpu")
    others = search_values(X, y, tuple("abcde"), alone).candidates
    assert min(c.loss for c in others) > 1e-6
