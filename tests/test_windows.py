"""Long records: searched on the windows that tell most, fitted to and tested on every row."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from scipy.optimize import least_squares

from dynsr.cli.discovery import show_files, show_reasons
from dynsr.cli.results import score_discovery
from dynsr.data import (
    StateNoise,
    Trajectory,
    Window,
    WindowSettings,
    choose_windows,
    cut_to_windows,
)
from dynsr.discovery import DISCOVERY, Discovery, discover
from dynsr.discovery.every_row import on_every_row, take_windows
from dynsr.expression import parse
from dynsr.fit import ParetoFront, fit_blocks
from dynsr.fit.blocks import cut_blocks
from dynsr.methods import RationalSearch
from dynsr.report.discovery import render_discovery
from dynsr.verdict.levels import StateVerdict, Verdict

RNG = np.random.default_rng(3)
T = np.linspace(0.0, 100.0, 4001)
X, Y = sympy.symbols("x y")
# A rotation at the rate 0.8.
TURN = {"x": 0.8 * Y, "y": -0.8 * X}
NOISE = 0.02
FEW = WindowSettings(above=1000, count=5, rows=100, block=1000)
SETTINGS = replace(DISCOVERY, windows=FEW)
QUICK = {
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
    "jobs": 1,
    "settings": SETTINGS,
}


def turning(rates=(0.8,), noise=0.0):
    """A rotation whose rate changes at even parts of the time."""
    rate = np.repeat(rates, -(-len(T) // len(rates)))[: len(T)]
    angle = np.concatenate([[0.0], np.cumsum(rate[1:] * np.diff(T))])
    x = np.column_stack([np.sin(angle), np.cos(angle)])
    return Trajectory(T, x + noise * RNG.standard_normal(x.shape), ("x", "y"))


def law(run, windows, exprs=TURN):
    """A discovery as the windows of a run give it."""
    own = StateVerdict("law", "reproduces the data within their noise.", 1.0)
    return Discovery(
        exprs,
        dict.fromkeys(exprs, ((0.8, 0.01),)),
        {},
        dict.fromkeys(exprs, " Found by search."),
        tuple(cut_to_windows([run], windows)),
        settings={"engine": "embedded"},
        verdict=Verdict("law", "it follows.", dict.fromkeys(exprs, own)),
    )


def test_the_windows_are_where_something_happens():
    """Of a decay that is over after a hundredth of the record, a window has its begin."""
    rest = Trajectory(T, np.exp(-T)[:, None], ("x",))
    first = choose_windows([rest], FEW)[0]
    assert (first.run, first.first) == (0, 0)


def test_windows_tell_more_than_even_ones():
    """The determinant of what they say of a sum of products is larger than that of even windows."""
    swing = np.sin(T) * (1 + 0.9 * np.sin(0.05 * T))
    run = Trajectory(T, np.column_stack([swing, np.cos(0.3 * T)]), ("x", "y"))
    chosen = choose_windows([run], FEW)
    starts = np.linspace(0, len(T) - 100, 5).astype(int)
    even = [Window(0, int(i), int(i) + 100) for i in starts]

    def told(windows):
        """Logarithm of the determinant, from its definition."""
        whole = np.zeros((6, 6))
        for one in cut_to_windows([run], windows):
            x, y = one.x.T
            features = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
            steps = np.diff(one.t)[:, None] * (features[1:] + features[:-1]) / 2
            integrals = np.vstack([np.zeros(6), np.cumsum(steps, axis=0)])
            whole += len(one) * np.cov(integrals.T, bias=True)
        return np.linalg.slogdet(whole)[1]

    assert [len(window) for window in chosen] == [100] * 5
    assert told(chosen) > told(even)


def test_noise_asks_for_longer_windows_and_exact_rows_for_near_ones():
    """Of a slow motion in noise one row in many is taken; of an exact one, every row."""
    slow = np.sin(0.05 * T)[:, None]
    noisy = Trajectory(T, slow + 0.1 * RNG.standard_normal(slow.shape), ("x",))
    assert choose_windows([noisy], FEW)[0].stride > 2
    assert choose_windows([Trajectory(T, np.sin(T)[:, None], ("x",))], FEW)[0].stride == 1


def test_a_map_leaves_out_no_row():
    """The same noise asks for every row where each follows from the one before."""
    slow = Trajectory(T, np.sin(0.02 * T)[:, None] + 0.1 * RNG.standard_normal((len(T), 1)), ("x",))
    assert take_windows([slow], FEW, None, 1000)[1][0].stride > 1
    assert {w.stride for w in take_windows([slow], FEW, None, 1000, discrete=True)[1]} == {1}


def test_short_runs_are_taken_whole():
    """Of many short runs, as many are taken as the windows have rows together."""
    runs = [
        Trajectory(T[:50], np.exp(-k * T[:50])[:, None], ("x",)) for k in np.linspace(0.1, 2, 60)
    ]
    chosen = choose_windows(runs, FEW)
    assert {(w.first, w.last) for w in chosen} == {(0, 50)}
    assert len({w.run for w in chosen}) == len(chosen) == 10


def test_few_rows_are_all_searched():
    """Below the number of rows nothing is chosen, and slopes stay as they are."""
    run = turning()
    assert take_windows([run], FEW, None, len(T)) == ([run], [], None)


def test_blocks_together_are_a_fit_to_all_rows():
    """The mean of the blocks is that of SciPy's fit of the closed solution, a phase each block."""
    run = turning(noise=NOISE)
    blocks = fit_blocks(
        {"x": 0.79 * Y, "y": -0.81 * X}, [run], {}, [StateNoise(NOISE)] * 2, 0.0, 1000
    )
    places = list(cut_blocks([len(T)], 1000))

    def missed(values):
        """Of x = A sin(w t + c), y = A r cos(w t + c), w^2 = a b, r^2 = b / a."""
        a, b = values[:2]
        found = []
        for (_, first, last), (size, phase) in zip(places, values[2:].reshape(-1, 2), strict=True):
            angle = np.sqrt(a * b) * T[first:last] + phase
            x = np.column_stack([np.sin(angle), np.sqrt(b / a) * np.cos(angle)])
            found.append(size * x - run.x[first:last])
        return np.concatenate(found).ravel()

    whole = least_squares(missed, [0.8, 0.8, *[1.0, 0.0] * len(places)])
    errors = NOISE * np.sqrt(np.diag(np.linalg.inv(whole.jac.T @ whole.jac)))[:2]
    np.testing.assert_allclose(np.abs(blocks.constants), whole.x[:2], atol=0.1 * errors.min())
    np.testing.assert_allclose(blocks.errors, errors, rtol=0.1)
    assert blocks.differing(0.95) == []


