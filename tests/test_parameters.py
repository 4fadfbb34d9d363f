import math
from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.data.system import LORENZ, SIR, System
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.engines.simulation import simulate
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront
from dynsr.parameters.parameters import ParametricSystem, name_constants

X, Y = sympy.symbols("x y")


def made(equations, errors=None, **fields):
    """Give a discovery of equations as text."""
    read = {state: parse(text) for state, text in equations.items()}
    front = {state: ParetoFront() for state in read}
    return Discovery(read, errors or {}, front, {}, **fields)


PREY = {"x": "0.9*x - 0.4*x*y", "y": "0.4*x*y - 0.7*y"}


def test_what_leaves_one_state_for_another_is_one_parameter():
    """SIR has two parameters in three equations, the Lorenz system one for both of x's terms."""
    assert ParametricSystem.of(SIR).parameters.numbers == {"k1": 0.4, "k2": 0.1}
    sigma = ParametricSystem.of(LORENZ)
    assert sigma.equations["x"].free_symbols == {X, Y, sympy.Symbol("k1")}


def test_a_first_value_is_of_a_state():
    """A first value of something that has no equation is refused, by its name."""
    known = ParametricSystem.of(SIR)
    with pytest.raises(InputError, match="x0 has a value for 'Z', which has no equation"):
        replace(known, x0={**known.x0, "Z": 1.0})


@pytest.mark.parametrize("values", [(2.0, 3.0), (1.0, 1.0), (-0.3, -0.3)])
def test_named_equations_are_the_equations(values):
    """With the values put in, named equations give the same slopes; every value is positive."""
    equations = {
        "x": f"{values[0]}*x/(1.5 + x) - {values[1]}*sin(2*y)",
        "y": f"x^1.5 - {values[0]}*x/(1.5 + x) + 8/3",
    }
    found = made(equations)
    point = {X: 1.3, Y: 0.4}
    for state, expr in found.system.in_numbers.items():
        assert math.isclose(expr.subs(point), found.equations[state].subs(point), rel_tol=1e-12)
    assert all(value > 0 for value in found.parameters.numbers.values())


def test_a_name_is_no_other_name():
    """Where a state is called k1, parameters have another letter."""
    assert list(made({"k1": "-2*k1"}).parameters) == ["p1"]
    assert list(made({"x": "-2*x*k7"}).parameters) == ["p1"]


def test_a_parameter_has_the_surest_of_its_intervals():
    """A constant that stands in two equations has the smaller error, with the parameter's sign."""
    errors = {"x": ((-0.4, 0.02), (0.9, 0.1)), "y": ((0.4, 0.01), (-0.7, 0.05))}
    found = made(PREY, errors).parameters
    assert found["k1"].error == pytest.approx(0.01) and found["k1"].states == ("x", "y")
    assert (found["k3"].low, found["k3"].high) == pytest.approx((0.7 - 0.098, 0.7 + 0.098))


def test_names_stay_with_the_result(tmp_path):
    """A renamed parameter is saved and read back; other names follow from it."""
    found = made(PREY, settings={"engine": "embedded"}).rename({"k1": "bite", "k3": "death"})
    back = Discovery.load(found.save(tmp_path / "found.json"))
    assert list(back.parameters) == ["bite", "k2", "death"]
    again = back.rename({"bite": "k1", "death": "k3"})
    assert again.parameters.numbers == made(PREY).parameters.numbers


