import numpy as np
import pytest
import sympy

from dynsr.data.system import LORENZ, LOTKA_VOLTERRA, PENDULUM, SIR
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.engines.equilibria import find_fixed_points
from dynsr.engines.simulation import simulate
from dynsr.errors import InputError
from dynsr.expression.export import to_numpy
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront


def made(equations, *runs, **fields):
    """Give a discovery of equations as text or as SymPy has them."""
    read = {state: parse(text) for state, text in equations.items()}
    front = {state: ParetoFront() for state in read}
    return Discovery(read, {}, front, {}, runs, **fields)


def of(system, **fields):
    """Give a discovery of a known system with its own trajectory."""
    equations = dict(zip(system.states, system.rhs, strict=True))
    return made(equations, simulate(system), settings={"engine": "embedded", "seed": 0}, **fields)


def test_a_linearisation_is_the_slope_of_the_equations():
    """A and B are what small differences of states and inputs give; the eigenvalues are A's."""
    found = made({"x": "sin(x*y) - u^2*x", "y": "exp(-x)/(1 + y^2) + 3*u"})
    point, u = np.array([0.7, -0.4]), 0.9
    near = found.linearise(point, {"u": u})
    rhs, step = to_numpy(found.equations), 1e-6

    def slope(of_point, of_input):
        return (rhs(0, point + of_point, u + of_input) - rhs(0, point - of_point, u - of_input)) / (
            2 * step
        )

    by_state = np.array([slope(step * e, 0.0) for e in np.eye(2)]).T
    assert np.allclose(near.A, by_state, atol=1e-8)
    assert np.allclose(near.B[:, 0], slope(np.zeros(2), step), atol=1e-8)
    assert np.allclose(near.slopes, rhs(0, point, u))
    assert np.allclose(sorted(near.eigenvalues), sorted(np.linalg.eigvals(by_state)), atol=1e-7)
    assert near.inputs == ("u",) and near.at == {"x": 0.7, "y": -0.4}


def test_a_linearisation_feeds_python_control():
    """A and B make a state-space model with the poles of the equations."""
    control = pytest.importorskip("control", reason="python-control is not installed")
    near = made({"w": "v", "v": "-9.81*w - 0.5*v + u"}).linearise([0, 0], {"u": 0})
    model = control.ss(near.A, near.B, np.eye(2), np.zeros((2, 1)))
    assert np.allclose(sorted(model.poles()), sorted(np.roots([1, 0.5, 9.81])))


def test_the_fixed_points_of_known_systems():
    """Lorenz has three, in closed form; prey and predators turn about theirs; a pendulum hangs."""
    lorenz = of(LORENZ).fixed_points()
    root = np.sqrt(8 / 3 * 27)
    places = [[-root, -root, 27], [0, 0, 0], [root, root, 27]]
    assert np.allclose([list(p.at.values()) for p in lorenz], places)
    assert [p.kind for p in lorenz] == ["saddle"] * 3
    prey = {p.kind: p.at for p in of(LOTKA_VOLTERRA).fixed_points()}
    assert prey["centre"] == pytest.approx({"x": 3.0, "y": 1.5})
    assert prey["saddle"] == {"x": 0.0, "y": 0.0}
    hanging = [p for p in of(PENDULUM).fixed_points() if p.stable]
    assert [p.at for p in hanging] == [{"theta1": 0.0, "theta2": 0.0}]
    assert hanging[0].kind == "stable focus"


def test_a_line_of_fixed_points_is_one():
    """With nobody infected, any number of the susceptible stands still."""
    (line,) = of(SIR).fixed_points()
    assert line.kind == "degenerate" and line.at["i"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("rate", "kinds"),
    [
        (0.5, {0.0: "stable node"}),
        (2.8, {0.0: "unstable node", 1 - 1 / 2.8: "stable node"}),
        (3.4, {0.0: "unstable node", 1 - 1 / 3.4: "unstable node"}),
    ],
)
def test_fixed_points_of_a_map(rate, kinds):
    """The logistic map stands still at 0 and 1 - 1/r; the second is stable between 1 and 3."""
    run = Trajectory(np.arange(3.0), [[0.0], [1.0], [0.5]], ("x",))
    found = made({"x": f"{rate}*x - {rate}*x^2"}, run, settings={"kind": "map"})
    points = {round(p.at["x"], 9): p.kind for p in found.fixed_points()}
    assert {round(place, 9): kind for place, kind in kinds.items()}.items() <= points.items()


