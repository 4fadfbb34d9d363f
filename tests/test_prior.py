"""The prior of formulas: counted in a corpus of textbooks' laws, and what it says of systems."""

import json
import math
from itertools import pairwise

import pytest
import sympy

from dynsr.expression import parse
from dynsr.fit import with_floats
from dynsr.library import Place, Written, read_body, read_equation, textbooks, write_down
from dynsr.library.prior import _FILES, CHOICES, corpus, count

PREY = {"x": "1.1*x - 0.4*x*y", "y": "0.1*x*y - 0.4*y"}


def bits(equations, columns=None):
    """Bits of a system that is given in words."""
    exprs = {s: with_floats(parse(e)) for s, e in equations.items()}
    return textbooks().system_bits(exprs, columns or list(exprs))


def templates(text):
    """The templates of the factors of a term."""
    return [factor.template for factor in read_body(parse(text))]


@pytest.mark.slow
def test_the_counts_are_those_of_the_corpus():
    """The file that is read is what counting gives."""
    kept = json.loads(_FILES.joinpath("prior.json").read_text("utf-8"))
    assert kept == {name: dict(own) for name, own in count(corpus()).counts.items()}


def test_an_equation_with_the_time_is_rare():
    """As bits: how many equations of the corpus there are for each that contains the time."""
    assert textbooks().driven_bits == pytest.approx(math.log2(sum_of("terms") / 5), abs=0.5)


def sum_of(choice):
    """How often a choice was made."""
    return sum(textbooks().counts[choice].values())


def test_every_choice_is_counted_by_hand():
    """Two small systems, counted with pencil and paper."""
    x, y = sympy.symbols("x y")
    decay = {"x": -1.5 * x}
    hunt = {"x": 2.5 * x - 1.5 * x * y, "y": 0.7 * x * y - 0.2 * sympy.sin(x)}
    counts = count([decay, hunt]).counts
    assert counts.keys() == set(CHOICES)
    assert counts["terms"] == {"1": 1, "2": 2}
    # x, x and x y, and sin x; the second x y is cited.
    assert counts["factors"] == {"1": 3, "2": 1}
    assert counts["template"] == {"v0": 4, "sin(v0)": 1}
    assert counts["role of a power"] == {"own": 3, "state": 1}
    assert counts["role in a function"] == {"state": 1}
    assert counts["role"] == {"own in v0": 3, "state in v0": 1, "state in sin(v0)": 1}
    assert counts["cited"] == {"yes": 1, "no": 1}
    assert counts["twin"] == {"no": 1}
    assert counts["repeated"] == counts["again"] == {}
    assert counts["same inside"] == counts["same factor of a function"] == {}
    assert counts["same factor of a product"] == {"no": 1}


def test_constants_that_terms_share_are_counted_by_hand():
    """Uptake is growth at one rate; a part like it saturates at a constant of its own."""
    s, x = sympy.symbols("s x")
    rate = s * x / (s + 0.4)
    system = {"s": 2.5 - 1.5 * rate - 0.2 * x, "x": 1.5 * rate - 0.2 * x + 0.3 * s / (s + 0.7)}
    counts = count([system]).counts
    assert counts["same inside"] == {"yes": 1, "no": 1}
    assert counts["same factor of a function"] == {"yes": 1}
    assert counts["same factor of a column"] == {"yes": 1}
    assert counts["same factor of a product"] == {}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.3*x*y", ["v0", "v0"]),
        ("2.5*x**2*y/(x**2 + 1.5)", ["v0", "v0**2/(c + v0**2)"]),
        ("3/(0.7 + 0.4*y**4)", ["1/(c + v0**4)"]),
        ("0.5*x*y/(x + 2.5*y)", ["v0", "v0/(c*v1 + v0)"]),
        ("0.5*x*y/(x + y)", ["v0", "v0/(v0 + v1)"]),
        ("-0.2*sin(y - x)", ["sin(v0 - v1)"]),
        ("0.2*exp(-1.5*x)", ["exp(c*v0)"]),
        ("x**1.7", ["v0**c"]),
        ("2.5", []),
    ],
)
def test_terms_are_read_in_one_way(text, expected):
    """What saturates is one factor; constants, signs and names of columns are left out."""
    assert templates(text) == expected


def test_terms_that_differ_in_a_constant_inside_are_two():
    """Two exponentials of a potential are no single one, and the second costs bits of its own."""
    x, v = sympy.symbols("x v")
    morse = sympy.exp(-2.0 * x) - 1.5 * sympy.exp(-1.0 * x)
    assert len(read_equation(morse)) == 2
    counts = count([{"x": v, "v": morse}]).counts
    assert counts["again"] == {"yes": 1} and counts["template"]["exp(c*v0)"] == 1
    uptake = "0.5*y*x**3/(x**3 + 1.5)"
    one = bits({"x": f"0.2*x - {uptake}", "y": f"{uptake} - 0.3*y"})
    two = bits({"x": f"0.2*x - {uptake}", "y": f"{uptake} - 0.3*y*x**3/(x**3 + 0.1)"})
    assert two > one + 2


