"""Free parts: functions of one column that known equations leave open."""

from __future__ import annotations

import json
import pickle
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline

from dynsr import Discovery, DiscoverySettings, InputError, Trajectory, discover, load
from dynsr.discovery.free_model import finish_model, has_free, read_model
from dynsr.expression import (
    Curve,
    compile_columns,
    compile_numpy,
    compile_scalar,
    differentiate,
    evaluate,
    parse,
    to_text,
    write_out,
)
from dynsr.fit import (
    CurvedSystem,
    MixedMesh,
    Part,
    Slopes,
    fit_curved,
    measure_runs,
)
from dynsr.fit.curved import place_knots
from dynsr.parameters import FreePart, FreeParts, FreeSettings
from tests.command_line import run

X, Y = sympy.symbols("x y")
KNOTS = np.array([0.0, 0.4, 1.1, 1.5, 2.6, 3.0])
WAVE = Curve("f", KNOTS, np.sin(2 * KNOTS))


def follow(slopes, start, end, rows, noise, seed, names, drive=None):
    """Give a trajectory of an exact solution, with noise as a share of the spread."""
    t = np.linspace(0, end, rows)
    x = solve_ivp(slopes, (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12, max_step=0.2).y.T
    x = x + noise * x.std(axis=0) * np.random.default_rng(seed).normal(size=x.shape)
    if drive is None:
        return Trajectory(t, x, names)
    return Trajectory(t, x, names, inputs=drive(t)[:, None], input_names=("u",))


def hunt(noise=0.0, seed=0, rows=200):
    """Give predators that eat 1.2 x/(0.5 + x) of the prey (Holling's second kind)."""

    def slopes(_, z):
        eaten = 1.2 * z[0] / (0.5 + z[0]) * z[1]
        return [z[0] * (1 - z[0] / 3) - eaten, eaten / 1.2 - 0.5 * z[1]]

    return follow(slopes, [1.0, 0.5], 40, rows, noise, seed, ("x", "y"))


def circuit(noise=0.0, seed=0):
    """Give a driven circuit with the cubic characteristic of a tunnel diode."""

    def drive(t):
        return 0.5 + 0.3 * np.sin(0.37 * t)

    def slopes(t, z):
        current = z[0] ** 3 / 3 - z[0]
        return [drive(t) - current - z[1], 0.08 * (z[0] + 0.7 - 0.8 * z[1])]

    return follow(slopes, [-1.0, 0.5], 100, 500, noise, seed, ("v", "w"), drive)


def swing(noise=0.0, seed=0):
    """Give an oscillator whose friction is nearly the same at all speeds."""

    def slopes(_, z):
        return [z[1], -4 * z[0] - 0.4 * np.tanh(2 * z[1])]

    return follow(slopes, [3.0, 0.0], 12, 400, noise, seed, ("x", "v"))


def bumps(x):
    """Give a function that is no formula of the library."""
    return 0.2 + np.exp(-(((x - 1.2) / 0.25) ** 2)) + 0.4 * np.exp(-(((x - 2.2) / 0.3) ** 2))


def tank(noise=0.0, seed=0):
    """Give a driven state that decays at a rate of two bumps."""

    def drive(t):
        return 1.5 + 1.2 * np.sin(0.3 * t)

    def slopes(t, z):
        return [drive(t) - bumps(z[0]) * z[0] - 0.5 * z[0]]

    return follow(slopes, [1.0], 80, 500, noise, seed, ("x",), drive)


HUNT = {"x": "r*x*(1 - x/k) - f(x)*y", "y": "b*f(x)*y - c*y"}
CIRCUIT = {"v": "u - i(v) - w", "w": "e*(v + a - b*w)"}
TANK = {"x": "u - 0.5*x - f(x)*x"}


@cache
def found_in_tank() -> Discovery:
    """Give the discovery of a function that stays a curve."""
    return discover(tank(0.02), known=TANK, jobs=1)


@cache
def found_in_hunt(noise):
    """Give the discovery of a function that two equations share."""
    return discover(hunt(noise), known=HUNT, jobs=1)


# --- curves ------------------------------------------------------------------------------------


def test_a_curve_is_the_natural_spline_and_a_line_beyond_it():
    """Between its knots it is SciPy's natural cubic spline; its line beyond has the same slope."""
    x = np.linspace(0, 3, 61)
    plain = CubicSpline(KNOTS, WAVE.values, bc_type="natural")
    np.testing.assert_allclose(WAVE(x), plain(x), atol=1e-13)
    np.testing.assert_allclose(WAVE(4.0), plain(3.0) + plain(3.0, 1), atol=1e-12)
    np.testing.assert_allclose(WAVE.weights(np.array([-1.0, 1.0])) @ WAVE.values, WAVE([-1.0, 1.0]))


def test_roughness_is_the_integral_of_the_squared_second_derivative():
    """The quadratic form of the values is what quadrature gives, and 0 for lines."""
    plain = CubicSpline(KNOTS, WAVE.values, bc_type="natural")
    pieces = [quad(lambda t: plain(t, 2) ** 2, a, b)[0] for a, b in pairwise(KNOTS)]
    assert WAVE.values @ WAVE.roughness @ WAVE.values == pytest.approx(sum(pieces), rel=1e-9)
    line = 2 * KNOTS - 1
    assert abs(line @ WAVE.roughness @ line) < 1e-12


def test_a_curve_in_an_expression_is_evaluated_in_every_way_alike():
    """Node by node, compiled, for floats, as a program, and written out: the same numbers."""
    expr = 2 - WAVE.function(X) * Y
    x, y = np.linspace(-1, 4, 31), np.linspace(1, 2, 31)
    truth = 2 - WAVE(x) * y
    for values in (
        evaluate(expr, {"x": x, "y": y}),
        compile_numpy([expr], ["x", "y"])(np.array([x, y]))[0],
        compile_columns([expr], ["x", "y"])(x, y)[0],
        [compile_scalar([expr], ["x", "y"])(*pair)[0] for pair in zip(x, y, strict=True)],
        evaluate(write_out(expr), {"x": x, "y": y}),
    ):
        np.testing.assert_allclose(values, truth, atol=1e-11)


def test_a_curve_has_a_derivative_and_survives_text_and_pickle():
    """The slope is that of differences; text read with the curve, and a pickle, are the same."""
    expr = 2 - WAVE.function(X) * X
    x, step = np.linspace(0.05, 2.9, 41), 1e-6
    around = [evaluate(expr, {"x": x + own}) for own in (step, -step)]
    slopes = evaluate(differentiate(expr, X), {"x": x})
    np.testing.assert_allclose(slopes, (around[0] - around[1]) / (2 * step), atol=1e-7)
    assert parse(to_text(expr), functions={"f": WAVE.function}) == expr
    again = pickle.loads(pickle.dumps(expr))
    assert again == expr
    np.testing.assert_array_equal(evaluate(again, {"x": x}), evaluate(expr, {"x": x}))
    other = WAVE.with_values(WAVE.values + 1)
    assert other.function(X) != WAVE.function(X)


@pytest.mark.parametrize(
    ("knots", "values"),
    [([0, 1], [0, 1]), ([0, 1, 1], [0, 1, 2]), ([0, 1, 2], [0, np.nan, 1]), ([0, 1, 2], [0, 1])],
)
def test_a_curve_of_wrong_numbers_is_refused(knots, values):
    """Too few knots, knots that do not increase, and values that are not finite."""
    with pytest.raises(InputError, match="the curve 'f'"):
        Curve("f", np.array(knots, dtype=float), np.array(values, dtype=float))


# --- reading -----------------------------------------------------------------------------------


def test_known_equations_are_read():
    """Names that are no columns are constants, unknown functions are free, and shared by name."""
    model = read_model(HUNT, ["x", "y"], ["x", "y", "t"])
    assert model.constants == ("b", "c", "k", "r")
    assert [(part.name, part.of) for part in model.parts] == [("f", "x")]
    assert all(model.contains(state, model.parts[0]) for state in ("x", "y"))
    given = {"x": sympy.Symbol("a") - sympy.Function("f")(X) * Y}
    assert has_free(given)
    assert not has_free({"x": "a - exp(x)"})
    assert read_model(given, ["x"], ["x", "y", "t"]).constants == ("a",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("f(x, y)", r"'f\(x, y\)' in known of 'x' has 2 arguments; a free function has one column"),
        ("f()", "has 0 arguments"),
        ("f(2*x)", "is a function of a formula; give a free function one column"),
        ("f(sin(x))", "is a function of a formula"),
        ("f(g(x))", "is a function of a formula"),
        ("f(3)", "is a function of a formula"),
        ("f(q)", r"is a function of 'q', which is no column; the columns are: x, y, t"),
        ("y(x)", r"calls the column 'y'; write y\*\(\.\.\.\), or rename it"),
        ("f(x) + f(y)", "give the second one another name"),
        ("f(x) + f", "is a function and a constant in known; rename one of them"),
        ("f(x) + g(x)", "leave one function free"),
        ("sine(x)", "'sine' in known of 'x' is written nearly as sin; correct it"),
        ("log10(x)", "is written nearly as log; correct it"),
        ("erf(x)", "is a function that formulas do not have; correct it, or give the free"),
        ("f(x) + log(-1 - x**2)", "finite"),
    ],
)
def test_what_cannot_be_free_is_refused_in_one_line(text, said):
    """The line names what is wrong and the remedy."""
    data = {"t": np.linspace(0, 5, 40), "x": np.linspace(1, 2, 40), "y": np.linspace(2, 1, 40)}
    with pytest.raises(InputError, match=said) as refused:
        discover(data, known={"x": text, "y": "-y"}, jobs=1)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "option",
    [
        {"order": 2},
        {"delays": True},
        {"vary": True},
        {"must": {"x": "x"}},
        {"loss": "absolute"},
        {"ensemble": True},
        {"discrete": True},
    ],
)
def test_options_that_do_not_go_with_a_free_function_are_refused(option):
    """Each is named."""
    (name,) = option
    runs = [hunt(rows=40)] * 2 if name == "vary" else hunt(rows=40)
    with pytest.raises(InputError, match=f"^{name} does not go with a free function in known"):
        discover(runs, known=HUNT, jobs=1, **option)


