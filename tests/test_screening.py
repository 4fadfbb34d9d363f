import numpy as np

from dynsr.methods.feynman.enumeration.backend import NumpyBackend
from dynsr.methods.feynman.enumeration.bank import Chunk
from dynsr.methods.feynman.enumeration.screening import Screen, Shortlist
from dynsr.methods.feynman.problem import make_problems


def unexplained(columns: np.ndarray, z: np.ndarray) -> float:
    """Sum of squares that numpy's lstsq leaves."""
    rest = z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0]
    return float(rest @ rest)


def test_shares_are_those_of_lstsq():
    """The closed form of every problem's affine fit explains what numpy's lstsq explains."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0.5, 2.0, (200, 2))
    y = X[:, 0] * np.exp(-X[:, 1]) + 0.1
    probes = np.arange(0, 200, 5)
    problems = make_problems(X, y, ("inv", "square", "log"), True)
    backend = NumpyBackend()
    screen = Screen(problems, probes, backend)
    values = rng.uniform(0.1, 3.0, (30, len(probes)))
    squares = backend.square_sums(values)
    shares = screen.shares(screen.directions @ values.T, squares, values)
    assert shares.shape == (len(problems), 30)
    for place, problem in enumerate(problems):
        z = problem.target.values[probes]
        background = problem.background[probes]
        for k in range(30):
            both = np.column_stack([background, problem.feature(values[k])])
            expected = 1 - unexplained(both, z) / unexplained(background, z)
            assert np.isclose(shares[place, k], expected, rtol=1e-7, atol=1e-9), problem.name


def test_a_shortlist_keeps_the_best_of_all_chunks():
    """What comes out is what sorting all shares at once gives."""
    rng = np.random.default_rng(1)
    shortlist = Shortlist(problems=2, keep=5)
    shares = rng.uniform(size=(2, 4000))
    for begin in range(0, 4000, 100):
        numbers = np.arange(begin, begin + 100, dtype=np.int32)
        kinds = np.zeros(100, dtype=np.uint8)
        chunk = Chunk(np.empty((100, 1)), kinds, numbers, numbers, kinds)
        shortlist.offer(shares[:, begin : begin + 100], chunk, np.arange(100))
    for place in range(2):
        expected = np.argsort(-shares[place])[:5].tolist()
        assert [left for _, left, _ in shortlist.winners(place)] == expected
