"""Found equations in torch: with trainable constants, or a network for their residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
import torch

from dynsr.data import Samples, Trajectory, carry, choose_samples, robust_scale
from dynsr.engines import Drive, Motion, follow
from dynsr.errors import InputError
from dynsr.expression import (
    arguments_of,
    call_names,
    compile_scalar,
    evaluate,
    free_constants,
    take_inputs,
    to_text,
    with_signs,
)
from dynsr.fit import ParetoFront
from dynsr.methods import AbstractMethod, make_method
from dynsr.verdict import ABSTOL, RELTOL, Measured


class EquationModule(torch.nn.Module):
    """dx/dt of a system: ``module(t, state, inputs...)`` with state (..., k) gives (..., k).

    Every float is a parameter (float64, trainable); whole numbers and fractions are structure.
    """

    def __init__(self, equations: Mapping[str, sympy.Expr]) -> None:
        """Compile the equations; their floats become ``constants``."""
        super().__init__()
        self.states = tuple(equations)
        self.inputs = arguments_of(equations)
        self._calls = call_names(equations)
        symbols: list[sympy.Symbol] = []
        values: list[float] = []
        self._templates = []
        for state, expr in equations.items():
            template, found = free_constants(with_signs(expr), f"constant_{state}_")
            symbols += found
            values += found.values()
            self._templates.append(template)
        self._symbols = symbols
        self.constants = torch.nn.Parameter(torch.tensor(values, dtype=torch.float64))
        names = [sympy.Symbol(n) for n in (*self.states, "t", *self.inputs)]
        # A state may have the name of what the function calls.
        own = {symbol: sympy.Dummy(f"own{i}") for i, symbol in enumerate((*names, *symbols))}
        templates = [_with_plain_numbers(t).xreplace(own) for t in self._templates]
        functions = [{"sign": torch.sign, "Abs": torch.abs}, "torch"]
        self._function = sympy.lambdify([*own.values()], templates, functions, cse=True)

    def forward(
        self,
        t: torch.Tensor | float,
        state: torch.Tensor,
        *given: torch.Tensor | float | Callable[..., Any],
        **inputs: torch.Tensor | float | Callable[..., Any],
    ) -> torch.Tensor:
        """Give dx/dt, (..., k) in state units a unit of time.

        Parameters
        ----------
        t : the time, or times (...,).
        state : (..., k) states.
        given, inputs : each input by its place, in the order of the alphabet, or by name: (...,)
            values, or a function of ``t`` that gives them.

        Raises TypeError when an input is missing.
        """
        columns = list(state.unbind(-1))
        values = take_inputs(self._calls, t, given, inputs)
        tensors = [torch.as_tensor(value, dtype=state.dtype) for value in (t, *values)]
        found = self._function(*columns, *tensors, *self.constants)
        rows = [torch.as_tensor(f, dtype=state.dtype).expand_as(columns[0]) for f in found]
        return torch.stack(rows, dim=-1)

    def equations(self) -> dict[str, str]:
        """Every state with its right-hand side, the present constants put in."""
        values = [sympy.Float(v) for v in self.constants.tolist()]
        put = dict(zip(self._symbols, values, strict=True))
        return {
            s: to_text(e.xreplace(put)) for s, e in zip(self.states, self._templates, strict=True)
        }


def _with_plain_numbers(expr: sympy.Expr) -> sympy.Expr:
    """Write a number such as the root of 3 as a float, since functions of torch take no numbers."""
    return expr.replace(lambda e: e.is_number and bool(e.args), lambda e: sympy.Float(float(e)))


@dataclass(frozen=True, eq=False)
class Residual:
    """A network g with y - f(X) = g(X) + error, for one state.

    ``share`` is the share of the slopes' variance (robust) that the network carries: the drop in
    mean squared, clipped misses on rows it was not trained on. ``freedom`` is the degrees of
    freedom of the fitted Student-t error: small for heavy tails, large for nearly Gaussian.
    """

    state: str
    network: torch.nn.Module
    centre: np.ndarray
    scale: np.ndarray
    unit: float
    share: float
    freedom: float

    def evaluate(self, X: np.ndarray) -> np.ndarray:
        """(n,) slopes in state units per second for (n, p) columns."""
        inside = torch.from_numpy((np.asarray(X, dtype=float) - self.centre) / self.scale)
        with torch.no_grad():
            return self.unit * self.network(inside)[:, 0].numpy()


@dataclass(frozen=True, eq=False)
class HybridModel:
    """Equations plus networks: dx/dt = f(x) + g(x)."""

    equations: Mapping[str, sympy.Expr]
    trajectories: Sequence[Trajectory]
    inputs: Mapping[str, sympy.Expr]
    residuals: Mapping[str, Residual]

    @property
    def shares(self) -> dict[str, float]:
        """State -> share of the slopes' variance that the network carries, 0 to 1."""
        return {state: residual.share for state, residual in self.residuals.items()}

    def slopes(self, X: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        """Give dx/dt of every state for (n, p) columns of the data at (n,) times."""
        names = self.trajectories[0].names
        columns = {**{name: X[:, i] for i, name in enumerate(names)}, "t": t}
        return {
            state: evaluate(expr, columns) + self.residuals[state].evaluate(X)
            for state, expr in self.equations.items()
        }

    def simulate(
        self,
        x0: Sequence[float] | np.ndarray | None = None,
        t: Sequence[float] | np.ndarray | None = None,
    ) -> Trajectory:
        """Integrate equations and networks, by default over the first trajectory.

        The embedded engine does, adaptively, since a network does not cross the seam. Inputs are
        those of the first trajectory, between its rows as that says; no step passes over one.

        Parameters
        ----------
        x0 : (k,) start states in the order of the data.
        t : (n,) increasing times in seconds.

        Raises InputError when an equation is missing or a time lies beyond the measured inputs, and
        EngineError, with time and state, where the solution ends before the last time.
        """
        (run,) = carry(self.trajectories[:1])
        times = run.t if t is None else np.asarray(t, dtype=float)
        order = [run.index(state) for state in self.equations]
        start = run.x[0] if x0 is None else np.asarray(x0, dtype=float)
        measured = [name for name in run.input_names if name not in self.inputs]
        motion = Motion(
            "the model",
            run.states,
            self._field(run, order, measured),
            run.t if run.input_names else np.empty(0),
            tuple(self._drive(run, name, times) for name in measured),
        )
        found, how = follow(motion, start, times, RELTOL, ABSTOL)
        return Trajectory(times, found, run.states, origin={"engine": f"embedded ({how})"})

    def _field(
        self, run: Trajectory, order: Sequence[int], measured: Sequence[str]
    ) -> Callable[..., list[float]]:
        missing = [s for s in run.states if s not in self.equations]
        if missing:
            raise InputError(f"the equation of {missing[0]!r} is missing; discover all states")
        exact = compile_scalar(list(self.equations.values()), [*run.names, "t"])
        known = [name for name in run.input_names if name in self.inputs]
        given = compile_scalar([self.inputs[name] for name in known], ["t"])
        names, count = [*measured, *known], len(run.states)
        places = [names.index(name) for name in run.input_names]

        def slopes(*at: float) -> list[float]:
            values = [*at[count:-1], *given(at[-1])]
            row = [*at[:count], *[values[place] for place in places]]
            columns, found = np.array(row)[None], [0.0] * len(order)
            for state, place, slope in zip(self.equations, order, exact(*row, at[-1]), strict=True):
                found[place] = slope + float(self.residuals[state].evaluate(columns)[0])
            return found

        return slopes

    def _drive(self, run: Trajectory, name: str, times: np.ndarray) -> Drive:
        """Give a measured input as pieces."""
        measured = Measured(name, run.t, run.by_name[name], run.held(name))
        measured.check_covers(times)
        return measured.drive

    def residual_samples(self, state: str) -> Samples:
        """Give the residuals of a state's slopes as the network sees them, without the noise.

        A symbolic search on these says what the network has learned.
        """
        samples = choose_samples(list(self.trajectories), state)
        learned = self.residuals[state].evaluate(samples.X)
        return Samples(
            samples.X, learned, samples.names, state, "network", samples.t, samples.noise
        )

    def explain(
        self, state: str, method: AbstractMethod | None = None, seed: int = 0
    ) -> ParetoFront:
        """Search a formula for what the network of a state carries.

        Parameters
        ----------
        state : whose equation the network completes.
        method : what searches; sums and ratios of short features by default.
        seed : all chance comes from it.
        """
        chosen = method or make_method("rational", "quick")
        return chosen.search(self.residual_samples(state), np.random.default_rng(seed))


def fit_hybrid(
    equations: Mapping[str, sympy.Expr],
    trajectories: Sequence[Trajectory],
    inputs: Mapping[str, sympy.Expr],
    *,
    width: int = 32,
    epochs: int = 400,
    rate: float = 0.01,
    seed: int = 0,
) -> HybridModel:
    """Train one network a state on the residuals: slopes of the data less those of the equation.

    The likelihood is Student's t with fitted scale and degrees of freedom, so that a few wild
    slopes do not decide. Every fifth block of rows is kept out to choose the best epoch and to
    measure the share.

    Parameters
    ----------
    equations : state -> right-hand side.
    trajectories : the data that they were found in.
    inputs : input name -> expression in ``t`` where it is known.
    width : neurons in each of the two hidden layers.
    epochs : passes over the samples by Adam, its rate falling along a cosine.
    rate : rate at the start.
    seed : all chance comes from it.

    Raises InputError when the data are not there.
    """
    if not trajectories:
        raise InputError("the data are not here; discover again before asking for a hybrid")
    residuals = {}
    for state, expr in equations.items():
        samples = choose_samples(list(trajectories), state)
        residual = samples.y - evaluate(expr, samples.timed)
        residuals[state] = _train(samples, residual, width, epochs, rate, seed)
    return HybridModel(equations, trajectories, inputs, residuals)


def _train(
    samples: Samples, residual: np.ndarray, width: int, epochs: int, rate: float, seed: int
) -> Residual:
    centre, scale = samples.X.mean(axis=0), samples.X.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    unit = float(robust_scale(residual)) or 1.0
    kept_out = (np.arange(len(residual)) * 25 // len(residual)) % 5 == 2
    X = torch.from_numpy((samples.X - centre) / scale)
    y = torch.from_numpy(residual / unit)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = _network(X.shape[1], width)
        freedom = _descend(network, X, y, torch.from_numpy(kept_out), epochs, rate)
    with torch.no_grad():
        predicted = unit * network(X)[:, 0].numpy()
    share = _share(samples.y[kept_out], residual[kept_out], predicted[kept_out])
    return Residual(samples.target, network, centre, scale, unit, share, freedom)


def _network(inputs: int, width: int) -> torch.nn.Sequential:
    last = torch.nn.Linear(width, 1)
    # It begins as zero: nothing is added that the data do not ask for.
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    layers = [torch.nn.Linear(inputs, width), torch.nn.Tanh()]
    return torch.nn.Sequential(
        *layers, torch.nn.Linear(width, width), torch.nn.Tanh(), last
    ).double()


def _descend(
    network: torch.nn.Sequential,
    X: torch.Tensor,
    y: torch.Tensor,
    out: torch.Tensor,
    epochs: int,
    rate: float,
) -> float:
    """Maximise the likelihood; the weights of the best epoch on the rows kept out stay."""
    shape = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([*network.parameters(), shape], lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    best, weights = np.inf, {k: v.clone() for k, v in network.state_dict().items()}
    for _ in range(epochs):
        optimiser.zero_grad()
        losses = _student(y - network(X)[:, 0], shape)
        held = float(losses[out].mean().detach())
        if held < best:
            best, weights = held, {k: v.clone() for k, v in network.state_dict().items()}
        losses[~out].mean().backward()
        optimiser.step()
        schedule.step()
    network.load_state_dict(weights)
    return float(1 + torch.exp(shape[1].detach()))


def _student(misses: torch.Tensor, shape: torch.Tensor) -> torch.Tensor:
    """Negative log likelihood of Student's t; scale exp(shape[0]), freedom 1 + exp(shape[1])."""
    scale, freedom = torch.exp(shape[0]), 1 + torch.exp(shape[1])
    constant = torch.lgamma(freedom / 2) - torch.lgamma((freedom + 1) / 2)
    constant = constant + 0.5 * torch.log(freedom * torch.pi) + shape[0]
    return constant + (freedom + 1) / 2 * torch.log1p((misses / scale) ** 2 / freedom)


def _share(y: np.ndarray, residual: np.ndarray, predicted: np.ndarray) -> float:
    """Share of the slopes' variance that the network explains on rows kept out."""
    size = float(np.mean((y - y.mean()) ** 2)) or 1.0
    bound = 5 * float(robust_scale(residual)) or np.inf
    before = np.mean(np.minimum(residual**2, bound**2))
    after = np.mean(np.minimum((residual - predicted) ** 2, bound**2))
    return float(np.clip((before - after) / size, 0.0, 1.0))
