import sys

import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.methods.feynman.network import fit_network


def _samples(count: int) -> Samples:
    rng = np.random.default_rng(3)
    X = rng.uniform([-1.0, 100.0], [1.0, 300.0], size=(count, 2))
    y = 50.0 + 7.0 * np.sin(2 * X[:, 0]) * X[:, 1] / 100.0
    return Samples(X, y, ("a", "b"), "a", "given", np.arange(float(count)))


@pytest.mark.slow
def test_the_network_and_its_gradient_follow_a_smooth_function():
    """On fresh points the values are within 2 % of the spread, the derivatives within 10 %."""
    network = fit_network(_samples(600), np.random.default_rng(0), epochs=200)
    X = np.random.default_rng(4).uniform([-0.9, 120.0], [0.9, 280.0], size=(200, 2))
    y = 50.0 + 7.0 * np.sin(2 * X[:, 0]) * X[:, 1] / 100.0
    spread = np.std(y)
    assert np.sqrt(np.mean((network.predict(X) - y) ** 2)) < 0.02 * spread
    assert network.validation_error < 0.02 * spread
    slopes = np.column_stack([14 * np.cos(2 * X[:, 0]) * X[:, 1], 7 * np.sin(2 * X[:, 0])]) / 100.0
    off = np.sqrt(np.mean((network.gradient(X) - slopes) ** 2, axis=0))
    assert np.all(off < 0.1 * np.sqrt(np.mean(slopes**2, axis=0)))


def test_training_loads_no_compiler(monkeypatch):
    """What torch.compile needs takes as long to load as torch itself, and is not used."""
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)
    assert fit_network(_samples(80), np.random.default_rng(5), epochs=20).epochs == 20


def test_training_repeats_itself():
    """The same generator state gives the same network; another seed gives another."""
    samples = _samples(80)
    first, again, other = (
        fit_network(samples, np.random.default_rng(seed), epochs=10).predict(samples.X)
        for seed in (5, 5, 6)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_gradient_is_that_of_the_values():
    """Central differences of the values give the gradient, before the network follows anything."""
    network = fit_network(_samples(80), np.random.default_rng(5), epochs=10)
    X = _samples(80).X
    for k, step in enumerate((1e-4, 1e-2)):
        shift = step * np.eye(2)[k]
        rise = network.predict(X + shift) - network.predict(X - shift)
        assert np.allclose(network.gradient(X)[:, k], rise / (2 * step), rtol=1e-5, atol=1e-7)
