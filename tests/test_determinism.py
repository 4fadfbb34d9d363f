"""What the columns leave open is told from the data alone, without false alarms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data import Trajectory, diagnose
from dynsr.data.determinism import Orbit, forced_share, nearest_pairs

ALARMS = {"missing state", "second order", "time dependence", "map"}


def solve(slope, start, end, rows):
    """Integrate to a tolerance far below what a diagnosis sees; gives times and states."""
    t = np.linspace(0.0, end, rows)
    done = solve_ivp(slope, (0.0, end), start, t_eval=t, rtol=1e-9, atol=1e-11, method="LSODA")
    return t, done.y.T


WHOLE = {
    "Lotka-Volterra": lambda: solve(
        lambda t, x: [1.1 * x[0] - 0.4 * x[0] * x[1], 0.1 * x[0] * x[1] - 0.4 * x[1]],
        [10.0, 5.0],
        40.0,
        800,
    ),
    "pendulum": lambda: solve(lambda t, x: [x[1], -9.81 * np.sin(x[0])], [1.5, 0.0], 10.0, 140),
    "damped pendulum": lambda: solve(
        lambda t, x: [x[1], -np.sin(x[0]) - 0.1 * x[1]], [2.0, 0.0], 30.0, 800
    ),
    "Lorenz": lambda: solve(
        lambda t, x: [
            10 * (x[1] - x[0]),
            x[0] * (28 - x[2]) - x[1],
            x[0] * x[1] - 8 / 3 * x[2],
        ],
        [1.0, 1.0, 1.0],
        20.0,
        2000,
    ),
    "Rossler": lambda: solve(
        lambda t, x: [-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - 5.7)],
        [1.0, 1.0, 1.0],
        60.0,
        1500,
    ),
    "SIR": lambda: solve(
        lambda t, x: [-0.5 * x[0] * x[1], 0.5 * x[0] * x[1] - 0.1 * x[1]], [0.99, 0.01], 60.0, 200
    ),
    "logistic growth": lambda: solve(lambda t, x: [x[0] * (1 - x[0])], [0.05], 10.0, 200),
    "Van der Pol": lambda: solve(
        lambda t, x: [x[1], (1 - x[0] ** 2) * x[1] - x[0]], [2.0, 0.0], 30.0, 800
    ),
    "FitzHugh-Nagumo": lambda: solve(
        lambda t, x: [x[0] - x[0] ** 3 / 3 - x[1] + 0.5, 0.08 * (x[0] + 0.7 - 0.8 * x[1])],
        [0.0, 0.0],
        150.0,
        750,
    ),
    "Brusselator": lambda: solve(
        lambda t, x: [1 + x[0] ** 2 * x[1] - 4 * x[0], 3 * x[0] - x[0] ** 2 * x[1]],
        [1.0, 1.0],
        40.0,
        800,
    ),
    "decay": lambda: solve(lambda t, x: [-0.7 * x[0]], [3.0], 8.0, 100),
    "Duffing": lambda: solve(
        lambda t, x: [x[1], x[0] - x[0] ** 3 - 0.2 * x[1]], [1.5, 1.0], 30.0, 800
    ),
    "competition": lambda: solve(
        lambda t, x: [x[0] * (1 - x[0] - 0.5 * x[1]), x[1] * (1.2 - x[1] - 0.6 * x[0])],
        [0.1, 0.05],
        25.0,
        150,
    ),
    "coupled oscillators": lambda: solve(
        lambda t, x: [x[1], -2 * x[0] + x[2], x[3], -3 * x[2] + x[0]],
        [1.0, 0.0, -0.5, 0.3],
        40.0,
        700,
    ),
}


def kinds(t, x, target="a", noise=0.0, multiplicative=False):
    """Diagnose one column of a table; give the kinds in their order."""
    draws = np.random.default_rng(3).normal(size=x.shape)
    noisy = x + noise * (x if multiplicative else x.std(axis=0)) * draws
    run = Trajectory(t, noisy, tuple("abcd"[: x.shape[1]]))
    return [cause.kind for cause in diagnose(run, target)]


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.slow
def test_whole_states_raise_no_alarm(name):
    """No state, order, time or map is called missing where all states are there, noise or not."""
    t, x = WHOLE[name]()
    for place, target in enumerate("abcd"[: x.shape[1]]):
        assert not ALARMS & set(kinds(t, x, target))
        # The noise of every other state is a share of its value, that of the rest of its spread.
        assert not ALARMS & set(kinds(t, x, target, 0.05, multiplicative=place % 2 == 1))


@pytest.mark.parametrize("noise", [0.0, pytest.param(0.004, marks=pytest.mark.slow)])
def test_a_state_that_comes_back_while_its_input_rests_looks_second_order(noise):
    """A circuit rings behind a step of the voltage; one without a coil goes one way each time."""
    t = np.arange(0, 40, 0.1)
    volts = np.where(t % 20 >= 2, 5.0, 0.0)

    def held(when):
        return volts[np.searchsorted(t, when, side="right") - 1]

    def follow(slopes, width):
        made = solve_ivp(
            lambda s, x: slopes(x, held(s)), (0, 40), [0.0] * width, "RK45", t, max_step=0.1
        )
        x = made.y[:1].T
        x = x + noise * x.std() * np.random.default_rng(2).normal(size=x.shape)
        return Trajectory(t, x, ("v",), volts[:, None], ("u",))

    ringing = follow(lambda x, u: [x[1], u - x[0] - 0.4 * x[1]], 2)
    assert [c.kind for c in diagnose(ringing, "v")] == ["second order", "missing state"]
    assert diagnose(follow(lambda x, u: [(u - x[0]) / 1.5], 1), "v") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["pendulum", "damped pendulum", "Van der Pol", "Lotka-Volterra", "SIR"]
)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_one_column_of_two_looks_second_order(name, noise):
    """Of a plane system one column alone is second-order, and a state is missing."""
    t, x = WHOLE[name]()
    column = x[:, [1]] if name == "SIR" else x[:, [0]]
    found = kinds(t, column, noise=noise)
    assert found[0] == "second order" and "missing state" in found


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_of_rossler_a_state_is_missed_where_it_acts(noise):
    """Without z, x' = -y - z is open and y' = x + a y is not."""
    t, x = WHOLE["Rossler"]()
    assert "missing state" in kinds(t, x[:, :2], "a", noise)
    assert not ALARMS & set(kinds(t, x[:, :2], "b", noise))


def test_a_table_too_short_for_neighbours_still_turns_back():
    """Twenty rows of one swing have no near passes, but a lone state cannot come back."""
    t = np.linspace(0, 5, 30)
    assert "missing state" in kinds(t, np.sin(t)[:, None])


def test_a_drive_in_time_is_named_with_its_period():
    """A Duffing oscillator with a cosine force of period 2 pi misses that time."""
    t, x = solve(
        lambda t, x: [x[1], x[0] - x[0] ** 3 - 0.2 * x[1] + 0.3 * np.cos(t)],
        [1.0, 0.0],
        100.0,
        1500,
    )
    run = Trajectory(t, x, ("a", "b"))
    assert diagnose(run, "a") == []
    first = diagnose(run, "b")[0]
    assert first.kind == "time dependence" and "--explicit-time" in first.sentence
    assert first.evidence["period"] == pytest.approx(2 * np.pi, rel=0.01)


def test_a_drive_that_is_a_column_is_no_drive_in_time():
    """The same oscillator with the force among the inputs leaves nothing open."""
    t, x = solve(
        lambda t, x: [x[1], x[0] - x[0] ** 3 - 0.2 * x[1] + 0.3 * np.cos(t)],
        [1.0, 0.0],
        100.0,
        1500,
    )
    run = Trajectory(t, x, ("a", "b"), np.cos(t)[:, None], ("F",))
    assert diagnose(run, "b") == []


def test_runs_that_agree_at_the_same_time_depend_on_it():
    """Many runs of x' = -(1 + t) x differ at the same x and agree at the same x and t."""
    t = np.linspace(0, 2, 60)
    starts = np.linspace(1, 3, 15)
    runs = [Trajectory(t, (s * np.exp(-t - t**2 / 2))[:, None], ("x",)) for s in starts]
    assert diagnose(runs, "x")[0].kind == "time dependence"
    steady = [Trajectory(t, (s * np.exp(-t))[:, None], ("x",)) for s in starts]
    assert diagnose(steady, "x") == []


