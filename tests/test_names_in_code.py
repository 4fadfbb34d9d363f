"""Names of states and inputs in exported code: none hides what the code needs itself."""

import builtins
import keyword
import math
import re

import numpy as np
import pytest
from known_systems import made

from dynsr.errors import InputError
from dynsr.expression.export import call_names, to_numpy
from dynsr.expression.operators import FUNCTIONS
from dynsr.expression.parsing import check_name, parse

# What Julia 1.10 keeps, what its Base and Core give to every program and code may well call.
_JULIA = """
    abs2 abstract all angle any Any applicable Array as baremodule Base begin Bool
    callable catch cbrt ccall ceil cis clamp collect complex conj const convert copy copysign
    Core count deg2rad diff div divrem do du e elseif end eps error eval exp10 exp2 expm1
    exponent export false fieldtype finally first fld float Float64 floor fma function
    Function gcd get getindex getproperty global hypot identity ifelse im imag in Inf Int
    Integer inv invoke isa isdefined isless iszero keys last lcm length let local log10 log1p
    log2 macro Main map math Matrix max maximum min minimum missing mod module muladd mutable
    NaN new nothing ntuple Number one ones open outer p pairs parent position primitive print
    prod promote public quote rand range read real Real rem replace reverse rhs round run sec
    self setindex show sign signbit sincos size sizeof sort split state step string struct sum
    t throw time true trunc try tuple Tuple type typeof u undef union using values var Vector
    view wait where xor zero zeros zip
"""
JULIA = _JULIA.split()
PYTHON = [*dir(builtins), *keyword.softkwlist, *keyword.kwlist, *dir(math), "np", "numpy", "scipy"]
OWN = ["t_", "state", "self", "math", "callable", "rhs", "step", "du", "u", "p", "given", "inputs"]
NUMPY = [*dir(np), *dir(np.linalg)]


def usable(names):
    """Give those that a state or an input may have."""
    return [name for name in dict.fromkeys(names) if is_usable(name)]


def is_usable(name):
    """Whether a formula may hold the name; t is the time, and x a state of the tests."""
    try:
        return check_name(name) not in ("t", "x")
    except InputError:
        return False


NAMES = usable([*PYTHON, *OWN, *JULIA, *NUMPY])


def make(names):
    """Give one equation a state, in which every function of the operator table stands."""
    calls = [f"{f}({{0}}/3)" for f in FUNCTIONS if f not in ("identity", "inv")]
    texts = [f"{calls[i % len(calls)]} + abs({{0}})^1.5".format(n) for i, n in enumerate(names)]
    return dict(zip(names, map(parse, texts), strict=True))


def chunks(names):
    """Give so many names at a time as there are functions, twice."""
    size = 2 * len(FUNCTIONS)
    return [names[i : i + size] for i in range(0, len(names), size)]


def test_the_names_are_many():
    """Builtins, words and functions of all languages are among them."""
    assert {"callable", "Number", "isa", "nothing", "sum", "match", "linspace"} <= {*NAMES}
    assert len(NAMES) > 600


@pytest.mark.parametrize("names", chunks(NAMES), ids=lambda names: names[0])
@pytest.mark.slow
def test_states_may_be_called_like_anything_of_python(names):
    """Each name of Python, its modules and NumPy gives code that runs and the same slopes."""
    equations, space = make(names), {}
    state = np.linspace(0.2, 1.4, len(names))
    exec(made(equations).to_python(), space)
    truth = [float(e.subs(s, x)) for (s, e), x in zip(equations.items(), state, strict=True)]
    assert np.allclose(space["rhs"](0.0, state), truth, rtol=1e-13)
    assert np.allclose(to_numpy(equations)(0.0, state), truth, rtol=1e-13)


@pytest.mark.parametrize("names", chunks(NAMES)[::4], ids=lambda names: names[0])
def test_states_may_be_called_like_anything_of_torch(names):
    """The module of torch gives the same slopes under these names."""
    torch = pytest.importorskip("torch")
    from dynsr.discovery.hybrid import EquationModule

    names = ["torch", "abs", *names][2 * (names[0] == "torch") :]
    names = usable([*names, "where", "tensor", "float64"])
    equations = make(names)
    state = np.linspace(0.2, 1.4, len(names))
    found = EquationModule(equations)(0.0, torch.tensor(state)).detach().numpy()
    assert np.allclose(found, to_numpy(equations)(0.0, state), rtol=1e-12)


@pytest.mark.parametrize("names", chunks(NAMES), ids=lambda names: names[0])
def test_inputs_may_be_called_like_anything_of_python(names):
    """Under the name that is said for a call, an input is a number or a function of time."""
    equations = {"x": parse("abs(x) + sign(x) + " + " + ".join(names))}
    calls, space = call_names(equations), {}
    exec(made(equations).to_python(), space)
    given = {call: (lambda t: t) if i % 2 else 2.0 for i, call in enumerate(calls.values())}
    for function in (space["rhs"], to_numpy(equations)):
        assert np.allclose(function(2.0, np.array([1.5]), **given), 2.5 + 2.0 * len(names))


@pytest.mark.parametrize("names", chunks(NAMES), ids=lambda names: names[0])
@pytest.mark.slow
def test_no_state_hides_what_the_julia_code_calls(names):
    """Nothing that is set in the function has a name that the code calls, asks for or returns."""
    equations = make(names)
    equations[names[0]] += parse("drive")
    code = made(equations).to_julia()
    body = "\n".join(code.splitlines()[1:-1])
    local = set(re.findall(r"^    (\w+) = ", body, re.MULTILINE))
    called = set(re.findall(r"(?<![.\w])([^\W\d]\w*)\(", body))
    assert len(local) >= len(equations)
    assert not local & (called | {"isa", "Number", "return", "nothing", "du", "u", "p", "t"})
    words = "baremodule begin catch ccall do else elseif end export false function global in local"
    words += " import isa let macro module quote return struct true using while const where"
    assert not local & {*words.split()}


def test_one_name_gives_the_same_code_as_another():
    """Only what would hide something gets an underscore, and never a name of another state."""
    equations = {"callable": parse("callable_ - callable"), "callable_": parse("callable*u")}
    code = made(equations).to_python()
    space: dict = {}
    exec(code, space)
    assert space["rhs"](0.0, [2.0, 5.0], 3.0).tolist() == [3.0, 6.0]
    assert "sum, = state" in made({"sum": parse("-sum")}).to_python()


def test_the_torch_module_takes_numbers_everywhere():
    """An irrational number, the time and inputs stand in functions of torch as in NumPy's."""
    torch = pytest.importorskip("torch")
    from dynsr.discovery.hybrid import EquationModule

    equations = {"x": parse("sqrt(x/3) + cos(t) + sin(F) + exp(2)*pi*x")}
    found = EquationModule(equations)(0.7, torch.tensor([1.3], dtype=torch.float64), F=0.4)
    assert np.allclose(found.detach(), to_numpy(equations)(0.7, np.array([1.3]), F=0.4), rtol=1e-13)
