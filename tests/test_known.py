import numpy as np
import pytest

from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.methods.base import Progress
from dynsr.methods.feynman.rational import RationalSearch
from dynsr.methods.known import WithKnown
from dynsr.samples import Samples

_SMALL = RationalSearch(costs=(2,), max_terms=1, denominators=False)


def _samples(y: np.ndarray, X: np.ndarray) -> Samples:
    return Samples(X, y, ("a", "b"), "a", "given", np.arange(float(len(y))))


def _points() -> np.ndarray:
    return np.random.default_rng(0).uniform(0.5, 2.0, size=(200, 2))


def test_a_known_term_lets_a_small_search_find_the_rest():
    """With one of two terms given, a search for one term finds the law; alone it cannot."""
    X = _points()
    samples = _samples(1.5 * X[:, 0] - np.exp(X[:, 1]) / X[:, 0] ** 3, X)
    rng = np.random.default_rng(0)
    front = WithKnown(_SMALL, "-exp(b)/a^3").search(samples, rng)
    assert front.best_fit.loss < 1e-12
    assert _SMALL.search(samples, rng).best_fit.loss > 0.01


def test_a_known_factor_is_divided_out_and_put_back():
    """f = factor * g + term is found with both given, scored on f."""
    X = _points()
    samples = _samples(np.log(X[:, 0]) ** 2 * (2 * X[:, 1]) + 4, X)
    front = WithKnown(_SMALL, parse("4"), "log(a)^2").search(samples, np.random.default_rng(0))
    assert front.best_fit.loss < 1e-12


def test_progress_shows_whole_formulas():
    """What is reported on the way has the known part in it."""
    X = _points()
    samples = _samples(X[:, 0] + np.sin(X[:, 1]), X)
    seen: list[Progress] = []
    WithKnown(_SMALL, "sin(b)").search(samples, np.random.default_rng(0), seen.append)
    assert seen and all(c.expr.has(parse("sin(b)")) for p in seen for c in p.front)


@pytest.mark.parametrize(
    ("term", "factor", "says"),
    [
        ("c*a", "1", "'c'"),
        ("log(a - 5)", "1", "finite"),
        ("a +", "1", "cannot read"),
        ("0", "0", "factor 0"),
        ("0", "a - a", "factor"),
    ],
)
def test_a_known_part_that_cannot_be_used_is_named(term, factor, says):
    """A misprint, an unknown name or a part without values is one clear line."""
    samples = _samples(np.arange(200.0), _points())
    with pytest.raises(InputError, match=says):
        WithKnown(_SMALL, term, factor).search(samples, np.random.default_rng(0))
