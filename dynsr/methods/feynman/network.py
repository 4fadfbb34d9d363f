"""The interpolating network: the only file that names torch."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch

from dynsr.data import Samples
from dynsr.methods.feynman.stages.base import NetworkSettings
from dynsr.methods.feynman.stages.polynomial import standard_coordinates


@dataclass(frozen=True, eq=False)
class Network:
    """A smooth function through samples, with its gradient.

    ``validation_error`` is its RMSE, in units of y, on the rows that training did not see;
    ``epochs`` how many passes over the rows training took.
    """

    module: torch.nn.Module
    centre: np.ndarray
    scale: np.ndarray
    offset: float
    spread: float
    validation_error: float
    epochs: int

    def predict(self, X: np.ndarray) -> np.ndarray:
        """(n,) values at the n rows of ``X``."""
        with _one_thread(), torch.no_grad():
            out = self.module(self._inputs(X))[:, 0]
        return self.offset + self.spread * out.double().cpu().numpy()

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """(n, p) derivatives by each of the p variables at the n rows of ``X``."""
        inputs = self._inputs(X).requires_grad_(True)
        with _one_thread():
            (slopes,) = torch.autograd.grad(self.module(inputs).sum(), inputs)
        return slopes.double().cpu().numpy() * self.spread / self.scale

    def _inputs(self, X: np.ndarray) -> torch.Tensor:
        first = next(self.module.parameters())
        return torch.as_tensor((X - self.centre) / self.scale, dtype=first.dtype).to(first.device)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Sums of one thread do not depend on how many cores the machine has."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit_network(
    samples: Samples,
    rng: np.random.Generator,
    epochs: int = 500,
    settings: NetworkSettings | None = None,
) -> Network:
    """Train p-128-128-64-64-1 tanh units on samples (Udrescu et al. 2020).

    Inputs and target are standardised. The first half of the ``epochs`` (the paper: 500) goes to
    Adam in batches with a rate that rises and falls once, the second to L-BFGS on all rows at
    once, which ends early when the rows set aside for validation get worse. float64 on a CPU,
    float32 on a GPU where torch finds one. The weights of least validation error are kept.
    """
    settings = settings or NetworkSettings()
    gpu = torch.cuda.is_available()
    device, dtype = ("cuda", torch.float32) if gpu else ("cpu", torch.float64)
    centre, scale = standard_coordinates(samples.X)
    offset, spread = float(np.mean(samples.y)), float(np.std(samples.y)) or 1.0
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    module = _build(samples.X.shape[1], settings.hidden, generator).to(device, dtype)
    inputs = torch.as_tensor((samples.X - centre) / scale, dtype=dtype).to(device)
    target = torch.as_tensor((samples.y - offset) / spread, dtype=dtype).to(device)[:, None]
    order = torch.randperm(len(samples), generator=generator).to(device)
    held = max(1, int(settings.validation * len(samples)))
    training = _Training(module, inputs, target, order[held:], order[:held], generator)
    with _one_thread():
        training.descend(epochs // 2, settings.batch, settings.peak_rate)
        training.polish(epochs - epochs // 2)
    module.load_state_dict(training.best_weights)
    error = spread * training.best_error
    return Network(module, centre, scale, offset, spread, error, training.epochs)


def _build(
    variables: int, hidden: tuple[int, ...], generator: torch.Generator
) -> torch.nn.Sequential:
    layers: list[torch.nn.Module] = []
    widths = (variables, *hidden, 1)
    for a, b in itertools.pairwise(widths):
        layer = torch.nn.Linear(a, b, dtype=torch.float64)
        with torch.no_grad():
            torch.nn.init.xavier_uniform_(layer.weight, generator=generator)
            layer.bias.uniform_(-0.1, 0.1, generator=generator)
        layers += [layer, torch.nn.Tanh()]
    return torch.nn.Sequential(*layers[:-1])


class _Training:
    """Weights on their way, and the best of them on the rows set aside."""

    def __init__(
        self,
        module: torch.nn.Module,
        inputs: torch.Tensor,
        target: torch.Tensor,
        rows: torch.Tensor,
        held: torch.Tensor,
        generator: torch.Generator,
    ) -> None:
        self.module, self.generator = module, generator
        self.inputs, self.target = inputs[rows], target[rows]
        self.held_inputs, self.held_target = inputs[held], target[held]
        self.epochs = 0
        self.best_error = float("inf")
        self.best_weights = copy.deepcopy(module.state_dict())

    def loss(self, rows: torch.Tensor | slice = slice(None)) -> torch.Tensor:
        return torch.mean((self.module(self.inputs[rows]) - self.target[rows]) ** 2)

    def check(self) -> float:
        """Error on the rows set aside; the weights are kept when it is the least so far."""
        with torch.no_grad():
            miss = self.module(self.held_inputs) - self.held_target
            error = float(torch.sqrt(torch.mean(miss**2)))
        if error < self.best_error:
            self.best_error = error
            self.best_weights = copy.deepcopy(self.module.state_dict())
        return error

    def descend(self, epochs: int, batch: int, peak_rate: float) -> None:
        """Adam, one cycle of the learning rate."""
        count = len(self.inputs)
        batches = max(1, count // batch)
        adam = torch.optim.Adam(self.module.parameters(), lr=peak_rate)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            adam, peak_rate, total_steps=max(2, epochs * batches), final_div_factor=1e3
        )
        for _ in range(epochs):
            order = torch.randperm(count, generator=self.generator).to(self.inputs.device)
            for rows in torch.chunk(order, batches):
                adam.zero_grad()
                self.loss(rows).backward()
                adam.step()
                schedule.step()
            self.epochs += 1
            self.check()

    def polish(self, epochs: int, block: int = 10, patience: int = 5) -> None:
        """L-BFGS in blocks; ends after ``patience`` blocks that did not help the held rows."""
        solver = torch.optim.LBFGS(
            self.module.parameters(),
            max_iter=block,
            max_eval=block,
            history_size=30,
            tolerance_grad=0.0,
            tolerance_change=0.0,
            line_search_fn="strong_wolfe",
        )

        def closure() -> torch.Tensor:
            solver.zero_grad()
            loss = self.loss()
            loss.backward()
            return loss

        stale = 0
        for _ in range(epochs // block):
            solver.step(closure)
            self.epochs += block
            before = self.best_error
            stale = 0 if self.check() < 0.999 * before else stale + 1
            if stale >= patience:
                break
