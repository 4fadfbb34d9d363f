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
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import sympy
from joblib import Parallel, delayed
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dynsr.data import KnownNoise, Limits, Trajectory, carry, read_sums
from dynsr.discovery import DiscoverySettings, discover
from dynsr.discovery.unmeasured import number_runs
from dynsr.expression import compile_numpy, evaluate, free_constants, parse
from dynsr.fit import Measurements, Series, StochasticSystem, fit_along
from dynsr.fit.whole import interval_reach
from dynsr.parameters import Delayed, DelaySettings, FreeSettings
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
def solve(
    law: tuple[tuple[str, str], ...], start: tuple[float, ...], end: float, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    """Give even times and the exact states of a system at them."""
    slope = compile_numpy([parse(text) for _, text in law], [*(state for state, _ in law), "t"])
    t = np.linspace(0, end, rows)
    x = solve_ivp(
        lambda t, x: slope([*x, t]),
        (0, end),
        start,
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
        max_step=end / 100,
    ).y.T
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
    t, x = solve(tuple(PREY.items()), (10.0, 5.0), 20.0, 201)
    x = noisy(x, noise, seed)
    x[np.random.default_rng(10_000 + seed).random(x.shape) < share] = np.nan
    x[np.arange(len(t)) % every != 0, 1] = np.nan
    return fit(PREY, Measurements.of(carry([Trajectory(t, x, ("x", "y"))]), {}, 2000))


def summed(noise: float, seed: int) -> Missed:
    """Measure one state and its sum with the other."""
    t, x = solve(tuple(EPIDEMIC.items()), (0.99, 0.01), 60.0, 121)
    seen = noisy(np.column_stack([x[:, 0], x.sum(axis=1)]), noise, seed)
    runs = read_sums([Trajectory(t, seen, ("S", "total"))], {"total": "S + I"})
    return fit(EPIDEMIC, Measurements.of(runs, {}, 2000))


def known_share(noise: float, seed: int) -> Missed:
    """Say errors that are a share of each value."""
    t, x = solve(tuple(GROWTH.items()), (0.1,), 12.0, 61)
    sd = noise * x[:, 0]
    seen = x[:, 0] + sd * np.random.default_rng(seed).standard_normal(len(t))
    run = Trajectory(t, seen[:, None], ("x",), noise={"x": KnownNoise(sd)})
    return fit(GROWTH, Measurements.of([run], {}, 2000))


def below(noise: float, seed: int) -> Missed:
    """Censor the half of all cells that is below a limit."""
    t, x = solve(tuple(DECAY.items()), (1.0,), 6.0, 61)
    y = x[:, 0] + noise * np.random.default_rng(seed).standard_normal(len(t))
    limit = np.exp(-0.7 * 3)
    limits = Limits(np.where(y < limit, limit, np.nan), np.full(len(t), np.nan))
    run = Trajectory(t, np.where(y < limit, np.nan, y)[:, None], ("x",), limits={"x": limits})
    return fit(DECAY, Measurements.of([run], {}, 2000))


def hidden(noise: float, seed: int) -> Missed:
    """Measure the prey alone; the predator is in the unit in which its factor is 1."""
    t, x = solve(tuple(SCALED.items()), (10.0, 2.0), 30.0, 201)
    run = Trajectory(t, noisy(x[:, :1], noise, seed), ("x",))
    data = Measurements.of(number_runs(carry([run])), {}, 2000)
    coupling = Coupling("y", "x", sympy.Symbol("x"), sympy.S.NegativeOne)
    return fit(SCALED, first_curve(data, coupling, read(SCALED)))


@dataclass(frozen=True)
class Late:
    """A system with one delay: its slope, where a fit starts, and the true constants.

    ``held`` says of an input whether it steps between rows or is smooth; None where there is none.
    """

    law: str
    start: str
    delay: float
    end: float
    constants: tuple[float, ...]
    held: bool | None = None

    def run(self, noise: float, seed: int, rows: int = 201) -> Trajectory:
        """Give noisy rows."""
        t, x = _late(self, rows)
        if self.held is None:
            return Trajectory(t, noisy(x[:, None], noise, seed), ("x",))
        u = _input(self, t)[:, None]
        return Trajectory(t, noisy(x[:, None], noise, seed), ("y",), u, ("u",))

    def fit(self, noise: float, seed: int) -> Missed:
        """Fit the delay and all constants, which are compared without their signs."""
        run = self.run(noise, seed)
        (state,) = run.states
        delayed_run = Delayed.of([run], DelaySettings())
        found = delayed_run.fit({state: parse(self.start)}, 1.04 * self.delay, ComparisonSettings())
        order = np.append(np.argsort(np.abs(found.fit.theta[:-1])), -1)
        values = np.append(np.abs(found.fit.theta[:-1]), found.delay)[order]
        errors = np.sqrt(np.diag(found.fit.covariance))[order]
        return (values - (*self.constants, self.delay)) / errors, found.fit.reach


def _changes(system: Late) -> tuple[np.ndarray, np.ndarray]:
    """Give 20 times, between which an input is held, and its values."""
    rng = np.random.default_rng(3)
    rows = np.append(0, np.sort(rng.choice(np.arange(2, 200, 2), 19, replace=False)))
    return system.end / 200 * rows, rng.uniform(0.2, 1.5, 20)


def _input(system: Late, t: np.ndarray) -> np.ndarray:
    """Give the input at times."""
    if not system.held:
        return 1 + 0.4 * np.sin(0.7 * np.maximum(t, 0)) + 0.25 * np.sin(1.9 * np.maximum(t, 0) + 1)
    times, values = _changes(system)
    return values[np.maximum(np.searchsorted(times, t + 1e-9, side="right") - 1, 0)]


@cache
def _late(system: Late, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Solve by the method of steps, which begins again where a delayed input jumps."""
    own, late = ("x", "x_delayed") if system.held is None else ("y", "u_delayed")
    slope = compile_numpy([parse(system.law)], [own, late])
    if system.held is None:
        ends = np.arange(0.0, system.end + system.delay, system.delay)
    elif system.held:
        ends = np.append(_changes(system)[0] + system.delay * (np.arange(20) > 0), system.end)
        ends = np.unique(np.minimum(ends, system.end))
    else:
        ends = np.array([0.0, system.delay, system.end])
    t, x, pieces = np.linspace(0, system.end, rows), [0.5], [lambda _: np.array([0.5])]
    for begin, end in pairwise(ends.tolist()):

        def before(
            s: float, past: Callable = pieces[-1], middle: float = (begin + end) / 2
        ) -> float:
            if system.held is None:
                return past(s - system.delay)[0]
            at = (middle if system.held else s) - system.delay
            return _input(system, np.array([at]))[0]

        piece = solve_ivp(
            lambda s, x, before=before: slope([x[0], before(s)]), (begin, end), x, "DOP853",
            rtol=1e-12, atol=1e-13, max_step=system.delay / 8, dense_output=True,
        )  # fmt: skip
        pieces.append(piece.sol)
        x = piece.y[:, -1]
    places = np.clip(np.searchsorted(ends, t, side="right"), 1, len(ends) - 1)
    return t, np.array([pieces[i](s)[0] for i, s in zip(places, t, strict=True)])


_PIPE = ("1.25*u_delayed - 1.25*y", "1.2*u_delayed - 1.3*y", 1.7, 40.0, (1.25, 1.25))
_HEATER = (
    "2*u_delayed - 0.5*y - 0.1*y^2", "2.1*u_delayed - 0.45*y - 0.11*y^2", 1.3, 40.0, (0.1, 0.5, 2.0)
)  # fmt: skip
LATE = {
    "Hutchinson": Late(
        "1.2*x - 0.6*x*x_delayed", "1.21*x - 0.59*x*x_delayed", 1.6, 40.0, (0.6, 1.2)
    ),
    "blowflies": Late(
        "2*x_delayed*exp(-x_delayed) - 0.175*x",
        "2.01*x_delayed*exp(-1.01*x_delayed) - 0.17*x",
        8.0,
        160.0,
        (0.175, 1.0, 2.0),
    ),
    "Mackey and Glass": Late(
        "0.2*x_delayed/(1 + x_delayed^10) - 0.1*x",
        "0.21*x_delayed/(1.01*x_delayed^10 + 1) - 0.09*x",
        17.0,
        300.0,
        (0.1, 0.2, 1.0),
    ),
    "pipe, held input": Late(*_PIPE, held=True),
    "pipe, smooth input": Late(*_PIPE, held=False),
    "heater, held input": Late(*_HEATER, held=True),
    "heater, smooth input": Late(*_HEATER, held=False),
}


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


def _band(
    run: Trajectory, known: Mapping[str, str], truth: Callable[[np.ndarray], np.ndarray]
) -> Missed:
    """Fit a free function as a curve, and compare it with the true one at 200 even points."""
    settings = DiscoverySettings(free=FreeSettings(fitted=0))
    (part,) = discover(
        run, known=known, settings=settings, jobs=1, progress=False
    ).free.parts.values()
    x = np.linspace(*part.span, 200)
    return (part(x) - truth(x)) / ((part.band(x)[1] - part(x)) / part.reach), part.reach


def _driven(
    law: Mapping[str, str],
    start: tuple[float, ...],
    end: float,
    noise: float,
    seed: int,
    drive: str,
) -> Trajectory:
    """Give 500 noisy rows of a driven system."""
    t, x = solve(tuple({**law}.items()), start, end, 500)
    u = evaluate(parse(drive), {"t": t})
    return Trajectory(t, noisy(x, noise, seed), tuple(law), u[:, None], ("u",))


def free_bumps(noise: float, seed: int) -> Missed:
    """Leave the rate of a decay free, which has two bumps."""
    rate, drive = "0.2 + exp(-16*(x - 1.2)^2) + 0.4*exp(-100/9*(x - 2.2)^2)", "1.5 + 1.2*sin(0.3*t)"
    run = _driven({"x": f"{drive} - 0.5*x - ({rate})*x"}, (1.0,), 80.0, noise, seed, drive)
    return _band(run, {"x": "u - 0.5*x - f(x)*x"}, lambda x: evaluate(parse(rate), {"x": x}))


def free_diode(noise: float, seed: int) -> Missed:
    """Leave the characteristic of a tunnel diode free."""
    drive = "0.5 + 0.3*sin(0.37*t)"
    law = {"v": f"{drive} - v^3/3 + v - w", "w": "0.08*(v + 0.7 - 0.8*w)"}
    run = _driven(law, (-1.0, 0.5), 100.0, noise, seed, drive)
    return _band(run, {"v": "u - f(v) - w", "w": "e*(v + a - b*w)"}, lambda v: v**3 / 3 - v)


def free_predator(noise: float, seed: int) -> Missed:
    """Leave free what a predator eats, which both equations share."""
    law = {"x": "x*(1 - x/3) - 1.2*x*y/(0.5 + x)", "y": "x*y/(0.5 + x) - 0.5*y"}
    t, x = solve(tuple(law.items()), (1.0, 0.5), 40.0, 200)
    known = {"x": "r*x*(1 - x/k) - f(x)*y", "y": "b*f(x)*y - c*y"}
    run = Trajectory(t, noisy(x, noise, seed), ("x", "y"))
    return _band(run, known, lambda x: 1.2 * x / (0.5 + x))


def _friction(noise: float, seed: int, friction: Callable[[np.ndarray], np.ndarray]) -> Missed:
    """Leave the friction of an oscillator free."""
    t = np.linspace(0, 12, 400)
    x = solve_ivp(
        lambda _, z: [z[1], -4 * z[0] - friction(z[1])], (0, 12), [3.0, 0.0], "DOP853", t,
        rtol=1e-9, atol=1e-10, max_step=0.05,
    ).y.T  # fmt: skip
    run = Trajectory(t, noisy(x, noise, seed), ("x", "v"))
    return _band(run, {"x": "v", "v": "-k*x - f(v)"}, friction)


def free_friction(noise: float, seed: int) -> Missed:
    """Leave a friction free that is nearly the same at all speeds: a step, and flat elsewhere."""
    return _friction(noise, seed, lambda v: 0.4 * np.tanh(2 * v))


def free_drawn(noise: float, seed: int) -> Missed:
    """Leave a friction free that bends equally easily everywhere, as a curve is believed to do.

    Twice integrated white noise, another one in each draw.
    """
    v = np.linspace(-7, 7, 281)
    drawn = np.cumsum(np.cumsum(np.random.default_rng(20_000 + seed).standard_normal(len(v))))
    drawn -= np.polyval(np.polyfit(v, drawn, 1), v)
    return _friction(noise, seed, CubicSpline(v, 0.1 * v + 0.4 * drawn / np.std(drawn)))


CASES: Mapping[str, Callable[[float, int], Missed]] = {
    "15 % of all cells empty": lambda noise, seed: some_cells(noise, seed, 0.15, 1),
    "predator at every fifth row": lambda noise, seed: some_cells(noise, seed, 0.0, 5),
    "sum of two states": summed,
    "known errors": known_share,
    "half below the limit": below,
    "hidden predator": hidden,
    **{f"delay: {name}": system.fit for name, system in LATE.items()},
    "noise in the motion": moved,
    "free rate of two bumps": free_bumps,
    "free characteristic": free_diode,
    "free predation": free_predator,
    "free friction": free_friction,
    "free friction, drawn": free_drawn,
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
    # Workers find a solution that is kept by the name of its module.
    from covered import main as named

    named()
