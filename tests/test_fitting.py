import warnings

import numpy as np
import pytest

from dynsr.fit.linear import fit_linear, fit_robustly, know


@pytest.mark.parametrize("columns", [1, 2, 4])
def test_closed_forms_agree_with_lstsq(columns):
    """Weighted least squares of a whole batch is numpy's lstsq of each problem alone."""
    rng = np.random.default_rng(columns)
    design = rng.standard_normal((20, 90, columns)) * 10.0 ** rng.uniform(-4, 4, columns)
    z, roots = rng.standard_normal((20, 90)), rng.uniform(0.1, 2.0, (20, 90))
    found = fit_linear(design, z, roots)
    for k in range(20):
        expected = np.linalg.lstsq(design[k] * roots[k][:, None], z[k] * roots[k], rcond=None)[0]
        assert np.allclose(found[k], expected, rtol=1e-9)


@pytest.mark.parametrize("rows", [120, 2000])
def test_bad_rows_do_not_move_a_robust_fit(rows):
    """With a tenth of the rows far off, slope and shift stay those of the other rows."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, rows)
    z = 2 * x - 1 + 1e-4 * rng.standard_normal(rows)
    bad = rng.choice(rows, rows // 10, replace=False)
    z[bad] += 5.0
    design = np.column_stack([np.ones(rows), x])[None]
    found = fit_robustly(design, z, np.ones(rows))[0]
    good = np.setdiff1d(np.arange(rows), bad)
    expected = np.linalg.lstsq(design[0][good], z[good], rcond=None)[0]
    plain = np.linalg.lstsq(design[0], z, rcond=None)[0]
    assert np.allclose(found, expected, atol=2e-5)
    assert not np.allclose(plain, expected, atol=0.1)


@pytest.mark.parametrize("variance", [0.0, np.inf])
def test_a_known_number_that_says_nothing_of_others_leaves_them(variance):
    """One that is exact already, or that the data leave open, moves no other, without a warning."""
    covariance = np.array([[variance, 0.5 * variance], [0.5 * variance, 2.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        values, left = know(np.array([3.0, 5.0]), covariance, 0, 1e300)
    assert values.tolist() == [1e300, 5.0]
    assert left.tolist() == [[0.0, 0.0], [0.0, 2.0]]


def test_what_may_be_anything_stays_so_where_another_is_known():
    """A constant of infinite variance and covariance moves with none, and moves none."""
    covariance = np.array([[0.02, np.inf, 0.01], [np.inf, np.inf, np.inf], [0.01, np.inf, 0.02]])
    values, left = know(np.array([1.1, 7.0, 2.0]), covariance, 0, 1.0)
    np.testing.assert_allclose(values, [1.0, 7.0, 1.95])
    np.testing.assert_allclose(left[::2, ::2], [[0.0, 0.0], [0.0, 0.015]], atol=1e-12)
    assert left[1, 1] == np.inf
