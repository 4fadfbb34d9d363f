"""Brute force: every function up to a size looked at once, in order of size.

One search runs over levels, sums and beams, with the bounds that end it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.fit import Candidate, ParetoFront, cauchy_weights
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.feynman.enumeration.alphabet import UNARY, count_strings, make_letters
from dynsr.methods.feynman.enumeration.backend import choose_backend
from dynsr.methods.feynman.enumeration.finishing import Finisher, Finishing, Found, Pool
from dynsr.methods.feynman.enumeration.formation import Enumerator
from dynsr.methods.feynman.enumeration.power_laws import (
    Combinations,
    CombinationSearch,
    find_exponents,
    find_nested,
)
from dynsr.methods.feynman.enumeration.screening import Screen, Shortlist
from dynsr.methods.feynman.enumeration.sums import Beam, best_pairs, best_triples, make_gram
from dynsr.methods.feynman.problem import CHANGES, Problem, make_problems
from dynsr.methods.limits import Limits
from dynsr.methods.own_terms import extend_samples


@dataclass(frozen=True)
class BruteForceResult:
    """What a search found, and how much it looked at.

    Parameters
    ----------
    candidates : formulas for y, simplest first: the Pareto fronts in RMSE and in error bits, and
        the best in error bits in addition.
    formed : functions evaluated, repetitions included.
    distinct : functions tested, each once up to an affine map.
    covered : strings in reverse Polish notation over the same letters of up to ``complete``
        letters; every one is equal to a function looked at or has no finite values on the samples.
    complete : largest size of which every function was looked at.
    stored : functions kept to build on, in ``nbytes`` bytes (tables of hashes included).
    stopped : what ended it: "exact", "size", "candidates", "deadline", "stable" or "interrupted".
    seconds : time taken.
    device : where the arrays lived: "numpy", or "torch:" and the device.
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
    device: str

    @property
    def front(self) -> ParetoFront:
        """The Pareto front of complexity against RMSE."""
        return ParetoFront(self.candidates)


