"""Censored cells: a state that was only seen to be below, or above, a limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import polars as pl
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import approx_fprime, minimize
from scipy.special import log_ndtr
from scipy.stats import norm, truncnorm

from dynsr import InputError, Trajectory, discover, load
from dynsr.data import (
    KnownNoise,
    Limits,
    carry,
    describe,
    load_with_doses,
    read_kept,
    read_sums,
    read_trajectories,
    take_trajectories,
    write_csv,
    write_kept,
)
from dynsr.discovery.scaling import Units
from dynsr.errors import DynsrWarning
from dynsr.fit import (
    Collocation,
    DelayedSystem,
    Measurements,
    MixedMesh,
    fit_along,
    interval_reach,
    measure_runs,
)
from dynsr.fit.censored import Censored, deviance, residual, steepness
from dynsr.report.plots import draw_states
from dynsr.verdict.flow_verdict import give_verdict
from tests.command_line import run as run_command

# On reading it is said how many cells are beyond a limit.
pytestmark = pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
X = sympy.Symbol("x")
T = np.linspace(0, 6, 61)
TRUE = np.exp(-0.7 * T)
LIMIT = float(np.exp(-0.7 * 3))


def decay(noise: float, seed: int = 0, how: str = "limit") -> Trajectory:
    """Give a decay, whose cells below a limit are censored, left out, or filled with a number."""
    y = TRUE + noise * np.random.default_rng(seed).normal(size=len(T))
    low = y < LIMIT
    x = np.where(low, {"half": LIMIT / 2, "at it": LIMIT}.get(how, np.nan), y)
    none = np.full(len(T), np.nan)
    limits = {"x": Limits(np.where(low, LIMIT, np.nan), none)} if how == "limit" else {}
    return Trajectory(T, x[:, None], ("x",), limits=limits)


def fit(run: Trajectory, rate: float = -0.65):
    """Fit the rate of the decay."""
    return fit_along({"x": rate * X}, Measurements.of([run], {}, 2000))


def test_the_likelihood_is_that_of_a_normal_measurement_beyond_its_limit():
    """Deviance, slopes and curvature agree with SciPy's normal distribution, far out too."""
    z = np.linspace(-30, 9, 79)
    assert np.allclose(deviance(z), -2 * norm.logcdf(z), rtol=1e-12)
    assert np.allclose(steepness(z), np.exp(norm.logpdf(z) - norm.logcdf(z)), rtol=1e-9)
    assert np.allclose(residual(z) ** 2, deviance(z))
    small = z[(z > -5) & (z < 5)]
    slopes = (residual(small - 1e-5) - residual(small + 1e-5)) / 2e-5
    assert np.allclose(steepness(small) / residual(small), slopes, rtol=1e-5)
    assert steepness(np.array([1e3])) == 0 and deviance(np.array([1e3])) == 0
    assert np.isclose(deviance(np.array([-1e8]))[0], 1e16)
    # The curvature is 1 less the variance of what is beyond the limit.
    for place, side in ((z, 1.0), (z, -1.0)):
        cells = Censored((np.zeros(79, int), np.arange(79)), place, np.full(79, side))
        bend, pull, total = cells.terms(np.zeros((1, 79)))
        inner = side * place
        variance = truncnorm.var(-np.inf, inner)
        assert np.allclose(bend, 1 - variance, atol=1e-6)
        assert np.allclose(pull, side * steepness(inner)) and np.isclose(
            total, deviance(inner).sum()
        )
        assert np.all(np.sign(cells.residuals(np.zeros((1, 79)))) == side)
    far = Censored((np.zeros(3, int), np.arange(3)), -np.array([1e3, 1e6, 1e9]), np.ones(3))
    bend, pull, _ = far.terms(np.zeros((1, 3)))
    assert np.allclose(bend, 1) and np.allclose(pull, [1e3, 1e6, 1e9])


