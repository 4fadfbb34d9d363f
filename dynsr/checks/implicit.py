"""The cart-pole's last equation as an implicit problem: who finds the law, right or wrong.

The law is ``(2 - cos(w)^2) z' = -(y^2 sin(w) + 9.81 sin(w) cos(w) + F)``. Everyone gets the same
rows ``[z' f; f]`` of sixteen functions f that hold it, with exact slopes and with the forward
differences of the paper, and is tested by the slopes that its relation gives over the test span.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from dynsr.checks.trajectories import CrosscheckRow, absent
from dynsr.data import find_system
from dynsr.engines import AbstractEngine, EmbeddedEngine, SparseProblem, simulate
from dynsr.errors import MissingExtra, need
from dynsr.expression import compile_numpy, parse

SYSTEM = "cart-pole"
FUNCTIONS = (
    *("1", "w", "y", "z", "y^2", "sin(w)", "cos(w)", "cos(w)^2", "cos(w)*sin(w)", "y*sin(w)"),
    *("y^2*sin(w)", "z*sin(w)", "y*cos(w)", "z*cos(w)", "y^2*cos(w)", "F"),
)
TERMS_OF_THE_LAW = 5
# Root mean square of the missed slopes over that of the slopes.
RIGHT = 1e-6
THRESHOLD, SINDY_PI_WEIGHT = 0.1, 1e-3
_STEP, _TOLERANCE, _MODELS = 0.01, 1e-12, 20
# A coefficient below this share of the largest is none: its solver gives no exact zeros.
_ZERO = 1e-3


@dataclass(frozen=True, eq=False)
class ImplicitProblem:
    """Values (p, m) of the functions, slopes (m,) as given, and how they were made."""

    functions: np.ndarray
    slopes: np.ndarray
    scheme: str

    @property
    def rows(self) -> np.ndarray:
        """The rows (2p, m) of the homogeneous problem, those of the denominator first."""
        return np.vstack([self.slopes * self.functions, self.functions])

    def miss(self, relation: np.ndarray) -> float:
        """Give how far the slopes of a relation (2p,) are from those given, inf where it has none.

        >>> line = ImplicitProblem(np.array([[1.0, 1.0]]), np.array([2.0, 2.0]), "exact")
        >>> line.miss(np.array([1.0, -2.0])), line.miss(np.array([0.0, 1.0]))
        (0.0, inf)
        """
        count = len(self.functions)
        below, above = relation[:count] @ self.functions, relation[count:] @ self.functions
        with np.errstate(all="ignore"):
            off = -above / below - self.slopes
        found = float(np.linalg.norm(off) / np.linalg.norm(self.slopes))
        return found if np.isfinite(found) else float("inf")


def pose(span: tuple[float, float], exact: bool) -> ImplicitProblem:
    """Pose the problem over a span of the cart-pole's trajectory, which begins at time 0.

    Parameters
    ----------
    span : first and last time in seconds.
    exact : slopes of the law itself; else forward differences over 0.01 s.
    """
    system = find_system(SYSTEM)
    times = np.arange(round(span[1] / _STEP) + 1) * _STEP
    run = simulate(system, t=times, reltol=_TOLERANCE, abstol=_TOLERANCE)
    run = run.select(slice(round(span[0] / _STEP), None))
    texts = [parse(text, run.names) for text in FUNCTIONS]
    functions = compile_numpy(texts, run.names)(run.columns.T)
    law = compile_numpy([system.rhs[system.index(system.target)]], run.names)(run.columns.T)[0]
    if exact:
        return ImplicitProblem(functions, law, "exact slopes")
    slopes = np.diff(run.x[:, run.index(system.target)]) / np.diff(run.t)
    return ImplicitProblem(functions[:, :-1], slopes, "forward differences")


def implicit_rows(system: str, engine: AbstractEngine) -> Iterator[CrosscheckRow]:
    """Test an engine's implicit search, and with the embedded one pysindy's, on the cart-pole.

    Each row is right or wrong; neither is a disagreement of engines. No other system has rows.

    Parameters
    ----------
    system : one of the paper's systems.
    engine : the engine to test.
    """
    if system != SYSTEM:
        return
    truth = find_system(SYSTEM)
    test = pose(truth.test, exact=True)
    for exact in (True, False):
        problem = pose(truth.train, exact)
        found = engine.regress(
            SparseProblem(
                problem.functions,
                problem.slopes,
                "STLSQ",
                {"threshold": THRESHOLD, "rho": 0.0},
                normalize=False,
                implicit=True,
            )
        ).coefficients
        yield _give_verdict(f"{engine.name} STLSQ", problem, test, found)
        if isinstance(engine, EmbeddedEngine):
            yield from _peers(problem, test)


def _peers(problem: ImplicitProblem, test: ImplicitProblem) -> Iterator[CrosscheckRow]:
    try:
        need("pysindy", "pysindy", "the comparison with pysindy")
    except MissingExtra as missing:
        yield absent("implicit", SYSTEM, "pysindy", "the law", str(missing))
        return
    import pysindy

    name = f"pysindy {pysindy.__version__}"
    yield _give_verdict(f"{name} ensemble of STLSQ", problem, test, _by_ensemble(pysindy, problem))
    if importlib.util.find_spec("cvxpy") is None:
        reason = "SINDyPI needs cvxpy; pip install cvxpy"
        yield absent("implicit", SYSTEM, f"{name} SINDyPI", "the law", reason)
        return
    yield _give_verdict(f"{name} SINDyPI", problem, test, _by_sindy_pi(pysindy, problem))


def _give_verdict(
    who: str, problem: ImplicitProblem, test: ImplicitProblem, relation: np.ndarray
) -> CrosscheckRow:
    terms = np.count_nonzero(relation)
    return CrosscheckRow(
        "implicit",
        SYSTEM,
        f"test slopes, from {problem.scheme}",
        who,
        "the law",
        len(test.slopes),
        test.miss(relation),
        RIGHT,
        f"{terms} terms where the law has {TERMS_OF_THE_LAW}",
        judged=True,
    )


def _by_ensemble(pysindy: ModuleType, problem: ImplicitProblem) -> np.ndarray:
    """Give the median of twenty fits to drawn rows, with the slope itself as the left-hand side."""
    rows = problem.rows
    stlsq = pysindy.STLSQ(threshold=THRESHOLD, alpha=0.0)
    ensemble = pysindy.EnsembleOptimizer(stlsq, bagging=True, n_models=_MODELS)
    with _seeded(), warnings.catch_warnings():
        # Rows that depend on each other are what an implicit problem is made of.
        warnings.simplefilter("ignore")
        ensemble.fit(rows[1:].T, rows[0][:, None])
    return np.concatenate([[1.0], -np.ravel(ensemble.coef_)])


def _by_sindy_pi(pysindy: ModuleType, problem: ImplicitProblem) -> np.ndarray:
    """Give the relation that fits the slopes best, of one for each row as the left-hand side."""
    rows = problem.rows
    optimizer = pysindy.SINDyPI(reg_weight_lam=SINDY_PI_WEIGHT, tol=1e-8, max_iter=20_000)
    # It prints the number of each model, and warns of those that its solver leaves inaccurate.
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        optimizer.fit(rows.T, rows.T)
    relations = np.eye(len(rows)) - optimizer.coef_
    relations[np.abs(relations) < _ZERO * np.abs(relations).max(axis=1, keepdims=True)] = 0.0
    return min(relations, key=problem.miss)


@contextlib.contextmanager
def _seeded() -> Iterator[None]:
    """Seed NumPy's old generator, which pysindy draws from, and leave it as it was."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002