def test_exact_blocks_give_the_constant_to_many_digits():
    """Of exact states the constants are those of the solution."""
    start = {"x": 0.7999 * Y, "y": -0.8001 * X}
    blocks = fit_blocks(start, [turning()], {}, None, 3e-6, 1000)
    np.testing.assert_allclose(np.abs(blocks.constants), 0.8, rtol=1e-8)
    assert blocks.differing(0.95) == []


def test_simple_numbers_of_exact_rows_stay_simple():
    """A third is written as a third, and no decimal takes its place."""
    blocks = fit_blocks(
        {"x": 2.666667 * Y, "y": -2.666667 * X}, [turning((8 / 3,))], {}, None, 1e-5, 1000
    )
    third = sympy.Rational(8, 3)
    assert blocks.choose_numbers([(8 / 3, 1e-9), (-8 / 3, 1e-9)]) == [third, -third]


@pytest.mark.parametrize("noise", [0.0, pytest.param(NOISE, marks=pytest.mark.slow)])
def test_a_law_that_changes_is_no_law_of_all_rows(noise):
    """Windows before the change show a law; the rows after it are named in the verdict."""
    run = turning((0.8, 0.8, 0.8, 0.84), noise)
    windows = [Window(0, i, i + 100) for i in (0, 800, 2000)]
    found = on_every_row(law(run, windows), [run], windows, SETTINGS)
    assert found.verdict.level == "approximation"
    assert "rows 3001 to 4001" in found.verdict.reason
    assert found.settings["windows"]["differing"] == [[1, 3001, 4001]]