def test_limits_go_with_their_rows_and_units():
    """Rows that are taken, other units and other states: limits are those of their cells."""
    run = decay(0.01)
    there = run.limits["x"].there
    assert there.sum() == np.isnan(run.x).sum() > 25
    part = run.select(slice(20, 40))
    assert np.array_equal(part.limits["x"].there, there[20:40])
    other = run.limits["x"].in_units(2.0)
    assert np.allclose(other.below[there], LIMIT / 2)
    turned = run.limits["x"].in_units(-1.0)
    assert np.allclose(turned.above[there], -LIMIT) and np.isnan(turned.below).all()
    # Data of any size are searched in units of their own, and their limits too.
    small = replace(run, x=1e-12 * run.x, limits={"x": run.limits["x"].in_units(1e12)})
    units = Units.of([small])
    again = units.apply(small)
    share = again.limits["x"].below[there] / np.nanmax(again.x)
    assert np.allclose(share, LIMIT / np.nanmax(run.x)) and np.nanmax(again.x) > 0.01
    # A cell that was measured has no limit, and limits of other columns go.
    full = Trajectory(T, TRUE[:, None], ("x",), limits=run.limits)
    assert full.limits == {} and replace(run, states=("y",)).limits == {}
    # Rows in which nothing else is known are kept where rows are thinned.
    assert np.isin(np.flatnonzero(there)[::4], run.every(4)).all()
    with pytest.raises(InputError, match=r"limits \(3,\) of 'x' do not fit 61 rows"):
        Trajectory(T, run.x, ("x",), limits={"x": Limits(np.ones(3), np.ones(3))})
    (carried,) = carry([run])
    assert np.all(carried.x[there, 0] <= LIMIT)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_fit_is_that_of_the_whole_likelihood(sign):
    """With known noise, rate, error and cost are those of SciPy on the closed form; turned, too."""
    noise = 0.05
    run = decay(noise, 3)
    limits = run.limits["x"]
    said = KnownNoise(np.full(len(T), noise))
    turned = replace(run, x=sign * run.x, limits={"x": limits.in_units(sign)}, noise={"x": said})
    found = fit(turned)
    low = limits.there

    def cost(p):
        x = p[0] * np.exp(p[1] * T)
        z = (x - run.x[:, 0])[~low] / noise
        return np.sum(z**2) / 2 - np.sum(log_ndtr((LIMIT - x[low]) / noise))

    best = minimize(
        cost, [1.0, -0.7], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}
    )
    step = 1e-4
    second = np.array(
        [
            (approx_fprime(best.x + d, cost, 1e-6) - approx_fprime(best.x - d, cost, 1e-6))
            / (2 * step)
            for d in step * np.eye(2)
        ]
    )
    assert found.constants[0] == pytest.approx(best.x[1], abs=2e-4)
    assert found.errors[0] == pytest.approx(np.sqrt(np.linalg.inv(second)[1, 1]), rel=0.02)
    assert found.found.squares == pytest.approx(2 * best.fun, rel=1e-3)
    assert found.problem.mesh.rows[0] == np.sum(~low)


@pytest.mark.slow
def test_censored_cells_take_the_bias_away():
    """Half of all rows below the limit: bias and intervals against the ways in which it is done."""
    off, held = {}, {}
    for how in ("limit", "out", "half", "at it"):
        found = [fit(decay(0.05, seed, how)) for seed in range(20)]
        rates = np.array([own.constants[0] for own in found])
        off[how] = abs(np.mean(rates) + 0.7)
        held[how] = np.mean([abs(own.constants[0] + 0.7) < 2 * own.errors[0] for own in found])
    assert off["limit"] < 0.25 * min(off["out"], off["half"], off["at it"])
    assert held["limit"] >= 0.9
    assert max(held["out"], held["half"], held["at it"]) <= 0.75


@pytest.mark.slow
def test_clean_and_almost_clean_decays_have_their_rate():
    """With noise of 1 % and less the rate is right, and censored cells do no harm."""
    assert fit(decay(1e-4)).constants[0] == pytest.approx(-0.7, abs=5e-4)
    rates = [fit(decay(0.01, seed)).constants[0] for seed in range(12)]
    assert np.mean(rates) == pytest.approx(-0.7, abs=0.006)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_to_98_percent():
    """Over 100 draws, at 1 % and 5 % in turn, half of all rows below the limit."""
    found = [fit(decay((0.01, 0.05)[seed % 2], seed)) for seed in range(100)]
    inside = [
        abs(own.constants[0] + 0.7) <= interval_reach(own.freedom) * own.errors[0] for own in found
    ]
    assert 0.90 <= np.mean(inside) <= 0.98


