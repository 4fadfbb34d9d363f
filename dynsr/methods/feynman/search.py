"""DynAIFeynman: all stages of AI Feynman 2.0, and more, on the slopes of a trajectory."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.fit import Candidate, ParetoFront, choose, score_candidate, snap_best
from dynsr.methods.base import AbstractMethod, Report, silent
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, BruteForceStage, SimpleStage
from dynsr.methods.feynman.stages.base import AbstractStage, Context, Surrogate
from dynsr.methods.feynman.stages.domain_change import DOMAIN_CHANGES, DomainChange
from dynsr.methods.feynman.stages.inner_functions import (
    Compositionality,
    GeneralisedSymmetry,
    GeneralSeparability,
)
from dynsr.methods.feynman.stages.polynomial import Polynomial
from dynsr.methods.feynman.stages.reduction import AbstractReducer, Reduce, short
from dynsr.methods.feynman.stages.refinement import Refinement
from dynsr.methods.feynman.stages.separability import Separability
from dynsr.methods.feynman.stages.symmetry import Symmetry
from dynsr.methods.rational import RationalSearch

STAGES = (
    "rational",
    "polynomial",
    "brute force",
    "domain change",
    "symmetry",
    "separability",
    "compositionality",
    "general separability",
    "generalised symmetry",
    "refinement",
    "snapping",
)
SELECTIONS = ("lowest error", "description length")
_DIRECT = ("rational", "polynomial", "brute force")
_EXACT = 1e-9
_PAPER: dict[str, Any] = {
    "stages": tuple(name for name in STAGES if name != "rational"),
    "sparse": False,
    "candidates": 200_000,
    "branches": 1,
    "selection": "lowest error",
    "agreement": 0,
}
_SIMPLE = BruteForce(max_size=3, sums=(), beam=0, combinations=True)


@dataclass(frozen=True)
class RationalStage(AbstractStage):
    """The search for short sums and ratios as a stage; each round goes to the front at once."""

    settings: RationalSearch = field(default_factory=RationalSearch)
    name = "rational"

    def run(self, samples: Samples, context: Context) -> list[Candidate]:
        """Give the best formulas of every size."""
        found: list[Candidate] = []
        total = len(self.settings.costs) * self.settings.rounds
        context.tell(self.name, 0, total)
        seconds = min(self.settings.seconds, 0.4 * context.seconds_left)
        settings = replace(self.settings, seconds=seconds)
        for done, candidates in enumerate(settings.find(samples), start=1):
            found += candidates
            context.offer(candidates)
            context.tell(self.name, done, total)
            if context.seconds_left <= 0:
                break
        return found


@dataclass(frozen=True)
class DynAIFeynman(AbstractMethod):
    """AI Feynman 2.0 (Udrescu et al. 2020) extended to the slopes of trajectories.

    Parameters
    ----------
    stages : which of STAGES are run.
    degree : highest degree of the polynomial fits.
    sparse : also thin the polynomials out.
    epochs : passes over the samples in training the network (the paper: 500).
    candidates : functions that brute force forms at most; a tenth of them on reduced problems.
    branches : reductions followed at each level, surest first.
    max_depth : reductions after each other at most.
    changes : domain changes of the target.
    selection : which of SELECTIONS :meth:`choose` goes by.
    agreement : so many of the direct stages (sums and ratios, polynomials, brute force) whose best
        formulas, refined and snapped, are the same end the search; 0 never ends it early.
    time_budget : seconds after which no new part is begun; by default there is no limit, since a
        limit makes the result depend on the machine's speed.

    Raises InputError when a stage, change or selection is unknown or a bound allows nothing.

    >>> method = DynAIFeynman.preset("paper", epochs=100)
    >>> method.epochs, method.degree, method.selection
    (100, 4, 'lowest error')
    """

    stages: tuple[str, ...] = STAGES
    degree: int = 4
    sparse: bool = True
    epochs: int = 500
    candidates: float = 500_000
    branches: int = 2
    max_depth: int = 2
    changes: tuple[str, ...] = DOMAIN_CHANGES
    selection: str = "description length"
    agreement: int = 2
    time_budget: float | None = None

    name = "dynaifeynman"
    # The paper's is its experiment's: 500 epochs, degree 4, the member of lowest error reported;
    # the caller gives it forward differences.
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
        for change in self.changes:
            if change not in DOMAIN_CHANGES:
                known = ", ".join(DOMAIN_CHANGES)
                raise InputError(f"unknown domain change {change!r}; they are: {known}")
        if self.selection not in SELECTIONS:
            known = ", ".join(SELECTIONS)
            raise InputError(f"unknown selection {self.selection!r}; they are: {known}")
        for bound, least in (("degree", 0), ("epochs", 1), ("candidates", 1), ("branches", 1)):
            if not getattr(self, bound) >= least:
                raise InputError(f"{bound} {getattr(self, bound)!r} must be at least {least}")
        if self.time_budget is not None and not self.time_budget > 0:
            raise InputError(
                f"time_budget {self.time_budget!r} must be a positive number of seconds"
            )

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search; see :meth:`AbstractMethod.search`.

        >>> x = np.linspace(0.5, 2.0, 100)
        >>> samples = Samples(x[:, None], 2 * np.sin(x), ("x",), "x", "given", x)
        >>> front = DynAIFeynman.preset("best").search(samples, np.random.default_rng(0))
        >>> DynAIFeynman.preset("best").choose(front, samples).expr
        2*sin(x)
        """
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
        """Give the member to report, by ``selection``; ValueError on an empty front."""
        return front.best_fit if self.selection == "lowest error" else choose(front, samples)

    def _solve(self, samples: Samples, context: Context) -> list[Candidate]:
        """Run the stages in order until one is exact or several agree."""
        found: list[Candidate] = []
        bests: list[sympy.Expr] = []
        size = float(np.std(samples.y))
        settled = False
        for stage in self._pipeline(samples, context.depth):
            if context.seconds_left <= 0 or context.interrupted:
                break
            if isinstance(stage, Refinement):
                # Beside an exact formula the others need no better constants.
                exact = [c for c in found if c.loss <= _EXACT * size]
                stage = replace(stage, candidates=tuple(exact or found))
            elif settled:
                continue
            context.tell(stage.name, 0, None)
            fresh = stage.run(samples, context)
            found += fresh
            context.offer(fresh)
            settled = bool(found) and min(c.loss for c in found) <= _EXACT * size
            if context.depth == 0 and not settled and stage.name in _DIRECT:
                bests += self._agree(fresh, samples, context)
                settled = bool(bests) and bests.count(bests[-1]) >= self.agreement > 0
        return found

    def _agree(
        self, fresh: list[Candidate], samples: Samples, context: Context
    ) -> list[sympy.Expr]:
        """Snap a stage's best short formula, so that stages can be compared."""
        if not self.agreement or "snapping" not in self.stages:
            return []
        snapped = snap_best(short(fresh), samples, 2)
        context.offer(snapped)
        return [candidate.expr for candidate in snapped[:1]]

    def _pipeline(self, samples: Samples, depth: int) -> list[AbstractStage]:
        polynomial = Polynomial(self.degree, self.sparse and depth == 0)
        rational = RationalSearch() if depth == 0 else RationalSearch(costs=(3,), rounds=1)
        brute = BruteForce(max_candidates=self.candidates)
        if depth:
            fewer = max(1.0, 0.1 * self.candidates)
            brute = replace(brute, max_candidates=fewer, sums=(50,), keep=6)
        stages: dict[str, AbstractStage] = {
            "rational": RationalStage(rational),
            "polynomial": polynomial,
            "brute force": BruteForceStage(brute),
        }
        if depth == 0 or samples.X.shape[1] == 1:
            inner = Polynomial(self.degree, False)
            stages["domain change"] = DomainChange((inner,), self.changes)
        pipeline = [stage for name, stage in stages.items() if name in self.stages]
        # The paper's own stages know neither sums and ratios nor laws of one combination.
        if depth == 0 and {"rational", "brute force"} <= set(self.stages):
            pipeline.insert(0, SimpleStage(_SIMPLE))
        pipeline.append(Reduce(self._reducers(), self.branches, self.max_depth))
        if depth == 0 and {"refinement", "snapping"} & set(self.stages):
            pipeline.append(Refinement("snapping" in self.stages))
        return pipeline

    def _reducers(self) -> tuple[AbstractReducer, ...]:
        every = (
            Symmetry(),
            Separability(),
            Compositionality(),
            GeneralSeparability(),
            GeneralisedSymmetry(),
        )
        return tuple(reducer for reducer in every if reducer.name in self.stages)

    def _train(self, samples: Samples, context: Context) -> Surrogate:
        """Train the network; on reduced problems with half the epochs, as AI Feynman does."""
        # Torch takes seconds to import and is wanted by this one stage.
        from dynsr.methods.feynman.network import fit_network

        return fit_network(samples, context.rng, max(1, self.epochs >> min(context.depth, 1)))
