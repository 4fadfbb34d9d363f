import math

import numpy as np
import pytest
import sympy

from dynsr.data.system import CART_POLE, LORENZ, LOTKA_VOLTERRA, PENDULUM
from dynsr.engines.base import InitialValueProblem
from dynsr.engines.tsit5.batch import lane_slopes, solve_batch
from dynsr.engines.tsit5.groups import fill_form, solve_all, split_numbers
from dynsr.engines.tsit5.single import solve
from dynsr.errors import InputError
from dynsr.expression.parsing import parse


def one_equation(text: str, x0: float, t, **settings) -> InitialValueProblem:
    """Pose dx/dt = text."""
    return InitialValueProblem((parse(text, ["x", "t"]),), ("x",), [x0], t, **settings)


@pytest.mark.parametrize("system", [LOTKA_VOLTERRA, PENDULUM, CART_POLE], ids=lambda s: s.name)
def test_many_starts_at_once_equal_each_alone(system):
    """Every lane takes the accepted and rejected steps that it would take alone."""
    rng = np.random.default_rng(0)
    starts = np.array(system.x0) * (1 + 0.3 * rng.random((20, len(system.x0))))
    t = np.linspace(10.0, 15.0, 101)
    batch = solve_batch(lane_slopes(system.closed_rhs(), system.states), starts, t)
    for lane, start in enumerate(starts):
        alone = solve(InitialValueProblem(system.closed_rhs(), system.states, start, t))
        assert batch.accepted[lane] == alone.accepted
        assert batch.rejected[lane] == alone.rejected
        # The last bit of a single-precision power may differ between numpy and the C library.
        assert np.abs(batch.x[lane] - alone.x).max() < 1e-6


def test_many_equations_of_one_form_equal_each_alone():
    """Right-hand sides that differ in their numbers share lanes and keep their own answers."""
    rng = np.random.default_rng(1)
    problems = []
    for a, b, c in rng.uniform(0.5, 2.0, (12, 3)):
        rhs = (parse(f"x*({a} - y)"), parse(f"-y*({b} - {c}*x)"))
        problems.append(InitialValueProblem(rhs, ("x", "y"), [1.0, c], [0.0, 1.0, 5.0]))
    for problem, found in zip(problems, solve_all(problems), strict=True):
        alone = solve(problem)
        assert found.accepted == alone.accepted
        assert np.abs(found.x - alone.x).max() < 1e-6


def test_mixed_forms_come_back_in_order():
    """Problems of different forms, times and tolerances each get their own answer."""
    problems = [one_equation(f"-{rate}*x", 1.0, [0.0, 1.0], reltol=1e-9) for rate in (1.5, 2.5)] * 4
    problems[3:3] = [one_equation("cos(t)", 0.0, [0.0, 2.0], reltol=1e-9)]
    ends = [found.x[-1, 0] for found in solve_all(problems)]
    expected = [math.exp(-1.5), math.exp(-2.5)] * 4
    expected[3:3] = [math.sin(2.0)]
    assert np.allclose(ends, expected, rtol=1e-4)


def test_lanes_that_diverge_leave_the_others_alone():
    """Blow-ups and left domains are NaN in their own lanes only."""
    t = np.linspace(0.0, 1.0, 11)
    problems = [one_equation(f"{c}*x^2", 1.0, t) for c in (0.1, 0.2, 0.3, 0.4, 2.1, 50.0, 1e9)]
    answers = solve_all(problems)
    assert [found.success for found in answers] == [True] * 4 + [False] * 3
    for c, found in zip((0.1, 0.2, 0.3, 0.4), answers, strict=False):
        assert np.allclose(found.x[:, 0], 1 / (1 - c * t), rtol=1e-3)
    # 2.1 x^2 blows up at t = 1 / 2.1.
    assert np.isfinite(answers[4].x[:5]).all() and np.isnan(answers[4].x[5:]).all()
    assert "diverged" in answers[4].message


def test_a_lane_that_needs_many_steps_is_finished_alone():
    """A stiff lane among easy ones meets its own step limit, the easy ones are unharmed."""
    rates = (1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1e9)
    problems = [one_equation(f"-{r}*(x - cos(t))", 2.0, [0.0, 1.0], max_steps=900) for r in rates]
    *easy, stiff = solve_all(problems)
    assert all(found.success for found in easy)
    assert not stiff.success and stiff.accepted + stiff.rejected == 900


def test_a_slow_lane_gets_its_full_answer():
    """More steps than are taken together are still taken."""
    rates = (1.1, 1.2, 1.3, 1.4, 1.5, 3000.1)
    problems = [one_equation(f"-{r}*(x - cos(t))", 1.0, [0.0, 1.0]) for r in rates]
    slow = solve_all(problems)[-1]
    assert slow.success and slow.accepted > 300
    assert slow.x[-1, 0] == pytest.approx(math.cos(1.0), abs=2e-3)


def test_lanes_without_a_value_at_the_start_are_a_result():
    """log of a negative start has no slope; the other lanes go on."""
    batch = solve_batch(
        lane_slopes([parse("log(x)")], ["x"]), np.array([[2.0], [-1.0]]), np.array([0.0, 1.0])
    )
    assert batch.success.tolist() == [True, False]
    assert np.isnan(batch.x[1, 1:]).all()


def test_an_empty_list_has_no_answers():
    """No problems, no answers."""
    assert solve_all([]) == []


def test_shapes_that_do_not_fit_are_refused():
    """Starts must be one row a lane, and times increase."""
    slopes = lane_slopes([parse("x")], ["x"])
    with pytest.raises(InputError, match="lanes, states"):
        solve_batch(slopes, np.array([1.0]), np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="increasing times"):
        solve_batch(slopes, np.array([[1.0]]), np.array([0.0, 0.0]))


@pytest.mark.parametrize(
    "text",
    ["1.5*x + 2.5*y^2 - 0.1", "sin(2.1*x)*sin(3.1*x)", "x^2.5/(1.5 + y)", "3*x - 1/2", "0.5", "x"],
)
def test_a_form_filled_with_its_own_numbers_is_the_expression(text):
    """Splitting loses nothing."""
    expr = parse(text)
    form, numbers = split_numbers(expr)
    filled = fill_form(form, iter([sympy.Float(n) for n in numbers]))
    point = {"x": 0.7, "y": 0.4}
    assert float(filled.subs(point)) == pytest.approx(float(expr.subs(point)), rel=1e-15)


def test_the_order_of_terms_does_not_split_a_form():
    """Equal monomials with other coefficients are one form, exact integers stay in it."""
    one, two = parse("0.3*x*y - 9.1*x^2 + 4*y"), parse("-7.7*x^2 + 4*y + 12.5*x*y")
    assert split_numbers(one)[0] == split_numbers(two)[0]
    assert split_numbers(one)[0] != split_numbers(parse("0.3*x*y - 9.1*x^2 + 5*y"))[0]


def test_chaos_is_reproducible_in_a_batch():
    """The same batch gives the same bits twice."""
    starts = np.array(LORENZ.x0) + np.arange(8)[:, None] * 0.1
    slopes, t = lane_slopes(LORENZ.closed_rhs(), LORENZ.states), np.linspace(0.0, 10.0, 101)
    assert (solve_batch(slopes, starts, t).x == solve_batch(slopes, starts, t).x).all()