@pytest.mark.slow
def test_a_function_of_a_column_that_does_not_change_is_refused():
    """Fewer than three values of a column show no function."""
    still = hunt(rows=40)
    x = np.column_stack([still.x, np.ones(40)])
    with pytest.raises(InputError, match="fewer than three values"):
        discover(Trajectory(still.t, x, ("x", "y", "z")), known={"x": "f(z) - x"}, jobs=1)


# --- what can be known -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("known", "fixed", "means"),
    [
        ({"x": "a - f(x)"}, {"a": 0.0}, [None]),
        ({"x": "a*f(x)*y"}, {"a": 1.0}, [None]),
        ({"x": "a*x - f(x)"}, {"a": 0.0}, [None]),
        ({"x": "a*(b - f(x))*y"}, {"a": 1.0, "b": 0.0}, [None]),
        ({"x": "a - f(x)*y"}, {}, [None]),
        (HUNT, {}, [None]),
        ({"x": "f(x) + g(y)"}, {}, [None, 0.0]),
        ({"x": "f(x)*g(y)"}, {}, [None, 1.0]),
        ({"x": "-f(x)*y", "y": "f(x)*g(y)"}, {}, [None, None]),
    ],
)
def test_what_exact_data_cannot_determine_is_fixed_and_said(known, fixed, means):
    """A constant becomes 0, or 1 where the function would vanish; of two functions one mean is."""
    model = read_model(known, ["x", "y"], ["x", "y", "t"])
    columns = {name: np.linspace(0.5, 3, 20) for name in ("x", "y", "t")}
    settled = finish_model(model, columns, np.random.default_rng(1))
    assert dict(settled.fixed) == fixed
    assert [part.mean for part in settled.parts] == means
    assert len(settled.notes) == len(fixed) + sum(mean is not None for mean in means)
    for name in fixed:
        assert any(note.startswith(f"{name} cannot be known: ") for note in settled.notes)


