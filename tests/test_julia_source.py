import math
import re
from typing import get_args

import numpy as np
import pytest
import sympy
import tree_sitter_julia
from tree_sitter import Language, Parser

from dynsr.data.system import SYSTEMS
from dynsr.engines.base import Optimizer, Release
from dynsr.engines.julia.setup import find_sources
from dynsr.engines.julia.source import write_julia, write_slopes
from dynsr.engines.julia.worker import _IS_PACKAGE
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
    # What the worker itself says to Julia.
    assert not faults_of(_IS_PACKAGE) and not faults_of("import DynSR")


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_every_julia_file_parses(path):
    """Each file of the julia folder is Julia by its grammar."""
    assert faults_of(path.read_text()) == []


def test_the_solver_gets_one_type_for_every_right_hand_side():
    """What ODEProblem is given is built as Slopes, whose one field is an abstract Function."""
    text = (find_sources() / "src" / "integrate.jl").read_text()
    assert re.search(r"^struct Slopes\n    call::Function\nend$", text, re.MULTILINE)
    made = re.findall(r"^    (\w+) = Slopes\(compile\(source\)\)$", text, re.MULTILINE)
    assert [name for name in made if f"run_tsit5, {name}," not in text] == [] and len(made) == 2
    (given,) = re.findall(r"ODEProblem\((\w+),", text)
    assert re.search(rf"^function run_tsit5\(\s+{given},", text, re.MULTILINE)


def test_what_is_compiled_ahead_is_every_kind_of_call():
    """The workload names each optimizer, release and proximal operator, and evaluates no text."""
    text = (find_sources() / "src" / "workload.jl").read_text()
    named = set(re.findall(r'"([\w-]*)"', text))
    releases = {"", *get_args(Release)}
    assert set(get_args(Optimizer)) | releases | {"hard", "soft"} <= named
    code = re.sub(r"#.*|^\".*\"$", "", text, flags=re.MULTILINE)
    assert not re.search(r"\b(compile|integrate|integrate_driven|eval)\(", code)
    # Without and with a measured input, whose pieces are taken apart there too.
    called = re.findall(r"(run_\w+)\(\s*Slopes\(", code)
    assert called == ["run_tsit5", "run_driven"] and "versions" in code
    driven = (
        (find_sources() / "src" / "integrate.jl").read_text().partition("function run_driven")[2]
    )
    assert "drives_of(" in driven.partition("\nend")[0]


def test_the_workload_belongs_to_the_package_alone():
    """Included into a project that is not ours, the module asks for no PrecompileTools."""
    sources = {p.name: p.read_text() for p in (find_sources() / "src").glob("*.jl")}
    users = [name for name, text in sources.items() if "using PrecompileTools" in text]
    assert users == ["workload.jl"]
    assert (
        'if Base.PkgId(@__MODULE__).uuid !== nothing\n    include("workload.jl")\nend'
        in sources["DynSR.jl"]
    )


def test_the_julia_folder_is_complete():
    """The module includes every source file beside it, and nothing that is missing."""
    names = {path.name for path in FILES}
    assert {"DynSR.jl", "integrate.jl", "regress.jl", "release2021.jl", "runtests.jl"} <= names
    assert "workload.jl" in names
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
