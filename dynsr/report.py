"""Reports: results as one HTML page that needs nothing else, and every table and picture as a file.

Pages are made from the templates beside this file; pictures are drawn inside them, so that a page
can be mailed, printed and read on a phone without a network, and the page itself forbids the
browser to ask for anything.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from dynsr.errors import InputError
from dynsr.exports import to_mathml
from dynsr.expression import parse
from dynsr.records import Record, write_bytes, write_text
from dynsr.results import FIGURE_1, SYSTEM_TITLES, all_tables, drawable, figure_1
from dynsr.tables import Formula, Table, format_value

FORMATS = ("csv", "md", "tex")


@dataclass(frozen=True)
class Picture:
    """A picture as an ``svg`` element, with the sentence that says what it shows."""

    svg: str
    caption: str

    @classmethod
    def of(cls, figure: Any, caption: str) -> Picture:
        """Draw a matplotlib figure for a page."""
        from dynsr.plots import to_svg

        return cls(to_svg(figure, caption), caption)


def render_page(template: str, **content: Any) -> str:
    """Fill a template of ``dynsr/templates``; every text in ``content`` is escaped.

    Tables are shown by ``show_table`` of ``parts.html.j2``, a Picture by ``show_picture``, pairs
    of names and values by ``show_facts``.
    """
    environment = Environment(
        loader=PackageLoader("dynsr"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["read"] = format_value
    environment.filters["typeset"] = typeset
    environment.tests["formula"] = lambda value: isinstance(value, Formula)
    return environment.get_template(template).render(**content)


def typeset(formula: str) -> str:
    """Give a formula's text as MathML, constants to six digits; nothing where it is no formula.

    >>> typeset("2*x")
    '<math><mrow><mn>2</mn>...<mi>x</mi></mrow></math>'
    """
    try:
        return to_mathml(parse(formula))
    except InputError:
        return ""


def render_replication(
    records: Sequence[Record], settings: Mapping[str, Any], tables: Sequence[Table] | None = None
) -> str:
    """Give the report of a replication as one page: tables, pictures, and how it was made."""
    engine = str(settings["engine"])
    pictures = [
        Picture.of(figure_1(records, [system], engine), caption)
        for system, caption in _pictures(records)
    ]
    failed = [r for r in records if not r.done]
    return render_page(
        "replication.html.j2",
        summary=_summary(records),
        quick=settings["quick"],
        failures=[f"{r.system}, {r.method}, run {r.run}: {r.error}" for r in failed],
        tables=tables or all_tables(records),
        pictures=pictures,
        facts=_facts(records, settings),
    )


def write_results(
    folder: Path, records: Sequence[Record], settings: Mapping[str, Any]
) -> list[Path]:
    """Write the tables as CSV, Markdown and LaTeX, Figure 1 and report.html; give their paths."""
    from dynsr.plots import to_bytes

    written = []
    tables = all_tables(records)
    for table in tables:
        written += write_table(table, folder / "tables")
    systems, _ = drawable(records)
    if systems:
        figure = figure_1(records, systems, str(settings["engine"]))
        for kind in ("png", "pdf"):
            written.append(folder / f"figure1.{kind}")
            write_bytes(written[-1], to_bytes(figure, kind, 200))
    written.append(folder / "report.html")
    write_text(written[-1], render_replication(records, settings, tables))
    return written


def write_table(table: Table, folder: Path) -> list[Path]:
    """Write one table in every format; gives the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{table.name}.{kind}" for kind in FORMATS]
    texts = (table.to_csv(), table.to_markdown(), table.to_latex())
    for path, text in zip(paths, texts, strict=True):
        write_text(path, text)
    return paths


def _pictures(records: Iterable[Record]) -> list[tuple[str, str]]:
    """Give the system of each picture and what it shows."""
    of_paper, others = drawable(records)
    names = {
        **dict(zip(FIGURE_1, ("Figure 1, left", "Figure 1, right"), strict=True)),
        **dict.fromkeys(others, "Not in the paper's Figure 1"),
    }
    return [
        (
            system,
            f"{names[system]}. {SYSTEM_TITLES.get(system, system)}, the state whose equation was "
            "sought: the truth, and what each method inferred over the test span.",
        )
        for system in (*of_paper, *others)
    ]


def _summary(records: Sequence[Record]) -> str:
    def some(count: int, one: str) -> str:
        return f"{count} {one}{'' if count == 1 else 's'}"

    systems, methods = {r.system for r in records}, {r.method for r in records}
    runs = max((r.run for r in records), default=0)
    return (
        f"{some(len(methods), 'method')} on {some(len(systems), 'system')}, "
        f"{some(runs, 'run')} each: {some(len(records), 'cell')}, "
        f"{sum(r.done for r in records)} with a formula."
    )


def _facts(records: Sequence[Record], settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    versions: dict[str, str] = {}
    for record in records:
        versions.update(record.versions)
    total = sum(r.seconds for r in records if r.done)
    return [
        ("command", _command(records, settings)),
        ("seed", str(settings["seed"])),
        ("engine", str(settings["engine"])),
        ("settings", "quick" if settings["quick"] else "the paper's"),
        ("time of the searches", f"{total:.0f} s, all cells together"),
        *sorted(versions.items()),
    ]


def _command(records: Sequence[Record], settings: Mapping[str, Any]) -> str:
    """Give the command that makes these records."""
    systems = ",".join(dict.fromkeys(r.system for r in records))
    methods = ",".join(dict.fromkeys(r.method for r in records))
    runs = max((r.run for r in records), default=0)
    quick = " --quick" if settings["quick"] else ""
    return (
        f"dynsr replicate --systems {systems} --methods {methods} --runs {runs}{quick} "
        f"--seed {settings['seed']} --engine {settings['engine']}"
    )
