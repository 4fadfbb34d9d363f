"""Own loss: what a miss counts decides among formulas, and fits the constants of the best."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from scipy.optimize import linprog

import dynsr
from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.fit import Candidate, choose_by_loss, read_loss
from dynsr.methods.rational import RationalSearch

SUMS = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1)


def pinball(predicted: np.ndarray, actual: np.ndarray) -> np.ndarray:
    """Count what lies above nine times as much as what lies below: least at the 0.9 quantile."""
    return np.where(actual > predicted, 0.9 * (actual - predicted), 0.1 * (predicted - actual))


def line() -> tuple[np.ndarray, np.ndarray]:
    """Give a line with skewed noise."""
    rng = np.random.default_rng(0)
    x = rng.uniform(1, 5, 300)
    return x[:, None], 2 + 1.5 * x + rng.exponential(1.0, 300)


@pytest.mark.slow
def test_a_function_of_ones_own_finds_the_quantile() -> None:
    """Nine rows in ten lie below the formula, where without it about half do."""
    X, y = line()
    plain = dynsr.DynsrRegressor("sindy").fit(X, y)
    model = dynsr.DynsrRegressor("sindy", loss=pinball).fit(X, y)
    assert 0.3 < np.mean(y < plain.predict(X)) < 0.75
    assert np.mean(y < model.predict(X)) == pytest.approx(0.9, abs=0.03)
    mean = np.mean(pinball(model.predict(X), y))
    assert mean < np.mean(pinball(plain.predict(X), y))
    assert (model.equations_["loss"] >= np.min(model.equations_["loss"])).all()
    chosen = model.equations_["sympy_format"].tolist().index(model.expr_)
    assert model.equations_["loss"][chosen] == pytest.approx(mean)


def test_constants_have_the_least_absolute_misses() -> None:
    """Those of a line are those that linear programming finds."""
    X, y = line()
    samples = Samples(X, y, ("x",), "y", "given", np.arange(300.0))
    start = Candidate(parse("1.4*x + 3.1"), 1.0, 1.0)
    loss = read_loss("absolute")
    assert loss is not None
    pool, judged = choose_by_loss([start], samples, loss)
    found = pool[-1].expr
    slope, level = float(found.coeff("x")), float(found.subs({"x": 0}))
    # min sum(u + v) with a x + b + u - v = y and u, v >= 0.
    n = len(y)
    table = np.hstack([X, np.ones((n, 1)), np.eye(n), -np.eye(n)])
    best = linprog(
        [0, 0, *[1] * (2 * n)], A_eq=table, b_eq=y, bounds=[(None, None)] * 2 + [(0, None)] * 2 * n
    )
    assert (slope, level) == pytest.approx(tuple(best.x[:2]), abs=1e-4)
    assert judged.loss is not None
    assert np.mean(judged.residuals(slope * X[:, 0] + level) ** 2) == pytest.approx(best.fun / n)


@pytest.mark.parametrize("name", ["huber", "cauchy"])
def test_robust_losses_leave_outliers_behind(name: str) -> None:
    """Beyond some errors' size Huber's loss grows with the miss, Cauchy's hardly at all."""
    rng = np.random.default_rng(1)
    x = np.linspace(0, 3, 120)
    y = 2 * x + 0.01 * rng.normal(size=120)
    y[::10] += 5
    samples = Samples(x[:, None], y, ("x",), "y", "given", x)
    loss = read_loss(name)
    assert loss is not None
    pool, judged = choose_by_loss([Candidate(parse("2.4*x"), 1.0, 1.0)], samples, loss)
    assert float(pool[-1].expr.coeff("x")) == pytest.approx(2, abs=0.3)
    assert judged.loss is not None
    near, far, further = judged.loss(np.array([0.001, 5.0, 10.0]), np.zeros(3))
    assert near == pytest.approx(1e-6, rel=1e-3)
    assert (1.9 < further / far < 2.3) if name == "huber" else (1 < further / far < 1.9)


