import math
import re

import numpy as np
import pytest
import sympy
import tree_sitter_julia
from tree_sitter import Language, Parser

from dynsr.data.system import SYSTEMS
from dynsr.engines.julia.setup import find_sources
from dynsr.engines.julia.source import write_julia, write_slopes
from dynsr.errors import InputError
from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.operators import FUNCTIONS
from dynsr.expression.parsing import parse

JULIA = Parser(Language(tree_sitter_julia.language()))
FILES = sorted(find_sources().rglob("*.jl"))


def faults_of(source: str) -> list[str]:
    """Give what the Julia grammar cannot read in a text."""
    faults, nodes = [], [JULIA.parse(source.encode()).root_node]
    while nodes:
        node = nodes.pop()
        if node.is_error or node.is_missing:
            faults.append(f"line {node.start_point[0] + 1}: {node.text.decode()[:60]}")
        nodes.extend(node.children)
    return faults


def slopes_in_python(source: str):
    """Read the written function as Python: other brackets, other powers, the same arithmetic."""
    body = "\n".join(source.split("\n")[1:-2])
    body = re.sub(r"\[(\d+)\]", lambda m: f"[{int(m[1]) - 1}]", body).replace("^", "**")
    scope = {k: getattr(math, k) for k in dir(math)}
    scope |= {"power": pow, "abs": abs, "sign": np.sign, "NaN": math.nan, "Inf": math.inf}
    exec(f"def slopes(u, t, du):\n{body}\n    return du", scope)
    return lambda u, t: scope["slopes"](u, t, [0.0] * 9)


def test_the_grammar_finds_a_fault():
    """The parser used below does reject what is not Julia."""
    assert faults_of("function f(x) x + ") and not faults_of("f(x) = x + 1")


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_every_julia_file_parses(path):
    """Each file of the julia folder is Julia by its grammar."""
    assert faults_of(path.read_text()) == []


def test_the_julia_folder_is_complete():
    """The module includes every source file beside it, and nothing that is missing."""
    names = {path.name for path in FILES}
    assert {"DynSR.jl", "integrate.jl", "regress.jl", "release2021.jl", "runtests.jl"} <= names
    module = (find_sources() / "src" / "DynSR.jl").read_text()
    included = set(re.findall(r'include\("(.+?)"\)', module))
    assert included == {p.name for p in (find_sources() / "src").glob("*.jl")} - {"DynSR.jl"}


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_written_slopes_are_the_equations(system):
    """Every known system, written for Julia, parses there and has the slopes it has in numpy."""
    source = write_slopes(system.closed_rhs(), system.states)
    assert faults_of(source) == []
    rng = np.random.default_rng(1)
    slopes = slopes_in_python(source)
    expected = compile_numpy(system.closed_rhs(), [*system.states, "t"])
    for _ in range(5):
        u, t = rng.uniform(0.2, 1.5, len(system.states)), float(rng.uniform(0.0, 9.0))
        found = slopes(u, t)[: len(u)]
        assert np.allclose(found, expected(np.array([*u, t])), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    "text",
    [
        "x^2 + x^-2 - x^(1/2) + x^(-1/2) + x^(1/3) + x^1.7",
        "1/(x*y)^3 - x/y*2/3 + (x - y)/(x + y)^2/7",
        "-(-x)^2 + (-2)^3*y - 2^x - 10000000000000000000000*x",
        "exp(-x)*log(y) + abs(x - y)*sign(x - 2) + atan(x/y) + tanh(x)",
        "pi*x + exp(1)*y + 1e-30 - 2.5e300*x",
        "asin(x/9) + acos(y/9) + sinh(x) - cosh(y) + tan(x)",
    ],
)
def test_every_operation_keeps_its_value(text):
    """Powers, quotients, numbers and functions mean in Julia what they mean in numpy."""
    expr = parse(text, ["x", "y"])
    source = write_slopes([expr], ["x", "y"])
    assert faults_of(source) == []
    values = np.array([1.3, 0.7])
    expected = compile_numpy([expr], ["x", "y"])(values)[0]
    assert slopes_in_python(source)(values, 0.0)[0] == pytest.approx(float(expected), rel=1e-13)


def test_every_function_of_the_operator_table_can_be_written():
    """No function of the table is unknown to the writer."""
    x = sympy.Symbol("x")
    for operator in FUNCTIONS.values():
        assert write_julia(operator.sympy(x), {x: "u[1]"})


def test_names_of_states_cannot_clash_with_julia():
    """A state called end or function is no word of the source."""
    source = write_slopes([parse("end*begin", ["end", "begin"])] * 2, ["end", "begin"])
    assert faults_of(source) == [] and "u[1] * u[2]" in source.replace("u[2] * u[1]", "u[1] * u[2]")


def test_common_parts_are_computed_once():
    """A sine that occurs in three places is one call."""
    rhs = [parse("sin(x*y) + 1"), parse("2*sin(x*y)"), parse("sin(x*y)^2")]
    assert write_slopes(rhs, ["x", "y", "z"]).count("sin(") == 1


def test_what_julia_is_not_given_is_refused():
    """A function outside the table and an unknown name are told in one line."""
    x = sympy.Symbol("x")
    with pytest.raises(InputError, match="gamma in a right-hand side cannot be written"):
        write_slopes([sympy.gamma(x)], ["x"])
    with pytest.raises(InputError, match="unknown name 'k'"):
        write_slopes([sympy.Symbol("k") * x], ["x"])
