import numpy as np
import pandas as pd
import pytest
import sympy
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

from dynsr.discovery.estimator import DynsrRegressor
from dynsr.errors import InputError
from dynsr.methods.rational import RationalSearch

SMALL = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1, width=20)


@parametrize_with_checks([DynsrRegressor(method=SMALL)])
def test_scikit_learns_own_checks_pass(estimator, check):
    """Every check that scikit-learn runs on its own estimators passes."""
    check(estimator)


@pytest.fixture
def planted():
    """Give 200 rows of 3 a b - 2 b."""
    X = pd.DataFrame(np.random.default_rng(0).uniform(0.5, 3, (200, 2)), columns=["a", "b"])
    return X, 3 * X.a * X.b - 2 * X.b


def test_a_planted_formula_comes_back_in_the_names_of_the_frame(planted):
    """The formula is exact and speaks of the frame's columns."""
    a, b = sympy.symbols("a b")
    model = DynsrRegressor(method=SMALL).fit(*planted)
    assert sympy.expand(model.expr_ - (3 * a * b - 2 * b)) == 0
    assert model.score(*planted) == pytest.approx(1.0)


def test_it_works_in_a_pipeline_and_a_grid_search(planted):
    """A pipeline with a grid over settings fits, and picks the setting that can be right."""
    X, y = planted
    few = RationalSearch(costs=(2,), max_terms=1, denominators=False, rounds=1)
    search = GridSearchCV(
        make_pipeline(FunctionTransformer(), DynsrRegressor()),
        {"dynsrregressor__method": [few, SMALL]},
        cv=2,
    ).fit(X, y)
    assert search.best_params_["dynsrregressor__method"] == SMALL
    assert search.best_score_ == pytest.approx(1.0)


def test_a_clone_fits_alike(planted):
    """A clone has the settings and finds the same formula."""
    model = DynsrRegressor(method=SMALL)
    assert clone(model).fit(*planted).expr_ == model.fit(*planted).expr_


def test_lowest_error_takes_the_end_of_the_front(planted):
    """The other way to select gives the most accurate formula."""
    model = DynsrRegressor(method=SMALL, select="lowest error").fit(*planted)
    assert model.expr_ == model.front_.best_fit.expr


@pytest.mark.parametrize("settings", [{"method": "magic"}, {"preset": "x"}, {"select": "y"}])
def test_unknown_settings_are_one_line(planted, settings):
    """An unknown setting is an input error when fitted."""
    with pytest.raises(InputError, match="unknown"):
        DynsrRegressor(**settings).fit(*planted)
