import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.system import CART_POLE, LORENZ, LOTKA_VOLTERRA, PAPER_SYSTEMS, PENDULUM, System
from dynsr.errors import EngineError, InputError
from dynsr.expression.parsing import parse
from dynsr.paper.protocol import (
    compared_states,
    find_protocol,
    is_of_paper,
    printed_loss,
    score_as_printed,
)
from dynsr.verdict.scoring import (
    equation_rmse,
    score_expressions,
    trajectory_loss,
    trajectory_losses,
)

# Two states that do not touch each other, so that losses have closed forms.
DECAYS = System.from_strings(
    {"a": "-a", "b": "-b"}, x0=[2.0, 1.0], test=(0.0, 1.0), name="two decays"
)


def test_the_true_equation_has_no_loss():
    """All three losses of the true right-hand side are exactly 0, from the right start."""
    for system in (LOTKA_VOLTERRA, CART_POLE):
        score = score_as_printed(system, [system.rhs[-1]], "ga")[0]
        assert (score.equation_rmse, score.printed_loss, score.trajectory_loss) == (0, 0, 0)


def test_the_equation_rmse_has_its_closed_form():
    """f_hat - f = c b along b = exp(-t) gives c sqrt(mean exp(-2t))."""
    found = equation_rmse(DECAYS, parse("-0.5*b"))
    assert found == pytest.approx(0.5 * math.sqrt((1 - math.exp(-2)) / 2), rel=2e-3)


def test_the_trajectory_loss_has_its_closed_form():
    """db/dt = 0 from 1 stays at 1 while the truth is exp(-t)."""
    squared_mean = 1 - 2 * (1 - math.exp(-1)) + (1 - math.exp(-2)) / 2
    assert trajectory_loss(DECAYS, sympy.Float(0.0)) == pytest.approx(
        math.sqrt(squared_mean), rel=1e-3
    )


def test_squares_of_states_are_added_not_averaged():
    """Both states off by the same number count sqrt(2) times one of them."""
    system = System.from_strings({"a": "b*0", "b": "0*b"}, x0=[0.0, 0.0], test=(0.0, 1.0))
    one = trajectory_loss(system, parse("1.0"), target="b")
    both = System.from_strings({"a": "b", "b": "0*b"}, x0=[0.0, 0.0], test=(0.0, 1.0))
    # a = t^2 / 2 and b = t: sum of squares t^2 + t^4 / 4.
    assert one == pytest.approx(math.sqrt(1 / 3), rel=1e-3)
    assert trajectory_loss(both, parse("1.0"), "b") == pytest.approx(
        math.sqrt(1 / 3 + 1 / 20), rel=1e-3
    )


def test_the_trajectory_loss_agrees_with_scipy():
    """An altered cart-pole, integrated by DOP853, is as far from the truth."""
    t = np.linspace(10.0, 15.0, 5001)

    def states(z_slope):
        def slopes(s, x):
            w, _, y, z = x
            force, sin, cos = -0.2 + 0.5 * np.sin(6 * s), np.sin(w), np.cos(w)
            over = 2 - cos**2
            y_slope = -(19.62 * sin + sin * cos * y**2 + force * cos) / over
            return [y, z, y_slope, z_slope(w, y, force, sin, cos, over)]

        start = [0.3, 0.0, 1.0, 0.0]
        return solve_ivp(slopes, (10, 15), start, "DOP853", t, rtol=1e-10, atol=1e-10).y

    true = states(lambda w, y, F, sin, cos, over: -(sin * y**2 + 9.81 * sin * cos + F) / over)
    altered = states(lambda w, y, F, sin, cos, over: F - 4 * w)
    expected = math.sqrt(np.mean(np.sum((altered - true) ** 2, axis=0)))
    assert trajectory_loss(CART_POLE, parse("F - 4*w")) == pytest.approx(expected, rel=5e-3)


def test_the_printed_loss_of_the_pendulum_has_the_wrong_start():
    """Even the true equation has a printed loss there: DOP853 from both starts has the same."""
    true = PENDULUM.rhs[-1]
    assert trajectory_loss(PENDULUM, true) == 0
    t = np.linspace(10.0, 15.0, 5001)

    def states(start):
        def slopes(s, x):
            return [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1]]

        return solve_ivp(slopes, (10, 15), start, "DOP853", t, rtol=1e-10, atol=1e-10).y

    gaps = states([0.3, 0.0]) - states(PENDULUM.x0)
    expected = math.sqrt(np.mean(np.sum(gaps * gaps, axis=0)))
    assert printed_loss(PENDULUM, true, "ga") == pytest.approx(expected, rel=5e-3)
    assert trajectory_losses(PENDULUM, [true], start=[0.3, 0.0]) == [
        printed_loss(PENDULUM, true, "ga")
    ]