# --- the fit of curves -------------------------------------------------------------------------


@pytest.mark.slow
def test_a_line_is_fitted_as_a_line():
    """Over five draws bending costs so much that two parameters are left, as a median."""
    effective, part = [], Part("f", "x")
    places, t = np.linspace(2.1, 2.9, 9), np.linspace(0, 6, 80)
    for seed in range(5):
        x = 2 + np.exp(-0.5 * t) + 0.01 * np.random.default_rng(seed).normal(size=80)
        data = measure_runs([Trajectory(t, x[:, None], ("x",))], {}, 500, {})
        rows, smooth = MixedMesh.of(data, ("x",)), data.smoothed[0]
        slopes = Slopes({"x": smooth.x[:, 0], "t": t}, smooth.slope.T, smooth.slope_sd.T)
        fit = fit_curved(CurvedSystem({"x": part.symbol}, (), (part,)), rows, slopes)
        effective.append(fit.effective[1])
        weights = fit.curves[0].weights(places)
        errors = np.sqrt(np.einsum("nk,kl,nl->n", weights, fit.covariance, weights))
        assert np.all(np.abs(fit.curves[0](places) - (1 - places / 2)) < 3 * errors)
        assert np.all(errors < 0.05)
    assert np.median(effective) == pytest.approx(2.0, abs=0.05)


