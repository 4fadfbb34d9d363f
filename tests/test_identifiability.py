"""Identifiability: which parameters can be known at all, and which combinations of the others."""

import json

import numpy as np
import pytest
import sympy
from command_line import run
from test_profile_likelihood import enzyme, found_in, noisy_rabbits, solved

import dynsr
from dynsr.discovery import Discovery
from dynsr.errors import InputError


def said(equations, **options):
    """Give the unknown parameters of a system, and what is known of them, as text."""
    found = dynsr.identifiability(equations, **options)
    return set(found.unknown), {str(one.expr) for one in found.combinations}, found.beyond


@pytest.mark.parametrize(
    ("equations", "unknown", "combinations"),
    [
        ({"x": "a*b*x"}, {"a", "b"}, {"a*b"}),
        ({"x": "(a + b)*x"}, {"a", "b"}, {"a + b"}),
        ({"x": "a*b**2*x - c*x**2"}, {"a", "b"}, {"a*b**2"}),
        ({"x": "a*x/(b + c*x)"}, {"a", "b", "c"}, {"a/c", "b/c"}),
        ({"x": "a*exp(b + x)"}, {"a", "b"}, {"a*exp(b)"}),
        ({"x": "(a + b)*x + c*d*x**2"}, {"a", "b", "c", "d"}, {"c*d", "a + b"}),
        ({"x": "a*x/(b + x)"}, set(), set()),
        ({"x": "a*sin(b*x + c)"}, set(), set()),
        ({"x": "s*(y - x)", "y": "r*x - y - x*z", "z": "x*y - b*z"}, set(), set()),
    ],
)
def test_what_measured_states_determine(equations, unknown, combinations):
    """Closed forms: what enters as a product, a sum or beside an exponential is known as that."""
    assert said(equations) == (unknown, combinations, 0)


def test_an_epidemic_seen_as_a_share_of_the_ill():
    """Reported cases k*I give g, b/k and k*S(0), and none of b, k, S(0), I(0) (Chapman 2009)."""
    epidemic = {"S": "-b*S*I", "I": "b*S*I - g*I"}
    found = dynsr.identifiability(epidemic, observed={"cases": "k*I"})
    assert found.known == ("g",) and set(found.unknown) == {"b", "k", "S(0)", "I(0)"}
    assert {str(one.expr) for one in found.combinations} == {"b/k", "S(0)*k", "I(0)*k"}


def test_predator_is_known_from_prey_up_to_its_unit():
    """From the prey alone all rates follow but that at which it is eaten, given how many eat."""
    assert said({"x": "a*x - b*x*y", "y": "c*x*y - d*y"}, observed=["x"]) == (
        {"b", "y(0)"},
        {"b*y(0)"},
        0,
    )


def test_two_compartments_are_known_from_one_only_with_a_known_input():
    """One compartment, watched: k1*k3 and k1 + k2 + k3 of three rates; with an input all three."""
    free = {"x": "-k1*x + k2*y", "y": "k1*x - (k2 + k3)*y"}
    unknown, combinations, beyond = said(free, observed=["x"])
    assert unknown == {"k1", "k2", "k3", "y(0)"}
    assert combinations == {"k1*k3", "k1 + k2 + k3"} and beyond == 1
    driven = {**free, "x": "-k1*x + k2*y + u"}
    assert said(driven, observed={"level": "x/V"}, inputs=["u"])[0] == set()


def test_chaos_is_known_from_one_state():
    """The x of Lorenz's system determines its three parameters, y and z at the start too."""
    lorenz = {"x": "s*(y - x)", "y": "r*x - y - x*z", "z": "x*y - b*z"}
    found = dynsr.identifiability(lorenz, observed=["x"])
    assert found.known == ("b", "r", "s") and found.unknown == ()


def test_random_points_do_not_change_what_is_said():
    """Other seeds give the same parameters and combinations."""
    known = [said({"x": "a*x/(b + c*x) - d*x"}, seed=seed) for seed in range(4)]
    assert all(one == known[0] for one in known)