def test_sindy_counts_all_states_and_the_others_two():
    """The cart-pole's four states count for SINDy; position and angle for the others."""
    assert compared_states(CART_POLE, "SINDy") == ("w", "x", "y", "z")
    assert compared_states(CART_POLE, "dynaifeynman") == ("w", "x")
    expr = parse("-2*w")
    assert printed_loss(CART_POLE, expr, "sindy") == trajectory_loss(CART_POLE, expr)
    assert printed_loss(CART_POLE, expr, "ga") < printed_loss(CART_POLE, expr, "sindy")


@pytest.mark.parametrize("text", ["y^3 + 1000*x", "log(-y)", "exp(exp(y))", "-1/sqrt(y)"])
def test_a_diverging_equation_has_infinite_loss(text):
    """Blow-ups and left domains are a loss, not an exception."""
    score = score_as_printed(LOTKA_VOLTERRA, [parse(text)], "ga")[0]
    assert score.trajectory_loss == math.inf and score.printed_loss == math.inf


def test_many_equations_score_as_each_alone():
    """Duplicates and company change no score."""
    exprs = [parse(text) for text in ("-y*(3-x)", "x-3", "y^3+1000*x", "x-3", "2.5*x*y-y")]
    together = score_as_printed(LOTKA_VOLTERRA, exprs, "GA")
    for expr, score in zip(exprs, together, strict=True):
        assert score.expr == expr
        alone = score_as_printed(LOTKA_VOLTERRA, [expr], "GA")[0]
        assert score.equation_rmse == alone.equation_rmse
        assert score.trajectory_loss == pytest.approx(alone.trajectory_loss, rel=1e-6)
        assert score.printed_loss == pytest.approx(alone.printed_loss, rel=1e-6)


@pytest.mark.parametrize("system", PAPER_SYSTEMS, ids=lambda s: s.name)
def test_one_call_gives_what_the_three_functions_give(system):
    """score_as_printed and the single functions are the same definitions."""
    expr = parse(f"0.5*{system.states[0]} - {system.states[-1]}")
    assert score_as_printed(system, [expr], "DynAIFeynman")[0].losses == {
        "equation_rmse": equation_rmse(system, expr),
        "printed_loss": printed_loss(system, expr, "DynAIFeynman"),
        "trajectory_loss": trajectory_loss(system, expr),
    }


def test_another_target_can_be_scored():
    """The first equation is altered, the last kept."""
    score = score_as_printed(LOTKA_VOLTERRA, [LOTKA_VOLTERRA.rhs[0]], "ga", target="x")[0]
    assert (score.trajectory_loss, score.printed_loss, score.target) == (0, 0, "x")
    assert equation_rmse(LOTKA_VOLTERRA, parse("1.0 + x*(1.5 - y)"), target="x") == pytest.approx(1)


def test_an_unknown_name_is_refused():
    """An expression in a variable that the system lacks is named."""
    with pytest.raises(InputError, match="unknown name 'q'"):
        score_expressions(PENDULUM, [parse("q + 1")], "ga")


def test_a_true_system_without_a_solution_is_refused():
    """Nothing can be compared with a truth that blows up."""
    system = System.from_strings({"x": "x^2"}, x0=[1.0], test=(0.0, 2.0))
    with pytest.raises(EngineError, match="itself has no solution"):
        trajectory_loss(system, parse("x"))


TWO_STATES = {"theta1": "theta2", "theta2": "-9.81*sin(theta1) - 0.1*theta2"}
NAMESAKES = (
    System.from_strings(TWO_STATES, x0=[1.0, 0.0], name="pendulum"),
    System.from_strings({**TWO_STATES, "u": "-u"}, x0=[1.0, 0.0, 1.0], name="pendulum"),
    replace(PENDULUM, test=(0.0, 1.0)),
)


@pytest.mark.parametrize("system", [*NAMESAKES, LORENZ], ids=lambda s: f"{s.name}{len(s.states)}")
def test_the_printed_loss_is_the_papers_systems_alone(system):
    """A system that only has the name of one of the paper's has no printed loss, and works."""
    assert not is_of_paper(system)
    score = score_as_printed(system, [system.rhs[-1]], "ga")[0]
    assert score.losses == {"equation_rmse": 0, "trajectory_loss": 0}
    with pytest.raises(InputError, match=r"not one of the paper's own.*cart-pole") as caught:
        printed_loss(system, system.rhs[-1], "ga")
    assert "\n" not in str(caught.value)


def test_a_paper_system_is_known_in_another_process():
    """A copy that was sent to a worker is still the paper's."""
    for system in PAPER_SYSTEMS:
        copy = pickle.loads(pickle.dumps(system))
        assert copy is not system and find_protocol(copy) is find_protocol(system)
