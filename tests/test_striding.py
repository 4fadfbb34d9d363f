import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from dynsr.expression.parsing import parse
from dynsr.fit.flow import Flow, Pace, Windows

T = np.linspace(0, 2, 201)
RHS = {"a": parse("b"), "b": parse("-9.81*sin(a) - 0.1*b + F")}
START = np.array([[1.0], [0.3]])


def drive(times):
    """Force and time."""
    return np.stack([np.sin(6 * times), times])


WINDOWS = Windows(T[:, None], np.zeros((len(T), 2, 1)), drive)


@pytest.mark.parametrize("stride", [2, 3, 8])
def test_strides_follow_the_solution(stride):
    """States at every row are those of DOP853, whether or not the rows divide by the stride."""
    found = Flow(RHS, ("F",), (), stride).run(WINDOWS, START, np.empty(0))
    truth = solve_ivp(
        lambda t, s: [s[1], -9.81 * np.sin(s[0]) - 0.1 * s[1] + np.sin(6 * t)],
        *((0, 2), START[:, 0], "DOP853"),
        t_eval=T,
        rtol=1e-11,
        atol=1e-11,
    ).y.T
    assert found.shape == (201, 2, 1)
    assert np.allclose(found[:, :, 0], truth, atol=3e-7 * stride**4)


@pytest.mark.parametrize("substeps", [1, 2])
def test_steps_of_order_eight_follow_the_solution_closely(substeps):
    """Over ten rows at once, with a force, they stay within rounding of DOP853's own steps."""
    coarse = Windows(T[::10, None], np.zeros((21, 2, 1)), drive)
    found = Flow(RHS, ("F",), ()).run(coarse, START, np.empty(0), Pace(substeps, True))
    truth = solve_ivp(
        lambda t, s: [s[1], -9.81 * np.sin(s[0]) - 0.1 * s[1] + np.sin(6 * t)],
        *((0, 2), START[:, 0], "DOP853"),
        t_eval=T[::10],
        rtol=1e-12,
        atol=1e-12,
    ).y.T
    assert np.allclose(found[:, :, 0], truth, atol=2e-9 / 2 ** (6 * (substeps - 1)))


LONELY = [
    {"a": parse("b"), "b": parse("-9.81*sin(a) - 0.1*b + F")},
    {"a": parse("-0.5*a + tanh(b) + sign(a)"), "b": parse("abs(a - b) - exp(b)/(2 + cos(b))")},
    # Beside their domain: a root and a power of what falls below 0, a pole, a blow-up.
    {"a": parse("-1 - sqrt(a)"), "b": parse("cos(t) - 0.3*b")},
    {"a": parse("-2 - a^1.5"), "b": parse("log(a)")},
    {"a": parse("-1/(a - 1)"), "b": parse("b")},
    {"a": parse("exp(a^2)"), "b": parse("sin(a) - b")},
]


@pytest.mark.parametrize("pace", [Pace(2), Pace(1, True)])
@pytest.mark.parametrize("rhs", LONELY, ids=str)
def test_a_lane_alone_goes_as_it_does_beside_another(rhs, pace):
    """One run on floats is the same run among two on arrays, NaN and infinity in their places."""
    two = Windows(np.repeat(T[:, None], 2, axis=1), np.zeros((len(T), 2, 2)), drive)
    flow = Flow(rhs, ("F",), ())
    alone = flow.track(WINDOWS, START, np.empty(0), pace)
    beside = flow.track(two, np.repeat(START, 2, axis=1), np.empty(0), pace)
    for own, other in ((alone.rows, beside.rows), (alone.nodes, beside.nodes)):
        assert np.allclose(own[..., 0], other[..., 1], rtol=1e-9, atol=1e-12, equal_nan=True)
    assert np.isfinite(alone.rows[1]).any()


def test_probes_have_the_sensitivity_of_their_term():
    """The slope by a probe is what a small multiple of its term changes, the states as before."""
    flow = Flow(RHS, ("F",), (sympy.Symbol("p"),), 2, ((1, parse("a*b")),))
    states, slopes = flow.run_sensitive(WINDOWS, START, np.zeros(1))
    plain = Flow(RHS, ("F",), (), 2).run(WINDOWS, START, np.empty(0))
    assert np.array_equal(states, plain)
    moved = {**RHS, "b": RHS["b"] + 1e-5 * parse("a*b")}
    more = Flow(moved, ("F",), (), 2).run(WINDOWS, START, np.empty(0))
    assert np.allclose(slopes[:, :, 0], (more - plain) / 1e-5, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stride", "pace"),
    [
        (1, Pace(1)),
        (1, Pace(3)),
        (3, Pace(1)),
        (300, Pace(1)),
        (1, Pace(2, True)),
        (3, Pace(1, True)),
    ],
)
@pytest.mark.parametrize("lanes", [1, 64])
def test_sensitivities_are_those_of_the_march(stride, pace, lanes, monkeypatch):
    """Steps differentiated apart, few or many at a time, join to the slopes of the whole march."""
    monkeypatch.setattr("dynsr.fit.flow._LANES", lanes)
    rhs = {"a": RHS["a"], "b": sympy.Symbol("c") * sympy.sin(sympy.Symbol("a")) + parse("F")}
    flow = Flow(rhs, ("F",), (sympy.Symbol("c"),), stride)
    at = np.array([-9.81])
    _, slopes = flow.run_sensitive(WINDOWS, START, at, pace)
    assert slopes.shape == (201, 2, 3, 1)
    step = 1e-6

    def moved(constants, start):
        return flow.run(WINDOWS, start, constants, pace)

    by_constant = (moved(at + step, START) - moved(at - step, START)) / (2 * step)
    np.testing.assert_allclose(slopes[:, :, 0], by_constant, atol=1e-6, rtol=1e-6)
    for j, shift in enumerate(step * np.eye(2)[..., None]):
        by_start = (moved(at, START + shift) - moved(at, START - shift)) / (2 * step)
        np.testing.assert_allclose(slopes[:, :, 1 + j], by_start, atol=1e-6, rtol=1e-6)


def test_driven_columns_are_read_once():
    """Windows ask for the driven columns at all times once, whatever flows run over them."""
    asked = []

    def counted(times):
        asked.append(len(times))
        return drive(times)

    windows = Windows(WINDOWS.t, WINDOWS.x, counted)
    expected = [drive(row) for row in np.linspace(0, 2, 401)[:, None]]
    np.testing.assert_allclose(windows.driven_at(), expected, atol=1e-13)
    before = len(asked)
    assert before == 1
    windows.driven_at()
    for stride in (1, 4):
        one = Flow(RHS, ("F",), (), stride).run(windows, START, np.empty(0))
        assert len(asked) == before and np.isfinite(one).all()