def test_the_slopes_by_constants_and_curves_are_those_of_differences():
    """What the first fit follows is the derivative of the equations, also where sizes have one."""
    model = read_model({"x": "a*f(x)*y^2 - b*abs(x)", "y": "exp(-b)*f(x)"}, ["x", "y"], ["x", "y"])
    system = CurvedSystem(model.equations, model.constants, model.parts)
    t = np.linspace(0.1, 2, 40)
    run_ = Trajectory(t, np.column_stack([np.cos(t), np.sin(t)]), ("x", "y"))
    mesh = MixedMesh.of(measure_runs([run_], {}, 99, {}), ("x", "y")).mesh
    program, columns = system.program(mesh), [np.array([-0.5, 0.7]), np.array([1.1, 0.3])]
    columns += [np.zeros(2)] * len(mesh.driven_names)
    numbers = np.array([0.9, 0.4, 1.3])
    moves = 1e-6 * np.eye(3)
    differences = [
        (program(*columns, *numbers + m) - program(*columns, *numbers - m)) / 2e-6 for m in moves
    ]
    found = system.by_numbers(mesh)(*columns, *numbers).reshape(2, 3, 2)
    np.testing.assert_allclose(found.swapaxes(0, 1), differences, atol=1e-8)


# --- whole discoveries -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_function_that_two_equations_share_is_found(noise):
    """Holling's response without noise and at 5 %; the intervals contain the true constants."""
    found = found_in_hunt(noise)
    assert found.verdict.level == "law"
    law = found.free["f"].law
    assert law.as_numer_denom()[1].has(X)
    x = np.linspace(0.1, 2.5, 20)
    near = 1e-4 if noise == 0 else 0.02
    np.testing.assert_allclose(found.free["f"](x), 1.2 * x / (0.5 + x), rtol=near)
    truth = {"r": 1.0, "k": 3.0, "b": 1 / 1.2, "c": 0.5}
    assert found.free.constants.keys() == truth.keys()
    for name, own in found.free.constants.items():
        assert own.low <= truth[name] <= own.high
    assert "f(x) = " in str(found)
    assert not any(expr.has(sympy.core.function.AppliedUndef) for expr in found.equations.values())


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_characteristic_in_a_driven_circuit_is_found(noise):
    """A cubic without noise and at 5 %."""
    found = discover(circuit(noise), known=CIRCUIT, jobs=1)
    assert found.verdict.level == "law"
    law = sympy.expand(found.free["i"].law)
    v = sympy.Symbol("v")
    assert set(law.as_coefficients_dict(v)) == {v, v**3}
    assert float(law.coeff(v, 3)) == pytest.approx(1 / 3, abs=0.02)
    assert float(law.coeff(v, 1)) == pytest.approx(-1, abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "near"), [(0.0, 1e-6), (0.05, 0.3)])
