import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.expression.evaluation import compile_numpy, evaluate
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, score_candidate
from dynsr.fit.constants import refit
from dynsr.methods.feynman.stages.base import Context
from dynsr.methods.feynman.stages.inner_functions import (
    Compositionality,
    GeneralisedSymmetry,
    GeneralSeparability,
    scatter,
)
from dynsr.methods.feynman.stages.polynomial import Polynomial
from dynsr.methods.feynman.stages.reduction import AbstractReducer, Reduce, Support
from dynsr.methods.feynman.stages.separability import Separability
from dynsr.methods.feynman.stages.symmetry import Symmetry
from dynsr.methods.rational import RationalSearch

ALL = (Symmetry(), Separability(), Compositionality(), GeneralSeparability(), GeneralisedSymmetry())


class Truth:
    """A surrogate as good as a network of relative error 1e-3 would be, made from the law."""

    def __init__(self, law: str, names: tuple[str, ...], spread: float):
        """Make it from the law; ``spread`` is the size of y."""
        expr = parse(law)
        slopes = [expr.diff(parse(name)) for name in names]
        self._value, self._slopes = compile_numpy([expr], names), compile_numpy(slopes, names)
        self.validation_error = 1e-3 * spread
        self._rng = np.random.default_rng(8)

    def predict(self, X: np.ndarray) -> np.ndarray:
        """(n,) values with a ripple."""
        values = self._value(X.T)[0]
        return values + 0.3 * self.validation_error * np.sin(40 * X.sum(axis=1))

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """(n, p) slopes with noise of one percent."""
        slopes = self._slopes(X.T).T
        return slopes * (1 + 0.01 * self._rng.normal(size=slopes.shape))


def _samples(law: str, low: float = 0.5, high: float = 2.0) -> Samples:
    names = tuple(sorted(str(s) for s in parse(law).free_symbols))
    X = np.random.default_rng(0).uniform(low, high, size=(800, len(names)))
    y = evaluate(parse(law), dict(zip(names, X.T, strict=True)))
    return Samples(X, y, names, "a", "given", np.arange(800.0))


def _base(samples: Samples, context: Context) -> list[Candidate]:
    """Sums of at most three features, and quadratic polynomials."""
    found = Polynomial(degree=2, sparse=False).run(samples, context)
    sums = RationalSearch(costs=(3,), rounds=1, max_terms=3, denominators=False)
    return found + [c for group in sums.find(samples) for c in group]


def _loss(law: str, *reducers: AbstractReducer) -> float:
    samples = _samples(law)
    surrogate = Truth(law, samples.names, float(np.std(samples.y)))
    context = Context(
        np.random.default_rng(0), solve=_base, surrogate=lambda samples, context: surrogate
    )
    found = _base(samples, context) + Reduce(reducers).run(samples, context)
    best = sorted(found, key=lambda c: c.loss)[:3]
    refined = [score_candidate(refit(c.expr, samples), samples) for c in best]
    return min(c.loss for c in refined) / float(np.std(samples.y))


PLANTED = {
    "translational": ("c + exp(a - b)", Symmetry(scaling=False)),
    "sum": ("c + log(a + b)", Symmetry(scaling=False)),
    "scaling": ("c + sin(a/b)", Symmetry(translation=False)),
    "product": ("c + cos(a*b)", Symmetry(translation=False)),
    "additive": ("sin(a) + exp(a) + cos(b) - log(b)", Separability(multiplicative=False)),
    "multiplicative": ("(sin(a) + exp(a))*(cos(b) - log(b))", Separability(additive=False)),
    "compositionality": ("log(a*b + 0.7*c)", Compositionality()),
    "general separability": ("sin(a^3 + b^2*log(b))", GeneralSeparability()),
    "generalised symmetry": ("c + sin(a^2 + 0.5*a*b)", GeneralisedSymmetry()),
}


@pytest.mark.parametrize("kind", PLANTED)
@pytest.mark.slow
def test_a_planted_law_is_found_by_its_own_reduction_alone(kind):
    """With its reducer the law comes out; with no reducer the same stages miss it."""
    law, reducer = PLANTED[kind]
    assert _loss(law, reducer) < 1e-5
    assert _loss(law) > 1e-3


@pytest.mark.parametrize("kind", PLANTED)
@pytest.mark.slow
def test_a_reducer_that_is_switched_off_finds_nothing(kind):
    """Without the planted property there is nothing to find: a law with none is left alone."""
    samples = _samples("sin(a*b + c*a^2) + exp(b*c)/(a + b*c^2)")
    law = "sin(a*b + c*a^2) + exp(b*c)/(a + b*c^2)"
    surrogate = Truth(law, samples.names, float(np.std(samples.y)))
    assert PLANTED[kind][1].find(samples, surrogate, Support(samples.X)) == []


def test_a_thin_curve_supports_no_reduction():
    """On one trajectory nothing is known beside the curve, so no property is accepted."""
    t = np.linspace(0, 10, 800)
    law = "sin(2*(a - b)) + c"
    X = np.column_stack([np.sin(t), np.cos(t), np.sin(0.5 * t)])
    y = evaluate(parse(law), dict(zip("abc", X.T, strict=True)))
    samples = Samples(X, y, ("a", "b", "c"), "a", "given", t)
    assert not Support(X).fills_space
    surrogate = Truth(law, samples.names, float(np.std(y)))
    assert [r.kind for reducer in ALL for r in reducer.find(samples, surrogate, Support(X))] == []


def test_scatter_measures_noise_about_a_curve():
    """The scatter of a noisy curve is the noise's standard deviation."""
    rng = np.random.default_rng(5)
    u = rng.uniform(0, 3, 4000)
    assert scatter(u, np.sin(u) + 0.02 * rng.normal(size=4000)) == pytest.approx(0.02, rel=0.1)
