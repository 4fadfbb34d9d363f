"""Maps: equations x[n+1] = f(x[n]) from row to row, where nothing moves between the rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import sympy
from scipy.special import fdtrc

from dynsr.data import Samples, Trajectory, one_step, sample_input
from dynsr.errors import EngineError, InputError
from dynsr.expression import (
    arguments_of,
    compile_numpy,
    differentiate,
    evaluate,
    free_constants,
    parse,
    to_latex_formula,
    to_mathml,
)
from dynsr.fit import (
    Match,
    loosen,
    rmse,
    tidy,
    written_constant,
)
from dynsr.verdict.following import ENOUGH_ROWS
from dynsr.verdict.levels import VERDICT


def pair_rows(runs: Sequence[Trajectory], target: str) -> Samples:
    """Pair every row with the next value of the target, where it follows after one usual step.

    Only rows where every state was measured are paired, and only with measured values.

    Parameters
    ----------
    runs : trajectories of the same columns.
    target : the state whose next value is wanted.

    Raises InputError when the steps are so uneven that most rows have no next one.

    >>> halving = Trajectory([0.0, 1.0, 2.0], [[4.0], [2.0], [1.0]], ("x",))
    >>> pair_rows([halving], "x").y.tolist()
    [2.0, 1.0]
    """
    steps = [np.diff(run.t) for run in runs]
    shortest, longest = one_step(np.concatenate(steps), runs[0].time_unit)
    kept = [np.flatnonzero((shortest <= step) & (step <= longest)) for step in steps]
    whole: list[np.ndarray] = [np.all(run.measured, axis=1) for run in runs]
    after = [run.measured[:, run.index(target)] for run in runs]
    if 2 * sum(map(len, kept)) < sum(map(len, steps)):
        raise InputError("the rows are at uneven times; a map needs one row a step")
    kept = [
        rows[before[rows] & own[rows + 1]]
        for rows, before, own in zip(kept, whole, after, strict=True)
    ]
    if not sum(map(len, kept)):
        raise InputError(
            f"no row where every column was measured is followed by a value of {target!r}; "
            "a map needs such pairs"
        )
    return Samples(
        np.concatenate([run.columns[rows] for run, rows in zip(runs, kept, strict=True)]),
        np.concatenate(
            [run.x[rows + 1, run.index(target)] for run, rows in zip(runs, kept, strict=True)]
        ),
        runs[0].names,
        target,
        "given",
        np.concatenate([run.t[rows] for run, rows in zip(runs, kept, strict=True)]),
    )


def products_of(rows: np.ndarray, degree: int) -> np.ndarray:
    """Give the products (n, c) of columns, each in units of its spread around its mean, and 1.

    Parameters
    ----------
    rows : (d, n) the columns; unknown values count as the mean.
    degree : of the products at most.

    >>> products_of(np.array([[1.0, 3.0], [2.0, 6.0]]), 2).tolist()
    [[1.0, -1.0, -1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]]
    """
    spread = np.maximum(np.nanstd(rows, axis=1), 1e-300)
    middle = np.nanmean(rows, axis=1)
    units = np.nan_to_num((rows - middle[:, None]) / spread[:, None])
    columns = [np.ones(rows.shape[1])]
    for power in range(1, degree + 1):
        chosen = combinations_with_replacement(range(len(rows)), power)
        columns += [np.prod(units[list(some)], axis=0) for some in chosen]
    return np.column_stack(columns)


def chance_of(design: np.ndarray, values: np.ndarray, fitted: int) -> float:
    """Give the probability that columns (n, c) explain as much of values (n,) by chance.

    Fisher's test; of the columns so many are ``fitted``, the others were taken out before.
    """
    weights, *_ = np.linalg.lstsq(design, values, rcond=None)
    left, freedom = float(np.sum((values - design @ weights) ** 2)), len(values) - design.shape[1]
    ratio = (float(values @ values) - left) / fitted / max(left / freedom, 1e-300)
    return float(fdtrc(fitted, freedom, ratio))


def measure_step_errors(
    expr: sympy.Expr, samples: Samples
) -> tuple[tuple[tuple[float, float], ...], tuple[float, ...]]:
    """Give (value, standard error) of the constants of a map, and their values by least squares.

    The errors are those of ordinary least squares on one step: right for noise in the motion
    itself. Noise of the measurement alone is in both sides of a step and makes them too small.

    >>> x = np.linspace(0, 1, 50)
    >>> pairs = Samples(x[:, None], 3 * x + 0.1 * np.cos(60 * x), ("x",), "x", "given", x)
    >>> tripling = sympy.Float(3) * sympy.Symbol("x")
    >>> ((value, error),), (fitted,) = measure_step_errors(tripling, pairs)
    >>> value, bool(abs(fitted - 3) < 2 * error < 0.1)
    (3.0, True)
    """
    template, values = free_constants(loosen(expr), "constant ")
    if not values:
        return (), ()
    misses, jacobian = linearise_constants(template, values, samples)
    shift, *_ = np.linalg.lstsq(jacobian, misses, rcond=None)
    left = misses - jacobian @ shift
    freedom = max(len(misses) - len(values), 1)
    spread = np.linalg.pinv(jacobian.T @ jacobian)
    errors = np.sqrt(np.maximum(np.diag(spread), 0.0) * float(left @ left) / freedom)
    numbers = np.array(list(values.values()))
    return tuple(zip(numbers.tolist(), errors.tolist(), strict=True)), tuple(
        (numbers + shift).tolist()
    )


def match_steps(
    equations: Mapping[str, sympy.Expr], samples: Mapping[str, Samples], reach: float = 1.96
) -> Match:
    """Give maps as they are, with the errors and the fitted values of their constants."""
    found = {s: measure_step_errors(e, samples[s]) for s, e in equations.items()}
    errors = {s: own for s, (own, _) in found.items()}
    fitted = {s: own for s, (_, own) in found.items()}
    return Match(dict(equations), errors, np.empty(0), True, fitted, reach)


def linearise_constants(
    template: sympy.Expr, values: Mapping[sympy.Symbol, float], samples: Samples
) -> tuple[np.ndarray, np.ndarray]:
    """Give what a formula misses (n,), and its slopes (n, P) by constants at their values."""
    columns, rows = samples.timed, len(samples)
    put = {symbol: sympy.Float(value) for symbol, value in values.items()}
    by = [evaluate(differentiate(template, symbol).xreplace(put), columns) for symbol in values]
    slopes = np.array([np.broadcast_to(own, rows) for own in by]).reshape(len(by), rows).T
    return samples.y - evaluate(template.xreplace(put), columns), slopes


def measure_step_covariance(
    equations: Mapping[str, sympy.Expr],
    symbols: Sequence[sympy.Symbol],
    values: Sequence[float],
    runs: Sequence[Trajectory],
) -> np.ndarray:
    """Give the covariance (P, P) of the parameters of a map by least squares on one step.

    Parameters
    ----------
    equations : state -> right-hand side with P symbols, which may be in several places.
    symbols, values : the parameters and their values.
    runs : trajectories of the same columns.

    >>> x, k = sympy.symbols("x k")
    >>> halving = Trajectory([0.0, 1.0, 2.0], [[4.0], [2.1], [1.0]], ("x",))
    >>> measure_step_covariance({"x": k * x}, [k], [0.5], [halving]).round(5).tolist()
    [[0.00061]]
    """
    numbers = dict(zip(symbols, values, strict=True))
    normal = np.zeros((len(symbols),) * 2)
    for state, expr in equations.items():
        misses, jacobian = linearise_constants(expr, numbers, pair_rows(runs, state))
        freedom = max(len(misses) - sum(s in expr.free_symbols for s in symbols), 1)
        normal += jacobian.T @ jacobian * freedom / max(float(misses @ misses), 1e-300)
    return np.linalg.pinv(normal, hermitian=True)


def keep_within(
    expr: sympy.Expr, samples: Samples, reach: float = 1.96, finest: float = 1e-9
) -> sympy.Expr:
    """Give a map whose constants lie within their own intervals, which simple numbers may leave.

    Parameters
    ----------
    expr : the right-hand side.
    samples : pairs of rows.
    reach : standard errors that an interval reaches to either side.
    finest : share of itself by which a constant is never distinguished from another.

    >>> x = np.linspace(0, 1, 50)
    >>> pairs = Samples(x[:, None], 2.9 * x + 0.01 * np.cos(60 * x), ("x",), "x", "given", x)
    >>> keep_within(3 * sympy.Symbol("x"), pairs)
    2.8996*x
    """
    while True:
        template, values = free_constants(loosen(expr), "constant ")
        errors, fitted = measure_step_errors(expr, samples)
        outside = {
            symbol: sympy.Float(written_constant(best, error))
            for symbol, (value, error), best in zip(values, errors, fitted, strict=True)
            if abs(value - best) > reach * error + finest * abs(value)
        }
        if not outside:
            return expr
        numbers = {s: sympy.Float(v) for s, v in values.items()}
        changed = tidy(template.xreplace(numbers | outside))
        if changed == expr:
            return expr
        expr = changed


def iterate(
    equations: Mapping[str, sympy.Expr],
    x0: Sequence[float] | np.ndarray,
    t: Sequence[float] | np.ndarray,
    inputs: Mapping[str, Any] | None = None,
) -> Trajectory:
    """Iterate a map from a start, once for every time after the first.

    Parameters
    ----------
    equations : state -> its next value, in the states, the inputs and ``t``.
    x0 : (k,) start in the order of the equations.
    t : (n,) increasing times of the rows.
    inputs : name -> expression in ``t``, function of one time, or (n,) values at the times.

    Raises InputError when an input is missing or a length does not fit, EngineError when the map
    leaves the finite numbers.

    >>> iterate({"x": 2 * sympy.Symbol("x")}, [1.0], [0.0, 1.0, 2.0]).x.ravel().tolist()
    [1.0, 2.0, 4.0]
    """
    times, start = np.asarray(t, dtype=float), np.asarray(x0, dtype=float)
    if start.shape != (len(equations),):
        raise InputError(f"x0 must be {len(equations)} numbers, one per state; it is {x0!r}")
    names = arguments_of(equations)
    given = [_values(name, inputs or {}, times) for name in names]
    step = compile_numpy(list(equations.values()), [*equations, *names, "t"])
    rows = [start]
    with np.errstate(all="ignore"):
        for i, time in enumerate(times[:-1]):
            column = [*rows[-1], *(values[i] for values in given), time]
            following = step(np.array(column)[:, None])[:, 0]
            if not np.all(np.isfinite(following)):
                raise EngineError(f"the map has no value after step {i + 1}; give fewer rows")
            rows.append(following)
    return Trajectory(times, np.array(rows), tuple(equations), origin={"engine": "iteration"})


def _values(name: str, inputs: Mapping[str, Any], times: np.ndarray) -> np.ndarray:
    if name not in inputs:
        raise InputError(
            f"nothing says what {name!r} does; give it as an input or discover its equation too"
        )
    value = inputs[name]
    if isinstance(value, (str, sympy.Basic, int, float)):
        return np.broadcast_to(evaluate(parse(value, ["t"]), {"t": times}), times.shape)
    return sample_input(name, value, times)


def inputs_in(run: Trajectory, equations: Mapping[str, sympy.Expr]) -> dict[str, np.ndarray]:
    """Give the inputs, and states without an equation, at the rows of a run."""
    return {
        name: run.columns[:, run.names.index(name)]
        for name in arguments_of(equations)
        if name in run.names
    }


def score_map(
    equations: Mapping[str, sympy.Expr], runs: Sequence[Trajectory]
) -> dict[str, dict[str, float]]:
    """Score a map on data: one step, free runs of five steps, and one over the whole data.

    ``step_rmse`` is the error of one step, ``forecast`` the median miss after five steps in units
    of the state's spread, ``trajectory_rmse`` the error of one iteration from the first row to the
    last (inf when it diverges).

    Parameters
    ----------
    equations : state -> its next value.
    runs : the data.

    >>> doubling = Trajectory(np.arange(6.0), 2.0 ** np.arange(6)[:, None], ("x",))
    >>> score_map({"x": 2 * sympy.Symbol("x")}, [doubling])["x"]["step_rmse"]
    0.0
    """
    starts = [run.select(slice(i, None)) for run in runs for i in _starts(run)]
    short = [_free_run(equations, s.select(slice(0, VERDICT.steps + 1)))[-1] for s in starts]
    whole = [_free_run(equations, run) for run in runs]
    scores = {}
    for place, (state, expr) in enumerate(equations.items()):
        samples = pair_rows(runs, state)
        truth = np.concatenate([run.x[:, run.index(state)] for run in runs])
        spread = float(np.std(truth)) or 1.0
        misses = [
            abs(found[place] - s.x[min(VERDICT.steps, len(s) - 1), s.index(state)])
            for found, s in zip(short, starts, strict=True)
        ]
        scores[state] = {
            "step_rmse": rmse(evaluate(expr, samples.timed), samples.y),
            "forecast": float(np.median(np.nan_to_num(misses, nan=np.inf))) / spread,
            "trajectory_rmse": rmse(np.concatenate([w[:, place] for w in whole]), truth),
        }
    return scores


def _starts(run: Trajectory) -> range:
    return range(0, max(len(run) - VERDICT.steps, 1), max(1, len(run) // ENOUGH_ROWS))


def _free_run(equations: Mapping[str, sympy.Expr], run: Trajectory) -> np.ndarray:
    """Iterate over a run; rows of NaN where that diverges."""
    start = [run.x[0, run.index(state)] for state in equations]
    try:
        return iterate(equations, start, run.t, inputs_in(run, equations)).x
    except EngineError:
        return np.full((len(run), len(equations)), np.nan)


def write_map_latex(equations: Mapping[str, sympy.Expr], first: Collection[str] = ()) -> str:
    r"""Write a map as a LaTeX ``aligned`` block, names that come ``first`` before the others.

    >>> print(write_map_latex({"x": 2 * sympy.Symbol("x")}))
    \begin{aligned}
    {x}_{n+1} &= 2 x
    \end{aligned}
    """
    rows = [
        f"{{{to_latex_formula(sympy.Symbol(s))}}}_{{n+1}} &= {to_latex_formula(e, first)}"
        for s, e in equations.items()
    ]
    return "\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}"


def write_map_mathml(expr: sympy.Expr, state: str) -> str:
    """Write the equation of a state of a map as MathML.

    >>> write_map_mathml(sympy.Symbol("y"), "x")
    '<math><msub><mi>x</mi><mrow><mi>n</mi><mo>+</mo><mn>1</mn></mrow></msub><mo>=</mo></math> ...'
    """
    name = to_mathml(sympy.Symbol(state)).removeprefix("<math>").removesuffix("</math>")
    following = "<mrow><mi>n</mi><mo>+</mo><mn>1</mn></mrow>"
    return f"<math><msub>{name}{following}</msub><mo>=</mo></math> {to_mathml(expr)}"
