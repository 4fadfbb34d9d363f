import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynsr.data import (
    SlopeSettings,
    StateNoise,
    Trajectory,
    choose_samples,
    estimate_noise,
    measurement_noise,
    smooth,
)
from dynsr.errors import InputError


def lotka_volterra(rows, end=30.0):
    """Give times, states and slopes of two species that chase each other."""

    def slope(_, z):
        return np.array([1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]])

    t = np.linspace(0, end, rows)
    x = solve_ivp(slope, (0, end), [10.0, 5.0], t_eval=t, rtol=1e-8, atol=1e-8).y.T
    return t, x, np.array([slope(0, z) for z in x])


def logistic(rows, end=80.0):
    """Give times, states and slopes of a growth that rests after a tenth of the record."""
    t = np.linspace(0, end, rows)
    x = 10 / (1 + (10 / 0.3 - 1) * np.exp(-t))
    return t, x[:, None], (x * (1 - x / 10))[:, None]


def measured(t, x, additive, multiplicative, seed):
    """Give the trajectory that an instrument with such noise would."""
    rng = np.random.default_rng(seed)
    noise = additive * rng.normal(size=x.shape) + multiplicative * x * rng.normal(size=x.shape)
    return Trajectory(t, x + noise, ("x", "y")[: x.shape[1]])


@pytest.mark.slow
@pytest.mark.parametrize("rows", [60, 1000])
@pytest.mark.parametrize(("additive", "multiplicative"), [(0.5, 0.0), (0.0, 0.05), (0.5, 0.1)])
@pytest.mark.parametrize("outliers", [0.0, 0.03])
def test_the_size_of_the_noise_is_recovered(rows, additive, multiplicative, outliers):
    """In the median of 3 draws the mean noise is right within 3 / sqrt(rows), with outliers too."""
    t, x, _ = lotka_volterra(rows)
    sizes = []
    for seed in range(3):
        run = measured(t, x[:, :1], additive, multiplicative, seed)
        rng = np.random.default_rng(seed)
        sd = np.hypot(additive, multiplicative * run.x)
        off = (rng.random(run.x.shape) < outliers) * 15 * sd * rng.choice([-1, 1], run.x.shape)
        found = estimate_noise([Trajectory(t, run.x + off, ("x",))])[0]
        true = np.hypot(additive, multiplicative * x[:, 0])
        sizes.append(np.sqrt(np.mean(found.sd(x[:, 0]) ** 2) / np.mean(true**2)))
    assert np.median(sizes) == pytest.approx(1.0, abs=3 / np.sqrt(rows))


def test_solver_output_has_no_noise():
    """A trajectory of a solver at tolerance 1e-8 has noise below a millionth of its spread."""
    t, x, _ = lotka_volterra(1000)
    for noise, spread in zip(
        estimate_noise([Trajectory(t, x, ("x", "y"))]), x.std(axis=0), strict=True
    ):
        assert np.max(noise.sd(x)) < 1e-6 * spread


def decays():
    """Give decays to 0 with noise of 1 % of the value, written with four digits."""
    rng, t = np.random.default_rng(3), np.arange(0, 40.1, 1.0)
    levels = [
        start * np.exp(-0.5 * t) * (1 + 0.01 * rng.normal(size=len(t))) for start in (1, 3, 9)
    ]
    return [Trajectory(t, np.round(x, 4)[:, None], ("x",)) for x in levels]


def test_rows_that_rest_at_zero_say_nothing_of_the_noise():
    """Most rows are 0.0000: noise is a share of the value, and no less than rounding anywhere."""
    runs = decays()
    (found,) = estimate_noise(runs)
    assert found.multiplicative == pytest.approx(0.01, rel=0.5)
    assert found.additive == pytest.approx(1e-4 / np.sqrt(12), rel=0.1)
    sized = [measurement_noise(run)[0] / np.std(run.x) for run in runs]
    assert min(sized) > 1e-5


def test_too_few_rows_have_no_noise_to_estimate():
    """Below five rows the noise is 0; below four there is nothing to smooth, and a line says so."""
    short = Trajectory([0.0, 1.0, 2.0], [[1.0], [2.0], [1.0]], ("x",))
    assert estimate_noise([short]) == (StateNoise(0.0),)
    with pytest.raises(InputError, match="3 rows are too few to smooth"):
        smooth(short, (StateNoise(0.1),))


@pytest.mark.parametrize("rows", [4, 5, 6, 7, 8, 11, 15])
def test_few_rows_are_smoothed(rows):
    """From four rows on everything is finite, whatever the times."""
    rng = np.random.default_rng(rows)
    t = np.cumsum(rng.uniform(0.1, 2, rows))
    run = Trajectory(t, rng.normal(size=(rows, 2)), ("x", "y"))
    found = smooth(run, estimate_noise([run]))
    for part in (found.x, found.slope, found.x_sd, found.slope_sd, found.noise):
        assert part.shape == (rows, 2) and np.all(np.isfinite(part))