class RunningSearch:
    """One running search: what was formed, what was found, and which bound ended it."""

    def __init__(
        self,
        X: np.ndarray,
        y: np.ndarray,
        names: tuple[str, ...],
        settings: BruteForce,
        watch: Watch,
    ) -> None:
        """Take finite (n, p) and (n,) values."""
        self.X, self.y, self.settings, self.watch = X, y, settings, watch
        self.started = time.monotonic()
        self.letters, self.nested = make_letters(settings.operators, settings.nested)
        leaves = [sympy.Symbol(name) for name in names] + [parse(c) for c in settings.constants]
        self.leaves = len(leaves)
        ratios = leaves[: len(names)] if settings.ratios else []
        self.problems = make_problems(X, y, settings.changes, settings.monomials, ratios)
        self.probes = probes = _spaced(len(y), settings.probes)
        backend = choose_backend(settings.device)
        self.screen = Screen(self.problems, probes, backend)
        self.enumerator = Enumerator(
            X[probes],
            leaves,
            self.letters,
            self.nested,
            backend,
            int(settings.max_memory * 2**20),
            int(settings.powers_up_to),
        )
        self.finisher = Finisher(self.enumerator.bank, X, y, settings.finishing)
        self.pool = Pool(settings.finishing)
        self.stopped = ""
        self.sums_done = self.stable = 0
        self.shortest: Found | None = None
        self.near: dict[str, list[tuple[int, int, int]]] = {}

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
            device=self.screen.backend.name,
        )

    def _run(self) -> None:
        settings = self.settings
        for problem in self.problems:
            self.pool.add(self.finisher.finish(problem, [()]))
        if settings.ratios:
            self.pool.add(
                find_nested(self.X, self.y, self.enumerator.bank.leaves, settings.finishing)
            )
        if settings.combinations and not self._must_stop():
            self._try_combination()
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
                settings.beam > 0,
            )
            self._finish(shortlist)
            self._notice_stability()
            if self._try_sums(size):
                self._notice_stability()
            if size == settings.max_size or self.enumerator.stopped == "candidates":
                self._try_beam()
            self.watch(self)
        if not self._ended():
            self.stopped = "size"

    def _try_combination(self) -> None:
        """Search for a law of one product of powers of the variables."""
        settings = self.settings
        exponents = find_exponents(self.X, self.y, settings.combination, settings.finishing)
        if exponents is not None:
            symbols, operators = self.enumerator.bank.leaves, settings.operators
            law = CombinationSearch(
                self.X,
                self.y,
                symbols[: self.X.shape[1]],
                exponents,
                operators,
                self.screen.backend,
                settings.combination,
                settings.finishing,
            )
            exact = self.settings.exact * float(np.abs(self.y).max())
            self.pool.add(law.run(self.started + self.settings.seconds, exact))

    def _notice_stability(self) -> None:
        """Count the parts through which the shortest formula stays the same."""
        if not self.settings.patience:
            return
        shortest = self.pool.shortest
        same = shortest is not None and shortest.resembles(self.shortest)
        self.shortest, self.stable = shortest, self.stable + 1 if same else 0
        summed = self.sums_done or not self.settings.sums
        if summed and self.stable >= self.settings.patience:
            self.stopped = self.stopped or "stable"

    def _ended(self) -> bool:
        """Whether a bound is met; says which in ``stopped``."""
        if not self._must_stop() and self.enumerator.stopped:
            self.stopped = self.enumerator.stopped
        return bool(self.stopped)

    def _must_stop(self) -> bool:
        """Whether nothing further is to be begun: a formula is exact, or the time is over."""
        best = self.pool.best
        if best is not None and best.loss <= self.settings.exact * float(np.abs(self.y).max()):
            self.stopped = "exact"
        elif time.monotonic() > self.started + self.settings.seconds:
            self.stopped = "deadline"
        return self.stopped in ("exact", "deadline", "stable")

    def _finish(self, shortlist: Shortlist) -> None:
        bank = self.enumerator.bank
        for place, problem in enumerate(self.problems):
            winners = shortlist.winners(place)
            self.near[problem.name] = [*winners[:8], *self.near.get(problem.name, [])]
            numbers = [(bank.number(*winner),) for winner in winners]
            self.pool.add(self.finisher.finish(problem, numbers))

    def _try_sums(self, size: int) -> bool:
        """Try all pairs of the next number of functions, once 3/4 are there or no more come."""
        before = self.sums_done
        levels = self.enumerator.bank.levels
        fresh = [level.start + np.flatnonzero(level.fresh) for level in levels]
        numbers = np.concatenate(fresh)
        over = size == self.settings.max_size or bool(self.enumerator.stopped)
        for count in self.settings.sums[self.sums_done :]:
            if (4 * len(numbers) < 3 * count and not over) or self._must_stop():
                break
            self.sums_done += 1
            rows = _spaced(len(self.y), self.settings.sum_rows)
            chosen = numbers[:count]
            depth = sum(level.start <= chosen[-1] for level in levels)
            values = self.enumerator.bank.evaluate_all(self.X[rows], depth)[chosen]
            for problem in self.problems:
                if problem.by_log or not problem.powers:
                    self._sum(problem, chosen, values, rows)
        return self.sums_done > before

    def _try_beam(self) -> None:
        """Add any stored function to the simplest ones and to the best; then once more."""
        if not self.settings.beam:
            return
        bank, keep = self.enumerator.bank, self.settings.keep
        deadline = self.started + self.settings.seconds
        beam = Beam(bank, self.X[self.probes], self.probes, self.screen.backend, deadline)
        # Sums are most probable in the target itself or its ratio to a variable.
        for problem in sorted(self.problems, key=lambda p: p.target.change.name != "y"):
            if self._must_stop():
                return
            near = [
                bank.number(*winner) for winner in self.near[problem.name][: self.settings.beam]
            ]
            starts = dict.fromkeys([*beam.singles(self.settings.beam), *((n,) for n in near)])
            pairs = beam.extend(problem, list(starts), 2 * keep)
            self.pool.add(self.finisher.finish(problem, pairs))
            if self._must_stop():
                return
            triples = beam.extend(problem, [*pairs, *beam.pairs(self.settings.starts)], keep)
            self.pool.add(self.finisher.finish(problem, triples))

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
                unit = max(2 * float(np.median(rest)), 1e-300)
                roots = roots * np.sqrt(cauchy_weights(rest, unit))
            gram = make_gram(values, problem, rows, roots / roots.max())
            pairs = best_pairs(gram, self.settings.pairs)
            triples = best_triples(gram, list(pairs), self.settings.keep)
            for groups in (pairs[: self.settings.keep], triples):
                chosen = [tuple(int(numbers[i]) for i in group) for group in groups]
                self.pool.add(self.finisher.finish(problem, chosen))
            if self._must_stop():
                return

    @property
    def formed(self) -> int:
        """Functions evaluated so far, repetitions included."""
        return self.enumerator.formed

    @property
    def front(self) -> ParetoFront:
        """What was found so far, written out at every call."""
        return ParetoFront(self.pool.candidates(self.settings.name))


Watch = Callable[[RunningSearch], None]


def unwatched(running: RunningSearch) -> None:
    """Look at nothing."""


