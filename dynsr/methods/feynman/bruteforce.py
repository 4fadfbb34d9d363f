"""Brute force worth the name: every function up to a size looked at once, in order of size.

Bottom-up, in batches: each level combines the distinct functions of the simpler ones; values on a
few probe rows tell whether a function was met before (up to an affine map) and how well it fits
every problem of :mod:`dynsr.methods.feynman.problem`, constants in closed form. Only the best few
of a level are then fitted on all rows. AI Feynman (Udrescu and Tegmark 2020, section II.C) counts
through strings instead, one at a time and with one free constant.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.feynman.alphabet import count_strings, make_letters
from dynsr.methods.feynman.backend import choose_backend
from dynsr.methods.feynman.enumerator import Enumerator
from dynsr.methods.feynman.finishing import Finisher
from dynsr.methods.feynman.pool import Pool
from dynsr.methods.feynman.problem import Problem, make_problems
from dynsr.methods.feynman.screening import Screen, Shortlist
from dynsr.methods.feynman.stage import AbstractStage, Context
from dynsr.methods.feynman.sums import best_pairs, best_triples, make_gram
from dynsr.pareto import Candidate, ParetoFront
from dynsr.samples import Samples

_EXACT = 1e-10
# Rows on which pairs are compared, and pairs that triples are grown from.
_SUM_ROWS = 500
_PAIRS = 48


@dataclass(frozen=True)
class BruteForceResult:
    """What a search found, and how much it looked at.

    Parameters
    ----------
    candidates : formulas for y, simplest first: the Pareto fronts in RMSE and in error bits, and
        the best in error bits beside them.
    formed : functions evaluated, repetitions included.
    distinct : functions tested, each once up to an affine map.
    covered : strings in reverse Polish notation over the same letters of up to ``complete``
        letters; every one is equal to a function looked at or has no finite values on the samples.
    complete : largest size of which every function was looked at.
    stored : functions kept to build on, in ``nbytes`` bytes (tables of hashes included).
    stopped : what ended it: "exact", "size", "candidates", "deadline" or "interrupted".
    seconds : time taken.
    """

    candidates: tuple[Candidate, ...]
    formed: int
    distinct: int
    covered: int
    complete: int
    stored: int
    nbytes: int
    stopped: str
    seconds: float

    @property
    def front(self) -> ParetoFront:
        """The Pareto front of complexity against RMSE."""
        return ParetoFront(self.candidates)


@dataclass(frozen=True)
class BruteForce(AbstractMethod):
    """Search for y = f(X) by enumeration of functions.

    Parameters
    ----------
    operators : tokens of the functions' letters.
    constants : numbers that stand beside the variables as leaves.
    nested : allow a function inside one of its own family, such as sin(x + cos(y)).
    changes : domain changes of the target, names of ``domain.CHANGES``.
    monomials : fit power laws and exponentials times a power law too.
    max_size : most letters of a function.
    max_candidates : functions formed at most. This bound does not depend on the machine's speed.
    max_memory : megabytes for stored functions and tables of hashes; when they would take more,
        nothing further is stored and only what is stored goes on being combined.
    seconds : time after which no further part is begun.
    probes : rows on which functions are told apart and screened.
    keep : functions of each level and problem that are fitted on all rows.
    sums : numbers of simplest functions of which all pairs are tried as sums, in turn; () for none.
    device : where the arrays live, see ``backend.choose_backend``.

    >>> x = np.linspace(0.5, 2.0, 200)
    >>> samples = Samples(x[:, None], 2 * np.sin(x**2) - 1, ("x",), "x", "given", x)
    >>> front = BruteForce(max_size=4).search(samples, np.random.default_rng(0))
    >>> front.best_fit.loss < 1e-12
    True
    """

    operators: tuple[str, ...] = (
        *("+", "-", "*", "/", "square", "sqrt", "inv"),
        *("sin", "cos", "exp", "log"),
    )
    constants: tuple[str, ...] = ("1",)
    nested: bool = False
    changes: tuple[str, ...] = ("inv", "square", "sqrt", "log", "exp", "sin", "asin", "acos")
    monomials: bool = True
    max_size: int = 12
    max_candidates: float = 1_000_000
    max_memory: float = 1024.0
    seconds: float = math.inf
    probes: int = 32
    keep: int = 16
    sums: tuple[int, ...] = (100, 400)
    device: str = "auto"

    name = "brute force"

    def __post_init__(self) -> None:
        """Refuse bounds that allow nothing."""
        make_letters(self.operators, self.nested)
        for field_name in ("max_size", "max_candidates", "max_memory", "seconds", "keep"):
            value = getattr(self, field_name)
            if not value > 0:
                raise InputError(f"{field_name} {value!r} must be greater than 0")
        if self.probes < 8:
            raise InputError(f"probes {self.probes!r} are too few to tell functions apart; give 8")

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; ``rng`` is not used, since nothing here is left to chance."""
        return search_values(samples.X, samples.y, samples.names, self, report=report).front


