"""Own bits: what the user adds for functions and operators counts wherever bits do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import sympy
from command_line import run

import dynsr
from dynsr.errors import InputError
from dynsr.expression import complexity, counting, parse, read_own_bits
from dynsr.fit import structure_bits

X = sympy.Symbol("x")
BITS = {"sin": 1000.0, "/": 100.0, "*": 10.0, "+": 1.0, "**": 0.1, "sqrt": 0.01}


@pytest.mark.parametrize(
    ("text", "added"),
    [
        ("x", 0.0),
        ("x + y - 3", 2.0),
        ("2.5*x*y", 20.0),
        ("-x*y", 10.0),
        ("x/y", 100.0),
        ("1/(1 + x)", 101.0),
        ("x*y/(1 + x)", 111.0),
        ("x**2", 0.1),
        ("x**-2", 100.1),
        ("sqrt(x)", 0.01),
        ("y/sqrt(x)", 100.01),
        ("sin(x)*sin(y)", 2010.0),
        ("cos(x)", 0.0),
    ],
)
def test_each_operation_is_counted_as_it_is_written(text: str, added: float) -> None:
    """Sums, products, divisions, powers, roots and functions, as one counts them by hand."""
    expr = parse(text)
    plain = complexity(expr), structure_bits(expr)
    with counting(BITS):
        counted = complexity(expr), structure_bits(expr)
    assert counted == pytest.approx([p + added for p in plain])
    assert (complexity(expr), structure_bits(expr)) == plain


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"foo": 3}, "complexity of 'foo', which is unknown; the functions are: sqrt, exp"),
        ({"-": 3}, "complexity of '-', which is unknown"),
        ({"sin": -1}, "complexity of 'sin' is '-1'; give bits from 0 up, such as 8"),
        ({"sin": "x"}, "complexity of 'sin' is 'x'; give bits"),
        ({"/": float("nan")}, "complexity of '/' is 'nan'; give bits"),
        ({"/": float("inf")}, "complexity of '/' is 'inf'; give bits"),
        ("sin", "complexity 'sin' must map functions and operators to bits, such as"),
    ],
)
def test_what_are_no_bits_is_one_line(given: object, said: str) -> None:
    """The line names the value and what would do."""
    with pytest.raises(InputError) as error:
        read_own_bits(given)  # type: ignore[arg-type]
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)


def swing() -> dynsr.Trajectory:
    """Give a solution of x' = -sin x, with noise of 0.3 % of its range."""
    t = np.linspace(0, 6, 150)
    x = 2 * np.arctan(np.exp(-t) * np.tan(1.2))
    x += 0.006 * np.random.default_rng(0).normal(size=len(t))
    return dynsr.Trajectory(t, x[:, None], ("x",))


@pytest.mark.slow
def test_what_is_dear_gives_way_to_what_does_as_well() -> None:
    """In noise the sine is found; at 500 bits a sine, another formula does as well."""
    plain = dynsr.discover(swing(), preset="quick", jobs=1)
    assert plain.equations["x"].has(sympy.sin)
    found = dynsr.discover(swing(), preset="quick", jobs=1, complexity={"sin": 500})
    expr = found.equations["x"]
    assert not expr.has(sympy.sin)
    x = np.linspace(0.05, 1.1, 50)
    assert np.allclose(sympy.lambdify(X, expr)(x), -np.sin(x), atol=0.05)
    assert found.settings["complexity"] == {"sin": 500.0}


@pytest.mark.slow
def test_the_estimator_counts_them() -> None:
    """sin x with noise is found as such, and as a polynomial where sines are dear."""
    x = np.linspace(-1.5, 1.5, 80)
    y = np.sin(x) + 0.01 * np.random.default_rng(0).normal(size=80)
    model = dynsr.DynsrRegressor(["rational", "sindy"]).fit(x[:, None], y)
    assert model.expr_.has(sympy.sin)
    dear = dynsr.DynsrRegressor(["rational", "sindy"], complexity={"sin": 500})
    dear.fit(x[:, None], y)
    assert not dear.expr_.has(sympy.sin)
    assert np.allclose(dear.predict(x[:, None]), np.sin(x), atol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "method"), [(1, "sindy"), (2, ["rational", "sindy"])])
def test_the_front_counts_them_too(jobs: int, method: str | list[str]) -> None:
    """Every formula of the front has its own bits and those of its functions, by any worker."""
    bits = {"sin": 7.0, "**": 3.0}
    options = {"method": method, "preset": "quick", "complexity": bits}
    found = dynsr.discover(swing(), jobs=jobs, **options)
    for candidate in found.front["x"]:
        with counting(bits):
            assert candidate.complexity == complexity(candidate.expr)
    assert any(c.complexity != complexity(c.expr) for c in found.front["x"])


@pytest.mark.slow
def test_no_bits_change_nothing() -> None:
    """With 0 bits for the sine all is as without."""
    options = {"method": "sindy", "preset": "quick", "functions": ["sin"], "jobs": 1}
    plain = dynsr.discover(swing(), **options)
    found = dynsr.discover(swing(), **options, complexity={"sin": 0})
    assert found.as_record()["front"] == plain.as_record()["front"]
    assert found.equations == plain.equations


@pytest.mark.slow
def test_the_shell_counts_them(tmp_path: Path) -> None:
    """--complexity reaches the record; what is no pair is one line."""
    data = tmp_path / "swing.csv"
    np.savetxt(
        data, np.column_stack([swing().t, swing().x]), delimiter=",", header="t,x", comments=""
    )
    words = ("discover", data, "--json", "--quiet", "--method", "sindy", "--preset", "quick")
    words = (*words, "--jobs", "1")
    told = json.loads(run(*words, "--complexity", "sin=8,/=4").stdout)
    assert told["settings"]["complexity"] == {"sin": 8.0, "/": 4.0}
    said = run(*words, "--complexity", "sin", code=2).output
    assert "--complexity 'sin' must be a name and a number, such as sin=8" in said