def _spaced(rows: int, count: int) -> np.ndarray:
    """Numbers of at most ``count`` evenly spaced rows."""
    return np.unique(np.linspace(0, rows - 1, min(rows, count)).astype(int))


@dataclass(frozen=True)
class BruteForce(AbstractMethod):
    """Search for y = f(X) by enumeration of functions.

    Parameters
    ----------
    operators : tokens of the functions' letters.
    constants : numbers that are leaves, as the variables are.
    nested : allow a function inside one of its own family, such as sin(x + cos(y)).
    changes : domain changes of the target, names of ``domain.CHANGES``.
    monomials : fit power laws and exponentials times a power law too.
    max_size : most letters of a function.
    max_candidates : functions formed at most. This bound does not depend on the machine's speed.
    max_memory : megabytes for stored functions and tables of hashes; when they would take more,
        nothing further is stored and only what is stored goes on being combined.
    seconds : time after which no further part is begun.
    probes : rows on which functions are distinguished and screened.
    keep : functions of each level and problem that are fitted on all rows.
    sums : numbers of simplest functions of which all pairs are tried as sums, in turn; () for none.
    beam : numbers of simplest functions and of best ones to which every stored function is added at
        the end, and to the best of those once more; 0 for none.
    patience : parts (a level, or sums of its functions) through which the formula of least
        description length stays the same, sums included or before, until the search ends as
        "stable"; 0 goes on to the other bounds.
    ratios : search for y / v and v / y too, for each variable v that is nowhere 0.
    combinations : search for laws of one product of powers of the variables first.
    combination : how those are searched.
    finishing : how the functions that were chosen become formulas.
    exact : RMSE, in units of the largest |y|, at which a formula ends the search.
    sum_rows : rows on which pairs are compared.
    pairs : best pairs that triples are grown from.
    starts : simplest functions of which all pairs are starts of triples.
    powers_up_to : functions formed up to this many are tried in the power law too, whose logarithms
        cost more than all other tests.
    device : where the arrays live, see ``backend.choose_backend``.
    terms : formulas in the columns that are leaves too.

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
    beam: int = 48
    patience: int = 0
    ratios: bool = False
    combinations: bool = False
    combination: Combinations = Combinations()
    finishing: Finishing = Finishing()
    exact: float = 1e-10
    sum_rows: int = 500
    pairs: int = 48
    starts: int = 8
    powers_up_to: int = 400_000
    device: str = "auto"
    terms: tuple[sympy.Expr, ...] = ()

    name = "brute force"

    def __post_init__(self) -> None:
        """Refuse bounds that allow nothing."""
        make_letters(self.operators, self.nested)
        for field_name in ("max_size", "max_candidates", "max_memory", "seconds", "keep"):
            value = getattr(self, field_name)
            if not value > 0:
                raise InputError(f"{field_name} {value!r} must be greater than 0")
        if self.probes < 8:
            raise InputError(f"probes {self.probes!r} are too few to distinguish functions; give 8")

    def within(self, limits: Limits) -> BruteForce:
        """Give the enumeration of what is allowed; see AbstractMethod.

        Power laws have exponents of any kind: they are searched where such powers are allowed.
        """
        vocabulary, changed = limits.vocabulary, replace(self, terms=limits.terms)
        if vocabulary is None:
            return changed
        return replace(
            changed,
            operators=limits.tokens(self.operators, UNARY),
            changes=tuple(c for c in self.changes if vocabulary.has(CHANGES[c].back)),
            monomials=self.monomials and vocabulary.power,
            combinations=self.combinations and vocabulary.power,
            ratios=self.ratios and vocabulary.power and vocabulary.divide,
        )

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; ``rng`` is not used, since nothing here is left to chance."""

        def tell(running: RunningSearch) -> None:
            report(Progress(self.name, running.formed, None, running.front))

        watch = unwatched if report is silent else tell
        return ParetoFront(search_samples(samples, self, watch).candidates)


def search_samples(samples: Samples, settings: BruteForce, watch: Watch) -> BruteForceResult:
    """Search on samples and on the columns that the settings' terms add to them.

    Parameters
    ----------
    samples : the rows.
    settings : those of the enumeration.
    watch : is called with the running search after every size.
    """
    wider = extend_samples(samples, settings.terms)
    result = search_values(wider.samples.X, samples.y, wider.samples.names, settings, watch)
    return replace(result, candidates=tuple(wider.bring_back(result.candidates)))


def search_values(
    X: np.ndarray,
    y: np.ndarray,
    names: Sequence[str],
    settings: BruteForce | None = None,
    watch: Watch = unwatched,
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
        raise InputError("X or y has a value that is not finite; drop those rows")
    return RunningSearch(X, y, tuple(names), settings or BruteForce(), watch).run()
