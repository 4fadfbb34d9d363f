"""Bits of constants of which some are written as simple numbers, or by others."""

import numpy as np
import pytest

from dynsr.fit import precision_bits, shortened_bits


def ridge(apart):
    """Give the information on two constants whose sum is known far better than their difference."""
    sums, differences = np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([[1.0, -1.0], [-1.0, 1.0]])
    return 1e8 * sums + differences / apart**2


@pytest.mark.parametrize("apart", [0.01, 0.1, 1.0])
def test_savings_add_up_and_are_no_more_than_said(apart):
    """Of two constants along a ridge both save the bits they are said to, not what all take."""
    ones = np.ones(2)
    whole = precision_bits(ridge(apart), ones, ones)
    for saved in ({(0,): 1.0}, {(0,): 1.0, (1,): 0.5}, {(0, 1): 2.0}):
        less = whole - shortened_bits(ridge(apart), ones, ones, saved)
        assert less == pytest.approx(sum(saved.values()))


def test_a_constant_saves_no_more_than_it_takes():
    """What is hardly known takes few bits, and these are all that a simple number saves."""
    loose = np.diag([1e8, 1e-2])
    ones = np.ones(2)
    first = precision_bits(loose[:1, :1], ones[:1], ones[:1])
    assert shortened_bits(loose, ones, ones, {(1,): 50.0}) == pytest.approx(first)


def test_a_place_is_written_otherwise_once():
    """A constant that two savings name takes the larger one."""
    told, ones = np.diag([1e8, 1e8]), np.ones(2)
    whole = precision_bits(told, ones, ones)
    saved = {(0,): 3.0, (0, 1): 5.0}
    assert whole - shortened_bits(told, ones, ones, saved) == pytest.approx(5.0)
