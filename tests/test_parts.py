"""Parts of the searches: each can be left out, and the record says which were."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynsr.discovery import DISCOVERY, discover
from dynsr.errors import InputError
from dynsr.selection.parts import PARTS, Parts

PACKAGE = Path(__file__).parents[1] / "dynsr"
T = np.linspace(0.0, 4.0, 80)
DECAY = 2 * np.exp(-0.7 * T)


def without(*names):
    """Give the settings without some parts."""
    return replace(DISCOVERY, selection=DISCOVERY.selection.without(*names))


def test_every_part_is_asked_for_by_its_name_and_no_other_is():
    """A name that no line reads would switch nothing off."""
    text = "".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    assert set(re.findall(r'\bhas\(\s*"([a-z-]+)"', text)) == set(PARTS)


def test_a_part_that_there_is_not_is_refused():
    """One line lists those that there are."""
    with pytest.raises(InputError, match="unknown part 'luck'; the parts are: look-permuted, "):
        Parts(("luck",))


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.slow
def test_what_is_left_out_stands_in_the_record(noise):
    """A search with hardly any part left still ends, and its record names what was left out."""
    needed = {"pruning", "end-look", "end-simple", "methods"}
    off = tuple(name for name in PARTS if name not in needed)
    x = DECAY + noise * np.random.default_rng(0).standard_normal(len(T))
    found = discover((T, x[:, None]), settings=without(*off), jobs=1)
    assert str(found.equations["x"].free_symbols) == "{x}"
    kept = found.settings["details"]["selection"]["comparison"]["parts"]["off"]
    assert set(kept) == set(off)


@pytest.mark.slow
def test_the_look_at_exact_slopes_ends_nothing_where_that_is_left_out():
    """Without the early end the methods search too."""
    ended = discover((T, DECAY[:, None]), jobs=1)
    settings = without("end-look", "end-confirmed")
    searched = discover((T, DECAY[:, None]), settings=settings, preset="quick", jobs=1)
    assert ended.settings["first_look"] == ["x"] and "first_look" not in searched.settings