def test_names_of_other_equations_are_not_believed(tmp_path):
    """Names that do not fit the equations, as in a record that was changed, are not used."""
    found = made(PREY, parameter_names={"x": ("a",), "y": ("b", "c")})
    assert list(found.parameters) == ["k1", "k2", "k3"]
    clash = made(PREY, parameter_names={"x": ("-a", "a"), "y": ("a", "-b")})
    assert list(clash.parameters) == ["k1", "k2", "k3"]
    state = made(PREY, parameter_names={"x": ("-y", "b"), "y": ("y", "-c")})
    assert list(state.parameters) == ["k1", "k2", "k3"]


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ({"k11": "a"}, r"unknown parameter 'k11' \(did you mean 'k1'\?\); the parameters are: k1"),
        ({"k1": "x"}, "named as a state"),
        ({"k1": "t"}, "named as a state, an input or the time"),
        ({"k1": "k2"}, "two parameters are named 'k2'"),
        ({"k1": "2a"}, "cannot be used in a formula"),
        ("roles", "must be"),
    ],
)
def test_a_name_that_cannot_be_is_refused(new, words):
    """An unknown parameter, a taken name and one that is no name are each one clear line."""
    with pytest.raises(InputError, match=words):
        made(PREY).rename(new)


def test_names_may_change_places():
    """Two parameters exchange their names."""
    changed = made(PREY).rename({"k1": "k2", "k2": "k1"}).parameters.numbers
    assert changed == {"k2": 0.4, "k1": 0.9, "k3": 0.7}


def test_a_value_is_put_in_wherever_the_parameter_stands():
    """Names and signs stay, also of a value below 0, and of one that is another's."""
    found = made(PREY).rename({"k1": "bite"})
    for value in (-2.0, 0.9, 0.5):
        changed = found.with_parameters(bite=value)
        assert changed.parameters.numbers == {"bite": value, "k2": 0.9, "k3": 0.7}
        assert math.isclose(changed.equations["y"].coeff(X * Y), value)
        assert not changed.verdict.tested and changed.errors == {}


def test_a_value_of_zero_leaves_the_other_names():
    """Without a term, the others are called as before."""
    changed = made(PREY).rename({"k2": "birth"}).with_parameters(k1=0)
    assert changed.parameters.numbers == {"birth": 0.9, "k3": 0.7}
    with pytest.raises(InputError, match="cannot be 0"):
        made({"x": "log(2.5*y + 1.5)"}).with_parameters(k2=0, k3=0)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "1", None, True, 1j])
def test_a_value_is_a_finite_number(value):
    """Anything else is named with its parameter."""
    with pytest.raises(InputError, match="parameter 'k1' is"):
        made(PREY).with_parameters(k1=value)
    with pytest.raises(InputError, match="unknown parameter 'q'"):
        made(PREY).with_parameters(q=1.0)


def test_an_unknown_parameter_is_a_key_error_with_the_names():
    """What is asked for by a wrong name is told which there are."""
    with pytest.raises(KeyError, match="are: k1, k2, k3"):
        made(PREY).parameters["nope"]


@pytest.mark.slow
def test_units_follow_from_those_of_the_columns():
    """A half-saturation has the unit of its column, a rate the state's over the time's."""
    pytest.importorskip("pint", reason="pint is not installed")
    units = {"x": "mg/L", "y": "mg/L", "t": "h"}
    found = made(
        {"x": "-0.5*x/(2.5 + x) - 0.3*x^2*y", "y": "0.2*y*exp(-3.5*x)"},
        settings={"column_units": units},
    ).parameters
    by_place = {p.value: p.unit for p in found.values()}
    assert by_place == {
        0.5: "mg/(h*l)",
        2.5: "mg/l",
        0.3: "l^2/(h*mg^2)",
        0.2: "1/h",
        3.5: "l/mg",
    }