def test_friction_is_found_or_stays_a_curve(noise, near):
    """Clean data give tanh; under noise a formula or a curve near it, and no wrong law."""
    found = discover(swing(noise), known={"x": "v", "v": "-k*x - f(v)"}, jobs=1)
    v = np.linspace(-5, 5, 40)
    assert np.sqrt(np.mean((found.free["f"](v) - 0.4 * np.tanh(2 * v)) ** 2)) < 0.4 * near
    constant = found.free.constants["k"]
    assert constant.low <= 4 <= constant.high
    if noise == 0:
        assert found.verdict.level == "law"
        assert found.free["f"].law.has(sympy.tanh)
    else:
        assert found.verdict.level == "approximation"


@pytest.mark.slow
def test_what_no_formula_describes_stays_a_curve():
    """The verdict says so, and the equation contains the function."""
    found = found_in_tank()
    part = found.free["f"]
    assert part.is_curve
    assert not part.formula
    assert found.verdict.level == "approximation"
    assert "f(x) is a curve and no formula" in found.verdict.reason
    assert "takes" in found.explanation["x"]
    assert "f(x)" in str(found.equations["x"])
    low, high = part.span
    x = np.linspace(low, high, 100)
    assert np.max(np.abs(part(x) - bumps(x))) < 0.08
    assert min(part.bits.values()) > 0
    assert len(part.points) > 100


@pytest.fixture
def untested(monkeypatch):
    """Leave out the verdict, which takes most of the time and comes after the bands."""
    monkeypatch.setattr("dynsr.discovery.free._tested", lambda found, *_: found)


@pytest.mark.slow
@pytest.mark.usefixtures("untested")
def test_a_band_contains_the_truth_as_often_as_it_says():
    """Over six draws of 5 % noise, from 90 % to 98 % of evenly spaced points are inside."""
    settings = DiscoverySettings(free=FreeSettings(fitted=0))
    shares = []
    for seed in range(6):
        known = {"known": TANK, "settings": settings, "preset": "quick"}
        found = discover(tank(0.05, seed), jobs=1, **known)
        part = found.free["f"]
        x = np.linspace(*part.span, 200)
        low, high = part.band(x)
        shares.append(np.mean((low <= bumps(x)) & (bumps(x) <= high)))
    assert 0.90 <= np.mean(shares) <= 0.98


@pytest.mark.slow
@pytest.mark.usefixtures("untested")
def test_a_band_counts_that_the_cost_of_bending_is_an_estimate():
    """Curves drawn from what is believed of them, 5 % noise: 90 % to 98 % of points are inside.

    With the best cost alone too few are.
    """
    settings, shares = DiscoverySettings(free=FreeSettings(fitted=0)), []
    for seed in range(10):
        drawn = np.cumsum(np.cumsum(np.random.default_rng(20_000 + seed).normal(size=281)))
        v = np.linspace(-7, 7, 281)
        drawn -= np.polyval(np.polyfit(v, drawn, 1), v)
        truth = CubicSpline(v, 0.1 * v + 0.4 * drawn / np.std(drawn))
        run = follow(
            lambda _, z, f=truth: [z[1], -4 * z[0] - f(z[1])],
            [3.0, 0.0],
            12,
            400,
            0.05,
            seed,
            ("x", "v"),
        )
        known = {"x": "v", "v": "-k*x - f(v)"}
        part = discover(run, known=known, settings=settings, jobs=1).free["f"]
        x = np.linspace(*part.span, 200)
        low, high = part.band(x)
        shares.append(np.mean((low <= truth(x)) & (truth(x) <= high)))
    assert 0.90 <= np.mean(shares) <= 0.98


@pytest.mark.slow
def test_a_discovery_with_a_curve_is_kept_and_simulated(tmp_path):
    """A saved one is the same, has the same curve, and follows the same course."""
    found = found_in_tank()
    again = load(found.save(tmp_path / "found.json"))
    assert again.equations == found.equations
    assert again.free["f"].table(7).equals(found.free["f"].table(7))
    seen = tank(0.02)
    given = {"u": seen.inputs[:, 0]}
    here, there = (one.simulate([1.0], seen.t, given).x for one in (found, again))
    np.testing.assert_array_equal(here, there)
    assert np.sqrt(np.mean((found.simulate().x - seen.x) ** 2)) < 0.03


