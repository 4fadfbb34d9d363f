import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError
from dynsr.expression import free_constants
from dynsr.expression.parsing import parse
from dynsr.fit.flow import Flow, cut_windows
from dynsr.fit.shooting import Shooting, build_shooting, match_trajectories, prepare


def lotka_volterra(noise=0.0, rows=601, seed=0):
    """Give predators and prey, solved by scipy, with noise relative to each state."""
    t = np.linspace(0, 6, rows)
    exact = solve_ivp(
        lambda t, u: [u[0] * (1.5 - u[1]), -u[1] * (3 - u[0])],
        (0, 6),
        [1.0, 1.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-12,
    ).y.T
    random = np.random.default_rng(seed).normal(size=exact.shape)
    return Trajectory(t, exact + noise * exact.std(axis=0) * random, ("x", "y"))


ROUGH = {"x": parse("1.4*x - 0.9*x*y"), "y": parse("-3.2*y + 1.1*x*y")}
TRUE = {"x": (1.5, -1.0), "y": (-3.0, 1.0)}


def constants(match):
    """Give the constants of every state, sorted."""
    return {s: sorted(v for v, _ in pairs) for s, pairs in match.errors.items()}


def test_constants_of_clean_data_are_exact():
    """On clean data the fitted constants are the true ones, far beyond what differences give."""
    found = constants(match_trajectories(ROUGH, lotka_volterra()))
    for state, true in TRUE.items():
        assert found[state] == pytest.approx(sorted(true), abs=1e-6)


def test_standard_errors_cover_the_truth_under_noise():
    """With 1 % noise every constant lies within four of its standard errors, and within 1 %."""
    match = match_trajectories(ROUGH, lotka_volterra(noise=0.01))
    for state, true in TRUE.items():
        pairs = sorted(match.errors[state])
        for (value, error), exact in zip(pairs, sorted(true), strict=True):
            assert abs(value - exact) < 4 * error
            assert abs(value - exact) < 0.01 * abs(exact)
            assert error < 0.01


def test_outliers_do_not_move_the_constants():
    """A few wild rows leave the constants where they were (heavy-tailed loss)."""
    clean = lotka_volterra(noise=0.002)
    x = clean.x.copy()
    x[50::100] += 1.0
    found = constants(match_trajectories(ROUGH, Trajectory(clean.t, x, clean.states)))
    for state, true in TRUE.items():
        assert found[state] == pytest.approx(sorted(true), rel=0.01)


def test_inputs_are_driven_by_expression_or_by_data():
    """A known force gives the same constants whether handed as an expression or as a column."""
    t = np.linspace(0, 8, 801)
    force = np.sin(2 * t)
    x = solve_ivp(
        lambda t, u: [u[1], -2 * u[0] - 0.3 * u[1] + 0.7 * np.sin(2 * t)],
        (0, 8),
        [1.0, 0.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-12,
    ).y.T
    rough = {"q": parse("v"), "v": parse("-1.8*q - 0.2*v + 0.5*F")}
    column = Trajectory(t, x, ("q", "v"), force[:, None], ("F",))
    by_column = constants(match_trajectories(rough, column))
    by_expression = constants(
        match_trajectories(rough, Trajectory(t, x, ("q", "v")), inputs={"F": parse("sin(2*t)")})
    )
    assert by_column["v"] == pytest.approx([-2.0, -0.3, 0.7], abs=1e-5)
    assert by_expression["v"] == pytest.approx([-2.0, -0.3, 0.7], abs=1e-6)


def test_one_state_alone_reads_the_others_from_the_data():
    """An equation can be matched while the other states are read from the data."""
    match = match_trajectories({"y": ROUGH["y"]}, lotka_volterra())
    assert constants(match)["y"] == pytest.approx([-3.0, 1.0], abs=1e-5)


def test_whole_numbers_stay():
    """Integers and rationals are structure: only floats are fitted."""
    match = match_trajectories(
        {"x": parse("1.4*x - x*y"), "y": parse("-3*y + x*y")}, lotka_volterra()
    )
    assert match.exprs["y"] == parse("-3*y + x*y")
    assert constants(match)["x"] == pytest.approx([1.5], abs=1e-6)


def test_a_diverging_start_is_handed_back():
    """Equations that explode at once are given back untouched and marked as failed."""
    wild = {"x": parse("exp(50.0*x*x*y)"), "y": ROUGH["y"]}
    match = match_trajectories(wild, lotka_volterra())
    assert not match.success
    assert match.exprs == wild


def test_an_unknown_state_is_named():
    """A state that the data do not hold is an input error that lists the states."""
    with pytest.raises(InputError, match="unknown state 'q'; the states are: x, y"):
        match_trajectories({"q": parse("1.0*x")}, lotka_volterra())


def test_sensitivities_equal_finite_differences():
    """The slopes by constants and starts are those of the integrated states themselves."""
    data = lotka_volterra()
    exprs, symbols, values = {}, [], []
    for state, expr in ROUGH.items():
        exprs[state], found = free_constants(expr, f"c{state}")
        symbols += found
        values += found.values()
    flow = Flow(exprs, (), tuple(symbols))
    windows = cut_windows([data.t], [data.x], [lambda t: t[None]], 20, 400)
    shooting = Shooting(flow, windows, np.ones(2), True)
    point, starts = np.array(values), windows.x[0]
    _, by_constant, by_start = shooting.linearise(point, starts)
    step = 1e-6
    for j in range(len(point)):
        move = step * np.eye(len(point))[j]
        up, down = shooting.misses(point + move, starts), shooting.misses(point - move, starts)
        slope = ((up - down) / (2 * step)).transpose(2, 0, 1).reshape(len(by_constant), -1)
        assert np.allclose(by_constant[..., j], slope, atol=1e-7)
    shift = step * np.array([[1.0], [0.0]])
    up, down = shooting.misses(point, starts + shift), shooting.misses(point, starts - shift)
    slope = ((up - down) / (2 * step)).transpose(2, 0, 1).reshape(len(by_start), -1)
    assert np.allclose(by_start[..., 0], slope, atol=1e-7)


def test_from_measured_starts_steps_converge_quadratically():
    """Four steps from constants some percent off end within a millionth of the truth."""
    flow, values, _ = prepare(ROUGH, [lotka_volterra()], {})
    shooting = build_shooting(flow, [lotka_volterra()], {}, 10, free=False)
    found, _ = shooting.minimise(np.array(values), shooting.windows.x[0], "linear", most=4)
    true = [*TRUE["x"], *TRUE["y"]]
    assert sorted(found) == pytest.approx(sorted(true), rel=1e-6)


def test_free_constants_keep_the_structure():
    """Every float becomes a symbol of its own; whole exponents and rationals stay."""
    template, values = free_constants(parse("2.5*x**2.0 + x/3 + sin(2.5*x)"), "c")
    assert sorted(values.values()) == [2.5, 2.5]
    assert template.subs(values) == sympy.sympify(parse("2.5*x**2 + x/3 + sin(2.5*x)"))


@pytest.mark.slow
def test_standard_errors_are_as_large_as_the_spread_of_the_constants():
    """Over 60 draws of Gaussian noise the stated error is the constants' spread, to a fifth."""
    t, rng = np.linspace(0.0, 8.0, 161), np.random.default_rng(0)
    fits = []
    for _ in range(60):
        x = np.exp(-0.5 * t) + 1.0 + rng.normal(0.0, 0.02, len(t))
        run = Trajectory(t, x[:, None], ("x",))
        fits.append(match_trajectories({"x": parse("0.5 - 0.5*x")}, [run]).errors["x"])
    values, errors = np.array(fits).transpose(2, 0, 1)
    ratio = values.std(axis=0, ddof=1) / errors.mean(axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)
