from dataclasses import replace

import numpy as np
import sympy

from dynsr.data.samples import Samples
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import score_candidate
from dynsr.methods.feynman.stages.base import Context
from dynsr.methods.feynman.stages.refinement import Refinement


def _samples(law: str) -> Samples:
    x = np.linspace(0.2, 3.0, 200)
    y = evaluate(parse(law), {"x": x})
    return Samples(x[:, None], y, ("x",), "x", "given", x)


def test_rough_constants_become_those_of_the_law():
    """A formula of the right shape with constants 10 % off is exact after the refit."""
    samples = _samples("2.37*exp(-0.71*x) + 0.113")
    rough = score_candidate(parse("2.6*exp(-0.64*x) + 0.1"), samples)
    found = Refinement(False).run(samples, Context(np.random.default_rng(0), found=(rough,)))
    assert min(c.loss for c in found) < 1e-12


def test_snapping_alone_gives_simple_numbers():
    """On noisy slopes the constants snap to those of the law; a plain refit stays beside them."""
    clean = _samples("3*x - 9.81*sin(x)")
    samples = replace(clean, y=clean.y + 0.001 * np.cos(40 * clean.X[:, 0]))
    rough = (score_candidate(parse("2.98*x - 9.8*sin(x)"), samples),)
    context = Context(np.random.default_rng(0))

    def numbers(snapping: bool) -> list[set[float]]:
        found = Refinement(snapping).run(samples, replace(context, found=rough))
        return [{abs(float(a)) for a in c.expr.atoms(sympy.Number)} for c in found]

    assert {3.0, 9.81} in numbers(True)
    assert {3.0, 9.81} not in numbers(False)


def test_long_formulas_are_left_as_they_are():
    """A formula with more constants than the bound is not refitted."""
    samples = _samples("sin(x)")
    long = score_candidate(parse("0.1*x + 0.2*x^2 + 0.3*x^3"), samples)
    stage = Refinement(most_constants=2)
    assert stage.run(samples, Context(np.random.default_rng(0), found=(long,))) == []
