import numpy as np

from dynsr.expression.evaluation import evaluate
from dynsr.methods.features import build_features


def test_values_are_those_of_the_expressions():
    """Each feature's row of values is its expression evaluated on the columns."""
    rng = np.random.default_rng(0)
    columns = {"x": rng.uniform(0.5, 2, 40), "y": rng.uniform(-2, 2, 40)}
    features = build_features(columns, max_cost=4)
    for expr, values in zip(features.exprs, features.values, strict=True):
        np.testing.assert_allclose(evaluate(expr, columns), values, rtol=1e-12, atol=1e-14)


def test_no_feature_repeats_another():
    """No two rows are proportional, although products commute and sqrt(x)^2 is x."""
    rng = np.random.default_rng(1)
    columns = {"x": rng.uniform(0.5, 2, 60), "y": rng.uniform(0.5, 2, 60)}
    values = build_features(columns, max_cost=5).values
    values = values / np.linalg.norm(values, axis=1, keepdims=True)
    cosines = np.abs(values @ values.T) - np.eye(len(values))
    assert cosines.max() < 1 - 1e-12


def test_too_many_features_are_cut_by_whole_costs():
    """Above the count, the dearest features go, never a part of one cost."""
    rng = np.random.default_rng(2)
    columns = {name: rng.uniform(-1, 1, 30) for name in "abcde"}
    everything = build_features(columns, max_cost=4, max_count=10_000)
    some = build_features(columns, max_cost=4, max_count=200)
    highest = some.costs[-1]
    assert len(some.exprs) == int((everything.costs <= highest).sum()) <= 200


def test_constant_columns_and_undefined_functions_make_no_features():
    """A constant column adds nothing, and a logarithm needs positive values."""
    columns = {"c": np.full(20, 3.0), "x": np.linspace(-1, 1, 20)}
    names = {str(expr) for expr in build_features(columns, max_cost=3).exprs}
    assert "exp(x)" in names
    assert not any(n == "c" or "log" in n or "sqrt" in n for n in names)