@dataclass(frozen=True)
class BruteForceStage(AbstractStage):
    """The enumeration as one stage of a search; takes at most ``share`` of the time left."""

    settings: BruteForce = field(default_factory=BruteForce)
    share: float = 0.5

    name = "brute force"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give the formulas found."""
        seconds = min(self.settings.seconds, self.share * context.seconds_left)
        if seconds <= 0:
            return []
        settings = replace(self.settings, seconds=seconds)

        def tell(progress: Progress) -> None:
            context.tell(self.name, progress.done, progress.total)

        result = search_values(samples.X, samples.y, samples.names, settings, report=tell)
        context.interrupted |= result.stopped == "interrupted"
        return list(result.candidates)


def search_values(
    X: np.ndarray,
    y: np.ndarray,
    names: Sequence[str],
    settings: BruteForce | None = None,
    report: Report = silent,
) -> BruteForceResult:
    """Search for y = f(X), (n, p) -> (n,), and say how much was looked at.

    Raises InputError when shapes do not fit or a value is not finite. KeyboardInterrupt ends the
    search early with what was found.

    >>> x = np.linspace(1.0, 2.0, 100)[:, None]
    >>> result = search_values(x, 3 * x[:, 0] ** 1.5, ["x"], BruteForce(max_size=3))
    >>> str(result.front.best_fit.expr), result.stopped
    ('3.0*x**(3/2)', 'exact')
    """
    X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
    if X.ndim != 2 or y.shape != (len(X),) or X.shape[1] != len(names) or len(y) < 2:
        raise InputError(
            f"X {X.shape}, y {y.shape} and {len(names)} names do not fit together; "
            "give (n, p), (n,) and p names with n at least 2"
        )
    if not (np.isfinite(X).all() and np.isfinite(y).all()):
        raise InputError("X or y holds a value that is not finite; drop those rows")
    return _Search(X, y, tuple(names), settings or BruteForce(), report).run()


class _Search:
    """One running search."""

    def __init__(
        self,
        X: np.ndarray,
        y: np.ndarray,
        names: tuple[str, ...],
        settings: BruteForce,
        report: Report,
    ) -> None:
        self.X, self.y, self.settings, self.report = X, y, settings, report
        self.started = time.monotonic()
        self.letters, self.nested = make_letters(settings.operators, settings.nested)
        leaves = [sympy.Symbol(name) for name in names] + [parse(c) for c in settings.constants]
        self.leaves = len(leaves)
        self.problems = make_problems(X, y, settings.changes, settings.monomials)
        probes = _spaced(len(y), settings.probes)
        backend = choose_backend(settings.device)
        self.screen = Screen(self.problems, probes, backend)
        self.enumerator = Enumerator(
            X[probes],
            leaves,
            self.letters,
            self.nested,
            backend,
            int(settings.max_memory * 2**20),
        )
        self.finisher = Finisher(self.enumerator.bank, X, y)
        self.pool = Pool()
        self.stopped = ""
        self.sums_done = 0

    def run(self) -> BruteForceResult:
        """Search until a bound is met."""
        try:
            with np.errstate(all="ignore"):
                self._run()
        except KeyboardInterrupt:
            self.stopped = "interrupted"
        enumerator = self.enumerator
        return BruteForceResult(
            candidates=tuple(self.pool.candidates(self.settings.name)),
            formed=enumerator.formed,
            distinct=enumerator.distinct,
            covered=count_strings(self.letters, self.leaves, enumerator.complete, self.nested),
            complete=enumerator.complete,
            stored=len(enumerator.bank),
            nbytes=enumerator.nbytes,
            stopped=self.stopped,
            seconds=time.monotonic() - self.started,
        )

    def _run(self) -> None:
        settings = self.settings
        for problem in self.problems:
            self.pool.add(self.finisher.finish(problem, [()]))
        for size in range(1, settings.max_size + 1):
            if self._ended():
                return
            shortlist = self.enumerator.form(
                size,
                self.screen,
                settings.keep,
                settings.max_candidates,
                self.started + settings.seconds,
                size == settings.max_size,
            )
            self._finish(shortlist)
            self._try_sums(size)
            if self.report is not silent:
                self.report(Progress(settings.name, self.enumerator.formed, None, self._front()))
        if not self._ended():
            self.stopped = "size"

    def _ended(self) -> bool:
        """Whether a bound is met; says which in ``stopped``."""
        best = self.pool.best
        if best is not None and best.loss <= _EXACT * float(np.abs(self.y).max()):
            self.stopped = "exact"
        elif self.enumerator.stopped:
            self.stopped = self.enumerator.stopped
        elif time.monotonic() > self.started + self.settings.seconds:
            self.stopped = "deadline"
        return bool(self.stopped)

    def _finish(self, shortlist: Shortlist) -> None:
        bank = self.enumerator.bank
        for place, problem in enumerate(self.problems):
            numbers = [(bank.number(*winner),) for winner in shortlist.winners(place)]
            self.pool.add(self.finisher.finish(problem, numbers))

    def _try_sums(self, size: int) -> None:
        """Try all pairs of the next number of functions, once there are as many or no more come."""
        levels = self.enumerator.bank.levels
        fresh = [level.start + np.flatnonzero(level.fresh) for level in levels]
        numbers = np.concatenate(fresh)
        over = size == self.settings.max_size or bool(self.enumerator.stopped)
        for count in self.settings.sums[self.sums_done :]:
            if (len(numbers) < count and not over) or self._ended_but_for_sums():
                return
            self.sums_done += 1
            rows = _spaced(len(self.y), _SUM_ROWS)
            chosen = numbers[:count]
            depth = sum(level.start <= chosen[-1] for level in levels)
            values = self.enumerator.bank.evaluate_all(self.X[rows], depth)[chosen]
            for problem in self.problems:
                self._sum(problem, chosen, values, rows)

    def _ended_but_for_sums(self) -> bool:
        return self._ended() and self.stopped in ("exact", "deadline")

    def _sum(
        self, problem: Problem, numbers: np.ndarray, values: np.ndarray, rows: np.ndarray
    ) -> None:
        """Fit the best pairs and triples; then again, rows weighted by how well they are explained.

        Without the second time the few large errors of slopes would choose the pairs.
        """
        for robust in (False, True):
            roots = problem.target.weights[rows]
            best = self.pool.best
            if robust and best is not None:
                rest = np.abs(best.residual[rows])
                roots = roots / np.sqrt(1 + (rest / max(2 * np.median(rest), 1e-300)) ** 2)
            gram = make_gram(values, problem, rows, roots / roots.max())
            pairs = best_pairs(gram, _PAIRS)
            triples = best_triples(gram, list(pairs), self.settings.keep)
            for groups in (pairs[: self.settings.keep], triples):
                chosen = [tuple(int(numbers[i]) for i in group) for group in groups]
                self.pool.add(self.finisher.finish(problem, chosen))
            if self._ended_but_for_sums():
                return

    def _front(self) -> ParetoFront:
        return ParetoFront(self.pool.candidates(self.settings.name))


def _spaced(rows: int, count: int) -> np.ndarray:
    """Numbers of at most ``count`` evenly spaced rows."""
    return np.unique(np.linspace(0, rows - 1, min(rows, count)).astype(int))
