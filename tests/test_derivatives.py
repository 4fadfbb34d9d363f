import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

from dynsr.data.samples import make_samples
from dynsr.data.slopes import (
    BiasWarning,
    choose_samples,
    choose_scheme,
    measurement_noise,
    slope_bias,
    smooth_column,
    warn_if_biased,
)
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


def lotka_volterra(t, noise=0.0, seed=0):
    """Give the noisy trajectory, the exact states and the exact slopes."""

    def slopes(_, s):
        return [s[0] * (1.5 - s[1]), -s[1] * (3 - s[0])]

    x = solve_ivp(slopes, (t[0], t[-1]), [1.0, 1.0], "DOP853", t, rtol=1e-12, atol=1e-12).y.T
    noisy = x + noise * x.std(axis=0) * np.random.default_rng(seed).standard_normal(x.shape)
    return Trajectory(t, noisy, ("x", "y")), x, np.column_stack(slopes(0, x.T))


GRID = np.arange(1001) * 0.01


@pytest.mark.parametrize("share", [1e-4, 0.01, 0.05])
@pytest.mark.parametrize("order", [0, 1])
def test_noise_is_estimated_within_a_tenth(share, order):
    """The noise of each state is found within 10 %, on even and on uneven times."""
    t = GRID if order == 0 else np.sort(np.random.default_rng(3).uniform(0, 10, 1001))
    noisy, clean, _ = lotka_volterra(t, share)
    assert measurement_noise(noisy) == pytest.approx(share * clean.std(axis=0), rel=0.1)


def test_clean_data_show_no_noise():
    """Exact data have a noise estimate far below a millionth of their size."""
    exact, clean, _ = lotka_volterra(GRID)
    assert np.all(measurement_noise(exact) < 1e-8 * clean.std(axis=0))


def test_clean_data_take_high_order_differences():
    """Without noise the slopes come from central differences and err below 1e-5."""
    exact, _, slopes = lotka_volterra(GRID)
    samples = choose_samples(exact, "y")
    rows = np.searchsorted(GRID, samples.t)
    assert samples.scheme.startswith("central")
    assert np.sqrt(np.mean((samples.y - slopes[rows, 1]) ** 2)) < 1e-5
    assert np.array_equal(samples.X, exact.x[rows])


@pytest.mark.parametrize(("share", "limit"), [(0.001, 0.004), (0.01, 0.03), (0.05, 0.06)])
def test_noisy_data_are_smoothed(share, limit):
    """Slopes of noisy data err by a small share, and far less than plain differences do."""
    noisy, clean, slopes = lotka_volterra(GRID, share, 1)
    samples = choose_samples(noisy, "y")
    rows = np.searchsorted(GRID, samples.t)
    size = slopes[:, 1].std()
    error = np.sqrt(np.mean((samples.y - slopes[rows, 1]) ** 2)) / size
    plain = smooth_column(GRID, noisy.x[:, 1], "central2")
    plain_error = np.sqrt(np.mean((plain.slope - slopes[plain.rows, 1]) ** 2)) / size
    assert error < limit and error < plain_error / 5
    assert samples.noise == pytest.approx(error * size, rel=0.5)
    kept = np.sqrt(np.mean((samples.X[:, 1] - clean[rows, 1]) ** 2))
    assert kept < 0.6 * share * clean[:, 1].std()


@pytest.mark.slow
def test_the_choice_is_near_the_best_scheme():
    """The chosen scheme errs at most 1.3 times as much as the best one in hindsight."""
    noisy, _, slopes = lotka_volterra(GRID, 0.02, 4)
    x = noisy.x[:, 0]

    def error(scheme):
        smooth = smooth_column(GRID, x, scheme)
        return np.sqrt(np.mean((smooth.slope - slopes[smooth.rows, 0]) ** 2))

    chosen = choose_scheme(GRID, x, measurement_noise(noisy)[0]).scheme
    names = [f"savgol({w},{d})" for w in (9, 17, 31, 41, 55, 73) for d in (2, 4, 6)] + ["spline"]
    assert error(chosen) < 1.3 * min(error(name) for name in names)


@pytest.mark.slow
def test_uneven_times_work():
    """Random sampling times give slopes within 3 % from 1 % noise."""
    t = np.sort(np.random.default_rng(5).uniform(0, 10, 900))
    noisy, _, slopes = lotka_volterra(t, 0.01)
    samples = choose_samples(noisy, "x")
    rows = np.searchsorted(t, samples.t)
    error = np.sqrt(np.mean((samples.y - slopes[rows, 0]) ** 2))
    assert error < 0.03 * slopes[:, 0].std()


@pytest.mark.parametrize("scheme", ["spline", "savgol(31,4)", "total-variation"])
def test_named_schemes_recover_slopes(scheme):
    """Each smoother by name beats plain differences on noisy data."""
    if scheme == "total-variation":
        pytest.importorskip("derivative")
    t = GRID[:300]
    noisy, _, slopes = lotka_volterra(t, 0.01)
    samples = choose_samples(noisy, "x", scheme=scheme)
    rows = np.searchsorted(t, samples.t)
    plain = smooth_column(t, noisy.x[:, 0], "central2")
    error = np.std(samples.y - slopes[rows, 0])
    assert error < 0.5 * np.std(plain.slope - slopes[plain.rows, 0])
    assert samples.scheme == scheme


