"""Options: what a call asks for is in one object, which its keywords build."""

import inspect
from dataclasses import fields

import numpy as np
import pytest

import dynsr
from dynsr.discovery.options import Options
from dynsr.discovery.problem import DISCOVERY

_ASKED = ("known", "slopes", "order", "method", "targets", "loss", "terms", "vary", "start")


def test_the_keywords_of_discover_are_the_options_with_the_same_defaults():
    """A keyword that is missing in one of the two, or another default, fails here."""
    keywords = dict(inspect.signature(dynsr.discover).parameters)
    del keywords["data"]
    assert list(keywords) == [field.name for field in fields(Options)]
    for field in fields(Options):
        assert keywords[field.name].default == field.default, field.name


def test_only_what_differs_from_the_default_is_said():
    """Empty collections and the words of the defaults say nothing; arrays always do."""
    assert not any(Options().says(field.name) for field in fields(Options) if field.name in _ASKED)
    said = Options(slopes={"x": np.zeros(3)}, order=2, method=["sindy"], hidden="z")
    assert all(said.says(name) for name in ("slopes", "order", "method", "hidden"))
    usual = Options(slopes={}, order=1, method=("auto",), targets=["all"], hidden=0)
    assert not any(usual.says(name) for name in ("slopes", "order", "method", "targets", "hidden"))


@pytest.mark.parametrize("snap", [True, False])
def test_constants_that_stay_as_fitted_are_a_setting_of_the_fit(snap):
    """The numbers that decide are those given, but for the snapping of constants."""
    assert Options(snap=snap).details.selection.fit.snap is snap
    assert Options(snap=True).details is DISCOVERY


def test_searches_within_a_call_are_not_asked_for_what_the_call_does():
    """What is done with all runs, delays and a hidden state is done once; the rest stays."""
    call = Options(vary=True, delays=1.5, hidden="z", stochastic=True, ensemble=9, seed=4)
    within = call.within
    assert not any(map(within.says, ("vary", "delays", "hidden", "stochastic", "ensemble")))
    assert within.seed == 4
