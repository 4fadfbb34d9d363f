"""By run: the parameters that differ from run to run, as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

from dynsr.arguments import checked
from dynsr.errors import InputError
from dynsr.parameters.parameters import Parameter, as_html, in_columns

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@checked
@dataclass(frozen=True, repr=False)
class RunParameters:
    """The parameters that differ from run to run: name -> one :class:`Parameter` for each run.

    Parameters
    ----------
    runs : names of the runs.
    constants : parameter -> its value in each run, with its 95 % interval.
    labels : column of labels -> what it says of each run.
    known : input that is constant in each run -> its values.
    follows : parameter -> the function of known inputs, or the multiple of another parameter, that
        it was found to be. Such a parameter has no values of its own.
    by : parameter -> the column of labels, or the input, with which it differs; a parameter that
        differs from run to run is not there.

    >>> RunParameters(("a", "b"), {"k1": (Parameter("k1", 0.5), Parameter("k1", 0.8))})
    run  k1   95 % interval
    a    0.5  unknown
    b    0.8  unknown
    """

    runs: tuple[str, ...] = ()
    constants: dict[str, tuple[Parameter, ...]] = field(default_factory=dict)
    labels: dict[str, tuple[str, ...]] = field(default_factory=dict)
    known: dict[str, tuple[float, ...]] = field(default_factory=dict)
    follows: dict[str, str] = field(default_factory=dict)
    by: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that there is one value for each run; raises InputError."""
        for name, own in {**self.constants, **self.labels, **self.known}.items():
            if len(own) != len(self.runs):
                raise InputError(f"{name!r} has {len(own)} values for {len(self.runs)} runs")

    def __getitem__(self, name: str) -> tuple[Parameter, ...]:
        """Give one parameter for each run; raises KeyError that names those that there are."""
        try:
            return self.constants[name]
        except KeyError:
            names = ", ".join(self.constants) or "none"
            raise KeyError(f"{name!r} does not differ; those that do are: {names}") from None

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self.constants)

    def __len__(self) -> int:
        """Count the parameters that differ."""
        return len(self.constants)

    def numbers(self, run: str | int) -> dict[str, float]:
        """Give parameter -> its value in one run.

        Parameters
        ----------
        run : its name, or its place from 0.

        Raises InputError when there is no such run.
        """
        place = self.place(run)
        return {name: own[place].value for name, own in self.constants.items()}

    def place(self, run: str | int) -> int:
        """Give the place of a run from 0; raises InputError when there is no such run.

        Parameters
        ----------
        run : its name, or its place from 0.
        """
        if isinstance(run, str) and run in self.runs:
            return self.runs.index(run)
        if isinstance(run, str) or not 0 <= run < len(self.runs):
            names = ", ".join(self.runs) or "none"
            raise InputError(f"{run!r} is no run; the runs, counted from 0, are: {names}")
        return run

    @property
    def sentences(self) -> list[str]:
        """Say which parameters differ, and what others follow."""
        ways = dict[str, list[str]]()
        for name in self.constants:
            ways.setdefault(self.by.get(name, ""), []).append(name)
        found = [
            f"{', '.join(own)} {'differs' if len(own) == 1 else 'differ'} "
            f"{f'with {way}' if way else 'from run to run'}."
            for way, own in ways.items()
        ]
        return found + [f"{name} differs too: it is {text}." for name, text in self.follows.items()]

    @property
    def head(self) -> tuple[str, ...]:
        """Heads of the columns of :meth:`rows`."""
        own = [word for name in self.constants for word in (name, "95 % interval")]
        return ("run", *self.labels, *self.known, *own)

    def rows(self) -> list[tuple[str, ...]]:
        """Give (run, labels, known inputs, value and interval of each parameter), to be read."""
        return [
            (
                run,
                *(own[i] for own in self.labels.values()),
                *(f"{own[i]:.6g}" for own in self.known.values()),
                *(text for own in self.constants.values() for text in _write(own[i])),
            )
            for i, run in enumerate(self.runs)
        ]

    def to_frame(self) -> pd.DataFrame:
        """Give a frame of pandas, one row for each run.

        >>> values = {"k1": (Parameter("k1", 0.5), Parameter("k1", 0.8))}
        >>> RunParameters(("a", "b"), values).to_frame().loc["b", "k1"].item()
        0.8
        """
        import pandas as pd

        columns: dict[str, Sequence[object]] = {**self.labels, **self.known}
        for name, own in self.constants.items():
            columns |= {
                name: [p.value for p in own],
                f"{name}_error": [p.error for p in own],
                f"{name}_low": [p.low for p in own],
                f"{name}_high": [p.high for p in own],
            }
        return pd.DataFrame(columns, index=pd.Index(self.runs, name="run"))

    def plot(self) -> Figure:
        """Draw the value of each parameter in each run, with its interval; gives the figure.

        Raises InputError when no parameter differs.
        """
        from dynsr.report import draw_by_run

        if not self.constants:
            raise InputError("no parameter differs from run to run; there is nothing to draw")
        return draw_by_run(self)

    def __repr__(self) -> str:
        """Write a table, and what parameters follow."""
        lines = in_columns([self.head, *self.rows()]) if self.constants else []
        return "\n".join([*lines, *(f"{n} = {text}" for n, text in self.follows.items())])

    def _repr_html_(self) -> str:
        said = "".join(f"<p>{escape(n)} = {escape(text)}</p>" for n, text in self.follows.items())
        return as_html(self.head, self.rows()) + said


def _write(parameter: Parameter) -> tuple[str, str]:
    return f"{parameter.value:.6g}", parameter.interval_text