def test_the_covariance_is_that_of_draws():
    """Intercept and slope of a decay to a level are correlated as a fit to many draws says."""
    t = np.linspace(0, 3, 121)
    rng = np.random.default_rng(3)
    law = {"x": parse("2.0 - 1.0*x")}
    clean = 2 + (0.5 - 2) * np.exp(-t)
    draws = []
    from scipy.optimize import curve_fit

    def solution(times, a, b, x0):
        return a / b + (x0 - a / b) * np.exp(-b * times)

    for _ in range(200):
        noisy = clean + 0.02 * rng.standard_normal(len(t))
        draws.append(curve_fit(solution, t, noisy, [2.0, 1.0, 0.5])[0][:2])
    expected = np.cov(np.array(draws).T)
    run = Trajectory(t, (clean + 0.02 * rng.standard_normal(len(t)))[:, None], ("x",))
    errors = tuple(zip([2.0, -1.0], np.sqrt(np.diag(expected)), strict=True))
    spread = Discovery(law, {"x": errors}, {}, {}, (run,)).covariance()
    assert list(spread.columns) == ["k1", "k2"]
    values = made({"x": "2.0 - 1.0*x"}).parameters.numbers
    order = [list(values.values()).index(v) for v in (2.0, 1.0)]
    found = spread.to_numpy()[np.ix_(order, order)]
    apart = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    theirs = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.allclose(found / apart, expected / theirs, atol=0.1)


def test_covariances_need_the_data():
    """Without them the line says so."""
    with pytest.raises(InputError, match="the data are not here"):
        made(PREY).covariance()


def test_a_system_with_names_is_a_system():
    """With numbers it integrates to the same states, from the start of the data."""
    t = np.linspace(0, 5, 51)
    system = System.from_strings(PREY, x0=[3.0, 1.0])
    run = simulate(system, t=t)
    found = made(PREY, trajectories=(run,)).rename("role").system
    again = simulate(found.to_system(), t=t)
    assert np.allclose(again.x, run.x, rtol=1e-9)
    with pytest.raises(InputError, match="measured values alone"):
        made({"x": "u - x"}).system.to_system()


def test_a_bare_column_has_no_parameter():
    """What a velocity is to its state is structure; a coefficient of -1 is a number."""
    assert name_constants({"x": Y, "y": -X}) == {"x": (), "y": ("-k1",)}
    assert len(made({"x": "y", "y": "0"}).parameters) == 0


def test_a_map_has_named_parameters_too():
    """Its covariance is that of least squares on one step."""
    rng = np.random.default_rng(0)
    x = np.empty(200)
    x[0] = 0.4
    for i in range(199):
        x[i + 1] = 3.7 * x[i] * (1 - x[i]) + 1e-3 * rng.standard_normal()
    run = Trajectory(np.arange(200.0), x[:, None], ("x",))
    columns = np.column_stack([x[:-1], -(x[:-1] ** 2)])
    coefficients, left, *_ = np.linalg.lstsq(columns, x[1:], rcond=None)
    spread = np.linalg.inv(columns.T @ columns) * left[0] / 197
    own = np.sqrt(np.diag(spread))
    errors = ((-coefficients[1], own[1]), (coefficients[0], own[0]))
    a, b = map(sympy.Float, coefficients)
    found = Discovery(
        {"x": a * X - b * X**2}, {"x": errors}, {}, {}, (run,), settings={"kind": "map"}
    )
    assert "[n+1]" in repr(found.system)
    assert found.covariance().loc["k1", "k2"] == pytest.approx(spread[0, 1], rel=1e-2)
    assert r"{x}_{n+1} &=" in found.latex(names=True)


def test_the_report_lists_parameters_with_names(tmp_path):
    """Each stands once, with the equations in these names below."""
    found = made(PREY, settings={"engine": "embedded"}).rename({"k1": "bite"})
    page = found.report(tmp_path / "report.html").read_text()
    assert "Each constant with its 95 % interval" in page and "bite*x*y" in page
    assert "<table>" in found.parameters._repr_html_()


def test_constants_are_named_once(monkeypatch):
    """All that is written of one discovery asks for their names, which takes long in large ones."""
    named = []
    monkeypatch.setattr(
        "dynsr.discovery.result.name_constants", lambda e: named.append(e) or name_constants(e)
    )
    found = Discovery({"x": 2 * X - X**2}, {"x": ()}, {}, {})
    assert found.system.parameters == found.parameters
    assert found.to_python() and len(named) == 1