@pytest.mark.slow
def test_the_noise_is_that_of_measured_rows():
    """The fit finds the noise that was put in, although rows near the limit show too little."""
    shown = []
    for seed in range(12):
        weights = fit(decay(0.05, seed)).problem.mesh.weights
        shown.append(1 / np.median(weights[weights > 0]))
    assert np.median(shown) == pytest.approx(0.05, rel=0.2)


def test_limits_are_kept_joined_and_turned_into_those_of_sums():
    """A saved table, two sources of one experiment and a sum of states have the same limits."""
    run = decay(0.01)
    text, kept = write_kept([run])
    (again,) = read_kept(text.encode(), kept)
    assert np.array_equal(again.limits["x"].below, run.limits["x"].below, equal_nan=True)
    assert np.isnan(again.limits["x"].above).all()
    fast = Trajectory(np.linspace(0, 6, 121), np.ones((121, 1)), ("y",))
    (joined,) = take_trajectories([fast, run])[0]
    there = joined.limits["x"].there
    assert np.array_equal(joined.t[there], run.t[run.limits["x"].there])
    both = Trajectory(T, np.column_stack([run.x[:, 0], TRUE]), ("total", "y"), limits=both_of(run))
    (summed,) = read_sums([both], {"total": "y - 2*z"})
    low = run.limits["x"].there
    assert np.allclose(summed.limits["z"].above[low], -LIMIT / 2)
    assert np.isnan(summed.limits["z"].below).all()


def both_of(run: Trajectory) -> dict[str, Limits]:
    """Give the limits of x to the column total."""
    return {"total": run.limits["x"]}


def test_a_sum_below_its_limit_counts_in_the_fit():
    """A fit of x + y below a limit has no greater cost than what the truth has, and its rates."""
    truth = np.column_stack([np.exp(-0.7 * T), 0.5 * np.exp(-0.2 * T)])
    noisy = truth + 0.01 * np.random.default_rng(0).normal(size=truth.shape)
    total = noisy[:, 0] + truth[:, 1]
    low = total < 0.4
    limits = {"total": Limits(np.where(low, 0.4, np.nan), np.full(len(T), np.nan))}
    x = np.column_stack([np.where(low, np.nan, total), noisy[:, 1]])
    runs = read_sums([Trajectory(T, x, ("total", "y"), limits=limits)], {"total": "x + y"})
    found = fit_along({"x": -0.5 * X, "y": -0.3 * sympy.Symbol("y")}, Measurements.of(runs, {}, 99))
    assert found.constants == pytest.approx([-0.7, -0.2], abs=0.02)
    assert len(found.found.censored) == low.sum() > 15
    assert np.all(np.abs(found.found.censored) < 3)


def test_rows_of_a_mesh_take_their_cells_along():
    """The cells of some rows are those of a mesh of these rows alone, run by run."""
    runs = [replace(decay(0.02, seed), origin={"run": seed}) for seed in range(3)]
    mesh = Measurements.of(runs, {}, 2000).mesh(("x",))
    cells, n = mesh.censored, len(mesh.t)
    assert len(cells.limits) == sum(np.isnan(run.x).sum() for run in runs)
    states, rows = cells.places
    assert np.all(mesh.weights[rows, states] == 0) and np.all(cells.sure > 0)
    kept = np.arange(n) >= n // 3
    some = cells.at(kept)
    assert np.array_equal(mesh.t[kept][some.places[1]], mesh.t[rows[kept[rows]]])
    assert cells.at(np.zeros(n, dtype=bool)) is None
    double = mesh.with_noise(np.array([2.0]))
    assert np.allclose(2 * double.censored.sure, cells.sure)
    assert np.allclose(2 * double.weights, mesh.weights)


def written(values: np.ndarray, limit: float = LIMIT, word: str = "") -> list[str]:
    """Write values as cells of text, those below a limit as "<limit" or as a word."""
    low = word or f"<{limit:.6f}"
    return [f"{v:.6f}" if v >= limit else low for v in values]


def limits_of(data, **options) -> Limits:
    """Give the limits of x in the one run of a table."""
    (run,) = read_trajectories(data, **options).trajectories
    assert np.isnan(run.x[run.limits["x"].there, run.index("x")]).all()
    return run.limits["x"]


