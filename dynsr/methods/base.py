"""What every method is: settings as fields, and one verb, ``search``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dynsr.data import Samples
from dynsr.engines import AbstractEngine
from dynsr.errors import InputError, say_near
from dynsr.fit import ParetoFront
from dynsr.methods.limits import Limits

if TYPE_CHECKING:
    from typing import Self


@dataclass(frozen=True)
class Progress:
    """One report of a running search: the stage, how far it is, and the front so far.

    ``total`` is None while the end is not known.
    """

    stage: str
    done: float
    total: float | None
    front: ParetoFront


Report = Callable[[Progress], None]


def silent(progress: Progress) -> None:
    """Report nothing."""


class AbstractMethod(ABC):
    """A search for the equation of one target. Subclasses are frozen dataclasses of settings.

    ``name`` is what records call the method. ``presets`` maps the names of its presets to the
    settings that differ from the class's own; a method of one's own needs none. A method that
    integrates or regresses has a field ``engine``, None for the caller's engine.
    """

    name: str
    engine: str | AbstractEngine | None = None
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Self:
        """Give the method with the settings called ``name``.

        Parameters
        ----------
        name : one of ``presets``; the registry of methods says what each means.
        changes : single settings that replace those of the preset.

        Raises InputError that lists the presets when there is none of that name, or the settings
        when a change is not one of them.

        >>> from dynsr.methods import RationalSearch
        >>> RationalSearch.preset("quick", width=50).costs
        (3, 4)
        """
        if name not in cls.presets:
            known = ", ".join(cls.presets) or "none"
            raise InputError(f"unknown preset {name!r} of {cls.__name__}; its presets are: {known}")
        settings = [f.name for f in fields(cls) if f.init]  # type: ignore[arg-type]
        for setting in changes:
            if setting not in settings:
                hint, known = say_near(setting, settings), ", ".join(settings)
                raise InputError(
                    f"{cls.__name__} has no setting {setting!r}{hint}; it has: {known}"
                )
        return cls(**{**cls.presets[name], **changes})

    def with_engine(self, engine: str | AbstractEngine) -> Self:
        """Give the method with that engine where it uses one and was given none of its own.

        Parameters
        ----------
        engine : the name of an engine, or an engine.
        """
        if self.engine is not None or not is_dataclass(self):
            return self
        if "engine" not in [f.name for f in fields(self)]:
            return self
        return replace(self, engine=engine)

    def within(self, limits: Limits) -> Self:
        """Give the method as it searches within limits; one that knows none is given as it is.

        What a search finds beyond them is left out afterwards in any case.

        Parameters
        ----------
        limits : functions, operators and terms that a formula may have, and how long it may be.
        """
        return self

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the result must know, one line each, such as stages left out here."""
        return ()

    @abstractmethod
    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Search for formulas f with y = f(X).

        All chance comes from ``rng``: the same samples, settings and generator state give the
        same front. ``report`` is called as the search goes on. KeyboardInterrupt ends the search
        early with the best front so far.

        Parameters
        ----------
        samples : the rows of X (n, p) and the slopes y (n,) in state units per second.
        rng : the generator that all chance comes from.
        report : is called with the stage and the front so far.
        """
