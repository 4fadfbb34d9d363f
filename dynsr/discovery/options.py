"""Options: what a call of discover asks for, in one object that every search reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import sympy

from dynsr import __version__
from dynsr.data import Missing, Trajectory, in_formulas, take_trajectories
from dynsr.discovery.orders import Order
from dynsr.discovery.problem import DISCOVERY, DiscoverySettings
from dynsr.discovery.records import say_data
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine
from dynsr.errors import InputError
from dynsr.fit import LossFunction
from dynsr.jobs import RunFolder, Step, fingerprint, to_plain
from dynsr.methods import (
    AUTO,
    DEFAULT_PRESET,
    AbstractMethod,
    Constraints,
    Demands,
    Must,
    read_demands,
)
from dynsr.verdict import record_hold

if TYPE_CHECKING:
    from dynsr.discovery.result import Discovery
    from dynsr.discovery.start import Start

# What is said of the columns before they are read, and what names columns afterwards.
_COLUMNS = (
    "time", "states", "trajectory", "quantity", "decimal", "missing", "doses", "noise", "limits",
)  # fmt: skip
_NAMING = (
    "targets", "hold", "known", "slopes", "order", "must", "constraints", "nonnegative", "units",
    "vary", "observed",
)  # fmt: skip
# What is asked of the equations themselves.
_DEMANDS = (
    "functions", "max_complexity", "terms", "must", "constraints", "conserved", "nonnegative",
)  # fmt: skip
# What says how equations of slopes are searched in states that were all measured, without noise in
# their motion and without a function that is free.
OF_PLAIN: tuple[str, ...] = (
    "slopes", "scheme", "order", "explicit_time", "discrete", "conserved", "units", "loss", "start",
)  # fmt: skip
# What the call as a whole does, and none of the searches in it.
_OF_THE_CALL = ("vary", "delays", "hidden", "stochastic", "ensemble", "observed")
# What says no more than the default does.
_USUAL = {"method": AUTO, "targets": "all", "order": 1, "loss": "squared"}


@dataclass(frozen=True, eq=False)
class Options:
    """The arguments of :func:`dynsr.discover` but the data; each is explained there.

    A search within another one has the same options with a few of them replaced.

    >>> replace(Options(seed=3), out="results").seed
    3
    """

    time: float | str | Sequence[Any] | None = None
    states: Sequence[str] | str | None = None
    trajectory: Sequence[str] | str | None = None
    quantity: str | None = None
    decimal: str | None = None
    missing: Missing | None = None
    method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO
    preset: str = DEFAULT_PRESET
    targets: str | Sequence[str] = "all"
    inputs: Mapping[str, Any] | Sequence[str] | str | None = None
    hold: Mapping[str, str] | str | None = None
    doses: Mapping[str, str] | None = None
    noise: Mapping[str, Any] | None = None
    limits: Mapping[str, Any] | None = None
    observed: Mapping[str, str | sympy.Expr] | None = None
    known: Mapping[str, str | sympy.Expr] | None = None
    seed: int = 0
    jobs: int = -1
    engine: str | AbstractEngine = DEFAULT_ENGINE
    scheme: str | None = None
    slopes: Mapping[str, Any] | None = None
    out: str | Path | None = None
    progress: Callable[[Step], None] | bool | None = None
    snap: bool = True
    order: Order | None = None
    explicit_time: bool = False
    discrete: bool = False
    settings: DiscoverySettings = DISCOVERY
    functions: Sequence[str] | None = None
    max_complexity: float | None = None
    complexity: Mapping[str, float] | None = None
    loss: str | LossFunction | None = None
    terms: Sequence[str | sympy.Expr] = ()
    must: Must | None = None
    constraints: Constraints | None = None
    conserved: Sequence[str | sympy.Expr] = ()
    nonnegative: Sequence[str] = ()
    units: Mapping[str, str] | str | None = None
    time_budget: float | None = None
    vary: bool | str | Sequence[str] = False
    delays: bool | float | Sequence[float] = False
    hidden: bool | int | str = False
    stochastic: bool = False
    ensemble: bool | int = False
    start: Discovery | Start | str | Path | None = None

    def read(self, data: Any) -> tuple[list[Trajectory], Options]:
        """Read the data; what these options say of columns has then the names of formulas.

        Parameters
        ----------
        data : as :func:`dynsr.discover` takes them.
        """
        asked = {name: getattr(self, name) for name in (*_COLUMNS, "hold")}
        runs, drives = take_trajectories(data, self.inputs, **asked)
        named = {name: in_formulas(getattr(self, name), runs[0]) for name in _NAMING}
        read: dict[str, Any] = {**dict.fromkeys(_COLUMNS), **named, "inputs": drives}
        return list(runs), replace(self, **read)

    @property
    def within(self) -> Options:
        """The same for searches within the call, of which nothing is asked that it does itself."""
        usual: dict[str, Any] = {name: getattr(Options, name) for name in _OF_THE_CALL}
        return replace(self, **usual)

    @property
    def drives(self) -> Mapping[str, sympy.Expr]:
        """Input name -> expression in ``t`` where it is known, of data that were read."""
        assert isinstance(self.inputs, Mapping)
        return self.inputs

    @property
    def details(self) -> DiscoverySettings:
        """The numbers that decide, as the call asks for them."""
        return self.settings if self.snap else self.settings.without_snapping()

    @property
    def report(self) -> Callable[[Step], None] | None:
        """What is called as steps end."""
        return self.progress if callable(self.progress) else None

    @property
    def folder(self) -> Path | None:
        """The folder that was asked for; a worker that changes its own still finds it."""
        return None if self.out is None else Path(self.out).absolute()

    def demands(
        self, states: Sequence[str], names: Sequence[str], units: Mapping[str, str] | None = None
    ) -> Demands:
        """Read what is asked of the equations of states in columns of these names and units."""
        asked = {name: getattr(self, name) for name in _DEMANDS}
        return read_demands(states, names, **asked, units=units)

    def record(self, name: str, run: Trajectory) -> dict[str, Any]:
        """Give what the record of a search says of how it was asked for.

        Parameters
        ----------
        name : what stands for a method.
        run : one of the data.
        """
        budget = self.time_budget
        return {
            **({} if budget is None else {"time_budget": budget}),
            "method": name,
            "methods": [name],
            "preset": self.preset,
            "seed": self.seed,
            "version": __version__,
            "details": to_plain(self.details),
            **record_hold(run, self.drives, False, self.hold),
        }

    def claim(
        self, record: Mapping[str, Any], runs: Sequence[Trajectory], asked: Mapping[str, Any]
    ) -> None:
        """Make the folder that of this discovery; raises FolderTaken when it is another one's.

        Parameters
        ----------
        record, runs : of the search.
        asked : what makes it another one than that of the same data without it.
        """
        about = {name: value for name, value in record.items() if name != "details"}
        about |= {**asked, "data": say_data(runs)}
        key = fingerprint(about, record["details"], dict(self.drives))
        RunFolder(self.folder).claim("discovery", about, key)

    @property
    def first_order(self) -> bool:
        """Whether nothing else than equations of first order is asked for."""
        return self.order in (None, 1)

    def says(self, name: str) -> bool:
        """Whether an option says anything but what it says by default.

        >>> asked = Options(known={}, order=1, terms=["x*y"])
        >>> [asked.says(name) for name in ("known", "order", "terms")]
        [False, False, True]
        """
        value, usual = getattr(self, name), _USUAL.get(name)
        if isinstance(value, np.ndarray):
            return True
        return bool(value) and value not in (usual, [usual], (usual,))

    def refuse(self, names: Sequence[str], own: str, what: str) -> None:
        """Raise InputError that names an option which does not go with another one.

        Parameters
        ----------
        names : options that do not, besides those of the call as a whole.
        own : the other one.
        what : what it is called.
        """
        others = (name for name in _OF_THE_CALL if name != own)
        if odd := next(filter(self.says, (*names, *others)), None):
            raise InputError(f"{odd} does not go with {what}; leave one of the two out")


Search: TypeAlias = "Callable[[Sequence[Trajectory], Options], Discovery]"