def test_cells_beyond_a_limit_are_read_from_all_kinds_of_tables(tmp_path):
    """A mapping of lists, frames, a file with a decimal comma, mixed cells: the limit is known."""
    low = TRUE < LIMIT
    cells = written(TRUE)
    tables = [{"t": T, "x": cells}, pd.DataFrame({"t": T, "x": cells})]
    tables += [pl.DataFrame({"t": T, "x": cells}), {"t": T.tolist(), "x": cells}]
    for table in tables:
        found = limits_of(table)
        assert np.array_equal(found.there, low) and np.allclose(found.below[low], LIMIT)
    mixed = pd.DataFrame({"t": T, "x": [c if c[0] == "<" else float(c) for c in cells]})
    assert np.array_equal(limits_of(mixed).there, low)
    rows = ["t;x", *(f"{t:.2f};{c} mg/L" for t, c in zip(T, cells, strict=True))]
    path = tmp_path / "comma.csv"
    path.write_text("\n".join(rows).replace(".", ","))
    found = limits_of(str(path))
    assert np.array_equal(found.there, low) and np.allclose(found.below[low], LIMIT, atol=1e-6)
    high = limits_of({"t": T, "x": [f"{v:.6f}" if v < 0.9 else ">0.9" for v in TRUE]})
    assert np.array_equal(high.above == 0.9, TRUE >= 0.9) and np.isnan(high.below).all()


def test_limits_stay_with_their_rows_when_a_table_is_put_together_otherwise(tmp_path):
    """Rows out of order, long tables, runs side by side, turned tables, tables of doses."""
    low, cells = TRUE < LIMIT, written(TRUE)
    order = np.random.default_rng(0).permutation(len(T))
    found = limits_of({"t": T[order], "x": [cells[i] for i in order]})
    assert np.array_equal(found.there, low)
    long = pd.DataFrame(
        {
            "t": np.repeat(T, 2),
            "analyte": ["x", "y"] * len(T),
            "value": [
                cell for c, v in zip(cells, TRUE, strict=True) for cell in (c, f"{v + 1:.5f}")
            ],
        }
    )
    assert np.array_equal(limits_of(long).there, low)
    (run,) = read_trajectories(long).trajectories
    assert "y" not in run.limits
    other = written(TRUE * 1.1)
    beside = {"t": T, "x_rep1": cells, "x_rep2": other}
    first, second = read_trajectories(beside).trajectories
    assert np.array_equal(first.limits["x"].there, low)
    assert np.array_equal(second.limits["x"].there, 1.1 * TRUE < LIMIT)
    turned = pd.DataFrame([["x", *cells], ["y", *(f"{v:.5f}" for v in TRUE + 1)]])
    turned.columns = ["what", *(f"{t:.1f} h" for t in T)]
    assert np.array_equal(limits_of(turned).there, low)
    doses = tmp_path / "doses.csv"
    doses.write_text("t,amount\n3.05,0.5\n")
    table = tmp_path / "x.csv"
    pd.DataFrame({"t": T, "x": cells}).to_csv(table, index=False)
    columns, _ = load_with_doses([table], doses, {"x": "amount"})
    assert np.array_equal(columns[0].limits["x"].there, np.insert(low, 31, False))
    # Of rows of one time, a value counts more than a limit.
    twice = {
        "t": np.repeat(T, 2),
        "x": [c for own in zip(cells, written(TRUE, 0.5 * LIMIT), strict=True) for c in own],
    }
    found = limits_of(twice)
    assert np.array_equal(found.there, TRUE < 0.5 * LIMIT)
    assert np.allclose(found.below[found.there], 0.75 * LIMIT)


@pytest.mark.parametrize("word", ["OVRFLW", "Over range", "overflow"])
def test_words_of_the_end_of_the_range_mean_what_is_said_of_it(word):
    """A plate reader writes them: without its end they are no value, as a note says."""
    high = TRUE > 0.6
    cells = np.where(high, word, TRUE.astype(str)).astype(object)
    table = read_trajectories({"t": T, "x": cells})
    assert not table.trajectories[0].limits
    (note,) = [n for n in table.notes if "limit" in n]
    assert note.startswith(f"{high.sum()} cells say that 'x' was above a limit")
    assert note.endswith("--limit 'x=>...'")
    found = limits_of({"t": T, "x": cells}, limits={"x": ">0.6"})
    assert np.array_equal(found.above == 0.6, high) and not np.isfinite(found.below).any()


