"""Functions of several constants inside: found on exact slopes, and in noise."""

import numpy as np
import pytest
import sympy
from looking import look_twice
from measured_systems import measured, run

from dynsr.data import choose_samples
from dynsr.expression import evaluate, parse
from dynsr.methods import read_demands
from dynsr.selection.alone import Alone
from dynsr.selection.comparison import COMPARISON

# The texts of the equations, a start, the span and the rows.
LAWS = {
    "a resin that cures by what is cured (Kamal 1974)": (
        {"a": "(0.12 + 1.4*a^0.8)*(1 - a)^1.6"},
        (0.02,),
        5.0,
        150,
    ),
    "growth with two exponents (Blumberg 1968)": (
        {"n": "1.3*n^0.7*(1 - n/4.2)^1.5"},
        (0.15,),
        6.0,
        150,
    ),
    "a step of a line with a threshold (Cowan 1968)": (
        {"e": "0.4 - e + 1.3/(1 + exp(1.3 - 4.2*e + 3.1*i))", "i": "-0.5*i + 0.8*e"},
        (0.2, 0.1),
        14.0,
        150,
    ),
    "a bump beside a drift": (
        {"v": "0.8 - 0.3*v + 1.4*exp(-2.5*(v - 1.3)^2)"},
        (0.1,),
        6.0,
        120,
    ),
    "growth that its own food inhibits, fed (Andrews 1968)": (
        {
            "s": "0.5 - 0.9*s*x/(0.4 + s + 0.7*s^2) - 0.2*s",
            "x": "0.7*s*x/(0.4 + s + 0.7*s^2) - 0.2*x",
        },
        (3.0, 0.1),
        25.0,
        200,
    ),
    "a pendulum whose angle is in other units": (
        {"p": "-2.7*sin(1.83*q) - 0.21*p", "q": "p"},
        (0.2, 1.1),
        14.0,
        150,
    ),
    "rotors that pull each other along, in other units": (
        {"a": "0.9 + 0.7*sin(2.4*(b - a))", "b": "1.4 - 0.3*sin(2.4*(b - a))"},
        (0.1, 0.9),
        6.0,
        150,
    ),
    "predators that die out (Beddington 1975; DeAngelis et al. 1975)": (
        {
            "p": "0.32*p*n/(0.85 + n + 0.41*p) - 0.63*p",
            "n": "0.75*n*log(2.1/n) - 0.65*p*n/(0.85 + n + 0.41*p)",
        },
        (2.25, 2.36),
        24.0,
        400,
    ),
}


def integrated(texts, start, end, rows):
    """Integrate equations finely and give their formulas and so many even rows."""
    laws = {state: parse(text) for state, text in texts.items()}
    rhs = sympy.lambdify(list(map(sympy.Symbol, laws)), list(laws.values()))
    return laws, run(rhs, start, end, rows, tuple(laws), rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_exact_slopes_show_functions_of_several_constants(name):
    """The law is final, in simple numbers, and the true function off the trajectory too."""
    laws, data = integrated(*LAWS[name])
    state = next(iter(laws))
    samples = choose_samples([data], state)
    seen = look_twice(samples)
    beside = {s: 0.9 * np.roll(x, 20 * i) for i, (s, x) in enumerate(samples.columns.items())}
    assert seen.final
    assert evaluate(seen.candidates[0].expr, beside) == pytest.approx(
        evaluate(laws[state], beside), rel=1e-5
    )


DRAG = {"u": "-0.21*u*sqrt(u^2 + v^2)", "v": "-9.81 - 0.21*v*sqrt(u^2 + v^2)"}
SWING = {"p": "-2.7*sin(1.83*q) - 0.21*p", "q": "p"}
SWITCH = {"a": "2.1/(1 + b^3) - 0.8*a", "b": "1.7/(1 + a^2) - 0.6*b"}


@pytest.mark.parametrize(
    ("texts", "start", "end", "state"),
    [
        (DRAG, (12.0, 15.0), 3.0, "u"),
        (SWITCH, (0.1, 0.3), 12.0, "a"),
        (SWING, (0.2, 1.1), 14.0, "p"),
    ],
    ids=["drag of a thrown ball", "a switch of two genes", "a pendulum in other units"],
)
@pytest.mark.slow
def test_noisy_states_show_them_too(texts, start, end, state):
    """Of the sums that are proposed in 1 % noise the law is one of the first twelve.

    Its constants are within 5 %; alone, with the other states read off their curves, it may be
    behind another.
    """
    laws, clean = integrated(texts, start, end, 150)
    alone = Alone.of(state, measured(tuple(texts.items()), start, end, 150, 0.01), COMPARISON)
    columns = dict(zip(clean.states, clean.x.T, strict=True))
    true = evaluate(laws[state], columns)
    count = len(sympy.Add.make_args(laws[state]))
    best = list(alone.rank(alone.propose()))[:12]
    likely = [e for e in best if len(sympy.Add.make_args(e)) == count]
    assert min(np.std(evaluate(e, columns) - true) for e in likely) < 0.05 * np.std(true)


@pytest.mark.slow
def test_a_user_who_forbids_functions_is_given_none():
    """Only sums of what the user allows are looked through."""
    _, clean = integrated(DRAG, (12.0, 15.0), 3.0, 150)
    samples = choose_samples([clean], "u")
    demands = read_demands(("u", "v"), ("u", "v"), functions=[])
    seen = look_twice(samples, demands.limits("u"))
    assert not any(c.expr.has(sympy.exp, sympy.Abs) for c in seen.candidates)