def logistic_map(rows, rate=3.7):
    """Iterate x[n+1] = r x (1 - x)."""
    x = [0.3]
    for _ in range(rows - 1):
        x.append(rate * x[-1] * (1 - x[-1]))
    return np.array(x)[:, None]


def test_a_map_is_a_map_and_noise_is_noise():
    """The logistic map follows from row to row, white noise does not."""
    x = logistic_map(300)
    for noise in (0.0, 0.05):
        assert kinds(np.arange(300.0), x, noise=noise) == ["map"]
    shuffled = np.random.default_rng(0).permutation(x)
    assert kinds(np.arange(300.0), shuffled) == ["too much noise"]


def test_layers_too_fast_for_the_rows_are_stiff():
    """Van der Pol at mu = 50 with a thousand even rows moves in a few of them."""
    t, x = solve(lambda t, x: [x[1], 50 * (1 - x[0] ** 2) * x[1] - x[0]], [2.0, 0.0], 200.0, 1000)
    assert kinds(t, x, "a") == kinds(t, x, "b") == ["stiff"]


def test_a_system_that_was_started_again_is_said_where():
    """The place of the largest jump and what to do about a restart are named."""
    t = np.arange(0, 10, 0.25)
    grown = [5 / (1 + (5 / start - 1) * np.exp(-0.6 * t)) for start in (0.2, 0.5)]
    run = Trajectory(np.append(t, t + 10), np.concatenate(grown)[:, None], ("N",))
    (cause,) = diagnose(run, "N")
    assert "from t = 9.75 to 10." in cause.sentence and "(--trajectory)" in cause.sentence


