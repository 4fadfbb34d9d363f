import numpy as np
import pytest

from dynsr.data.samples import SCHEMES, make_samples
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError


def _sine(step: float) -> Trajectory:
    t = np.arange(0, 2, step)
    return Trajectory(t, np.sin(t)[:, None], ("x",), np.cos(3 * t)[:, None], ("u",))


@pytest.mark.parametrize(
    ("scheme", "order"),
    [("forward", 1), ("backward", 1), ("central2", 2), ("central4", 4), ("central6", 6)],
)
def test_schemes_converge_with_their_order(scheme: str, order: int):
    """Halving the step divides the error by two to the order."""
    errors = []
    for step in (0.1, 0.05):
        samples = make_samples(_sine(step), "x", scheme)
        errors.append(np.abs(samples.y - np.cos(samples.t)).max())
    assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.25)


def test_central_differences_are_exact_for_polynomials_on_uneven_times():
    """Order 6 differentiates a polynomial of degree 6 exactly, whatever the spacing."""
    t = np.sort(np.random.default_rng(0).uniform(0, 1, 12))
    cubic = Trajectory(t, (t**6 - t)[:, None], ("x",))
    samples = make_samples(cubic, "x", "central6")
    np.testing.assert_allclose(samples.y, 6 * samples.t**5 - 1, atol=1e-9)


def test_no_difference_reaches_over_the_gap_between_trajectories():
    """Samples of two trajectories are those of each, one below the other."""
    a, b = _sine(0.1), _sine(0.05)
    for scheme in SCHEMES:
        both = make_samples([a, b], "x", scheme)
        apart = [make_samples(one, "x", scheme) for one in (a, b)]
        np.testing.assert_array_equal(both.y, np.concatenate([p.y for p in apart]))
        assert both.names == ("x", "u")


@pytest.mark.parametrize("scheme", list(SCHEMES))
def test_too_few_rows_are_refused(scheme: str):
    """One row has no slope; the message says how many are needed."""
    with pytest.raises(InputError, match="at least"):
        make_samples(_sine(0.1).select(slice(0, 1)), "x", scheme)


def test_unknown_schemes_and_unlike_trajectories_are_refused():
    """The schemes are listed; trajectories of other columns cannot be joined."""
    other = Trajectory([0, 1], [[1], [2]], ("x",))
    with pytest.raises(InputError, match="central4"):
        make_samples(other, "x", "middle")
    with pytest.raises(InputError, match="different columns"):
        make_samples([_sine(0.1), other], "x")
