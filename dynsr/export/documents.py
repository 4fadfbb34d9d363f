"""Documents: equations with named parameters for a paper or a page."""

from __future__ import annotations

from html import escape

import sympy

from dynsr.export.citations import write_citations
from dynsr.export.source import Source
from dynsr.expression import to_latex, to_mathml
from dynsr.verdict import write_map_latex, write_map_mathml


def write_latex(source: Source) -> str:
    """Write the equations with names, and a table of their values.

    Parameters
    ----------
    source : what is written.
    """
    system = source.system
    if system.discrete:
        text = write_map_latex(system.equations, system.parameters)
    else:
        text = to_latex(system.equations, system.time_unit, system.parameters)
    for name, own in source.delays.items():
        state, late = sympy.latex(sympy.Symbol(own.state)), sympy.latex(sympy.Symbol(name))
        text += f"\n\nHere ${late}(t) = {state}(t - {own.value:.6g})$."
    text += "".join(f"\n\n{words}" for words in source.curves)
    return f"{text}\n\n{system.parameters.to_latex()}\n"


def write_mathml(source: Source) -> str:
    """Write each equation as MathML, one a paragraph, and the values of the parameters.

    Parameters
    ----------
    source : what is written.
    """
    write = write_map_mathml if source.system.discrete else to_mathml
    lines = [write(e, s) for s, e in source.system.equations.items()]
    for name, value in source.parameters.items():
        equals = to_mathml(sympy.Symbol(name)).removesuffix("</math>")
        lines.append(f"{equals}<mo>=</mo>{to_mathml(sympy.Float(value)).removeprefix('<math>')}")
    lines += [f"{escape(name)} is {escape(own.text)}." for name, own in source.delays.items()]
    lines += map(escape, source.curves)
    return "".join(f"<p>{line}</p>\n" for line in lines)


def write_markdown(source: Source) -> str:
    """Write the equations and a table of the parameters in Markdown.

    Parameters
    ----------
    source : what is written.
    """
    lines = [f"    {line}" for line in source.lines()]
    lines += [f"\n{name} is {own.text}." for name, own in source.delays.items()]
    lines += [f"\n{words}" for words in source.curves]
    head = ("parameter", "value", "standard error", "95 % interval", "unit", "term")
    rows = [head, ["---"] * len(head), *source.system.parameters.rows()]
    table = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, "", *(table if source.parameters else []), ""])


def write_bibtex(source: Source) -> str:
    """Write BibTeX of what found the equations.

    Parameters
    ----------
    source : what is written.
    """
    return write_citations(source.methods, source.engine, source.system.discrete)
