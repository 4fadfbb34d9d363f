"""Tables: values with a title, as CSV, Markdown, LaTeX or on a terminal.

A table holds raw values. CSV writes them with all their digits; the other forms round numbers to
four significant digits and set formulas as such. They are written here because each cell is set by
its kind, which is most of the work: pandas would add the rules and the caption, not the note below
or the size of the letters, and needs tabulate for Markdown.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import mean, stdev
from typing import Any

from rich import box
from rich.markup import escape
from rich.table import Table as RichTable
from rich.text import Text

_TEX = {c: "\\" + c for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"\(\pm\)",
}


class Formula(str):
    """Text of an expression, which a table sets as a formula.

    >>> Formula("x*y").latex
    'x y'
    """

    @property
    def latex(self) -> str:
        """The formula in LaTeX, without delimiters."""
        # SymPy takes as long to import as all else that shows a table.
        import sympy

        from dynsr.expression import parse

        return sympy.latex(parse(str(self)))


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation (with n - 1) of a value over runs.

    ``diverged`` counts the runs whose value is infinite; the others make mean and deviation.
    ``deterministic`` says that the runs use no random numbers, so that they agree.

    >>> str(Spread.of([0.25, 0.75, math.inf]))
    '0.5 ± 0.3536 (1 of 3 diverges)'
    >>> str(Spread.of([0.25, 0.25], deterministic=True))
    '0.25 ± 0 (deterministic)'
    """

    mean: float
    deviation: float
    count: int
    diverged: int = 0
    deterministic: bool = False

    @classmethod
    def of(cls, values: Iterable[float], deterministic: bool = False) -> Spread:
        """Make the spread of some values."""
        values = list(values)
        finite = [v for v in values if math.isfinite(v)]
        # Equal values have no deviation; their mean as a float may differ in the last digit.
        same = len(set(finite)) == 1
        centre = finite[0] if same else mean(finite) if finite else math.nan
        spread = 0.0 if same else stdev(finite) if finite else math.nan
        return cls(centre, spread, len(values), len(values) - len(finite), deterministic)

    def __str__(self) -> str:
        """Write it as the paper does; one run has no deviation."""
        if not self.count:
            return ""
        if self.diverged == self.count:
            return "diverges"
        text = format_value(self.mean)
        if self.count - self.diverged > 1:
            text += f" ± {format_value(self.deviation)}"
        if self.count > 1 and not self.deviation and self.deterministic:
            text += " (deterministic)"
        if self.diverged:
            text += f" ({self.diverged} of {self.count} diverges)"
        return text


def format_value(value: Any) -> str:
    """Write one value for a reader: floats to four significant digits, infinity as "diverges".

    Parameters
    ----------
    value : anything; None and NaN become nothing, what is no float its own text.

    >>> [format_value(v) for v in (0.123456, 5, math.inf, None)]
    ['0.1235', '5', 'diverges', '']
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "diverges"
    return str(value)


@dataclass(frozen=True)
class Table:
    """Values under column headings.

    Parameters
    ----------
    name : stem of its files.
    title : what it shows, one line.
    columns : the headings.
    rows : raw values, as many in each as there are columns.
    note : how to read it.

    >>> print(Table("t", "Losses", ("run", "loss"), ((1, 0.123456),)).to_markdown())
    **Losses**
    <BLANKLINE>
    | run | loss |
    | ---: | ---: |
    | 1 | 0.1235 |
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""

    def is_text(self, column: int) -> bool:
        """Whether a column contains text, which is set to the left; written numbers are not."""
        texts = [row[column] for row in self.rows if isinstance(row[column], str)]
        return any(isinstance(t, Formula) or (t and not t[0].isdigit()) for t in texts)

    def to_records(self) -> list[dict[str, Any]]:
        """Give each row as a dictionary of raw values; a spread becomes three columns."""
        split = [
            any(isinstance(row[j], Spread) for row in self.rows) for j in range(len(self.columns))
        ]
        return [dict(_raw(self.columns, split, row)) for row in self.rows]

    def to_csv(self) -> str:
        """Write every digit, one line for each row, the headings first."""
        records = self.to_records()
        out = io.StringIO()
        writer = csv.DictWriter(out, records[0] if records else self.columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
        return out.getvalue()

    def to_markdown(self) -> str:
        """Write the table in Markdown, its title above and its note below."""
        marks = [":---" if self.is_text(j) else "---:" for j in range(len(self.columns))]
        lines = [self.columns, marks, *([_markdown(v) for v in row] for row in self.rows)]
        body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return f"**{self.title}**\n\n{body}\n" + (f"\n{self.note}\n" if self.note else "")

    def to_latex(self) -> str:
        """Write a LaTeX table that needs the package booktabs alone."""
        formulas = [any(isinstance(r[j], Formula) for r in self.rows) for j in self._indices]
        layout = "".join(
            r"p{0.5\linewidth}" if formulas[j] else "l" if self.is_text(j) else "r"
            for j in self._indices
        )
        lines = [
            r"\begin{table}[htbp]",
            rf"\caption{{{_tex(self.title)}}}",
            rf"\label{{tab:{self.name.replace('_', '-')}}}",
            r"\centering\footnotesize\setlength{\tabcolsep}{4pt}",
            rf"\begin{{tabular}}{{{layout}}}",
            r"\toprule",
            " & ".join(map(_tex, self.columns)) + r" \\",
            r"\midrule",
            *(" & ".join(map(_latex_cell, row)) + r" \\" for row in self.rows),
            r"\bottomrule",
            r"\end{tabular}",
            *([rf"\par\smallskip {_tex(self.note)}"] if self.note else []),
            r"\end{table}",
        ]
        return "\n".join(lines) + "\n"

    def to_rich(self) -> RichTable:
        """Give the table for a terminal."""
        title, note = escape(self.title), escape(self.note) or None
        table = RichTable(title=title, caption=note, box=box.SIMPLE_HEAD)
        for j, heading in enumerate(self.columns):
            text = self.is_text(j)
            table.add_column(escape(heading), justify="left" if text else "right", overflow="fold")
        for row in self.rows:
            table.add_row(*(Text(format_value(value)) for value in row))
        return table

    @property
    def _indices(self) -> Sequence[int]:
        return range(len(self.columns))


def _raw(
    columns: Sequence[str], split: Sequence[bool], row: Sequence[Any]
) -> Iterable[tuple[str, Any]]:
    for heading, wide, value in zip(columns, split, row, strict=True):
        if not wide:
            yield heading, str(value) if isinstance(value, Formula) else value
            continue
        spread = value if isinstance(value, Spread) else Spread(math.nan, math.nan, 0)
        yield f"{heading}, mean", spread.mean
        yield f"{heading}, deviation", spread.deviation
        yield f"{heading}, runs that diverge", spread.diverged


def _markdown(value: Any) -> str:
    text = format_value(value).replace("|", "\\|")
    return f"`{text}`" if isinstance(value, Formula) and text else text


def _latex_cell(value: Any) -> str:
    if isinstance(value, Formula) and value:
        return rf"\({value.latex}\)"
    return _tex(format_value(value))


def _tex(text: str) -> str:
    return "".join(_TEX.get(c, c) for c in text)