def test_a_constant_state_stays_what_it_is():
    """A state that never moves is smoothed to itself with slope 0."""
    run = Trajectory(np.arange(9.0), np.full((9, 1), 3.0), ("x",))
    found = smooth(run, estimate_noise([run]))
    assert np.all(found.x == 3.0) and np.all(found.slope == 0.0)


@pytest.mark.parametrize(
    ("signal", "rows", "additive", "multiplicative", "states", "slopes"),
    [
        (lotka_volterra, 150, 0.2, 0.0, 0.05, 0.16),
        (lotka_volterra, 150, 0.0, 0.05, 0.055, 0.19),
        (logistic, 150, 0.05, 0.0, 0.02, 0.1),
    ],
)
@pytest.mark.slow
def test_states_and_slopes_are_close_to_the_truth(
    signal, rows, additive, multiplicative, states, slopes
):
    """Errors (RMS, as a share of the truth's), ends and transients included, in the median draw."""
    t, x, true = signal(rows)
    misses = []
    for seed in range(3):
        run = measured(t, x, additive, multiplicative, seed)
        found = smooth(run, estimate_noise([run]))
        misses.append(
            [
                np.sqrt(np.mean((found.x - x) ** 2 / x.var(axis=0))),
                np.sqrt(np.mean((found.slope - true) ** 2 / np.mean(true**2, axis=0))),
            ]
        )
    assert np.all(np.median(misses, axis=0) < [states, slopes])


@pytest.mark.slow
def test_the_truth_lies_within_two_standard_deviations():
    """Over 6 draws of an oscillation, 88 to 99 % of states and slopes do."""
    t = np.linspace(0, 30, 120)
    x = np.exp(-0.05 * t) * np.sin(t)
    true = np.exp(-0.05 * t) * (np.cos(t) - 0.05 * np.sin(t))
    inside = []
    for seed in range(6):
        run = measured(t, x[:, None], 0.05, 0.0, seed)
        found = smooth(run, estimate_noise([run]))
        inside.append(np.abs(found.x[:, 0] - x) < 2 * found.x_sd[:, 0])
        inside.append(np.abs(found.slope[:, 0] - true) < 2 * found.slope_sd[:, 0])
    assert 0.88 < np.mean(inside) < 0.99


def test_outliers_do_not_bend_the_curve():
    """Three rows 20 standard deviations off change the smoothed states by less than the noise."""
    t = np.linspace(0, 10, 120)
    run = measured(t, np.sin(t)[:, None], 0.05, 0.0, 3)
    spoilt = run.x.copy()
    spoilt[[20, 61, 90]] += 1.0
    found = smooth(Trajectory(t, spoilt, ("x",)), (StateNoise(0.05),))
    assert np.max(np.abs(found.x[:, 0] - np.sin(t))) < 0.05


def test_the_curve_runs_through_the_smoothed_states():
    """Between rows the curve follows the truth; at rows it is the smoothed state."""
    t = np.linspace(0, 6, 60)
    run = measured(t, np.column_stack([np.sin(t), np.cos(t)]), 0.001, 0.0, 0)
    found = smooth(run, estimate_noise([run]))
    assert np.allclose(found.curve(t), found.x.T)
    between = (t[1:] + t[:-1]) / 2
    assert np.max(np.abs(found.curve(between) - [np.sin(between), np.cos(between)])) < 0.004


@pytest.mark.slow
def test_long_records_are_smoothed_in_pieces():
    """3000 rows of 120 cycles keep their slopes across the joints of the pieces."""
    t = np.linspace(0, 240 * np.pi, 3000)
    run = measured(t, np.sin(t)[:, None], 0.02, 0.0, 1)
    found = smooth(run, estimate_noise([run]))
    assert np.max(np.abs(found.slope[:, 0] - np.cos(t))) < 0.15


def test_few_noisy_rows_take_their_slopes_from_the_process():
    """With 60 noisy rows the data choose the process: its slopes err less than a polynomial'."""
    t, x, true = lotka_volterra(60)
    run = measured(t, x, 0.1, 0.0, 2)
    found = choose_samples(run, "x")
    assert found.scheme == "gp" and len(found.slope_sd) == len(found) >= 48
    rest = choose_samples(run, "x", settings=SlopeSettings(processed=0))
    assert rest.scheme.startswith("savgol") and rest.slope_sd is None

    def error(samples):
        rows = np.searchsorted(t, samples.t)
        return np.sqrt(np.mean((samples.y - true[rows, 0]) ** 2))

    assert error(found) < 0.7 * error(rest)
    assert len(found.select(slice(3)).slope_sd) == 3


@pytest.mark.parametrize("rows", [6, 9, 14])
def test_the_scheme_is_asked_for_by_name(rows):
    """Scheme "gp" works from few rows on, on uneven times, for several trajectories together."""
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1, rows))
    run = measured(t, np.sin(t)[:, None], 0.05, 0.0, 1)
    found = choose_samples([run, run], "x", scheme="gp")
    assert found.scheme == "gp" and len(found.slope_sd) == len(found) > rows