def test_few_rows_an_oscillation_are_too_coarse():
    """The pendulum with 7 rows a swing, all states there: neither map nor noise."""
    t, x = WHOLE["pendulum"]()
    wide, table = t[::5], x[::5]
    assert kinds(wide, table)[0] == "sampling too coarse"


def test_every_sentence_names_the_column_and_few_rows_are_said():
    """A sentence stands alone; 20 rows of two species are few, and no more is made of them."""
    t, x = WHOLE["Lotka-Volterra"]()
    run = Trajectory(t[::40], x[::40], ("hare", "lynx"))
    causes = diagnose(run, "hare")
    assert [cause.kind for cause in causes][-1] == "too few rows"
    assert all("hare" in cause.sentence for cause in causes)


def test_what_cannot_move_or_is_tiny_gives_no_verdict():
    """A constant column and eight rows end in words, not in a fault."""
    t = np.arange(40.0)
    assert diagnose(Trajectory(t, np.ones((40, 1)), ("x",)), "x") == []
    few = Trajectory(t[:8], (t[:8, None]) ** 2, ("x",))
    assert [cause.kind for cause in diagnose(few, "x")] == ["too few rows"]


def test_the_share_left_open_is_one_less_what_is_explained():
    """With y = f(x) + e the share is var(e) / var(y), the statistic of Pi and Peterson."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 4000)
    noise = rng.normal(0, 0.3, 4000)
    y = np.sin(3 * x) + noise
    pairs = nearest_pairs(Orbit(x[:, None], y, np.arange(4000), np.zeros(4000)))
    assert pairs.share == pytest.approx(0.09 / np.var(y), rel=0.1)


def test_a_wave_is_found_among_wrong_periods():
    """Of many periods the true one explains the most; where there is no wave none does."""
    rng = np.random.default_rng(1)
    t = np.linspace(0, 50, 1000)
    x = rng.normal(size=1000)
    rows = np.arange(1000)
    driven = Orbit(x[:, None], x**2 + np.cos(2 * np.pi * t / 5), np.zeros(1000), rows)
    share, period = forced_share(nearest_pairs(driven), t, np.linspace(3, 8, 51))
    assert period == pytest.approx(5.0) and share > 0.9
    still = Orbit(x[:, None], x**2 + rng.normal(size=1000), np.zeros(1000), rows)
    assert forced_share(nearest_pairs(still), t, np.linspace(3, 8, 51))[0] < 0.1
