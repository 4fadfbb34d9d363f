"""Terms that must occur: they do, with fitted coefficients, whatever the data say of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import sympy
from command_line import run
from scipy.integrate import solve_ivp

import dynsr
from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.fit import missing_terms
from dynsr.methods import read_demands

X, Y = sympy.symbols("x y")
QUICK = {"preset": "quick", "functions": (), "jobs": 1}


def prey(noise: float) -> dynsr.Trajectory:
    """Prey and predators, with noise as a share of their spread."""
    t = np.linspace(0, 8, 160)
    x = solve_ivp(
        lambda _, v: [1.3 * v[0] - 0.8 * v[0] * v[1], 0.9 * v[0] * v[1] - 2.6 * v[1]],
        (0, 8),
        [2.0, 1.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    ).y.T
    rng = np.random.default_rng(0)
    return dynsr.Trajectory(t, x + noise * x.std(axis=0) * rng.normal(size=x.shape), ("x", "y"))


def coefficient(expr: sympy.Expr, term: sympy.Expr) -> float:
    """Give the coefficient of a term of a polynomial in x and y."""
    return float(sympy.Poly(expr, X, Y).coeff_monomial(term))


@pytest.fixture(scope="module")
def plain() -> dynsr.Discovery:
    """Give the discovery that no term is forced upon."""
    return dynsr.discover(prey(0.0), **QUICK)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "method"), [(0.0, "sindy"), (0.01, "auto")])
def test_a_term_that_the_data_do_not_ask_for_is_there(
    plain: dynsr.Discovery, noise: float, method: str
) -> None:
    """x^2 is in x' with a coefficient near 0 and its interval; the law stands beside it."""
    assert not plain.equations["x"].has(X**2)
    found = dynsr.discover(
        prey(noise),
        method=method,
        targets="x",
        must={"x": "x**2"},
        **QUICK,
    )
    expr = found.equations["x"]
    assert expr.has(X**2)
    assert abs(coefficient(expr, X**2)) < 1e-6 + 3 * noise
    assert coefficient(expr, X) == pytest.approx(1.3, abs=1e-6 + 10 * noise)
    assert coefficient(expr, X * Y) == pytest.approx(-0.8, abs=1e-6 + 10 * noise)
    assert "x**2" in [one.of for one in found.constants["x"]]
    assert all(not missing_terms(c.expr, [X**2]) for c in found.front["x"])
    assert found.settings["must"] == ["x: x**2"]


@pytest.mark.slow
def test_a_term_of_the_law_changes_nothing_else(plain: dynsr.Discovery) -> None:
    """Forced terms that the law has give the equations of a search without them."""
    found = dynsr.discover(prey(0.0), must=["x: x*y", "y: y"], **QUICK)
    assert found.equations == plain.equations
    assert found.verdict.tested
    assert found.verdict.level == "law"


def logistic() -> dynsr.Trajectory:
    """Give 80 steps of the logistic map."""
    x = [0.3]
    for _ in range(80):
        x.append(3.7 * x[-1] * (1 - x[-1]))
    return dynsr.Trajectory(np.arange(81.0), np.array(x)[:, None], ("x",))


@pytest.mark.slow
def test_a_map_holds_its_term() -> None:
    """The logistic map with a forced constant is itself beside a constant of nearly 0."""
    found = dynsr.discover(logistic(), discrete=True, must={"x": ["1"]}, **QUICK)
    expr = found.equations["x"]
    assert missing_terms(expr, [sympy.S.One]) == []
    assert float(expr.subs(X, 0)) == pytest.approx(0, abs=1e-9)
    assert float(expr.subs(X, 0.5)) == pytest.approx(3.7 / 4, abs=1e-9)


def test_floats_inside_a_term_are_free() -> None:
    """exp(-0.5 x) is held by a formula with exp(-0.7 x), x by x (2 - y) multiplied out."""
    term = sympy.exp(-0.5 * X)
    assert missing_terms(2 * sympy.exp(-0.7 * X) + Y, [term]) == []
    assert missing_terms(2 * sympy.exp(-X * Y), [term]) == [term]
    assert missing_terms(X * (2 - Y), [X, X * Y, Y]) == [Y]


@pytest.mark.parametrize(
    ("words", "options", "said"),
    [
        ({"z": "x"}, {}, "must names 'z', which is no state; they are: x, y"),
        ("x*y", {}, "cannot read must 'x\\*y'; write it like 'x: x\\*y'"),
        (["x: x + y"], {}, "must of 'x' has 'x \\+ y', which is not one term"),
        (["x: exp(x)"], {"functions": []}, "must of 'x' has 'exp\\(x\\)', which functions do not"),
        (["y: x"], {"conserved": ["x + y"]}, "must of 'y' has 'x', but that equation follows"),
        (["x: x*y"], {"constraints": ["x: x*y = 0"]}, "must of 'x' has 'x\\*y', which a constrai"),
    ],
)
def test_what_cannot_be_held_is_one_line(words: object, options: dict, said: str) -> None:
    """The line names the state, the term and the remedy."""
    with pytest.raises(InputError, match=said):
        read_demands(["x", "y"], ["x", "y"], must=words, **options)  # type: ignore[arg-type]


def test_a_term_in_an_equation_that_is_not_searched_is_one_line() -> None:
    """Of order 2 the velocity has the equation; a target that is left out has none."""
    with pytest.raises(InputError, match=r"must of 'x' has 'x', but its .* are of: x_dot, y"):
        dynsr.discover(prey(0.0), order={"x": 2}, must={"x": "x"}, jobs=1)
    with pytest.raises(InputError, match="must of 'y' has 'x', but its equation is not searched"):
        dynsr.discover(prey(0.0), targets="x", must={"y": "x"}, jobs=1)


@pytest.mark.slow
def test_a_term_that_is_finite_nowhere_is_one_line() -> None:
    """Nothing could be fitted with it; a number within it may move to where it can."""
    t = np.linspace(0, 6, 40)
    x = 2 * np.exp(-0.5 * t) + 0.02 * np.random.default_rng(0).normal(size=40)
    run = dynsr.Trajectory(t, x[:, None], ("x",))
    with pytest.raises(InputError, match=r"'log\(x - 5\)' of must is finite at no row"):
        dynsr.discover(run, must={"x": "log(x - 5)"}, **QUICK | {"functions": None})
    found = dynsr.discover(run, must={"x": "log(x - 5.0)"}, **QUICK | {"functions": None})
    assert found.equations["x"].has(sympy.log)
    assert found.verdict.level != "law"


@pytest.mark.slow
def test_the_shell_forces_terms_too(tmp_path: Path) -> None:
    """--must, twice here, reaches the record and the equation."""
    data = tmp_path / "logistic.csv"
    dynsr.data.write_csv(logistic(), data)
    words = ("discover", data, "--json", "--quiet", "--map", "--preset", "quick", "-j", "1")
    words = (*words, "--functions", "none")
    told = json.loads(run(*words, "--must", "x: 1", "--must", "x: x").stdout)
    assert missing_terms(parse(told["equations"]["x"]), [sympy.S.One, X]) == []
    assert told["settings"]["must"] == ["x: 1", "x: x"]
