import numpy as np
import pandas as pd
import pytest
import sympy
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

from dynsr.discovery.estimator import DynsrRegressor, _repeated
from dynsr.errors import InputError
from dynsr.methods.rational import RationalSearch

SMALL = RationalSearch(costs=(2,), max_terms=3, denominators=False, rounds=1, width=20)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_default_finds_a_product_of_functions():
    """exp(-x0) sin(x1) is exact beside a column that plays no part: the default is "auto"."""
    X = np.random.default_rng(2).uniform(-2, 2, (100, 3))
    model = DynsrRegressor().fit(X, np.exp(-X[:, 0]) * np.sin(X[:, 1]))
    x0, x1 = sympy.symbols("x0 x1")
    assert sympy.simplify(model.expr_ - sympy.exp(-x0) * sympy.sin(x1)) == 0
    assert model.method == "auto"


def test_the_front_is_a_frame(planted):
    """equations_ lists every formula; sympy, latex and predict take its rows."""
    model = DynsrRegressor(method=SMALL).fit(*planted)
    table = model.equations_
    columns = ["complexity", "loss", "score", "equation", "sympy_format", "source"]
    assert list(table.columns) == columns and len(table) == len(model.front_)
    assert np.all(np.diff(table.complexity) > 0) and np.all(np.diff(table.loss) < 0)
    X, y = planted
    for k, row in table.iterrows():
        assert row.sympy_format == model.sympy(k) == model.front_[k].expr
        assert np.mean((model.predict(X, k) - y) ** 2) == pytest.approx(
            row.loss, rel=1e-12, abs=1e-25
        )
    assert model.sympy() == model.expr_ and model.latex() == "3 a b - 2 b"
    with pytest.raises(InputError, match="index 99 is none"):
        model.sympy(99)


def test_weights_count_rows():
    """Rows of weight 0 are as absent, whole weights as repeated rows, fractions in proportion."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 2, 120))
    y = np.where(x < 1, 2 * x, 5 * x)
    left = DynsrRegressor(method=SMALL).fit(x[:, None], y, sample_weight=(x < 1) * 0.3)
    right = DynsrRegressor(method=SMALL).fit(x[:, None], y, sample_weight=(x >= 1) * 7)
    assert str(left.expr_) == "2*x0" and str(right.expr_) == "5*x0"
    odd = rng.uniform(0.5, 1.5, 120)
    counts = np.bincount(_repeated(odd), minlength=120)
    assert counts.sum() == 960 and np.max(np.abs(counts - 8 * odd / odd.mean())) <= 1
    with pytest.raises(ValueError, match="at least one non-zero"):
        left.fit(x[:, None], y, sample_weight=0 * x)
