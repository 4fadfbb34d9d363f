"""Found: what a discovery gives back, to read, simulate, score, export and keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy

from dynsr.pareto import ParetoFront
from dynsr.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Discovery:
    """The equations found for the states of a system, with everything that led to them.

    ``equations`` state -> right-hand side (SymPy); ``front`` state -> all formulas found, from
    simple to accurate; ``errors`` state -> (value, standard error) of its constants in order;
    ``explanation`` state -> why this equation was chosen, in words.
    """

    equations: dict[str, sympy.Expr]
    errors: dict[str, tuple[tuple[float, float], ...]]
    front: dict[str, ParetoFront]
    explanation: dict[str, str]
    trajectories: tuple[Trajectory, ...] = ()
    inputs: Mapping[str, sympy.Expr] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