def test_names_and_sizes_say_nothing():
    """Bits are the same for other constants and other names of the columns."""
    other = {"a": "7.1*a - 0.02*a*b", "b": "3.3*a*b - 12.5*b"}
    assert bits(PREY) == pytest.approx(bits(other))


def test_what_an_equation_has_costs_less_in_another():
    """A term that is cited costs fewer bits than one like it that is not."""
    cited = bits({"x": "1.1*x - 0.4*x*y/(y + 0.5)", "y": "0.1*x*y/(y + 0.5) - 0.4*y"})
    anew = bits({"x": "1.1*x - 0.4*x*y/(y + 0.5)", "y": "0.1*x*y**2/(y + 0.5) - 0.4*y"})
    assert cited < anew - 3


def test_a_twin_costs_less_than_the_equation_that_it_repeats():
    """Names exchanged, all the way round a ring too, are said in a few bits."""
    ring = {"x": "2/(1.5 + z**3) - 0.9*x", "y": "2/(1.5 + x**3) - 0.9*y"}
    first = bits({"x": ring["x"]}, ["x", "y", "z"])
    whole = bits({**ring, "z": "2/(1.5 + y**3) - 0.9*z"})
    assert whole < first + 15


@pytest.mark.parametrize(
    ("textbook", "odd"),
    [
        ("0.5*x - 0.2*x*y", "0.5*sqrt(y) - 0.2*exp(0.3*x)"),
        ("0.5*x - 0.2*x*y/(x + 1.5)", "0.5/y**2 - 0.2*cos(0.3*x)"),
        ("0.5*x - 0.1*x**2", "0.5*x - 0.1*x**2*y**3"),
        ("0.5 - 0.2*x", "0.5*y - 0.2*y**2"),
    ],
)
def test_laws_of_textbooks_cost_less_than_odd_ones_of_their_length(textbook, odd):
    """With as many constants or fewer, what textbooks write is the shorter."""
    assert bits({"x": textbook}, ["x", "y"]) < bits({"x": odd}, ["x", "y"]) - 3


def test_templates_share_no_more_than_all_there_is():
    """Probabilities of the templates, and of one that was never seen, add up to about 1."""
    prior = textbooks()
    place, written = Place("x", ("x",), ("x",)), Written()
    plain = {f.template for f in read_body(sympy.Symbol("x"))}
    assert plain == {"v0"}
    shares = sum(2 ** -prior._choices["template"].bits(t) for t in prior.counts["template"])
    assert 0.9 < shares < 1
    assert prior.term_bits(read_body(sympy.Symbol("x")), place, written) > 0


def test_longer_sums_are_rarer():
    """Each of many terms more costs bits, though their order says nothing."""
    body = [read_body(parse(text)) for text in ("x", "x**2", "x*y", "y", "y**2", "x**3", "y**3")]
    prior, place = textbooks(), Place("x", ("x", "y"), ("x", "y"))
    costs = [prior.equation_bits(body[:n], place, Written()) for n in range(1, 8)]
    assert all(more > less for less, more in pairwise(costs))
    assert math.isfinite(costs[-1])


def test_what_is_written_down_is_cited():
    """The terms and functions of equations are at hand for another one."""
    hunt = parse("0.4*x*y/(y + 0.5) - x")
    written = write_down([("x", with_floats(hunt))])
    assert set(written.terms) == set(read_equation(with_floats(hunt)))
    place, term = Place("y", ("x", "y"), ("x", "y")), read_body(parse("x*y/(y + 0.7)"))
    assert textbooks().term_bits(term, place, written) < textbooks().term_bits(
        term, place, Written()
    )


def test_a_line_below_two_terms_is_written_once():
    """What stands below a fraction line costs less the second time, in an equation too."""
    line, other = "(1 + 0.7*x**2*y)", "(1 + 0.7*x*y**2)"
    once = bits({"x": f"0.4*x/{line} + 0.3*sin(y)/{line}"}, ["x", "y"])
    twice = bits({"x": f"0.4*x/{line} + 0.3*sin(y)/{other}"}, ["x", "y"])
    assert once < twice - 10


def test_states_are_of_one_kind_only_where_all_that_is_written_says_so():
    """A third term makes Lorenz's z' what y' is with y and z exchanged, but x' knows them apart."""
    flow = {"x": "10.0*y - 10.0*x", "y": "28.0*x - 1.0*x*z - 1.0*y"}
    extra = bits({**flow, "z": "1.0*x*y - 2.7*z + 0.1*x"}, ["x", "y", "z"])
    assert bits({**flow, "z": "1.0*x*y - 2.7*z"}, ["x", "y", "z"]) < extra
    # Where x' has both alike, all can be exchanged.
    flow["x"] = "10.0*y + 9.0*z - 8.0*x"
    alike = bits({**flow, "z": "1.1*x*y - 2.7*z + 0.1*x"}, ["x", "y", "z"])
    assert alike < extra - 4
