"""Methods without much of a search, for tests of what is around a method."""

import os
import time
from dataclasses import dataclass, field

import sympy

from dynsr.fit.candidates import ParetoFront, score_candidate
from dynsr.methods.base import AbstractMethod, silent


@dataclass(frozen=True)
class Guess(AbstractMethod):
    """Draw the coefficients of a linear law from the generator, after a pause in seconds."""

    pause: float = 0.0
    name: str = field(default="guess", init=False)

    def search(self, samples, rng, report=silent):
        """Draw; the front holds a constant too."""
        time.sleep(self.pause)
        law = sum(sympy.Float(-abs(rng.normal())) * sympy.Symbol(n) for n in samples.names[:2])
        exprs = (law, sympy.Float(rng.normal()))
        return ParetoFront(score_candidate(e, samples, self.name) for e in exprs)


@dataclass(frozen=True)
class Broken(AbstractMethod):
    """Fail in one way or another."""

    how: str = "raises"
    name: str = field(default="broken", init=False)

    def search(self, samples, rng, report=silent):
        """Raise, find nothing, or take the process down."""
        if self.how == "dies":
            os._exit(9)
        if self.how == "raises":
            raise ValueError("no luck\ntoday")
        return ParetoFront()


@dataclass(frozen=True)
class DiesOnce(Guess):
    """Take the first process down that makes the mark, and draw in all others."""

    mark: str = ""

    def search(self, samples, rng, report=silent):
        """Die where there is no mark yet."""
        try:
            os.close(os.open(self.mark, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return super().search(samples, rng, report)
        os._exit(9)


def make(name, system, quick):
    """Make a fake by its name."""
    if name.startswith("broken-"):
        return Broken(name.removeprefix("broken-"))
    return Guess(float(name.removeprefix("guess") or 0))