def test_words_mean_the_limit_that_is_said():
    """BDL is the one limit that the column writes, else the one that is given, else no value."""
    low = TRUE < 0.12
    words = {"t": T, "x": written(TRUE, 0.12, "BDL")}
    table = read_trajectories(words)
    assert not table.trajectories[0].limits and len(table.trajectories[0]) == np.sum(~low)
    (note,) = [n for n in table.notes if "limit" in n]
    assert note.startswith(f"{low.sum()} cells say that 'x' was below a limit that is not written")
    assert "--limit x=..." in note
    found = limits_of(words, limits={"x": 0.12})
    assert np.array_equal(found.below == 0.12, low)
    own = written(TRUE, 0.12)
    own[-1] = "< LOQ"
    assert np.array_equal(limits_of({"t": T, "x": own}).below == 0.12, TRUE < 0.12)
    several = written(TRUE, 0.12)
    several[-2:] = ["<0.10", "bdl"]
    table = read_trajectories({"t": T, "x": several})
    assert any("1 cell says that 'x' was below a limit" in note for note in table.notes)
    assert "n.d." not in str(table.trajectories[0].limits)


def test_limits_that_are_said_hold_for_values():
    """At or below the limit of detection, at or above the end of the range: only that is known."""
    runs, _ = take_trajectories((T, TRUE), limits={"x": "0.12..0.9"})
    found = runs[0].limits["x"]
    assert np.array_equal(found.below == 0.12, TRUE <= 0.12)
    assert np.array_equal(found.above == 0.9, TRUE >= 0.9)
    for said in (0.12, "0.12", "<0.12", "< 0.12", (0.12, None), "0.12.."):
        again = take_trajectories((T, TRUE), limits={"x": said})[0][0].limits["x"]
        assert np.array_equal(again.below, found.below, equal_nan=True)
        assert np.isnan(again.above).all()
    for said in (">0.9", ">= 0.9", (None, 0.9), "..0.9"):
        again = take_trajectories((T, TRUE), limits={"x": said})[0][0].limits["x"]
        assert np.array_equal(again.above, found.above, equal_nan=True)
    two = [{"t": T, "x": TRUE}, {"t": T[::2], "y": TRUE[::2]}]
    (joined,) = read_trajectories(two, limits={"y": 0.12}).trajectories
    assert "x" not in joined.limits and (joined.limits["y"].below == 0.12).sum() > 10
    for wrong in ("<low", "", (1.0, 0.5), (None, None), np.nan, [1, 2, 3]):
        with pytest.raises(InputError, match=r"the limit of 'x' is .*give the limit of detection"):
            take_trajectories((T, TRUE), limits={"x": wrong})
    with pytest.raises(InputError, match="limits names 'y', which is no state; the states are: x"):
        take_trajectories((T, TRUE), limits={"y": 0.1})


def test_the_shell_takes_limits(tmp_path):
    """--limit reaches the data; a wrong one is one line, and exit code 2."""
    path = tmp_path / "x.csv"
    pd.DataFrame({"t": T, "x": written(TRUE, word="<LOD")}).to_csv(path, index=False)
    said = run_command("describe", path).stdout
    assert "61 rows" not in said and "--limit x=..." in said
    assert "61 rows" in run_command("describe", path, "--limit", f"x={LIMIT}").stdout
    wrong = run_command("describe", path, "--limit", "x=<low", code=2)
    assert wrong.stderr.count("\n") == 1 and "the limit of 'x' is '<low'" in wrong.stderr
    wrong = run_command("discover", path, "--limit", "x", code=2)
    assert "--limit 'x' must be a state and its limit" in wrong.stderr


@pytest.mark.slow
def test_a_curve_on_the_wrong_side_of_limits_is_no_law():
    """Residuals of a right law are noise near its limit; one that stays above it is found out."""
    steady = sympy.Float(-0.9) * X + sympy.Float(0.08)
    levels = {"right": 0, "wrong": 0}
    for seed in range(6):
        run = carry([decay(0.02, seed)])
        noise = [np.where(run[0].measured, 0.02, np.inf)]
        levels["right"] += give_verdict({"x": -0.7 * X}, run, noise=noise).level == "law"
        levels["wrong"] += give_verdict({"x": steady}, run, noise=noise).level == "law"
    assert levels["right"] >= 5 and levels["wrong"] == 0


