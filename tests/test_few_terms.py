"""Sums of few terms: the law among very many sums that follow a short arc as closely."""

import numpy as np
import pytest
import sympy

from dynsr.data import Samples
from dynsr.expression import Vocabulary, evaluate, parse, skeleton
from dynsr.methods import Limits
from dynsr.selection import look

BESIDE = {"n": np.linspace(0.2, 3.0, 7), "p": np.linspace(2.0, 0.1, 7)}


def on_an_arc(law, error=0.0):
    """Slopes of a law along a short arc of two columns, each off by a share of the largest."""
    t = np.linspace(0.0, 1.0, 80)
    columns = {"n": 1.9 - 1.1 * t + 0.2 * t**2, "p": 0.6 + 0.7 * t - 0.3 * t**3}
    slopes = evaluate(parse(law), columns)
    slopes = slopes + error * np.max(np.abs(slopes)) * np.random.default_rng(0).normal(size=80)
    return Samples(np.column_stack(list(columns.values())), slopes, ("n", "p"), "n", "given", t)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        "0.374*n^2 - 0.097*n^3 - 0.119*n - 1.1*n*p/(n + 2.0)",
        "0.9*n - 0.4*n*p*exp(-0.8*n)",
        "0.43*n*p/(n + 2.0) - 0.43*p/(p + 0.59)",
        "0.16 + 2.4*p^2/(p^2 + 1.5) - 0.75*n/(n + 0.34)",
        "0.69*p - 0.69*p*exp(-0.5*n) - 0.73*p/(p + 0.61)",
    ],
)
def test_the_law_of_an_arc_leads(law):
    """The first candidate is the law beside the arc too."""
    first = look(on_an_arc(law)).candidates[0].expr
    np.testing.assert_allclose(
        evaluate(first, BESIDE), evaluate(parse(law), BESIDE), rtol=1e-3, atol=1e-4
    )


@pytest.mark.slow
def test_of_noise_nothing_is_final():
    """Slopes that err by a percent leave no doubt of no sum."""
    assert not look(on_an_arc("0.9*n - 0.4*n^2", error=0.01)).final


@pytest.mark.slow
def test_what_is_in_simple_numbers_is_final():
    """Two saturations end the search where all constants but one are simple numbers."""
    law = parse("0.16 + 2.4*p^2/(p^2 + 1.5) - 0.7512345678*n/(n + 0.34)")
    seen = look(on_an_arc(str(law)))
    assert seen.final
    found = evaluate(seen.candidates[0].expr, BESIDE)
    np.testing.assert_allclose(found, evaluate(law, BESIDE), rtol=1e-5)


@pytest.mark.parametrize(("names", "found"), [(["exp", "*"], True), (["sin", "*"], False)])
@pytest.mark.slow
def test_sums_contain_only_what_is_allowed(names, found):
    """A list of functions is kept, and the law is there where it is allowed."""
    law, own = parse("0.9*n - 0.4*n*p*exp(-0.8*n)"), Vocabulary.read(names)
    exprs = [c.expr for c in look(on_an_arc(str(law)), Limits(own)).candidates]
    assert exprs
    assert all(own.allows(expr) for expr in exprs)
    near = [e for e in exprs if skeleton(sympy.N(e)) == skeleton(sympy.N(law))]
    assert bool(near) == found


@pytest.mark.slow
def test_nothing_allowed_is_no_fault():
    """With no function allowed only sums of products are given."""
    law = "0.9*n - 0.4*n*p*exp(-0.8*n)"
    seen = look(on_an_arc(law), Limits(Vocabulary.read(["+", "*"])))
    assert all(c.expr.is_polynomial() for c in seen.candidates)


@pytest.mark.slow
def test_the_users_own_terms_are_among_the_few():
    """A law with a term that only the user knows is final; left out, that term is not there."""
    law = parse("0.16 + 2.4*p^2/(p^2 + 1.5) - 0.75*n*sin(3*p)*exp(p)")
    own = parse("n*sin(3*p)*exp(p)")
    seen = look(on_an_arc(str(law)), Limits(terms=(2 * own,)))
    assert seen.final
    found = evaluate(seen.candidates[0].expr, BESIDE)
    np.testing.assert_allclose(found, evaluate(law, BESIDE), rtol=1e-5)
    without = look(on_an_arc(str(law)), Limits(terms=(own,), left_out=(own,)))
    assert not any(c.expr.has(own) for c in without.candidates)
