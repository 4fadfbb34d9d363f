"""Brute force worth the name: every function up to a size looked at once, in order of size.

Bottom-up, in batches: each level combines the distinct functions of the simpler ones; values on a
few probe rows tell whether a function was met before (up to an affine map) and how well it fits
every problem of :mod:`dynsr.methods.feynman.problem`, constants in closed form. Only the best few
of a level are then fitted on all rows. AI Feynman (Udrescu and Tegmark 2020, section II.C) counts
through strings instead, one at a time and with one free constant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynsr.errors import InputError
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.feynman.alphabet import make_letters
from dynsr.methods.feynman.running import BruteForceResult, RunningSearch
from dynsr.methods.feynman.stage import AbstractStage, Context
from dynsr.pareto import Candidate, ParetoFront
from dynsr.samples import Samples


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
    beam : numbers of simplest functions and of best ones to which every stored function is added at
        the end, and to the best of those once more; 0 for none.
    patience : parts (a level, or sums of its functions) through which the formula of least
        description length stays the same, sums among them or before, until the search ends as
        "settled"; 0 goes on to the other bounds.
    ratios : search for y / v and v / y too, for each variable v that is nowhere 0.
    combinations : search for laws of one product of powers of the variables first.
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
    beam: int = 48
    patience: int = 0
    ratios: bool = False
    combinations: bool = False
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


class SimpleStage(BruteForceStage):
    """The simplest functions and laws of one combination: over at once, and often enough."""

    name = "simple functions"


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
    return RunningSearch(X, y, tuple(names), settings or BruteForce(), report).run()
