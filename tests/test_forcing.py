"""Slopes, noise and smooth curves of states that a held input bends at rows."""

from dataclasses import replace

import numpy as np
import pytest

from dynsr.data import (
    Trajectory,
    add_velocities,
    choose_samples,
    choose_second_samples,
    estimate_noise,
    find_forced,
    measurement_noise,
    smooth,
)


def driven(fewest: int, most: int, rows: int = 200) -> Trajectory:
    """Give q'' = u - q - 0.3 q' in closed form, u any number for some uneven rows."""
    from scipy.linalg import expm

    rng = np.random.default_rng(3)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.15, rows - 1))])
    u: list[float] = []
    while len(u) < rows:
        u += [float(rng.uniform(-1, 1))] * int(rng.integers(fewest, most + 1))
    x, matrix = [np.array([0.5, 0.0])], np.array([[0.0, 1.0], [-1.0, -0.3]])
    for i in range(rows - 1):
        rest = np.array([u[i], 0.0])
        x.append(rest + expm((t[i + 1] - t[i]) * matrix) @ (x[-1] - rest))
    return Trajectory(t, np.array(x), ("q", "p"), np.array(u[:rows])[:, None], ("u",))


def slope_of(run: Trajectory) -> np.ndarray:
    """Give p' at the rows, after a step."""
    q, p = run.x.T
    return np.asarray(run.inputs[:, 0] - q - 0.3 * p)


@pytest.mark.parametrize("most", [1, 3, 12])
def test_slopes_of_exact_data_are_exact_beside_steps(most: int) -> None:
    """The slope of a row at which the input steps is that after the step, to four digits."""
    run = driven(min(most, 6), most)
    samples = choose_samples(run, "p")
    rows = np.searchsorted(run.t, samples.t)
    assert pytest.approx(run.columns[rows]) == samples.X
    true = slope_of(run)
    assert np.max(np.abs(samples.y - true[rows])) < 1e-4 * np.std(true)


@pytest.mark.parametrize("most", [1, 3, 12])
@pytest.mark.slow
def test_kinks_are_no_noise(most: int) -> None:
    """Exact data have none; noise of 1 % of the spread is found as that."""
    run = driven(min(most, 6), most)
    assert np.max(measurement_noise(run) / run.x.std(axis=0)) < 1e-5
    level = 0.01 * run.x.std(axis=0)
    noise = np.random.default_rng(0).normal(size=run.x.shape) * level
    noisy = replace(run, x=run.x + noise)
    assert measurement_noise(noisy) == pytest.approx(level, rel=0.3)
    found = estimate_noise([noisy])
    assert [own.additive for own in found] == pytest.approx(level.tolist(), rel=0.3)


@pytest.mark.slow
def test_a_smooth_curve_has_the_kinks() -> None:
    """Slopes of 1 % noise keep their steps, from both sides; the curve goes on between rows."""
    run = driven(6, 12)
    noise = np.random.default_rng(0).normal(size=run.x.shape) * 0.01 * run.x.std(axis=0)
    noisy = replace(run, x=run.x + noise)
    found = smooth(noisy, estimate_noise([noisy]))
    true = slope_of(run)
    assert found.before is not None
    assert np.std(found.slope[5:-5, 1] - true[5:-5]) < 0.15 * np.std(true)
    steps = 1 + np.flatnonzero(np.diff(run.inputs[:, 0]))
    change = (found.slope - found.before)[steps, 1]
    made = np.diff(run.inputs[:, 0])[steps - 1]
    assert change @ made / (made @ made) == pytest.approx(1.0, abs=0.2)
    between = (run.t[1:] + run.t[:-1]) / 2
    middle = (run.x[1:] + run.x[:-1]) / 2
    assert pytest.approx(middle, abs=0.03) == found.curve(between).T
    assert pytest.approx(found.x) == found.curve(run.t).T


def test_nothing_is_taken_where_no_input_is_held() -> None:
    """A smooth input, a constant one and none bend nothing."""
    run = driven(6, 12)
    assert find_forced([replace(run, hold={"u": "smooth"})]) is None
    assert find_forced([replace(run, inputs=np.ones_like(run.inputs))]) is None
    assert find_forced([Trajectory(run.t, run.x, run.states)]) is None


def test_second_derivatives_have_steps_too() -> None:
    """From positions alone velocities come out smooth, and accelerations with their steps."""
    run = driven(6, 12)
    seen = replace(run, x=run.x[:, :1], states=("q",))
    both = add_velocities([seen], {"q": "v"})
    rows = np.searchsorted(run.t, both[0].t)
    assert both[0].x[:, 1] == pytest.approx(run.x[rows, 1], abs=1e-4)
    samples = choose_second_samples(both, {"q": "v"}, "v")
    rows = np.searchsorted(run.t, samples.t)
    assert samples.y == pytest.approx(slope_of(run)[rows], abs=1e-2)


def test_all_runs_say_what_an_input_does() -> None:
    """Runs of one call have the same coefficients, so that a short one has good slopes too."""
    run = driven(6, 12)
    short = run.select(slice(0, 30))
    samples = choose_samples([run, short], "p")
    tail = samples.select(slice(len(samples) - 20, None))
    rows = np.searchsorted(short.t, tail.t)
    assert tail.y == pytest.approx(slope_of(short)[rows], abs=1e-4)
