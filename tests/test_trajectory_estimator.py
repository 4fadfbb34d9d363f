"""The estimator for trajectories: PySINDy's interface, and a script that runs with both."""

import contextlib
import io
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sklearn.base import clone

from dynsr import TrajectoryRegressor
from dynsr.errors import DynsrWarning, InputError

QUICK = {"preset": "quick", "jobs": 1}

SCRIPT = """
import numpy as np
from scipy.integrate import solve_ivp
from pysindy import SINDy


def rhs(t, s):
    return [1.5 * s[0] - s[0] * s[1], s[0] * s[1] - 3 * s[1]]


t = np.arange(0, 5, 0.01)
x = solve_ivp(rhs, (0, 5), [1, 1], t_eval=t, rtol=1e-10, atol=1e-10).y.T
model = SINDy()
model.fit(x, t=t, feature_names=["x", "y"])
model.print()
print(len(model.equations(3)))
slopes = model.predict(x)
assert np.allclose(slopes, np.transpose(rhs(0, x.T)), atol=0.1)
assert np.allclose(model.simulate(x[0], t), x, atol=0.1)
assert model.score(x, t=t) > 0.999
model.fit([x[:200], x[250:]], t=[t[:200], t[250:]])
model.print(lhs=["a", "b"], precision=1)
model.fit(x, t=0.01, x_dot=np.transpose(rhs(0, x.T)))
assert model.predict([x, x])[1].shape == x.shape
drive = np.sin(2 * t)[:, None]
z = solve_ivp(lambda t, s: np.sin(2 * t) - s, (0, 5), [1], t_eval=t, rtol=1e-10, atol=1e-10).y.T
model.fit(z, t=t, u=drive)
model.print()
again = model.simulate(z[0], t, u=lambda t: np.array([np.sin(2 * t)]))
assert np.allclose(again, z, atol=0.01)
assert model.score(z, t=t, u=drive) > 0.999
"""


def run(script):
    """Run a script in a namespace of its own and give the lines that it prints."""
    told = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(told):
        warnings.simplefilter("ignore")
        exec(script, {})
    return told.getvalue().splitlines()


@pytest.mark.slow
def test_a_script_for_pysindy_runs_with_both():
    """The very same lines run with either, and each finds the three systems in its own writing."""
    pytest.importorskip("pysindy")
    ours = SCRIPT.replace("from pysindy import", "from dynsr import TrajectoryRegressor as")
    assert sum(a != b for a, b in zip(SCRIPT.split("\n"), ours.split("\n"), strict=True)) == 1
    theirs = run(SCRIPT)
    assert [line.partition("=")[0] for line in theirs] == [
        *("(x)' ", "(y)' ", "2", "a ", "b ", "(x0)' "),
    ]
    assert run(ours) == [
        "(x)' = -x*y + 1.5*x",
        "(y)' = x*y - 3*y",
        "2",
        "a = -x0*x1 + 2*x0",
        "b = x0*x1 - 3*x1",
        "(x0)' = u0 - x0",
    ]


@pytest.fixture(scope="module")
def swing():
    """Give times and two states of an oscillator."""
    t = np.arange(0, 5, 0.02)
    return t, np.column_stack([np.sin(2 * t), 2 * np.cos(2 * t)])


@pytest.mark.slow
def test_the_slopes_are_those_of_the_equations(swing):
    """predict gives x' of every row; score is R2 of the slopes, 1 at best."""
    t, x = swing
    model = TrajectoryRegressor(**QUICK).fit(x, t=t, feature_names=["x", "v"])
    assert np.allclose(model.predict(x), np.column_stack([x[:, 1], -4 * x[:, 0]]))
    assert model.score(x, t) == pytest.approx(1.0)
    with pytest.warns(UserWarning, match="the slopes given of . look biased by"):
        assert model.score(x, t, x_dot=-model.predict(x)) < -2.9
    assert str(model) == "x' = v\nv' = -4*x" and model.discovery_.verdict.level == "law"
    assert set(model.equations_) == {"x", "v"}


def test_a_map(capsys):
    """With discrete_time rows follow one another: predict gives the next, simulate counts rows."""
    x = [0.3]
    while len(x) < 100:
        x.append(3.7 * x[-1] * (1 - x[-1]))
    model = TrajectoryRegressor(discrete_time=True, **QUICK).fit(np.array(x), t=1)
    model.print()
    assert capsys.readouterr().out == "(x0)[k+1] = -3.7*x0**2 + 3.7*x0\n"
    assert np.allclose(model.predict(np.array(x[:-1]))[:, 0], x[1:])
    assert np.allclose(model.simulate(0.3, 5)[:, 0], x[:5])


def test_it_is_an_estimator_of_scikit_learn():
    """Its settings are known by name, and a clone has them."""
    model = TrajectoryRegressor(method="sindy", random_state=3)
    assert clone(model).get_params() == model.get_params()