@pytest.mark.slow
def test_constants_and_their_intervals_are_those_of_all_rows():
    """The constant is found anew, surer than in the windows, and its pair has its place."""
    run = turning((0.8,), NOISE)
    windows = [Window(0, i, i + 100) for i in (0, 800, 2000)]
    begun = {"x": 0.803 * Y, "y": -0.798 * X}
    found = on_every_row(law(run, windows, begun), [run], windows, SETTINGS)
    for state, sign in (("x", 1), ("y", -1)):
        ((value, error),) = found.errors[state]
        assert error < 1e-3 and abs(value - sign * 0.8) < 4 * error
        assert found.fitted[state][0] == pytest.approx(value, abs=4 * error)
    assert found.verdict.level == "law"
    assert "fitted to all of them, which agree" in found.explanation["x"]


@pytest.mark.slow
def test_a_long_table_is_searched_on_windows():
    """The whole call: a law with its constants of all rows, and the record says which were seen."""
    found = discover(turning(), **QUICK)
    assert {s: str(e) for s, e in found.equations.items()} == {"x": "0.8*y", "y": "-0.8*x"}
    assert found.verdict.level == "law"
    assert found.settings["windows"]["rows"] == len(T)
    assert len(found.settings["windows"]["searched"]) == len(found.trajectories) == 5
    assert found.settings["windows"]["differing"] == []


@pytest.mark.slow
def test_own_slopes_go_with_the_windows():
    """Slopes that the user gives are read at the rows of the windows."""
    run = turning()
    slopes = {"x": 0.8 * run.x[:, 1], "y": -0.8 * run.x[:, 0]}
    _, windows, own = take_windows([run], FEW, slopes, 1000)
    np.testing.assert_array_equal(own["x"][0], slopes["x"][windows[0].rows])
    assert discover(run, slopes=slopes, **QUICK).equations["x"] == parse("0.8*y")


def test_an_alias_is_no_slow_motion():
    """Rows that are whole periods apart lie still; of them no window is made, however long."""
    t = np.arange(2.0**15)
    for period in (64, 49.75):
        angle = 2 * np.pi * t / period
        run = Trajectory(t, np.column_stack([np.sin(angle), np.cos(angle)]), ("x", "y"))
        noisy = replace(run, x=run.x + NOISE * RNG.standard_normal(run.x.shape))
        for own in (run, noisy):
            chosen = choose_windows([own], WindowSettings(count=1, rows=30))
            assert max(window.stride for window in chosen) < period / 4


@pytest.mark.slow
def test_windows_name_themselves(capsys):
    """The report, the scores and the file of the data say that they are of the windows."""
    run = turning()
    windows = [Window(0, i, i + 100) for i in (0, 800, 2000)]
    found = on_every_row(law(run, windows), [run], windows, SETTINGS)
    found = replace(found, front=dict.fromkeys(TURN, ParetoFront(())))
    says = "3 windows of 4,001 rows"
    assert f"found on {says}. These 300 rows are" in render_discovery(found)
    show_files(found, [Path("here/data.csv")], Path("here"))
    assert f"data.csv ({says})" in " ".join(capsys.readouterr().err.split())
    scores = score_discovery(found, [run], None, "embedded")
    assert scores == {"data": found.score(found.trajectories)}
    show_reasons(found, scores, {}, details=True)
    assert f"the data here are {says}" in " ".join(capsys.readouterr().out.split())
