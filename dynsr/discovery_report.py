"""The report of one discovery: a single HTML page that needs no network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from dynsr.derivatives import choose_samples
from dynsr.errors import DynsrError
from dynsr.exports import shown
from dynsr.expression import evaluate
from dynsr.found import Discovery
from dynsr.methods.constants import free_constants
from dynsr.methods.variation import loosen
from dynsr.plots import draw_phase_portrait, draw_residuals, draw_states, to_data_uri
from dynsr.prediction import predict
from dynsr.report import Picture, render_page
from dynsr.trajectory import Trajectory

_MOST_RUNS = 3
_MOST_ROWS = 2000
_DRAWS = 20


def write_report(found: Discovery, path: Path) -> Path:
    """Write the page; gives its path. Raises InputError when it cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(render_discovery(found), "utf-8")
    return path


def render_discovery(found: Discovery) -> str:
    """Give the page: equations, reasons, interactive fronts, trajectories, residuals, phases.

    Pictures need the data, which a loaded discovery does not have; the rest is always there.
    """
    return render_page(
        "discovery.html.j2",
        equations=[_equation(found, state) for state in found.equations],
        latex=found.latex(),
        fronts={state: _front(found, state) for state in found.equations},
        pictures=list(_pictures(found)),
        scores=_scores(found),
        exports=[("Python", found.to_python()), ("Julia", found.to_julia())],
        facts=_facts(found),
    )


def _equation(found: Discovery, state: str) -> dict[str, Any]:
    expr = found.equations[state]
    return {
        "state": state,
        "text": f"{state}' = {shown(expr)}",
        "mathml": to_mathml(state, expr),
        "why": found.explanation.get(state, ""),
        "constants": [f"{v:.6g} ± {e:.2g}" for v, e in found.errors.get(state, ())],
    }


class _MathML(MathMLPresentationPrinter):
    def _print_Float(self, expr: sympy.Float) -> Any:  # noqa: N802 (SymPy's protocol)
        number = self.dom.createElement("mn")
        number.appendChild(self.dom.createTextNode(f"{float(expr):.6g}"))
        return number


def to_mathml(state: str, expr: sympy.Expr) -> str:
    """Write one equation as MathML, which browsers show without any script.

    >>> "<mfrac>" in to_mathml("x", 1 / sympy.Symbol("x"))
    True
    """
    printer = _MathML()
    left = printer.doprint(sympy.Symbol(state))
    return (
        f'<math display="block"><mover accent="true">{left}<mo>˙</mo></mover>'
        f"<mo>=</mo><mrow>{printer.doprint(expr)}</mrow></math>"
    )


def _front(found: Discovery, state: str) -> dict[str, Any]:
    chosen = found.equations[state]
    points = [
        {
            "bits": round(c.complexity, 2),
            # A loss of 0 has no logarithm.
            "loss": max(c.loss, 1e-16),
            "text": shown(c.expr),
            "source": c.source,
        }
        for c in found.front[state]
    ]
    return {"points": points, "chosen": shown(chosen)}


def _pictures(found: Discovery) -> Iterator[Picture]:
    for number, run in enumerate(found.trajectories[:_MOST_RUNS], 1):
        thin = run.select(slice(None, None, max(1, len(run) // _MOST_ROWS)))
        model = _simulate(found, thin)
        name = f"Trajectory {number}" if len(found.trajectories) > 1 else "Trajectory"
        yield Picture(
            to_data_uri(draw_states(thin, model, _bands(found, thin) if model else None)),
            f"{name}: the data, and the equations integrated from their first row; the band "
            "holds 95 % of the curves that constants drawn within their errors give.",
        )
        if len(run.states) > 1:
            yield Picture(
                to_data_uri(draw_phase_portrait(thin, model, *run.states[:2])),
                f"{name}: {run.states[1]} against {run.states[0]}.",
            )
    for state, expr in found.equations.items() if found.trajectories else ():
        samples = choose_samples(list(found.trajectories), state)
        predicted = evaluate(expr, {**samples.columns, "t": samples.t})
        yield Picture(
            to_data_uri(draw_residuals(samples, predicted)),
            f"What the equation of {state} leaves of its slopes ({samples.scheme}).",
        )


def _simulate(found: Discovery, run: Trajectory) -> Trajectory | None:
    """Integrate from the run's first row; None where the equations diverge or need more states."""
    if set(found.equations) != set(run.states):
        return None
    start = [run.x[0, run.index(state)] for state in found.equations]
    try:
        return predict(found.equations, start, run.t, found.inputs_at(run.t, run))
    except DynsrError:
        return None


def _bands(found: Discovery, run: Trajectory) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Give for each state the 2.5 % and 97.5 % quantiles over drawn constants."""
    rng = np.random.default_rng(0)
    start = [run.x[0, run.index(state)] for state in found.equations]
    inputs = found.inputs_at(run.t, run)
    curves = []
    for _ in range(_DRAWS):
        drawn = {s: _draw(e, found.errors.get(s, ()), rng) for s, e in found.equations.items()}
        try:
            curves.append(predict(drawn, start, run.t, inputs).x)
        except DynsrError:
            continue
    if len(curves) < _DRAWS // 2:
        return {}
    low, high = np.quantile(np.array(curves), [0.025, 0.975], axis=0)
    return {s: (low[:, i], high[:, i]) for i, s in enumerate(found.equations)}


def _draw(
    expr: sympy.Expr, errors: tuple[tuple[float, float], ...], rng: np.random.Generator
) -> sympy.Expr:
    """Move every constant by its own error; one without an error stays."""
    template, values = free_constants(loosen(expr), "constant ")
    moved = {}
    for symbol, value in values.items():
        nearest = min(errors, key=lambda pair: abs(pair[0] - value), default=(value, 0.0))
        error = nearest[1] if np.isfinite(nearest[1]) else 0.0
        moved[symbol] = sympy.Float(value + error * rng.standard_normal())
    return template.xreplace(moved)


def _scores(found: Discovery) -> list[tuple[str, str]]:
    if not found.trajectories:
        return []
    return [
        (
            state,
            f"slopes off by {s['slope_rmse']:.3g}, forecasts by {s['forecast']:.2g} of the "
            f"spread, the whole trajectory by {s['trajectory_rmse']:.3g}",
        )
        for state, s in found.score().items()
    ]


def _facts(found: Discovery) -> list[tuple[str, str]]:
    facts = [(name, _read(value)) for name, value in found.settings.items()]
    rows = sum(len(run) for run in found.trajectories)
    if rows:
        facts.append(("data", f"{rows} rows in {len(found.trajectories)} trajectories"))
    return [*facts, ("seconds", f"{found.seconds:.1f}")]


def _read(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}: {v}" for k, v in value.items())
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
