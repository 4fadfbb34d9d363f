"""The interpolating network: the only file that names torch."""

from __future__ import annotations

import itertools
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import unwrap

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

    layers: _Layers
    centre: np.ndarray
    scale: np.ndarray
    offset: float
    spread: float
    validation_error: float
    epochs: int

    def predict(self, X: np.ndarray) -> np.ndarray:
        """(n,) values at the n rows of ``X``."""
        with _one_thread():
            out = self.layers.values(self._inputs(X))[:, 0]
        return self.offset + self.spread * out.double().cpu().numpy()

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """(n, p) derivatives by each of the p variables at the n rows of ``X``."""
        inputs = self._inputs(X)
        with _one_thread():
            slopes = self.layers.slopes(inputs, torch.ones_like(self.layers.values(inputs)))
        return slopes.double().cpu().numpy() * self.spread / self.scale

    def write(self) -> tuple[str, float, int]:
        """Give the weights as text, the validation error and the epochs, for `read_network`."""
        weights = self.layers.weights.detach().double().cpu().numpy()
        return b64encode(weights.tobytes()).decode("ascii"), self.validation_error, self.epochs

    def _inputs(self, X: np.ndarray) -> torch.Tensor:
        weights = self.layers.weights
        return torch.as_tensor((X - self.centre) / self.scale, dtype=weights.dtype).to(
            weights.device
        )


class _Layers:
    """Linear layers with tanh between them, all weights in one vector.

    Training is thousands of small steps. One vector to descend in and one place a layer for values
    and slopes spare them the overhead of autograd, to the same last digit.

    Parameters
    ----------
    weights : every layer's matrix (units, units below) and bias (units,), from the inputs up.
    """

    def __init__(self, weights: Sequence[torch.Tensor]) -> None:
        self.weights = torch.cat([w.flatten() for w in weights])
        self.weights.grad = self.by_weights = torch.zeros_like(self.weights)
        sizes = [w.numel() for w in weights]
        self._parts, self._slopes = (
            [part.view(w.shape) for part, w in zip(vector.split(sizes), weights, strict=True)]
            for vector in (self.weights, self.by_weights)
        )
        self._values: list[torch.Tensor] = []
        self._back: list[torch.Tensor] = []

    def values(self, inputs: torch.Tensor) -> torch.Tensor:
        """(n, 1) at n rows; the next call writes over them."""
        count = len(inputs)
        if not self._values or len(self._values[0]) < count:
            biases = self._parts[1::2]
            self._values, self._back = (
                [bias.new_empty(count, len(bias)) for bias in biases] for _ in range(2)
            )
        below = inputs
        for matrix, bias, place in zip(
            self._parts[::2], self._parts[1::2], self._values, strict=True
        ):
            if below is not inputs:
                torch.tanh_(below)
            below = torch.addmm(bias, below, matrix.t(), out=place[:count])
        return below

    def slopes(self, inputs: torch.Tensor, by_value: torch.Tensor) -> torch.Tensor:
        """(n, p) derivatives by the inputs of what has the derivatives ``by_value`` (n, 1).

        Those by the weights become ``by_weights``, the gradient that optimisers see. The values
        were formed at the same inputs.
        """
        count, slopes = len(inputs), by_value
        for k in reversed(range(len(self._values))):
            below = self._values[k - 1][:count] if k else inputs
            torch.mm(slopes.t(), below, out=self._slopes[2 * k])
            torch.sum(slopes, 0, out=self._slopes[2 * k + 1])
            if not k:
                break
            place = self._back[k - 1][:count]
            torch.mm(slopes, self._parts[2 * k], out=place)
            slopes = torch.ops.aten.tanh_backward.grad_input(place, below, grad_input=place)
        return torch.mm(slopes, self._parts[0])


class _Adam(torch.optim.Adam):
    """Adam that does not load torch's compiler, which takes as long as torch itself."""

    add_param_group = unwrap(torch.optim.Adam.add_param_group)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))