@pytest.mark.slow
def test_a_curve_is_exported_as_a_formula():
    """Code gives the slopes of the equations; documents keep the name."""
    found = found_in_tank()
    scope: dict[str, object] = {}
    exec(found.export("python").partition("if __name__")[0], scope)
    x = np.linspace(0.3, 4, 12)
    for value in x:
        slope = scope["rhs"](0.0, np.array([value]), 1.5)[0]
        assert slope == pytest.approx(found.to_numpy()(0.0, np.array([value]), 1.5)[0], abs=1e-9)
    assert "is a curve, no formula" in found.export("c")
    assert "f(x)" in found.export("markdown")
    assert "f{\\left(x \\right)}" in found.latex()


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["profiles", "identifiability", "suggest"])
def test_what_a_curve_does_not_allow_is_refused_in_one_line(asked):
    """Profiles, identifiability and suggestions are those of formulas."""
    with pytest.raises(InputError, match=r"f\(x\) is a curve; write a formula for it in known"):
        getattr(found_in_tank(), asked)()


@pytest.mark.slow
def test_an_interrupted_search_gives_the_curve(monkeypatch, tmp_path):
    """Ctrl-C while formulas are fitted: the curve so far, without a verdict, and kept."""

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dynsr.discovery.free._Study._with_law", stop)
    found = discover(hunt(0.01), known=HUNT, jobs=1, out=tmp_path)
    assert not found.complete
    assert not found.verdict.tested
    assert found.free["f"].is_curve
    assert not load(tmp_path / "discovery.json").complete


@pytest.mark.slow
def test_a_budget_that_ends_the_search_leaves_the_curve():
    """The record says what it ended."""
    found = discover(hunt(0.01), known=HUNT, jobs=1, time_budget=0.01)
    assert found.free["f"].is_curve
    assert "free functions" in found.settings["ended_by_budget"]


@pytest.mark.slow
def test_equations_with_a_curve_are_analysed():
    """A fixed point is where the slope is 0, and the linear equation has the slope there."""
    found = found_in_tank()
    for point in found.fixed_points({"u": 1.5}):
        (x,) = point.at.values()
        assert abs(1.5 - 0.5 * x - found.free["f"](x) * x) < 1e-8
    at = found.linearise([1.0], {"u": 1.5}).A[0, 0]
    step = 1e-6
    ends = [found.to_numpy()(0.0, np.array([1.0 + own]), 1.5)[0] for own in (step, -step)]
    assert at == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


@pytest.mark.slow
def test_the_report_and_the_pictures_show_the_function(tmp_path):
    """A section with the picture, and a table of values where it stays a curve."""
    found = found_in_tank()
    page = found.report(tmp_path / "page.html").read_text("utf-8")
    assert "Free functions" in page
    assert "Values of f(x)" in page
    figure = found.free.plot()
    assert figure.axes[0].get_ylabel() == "f(x)"
    assert [own.get_label() for own in figure.axes[0].lines] == ["slopes of the data", "curve"]


@pytest.mark.slow
def test_a_state_without_an_equation_is_searched_and_fitted_too():
    """Prey alone is given; its constants are those of the fit in which both equations are."""
    found = discover(hunt(0.05), known={"x": HUNT["x"]}, jobs=1)
    assert found.verdict.level == "law"
    assert list(found.equations) == ["x", "y"]
    assert found.free.states == ("x",)
    both = found_in_hunt(0.05).free.constants
    for name, own in found.free.constants.items():
        middle = (own.low + own.high) / 2
        assert middle == pytest.approx((both[name].low + both[name].high) / 2, abs=own.error)


@pytest.mark.slow
def test_a_search_starts_from_a_formula_that_was_found_and_from_no_curve():
    """A formula is in the equations; a curve is refused in one line."""
    again = discover(hunt(0.05), start=found_in_hunt(0.05), jobs=1)
    assert again.verdict.level == "law"
    assert again.settings["methods"] == ["start"]
    with pytest.raises(InputError, match=r"a search starts from formulas, and f\(x\) is a curve"):
        discover(tank(0.02), start=found_in_tank(), jobs=1)