@pytest.mark.slow
def test_squares_are_what_everything_counts_by_itself() -> None:
    """Squared and none at all are the same, of the estimator and of a discovery."""
    X, y = line()
    models = [dynsr.DynsrRegressor("sindy", loss=loss).fit(X, y) for loss in (None, "squared")]
    assert models[0].expr_ == models[1].expr_
    t = np.linspace(0, 4, 90)
    data = dynsr.Trajectory(t, np.exp(-0.7 * t)[:, None], ("x",))
    found = [dynsr.discover(data, method=SUMS, jobs=1, loss=loss) for loss in (None, "squared")]
    assert found[0].as_record()["front"] == found[1].as_record()["front"]
    assert "loss" not in found[1].settings


def likeliest(details: str) -> str:
    """Give the formula of fewest bits among those that the details of a choice compare."""
    told = re.findall(
        r"(?:= |next best, |\. )([^=,]+?),? takes (-?\d+) bits (in all|more|less)", details
    )
    whole = int(told[0][1])
    bits = [whole + int(n) * {"in all": 0, "more": 1, "less": -1}[how] for _, n, how in told]
    return str(told[bits.index(min(bits))][0])


@pytest.mark.slow
def test_a_discovery_ranks_by_the_loss() -> None:
    """On slopes of one's own with skewed errors, the quantile's constant is chosen."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 20, 150)
    x = 2 + np.sin(t)
    slopes = 1.5 * x + rng.exponential(0.5, 150)
    data = dynsr.Trajectory(t, x[:, None], ("x",))
    shares = {}
    for loss in (None, pinball):
        with pytest.warns(UserWarning, match="biased"):
            found = dynsr.discover(
                data, slopes={"x": slopes}, method=SUMS, jobs=2, loss=loss, discrete=False
            )
        formula = parse(likeliest(found.details["x"]).replace("^", "**"), ["x"])
        values = np.array([float(formula.subs({"x": value})) for value in x])
        shares[loss] = float(np.mean(slopes < values))
    assert shares[None] < 0.75
    assert shares[pinball] == pytest.approx(0.9, abs=0.05)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("foo", "unknown loss 'foo'; the losses are: squared, absolute, huber, cauchy; or give a"),
        (3, "unknown loss '3'"),
        (lambda p, a: float(np.mean(p - a)), "the loss gives shape () for 81 rows; it takes pre"),
        (lambda p, a: p - a, "the loss gives losses below 0 or no numbers for 81 rows"),
    ],
)
def test_what_is_no_loss_is_one_line(given: object, said: str) -> None:
    """The line says what a loss is, before any search."""
    with pytest.raises(InputError) as error:
        read_loss(given)
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_functions_of_one_name_are_told_apart(tmp_path: Path) -> None:
    """A folder goes on with its own loss, and not with another of the same name."""
    t = np.linspace(0, 4, 90)
    data = dynsr.Trajectory(t, np.exp(-0.7 * t)[:, None], ("x",))

    def give(power: float) -> dynsr.Discovery:
        def own(predicted: np.ndarray, actual: np.ndarray) -> np.ndarray:
            return np.abs(predicted - actual) ** power

        return dynsr.discover(data, method=SUMS, jobs=1, loss=own, out=tmp_path / "out")

    assert give(1.5).settings["loss"].startswith("own: ")
    give(1.5)
    with pytest.raises(InputError, match="other"):
        give(1.2)


@pytest.mark.slow
def test_the_shell_takes_a_loss(tmp_path: Path) -> None:
    """--loss reaches the record; an unknown one is one line."""
    t = np.linspace(0, 4, 80)
    path = tmp_path / "decay.csv"
    np.savetxt(path, np.column_stack([t, np.exp(-t)]), delimiter=",", header="t,x", comments="")
    words = ("discover", path, "--jobs", "1", "--json", "--quiet", "--preset", "quick")
    assert json.loads(run(*words, "--loss", "huber").stdout)["settings"]["loss"] == "huber"
    assert "unknown loss 'foo'" in run(*words, "--loss", "foo", code=2).output
