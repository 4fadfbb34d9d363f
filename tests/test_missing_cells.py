"""Missing cells: each state counts where it was measured; no row goes, nothing is filled in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import polars as pl
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.stats import binom

from dynsr import Discovery, InputError, Trajectory, discover
from dynsr.data import (
    carry,
    choose_samples,
    estimate_noise,
    measurement_noise,
    read_trajectories,
    smooth,
    take_trajectories,
    write_csv,
)
from dynsr.errors import DynsrWarning
from dynsr.expression import parse, skeleton
from dynsr.fit import (
    Measurements,
    fit_along,
    match_trajectories,
)
from dynsr.report.plots import draw_phase_portrait, draw_states
from dynsr.verdict.flow_verdict import give_verdict
from dynsr.verdict.maps import pair_rows

X, Y = sympy.symbols("x y")
LAW = {"x": 1.1 * X - 0.4 * X * Y, "y": 0.1 * X * Y - 0.4 * Y}
CONSTANTS = (1.1, -0.4, -0.4, 0.1)
T = np.linspace(0, 20, 201)
TRUE = solve_ivp(
    lambda _, x: [1.1 * x[0] - 0.4 * x[0] * x[1], 0.1 * x[0] * x[1] - 0.4 * x[1]],
    (0, 20),
    [10, 5],
    t_eval=T,
    rtol=1e-10,
    atol=1e-10,
).y.T
# A decay and a wave, for what needs no system.
SHORT = np.linspace(0, 10, 101)
BOTH = np.column_stack([np.exp(-0.4 * SHORT), np.sin(SHORT)])


def cycle(noise: float, seed: int = 0, share: float = 0.15, every: int = 1) -> Trajectory:
    """Give predator and prey with noise; a share of all cells, or all but one in so many, empty."""
    rng = np.random.default_rng(seed)
    x = TRUE + rng.normal(0, 1, TRUE.shape) * noise * TRUE.std(axis=0)
    x[rng.random(x.shape) < share] = np.nan
    x[np.arange(len(T)) % every != 0, 1] = np.nan
    return Trajectory(T, x, ("x", "y"))


def gappy(noise: float = 0.0) -> Trajectory:
    """Give decay and wave, the wave at every fourth row alone."""
    x = BOTH + np.random.default_rng(1).normal(0, noise, BOTH.shape)
    x[np.arange(101) % 4 != 0, 1] = np.nan
    return Trajectory(SHORT, x, ("x", "y"))


def alone(run: Trajectory, state: str) -> Trajectory:
    """Give a run of one state, at its own rows."""
    rows = run.own_rows(state)
    return Trajectory(run.t[rows], run.x[rows][:, [run.index(state)]], (state,))


def test_a_cell_that_is_empty_was_not_measured():
    """NaN in a state is no fault; a run says which cells were measured, and so do parts of it."""
    run = gappy()
    assert run.measured.sum(axis=0).tolist() == [101, 26]
    assert run.own_rows("y")[:3].tolist() == [0, 4, 8]
    part = run.select(slice(2, 10))
    assert part.own_rows("y").tolist() == [2, 6]
    assert run.of_states(["y"]).measured.sum() == 26
    with pytest.raises(InputError, match=r"'x' holds inf in row 1"):
        Trajectory([0.0, 1.0], [[np.inf], [1.0]], ("x",))
    with pytest.raises(InputError, match=r"'u' holds nan in row 2"):
        Trajectory([0.0, 1.0], [[1.0], [1.0]], ("x",), [[1.0], [np.nan]], ("u",))


def test_rows_of_a_state_that_is_measured_seldom_are_kept_when_rows_are_thinned():
    """Every so many-th row of each state is left, so that none loses all of its own."""
    run = gappy()
    assert set(run.own_rows("y")) <= set(run.every(4))
    (rows,) = run.thin(4)
    assert run.select(rows).measured.sum(axis=0).min() >= 25


def test_a_state_stands_on_its_curve_where_it_was_not_measured():
    """The curve is near the truth, what was measured stays to the bit, and the marks stay."""
    (run,) = carry([gappy()])
    assert np.array_equal(run.observed, gappy().x, equal_nan=True)
    assert np.max(np.abs(run.x - BOTH)) < 2e-3
    assert np.array_equal(run.as_measured().x, gappy().x, equal_nan=True)
    assert carry([run])[0] is run


def test_noise_and_curve_of_a_state_are_those_of_its_own_rows():
    """A state with gaps has the noise and the smoothed values of the same rows without the gaps."""
    (run,) = carry([gappy(0.02)])
    noise = estimate_noise([run])
    for place, state in enumerate(run.states):
        own = alone(run, state)
        assert noise[place] == estimate_noise([own])[0]
        assert measurement_noise(run)[place] == measurement_noise(own)[0]
        rows, smoothed = run.own_rows(state), smooth(run, noise)
        plain = smooth(own, noise[place : place + 1])
        assert np.array_equal(smoothed.x[rows, place], plain.x[:, 0])
        assert np.all(np.isfinite(smoothed.noise[:, place]) == run.measured[:, place])


@pytest.mark.slow
def test_a_curve_is_as_unsure_as_rows_are_far():
    """Where nobody measured for 3 length scales of a process, errors are as large as is said.

    The usual miss is 0.67 standard deviations; the length scale is an estimate, so it is more.
    """
    root = np.linalg.cholesky(np.exp(-((SHORT[:, None] - SHORT) ** 2) / 2) + 1e-9 * np.eye(101))
    lost, found = (SHORT > 4) & (SHORT < 7), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = root @ rng.normal(size=101)
        seen = np.where(lost, np.nan, true + rng.normal(0, 0.02, 101))
        run = Trajectory(SHORT, np.column_stack([seen, true]), ("x", "y"))
        own = smooth(run, estimate_noise([run]))
        slope = np.gradient(true, SHORT)
        for curve, truth, sd in ((own.x, true, own.x_sd), (own.slope, slope, own.slope_sd)):
            found.append((curve[lost, 0] - truth[lost]) / sd[lost, 0])
    assert 0.5 < np.median(np.abs(found)) < 1.5


def test_slopes_are_those_of_own_rows():
    """Samples of a state have its own rows alone, with the slopes of these."""
    run = gappy()
    samples = choose_samples(run, "y")
    assert set(samples.t) <= set(run.t[run.own_rows("y")])
    assert np.allclose(samples.y, np.cos(samples.t), atol=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("junk", [0.0, 1e3, -7.0])
def test_what_stands_in_an_empty_cell_counts_nothing(junk):
    """Fit, errors and verdict are the same whatever a cell that was not measured holds."""
    (run,) = carry([cycle(0.02)])
    exprs = {s: e.xreplace({n: 1.05 * n for n in e.atoms(sympy.Float)}) for s, e in LAW.items()}
    data = Measurements.of([run], {}, 2000)
    plain = fit_along(exprs, data)
    x = np.where(run.measured, run.x, junk)
    other = fit_along(exprs, replace(data, runs=[replace(run, x=x)]))
    assert np.allclose(plain.constants, other.constants, rtol=1e-6)
    assert np.allclose(plain.errors, other.errors, rtol=1e-4)
    assert plain.freedom == int(run.measured.sum()) - 4 - 2


@pytest.mark.parametrize("share", [0.15, 0.5])
@pytest.mark.slow
def test_a_law_is_judged_by_what_was_measured(share):
    """R2 and the misses in units of the noise are those of the measured cells alone."""
    run = cycle(0.03, share=share)
    (whole,) = carry([run])
    noise = [np.broadcast_to(0.03 * TRUE.std(axis=0), run.x.shape)]
    verdict = give_verdict(LAW, [whole], noise=noise)
    assert verdict.level == "law"
    for place, state in enumerate(run.states):
        told = run.measured[:, place]
        missed = (run.x - TRUE)[told, place]
        truth = 1 - np.sum(missed**2) / np.sum(
            (run.x[told, place] - run.x[told, place].mean()) ** 2
        )
        assert abs(verdict.states[state].r2 - truth) < 1e-3
        assert abs(verdict.states[state].chi_square - 1) < 4 * np.sqrt(2 / told.sum())


@pytest.mark.slow
def test_windows_of_exact_data_are_fitted_to_what_was_measured():
    """Constants of clean data come to many digits though a third of the cells are empty."""
    runs = carry([cycle(0.0, share=0.3)])
    begun = {s: e.xreplace({n: 1.02 * n for n in e.atoms(sympy.Float)}) for s, e in LAW.items()}
    match = match_trajectories(begun, runs)
    found = [value for pairs in match.errors.values() for value, _ in pairs]
    assert np.allclose(sorted(found), sorted(CONSTANTS), rtol=1e-5)
    assert len(match.misses) >= runs[0].measured.sum()


@pytest.mark.slow
def test_the_law_of_clean_data_with_empty_cells_is_found_exactly():
    """15 % of all cells are empty at random: the law of predator and prey, as its own digits."""
    found = discover(cycle(0.0), jobs=1)
    assert found.verdict.level == "law"
    assert {s: str(e) for s, e in found.equations.items()} == {
        "x": "-0.4*x*y + 1.1*x",
        "y": "0.1*x*y - 0.4*y",
    }
    assert np.isnan(found.trajectories[0].x).sum() == np.isnan(cycle(0.0).x).sum()
    scores = found.score()
    assert max(own["trajectory_rmse"] for own in scores.values()) < 1e-4
    assert found.simulate().x.shape == (201, 2)


@pytest.mark.slow
def test_the_law_of_noisy_data_with_empty_cells_is_found():
    """15 % of all cells are empty at random, with noise of 5 % of the spread."""
    found = discover(cycle(0.05), jobs=1)
    assert found.verdict.level == "law"
    for state, law in LAW.items():
        values = law.as_coefficients_dict()
        own = found.equations[state].as_coefficients_dict()
        assert set(own) == set(values)
        assert all(abs(own[term] / values[term] - 1) < 0.1 for term in values)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_one_state_each_row_and_another_each_tenth(noise):
    """The law is found though the predator was counted at 21 of 201 times only."""
    found = discover(cycle(noise, share=0.0, every=10), jobs=1)
    for state, law in LAW.items():
        assert set(found.equations[state].as_coefficients_dict()) == set(law.as_coefficients_dict())
    if not noise:
        assert found.verdict.level == "law"


@pytest.mark.slow
@pytest.mark.parametrize(("share", "every"), [(0.15, 1), (0.0, 5)])
def test_intervals_hold_the_truth_over_draws(share, every):
    """95 % intervals of the constants hold the truth in 90 to 98 % of draws with empty cells, at
    1 % and 5 % of noise in turn.
    """
    draws, held = 30, 0
    for seed in range(draws):
        noise = (0.01, 0.05)[seed % 2]
        runs = carry([cycle(noise, seed, share, every)])
        fit = fit_along(LAW, Measurements.of(runs, {}, 2000))
        held += int(np.sum(np.abs(fit.constants - CONSTANTS) <= 1.96 * fit.errors))
    count = draws * len(CONSTANTS)
    low, high = binom.ppf([0.01, 0.99], count, [0.90, 0.98])
    assert low <= held <= high


@pytest.mark.slow
def test_a_start_that_was_not_measured_is_fitted():
    """The first rows of one state and the last of the other are empty: nothing stands there."""
    x = TRUE + np.random.default_rng(4).normal(0, 0.01, TRUE.shape) * TRUE.std(axis=0)
    x[:30, 1], x[-40:, 0] = np.nan, np.nan
    runs = carry([Trajectory(T, x, ("x", "y"))])
    fit = fit_along(LAW, Measurements.of(runs, {}, 2000))
    assert np.all(np.abs(fit.constants - CONSTANTS) < 4 * fit.errors)
    assert np.max(fit.found.mean_squares) < 1.5


@pytest.mark.parametrize(("noise", "near"), [(0.0, 1e-5), (0.01, 0.01), (0.05, 0.05)])
@pytest.mark.slow
def test_pictures_and_scores_begin_where_the_equations_begin(noise, near):
    """The first 15 rows of the predator are empty: its curve says little of its start."""
    run = cycle(noise, share=0.0)
    x = run.x.copy()
    x[:15, 1] = np.nan
    found = Discovery(LAW, {}, {}, {}, (Trajectory(T, x, ("x", "y")),))
    exact = found.simulate([10.0, 5.0]).x
    off = [found.simulate().x - exact, found.carried[0].x[:1] - TRUE[:1]]
    assert max(np.sqrt(np.mean(own**2, axis=0)).max() for own in off) < near * TRUE.std()
    missed = max(own["trajectory_rmse"] for own in found.score().values())
    assert missed < max(1.5 * noise, near) * TRUE.std()
    assert np.array_equal(found.carried[0].x[15:], x[15:])


@pytest.mark.slow
def test_exports_begin_where_the_equations_begin(tmp_path):
    """Each run of a problem of PEtab does too, and says it of a state that its first row lacks."""
    pytest.importorskip("libsbml", reason="libsbml is not installed")
    runs, starts = [], ([10.0, 5.0], [6.0, 2.0])
    for start in starts:
        x = Discovery(LAW, {}, {}, {}).simulate(start, T).x.copy()
        x[:15, 1] = np.nan
        runs.append(Trajectory(T, x, ("x", "y")))
    found = Discovery(LAW, {}, {}, {}, tuple(runs))
    assert found.system.x0 == pytest.approx({"x": 10.0, "y": 5.0}, rel=1e-4)
    found.export("petab", tmp_path / "problem")
    rows = pd.read_csv(tmp_path / "problem" / "parameters.tsv", sep="\t").set_index("parameterId")
    values = [rows.nominalValue[f"start_y_run_{k}"] for k in (1, 2)]
    assert values == pytest.approx([own[1] for own in starts], rel=1e-4)


@pytest.mark.slow
def test_runs_too_short_to_be_fitted_begin_on_their_curves():
    """Of eight runs with four rows each, the first cell of the predator is empty."""
    runs = []
    for place in range(0, 160, 20):
        x = TRUE[place : place + 4].copy()
        x[0, 1] = np.nan
        runs.append(Trajectory(T[:4], x, ("x", "y")))
    found = Discovery(LAW, {}, {}, {}, tuple(runs))
    assert np.array_equal(found.carried[0].x, carry(runs)[0].x)
    assert np.isfinite(found.simulate().x).all()


def test_too_few_values_are_refused():
    """A state with fewer than 8 values in all runs has no equation that could be told."""
    x = TRUE.copy()
    x[7:, 1] = np.nan
    with pytest.raises(InputError, match="state 'y' was measured in 7 rows; give at least 8"):
        discover((T, x), jobs=1)
    # Of several runs, all count together.
    parts = [Trajectory(T[a : a + 40], TRUE[a : a + 40].copy(), ("x", "y")) for a in (0, 40)]
    for part in parts:
        part.x[4:, 1] = np.nan
    parts = [Trajectory(p.t, p.x, p.states) for p in parts]
    assert [p.measured[:, 1].sum() for p in carry(parts)] == [4, 4]


@pytest.mark.parametrize("make", [pd.DataFrame, pl.DataFrame, dict])
def test_frames_and_mappings_may_have_empty_cells(make):
    """NaN, null and None in columns are cells that were not measured."""
    y = [None if k % 3 else float(v) for k, v in enumerate(BOTH[:, 1])]
    data = {"t": SHORT, "x": BOTH[:, 0], "y": y if make is not dict else np.array(y, dtype=object)}
    (run,) = take_trajectories(make(data))[0]
    assert run.measured.sum(axis=0).tolist() == [101, 34]
    assert len(run) == 101


def test_a_table_is_written_and_read_with_its_empty_cells(tmp_path):
    """What was not measured is an empty cell of the file, also where a run stands on its curve."""
    path = tmp_path / "gaps.csv"
    write_csv(carry([gappy()])[0], path)
    assert path.read_text().splitlines()[2].endswith(",")
    (run,) = read_trajectories(path).trajectories
    assert np.array_equal(run.x, gappy().x, equal_nan=True)


def test_an_input_is_known_between_its_rows():
    """Empty cells of an input are read as an input is between its rows, by how it is held."""
    u = np.where(np.arange(101) % 5 == 0, 2 * SHORT, np.nan)
    y = BOTH[:, 0].copy()
    y[[3, 50]] = np.nan
    table = read_trajectories({"t": SHORT, "y": y, "u": u}, inputs=["u"])
    (run,) = table.trajectories
    assert np.allclose(run.inputs[:, 0], 2 * SHORT)
    assert run.measured.sum() == 99
    assert any("'u', an input, in 80" in note for note in table.notes)
    held = np.where(np.arange(101) % 20 == 0, np.arange(101) // 40, np.nan)
    (run,) = read_trajectories({"t": SHORT, "y": y, "u": held}, inputs=["u"]).trajectories
    assert np.array_equal(run.inputs[:, 0], np.arange(101) // 40)


def test_rows_with_a_time_alone_say_nothing():
    """Rows in which no state has a value are left out, and said."""
    x = BOTH.copy()
    x[60:] = np.nan
    table = read_trajectories({"t": SHORT, "x": x[:, 0], "y": x[:, 1]})
    assert len(table.trajectories[0]) == 60
    assert "41 rows were left out: no state has a value there." in table.notes


def test_a_map_pairs_only_rows_that_were_measured():
    """x[n+1] is asked of rows where all is known, and of values that are there."""
    x = np.column_stack([np.arange(12.0), np.arange(12.0) ** 2])
    x[[2, 7], 0], x[5, 1] = np.nan, np.nan
    (run,) = carry([Trajectory(np.arange(12.0), x, ("x", "y"))])
    assert pair_rows([run], "x").t.tolist() == [0.0, 3.0, 4.0, 8.0, 9.0, 10.0]
    assert pair_rows([run], "y").t.tolist() == [0.0, 1.0, 3.0, 6.0, 8.0, 9.0, 10.0]


def test_pictures_show_the_points_that_are_there():
    """Data are points; a state with gaps has those of its own rows."""
    (run,) = carry([gappy()])
    lines = [axis.lines[0] for axis in draw_states(run).axes[:2]]
    assert [line.get_marker() for line in lines] == ["o", "o"]
    assert np.isfinite(lines[1].get_ydata()).sum() == 26
    path = draw_phase_portrait(run, None, "x", "y").axes[0].lines[0]
    assert len(path.get_xdata()) == 26


def test_a_long_table_keeps_the_rows_of_what_is_measured_seldom():
    """Thinned to some rows, a table keeps the cells of a state that has few."""
    t = np.linspace(0, 10, 2001)
    seldom = np.where(np.arange(2001) % 50 == 7, np.sin(t), np.nan)
    with pytest.warns(DynsrWarning, match="every 5th was kept"):
        table = read_trajectories({"t": t, "x": np.cos(t), "y": seldom}, max_rows=500)
    assert table.trajectories[0].measured[:, 1].sum() == np.isfinite(seldom).sum()


def online(**columns: np.ndarray) -> pd.DataFrame:
    """Give a table of some columns at all times."""
    return pd.DataFrame({"t": T, **columns})


def test_sources_of_different_states_are_one_experiment(tmp_path):
    """Two files with clocks of their own are joined on the time, each state at its own rows."""
    own = np.arange(3, 201, 13)
    fast, slow = tmp_path / "online.csv", tmp_path / "offline.csv"
    pd.DataFrame({"time [h]": T, "x": TRUE[:, 0]}).to_csv(fast, index=False)
    minutes = np.round(60 * T[own] + 0.7, 6)
    pd.DataFrame({"t [min]": minutes, "y": TRUE[own, 1]}).to_csv(slow, index=False)
    table = read_trajectories([fast, slow])
    (run,) = table.trajectories
    assert run.states == ("x", "y")
    assert run.measured.sum(axis=0).tolist() == [201, len(own)]
    assert np.allclose(60 * run.t[run.own_rows("y")], minutes)
    assert np.array_equal(run.x[run.own_rows("y"), 1], TRUE[own, 1])
    assert len(run) == 201 + len(own)
    assert any(
        "online.csv (x) and offline.csv (y) measured one experiment" in n for n in table.notes
    )
    assert table.description.states == ("x", "y")
    # The same with the states named, and with times that only rounding sets apart.
    assert read_trajectories([fast, slow], states="x,y").trajectories[0].states == ("x", "y")
    frames = [online(x=TRUE[:, 0]), pd.DataFrame({"t": np.arange(67) * 0.3, "y": TRUE[::3, 1]})]
    assert len(take_trajectories(frames)[0][0]) == 201


def test_sources_with_dates_are_joined_where_they_are():
    """Files of dates are counted from the earliest date of all, not each from its own first row."""
    when = pd.Timestamp("2024-03-01 08:00") + pd.to_timedelta(T, unit="h")
    late = slice(25, None, 5)
    fast = pd.DataFrame({"when": when, "x": TRUE[:, 0]})
    slow = pd.DataFrame({"sampled": when[late], "y": TRUE[late, 1]})
    for sources in ([fast, slow], [slow, fast]):
        (run,) = read_trajectories(sources).trajectories
        rows = run.own_rows("y")
        at_y = np.interp(run.t[rows], run.t[run.own_rows("x")], TRUE[:, 0])
        assert np.allclose(at_y, TRUE[late, 0])
    with pytest.raises(InputError, match="counted in min and in no unit"):
        read_trajectories([fast, online(y=TRUE[:, 1]).assign(t=T)])


def test_experiments_of_several_sources_are_matched_by_name_or_by_order():
    """Runs that a column names go together by name; files of one run each by their order."""
    fast = pd.concat([online(x=TRUE[:, 0]).assign(run=name) for name in "ab"])
    slow = pd.concat(
        [online(y=k * TRUE[:, 1]).assign(run=name)[::10] for k, name in ((2, "b"), (1, "a"))]
    )
    runs = read_trajectories([fast, slow]).trajectories
    assert [run.origin["name"] for run in runs] == ["a", "b"]
    assert [float(run.x[0, 1]) for run in runs] == [5.0, 10.0]
    files = [online(x=k * TRUE[:, 0]) for k in (1, 2)] + [online(y=k * TRUE[:, 1]) for k in (1, 2)]
    runs = read_trajectories(files).trajectories
    assert [run.x[0].tolist() for run in runs] == [[10.0, 5.0], [20.0, 10.0]]
    with pytest.raises(InputError, match=r"2 trajectories of x and .* 1 trajectory of y"):
        read_trajectories(files[:3])
    with pytest.raises(InputError, match="with the same names"):
        read_trajectories([fast, slow.replace({"run": {"b": "c"}})])


def test_sources_that_do_not_meet_are_refused():
    """Other times, or a state that both measured: one line says what to do."""
    with pytest.raises(InputError, match=r"from 0 to 20 and .* from 100 to 120: they do not meet"):
        read_trajectories([online(x=TRUE[:, 0]), online(y=TRUE[:, 1]).assign(t=T + 100)])
    with pytest.raises(InputError, match="leave 'x' out of one of them or rename it there"):
        read_trajectories([online(x=TRUE[:, 0]), online(x=TRUE[:, 0], y=TRUE[:, 1])])


def test_an_input_of_one_source_is_known_at_the_rows_of_the_other():
    """The input that only one file has is read between its rows where only the other has rows."""
    fast = online(x=TRUE[:, 0], u=np.floor(T / 4))
    slow = pd.DataFrame({"t": T[5::10] + 0.03, "y": TRUE[5::10, 1]})
    (run,) = read_trajectories([fast, slow], inputs=["u"]).trajectories
    assert run.input_names == ("u",)
    assert np.array_equal(run.inputs[:, 0], np.floor(run.t / 4))
    pair = [Trajectory(T, TRUE[:, :1], ("x",)), Trajectory(T[::4], TRUE[::4, 1:], ("y",))]
    assert take_trajectories(pair)[0][0].measured.sum(axis=0).tolist() == [201, 51]


@pytest.mark.slow
def test_two_sources_are_searched_as_one():
    """discover([online, offline]) finds the law of both, though their clocks differ."""
    own = np.arange(4, 201, 7)
    slow = pd.DataFrame({"t": T[own], "y": TRUE[own, 1]})
    found = discover([online(x=TRUE[:, 0]), slow], jobs=1, preset="quick")
    assert {s: str(e) for s, e in found.equations.items()} == {
        "x": "-0.4*x*y + 1.1*x",
        "y": "0.1*x*y - 0.4*y",
    }
    assert "joined on the time" in found.settings["table"]["notes"][0]


def test_quantities_of_a_long_table_may_have_times_of_their_own():
    """A column called a quantity names states, also where each is measured at its own times."""
    fast = pd.DataFrame({"hours": T, "analyte": "x", "value": TRUE[:, 0]})
    slow = pd.DataFrame({"hours": T[::7], "analyte": "y", "value": TRUE[::7, 1]})
    (run,) = read_trajectories(pd.concat([fast, slow])).trajectories
    assert run.states == ("x", "y")
    assert run.measured.sum(axis=0).tolist() == [201, 29]
    assert np.array_equal(run.observed[::7, 1], TRUE[::7, 1])


def test_a_source_of_inputs_alone_is_joined_with_its_states():
    """Commands have a clock of their own, and keep their value until the next one."""
    t, own = np.linspace(0, 9, 91), np.arange(0.003, 9, 0.5)
    states = {"t": t, "x": np.cos(t), "y": np.sin(t)}
    command = {"t": own, "u_z": np.where(own % 4 < 2, 1.5, -0.3)}
    table = read_trajectories([states, command], inputs=["u_z"])
    (run,) = table.trajectories
    assert run.states == ("x", "y") and run.input_names == ("u_z",)
    assert run.holds["u_z"] == "previous" and table.description.inputs == ("u_z",)
    late = run.t > own[0]
    steps = command["u_z"][np.searchsorted(own, run.t[late], side="right") - 1]
    assert np.array_equal(run.inputs[late, 0], steps)
    dates = pd.date_range("2024-01-01", periods=91, freq="min")
    both = {"when": dates, "x": np.cos(t), "u": np.sign(np.sin(t))}
    (run,) = read_trajectories([both], inputs=["u"]).trajectories
    assert run.states == ("x",) and run.input_names == ("u",)


@pytest.mark.slow
def test_few_exact_assays_have_the_terms_of_the_many_rows():
    """A fermenter: biomass each 0.1 h, and the sugar, which is used up, once an hour.

    Eleven rows, however exact, do not say what the sugar is between them.
    """

    def grow(_, z):
        eaten = z[0] * z[1] / (1.2 + z[1])
        return 0.5 * eaten, -1.1 * eaten

    t = np.linspace(0, 10, 101)
    # Biomass and sugar have a fixed sum, so that other terms are these along the data: what a
    # solver leaves would decide between them.
    to_the_last = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
    x = solve_ivp(grow, (0, 10), [0.1, 6.0], t_eval=t, **to_the_last).y.T
    x[np.arange(101) % 10 != 0, 1] = np.nan
    found = discover(Trajectory(t, x, ("X", "S")), jobs=1, preset="quick")
    for state, size in (("X", 0.5), ("S", -1.1)):
        expr = found.equations[state]
        assert skeleton(expr) == skeleton(parse("0.5*X*S/(1.2 + S)"))
        assert float(expr.subs({"X": 1, "S": 1e9})) == pytest.approx(size, rel=1e-6)
