import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.methods.feynman.stages.base import Context
from dynsr.methods.feynman.stages.domain_change import DomainChange
from dynsr.methods.feynman.stages.polynomial import Polynomial

_STAGE = DomainChange((Polynomial(degree=2, sparse=True),))


def _samples(law: str) -> Samples:
    X = np.random.default_rng(0).uniform(0.5, 2.0, size=(300, 2))
    y = evaluate(parse(law), {"a": X[:, 0], "b": X[:, 1]})
    return Samples(X, y, ("a", "b"), "a", "given", np.arange(300.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        "exp(a*b + b)",
        "1/(a*b + 2)",
        "sqrt(a^2 + b^2)",
        "log(a*b + 1)",
        "(a + 2*b^2)^2",
        "-exp(a*b)",
    ],
)
def test_a_polynomial_behind_an_outer_function_is_found(law):
    """A polynomial of a changed target gives the law exactly; polynomials of y itself do not."""
    samples = _samples(law)
    context = Context(np.random.default_rng(0))
    assert min(c.loss for c in _STAGE.run(samples, context)) < 1e-9
    assert min(c.loss for c in Polynomial(degree=2).run(samples, context)) > 1e-4


def test_losses_are_those_of_y_itself():
    """A formula's loss is its RMSE on y, not on the changed target."""
    samples = _samples("exp(a*b + b)")
    for candidate in _STAGE.run(samples, Context(np.random.default_rng(0))):
        predicted = evaluate(candidate.expr, samples.columns)
        expected = np.sqrt(np.mean((predicted - samples.y) ** 2))
        assert candidate.loss == pytest.approx(expected, rel=1e-12) or not np.isfinite(expected)
