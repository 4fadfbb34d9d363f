import math

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from dynsr.data.samples import Samples
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront, rmse, score_candidate

pairs = st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=15)


def _candidates(values: list[tuple[int, int]]) -> list[Candidate]:
    return [
        Candidate(sympy.Symbol(f"c{i}"), float(loss), float(bits))
        for i, (loss, bits) in enumerate(values)
    ]


@given(pairs)
def test_the_front_holds_what_nothing_dominates(values: list[tuple[int, int]]):
    """A pair of loss and complexity is on the front exactly when no other is better in both."""
    front = {(c.loss, c.complexity) for c in ParetoFront(_candidates(values))}
    assert front == {
        (a, b)
        for a, b in values
        if not any((c <= a and d <= b) and (c, d) != (a, b) for c, d in values)
    }


@given(pairs, pairs)
def test_merging_is_the_front_of_all(a: list[tuple[int, int]], b: list[tuple[int, int]]):
    """Merging two fronts loses nothing and does not depend on the order."""
    one, two = ParetoFront(_candidates(a)), ParetoFront(_candidates(b))
    merged = [(c.loss, c.complexity) for c in one.merge(two)]
    assert merged == [(c.loss, c.complexity) for c in two.merge(one)]
    assert merged == [(c.loss, c.complexity) for c in ParetoFront(_candidates(a + b))]


@given(st.permutations(["b", "a", "c", "a"]))
def test_of_equals_the_first_by_text_is_kept(names: list[str]):
    """Which of several equal formulas is kept does not depend on the order they came in."""
    equal = [Candidate(sympy.Symbol(name), 1.0, 1.0) for name in names]
    assert [str(c.expr) for c in ParetoFront(equal)] == ["a"]
    assert [str(c.expr) for c in ParetoFront(equal).best_by_source] == ["a"]


def test_only_ties_are_printed():
    """Printing is slow: formulas of which one is better are not printed to order them."""

    class Unprintable(sympy.Symbol):
        def _sympystr(self, printer):
            raise AssertionError

    found = [Candidate(Unprintable("x"), 1.0, bits) for bits in (2.0, 1.0, 3.0)]
    assert len(ParetoFront(found).add(*found)) == 1


def test_infinite_losses_stay_off_the_front():
    """A formula that has no value somewhere on the samples is not a candidate."""
    samples = Samples(np.array([[0.0], [1.0]]), np.ones(2), ("x",), "x", "given", np.arange(2.0))
    bad = score_candidate(parse("1/x"), samples)
    assert math.isinf(bad.loss)
    assert len(ParetoFront([bad])) == 0
    with pytest.raises(ValueError, match="empty"):
        _ = ParetoFront([bad]).best_fit


def test_rmse_is_the_root_of_the_mean_square():
    """(3, 4) against zero is 5 over the root of 2."""
    assert rmse(np.array([3.0, 4.0]), np.zeros(2)) == pytest.approx(5 / math.sqrt(2))


def test_the_knee_is_where_a_bit_buys_most():
    """Of 1, 0.9, 0.001, 0.0009 the third is the knee."""
    losses = [1.0, 0.9, 0.001, 0.0009]
    front = ParetoFront(
        Candidate(sympy.Symbol(f"c{i}"), loss, float(i)) for i, loss in enumerate(losses)
    )
    assert front.knee.loss == 0.001
