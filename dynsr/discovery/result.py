"""Found: what a discovery gives back, to read, simulate, score, export and keep."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from dynsr.data import Trajectory, choose_samples, take_trajectories
from dynsr.discovery.prediction import predict
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, find_engine
from dynsr.errors import DynsrError, InputError, need
from dynsr.expression import (
    arguments_of,
    evaluate,
    parse,
    shown,
    to_julia,
    to_latex,
    to_mathml,
    to_numpy,
    to_python,
    to_text,
    to_text_block,
)
from dynsr.fit import Candidate, ParetoFront, rmse
from dynsr.jobs import from_plain, write_json
from dynsr.selection import forecast_miss

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table as RichTable

    from dynsr.discovery.hybrid import EquationModule, HybridModel

_FORMAT = "dynsr discovery 1"


@dataclass(frozen=True, eq=False, repr=False)
class Discovery:
    """The equations found for the states of a system, with everything that led to them.

    Parameters
    ----------
    equations : state -> right-hand side, state units per second.
    errors : state -> (value, standard error) of its constants in order.
    front : state -> all formulas found, from simple to accurate.
    explanation : state -> why this equation was chosen, in words.
    trajectories : the data; empty where they are not there.
    inputs : input name -> expression in ``t`` where it is known.
    settings : how it was found: methods, preset, seed, scheme, engines, and every setting.
    seconds : wall time.
    complete : False when Ctrl-C ended the searches and these are the best formulas so far.
    engine : what integrates the equations.

    >>> x = sympy.Symbol("x")
    >>> Discovery({"x": -2 * x}, {"x": ()}, {}, {}).simulate([1.0], [0.0, 1.0]).x[-1].round(4)
    array([0.1353])
    """

    equations: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    front: dict[str, ParetoFront]
    explanation: dict[str, str]
    trajectories: tuple[Trajectory, ...] = ()
    inputs: Mapping[str, sympy.Expr] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    complete: bool = True
    engine: str | AbstractEngine = DEFAULT_ENGINE

    def simulate(
        self,
        x0: Sequence[float] | np.ndarray | None = None,
        t: Sequence[float] | np.ndarray | None = None,
        inputs: Mapping[str, Any] | None = None,
        engine: str | AbstractEngine | None = None,
    ) -> Trajectory:
        """Integrate the equations; by default from the start and at the times of the data.

        Parameters
        ----------
        x0 : (k,) start states in the order of the equations.
        t : (n,) increasing times in seconds.
        inputs : name -> expression in ``t``, or (n,) values at the times; by default those of the
            data.
        engine : "embedded", "julia" or an engine; the discovery's own by default.

        Raises InputError when something is missing, EngineUnavailable when the engine is absent,
        EngineError when the solution diverges.
        """
        if (x0 is None or t is None) and not self.trajectories:
            raise InputError("the data are not here; give x0 and t")
        times = self.trajectories[0].t if t is None else np.asarray(t, dtype=float)
        if x0 is None:
            x0 = self.trajectories[0].select(slice(0, 1)).x[0][self._positions()]
        given = {**self.inputs_at(times), **(inputs or {})}
        return predict(self.equations, x0, times, given, engine or self.engine)

    def _positions(self) -> list[int]:
        return [self.trajectories[0].index(state) for state in self.equations]

    def inputs_at(self, times: np.ndarray, run: Trajectory | None = None) -> dict[str, Any]:
        """Inputs at (n,) ``times`` in seconds, as they were in a ``run``, by default the first.

        States without an equation are read from there too.
        """
        given: dict[str, Any] = dict(self.inputs)
        source = run or (self.trajectories[0] if self.trajectories else None)
        for name in arguments_of(self.equations):
            if name not in given and source is not None and name in source.names:
                column = source.columns[:, source.names.index(name)]
                given[name] = np.interp(times, source.t, column)
        return given

    def score(
        self, data: Any = None, engine: str | AbstractEngine | None = None
    ) -> dict[str, dict[str, float]]:
        """Score on data (the data of the discovery by default), state by state.

        ``slope_rmse`` is the error of the right-hand side against the chosen slopes,
        ``forecast`` the median miss of forecasts over 50 rows in units of the state's spread,
        ``trajectory_rmse`` the error of one integration from the first row to the last (inf when
        it diverges).

        Parameters
        ----------
        data : what :func:`dynsr.discover` takes.
        engine : what integrates the whole trajectories; the discovery's own by default. The many
            short forecasts are integrated by the embedded one.

        Raises InputError when there are no data, EngineUnavailable when the engine is absent.
        """
        chosen = find_engine(engine or self.engine)
        runs = list(self.trajectories) if data is None else take_trajectories(data, self.inputs)[0]
        if not runs:
            raise InputError("the data are not here; give some to score on")
        whole = [self._whole(run, chosen) for run in runs]
        scores = {}
        for state, expr in self.equations.items():
            samples = choose_samples(runs, state)
            truth = np.concatenate([run.x[:, run.index(state)] for run in runs])
            position = list(self.equations).index(state)
            scores[state] = {
                "slope_rmse": rmse(evaluate(expr, _with_time(samples)), samples.y),
                "forecast": forecast_miss({state: expr}, runs, inputs=self.inputs),
                "trajectory_rmse": rmse(np.concatenate([w[:, position] for w in whole]), truth),
            }
        return scores

    def _whole(self, run: Trajectory, engine: AbstractEngine) -> np.ndarray:
        start = [run.x[0, run.index(state)] for state in self.equations]
        try:
            return predict(self.equations, start, run.t, self.inputs_at(run.t, run), engine).x
        except DynsrError:
            return np.full((len(run), len(self.equations)), np.nan)

    def latex(self) -> str:
        """Write the equations as LaTeX."""
        return to_latex(self.equations)

    def to_python(self) -> str:
        """Write the equations as a Python function for ``scipy.integrate.solve_ivp``."""
        return to_python(self.equations)

    def to_numpy(self) -> Callable[..., np.ndarray]:
        """Give the right-hand side as a function of arrays."""
        return to_numpy(self.equations)

    def to_julia(self) -> str:
        """Write the equations as a Julia function for DifferentialEquations.jl."""
        return to_julia(self.equations)

    def to_torch(self) -> EquationModule:
        """Give the right-hand side as a torch module whose constants can be trained.

        Raises MissingExtra when torch is not installed.
        """
        need("torch", "torch", "a torch module")
        from dynsr.discovery.hybrid import EquationModule

        return EquationModule(self.equations)

    def hybrid(
        self, *, width: int = 32, epochs: int = 400, rate: float = 0.01, seed: int = 0
    ) -> HybridModel:
        """Train networks on the residuals of the slopes.

        Parameters
        ----------
        width, epochs, rate, seed : neurons in each hidden layer, passes over the samples, rate of
            Adam at the start, and what all chance comes from.

        Raises InputError when the data are not there, MissingExtra when torch is not installed.
        """
        need("torch", "torch", "a hybrid model")
        from dynsr.discovery.hybrid import fit_hybrid

        return fit_hybrid(
            self.equations,
            self.trajectories,
            self.inputs,
            width=width,
            epochs=epochs,
            rate=rate,
            seed=seed,
        )

    def plot(self) -> Figure:
        """Draw the data and the equations integrated from their start; gives the figure."""
        from dynsr.report import draw_states

        if not self.trajectories:
            raise InputError("the data are not here; discover again before plotting")
        return draw_states(self.trajectories[0], self.simulate())

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML page to ``path``; gives the path."""
        from dynsr.report import write_report

        return write_report(self, Path(path))

    def save(self, path: str | Path) -> Path:
        """Write everything but the data as JSON, whole or not at all; gives the path."""
        write_json(Path(path), self.as_record())
        return Path(path)

    def as_record(self) -> dict[str, Any]:
        """Give everything but the data as plain values."""
        return {
            "format": _FORMAT,
            "equations": {s: to_text(e) for s, e in self.equations.items()},
            "errors": {s: [list(pair) for pair in pairs] for s, pairs in self.errors.items()},
            "front": {
                s: [[to_text(c.expr), c.loss, c.complexity, c.source] for c in front]
                for s, front in self.front.items()
            },
            "explanation": dict(self.explanation),
            "inputs": {name: to_text(e) for name, e in self.inputs.items()},
            "settings": dict(self.settings),
            "seconds": self.seconds,
            "complete": self.complete,
        }

    @classmethod
    def load(cls, path: str | Path) -> Discovery:
        """Read a discovery from the JSON file at ``path``; nothing in it is ever run.

        Raises InputError when there is no such file or it holds something else.
        """
        try:
            record = json.loads(Path(path).read_text("utf-8"))
        except OSError as error:
            raise InputError(f"cannot read {str(path)!r} ({error.strerror}); name a file") from None
        except (ValueError, RecursionError):
            raise InputError(f"{str(path)!r} is no whole JSON file; save it again") from None
        if not isinstance(record, dict) or record.get("format") != _FORMAT:
            raise InputError(f"{str(path)!r} is no saved discovery; give one that save() wrote")
        try:
            return cls(
                equations={s: parse(e) for s, e in record["equations"].items()},
                errors=from_plain(dict[str, tuple[tuple[float, ...], ...]], record["errors"]),
                front={
                    s: ParetoFront(Candidate(parse(e), *rest) for e, *rest in front)
                    for s, front in record["front"].items()
                },
                explanation=dict(record["explanation"]),
                inputs={name: parse(e, ["t"]) for name, e in record["inputs"].items()},
                settings=dict(record["settings"]),
                seconds=float(record["seconds"]),
                complete=bool(record.get("complete", True)),
                engine=str(record["settings"].get("engine", DEFAULT_ENGINE)),
            )
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{str(path)!r} lacks parts of a discovery; save it again") from None

    def __repr__(self) -> str:
        """Write the equations, one a line."""
        return to_text_block(self.equations)

    def _repr_latex_(self) -> str:
        return f"$$\n{self.latex()}\n$$"

    def _repr_html_(self) -> str:
        rows = "".join(
            f'<tr><td style="text-align:left">{to_mathml(e, s)}'
            f"<br><code>{escape(s)}' = {escape(shown(e))}</code></td>"
            f'<td style="text-align:left">{escape(self.explanation.get(s, ""))}</td></tr>'
            for s, e in self.equations.items()
        )
        return f"<table><tr><th>equation</th><th>why this one</th></tr>{rows}</table>"

    def __rich__(self) -> RichTable:
        """Give a table for rich terminals."""
        from rich.table import Table
        from rich.text import Text

        table = Table("state", "equation", "why", title="Equations found", show_lines=True)
        for state, expr in self.equations.items():
            why = Text(self.explanation.get(state, ""), style="dim")
            table.add_row(Text(f"{state}'"), Text(shown(expr), style="bold"), why)
        return table


def _with_time(samples: Any) -> dict[str, np.ndarray]:
    return {**samples.columns, "t": samples.t}
