"""The page of a batch: one row for each file, with a link to the report of its discovery."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from dynsr import __version__
from dynsr.data import check_replaceable, is_own_page, write_page, write_text
from dynsr.discovery import Discovered
from dynsr.jobs import REPORT
from dynsr.report.page import render_page
from dynsr.report.tables import Table

# From the best to the worst; a verdict in singular and in plural.
_LEVELS = {
    "law": ("law", "laws"),
    "approximation": ("approximation", "approximations"),
    "not found": ("not found", "not found"),
    "failed": ("failed", "failed"),
}


def write_batch(rows: Sequence[Discovered], folder: Path) -> list[Path]:
    """Write the table of a batch as discoveries.csv, and its page report.html; gives the paths.

    Parameters
    ----------
    rows : what was found, one for each file.
    folder : of the batch, from which the reports of its files are linked.

    Raises InputError when they cannot be written, or a file that is no page of dynsr is there.
    """
    page = folder / REPORT
    check_replaceable(page, is_own_page)
    table = tabulate(rows)
    path = folder / f"{table.name}.csv"
    write_text(path, table.to_csv(), links=False)
    write_page(page, render_batch(rows))
    return [path, page]


def tabulate(rows: Sequence[Discovered]) -> Table:
    """Give the table of a batch, one row for each file.

    Parameters
    ----------
    rows : what was found, one for each file.

    >>> found = Discovered("a.csv", "law", "fine.", ("x' = -x",), 1.5)
    >>> print(tabulate([found]).to_csv())
    file,verdict,equations,constants,reason,seconds,report
    a.csv,law,x' = -x,,fine.,1.5,
    <BLANKLINE>
    """
    return Table(
        "discoveries",
        "Discoveries",
        ("file", "verdict", "equations", "constants", "reason", "seconds", "report"),
        tuple(
            (
                row.file,
                row.level,
                "; ".join(row.equations),
                "; ".join(row.constants),
                row.reason,
                round(row.seconds, 1),
                f"{row.folder}/{REPORT}" if row.folder else "",
            )
            for row in rows
        ),
    )


def render_batch(rows: Sequence[Discovered]) -> str:
    """Give the page of a batch: how many laws there are, and a row for each file.

    Parameters
    ----------
    rows : what was found, one for each file.
    """
    counts = Counter(row.level for row in rows)
    parts = [f"{n} {_LEVELS[level][n > 1]}" for level in _LEVELS if (n := counts[level])]
    files = f"{len(rows)} file{'s' * (len(rows) != 1)}"
    return render_page(
        "batch.html.j2",
        heading=f"Equations of {files}",
        summary=f"{', '.join(parts)}.",
        rows=[
            (
                row,
                quote(f"{row.folder}/{REPORT}") if row.folder else "",
                row.level.replace(" ", "-"),
            )
            for row in rows
        ],
        facts=[
            ("made by", f"dynsr {__version__}"),
            ("time of the searches", f"{sum(row.seconds for row in rows):.1f} s, all together"),
        ],
    )