@pytest.mark.parametrize("scheme", ["forward", "backward"])
def test_one_sided_differences_leave_the_data_as_they_are(scheme):
    """Asked for by name, they give the rise over the run beside the data, noise and all."""
    t = np.sort(np.random.default_rng(0).uniform(0, 10, 300))
    noisy = lotka_volterra(t, noise=0.05)[0]
    rows = slice(None, -1) if scheme == "forward" else slice(1, None)
    for found in (choose_samples(noisy, "y", scheme=scheme), make_samples(noisy, "y", scheme)):
        np.testing.assert_array_equal(found.X, noisy.x[rows])
        np.testing.assert_allclose(found.y, np.diff(noisy.x[:, 1]) / np.diff(t), rtol=1e-12)
        np.testing.assert_array_equal(found.t, t[rows])
        assert found.scheme == scheme


@pytest.mark.parametrize(("window", "degree"), [(5, 2), (31, 4), (41, 6)])
def test_local_polynomials_are_those_of_savitzky_and_golay(window, degree):
    """On even times, values and slopes are scipy's to its own rounding."""
    x = np.random.default_rng(7).normal(size=300)
    smooth = smooth_column(0.01 * np.arange(300), x, f"savgol({window},{degree})")
    for order, found in ((0, smooth.x), (1, smooth.slope)):
        expected = savgol_filter(x, window, degree, deriv=order, delta=0.01)[smooth.rows]
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_own_slopes_are_used_and_checked():
    """Slopes that the user gives come out unchanged; shifted ones raise a warning of bias."""
    exact, _, slopes = lotka_volterra(GRID)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        samples = choose_samples(exact, "y", slopes=slopes[:, 1])
    rows = np.searchsorted(GRID, samples.t)
    assert samples.scheme == "given" and np.array_equal(samples.y, slopes[rows, 1])
    with pytest.warns(BiasWarning, match="the slopes given of y look biased"):
        choose_samples(exact, "y", slopes=slopes[:, 1] + 0.2)
    with pytest.raises(InputError, match="1001"):
        choose_samples(exact, "y", slopes=slopes[:50, 1])


def test_given_slopes_are_as_sure_as_those_of_the_states_show():
    """Where some are off, they and the rows next to them are as unsure as they are off."""
    exact, _, slopes = lotka_volterra(GRID)
    off = np.where((GRID >= 4) & (GRID < 6), 1e-3, 0.0)
    found = choose_samples(exact, "y", slopes=slopes[:, 1] + off)
    inside = (found.t > 3.98) & (found.t < 6.01)
    assert found.slope_sd[inside] == pytest.approx(1e-3, rel=1e-2)
    assert np.all(found.slope_sd[~inside] < 1e-5)


def test_forward_differences_are_known_to_be_biased():
    """Forward differences at dt 0.01 are told apart from good slopes by their bias."""
    exact, _, slopes = lotka_volterra(GRID)
    forward = make_samples(exact, "y")
    expected = np.sqrt(np.mean((forward.y - slopes[:-1, 1]) ** 2) / np.mean(slopes[:, 1] ** 2))
    found = slope_bias(exact, "y", forward.t, forward.y)
    assert found == pytest.approx(expected, rel=0.1)
    with pytest.warns(BiasWarning):
        warn_if_biased(exact, "y", forward.t, forward.y, "forward differences")
    noisy, _, _ = lotka_volterra(GRID, 0.01)
    good = choose_samples(noisy, "y")
    assert slope_bias(noisy, "y", good.t, good.y) < 0.01


def test_many_trajectories_of_any_length():
    """A short second trajectory with its own step joins the first."""
    first, _, _ = lotka_volterra(GRID, 0.01)
    second, _, _ = lotka_volterra(np.linspace(0, 0.5, 21), 0.01, 2)
    samples = choose_samples([first, second], "x")
    assert len(samples) > 900 and samples.X.shape[1] == 2
    with pytest.raises(InputError, match="different columns"):
        choose_samples([first, Trajectory(first.t, first.x, ("a", "b"))], "x")
    with pytest.raises(InputError, match="unknown scheme"):
        choose_samples(first, "x", scheme="forwards")


def test_rows_far_apart_take_differences_of_still_higher_order():
    """Eight rows a swing, a third of them lost: slopes err by 1e-4, and know by how much."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.choice(np.linspace(0, 60, 240), 160, replace=False))
    samples = choose_samples(Trajectory(t, np.sin(t)[:, None], ("x",)), "x")
    assert int(samples.scheme.removeprefix("central")) > 8
    errors = np.abs(samples.y - np.cos(samples.t))
    assert np.median(errors) < 1e-4
    assert np.mean(errors <= samples.slope_sd) > 0.9


def test_a_run_at_rest_does_not_decide_how_slopes_are_made():
    """Of runs of one length, of which the first is at rest, the slopes are those of the others."""
    t = np.arange(20) * 0.1
    runs = [Trajectory(t, a * np.exp(-2 * t)[:, None], ("x",)) for a in (0.0, 5.0, 3.0)]
    samples = choose_samples(runs, "x")
    assert samples.scheme != "central2"
    assert np.max(np.abs(samples.y + 2 * samples.X[:, 0])) < 1e-5