class _LBFGS(torch.optim.LBFGS):
    """L-BFGS that does not load torch's compiler."""

    add_param_group = unwrap(torch.optim.LBFGS.add_param_group)


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
    device, dtype = _place()
    centre, scale = standard_coordinates(samples.X)
    offset, spread = float(np.mean(samples.y)), float(np.std(samples.y)) or 1.0
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    weights = _draw_weights(samples.X.shape[1], settings.hidden, generator)
    layers = _Layers([w.to(device, dtype) for w in weights])
    inputs = torch.as_tensor((samples.X - centre) / scale, dtype=dtype).to(device)
    target = torch.as_tensor((samples.y - offset) / spread, dtype=dtype).to(device)[:, None]
    order = torch.randperm(len(samples), generator=generator).to(device)
    held = max(1, int(settings.validation * len(samples)))
    training = _Training(layers, inputs, target, order[held:], order[:held], generator)
    with _one_thread():
        training.descend(epochs // 2, settings.batch, settings.peak_rate)
        training.polish(epochs - epochs // 2)
    layers.weights.copy_(training.best_weights)
    error = spread * training.best_error
    return Network(layers, centre, scale, offset, spread, error, training.epochs)


def read_network(
    samples: Samples,
    weights: str,
    validation_error: float,
    epochs: int,
    settings: NetworkSettings | None = None,
) -> Network:
    """Give a network back that was trained on the same samples with the same settings.

    Parameters
    ----------
    samples, settings : what :func:`fit_network` was given.
    weights, validation_error, epochs : what the network wrote.

    Raises ValueError when the weights are not those of such a network.
    """
    settings = settings or NetworkSettings()
    device, dtype = _place()
    centre, scale = standard_coordinates(samples.X)
    offset, spread = float(np.mean(samples.y)), float(np.std(samples.y)) or 1.0
    units = (samples.X.shape[1], *settings.hidden, 1)
    shapes = [s for below, own in itertools.pairwise(units) for s in ((own, below), (own,))]
    layers = _Layers([torch.zeros(shape, dtype=dtype, device=device) for shape in shapes])
    values = np.frombuffer(b64decode(weights, validate=True), dtype=np.float64)
    layers.weights.copy_(torch.tensor(values, dtype=dtype))
    return Network(layers, centre, scale, offset, spread, validation_error, epochs)


def _place() -> tuple[str, torch.dtype]:
    gpu = torch.cuda.is_available()
    return ("cuda", torch.float32) if gpu else ("cpu", torch.float64)


def _draw_weights(
    variables: int, hidden: tuple[int, ...], generator: torch.Generator
) -> list[torch.Tensor]:
    drawn = []
    for below, units in itertools.pairwise((variables, *hidden, 1)):
        matrix, bias = torch.empty(units, below).double(), torch.empty(units).double()
        torch.nn.init.xavier_uniform_(matrix, generator=generator)
        drawn += [matrix, bias.uniform_(-0.1, 0.1, generator=generator)]
    return drawn


class _Training:
    """Weights on their way, and the best of them on the rows set aside."""

    def __init__(
        self,
        layers: _Layers,
        inputs: torch.Tensor,
        target: torch.Tensor,
        rows: torch.Tensor,
        held: torch.Tensor,
        generator: torch.Generator,
    ) -> None:
        self.layers, self.generator = layers, generator
        self.inputs, self.target = inputs[rows], target[rows]
        self.held_inputs, self.held_target = inputs[held], target[held]
        self.epochs = 0
        self.best_error = float("inf")
        self.best_weights = layers.weights.clone()

    def loss(self, rows: torch.Tensor | slice = slice(None)) -> torch.Tensor:
        """Mean square error on some rows; its slopes become the gradient of the weights."""
        inputs = self.inputs[rows]
        miss = self.layers.values(inputs) - self.target[rows]
        self.layers.slopes(inputs, 2 * miss * (1 / len(miss)))
        return torch.mean(miss**2)

    def check(self) -> float:
        """Error on the rows set aside; the weights are kept when it is the least so far."""
        miss = self.layers.values(self.held_inputs) - self.held_target
        error = float(torch.sqrt(torch.mean(miss**2)))
        if error < self.best_error:
            self.best_error = error
            self.best_weights = self.layers.weights.clone()
        return error

    def descend(self, epochs: int, batch: int, peak_rate: float) -> None:
        """Adam, one cycle of the learning rate."""
        count = len(self.inputs)
        batches = max(1, count // batch)
        adam = _Adam([self.layers.weights], lr=peak_rate)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            adam, peak_rate, total_steps=max(2, epochs * batches), final_div_factor=1e3
        )
        for _ in range(epochs):
            order = torch.randperm(count, generator=self.generator).to(self.inputs.device)
            for rows in torch.chunk(order, batches):
                self.loss(rows)
                adam.step()
                schedule.step()
            self.epochs += 1
            self.check()

    def polish(self, epochs: int, block: int = 10, patience: int = 5) -> None:
        """L-BFGS in blocks; ends after ``patience`` blocks that did not help the held-back rows."""
        solver: torch.optim.LBFGS = _LBFGS(
            [self.layers.weights],
            max_iter=block,
            max_eval=block,
            history_size=30,
            tolerance_grad=0.0,
            tolerance_change=0.0,
            line_search_fn="strong_wolfe",
        )

        weights = self.layers.weights
        seen: deque[tuple[torch.Tensor, ...]] = deque(maxlen=block)

        def loss() -> torch.Tensor:
            # A block begins where a line search of the last one has been.
            for place, value, slopes in seen:
                if torch.equal(place, weights):
                    self.layers.by_weights.copy_(slopes)
                    return value
            value = self.loss()
            seen.appendleft((weights.clone(), value, self.layers.by_weights.clone()))
            return value

        stale = 0
        for _ in range(epochs // block):
            solver.step(loss)
            self.epochs += block
            before = self.best_error
            stale = 0 if self.check() < 0.999 * before else stale + 1
            if stale >= patience:
                break