def test_what_holds_the_time_or_an_input_stands_somewhere():
    """A value is asked for where nothing says it; a measured input is its mean."""
    with pytest.raises(InputError, match="hold 't'; give its value"):
        made({"x": "t - x"}).fixed_points()
    (point,) = made({"x": "t - x"}).fixed_points(t=0.5)
    assert point.at["x"] == pytest.approx(0.5)
    with pytest.raises(InputError, match="nothing says what 'u' is"):
        made({"x": "u - x"}).fixed_points()
    t = np.linspace(0, 1, 11)
    run = Trajectory(t, np.column_stack([t]), ("x",), np.column_stack([t]), ("u",))
    (point,) = made({"x": "u - x"}, run).fixed_points()
    assert point.at["x"] == pytest.approx(0.5)
    with pytest.raises(InputError, match="no input 'v'"):
        made({"x": "u - x"}, run).fixed_points({"v": 1.0})
    driven = made({"x": "u - x"}, inputs={"u": parse("sin(t)")})
    with pytest.raises(InputError, match="nothing says what 'u' is"):
        driven.fixed_points()
    assert driven.fixed_points(t=np.pi / 2)[0].at["x"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ([1.0], "the point has 1 values; give 2"),
        ({"x": 1.0}, "nothing says what 'y' is"),
        ({"x": 0.0, "y": 1.0}, "no slope at x = 0"),
    ],
)
def test_a_point_that_cannot_be_linearised_is_named(at, words):
    """Too few values, a missing state and a pole are each one line."""
    with pytest.raises(InputError, match=words):
        made({"x": "y/x", "y": "-y"}).linearise(at)


def test_fixed_points_are_found_wherever_they_are_in_the_box():
    """All nine of a product of cubics, whatever the scale of the states."""
    x, y = sympy.symbols("x y")
    scale = 1e6
    equations = {"x": (x - x**3) * 1e-3, "y": y - y**3 / scale**2}
    found = find_fixed_points(equations, {"x": (-1.2, 1.1), "y": (-1.1 * scale, 1.3 * scale)})
    places = {(round(p.at["x"]), round(p.at["y"] / scale)) for p in found}
    assert places == {(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    assert sum(p.stable for p in found) == 4


@pytest.mark.slow
def test_stability_is_lost_where_theory_says():
    """The Lorenz system's fixed points turn unstable at r = 24.74, and appear at r = 1."""
    found = of(LORENZ)
    values = np.linspace(0.55, 30.05, 60)
    branches = found.bifurcation("k3", values)
    (born, first), (lost, last) = branches.changes()
    assert born == pytest.approx(1.0, abs=0.5) and first == "1 stable -> 1 saddle, 2 stable"
    assert lost == pytest.approx(24.74, abs=0.5) and last == "1 saddle, 2 stable -> 3 saddle"
    with pytest.raises(InputError, match="unknown parameter 'k33'"):
        found.bifurcation("k33", values)
    figure = branches.plot("x")
    assert figure.axes[0].get_xlabel() == "k3"


def test_a_phase_portrait_shows_where_states_go():
    """Nullclines, fixed points and data of two states are drawn; others are refused."""
    figure = of(PENDULUM).phase_portrait()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["theta1' = 0", "theta2' = 0", "data", "stable"]
    with pytest.raises(InputError, match="two states"):
        of(LORENZ).phase_portrait()


@pytest.mark.slow
def test_a_report_says_where_the_equations_go(tmp_path):
    """It lists the fixed points, and draws the flow of two states."""
    page = of(PENDULUM).report(tmp_path / "report.html").read_text()
    assert "Fixed points" in page and "stable focus" in page and "The flow of the equations" in page
    driven = made({"x": "t - x"}, Trajectory(np.arange(9.0), np.ones((9, 1)), ("x",)))
    assert "Fixed points" not in driven.report(tmp_path / "driven.html").read_text()


@pytest.mark.slow
def test_a_report_searches_fixed_points_once(tmp_path, monkeypatch):
    """The table, the flow and the question whether there are any share one search."""
    searched = []
    monkeypatch.setattr(
        "dynsr.discovery.result.find_fixed_points",
        lambda *asked: searched.append(asked) or find_fixed_points(*asked),
    )
    assert "stable focus" in of(PENDULUM).report(tmp_path / "report.html").read_text()
    assert len(searched) == 1


def test_what_is_no_state_and_no_number_is_refused_by_name():
    """A point, a box and a picture name states; a parameter goes along finite numbers."""
    found = made({"prey": "prey*(1 - prey)"})
    said = "no state 'pray' \\(did you mean 'prey'\\?\\); the states are: prey"
    branches = found.bifurcation("k1", [0.5, 1.0])
    for ask in (
        lambda: found.linearise({"pray": 1.0}),
        lambda: found.fixed_points(box={"pray": (0.0, 1.0)}),
        lambda: branches.plot("pray"),
    ):
        with pytest.raises(InputError, match=said):
            ask()
    with pytest.raises(InputError, match="a value of 'k1' is no finite number; leave it out"):
        found.bifurcation("k1", [0.5, np.nan])
