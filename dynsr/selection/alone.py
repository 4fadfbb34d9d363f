"""Alone: the formulas of one state, the others read from their smoothed curves.

Three kinds of sums are fitted to one state and sorted by their bits: those that a linear fit ranks
highest, those of terms of a joint, and those with terms of other equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy
from scipy.linalg import LinAlgError

from dynsr.expression import ByText, compile_columns, evaluate, free_constants, skeleton
from dynsr.fit import (
    Collocation,
    Linearised,
    Measurements,
    Probes,
    constant_bits,
    structure_bits,
)
from dynsr.library import write_down
from dynsr.selection.changes import prune
from dynsr.selection.comparison import (
    ComparisonSettings,
    Equations,
    SystemComparison,
    SystemFit,
)
from dynsr.selection.evidence import Evidence
from dynsr.selection.joints import Joint
from dynsr.selection.subsets import best_subsets, solve_scaled
from dynsr.selection.terms import weighted_sum


@dataclass(frozen=True)
class Leader:
    """A formula of one state, and the bits that it takes alone more than the best."""

    expr: sympy.Expr
    behind: float


@dataclass(frozen=True, eq=False)
class Alone:
    """One state fitted by itself, the others read from their smoothed curves.

    Parameters
    ----------
    state : whose equation is sought.
    beside : the equations of the others.
    comparison : the fits.
    told : formulas that were fitted so before, with their bits.
    """

    state: str
    beside: Equations
    comparison: SystemComparison
    told: Mapping[sympy.Expr, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        state: str,
        data: Measurements,
        settings: ComparisonSettings,
        told: Mapping[sympy.Expr, float] | None = None,
    ) -> Alone:
        """Take one state of some data.

        Parameters
        ----------
        state : whose equation is sought.
        data : the measured states, their noise and smoothed curves.
        settings : the numbers that decide.
        told : formulas that were fitted so before, with their bits.
        """
        beside = data.beside(state)
        mesh = data.mesh((*beside, state))
        comparison = SystemComparison(mesh, settings, data.runs[0].states)
        return cls(state, beside, comparison, told or {})

    def rank(self, pool: Iterable[sympy.Expr]) -> dict[sympy.Expr, float]:
        """Give the formulas that can be fitted and their bits, fewest bits first."""
        force = self.comparison.settings.demands.force
        for expr in pool:
            self.comparison.fit({**self.beside, self.state: force(self.state, expr)})
        for fit in self._ranked()[: self.comparison.settings.pruned]:
            prune(self.comparison, fit, self.state)
        return {fit.exprs[self.state]: fit.bits for fit in self._ranked()}

    def lead(
        self, pool: Iterable[sympy.Expr], others: Sequence[tuple[str, sympy.Expr]] = ()
    ) -> list[Leader]:
        """Give those of the formulas that come close to the best.

        Parameters
        ----------
        pool : more formulas.
        others : states and equations of theirs; terms in these cost less.
        """
        before = {skeleton(expr): (expr, bits) for expr, bits in self.told.items()}
        ranked = self.rank(expr for expr in pool if skeleton(expr) not in before)
        known = {**before, **{skeleton(expr): (expr, bits) for expr, bits in ranked.items()}}
        settings, written, found = self.comparison.settings, write_down(others), []
        for expr, bits in known.values():
            less = self.comparison.saved_bits(self.state, expr, written) if others else 0.0
            found.append((expr, bits - less))
        found = sorted(found, key=lambda pair: pair[1])[: settings.together]
        leaders = [Leader(expr, bits - found[0][1]) for expr, bits in found]
        return [one for one in leaders if one.behind <= settings.behind]

    def lead_citing(
        self, own: list[Leader], others: Sequence[tuple[str, sympy.Expr]]
    ) -> list[Leader]:
        """Give the formulas close to the best, also those with terms of other equations.

        Parameters
        ----------
        own : what leads here.
        others : other states, and what leads there.
        """
        evidence = self._evidence()
        if not own or not others or evidence is None:
            return own
        sums = self.comparison.propose(self.state, evidence, others, functions=False)
        return self.lead(sums[: self.comparison.settings.sums], others)

    def fitted(self, bodies: Sequence[sympy.Expr]) -> sympy.Expr | None:
        """Give the sum of all of some terms that a linear fit expects; None where that fails.

        Parameters
        ----------
        bodies : the terms; what others of them say as well has a share of it.
        """
        normal = self._normal(compile_columns(bodies, self.comparison.columns)(*self._points))
        if normal is None:
            return None
        gram, places = normal.gram, list(range(len(bodies)))
        return weighted_sum((-solve_scaled(gram, places, gram[places, -1:])[:, 0]).tolist(), bodies)

    def sums_around(self, angle: str) -> list[sympy.Expr]:
        """Give the sums of terms of a joint that a linear fit ranks highest.

        The denominator is 1 + c sin^2 or 1 + c cos of the angle, with c near one of a few values.

        Parameters
        ----------
        angle : of the joint.
        """
        joint = Joint.of(angle, self.comparison.names)
        allow = self.comparison.settings.demands.limits(self.state).allow
        exprs = [e for e in joint.above if allow(e)]
        bits = np.array([structure_bits(0.5 * e) for e in exprs])
        values = compile_columns(exprs, self.comparison.columns)(*self._points)
        rows, found = self.rows, []
        for below in joint.below:
            line = 1 + below
            normal = None
            if allow(1 / line):
                normal = self._normal(values / evaluate(line, self._named))
            if normal is not None:
                subsets = best_subsets(
                    normal.information,
                    -normal.pull,
                    normal.squares,
                    bits + constant_bits(rows),
                    rows,
                )
                found += [(subset, line) for subset in subsets]
        found.sort(key=lambda pair: (pair[0].bits, pair[0].places, ByText(pair[1])))
        return [
            weighted_sum(subset.coefficients, [exprs[i] for i in subset.places]) / line
            for subset, line in found[: self.comparison.settings.sums]
        ]

    def _evidence(self) -> Evidence | None:
        """Give a view of the equation; None where the data do not determine it."""
        settings, columns = self.comparison.settings, self.comparison.columns
        nodes = settings.proposals.nodes
        return Evidence.of(self._still, columns, self.rows, settings.alone_softness, nodes)

    @cached_property
    def _points(self) -> np.ndarray:
        """Values of all columns, the time the last, at the rows and between them."""
        return self._still.points(self.comparison.mesh.start, np.zeros(0))

    @property
    def _named(self) -> dict[str, np.ndarray]:
        return dict(zip(self.comparison.columns, self._points, strict=True))

    @cached_property
    def _still(self) -> Collocation:
        exprs = {**self.beside, self.state: sympy.S.Zero}
        return Collocation(exprs, self.comparison.mesh, self.comparison.settings.fit)

    @property
    def rows(self) -> float:
        """Measured rows of the state."""
        return float(np.max(self.comparison.mesh.rows))

    def _normal(self, values: np.ndarray) -> Linearised | None:
        """Give the normal equations of terms with these values; None where undetermined."""
        still, mesh = self._still, self.comparison.mesh
        slopes = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
        probes = Probes(np.full(len(values), len(mesh.states) - 1), slopes)
        softness = self.comparison.settings.softness
        try:
            return still.normal(mesh.start, np.zeros(0), probes, softness)
        except LinAlgError:
            return None

    def best(self) -> SystemFit | None:
        """Give the fit of fewest bits."""
        return next(iter(self._ranked()), None)

    def _ranked(self) -> list[SystemFit]:
        return sorted(self.comparison.fits(), key=lambda f: f.bits)

    def propose(self) -> list[sympy.Expr]:
        """Give the sums of terms of the library that are expected to take the fewest bits."""
        evidence = self._evidence()
        if evidence is None:
            return []
        others = [sympy.Symbol(name) for name in self.comparison.names if name != self.state]
        return [sympy.S.Zero, *others, *self.comparison.propose(self.state, evidence)]

    def rank_sums(self) -> dict[sympy.Expr, float]:
        """Give sums of terms of the library and their bits, fewest bits first."""
        return self.rank(self.propose())


def constants(expr: sympy.Expr) -> int:
    """Count the constants of a formula that are fitted."""
    return len(free_constants(expr, "c")[1])
