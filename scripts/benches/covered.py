"""How often intervals of 95 % contain the truth, where states, data or equations are known in part.

    scripts/bench covered --draws 60 --cases "hidden predator" --noise 0.01,0.05

Each draw adds noise, as a share of the spread, to exact states. The fit gets the true form of the
equations. The last column but one is the deviation of (fitted - true) / standard error, which is 1
for honest errors. Prints the table of the page on fits.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import cache
from itertools import count

import numpy as np
import sympy
from joblib import Parallel, delayed
from scipy.integrate import solve_ivp

from dynsr.data import KnownNoise, Limits, Trajectory, carry, read_sums
from dynsr.discovery.unmeasured import number_runs
from dynsr.expression import compile_numpy, parse
from dynsr.fit import Measurements, Series, StochasticSystem, fit_along
from dynsr.fit.constants import free_constants
from dynsr.fit.whole import interval_reach
from dynsr.parameters.delays import Delayed, DelaySettings
from dynsr.selection import ComparisonSettings, Coupling
from dynsr.selection.hidden import first_curve

# (fitted - true) / standard error of each constant, and how many errors an interval reaches.
Missed = tuple[np.ndarray, float]
PREY = {"x": "1.1*x - 0.4*x*y", "y": "0.1*x*y - 0.4*y"}
SCALED = {"x": "1.1*x - x*y", "y": "0.1*x*y - 0.4*y"}
EPIDEMIC = {"S": "-0.5*S*I", "I": "0.5*S*I - 0.1*I"}
GROWTH = {"x": "0.73*x - 0.31*x^2"}
DECAY = {"x": "-0.7*x"}


def read(law: Mapping[str, str]) -> dict[str, sympy.Expr]:
    """Give equations from text."""
    return {state: parse(text) for state, text in law.items()}


def truth_of(law: Mapping[str, sympy.Expr]) -> np.ndarray:
    """Give all floats of equations in the order in which they are fitted."""
    return np.array([v for e in law.values() for v in free_constants(e, "c")[1].values()])


@cache
def _solve(
    law: tuple[tuple[str, str], ...], start: tuple[float, ...], end: float, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    slope = compile_numpy([parse(text) for _, text in law], [state for state, _ in law])
    t = np.linspace(0, end, rows)
    x = solve_ivp(lambda _, x: slope(x), (0, end), start, t_eval=t, rtol=1e-10, atol=1e-12).y.T
    return t, x


def noisy(x: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """Add errors of a share of the spread to columns."""
    return x + noise * x.std(axis=0) * np.random.default_rng(seed).standard_normal(x.shape)


def fit(law: Mapping[str, str], data: Measurements) -> Missed:
    """Fit all constants, and compare them with the true ones."""
    exprs = read(law)
    found = fit_along(exprs, data)
    return (found.constants - truth_of(exprs)) / found.errors, interval_reach(found.freedom)


def some_cells(noise: float, seed: int, share: float, every: int) -> Missed:
    """Leave cells out at random, or all but one in so many of the predator."""
    t, x = _solve(tuple(PREY.items()), (10.0, 5.0), 20.0, 201)
    x = noisy(x, noise, seed)
    x[np.random.default_rng(10_000 + seed).random(x.shape) < share] = np.nan
    x[np.arange(len(t)) % every != 0, 1] = np.nan
    return fit(PREY, Measurements.of(carry([Trajectory(t, x, ("x", "y"))]), {}, 2000))


def summed(noise: float, seed: int) -> Missed:
    """Measure one state and its sum with the other."""
    t, x = _solve(tuple(EPIDEMIC.items()), (0.99, 0.01), 60.0, 121)
    seen = noisy(np.column_stack([x[:, 0], x.sum(axis=1)]), noise, seed)
    runs = read_sums([Trajectory(t, seen, ("S", "total"))], {"total": "S + I"})
    return fit(EPIDEMIC, Measurements.of(runs, {}, 2000))


def known_share(noise: float, seed: int) -> Missed:
    """Say errors that are a share of each value."""
    t, x = _solve(tuple(GROWTH.items()), (0.1,), 12.0, 61)
    sd = noise * x[:, 0]
    seen = x[:, 0] + sd * np.random.default_rng(seed).standard_normal(len(t))
    run = Trajectory(t, seen[:, None], ("x",), noise={"x": KnownNoise(sd)})
    return fit(GROWTH, Measurements.of([run], {}, 2000))


def below(noise: float, seed: int) -> Missed:
    """Censor the half of all cells that is below a limit."""
    t, x = _solve(tuple(DECAY.items()), (1.0,), 6.0, 61)
    y = x[:, 0] + noise * np.random.default_rng(seed).standard_normal(len(t))
    limit = np.exp(-0.7 * 3)
    limits = Limits(np.where(y < limit, limit, np.nan), np.full(len(t), np.nan))
    run = Trajectory(t, np.where(y < limit, np.nan, y)[:, None], ("x",), limits={"x": limits})
    return fit(DECAY, Measurements.of([run], {}, 2000))


def hidden(noise: float, seed: int) -> Missed:
    """Measure the prey alone; the predator is in the unit in which its factor is 1."""
    t, x = _solve(tuple(SCALED.items()), (10.0, 2.0), 30.0, 201)
    run = Trajectory(t, noisy(x[:, :1], noise, seed), ("x",))
    data = Measurements.of(number_runs(carry([run])), {}, 2000)
    coupling = Coupling("y", "x", sympy.Symbol("x"), sympy.S.NegativeOne)
    return fit(SCALED, first_curve(data, coupling, read(SCALED)))


@cache
def _late(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Solve x' = 1.2 x (1 - x(t - 1.6) / 2) by the method of steps."""
    t, pieces, x = np.linspace(0, 40, rows), [lambda _: [0.5]], [0.5]
    for i in count():
        if i * 1.6 >= 40:
            break
        piece = solve_ivp(
            lambda s, x, past=pieces[-1]: 1.2 * x * (1 - past(s - 1.6)[0] / 2),
            (i * 1.6, (i + 1) * 1.6), x, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True,
        )  # fmt: skip
        pieces.append(piece.sol)
        x = piece.y[:, -1]
    places = np.minimum((t // 1.6).astype(int) + 1, len(pieces) - 1)
    return t, np.array([pieces[i](s)[0] for i, s in zip(places, t, strict=True)])


def _fit_delay(run: Trajectory, start: str, truth: tuple[float, ...]) -> Missed:
    """Fit a delay, which is last of the truth, and all constants, without their signs."""
    (state,) = run.states
    delayed_run = Delayed.of([run], DelaySettings())
    found = delayed_run.fit({state: parse(start)}, 1.04 * truth[-1], ComparisonSettings())
    order = np.append(np.argsort(np.abs(found.fit.theta[:-1])), -1)
    values = np.append(np.abs(found.fit.theta[:-1]), found.delay)[order]
    errors = np.sqrt(np.diag(found.fit.covariance))[order]
    return (values - truth) / errors, found.fit.reach


def delayed_state(noise: float, seed: int) -> Missed:
    """Fit the delayed logistic equation."""
    t, x = _late(201)
    run = Trajectory(t, noisy(x[:, None], noise, seed), ("x",))
    return _fit_delay(run, "1.21*x - 0.59*x*x_delayed", (0.6, 1.2, 1.6))


def delayed_input(noise: float, seed: int) -> Missed:
    """Fit a pipe of which the input steps between rows, solved in closed form."""
    rng, t = np.random.default_rng(3), np.linspace(0, 40, 201)
    when = np.append(0, np.sort(rng.choice(t[1:-1], 19, replace=False)))
    change = rng.normal(size=20)
    since = t[:, None] - when
    y = (1 - np.exp(-np.maximum(since - 1.7, 0) / 0.8)) @ change
    u = (since >= 0) @ change
    run = Trajectory(t, noisy(y[:, None], noise, seed), ("y",), u[:, None], ("u",))
    return _fit_delay(run, "1.2*u_delayed - 1.3*y", (1.25, 1.25, 1.7))


def moved(noise: float, seed: int) -> Missed:
    """Fit drift and diffusion of Ornstein and Uhlenbeck's process, drawn by its exact steps."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 60, 401)
    kept = np.exp(-1.2 * t[1])
    steps = np.sqrt(0.5 / 2.4 * (1 - kept**2)) * rng.standard_normal(len(t))
    x = [2.0]
    for step in steps[1:]:
        x.append(kept * x[-1] + step)
    run = Trajectory(t, noisy(np.array(x)[:, None], noise, 10_000 + seed), ("x",))
    law, level = {"x": parse("-1.2*x")}, {"x": sympy.Float(0.5)}
    errors = {"x": noise * float(np.std(x))} if noise else {}
    series = Series.of([run]) if noise else Series.of([run]).apart()
    found = StochasticSystem(law, level, series, errors).fit()
    return (found.values[:2] - [-1.2, np.log(0.5)]) / found.sizes[:2], interval_reach(len(t))


CASES: Mapping[str, Callable[[float, int], Missed]] = {
    "15 % of all cells empty": lambda noise, seed: some_cells(noise, seed, 0.15, 1),
    "predator at every fifth row": lambda noise, seed: some_cells(noise, seed, 0.0, 5),
    "sum of two states": summed,
    "known errors": known_share,
    "half below the limit": below,
    "hidden predator": hidden,
    "delay of a state": delayed_state,
    "delay of an input": delayed_input,
    "noise in the motion": moved,
}


def main() -> None:
    """Print a row for each case and size of the noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--noise", default="0.01,0.05", help="shares of the spread, by commas")
    parser.add_argument("--jobs", type=int, default=-1, help="fits at a time")
    asked = parser.parse_args()
    print("| case | noise | intervals | contain the truth | deviation | s |")
    print("| :--- | ---: | ---: | ---: | ---: | ---: |")
    for name in asked.cases:
        for noise in map(float, asked.noise.split(",")):
            began = time.monotonic()
            each = Parallel(asked.jobs)(
                delayed(CASES[name])(noise, seed) for seed in range(asked.draws)
            )
            z = np.concatenate([own for own, _ in each])
            inside = np.concatenate([np.abs(own) <= reach for own, reach in each])
            seconds = (time.monotonic() - began) / asked.draws
            print(
                f"| {name} | {noise:.0%} | {len(z)} | {np.mean(inside):.1%} | {np.std(z):.2f} "
                f"| {seconds:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
