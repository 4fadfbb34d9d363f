import math
import re
import statistics

import pytest
import sympy

from dynsr.data.system import PAPER_SYSTEMS, find_system
from dynsr.expression.parsing import parse
from dynsr.paper.printed import METHODS, TABLE_1, printed_expressions, rows_of


def read_latex(latex: str) -> str:
    """Turn a printed formula into text by plain substitution, independently of the data file."""
    text = latex.replace("\\theta_1", "theta1").replace("\\theta_2", "theta2")
    text = text.replace("\\text{identity}", "").replace("\\cdot", "*")
    text = text.replace("{", "(").replace("}", ")").replace("^", "**")
    # Misprints: a letter that lost its dot, and a parenthesis that was never opened.
    text = re.sub(r"(\d)([wx])", r"\1*\2", text)
    return "(" + text if text.count(")") > text.count("(") else text


@pytest.mark.parametrize(
    "row", printed_expressions(), ids=lambda r: f"{r.system}-{r.method}{r.run}"
)
def test_each_expression_is_what_its_latex_says(row):
    """The formula in the data file and the one in the paper's LaTeX are the same expression."""
    names = {name: sympy.Symbol(name) for name in find_system(row.system).states}
    names["inv"] = lambda a: 1 / a
    independent = sympy.sympify(read_latex(row.latex), locals=names)
    difference = sympy.expand(independent - row.expr)
    point = {symbol: 0.3 + 0.1 * i for i, symbol in enumerate(sorted(names))}
    values = {names[n]: v for n, v in point.items() if n != "inv"}
    assert abs(difference.subs(values)) < 1e-9
    assert row.expr.free_symbols == independent.free_symbols


def test_every_system_and_method_has_its_runs():
    """Five runs of the two random methods and one of SINDy, three systems each: 33 rows."""
    assert len(printed_expressions()) == 33
    for system in PAPER_SYSTEMS:
        for method in METHODS:
            runs = [row.run for row in rows_of(system.name, method)]
            assert runs == ([1] if method == "SINDy" else [1, 2, 3, 4, 5])


def test_losses_are_printed_to_three_digits():
    """Every printed loss has three decimals, and reads as that number."""
    for row in printed_expressions():
        assert re.fullmatch(r"\d\.\d{3}", row.printed)
        assert row.loss == float(row.printed)


def test_pendulum_runs_2_to_5_are_copies():
    """They are Lotka-Volterra's runs 1, 3, 4, 5, coefficient for coefficient."""
    rename = {"x": "theta1", "y": "theta2"}
    for ours, theirs in zip((2, 3, 4, 5), (1, 3, 4, 5), strict=True):
        copied = rows_of("lotka-volterra", "DynAIFeynman")[theirs - 1].expression
        renamed = re.sub(r"\b[xy]\b", lambda m: rename[m.group()], copied)
        assert parse(renamed) == rows_of("pendulum", "DynAIFeynman")[ours - 1].expr


def test_table_1_follows_from_the_appendix_but_for_its_misprints():
    """Means and spreads of the printed runs give table 1 within one unit of its last digit."""
    for (method, system), cell in TABLE_1.items():
        losses = [row.loss for row in rows_of(system, method)]
        mean = statistics.fmean(losses)
        spread = statistics.stdev(losses) if len(losses) > 1 else math.nan
        unit = 10.0 ** -len(cell.mean.partition(".")[2])
        assert abs(mean - float(cell.mean)) <= 1.01 * unit
        if cell.spread is None:
            assert math.isnan(spread)
        else:
            unit = 10.0 ** -len(cell.spread.partition(".")[2])
            assert abs(spread - float(cell.spread)) <= 1.01 * unit
