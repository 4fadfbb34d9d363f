"""Equations as systems of CasADi, python-control and do-mpc: as text, and as objects at once."""

import re
import subprocess
import sys

import numpy as np
import pytest
from known_systems import KNOWN, NAMES, points, slopes
from scipy.integrate import solve_ivp

from dynsr.data.system import System
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import MissingExtra, say_install
from dynsr.export.formats import write_format
from dynsr.export.objects import make_casadi, make_control, make_do_mpc
from dynsr.export.source import Source
from dynsr.expression.parsing import parse
from dynsr.verdict.prediction import predict

MAP = {"x": parse("3.7*x - 3.7*x^2 + 0.1*sin(t)")}


def run(code):
    """Give the numbers in the last line that a script printed."""
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array([float(word) for word in done.stdout.splitlines()[-1].split()])


@pytest.fixture(scope="module")
def driven():
    """Give a driven decay with its data: the input was measured."""
    t = np.linspace(0, 4, 81)
    u = np.where(t < 2, 1.0, 0.0)
    return Discovery(
        {"x": parse("2*u - 0.5*x")},
        {},
        {},
        {},
        (Trajectory(t, np.exp(-t)[:, None], ("x",), u[:, None], ("u",)),),
    )


@pytest.mark.parametrize("name", NAMES)
def test_objects_compute_the_equations(name):
    """The function of CasADi and the system of python-control give dynsr's slopes."""
    pytest.importorskip("casadi", reason="casadi is not installed")
    pytest.importorskip("control", reason="control is not installed")
    source = Source.of(KNOWN[name])
    function, system = make_casadi(source), make_control(source)
    values = list(source.parameters.values())
    assert function.name_in() == ["t", "x", "u", "p"] and system.state_labels == source.states
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        out = function(t, state, [], values).full().ravel()
        assert np.allclose(out, expected, rtol=1e-10)
        assert np.allclose(system.dynamics(t, state, []), expected, rtol=1e-10)


def test_objects_take_inputs_and_other_parameters(driven):
    """An input is an argument; a parameter can be given another value."""
    pytest.importorskip("casadi", reason="casadi is not installed")
    pytest.importorskip("control", reason="control is not installed")
    assert float(driven.to_casadi()(0, [4.0], [3.0], [2.0, 0.25])) == 2 * 3 - 0.25 * 4
    system = driven.to_control()
    assert system.input_labels == ["u"]
    assert system.dynamics(0.0, [4.0], [3.0], params={"k2": 0.25}) == pytest.approx([5.0])


def test_a_system_of_python_control_goes_into_its_tools(driven):
    """Linearised where it stands still, it is the system worked out by hand."""
    control = pytest.importorskip("control", reason="control is not installed")
    near = control.linearize(driven.to_control(), [4.0], [1.0])
    assert np.allclose([near.A, near.B], [[[-0.5]], [[2.0]]], rtol=1e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_model_of_do_mpc_computes_the_equations():
    """Its right-hand sides are dynsr's slopes; the time is one more state."""
    pytest.importorskip("do_mpc", reason="do-mpc is not installed")
    import casadi

    for name in NAMES:
        source = Source.of(KNOWN[name])
        model = make_do_mpc(source)
        rhs = casadi.Function("rhs", [model.x, model.p], [model._rhs])
        for t, state, expected in zip(*points(name), slopes(name), strict=True):
            clock = [t] if source.timed else []
            out = rhs([*state, *clock], list(source.parameters.values())).full().ravel()
            assert np.allclose(out, [*expected, *([1.0] if clock else [])], rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("equations", [{"x": "y", "y": "-4*x + 0.3*cos(t)"}, {"x": "-x/2"}])
def test_the_script_of_do_mpc_simulates(equations):
    """It prints the last state of the trajectory, also where times do not begin at 0."""
    pytest.importorskip("do_mpc", reason="do-mpc is not installed")
    start = [1.0, 0.5][: len(equations)]
    system = System.from_strings(equations, x0=start, train=(5, 7))
    right = [parse(text) for text in equations.values()]
    t = np.array([5.0, 7.0])
    truth = predict(dict(zip(equations, right, strict=True)), start, t).x[-1]
    found = run(write_format(Source.of(system), "do-mpc"))
    assert np.allclose(found, truth, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_the_script_of_do_mpc_controls(driven):
    """Where there is an input, a controller brings the state to its aim, within bounds."""
    pytest.importorskip("do_mpc", reason="do-mpc is not installed")
    code = driven.export("do-mpc")
    assert 'bounds["lower", "_u", "u"] = 0.0' in code and 'bounds["upper", "_u", "u"] = 1.0' in code
    assert run(code.replace("control(START)", "control([3.0])")) == pytest.approx([3.0], abs=1e-3)
    # No input within the bounds holds more than 4.
    assert run(code.replace("control(START)", "control([9.0])"))[0] < 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("form", ["python", "casadi", "control", "do-mpc"])
def test_a_map_is_stepped_by_each_script(form):
    """Each prints the state that iterating by hand gives; an equation may hold the time."""
    pytest.importorskip(form.replace("-", "_") if form != "python" else "numpy")
    t = 3.0 + 0.5 * np.arange(6)
    data = Trajectory(t, np.linspace(0.4, 0.5, 6)[:, None], ("x",))
    found = Discovery(MAP, {}, {}, {}, (data,), settings={"kind": "map"})
    x = 0.4
    for now in t[:-1]:
        x = 3.7 * x - 3.7 * x**2 + 0.1 * np.sin(now)
    code = found.export(form).replace("print(state)", "print(*state)")
    assert run(code) == pytest.approx([x], rel=1e-9)
    if form == "casadi":
        assert float(
            found.to_casadi()(0, [0.4], [], [*found.parameters.numbers.values()])
        ) == pytest.approx(3.7 * 0.24)
    if form == "control":
        assert found.to_control().dt == 0.5
    if form == "do-mpc":
        assert found.to_do_mpc().model_type == "discrete"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_an_object_of_python_control_is_simulated_alike():
    """Its response is scipy's trajectory of the same equations."""
    control = pytest.importorskip("control", reason="control is not installed")
    found = Discovery.from_system(KNOWN["lotka-volterra"])
    t = np.linspace(0, 5, 51)
    exact = {"rtol": 1e-10, "atol": 1e-12}
    response = control.input_output_response(
        found.to_control(), t, initial_state=[1.0, 1.0], solve_ivp_kwargs=exact
    )
    truth = solve_ivp(found.to_numpy(), (0, 5), [1.0, 1.0], t_eval=t, **exact).y
    assert np.allclose(response.states, truth, rtol=1e-6)


@pytest.mark.parametrize(
    ("module", "make"),
    [("casadi", "to_casadi"), ("control", "to_control"), ("do_mpc", "to_do_mpc")],
)
def test_what_is_not_installed_is_named(monkeypatch, driven, module, make):
    """Without the tool one line says how to get it; the text needs none of it."""
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match=re.escape(say_install("control"))):
        getattr(driven, make)()
    assert driven.export("control") and driven.export("casadi")
