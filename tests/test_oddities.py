"""What looks odd in a table: each kind is seen in data that have it, and not in those without."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data.oddities import OddSettings, odd_states, odd_times, odd_values, resolution

T = np.linspace(0, 20, 200)


def kinds(x, t=T):
    """Give the kinds of what looks odd in a column."""
    return [odd.kind for odd in odd_values(t, x)]


def noise(size, seed=0, n=200):
    """Give normal noise."""
    return np.random.default_rng(seed).normal(0, size, n)


# Sound columns of many shapes: nothing may be said of them.
SOUND = {
    "a sine": np.sin(T),
    "a sine with noise": np.sin(T) + noise(0.05),
    "a sine of three digits": np.round(np.sin(T), 3),
    "growth to a rest": 20 / (1 + 19 * np.exp(-T)),
    "growth to a rest of four digits": np.round(20 / (1 + 19 * np.exp(-T)), 4),
    "decay to zero of five digits": np.round(np.exp(-2 * T), 5),
    "decay with noise": np.exp(-T / 5) + noise(0.02),
    "cooling of one digit": np.round(21.5 + 60 * np.exp(-T / 5), 1),
    "chaos": solve_ivp(
        lambda t, u: [10 * (u[1] - u[0]), u[0] * (28 - u[2]) - u[1], u[0] * u[1] - 8 / 3 * u[2]],
        (0, 20),
        [1, 1, 1],
        t_eval=np.linspace(0, 20, 1000),
        rtol=1e-8,
    ).y[0][::5],
    "jumps of an oscillator": solve_ivp(
        lambda t, u: [u[1], 5 * (1 - u[0] ** 2) * u[1] - u[0]], (0, 20), [2, 0], t_eval=T, rtol=1e-8
    ).y[0],
    "counts": np.random.default_rng(1).poisson(400 / (1 + 19 * np.exp(-T))).astype(float),
    "noise alone": noise(1.0),
    "a walk": np.cumsum(noise(1.0)),
    "steps of an input": np.repeat([1.0, 3.0, 2.0, 5.0], 50) + noise(0.01),
    "a map in chaos": np.array([0.3, *(0,) * 199]),
}
for i in range(199):
    SOUND["a map in chaos"][i + 1] = (
        3.9 * SOUND["a map in chaos"][i] * (1 - SOUND["a map in chaos"][i])
    )


@pytest.mark.parametrize("name", SOUND)
def test_nothing_is_odd_in_a_sound_column(name):
    """Rests, maxima, chaos, jumps, noise and counts look odd to no look."""
    assert kinds(SOUND[name]) == []


@pytest.mark.parametrize("rows", [15, 40, 200])
@pytest.mark.slow
def test_sound_noise_is_called_odd_as_rarely_as_is_said(rows):
    """Of 150 columns of noise alone at most one in thirty says something."""
    said = [kinds(noise(1.0, seed, rows), np.arange(1.0 * rows)) for seed in range(150)]
    assert sum(map(bool, said)) <= 5


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_a_stuck_sensor_is_seen(size):
    """Ten rows of one value amid a motion are named with their rows."""
    x = np.sin(T) + noise(size)
    x[50:60] = x[50]
    (odd,) = odd_values(T, x)
    assert (odd.kind, odd.rows) == ("stuck", (50, 59))
    assert "in rows 51 to 60" in odd.words and f"{x[50]:.4g}" in odd.words


def test_a_value_that_stands_in_two_rows_is_not_a_stuck_sensor():
    """Two equal neighbours happen in any column."""
    x = np.sin(T) + noise(0.02)
    x[50] = x[51]
    assert kinds(x) == []


@pytest.mark.parametrize("size", [0.0, 0.03])
def test_a_column_that_is_cut_off_is_seen(size):
    """A sine cut at 0.7 of its height is at its largest value in many rows."""
    x = np.minimum(np.sin(T) + noise(size), 0.7)
    (odd,) = odd_values(T, x)
    assert odd.kind == "saturated"
    assert f"at its largest value, 0.7, in {np.sum(x == 0.7)} of 200 rows" in odd.words


def test_a_limit_of_detection_is_seen():
    """Values below a limit written as the limit are at the smallest value in many rows."""
    x = np.maximum(np.exp(-T / 2) * (1 + noise(0.1)), 0.05)
    assert kinds(x) == ["saturated"]


def test_a_rest_is_not_cut_off():
    """A column that comes to rest at its largest value slowly is no sensor at its end."""
    x = np.round(5 * (1 - np.exp(-T)), 2)
    assert np.sum(x == 5) > 100 and kinds(x) == []


def test_coarse_rounding_is_seen_with_its_step():
    """Steps of 0.25 of a motion of spread 0.7 are said; steps of 0.01 are not."""
    (odd,) = odd_values(T, np.round(4 * np.sin(3 * T + 0.1) + noise(0.3)) / 4)
    assert odd.kind == "rounded" and "steps of 0.25, 3" in odd.words
    assert kinds(np.round(np.sin(T), 2)) == []


def test_a_column_written_more_often_than_measured_is_seen():
    """Values that each stand in four rows are told from a motion of four times the steps."""
    x = np.repeat(np.sin(T[::4]), 4)
    (odd,) = odd_values(T, x)
    assert odd.kind == "repeated" and "changes in 49 of 199 rows" in odd.words
    assert "one of about 4 rows" in odd.meaning
    assert kinds(x[::4], T[::4]) == []


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_a_spike_is_seen_in_its_row(size):
    """One row far off is named; a peak of several rows is none."""
    x = np.sin(T) + noise(size)
    x[70] += 2
    (odd,) = odd_values(T, x)
    assert (odd.kind, odd.rows) == ("spike", (70, 70)) and "in row 71, between" in odd.words
    peak = np.sin(T) + noise(size) + 2 * np.exp(-((T - 7) ** 2) / 0.1)
    assert kinds(peak) == []


def test_a_spike_amid_uneven_times_is_one_of_values():
    """A straight line at uneven times has no spike: the times count."""
    t = np.cumsum(np.random.default_rng(2).exponential(1.0, 60))
    x = 3 * t + 1e-6 * np.sin(t)
    assert kinds(x, t) == []
    x[30] += 40
    assert kinds(x, t) == ["spike"]


@pytest.mark.parametrize("rows", [3.3, 5.0, 8.0])
def test_an_oscillation_of_few_rows_is_seen(rows):
    """Fewer than ten rows an oscillation are said with their number; twelve are enough."""
    n = np.arange(60.0)
    odd = {o.kind: o for o in odd_values(n, np.sin(2 * np.pi * n / rows) + noise(0.1, n=60))}
    assert list(odd) == ["coarse"]
    said = float(re.search(r"about (\S+) rows an", odd["coarse"].words)[1])
    assert said == pytest.approx(rows, rel=0.03)
    assert kinds(np.sin(2 * np.pi * n / 12) + noise(0.1, n=60), n) == []


def test_gaps_of_the_clock_are_seen():
    """A night without rows is a gap, told with its row, its length and the usual step."""
    t = np.concatenate([np.arange(0, 8, 0.25), np.arange(24, 32, 0.25)])
    (odd,) = odd_times(t)
    assert odd.kind == "gap"
    assert odd.words == "jumps by 16.25 in row 33, where a step is 0.25"
    assert [odd.kind for odd in odd_times(np.arange(0, 8, 0.25))] == []


@pytest.mark.parametrize(
    "t",
    [
        [0, 0.25, 0.5, 1, 2, 3, 4, 6, 8, 12, 24],
        2.0 ** np.arange(12),
        np.cumsum([1, 1, 2, 1, 1, 3, 1, 1, 1, 2]),
    ],
)
def test_times_that_spread_out_are_uneven_and_have_no_gap(t):
    """Samples taken more and more seldom, and a row left out here and there, are no gaps."""
    assert [odd.kind for odd in odd_times(np.asarray(t, dtype=float))] == ["uneven"]


def test_times_written_with_few_digits_are_even():
    """Rounding of the times in their last digit is nothing to speak of."""
    assert odd_times(np.round(np.arange(0, 30, 1 / 3), 4)) == []


@pytest.mark.parametrize(
    ("x", "step"),
    [
        ([1.0, 2.0, 5.0], 1.0),
        ([0.1, 0.3, 0.9], 0.2),
        ([1000.0, 1500.0, 3000.0], 500.0),
        ([21.55, 21.5, 21.6], 0.05),
        ([1 / 3, 2 / 7, 0.9], 0.0),
        (np.round(0.00488 * 7.3 * np.arange(50), 4), 0.00488 * 7.3),
    ],
)
def test_the_resolution_of_a_column(x, step):
    """Decimals, halves, hundreds and the steps of a converter are read; full floats have none."""
    assert resolution(np.array(x)) == pytest.approx(step, rel=1e-3, abs=1e-15)


def test_a_state_that_follows_from_others_is_seen():
    """Sums that do not change, and a copy in other units, are told; noise makes them two."""
    s = np.exp(-T / 5)
    i = s * (1 - s)
    assert odd_states({"S": s, "I": i, "R": 1 - s - i}) == [("R", "R is 1 - S - I in every row")]
    fahrenheit = np.round(32 + 1.8 * np.round(50 * s, 1), 1)
    ((name, text),) = odd_states({"C": np.round(50 * s, 1), "F": fahrenheit})
    assert (name, text) == ("F", "F is 32 + 1.8*C in every row")
    assert odd_states({"S": s, "R": 1 - s + noise(0.001)}) == []
    growths = {f"x{k}": np.round(0.05 * np.exp(k * T / 80), 3) for k in (9, 10, 11)}
    assert odd_states(growths) == []
    counts = {n: np.round(1000 * own) for n, own in {"S": s, "I": i, "R": 1 - s - i}.items()}
    assert odd_states(counts) == [("R", "R is 1000 - S - I in every row")]
    assert odd_states({"S": s, "I": i, "J": np.exp(-T / 4)}) == []


def test_settings_decide():
    """Every number of the settings is read: another one changes what is said."""
    t = np.array([0.0, 1, 2, 3, 4, 12, 13, 14, 15])
    assert [o.kind for o in odd_times(t)] == ["uneven"]
    assert [o.kind for o in odd_times(t, OddSettings(gap=7))] == ["gap"]
    assert odd_times(t, OddSettings(even=1.0)) == []
    x = np.sin(T)
    x[70] += 1
    assert kinds(x) == ["spike"]
    assert odd_values(T, x, OddSettings(spike=50)) == []
    stuck = np.sin(T)
    stuck[50:54] = stuck[50]
    assert kinds(stuck) == ["stuck"]
    assert odd_values(T, stuck, OddSettings(chance=1e-8)) == []
    slow = np.round(np.sin(T), 3)
    slow[50:60] = slow[50]
    assert kinds(slow) == ["stuck"]
    assert odd_values(T, slow, OddSettings(edge=1e4)) == []
    assert [o.kind for o in odd_values(T, np.round(x, 1) - 0, OddSettings(rounding=1e-3))]
    assert [o.kind for o in odd_values(T, np.sin(T), OddSettings(rows=100))] == ["coarse"]


def test_a_mark_of_no_value_is_seen_and_hides_nothing():
    """A number far from all others, several times, is named; spikes beside it keep their rows."""
    x = np.sin(T) + noise(0.02)
    x[[5, 6, 90]] = -999
    x[120] += 3
    mark, spike = odd_values(T, x)
    assert (mark.kind, mark.rows) == ("mark", (5, 90)) and "is -999 in 3 of 200 rows" in mark.words
    assert (spike.kind, spike.rows) == (
        "spike",
        (120, 120),
    ) and "in row 121, between" in spike.words
    assert kinds(np.where(np.arange(200) % 50 < 2, 1.2, 0) + np.sin(T)) == []


def test_rows_without_a_value_are_passed_over_and_counted():
    """What stands behind an empty cell keeps the row that it has in the run."""
    x = np.sin(T) + noise(0.02)
    x[10:30] = np.nan
    x[120] += 3
    (odd,) = odd_values(T, x)
    assert odd.rows == (120, 120) and "in row 121, between" in odd.words


@pytest.mark.parametrize("size", [1e300, 1e-300, 0.0])
def test_numbers_of_any_size_are_looked_at_without_a_word(size):
    """Squares that overflow or vanish warn of nothing and are evidence of nothing."""
    x = size * noise(1.0)
    assert set(kinds(x)) <= {"coarse"}
    assert odd_states({"x": x, "y": np.sin(T), "z": np.exp(-T)}) == []


def test_a_gap_of_any_length_costs_nothing_and_hides_no_oscillation():
    """Rows of five an oscillation are told beside a gap of a hundred million steps."""
    t = np.concatenate([np.arange(50.0), 1e8 + np.arange(20.0)])
    assert kinds(np.sin(2 * np.pi * t / 5) + noise(0.1, n=70), t) == ["coarse"]
