"""Random systems: the same from the same seed, bounded, moving, of every field."""

import re

import numpy as np
import pytest

from dynsr.benchmarks import draw_systems
from dynsr.benchmarks.zoo.catalogue import ZOO
from dynsr.engines import simulate
from dynsr.errors import InputError

SIGNED = {"flows", "mechanics", "polynomials"}


@pytest.fixture(scope="module")
def drawn():
    """Draw forty systems."""
    return draw_systems(40, seed=3)


@pytest.mark.slow
def test_a_seed_gives_its_systems_again(drawn):
    """The same seed gives the same systems however many are asked for; another one gives others."""
    assert draw_systems(3, seed=3) == drawn[:3]
    others = [system.equations for system in draw_systems(3, seed=4)]
    assert all(system.equations not in others for system in drawn)


@pytest.mark.slow
def test_random_systems_are_of_many_fields_and_sizes(drawn):
    """Forty are of at least six fields and of one to four states, and all of different names."""
    assert len({system.kind for system in drawn}) >= 6
    assert {len(system.equations) for system in drawn} == {1, 2, 3, 4}
    assert len({system.name for system in drawn}) == len(drawn)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "seed"), [(25, 5), (12, 12)])
def test_a_system_that_runs_away_is_passed_over(number, seed):
    """Whatever the step in which a drawn system leaves its field, or fails, the next is drawn."""
    some = draw_systems(number, seed=seed, beyond=True)
    assert len(some) == number and all("beyond" in system.name for system in some)


def test_no_random_system_is_one_of_the_zoo(drawn):
    """None has the name or the equations of a system that is published."""
    known = {tuple(animal.system.rhs) for animal in ZOO}
    assert not known & {tuple(system.system.rhs) for system in drawn}


@pytest.mark.slow
def test_random_systems_stay_bounded_and_keep_moving(drawn):
    """By another solver, from both starts: below 30, still moving late, amounts not below 0."""
    for system in drawn:
        assert system.starts[0] != system.starts[1] and system.group == "drawn"
        for start in system.starts:
            x = simulate(system.system, start, np.linspace(0, system.span, 300), 1e-8, 1e-10).x
            assert np.all(np.abs(x) < 30)
            assert np.all(np.ptp(x[100:], axis=0) > 0.01 * np.ptp(x, axis=0))
            assert system.kind in SIGNED or np.all(x > -1e-6)


def test_a_number_below_one_is_refused():
    """A number of systems below 1 is told with its value."""
    with pytest.raises(InputError, match="number 0 of random systems must be at least 1"):
        draw_systems(0)


@pytest.mark.slow
def test_systems_beyond_the_library_are_drawn_as_well():
    """Each has a mechanism more than its field writes, and is bounded and moves as others do."""
    found = draw_systems(6, seed=3, beyond=True)
    assert all("beyond" in system.name for system in found)
    odd = r"exp\(-[\d.]+\*\w\^2\)|atan|log\(1 \+ exp|\w\^2\)|\*\w\*\w\)|\^0\.75|tanh|sqrt"
    for system in found:
        assert sum(bool(re.search(odd, text)) for text in system.equations.values()) >= 1
    assert draw_systems(2, seed=3, beyond=True) == found[:2]
