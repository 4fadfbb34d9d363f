"""Sums of few terms: the law among very many sums that follow a short arc as closely."""

import numpy as np
import pytest
import sympy

from dynsr.data import Samples
from dynsr.expression import Vocabulary, evaluate, parse
from dynsr.fit import skeleton
from dynsr.methods import Limits
from dynsr.selection import look_again
from dynsr.selection.few import FewTerms
from dynsr.selection.terms import products


def on_an_arc(law, error=0.0):
    """Slopes of a law along a short arc of two columns, each off by a share of the largest."""
    t = np.linspace(0.0, 1.0, 80)
    columns = {"n": 1.9 - 1.1 * t + 0.2 * t**2, "p": 0.6 + 0.7 * t - 0.3 * t**3}
    slopes = evaluate(parse(law), columns)
    slopes = slopes + error * np.max(np.abs(slopes)) * np.random.default_rng(0).normal(size=80)
    return Samples(np.column_stack(list(columns.values())), slopes, ("n", "p"), "n", "given", t)


def offered(samples, *known):
    """What sums are made of: products, and terms that are known."""
    plain = [sympy.S.One, *products(samples.names, 3)]
    plain.sort(key=lambda e: sympy.total_degree(e) - e.has(sympy.Symbol("n")))
    return FewTerms.of(samples, [*map(parse, known), *plain])


def sums(few, kind, most):
    """Sums of one kind that leave no more; the search of two functions ends with the first."""
    return few.with_two(most, most) if kind == "with_two" else getattr(few, kind)(most)


@pytest.mark.parametrize(
    ("kind", "law", "known"),
    [
        ("plain_sums", "0.37*n^2 - 0.1*n^3 - 0.14*n - 0.49*n*p - 0.62*p/(n + 1.4)", "p/(n + 1.4)"),
        ("with_one", "0.374*n^2 - 0.097*n^3 - 0.119*n - 1.1*n*p/(n + 2.0)", None),
        ("with_one", "0.9*n - 0.4*n*p*exp(-0.8*n)", None),
        ("with_two", "0.43*n*p/(n + 2.0) - 0.43*p/(p + 0.59)", None),
        ("with_two", "0.16 + 2.4*p^2/(p^2 + 1.5) - 0.75*n/(n + 0.34)", None),
        ("with_two", "0.69*p - 0.69*p*exp(-0.5*n) - 0.73*p/(p + 0.61)", None),
    ],
)
def test_the_law_of_an_arc_is_among_the_shortest(kind, law, known):
    """Sums of as few constants that leave 1e-8 are the law, with its constants to four digits."""
    samples = on_an_arc(law)
    most = 1e-8 * float(np.max(np.abs(samples.y)))
    found = sums(offered(samples, *filter(None, [known])), kind, most)
    same = [e for e in found if skeleton(e) == skeleton(sympy.expand(parse(law) * 1.0))]
    assert same, found
    numbers = [sorted(map(float, e.atoms(sympy.Float))) for e in (same[0], parse(law) * 1.0)]
    np.testing.assert_allclose(numbers[0][:3], numbers[1][:3], rtol=1e-3)
    beside = {"n": np.linspace(0.2, 3.0, 7), "p": np.linspace(2.0, 0.1, 7)}
    np.testing.assert_allclose(
        evaluate(same[0], beside), evaluate(parse(law), beside), rtol=1e-3, atol=1e-4
    )


def test_terms_that_only_cancel_each_other_are_no_law():
    """Of noise no sum of few terms is given, and none whose terms are far larger than it."""
    samples = on_an_arc("0.9*n - 0.4*n^2", error=0.01)
    alone = Samples(samples.X[:, :1], samples.y, ("n",), "n", "given", samples.t)
    few = FewTerms.of(alone, [sympy.S.One, *products(("n",), 3)])
    for kind in ("plain_sums", "with_one", "with_two"):
        assert sums(few, kind, 1e-6) == []
    largest = float(np.max(np.abs(samples.y)))
    found = few.with_one(0.02 * largest)
    assert found
    for expr in found:
        for term in sympy.Add.make_args(expr):
            assert np.max(np.abs(evaluate(term, alone.columns))) <= 100 * largest


def test_what_is_in_simple_numbers_is_final():
    """Two saturations end the search where all constants but one are simple numbers."""
    law = parse("0.16 + 2.4*p^2/(p^2 + 1.5) - 0.7512345678*n/(n + 0.34)")
    seen = look_again(on_an_arc(str(law)), {})
    assert seen.final
    beside = {"n": np.linspace(0.2, 3.0, 7), "p": np.linspace(2.0, 0.1, 7)}
    found = evaluate(seen.candidates[0].expr, beside)
    np.testing.assert_allclose(found, evaluate(law, beside), rtol=1e-5)


def test_sums_hold_only_what_is_allowed():
    """A list of functions is kept: the shortest sums that leave as little hold no others."""
    law = "0.9*n - 0.4*n*p*exp(-0.8*n)"
    samples = on_an_arc(law)
    most = 1e-6 * float(np.max(np.abs(samples.y)))
    plain = [sympy.S.One, *products(samples.names, 3)]
    for names, found in ((["exp", "*"], True), (["sin", "*"], False), (["/"], None)):
        own = Vocabulary.read(names)
        few = FewTerms.of(samples, plain, Limits(own).allow)
        exprs = [
            e for kind in ("plain_sums", "with_one", "with_two") for e in sums(few, kind, most)
        ]
        assert all(own.allows(expr) for expr in exprs)
        if found is not None:
            assert found == any(skeleton(e) == skeleton(parse(law)) for e in exprs)


def test_nothing_allowed_is_no_fault():
    """With no function allowed, and with no term at all, no sum is given."""
    samples = on_an_arc("0.9*n - 0.4*n*p*exp(-0.8*n)")
    for allowed in (lambda e: e == 1, lambda _: False):
        few = FewTerms.of(samples, [sympy.S.One], allowed)
        for kind in ("plain_sums", "with_one", "with_two"):
            assert sums(few, kind, 1e-6) == []


def test_the_users_own_terms_are_among_the_few():
    """A law with a term that only the user knows is final; left out, that term is not there."""
    law = parse("0.16 + 2.4*p^2/(p^2 + 1.5) - 0.75*n*sin(3*p)*exp(p)")
    own = parse("n*sin(3*p)*exp(p)")
    seen = look_again(on_an_arc(str(law)), {}, limits=Limits(terms=(2 * own,)))
    assert seen.final
    beside = {"n": np.linspace(0.2, 3.0, 7), "p": np.linspace(2.0, 0.1, 7)}
    found = evaluate(seen.candidates[0].expr, beside)
    np.testing.assert_allclose(found, evaluate(law, beside), rtol=1e-5)
    without = look_again(on_an_arc(str(law)), {}, limits=Limits(terms=(own,), left_out=(own,)))
    assert not any(c.expr.has(own) for c in without.candidates)
