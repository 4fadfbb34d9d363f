from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import dynsr
from dynsr.cli.data import generate
from dynsr.data.samples import make_samples
from dynsr.data.system import CART_POLE, LOTKA_VOLTERRA, PENDULUM, SYSTEMS, System
from dynsr.engines.simulation import add_noise, simulate, training_trajectory
from dynsr.errors import EngineError, InputError

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda s: s.name)
def test_every_known_system_can_be_simulated(system):
    """Each gives as many finite rows as its training span has samples."""
    found = simulate(system)
    assert len(found) == len(system.times(system.train))
    assert found.names == (*system.states, *system.inputs)
    assert np.isfinite(found.columns).all()


def test_data_hold_no_error_of_the_solver():
    """By themselves, here and from the shell, they are those of far smaller tolerances to 1e-8."""
    found, exact = (simulate(PENDULUM, t=[0.0, 10.0], **how) for how in ({}, {"reltol": 1e-13}))
    assert np.abs(found.x - exact.x).max() < 1e-8
    shell, own = (signature(f).parameters for f in (generate, simulate))
    assert all(shell[name].default == own[name].default for name in ("reltol", "abstol"))


def test_inputs_become_columns():
    """The force on the cart stands beside the states at the same times."""
    found = simulate(CART_POLE, t=np.linspace(0.0, 1.0, 11))
    assert found.input_names == ("F",)
    assert np.allclose(found.inputs[:, 0], -0.2 + 0.5 * np.sin(6 * found.t), atol=1e-15)


def test_the_origin_is_recorded():
    """Engine, versions and tolerances travel with the states."""
    origin = simulate(PENDULUM, t=[0.0, 1.0], reltol=1e-8).origin
    assert origin["engine"] == "embedded" and origin["system"] == "pendulum"
    assert origin["reltol"] == 1e-8 and origin["abstol"] == 1e-12
    assert origin["versions"]["dynsr"] == dynsr.__version__


@pytest.mark.parametrize("system", [LOTKA_VOLTERRA, PENDULUM], ids=lambda s: s.name)
def test_training_data_are_the_papers(system):
    """States and forward differences at t = 0, 0.01, ..., 10 are those of the paper's release."""
    golden = np.loadtxt(GOLDEN / f"paper_row_{system.name}.csv.gz", delimiter=",", skiprows=1)
    found = training_trajectory(system)
    samples = make_samples(found, system.target)
    assert len(samples) == len(golden) == 1001
    assert np.abs(samples.t - golden[:, 0]).max() < 1e-12
    assert np.abs(found.x[:-1] - golden[:, 1:3]).max() < 2e-5
    assert np.abs(samples.y - golden[:, 3]).max() < 1e-4


def test_finer_training_data_lie_on_the_same_solution():
    """Saving every 0.001 s moves no step: each tenth row is that of 0.01 s."""
    coarse, fine = training_trajectory(CART_POLE), training_trajectory(CART_POLE, step=0.001)
    assert len(fine) == 10011
    assert np.abs(fine.x[::10] - coarse.x).max() < 1e-12


def test_the_start_can_be_chosen():
    """A start state and times of one's own are used as given."""
    found = simulate(PENDULUM, x0=[0.1, 0.0], t=[5.0, 5.5])
    assert found.x[0].tolist() == [0.1, 0.0] and found.t.tolist() == [5.0, 5.5]


def test_a_start_that_does_not_fit_is_refused():
    """Three numbers for two states are named in one line."""
    with pytest.raises(InputError, match="do not fit 2 states"):
        simulate(PENDULUM, x0=[0.1, 0.0, 0.0])


def test_a_diverging_system_is_an_error_that_names_the_time():
    """Whoever asks for a trajectory is told until when there is one."""
    system = System.from_strings({"x": "x^2"}, x0=[1.0])
    with pytest.raises(EngineError, match="no solution at t = 1"):
        simulate(system, t=np.linspace(0.0, 2.0, 21))


def test_noise_has_the_level_asked_for():
    """Each state gets its own standard deviation times the level; inputs stay exact."""
    clean = simulate(CART_POLE)
    noisy = add_noise(clean, 0.05, np.random.default_rng(1))
    ratio = (noisy.x - clean.x).std(axis=0) / clean.x.std(axis=0)
    assert np.allclose(ratio, 0.05, rtol=0.1)
    assert (noisy.inputs == clean.inputs).all()
    assert noisy.origin["noise"] == 0.05


def test_the_same_seed_gives_the_same_noise():
    """Noise comes from the generator alone."""
    clean = simulate(PENDULUM)
    first, second = (add_noise(clean, 0.1, np.random.default_rng(7)).x for _ in range(2))
    assert (first == second).all()


@pytest.mark.parametrize("level", [-0.1, np.nan, np.inf])
def test_an_impossible_noise_level_is_refused(level):
    """Negative and not finite levels are named."""
    with pytest.raises(InputError, match="noise"):
        add_noise(simulate(PENDULUM, t=[0.0, 1.0]), level, np.random.default_rng(0))
