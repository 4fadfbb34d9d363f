"""Reports: results as one HTML page that needs nothing else, and every table and picture as a file.

Pages are made from the templates next to this file; pictures are drawn inside them, so that a page
can be mailed, printed and read on a phone without a network, and the page itself forbids the
browser to ask for anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from dynsr.data import write_text
from dynsr.errors import InputError
from dynsr.expression import parse, to_mathml
from dynsr.report.tables import Formula, Table, format_value

FORMATS = ("csv", "md", "tex")


@dataclass(frozen=True)
class Picture:
    """A picture as an ``svg`` element, with the sentence that says what it shows."""

    svg: str
    caption: str

    @classmethod
    def of(cls, figure: Any, caption: str) -> Picture:
        """Draw a matplotlib figure for a page, with the sentence that says what it shows."""
        from dynsr.report.plots import to_svg

        return cls(to_svg(figure, caption), caption)


def render_page(template: str, **content: Any) -> str:
    """Fill a template and give the page; every text in ``content`` is escaped.

    Parameters
    ----------
    template : name of a file in ``dynsr/report/templates``.
    content : the values that it shows, by name.

    Tables are shown by ``show_table`` of ``parts.html.j2``, a Picture by ``show_picture``, pairs
    of names and values by ``show_facts``.
    """
    return _environment().get_template(template).render(**content)


@cache
def _environment() -> Environment:
    """Make what reads templates, once a process: it keeps those that it has compiled."""
    environment = Environment(
        loader=PackageLoader("dynsr.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["read"] = format_value
    environment.filters["typeset"] = typeset
    environment.tests["formula"] = lambda value: isinstance(value, Formula)
    return environment


def typeset(formula: str) -> str:
    """Give a formula as MathML, constants to six digits.

    Parameters
    ----------
    formula : its text; what cannot be read as a formula gives nothing.

    >>> typeset("2*x")
    '<math><mrow><mn>2</mn>...<mi>x</mi></mrow></math>'
    """
    try:
        return to_mathml(parse(formula))
    except InputError:
        return ""


def write_table(table: Table, folder: Path) -> list[Path]:
    """Write one table in every format of FORMATS and give the paths.

    Parameters
    ----------
    table : its name is the stem of the files.
    folder : where they go; it is made when it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{table.name}.{kind}" for kind in FORMATS]
    texts = (table.to_csv(), table.to_markdown(), table.to_latex())
    for path, text in zip(paths, texts, strict=True):
        write_text(path, text, links=False)
    return paths
