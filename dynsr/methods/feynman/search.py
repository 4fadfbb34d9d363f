"""DynAIFeynman: all stages of AI Feynman 2.0, and more, on the slopes of a trajectory."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import Samples
from dynsr.errors import InputError, MissingExtra, need
from dynsr.fit import Candidate, ParetoFront, choose, score_candidate, snap_best
from dynsr.methods.base import AbstractMethod, Report, silent
from dynsr.methods.feynman.enumeration.brute_force import BruteForce
from dynsr.methods.feynman.stages.base import (
    AbstractStage,
    Context,
    NetworkSettings,
    Surrogate,
)
from dynsr.methods.feynman.stages.brute_force import Enumeration
from dynsr.methods.feynman.stages.domain_change import DomainChange
from dynsr.methods.feynman.stages.inner_functions import (
    Compositionality,
    GeneralisedSymmetry,
    GeneralSeparability,
)
from dynsr.methods.feynman.stages.polynomial import Polynomial
from dynsr.methods.feynman.stages.rational import Rational
from dynsr.methods.feynman.stages.reduction import AbstractReducer, Reach, Reduce, short
from dynsr.methods.feynman.stages.refinement import Refinement
from dynsr.methods.feynman.stages.separability import Separability
from dynsr.methods.feynman.stages.symmetry import Symmetry
from dynsr.methods.limits import Limits
from dynsr.methods.parts import part, read_state, write_state
from dynsr.methods.rational import RationalSearch

# Stages that look at the samples as they are.
DIRECT_STAGES = (
    "simple functions",
    "sums of powers",
    "sums of functions",
    "rational",
    "polynomial",
    "brute force",
)
# Stages whose best formulas are compared; the first is over before anything can be learned from it.
_COMPARED = DIRECT_STAGES[1:]
# Stages that need the network, and with it torch.
NETWORK_STAGES = (
    "symmetry",
    "separability",
    "compositionality",
    "general separability",
    "generalised symmetry",
)
STAGES = (*DIRECT_STAGES, "domain change", *NETWORK_STAGES, "refinement", "snapping")
SELECTIONS = ("lowest error", "description length")


# The paper's is its experiment's: 500 epochs, degree 4, the member of lowest error reported; the
# caller gives it forward differences. Its stages know neither sums and ratios nor laws of one
# combination.
_PAPER: dict[str, Any] = {
    "stages": tuple(stage for stage in STAGES if stage not in DIRECT_STAGES[:4]),
    "exact_values": None,
    "polynomial": Polynomial(sparse=False),
    "candidates": 200_000,
    "branches": 1,
    "selection": "lowest error",
    "agreement": 0,
}


@dataclass(frozen=True)
class ExactStages:
    """Stages for values that may be exact, in their order; an exact formula ends them.

    They run on samples of scheme "given". The slopes of a trajectory carry the errors of their
    differences, so that no formula is exact and an enumeration of millions would follow the errors.

    Parameters
    ----------
    simple_functions : the short enumeration, laws of one product of powers first.
    sums_of_powers : sums and ratios of products of powers, of the target's square and inverse too.
    sums_of_functions : sums of products with sines, exponentials, logarithms and roots.
    brute_force : the long enumeration.
    simple_share : share of the time left, 0 to 1, that the short enumeration takes at most.
    share : the same for each of the others.
    """

    simple_functions: BruteForce = BruteForce(max_candidates=1e5, ratios=True, combinations=True)
    sums_of_powers: RationalSearch = RationalSearch(
        costs=(4,), rounds=1, width=64, inverses=True, changes=("square", "inv")
    )
    sums_of_functions: RationalSearch = RationalSearch(
        costs=(6,),
        rounds=1,
        width=64,
        denominators=False,
        max_features=2500,
        changes=("square",),
    )
    brute_force: BruteForce = BruteForce(
        max_candidates=2.5e6, changes=("square",), ratios=True, keep=8
    )
    simple_share: float = 0.4
    share: float = 0.9

    def within(self, limits: Limits) -> ExactStages:
        """Give the stages as they search within limits."""
        return replace(
            self,
            simple_functions=self.simple_functions.within(limits),
            sums_of_powers=self.sums_of_powers.within(limits),
            sums_of_functions=self.sums_of_functions.within(limits),
            brute_force=self.brute_force.within(limits),
        )


@checked
@dataclass(frozen=True)
class DynAIFeynman(AbstractMethod):
    """AI Feynman 2.0 (Udrescu et al. 2020) extended to the slopes of trajectories.

    Stages run in the order of STAGES until a formula is exact or several stages agree.

    Parameters
    ----------
    stages : which of STAGES are run.
    simple_functions : the enumeration of the smallest functions, which comes first.
    rational : sums and ratios of features, robust against a few large errors of slopes.
    polynomial : all monomials up to a degree; on reduced problems without thinning out.
    brute_force : the enumeration.
    exact_values : settings of the stages that run before these on values that may be exact; its
        enumerations replace those above.
    reduced : the enumeration on reduced problems.
    candidates : functions that any enumeration forms at most; a tenth of them on reduced problems.
    domain_change : searches for functions of the target.
    epochs : passes over the samples in training the network (the paper: 500); halved with every
        reduction.
    network : layers and training of the network.
    reducers : the tests for symmetries, separability and inner functions, with their tolerances.
    reach : where among the samples the network is believed.
    branches : reductions followed at each level, surest first.
    max_depth : reductions after each other at most.
    refinement : which formulas get better constants.
    max_constants : formulas of more free constants do not count when stages are compared, nor as
        explanations that make the network needless.
    selection : which of SELECTIONS :meth:`choose` goes by.
    exact : RMSE, in standard deviations of the target, at which a formula ends the search.
    agreement : so many of DIRECT_STAGES whose best formulas, refined and snapped, are the same end
        the search; 0 never ends it early.
    time_budget : seconds after which nothing further is begun; by default there is no limit, since
        a limit makes the result depend on the machine's speed.

    Raises InputError when a stage or selection is unknown or a bound allows nothing.

    >>> method = DynAIFeynman.preset("paper", epochs=100)
    >>> method.epochs, method.polynomial.degree, method.selection
    (100, 4, 'lowest error')
    """

    stages: tuple[str, ...] = STAGES
    simple_functions: BruteForce = BruteForce(max_size=3, sums=(), beam=0, combinations=True)
    rational: RationalSearch = RationalSearch()
    polynomial: Polynomial = Polynomial()
    brute_force: BruteForce = BruteForce(max_candidates=5e5)
    exact_values: ExactStages | None = ExactStages()
    reduced: BruteForce = BruteForce(max_candidates=5e4, sums=(50,), keep=6)
    candidates: float = math.inf
    domain_change: DomainChange = DomainChange((Polynomial(sparse=False),))
    epochs: int = 500
    network: NetworkSettings = NetworkSettings()
    reducers: tuple[AbstractReducer, ...] = (
        Symmetry(),
        Separability(),
        Compositionality(),
        GeneralSeparability(),
        GeneralisedSymmetry(),
    )
    reach: Reach = Reach()
    branches: int = 2
    max_depth: int = 2
    refinement: Refinement = Refinement()
    max_constants: int = 8
    selection: str = "description length"
    exact: float = 1e-9
    agreement: int = 2
    time_budget: float | None = None

    name = "dynaifeynman"
    presets: ClassVar = {
        "best": {},
        "quick": {**_PAPER, "epochs": 100, "candidates": 50_000, "max_depth": 1},
        "paper": _PAPER,
    }

    def __post_init__(self) -> None:
        """Check the settings."""
        for stage in self.stages:
            if stage not in STAGES:
                raise InputError(f"unknown stage {stage!r}; the stages are: {', '.join(STAGES)}")
        if self.selection not in SELECTIONS:
            known = ", ".join(SELECTIONS)
            raise InputError(f"unknown selection {self.selection!r}; they are: {known}")
        for bound in ("epochs", "candidates", "branches"):
            if not getattr(self, bound) >= 1:
                raise InputError(f"{bound} {getattr(self, bound)!r} must be at least 1")
        if self.time_budget is not None and not self.time_budget > 0:
            raise InputError(
                f"time_budget {self.time_budget!r} must be a positive number of seconds"
            )

    def within(self, limits: Limits) -> DynAIFeynman:
        """Give the search whose every stage keeps to what is allowed; see AbstractMethod."""
        most = limits.most_terms(self.polynomial.max_terms)
        exact = self.exact_values
        return replace(
            self,
            simple_functions=self.simple_functions.within(limits),
            rational=self.rational.within(limits),
            polynomial=replace(self.polynomial, max_terms=most),
            brute_force=self.brute_force.within(limits),
            exact_values=None if exact is None else exact.within(limits),
            # A reduced problem has columns of its own.
            reduced=self.reduced.within(replace(limits, terms=(), left_out=())),
            domain_change=self.domain_change.within(limits),
            reducers=tuple(reducer.within(limits) for reducer in self.reducers),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What this search leaves out here: the network's stages, where torch is not installed."""
        missing = self._missing_network()
        if missing is None or not self._reducers():
            return ()
        return (f"{', '.join(r.name for r in self._reducers())} did not run: {missing}",)

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; see :meth:`AbstractMethod.search`.

        Raises MissingExtra when all the stages chosen need the network and torch is not installed.

        >>> x = np.linspace(0.5, 2.0, 100)
        >>> samples = Samples(x[:, None], 2 * np.sin(x), ("x",), "x", "given", x)
        >>> front = DynAIFeynman.preset("best").search(samples, np.random.default_rng(0))
        >>> DynAIFeynman.preset("best").choose(front, samples).expr
        2*sin(x)
        """
        missing = self._missing_network()
        if missing is not None and self._reducers():
            if not {*DIRECT_STAGES, "domain change"} & set(self.stages):
                raise missing
            stages = tuple(stage for stage in self.stages if stage not in NETWORK_STAGES)
            return replace(self, stages=stages).search(samples, rng, report)
        budget = math.inf if self.time_budget is None else self.time_budget
        context = Context(
            rng,
            time.monotonic() + budget,
            report,
            solve=self._solve,
            surrogate=self._train,
        )
        # A constant, so that even a search that was stopped at once has an answer.
        mean = sympy.Float(float(np.mean(samples.y)))
        context.offer([score_candidate(mean, samples, "mean")])
        try:
            if np.ptp(samples.y) > 0:
                self._solve(samples, context)
        except KeyboardInterrupt:
            pass
        return context.front

    def choose(self, front: ParetoFront, samples: Samples) -> Candidate:
        """Give the member of a front to report, by ``selection`` and the samples it was found on.

        Raises ValueError on an empty front.
        """
        return front.best_fit if self.selection == "lowest error" else choose(front, samples)

    def _solve(self, samples: Samples, context: Context) -> list[Candidate]:
        """Run the stages in order until one is exact or several agree; then refine."""
        found: list[Candidate] = []
        bests: list[sympy.Expr] = []
        limit = self.exact * float(np.std(samples.y))
        for stage in self._pipeline(samples, context.depth):
            if context.seconds_left <= 0 or context.interrupted:
                return found
            make = partial(self._run, stage, samples, context, limit)
            ended = part(stage.name, _Ended, make, lambda _: not context.interrupted)
            fresh = ended.bring_back(context)
            found += fresh
            if any(c.loss <= limit for c in fresh):
                break
            bests += ended.bests
            if bests and bests.count(bests[-1]) >= self.agreement > 0:
                break
        if context.depth or not {"refinement", "snapping"} & set(self.stages):
            return found
        if context.seconds_left > 0 and not context.interrupted:
            # Beside an exact formula the others need no better constants.
            context.found = tuple([c for c in found if c.loss <= limit] or found)
            context.tell("refinement", 0, None)
            refined = self.refinement
            refined = replace(refined, snapping=refined.snapping and "snapping" in self.stages)
            ended = part(
                "refinement",
                _Ended,
                lambda: _Ended.of(refined.run(samples, context), context),
                lambda _: not context.interrupted,
            )
            context.offer(ended.bring_back(context))
        return found

    def _run(
        self, stage: AbstractStage, samples: Samples, context: Context, limit: float
    ) -> _Ended:
        """Run one stage, and compare the best that it found with those of other stages."""
        context.tell(stage.name, 0, None)
        fresh = stage.run(samples, context)
        context.offer(fresh)
        bests: list[sympy.Expr] = []
        exact = any(c.loss <= limit for c in fresh)
        if context.depth == 0 and stage.name in _COMPARED and not exact:
            bests = self._compare(fresh, samples, context)
        return _Ended.of(fresh, context, bests)

    def _compare(
        self, fresh: list[Candidate], samples: Samples, context: Context
    ) -> list[sympy.Expr]:
        """Snap a stage's best short formula, so that stages can be compared."""
        if not self.agreement or "snapping" not in self.stages:
            return []
        snapped = snap_best(short(fresh, self.max_constants), samples, 2)
        context.offer(snapped)
        return [candidate.expr for candidate in snapped[:1]]

    def _pipeline(self, samples: Samples, depth: int) -> list[AbstractStage]:
        """Give the stages that search, in their order, for a problem or one reduced from it."""
        every: list[AbstractStage]
        exact = self.exact_values
        if depth:
            every = [
                Rational(replace(self.rational, costs=(3,), rounds=1, terms=(), left_out=())),
                replace(self.polynomial, sparse=False),
                self._enumerate("brute force", self.reduced, cap=0.1),
            ]
        elif exact and samples.scheme == "given":
            every = [
                self._enumerate("simple functions", exact.simple_functions, exact.simple_share),
                Rational(exact.sums_of_powers, exact.share, "sums of powers"),
                Rational(exact.sums_of_functions, exact.share, "sums of functions"),
                self._enumerate("brute force", exact.brute_force, exact.share),
                Rational(self.rational),
                self.polynomial,
            ]
        else:
            every = [
                self._enumerate("simple functions", self.simple_functions),
                Rational(self.rational),
                self.polynomial,
                self._enumerate("brute force", self.brute_force),
            ]
        if depth == 0 or samples.X.shape[1] == 1:
            every.append(self.domain_change)
        chosen = [stage for stage in every if stage.name in self.stages]
        reduce = Reduce(
            self._reducers(), self.branches, self.max_depth, self.max_constants, self.reach
        )
        return [*chosen, reduce]

    def _enumerate(
        self, name: str, settings: BruteForce, share: float = 0.5, cap: float = 1.0
    ) -> Enumeration:
        """Give an enumeration of at most a part ``cap`` of ``candidates``."""
        most = min(settings.max_candidates, max(1.0, cap * self.candidates))
        return Enumeration(replace(settings, max_candidates=most), share, name)

    def _reducers(self) -> tuple[AbstractReducer, ...]:
        return tuple(reducer for reducer in self.reducers if reducer.name in self.stages)

    def _missing_network(self) -> MissingExtra | None:
        try:
            need("torch", "torch", "the network of DynAIFeynman")
        except MissingExtra as missing:
            return missing
        return None

    def _train(self, samples: Samples, context: Context) -> Surrogate:
        """Train the network; on reduced problems with half the epochs, as AI Feynman does."""
        # Torch takes seconds to import and is wanted by this one stage.
        from dynsr.methods.feynman.network import fit_network, read_network

        epochs = max(1, self.epochs >> min(context.depth, 1))

        def train() -> _Trained:
            network = fit_network(samples, context.rng, epochs, self.network)
            return _Trained(*network.write(), write_state(context.rng))

        trained = part("network", _Trained, train)
        read_state(context.rng, trained.state)
        return read_network(
            samples, trained.weights, trained.validation_error, trained.epochs, self.network
        )


@dataclass(frozen=True)
class _Ended:
    """What a stage that has ended leaves, as it is kept."""

    found: tuple[Candidate, ...]
    front: tuple[Candidate, ...]
    bests: tuple[sympy.Expr, ...]
    state: str

    @classmethod
    def of(
        cls, found: Sequence[Candidate], context: Context, bests: Sequence[sympy.Expr] = ()
    ) -> _Ended:
        return cls(tuple(found), tuple(context.front), tuple(bests), write_state(context.rng))

    def bring_back(self, context: Context) -> list[Candidate]:
        """Give the formulas, and bring the search to where it was behind the stage."""
        context.front = ParetoFront(self.front)
        read_state(context.rng, self.state)
        return list(self.found)


@dataclass(frozen=True)
class _Trained:
    """A network as it is kept."""

    weights: str
    validation_error: float
    epochs: int
    state: str