@pytest.mark.slow
def test_two_functions_are_found_in_turns():
    """Growth, and what predators take: the function of one column shows what the other one is."""
    known = {"x": "g(x) - h(y)*x/(0.5 + x)", "y": "b*x/(0.5 + x)*y - c*y"}
    found = discover(hunt(0.01), known=known, jobs=1)
    assert found.verdict.level == "law"
    x = np.linspace(0.1, 2.5, 20)
    np.testing.assert_allclose(found.free["g"](x), x - x**2 / 3, atol=0.01)
    np.testing.assert_allclose(found.free["h"](x), 1.2 * x, atol=0.02)
    assert any("can take up changes of each other" in note for note in found.free.notes)


def test_knots_are_apart_where_most_of_the_data_are_in_one_place():
    """A column that decays to 0 has half of its values within rounding of it."""
    knots = place_knots(10.0 * np.exp(-np.arange(60.0)), 28)
    assert np.diff(knots).min() > 10.0 / 28**2 * (1 - 1e-9)
    assert knots[[0, -1]].tolist() == [10.0 * np.exp(-59.0), 10.0]


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "size"), [(0.02, 1.0), (0.0, 1e-6)])
def test_a_growth_rate_is_found_in_one_batch(noise, size):
    """Monod's rate and the yield from biomass and substrate, in any unit, until all is eaten."""

    def slopes(_, z):
        grown = 0.6 * z[1] / (1.5 + z[1]) * z[0]
        return [grown, -grown / 0.45]

    batch = follow(slopes, [0.1, 10.0], 16, 60, noise, 1, ("X", "S"))
    batch = Trajectory(batch.t, size * batch.x, batch.states)
    found = discover(batch, known={"X": "mu(S)*X", "S": "-mu(S)*X/Y"}, jobs=1)
    assert found.verdict.level == "law"
    S = np.linspace(0.5, 9, 20)
    np.testing.assert_allclose(found.free["mu"](size * S), 0.6 * S / (1.5 + S), rtol=0.03)
    assert found.free.constants["Y"].value == pytest.approx(0.45, rel=0.01)


@pytest.mark.slow
def test_the_command_line_takes_and_shows_free_functions(tmp_path):
    """--known as in Python; the answer has the function and the constants, of counts near 1e9."""
    seen = hunt(0.01)
    table = tmp_path / "data.csv"
    rows = np.column_stack([seen.t, 1e9 * seen.x])
    np.savetxt(table, rows, delimiter=",", header="t,x,y", comments="")
    asked = [word for state, text in HUNT.items() for word in ("--known", f"{state} = {text}")]
    asked += ["--out", tmp_path / "out"]
    said = run("discover", table, *asked, "--json").stdout
    read = json.loads(said)
    assert read["free"]["parts"]["f"]["formula"]
    assert set(read["free"]["constants"]) == {"b", "c", "k", "r"}
    found = load(tmp_path / "out")
    assert found.verdict.level == "law"
    assert found.free.constants["k"].value == pytest.approx(3e9, rel=0.01)
    x = np.array([2e8, 1e9])
    np.testing.assert_allclose(found.free["f"](x), 1.2 * x / (5e8 + x), rtol=0.02)
    # The second time nothing is searched.
    shown = run("discover", table, *asked).stdout
    assert "f(x) = " in shown
    line = run("discover", table, "--known", "x = f(x, y)", code=2).output
    assert "has 2 arguments" in line


def test_a_damaged_record_of_a_function_is_refused():
    """Knots, covariance and formula are checked as a file may have them."""
    square = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), square)
    with pytest.raises(InputError, match="covariance"):
        FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), square[:2])
    with pytest.raises(InputError, match="unknown name 'q'"):
        FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), square, formula="q + 1")
    with pytest.raises(InputError, match="cannot be used in a formula"):
        FreePart("f g", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), square)
    with pytest.raises(KeyError, match="no free part 'g'; the free parts are: none"):
        FreeParts()["g"]


def test_a_direction_that_data_do_not_show_has_no_band():
    """Infinite variances are open bands, where they have a share."""
    unknown = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, np.inf))
    part = FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), unknown)
    low, high = part.band(np.array([0.0, 2.0]))
    assert np.isfinite(low[0])
    assert np.isfinite(high[0])
    assert not np.isfinite(low[1])
    assert not np.isfinite(high[1])