@pytest.mark.slow
def test_what_has_no_effect_says_so(swing):
    """PySINDy's own objects are taken, and a warning says that they do nothing."""
    t, x = swing
    with pytest.warns(DynsrWarning, match="optimizer has no effect"):
        model = TrajectoryRegressor(object(), **QUICK).fit(x, t)
    with pytest.warns(DynsrWarning, match="integrator has no effect"):
        model.simulate(x[0], t, integrator="odeint")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, "x needs its times"),
        ({"t": 0.1, "feature_names": ["a"]}, "1 feature_names do not fit 2 states and 0 inputs"),
        ({"t": 0.1, "u": [np.ones(250), np.ones(250)]}, "1 arrays of states"),
        ({"t": [0.0, 0.1]}, "do not fit"),
    ],
)
def test_what_does_not_fit_is_one_line(swing, arguments, said):
    """Missing times and other shapes are named."""
    with pytest.raises(InputError, match=said):
        TrajectoryRegressor(**QUICK).fit(swing[1], **arguments)


@pytest.mark.slow
def test_its_columns_are_those_of_the_fit(swing):
    """Rows of another width are refused."""
    t, x = swing
    model = TrajectoryRegressor(**QUICK).fit(x, t)
    with pytest.raises(InputError, match="1 columns do not fit 2 states"):
        model.predict(x[:, :1])
    with pytest.raises(InputError, match="must be the times"):
        model.simulate(x[0], 3.0)


@pytest.mark.slow
def test_inputs_as_an_array(swing):
    """Inputs given row by row drive the simulation as a function does."""
    t = swing[0]
    z = solve_ivp(
        lambda t, s: np.sin(2 * t) - s, (0, 5), [1.0], t_eval=t, rtol=1e-10, atol=1e-10
    ).y.T
    drive = np.sin(2 * t)
    model = TrajectoryRegressor(**QUICK).fit(z, t, u=drive)
    assert np.allclose(model.simulate(z[0], t, u=drive), z, atol=1e-5)


@pytest.mark.slow
def test_names_may_be_those_of_the_estimator(swing):
    """As in PySINDy 1; those of a fit go before, and do not stay for other data."""
    t, x = swing
    model = TrajectoryRegressor(feature_names=["q", "v"], **QUICK).fit(x, t)
    assert model.equations() == ["v", "-4*q"] and model.feature_names == ["q", "v"]
    assert model.fit(x, t, feature_names=["a", "b"]).equations() == ["b", "-4*a"]
    alone = TrajectoryRegressor(**QUICK).fit(x, t)
    decay = np.exp(-t)
    assert alone.fit(decay, t).feature_names == ["x0"]
    assert clone(TrajectoryRegressor(feature_names=["q", "v"])).feature_names == ["q", "v"]


@pytest.mark.slow
def test_the_step_may_be_that_of_the_estimator(swing):
    """As in PySINDy 1; without any, the line asks for it."""
    x = swing[1]
    model = TrajectoryRegressor(t_default=0.02, **QUICK).fit(x)
    assert model.equations() == ["x1", "-4*x0"]
    with pytest.raises(InputError, match="x needs its times"):
        TrajectoryRegressor(**QUICK).fit(x)


@pytest.mark.slow
def test_coefficients_are_those_of_the_equations(swing):
    """Features times coefficients are the slopes; complexity counts what is not 0."""
    t, x = swing
    z = solve_ivp(lambda t, s: 2.0 - 0.5 * s + 0.1 * s**2, (0, 5), [1.0], t_eval=t, rtol=1e-10).y.T
    model = TrajectoryRegressor(**QUICK).fit(z, t)
    from dynsr.expression import evaluate, parse

    columns = [
        np.broadcast_to(evaluate(parse(name), {"x0": z[:, 0]}), len(z))
        for name in model.get_feature_names()
    ]
    assert np.allclose(np.column_stack(columns) @ model.coefficients().T, model.predict(z))
    assert model.complexity == 3
    pair = TrajectoryRegressor(**QUICK).fit(x, t)
    assert pair.coefficients().shape == (2, 2) and pair.complexity == 2


@pytest.mark.slow
def test_a_method_of_differentiation_is_used(swing):
    """A function of states and times, or an object of PySINDy, gives the slopes."""
    t, x = swing
    asked = []

    def slopes(states, times):
        asked.append((states.shape, times.shape))
        return np.column_stack([states[:, 1], -4 * states[:, 0]])

    model = TrajectoryRegressor(differentiation_method=slopes, **QUICK).fit([x, x], [t, t])
    assert asked == [((250, 2), (250,))] * 2 and model.equations() == ["x1", "-4*x0"]
    pysindy = pytest.importorskip("pysindy", reason="pysindy is not installed")
    method = pysindy.FiniteDifference(order=4)
    theirs = TrajectoryRegressor(differentiation_method=method, **QUICK).fit(x, t)
    assert theirs.equations() == ["x1", "-4*x0"]
    with pytest.warns(DynsrWarning, match="differentiation_method has no effect"):
        TrajectoryRegressor(differentiation_method="trend", **QUICK).fit(x, t)


@pytest.mark.slow
def test_results_have_one_naming(swing, tmp_path):
    """What a discovery is turned into is called to_..., and load reads what save wrote."""
    import dynsr

    found = TrajectoryRegressor(**QUICK).fit(swing[1], swing[0]).discovery_
    assert found.to_latex() == found.latex() and found.to_sympy() == found.equations
    assert found.to_latex(names=True) == found.latex(names=True)
    assert dynsr.load(found.save(tmp_path / "found.json")).equations == found.equations