@pytest.mark.slow
def test_a_law_is_found_although_a_state_falls_below_its_limit(tmp_path):
    """Half of the cells of the prey are below the limit; what is kept gives the same data back."""
    t = np.linspace(0, 20, 101)
    exact = solve_ivp(
        lambda _, x: [1.1 * x[0] - 0.4 * x[0] * x[1], 0.1 * x[0] * x[1] - 0.4 * x[1]],
        (0, 20),
        [10, 5],
        t_eval=t,
        rtol=1e-9,
        atol=1e-9,
    ).y
    noise = 0.05 * exact.std(axis=1)[:, None]
    prey, hunters = exact + noise * np.random.default_rng(1).normal(size=exact.shape)
    table = {"t": t, "prey": written(prey, 1.5), "hunters": hunters}
    found = discover(table, preset="quick", jobs=1, out=tmp_path / "kept")
    one, two = sympy.symbols("prey hunters")
    right = {"prey": {one, one * two}, "hunters": {two, one * two}}
    for state, expr in found.equations.items():
        terms = {term.as_coeff_Mul()[1] for term in sympy.Add.make_args(expr)}
        assert terms == right[state]
    assert found.verdict.level == "law"
    again = load(tmp_path / "kept").trajectories[0].limits["prey"]
    assert np.array_equal(again.below == 1.5, prey < 1.5)


@pytest.mark.slow
def test_a_decay_far_below_its_limit_is_one():
    """With half of the rows censored the law is x' = -k x, and the true k is in its interval."""
    for noise in (0.01, 0.05):
        y = TRUE + noise * np.random.default_rng(0).normal(size=len(T))
        found = discover({"t": T, "x": written(y)}, preset="quick", jobs=1)
        assert found.equations["x"].as_coeff_Mul()[1] == X
        assert found.verdict.level == "law"
        (constant,) = found.constants["x"]
        assert constant.low < -0.7 < constant.high


def test_a_picture_has_a_triangle_at_each_limit():
    """Below points down, above up; a state without limits has none, and the legend says what is."""
    runs, _ = take_trajectories({"t": T, "x": TRUE, "y": TRUE + 1}, limits={"y": "1.1..1.8"})
    figure = draw_states(runs[0])
    axes = figure.axes
    marks = [{line.get_marker(): line for line in axis.lines} for axis in axes]
    assert set(marks[0]) == {"o"} and set(marks[1]) == {"o", "v", "^"}
    drawn = marks[1]["v"].get_ydata()
    assert np.array_equal(np.isfinite(drawn), TRUE + 1 <= 1.1) and np.nanmax(drawn) == 1.1
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["data", "below a limit", "above a limit"]
    found = replace(runs[0], x=np.column_stack([TRUE, TRUE + 1]), limits={})
    low, high = draw_states(runs[0], found).axes[1].get_ylim()
    assert low < 1.1 and high > 1.8


def test_each_of_several_runs_has_its_own_cells():
    """A fit of one run of many, as constants that differ need it, is that of the run alone."""
    runs = [decay(0.02, seed) for seed in range(3)]
    every = MixedMesh.of(measure_runs(runs, {}, 2000, {}), ("x",))
    for number, own in enumerate(every.runs):
        low = runs[number].limits["x"].there
        assert np.array_equal(own.mesh.t[own.mesh.censored.places[1]], T[low])
        found = Collocation({"x": -0.65 * X}, own.mesh).fit()
        assert found.constants[0] == pytest.approx(-0.7, abs=0.05)
        assert len(found.censored) == low.sum()


def test_a_table_that_is_written_says_its_limits(tmp_path):
    """What write_csv writes is read again with the same limits, and people see <0.05."""
    runs, _ = take_trajectories((T, TRUE), limits={"x": "0.05..0.9"})
    path = tmp_path / "again.csv"
    write_csv(runs, path)
    assert "6.0,<0.05" in path.read_text() and "0.0,>0.9" in path.read_text()
    found = limits_of(str(path))
    assert np.array_equal(found.below, runs[0].limits["x"].below, equal_nan=True)
    assert np.array_equal(found.above, runs[0].limits["x"].above, equal_nan=True)
    (note,) = describe((T, TRUE), limits={"x": 0.05}).notes
    assert note.startswith("'x' is beyond a limit in 18 of 61 rows")