def test_a_random_scaling_is_found_whatever_its_powers():
    """Products of powers with whole exponents from -3 to 3 are found as they were hidden."""
    rng = np.random.default_rng(7)
    a, b, x = sympy.symbols("a b x")
    for _ in range(5):
        p, q = (int(v) for v in rng.choice([-3, -2, -1, 1, 2, 3], 2))
        hidden = a**p * b**q
        found = dynsr.identifiability({"x": hidden * x - x**3})
        (own,) = found.combinations
        ratio = sympy.log(own.expr.subs({a: 2, b: 3})) / sympy.log(hidden.subs({a: 2, b: 3}))
        assert (
            sympy.simplify(own.expr - hidden ** sympy.nsimplify(ratio.evalf(), tolerance=1e-9)) == 0
        )


def test_far_below_saturation_data_know_a_quotient_alone():
    """Exact data tell speed and half-saturation apart; these, in 10 % noise, tell the quotient."""
    found = enzyme(0.1)
    known = found.identifiability()
    assert known.unknown == () and set(known.weak) == {"k1", "k2"}
    (own,) = known.weak_combinations
    assert str(own.expr) == "k1/k2"
    assert own.error < 0.1 < min(known.errors.values())
    assert "k1/k2" in str(known) and "hardly bound k1 and k2" in str(known)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_what_is_known_is_said_to_be(noise):
    """Predator and prey in noise: every parameter is known, to about its noise."""
    known = noisy_rabbits(noise).identifiability()
    assert known.weak == () and known.unknown == ()
    assert max(known.errors.values()) < noise


def test_without_data_the_equations_alone_are_asked():
    """A discovery without its data says what could be known."""
    bare = Discovery({"x": dynsr.parse("-2.0*x/(3.1*x + 5.3)")}, {}, {}, {})
    assert bare.identifiability().errors == {}
    t, x = solved(lambda _, s: -0.5 * s, [1.0], 4.0, 60)
    assert bare.identifiability({"t": t, "x": x[:, 0]}).errors


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: dynsr.identifiability({"x": "-x"}), "there is no parameter"),
        (lambda: dynsr.identifiability({}), "there is no parameter"),
        (lambda: dynsr.identifiability({"x": "-k*x"}, observed=["y"]), "'y' is no state"),
        (lambda: dynsr.identifiability({"x": "-k*x"}, observed=[]), "nothing is observed"),
        (lambda: dynsr.identifiability({"x": "-k*("}), r"-k\*\("),
        (
            lambda: Discovery({"x": sympy.Symbol("x")}, {}, {}, {}).identifiability(),
            "no parameters",
        ),
        (
            lambda: Discovery(
                {"x": dynsr.parse("2*x")}, {}, {}, {}, settings={"kind": "map"}
            ).identifiability(),
            "a map",
        ),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(call, words):
    """Without parameters, states or formulas that can be read there is one line that says so."""
    with pytest.raises(InputError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_the_shell_and_the_report_say_what_is_known(tmp_path):
    """The command ends in the sentences; the page has them where something is not known."""
    found = enzyme(0.1)
    model, table = found.save(tmp_path / "discovery.json"), tmp_path / "data.csv"
    run_ = found.trajectories[0]
    np.savetxt(table, np.column_stack([run_.t, run_.x]), "%.12g", ",", header="t,x", comments="")
    assert "They tell k1/k2" in run("profile", model, table).stdout
    told = json.loads(run("profile", model, table, "--json").stdout)["identifiability"]
    assert told["weak"] == ["k1", "k2"]
    assert "They tell k1/k2" in found.report(tmp_path / "report.html").read_text("utf-8")


def test_a_ratio_of_three_constants_has_two_parameters():
    """A found ratio whose constants can all be scaled together says so."""
    t, x = solved(lambda _, s: -2 * s / (3 * s + 5), [4.0], 8.0, 80)
    found = found_in(t, x, x="-2.01*x/(3.02*x + 5.03)")
    known = found.identifiability()
    assert known.weak == () and len(found.parameters) - len(known.combinations) <= 2
