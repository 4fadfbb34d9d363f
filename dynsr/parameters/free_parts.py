"""Free parts: the functions of one column in known equations that were found, or stay curves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.errors import InputError
from dynsr.expression import Curve, check_name, evaluate, parse, shown
from dynsr.fit import CURVED, CurvedSettings
from dynsr.parameters.parameters import Parameter

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class FreeSettings:
    """The numbers that decide how free functions are found; they are in a discovery's record.

    Parameters
    ----------
    curved : how curves are fitted.
    points : values of its column at which a curve says what formula it may be, evenly spaced and
        where the data are.
    fitted : formulas that are fitted in the place of a curve; 0 leaves all of them curves.
    shown : of these, how many a result names, the best first.
    drawn : points of a picture.
    digits : digits of the formulas that are compared.
    step : share of a constant by which it is moved to see which numbers of equations follow it.
    grid, seen : values of each column, and points for each of them, at which slopes show what exact
        data could determine.
    unseen : share of the largest sensitivity below which a direction shows in no slope.
    """

    curved: CurvedSettings = CURVED
    points: int = 60
    fitted: int = 16
    shown: int = 5
    drawn: int = 300
    digits: int = 4
    step: float = 1e-3
    grid: int = 7
    seen: int = 40
    unseen: float = 1e-9


FREE: FreeSettings = FreeSettings()


@checked
@dataclass(frozen=True, repr=False)
class FreePart:
    """A function of one column in known equations: a formula where one was found, else a curve.

    Parameters
    ----------
    name : of the function.
    of : the column that it is a function of.
    knots, values : (K,) where the curve was fitted, and its values there. Between them it is a
        natural cubic spline, and beyond them a straight line.
    covariance : (K, K) of the values; inf where the data do not determine it.
    reach : standard errors that the 95 % band reaches to either side of the curve.
    effective : effective parameters of the curve.
    formula : the formula in the column; "" where the function stays a curve.
    points : (column, value) of what each row of the data says of the function.
    bits : formula -> bits that it takes more than the curve; those of the formula found are
        negative.

    Raises InputError when numbers are missing or not finite.

    >>> part = FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), ((0.01,) * 3,) * 3, 2.0)
    >>> float(part(0.5)), [end.round(3).tolist() for end in part.band(np.array([0.5]))]
    (0.5, [[0.3], [0.7]])
    """

    name: str
    of: str
    knots: tuple[float, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...] = ()
    reach: float = 1.96
    effective: float = math.inf
    formula: str = ""
    points: tuple[tuple[float, float], ...] = ()
    bits: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what a saved file may have wrong; raises InputError."""
        check_name(self.name, "function")
        check_name(self.of, "column")
        shapes = {len(self.knots), *map(len, self.covariance), len(self.covariance)} - {0}
        if shapes != {len(self.knots)}:
            raise InputError(f"the covariance of {self.name!r} is not one of its knots")
        if self.formula:
            parse(self.formula, [self.of])
        _ = self.curve

    @cached_property
    def curve(self) -> Curve:
        """The curve, also where a formula was found."""
        return Curve(self.name, np.array(self.knots), np.array(self.values))

    @property
    def is_curve(self) -> bool:
        """Whether no formula was found, so that the function is the curve."""
        return not self.formula

    @property
    def law(self) -> sympy.Expr:
        """The function as an expression: the formula, or the curve as a function of its column."""
        if self.is_curve:
            return self.curve.function(sympy.Symbol(self.of))
        return parse(self.formula, [self.of])

    def __call__(self, x: Any) -> Any:
        """Give the values of the function.

        Parameters
        ----------
        x : a number, or values (...,) of the column.
        """
        given = np.asarray(x, dtype=float)
        found = self.curve(given) if self.is_curve else evaluate(self.law, {self.of: given})
        return float(found) if given.ndim == 0 else found

    def band(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give the ends of the 95 % band of the curve; inf where the data do not determine it.

        Parameters
        ----------
        x : (n,) values of the column.
        """
        middle = self.curve(np.asarray(x, dtype=float))
        if not self.covariance:
            return middle - np.inf, middle + np.inf
        weights, spread = self.curve.weights(np.asarray(x, dtype=float)), np.array(self.covariance)
        unknown = ~np.isfinite(np.diag(spread))
        spread = np.where(np.isfinite(spread), spread, 0.0)
        variance = np.einsum("nk,kl,nl->n", weights, spread, weights)
        beside = self.reach * np.sqrt(np.maximum(variance, 0.0))
        beside = np.where(np.abs(weights) @ unknown > 0, np.inf, beside)
        return middle - beside, middle + beside

    @property
    def span(self) -> tuple[float, float]:
        """Where the data begin and end."""
        return self.knots[0], self.knots[-1]

    def table(self, rows: int = 101) -> pd.DataFrame:
        """Give the values of the function, and the band of the curve, as a frame of pandas.

        Parameters
        ----------
        rows : evenly spaced over the data.

        Raises InputError when there are fewer than two.

        >>> part = FreePart("f", "x", (0.0, 1.0, 2.0), (0.0, 1.0, 2.0), ((0.01,) * 3,) * 3, 2.0)
        >>> part.table(3).round(3).values.tolist()
        [[0.0, 0.0, -0.2, 0.2], [1.0, 1.0, 0.8, 1.2], [2.0, 2.0, 1.8, 2.2]]
        """
        import pandas as pd

        if rows < 2:
            raise InputError(f"a table of {rows} rows shows no function; give 2 or more")
        x = np.linspace(*self.span, rows)
        low, high = self.band(x)
        return pd.DataFrame({self.of: x, self.name: self(x), "low": low, "high": high})

    @property
    def text(self) -> str:
        """The function, to be read."""
        if not self.is_curve:
            return f"{self.name}({self.of}) = {shown(self.law)}"
        low, high = self.span
        return (
            f"{self.name}({self.of}) is a curve, no formula: {self.effective:.1f} effective "
            f"parameters, for {self.of} from {low:.4g} to {high:.4g}"
        )

    def plot(self) -> Figure:
        """Draw the function, the band of the curve, and what each row of the data says."""
        from dynsr.report import draw_free

        return draw_free([self])

    def __repr__(self) -> str:
        """Write the function."""
        return f"<{self.text}>"


@checked
@dataclass(frozen=True, repr=False)
class FreeParts:
    """The free functions of known equations by their names, and the constants fitted with them.

    Parameters
    ----------
    parts : name -> the function.
    constants : name -> the constant of the known equations, with its 95 % interval.
    notes : what the data cannot determine, and what was chosen, in words.
    states : the states whose equations were given.

    >>> FreeParts()
    no free part
    """

    parts: dict[str, FreePart] = field(default_factory=dict)
    constants: dict[str, Parameter] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    states: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> FreePart:
        """Give a function; raises KeyError that names those that there are."""
        try:
            return self.parts[name]
        except KeyError:
            names = ", ".join(self.parts) or "none"
            raise KeyError(f"no free part {name!r}; the free parts are: {names}") from None

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self.parts)

    def __len__(self) -> int:
        """Count the functions."""
        return len(self.parts)

    @property
    def only_curves(self) -> FreeParts:
        """What stays true of equations whose constants are changed: the curves."""
        return FreeParts(self.curves, states=self.states if self.curves else ())

    @property
    def curves(self) -> dict[str, FreePart]:
        """The functions that stay curves."""
        return {name: part for name, part in self.parts.items() if part.is_curve}

    @property
    def sentences(self) -> list[str]:
        """Say what the functions and the constants are, and what the data cannot determine."""
        found = [f"{part.text}." for part in self.parts.values()]
        if self.constants:
            each = (
                f"{own.name} = {own.value:.6g} ({own.interval_text})"
                for own in self.constants.values()
            )
            found.append(f"{', '.join(each)}.")
        return [*found, *self.notes]

    def plot(self) -> Figure:
        """Draw every function, the band of its curve, and what each row of the data says.

        Raises InputError when there is none.
        """
        from dynsr.report import draw_free

        if not self.parts:
            raise InputError("there is no free part; there is nothing to draw")
        return draw_free(list(self.parts.values()))

    def __repr__(self) -> str:
        """Write the functions and the constants."""
        return "\n".join(self.sentences) or "no free part"

    def _repr_html_(self) -> str:
        """Show the same in a notebook."""
        return "".join(f"<p>{escape(words)}</p>" for words in self.sentences)


def refuse_curves(free: FreeParts, what: str) -> None:
    """Raise InputError where a function stays a curve: what it does not allow.

    Parameters
    ----------
    free : the free functions.
    what : is said first.
    """
    for part in free.curves.values():
        raise InputError(
            f"{what}, and {part.name}({part.of}) is a curve; write a formula for it in known, and "
            "discover again"
        )