@pytest.mark.slow
def test_a_fit_with_a_delay_takes_censored_cells():
    """The cost is the same by either way, its slope is right, and the delay is the true one."""
    step, rows = 0.01, 4000
    truth = np.full(rows, 2.0)
    for i in range(rows - 1):
        past = truth[max(i - 120, 0)]
        truth[i + 1] = truth[i] * (1 + step * 1.5 * (1 - past / 10))
    t, x = step * np.arange(0, rows, 20), truth[::20]
    x = x + 0.05 * x.std() * np.random.default_rng(0).normal(size=len(x))
    runs, _ = take_trajectories((t, x), limits={"x": 6.0})
    data = MixedMesh.of(measure_runs(runs, {}, 2000, {}), ("x",))
    rate, crowd, late = sympy.symbols("a b late")
    system = DelayedSystem({"x": rate * X - crowd * X * late}, {"x": "late"}, ["a", "b"])
    found = system.fit(data, np.array([1.4, 0.14, 1.1]), 2.4)
    errors = np.sqrt(np.diag(found.covariance))
    assert len(found.found.censored) == np.sum(x <= 6) > 60
    assert np.all(np.abs(found.theta - [1.5, 0.15, 1.2]) < 3 * errors + [0.01, 0.001, 0.01])
    problem, _ = system.problem(data, found.theta, 2.4)
    rng, stiffness = np.random.default_rng(0), problem.settings.stiffness[-1]
    states = found.found.states.T + 0.01 * rng.normal(size=found.found.states.T.shape)
    constants = found.found.constants
    gathered = problem._gather(problem._linearise(states, constants), states, stiffness)
    cost = problem.cost(states, constants)
    assert gathered.squares + gathered.products[0, 0] == pytest.approx(cost, rel=1e-9)
    way = rng.normal(size=states.shape)
    ends = [problem.cost(states + size * way, constants) for size in (1e-6, -1e-6)]
    slope = 2 * gathered.sides[:, 0] @ way.T.ravel()
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6)


def test_each_row_may_have_a_limit_of_its_own():
    """A column of limits belongs to its state and is none; words mean the limit of their row."""
    lod = np.where(T < 3, 0.2, 0.1)
    low = lod >= TRUE
    cells = ["BDL" if beyond else f"{v:.6f}" for v, beyond in zip(TRUE, low, strict=True)]
    for x in (cells, TRUE):
        table = {"t": T, "x": x, "x_lod": lod}
        found = read_trajectories(table, limits={"x": "x_lod"})
        (run,) = found.trajectories
        assert run.states == ("x",) and found.left_out["x_lod"] == "is the limit of 'x'"
        assert np.array_equal(run.limits["x"].below[low], lod[low])
        assert np.array_equal(run.limits["x"].there, low)
        (again,), _ = take_trajectories(table, limits={"x": "x_lod"})
        assert np.array_equal(again.limits["x"].below, run.limits["x"].below, equal_nan=True)
        assert again.origin["said_limits"] == {"x": "x_lod"}
    with pytest.raises(InputError, match="the limit of 'x' is no number and no column: 'x_lod'"):
        take_trajectories((T, TRUE), limits={"x": "x_lod"})
    with pytest.raises(InputError, match="low"):
        read_trajectories({"t": T, "x": TRUE}, limits={"x": "low"})
    assert take_trajectories((T, TRUE), limits={"x": 0.1})[0][0].origin["said_limits"] == {
        "x": "<0.1"
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["discrete", "stochastic"])
def test_where_limits_do_not_count_one_line_says_so(kind):
    """Maps and noise in the motion take cells beyond a limit for empty ones, and say it."""
    values = 0.9 ** np.arange(61)
    with pytest.warns(DynsrWarning, match="cells beyond a limit count as empty there"):
        found = discover(
            (np.arange(61.0), values), limits={"x": 0.05}, preset="quick", jobs=1, **{kind: True}
        )
    assert found.equations["x"].as_coeff_Mul()[1] == X
