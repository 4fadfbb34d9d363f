import csv
import io
import math
import statistics

import pytest

from dynsr.report.tables import Formula, Spread, Table, format_value

TABLE = Table(
    "my_table",
    "Losses & more",
    ("Run", "Formula", "Loss", "Mean"),
    (
        (1, Formula("x**2/3 - 0.1*theta1"), 0.1 + 0.2, Spread.of([1.0, 2.0, 4.0])),
        (2, Formula("abs(x)"), math.inf, Spread.of([2.0, 2.0])),
        (3, "failed: 100% | bad_luck", math.nan, Spread.of([])),
    ),
    note="5 % of #3",
)


def test_a_spread_is_mean_and_sample_deviation():
    """Mean and deviation with n - 1, as Python's statistics computes them; divergence counted."""
    values = [0.258, 0.134, 0.162, 0.212, 0.213]
    spread = Spread.of([*values, math.inf])
    assert spread.mean == statistics.mean(values)
    assert spread.deviation == statistics.stdev(values)
    assert str(spread) == "0.1958 ± 0.04845 (1 of 6 diverges)"
    assert str(Spread.of([math.inf, math.inf])) == "diverges"
    assert str(Spread.of([0.1] * 3)) == "0.1 ± 0" and str(Spread.of([0.1])) == "0.1"
    assert str(Spread.of([0.1] * 3, deterministic=True)) == "0.1 ± 0 (deterministic)"
    assert str(Spread.of([0.1], deterministic=True)) == "0.1"
    assert str(Spread.of([1.0, 2.0], deterministic=True)) == "1.5 ± 0.7071"
    assert str(Spread.of([])) == ""


def test_csv_holds_every_digit():
    """Read back, the CSV gives the very numbers; a spread takes three columns."""
    rows = list(csv.DictReader(io.StringIO(TABLE.to_csv())))
    assert float(rows[0]["Loss"]) == 0.1 + 0.2
    assert float(rows[0]["Mean, deviation"]) == statistics.stdev([1.0, 2.0, 4.0])
    assert float(rows[1]["Loss"]) == math.inf
    assert rows[0]["Formula"] == "x**2/3 - 0.1*theta1"
    assert [r["Run"] for r in rows] == ["1", "2", "3"]


def test_markdown_is_a_table_of_as_many_cells_in_each_row():
    """Title, headings and marks stand above the rows; a bar in a text does not end its cell."""
    lines = TABLE.to_markdown().splitlines()
    assert lines[0] == "**Losses & more**"
    body = [line.replace("\\|", "") for line in lines if line.startswith("|")]
    assert {line.count("|") for line in body} == {5} and len(body) == 5
    assert "| 1 | `x**2/3 - 0.1*theta1` | 0.3 | 2.333 ± 1.528 |" in lines
    assert "diverges" in lines[5] and lines[-1] == "5 % of #3"


def test_latex_sets_formulas_and_escapes_text():
    """Formulas are in mathematics, special characters of text are escaped, braces balance."""
    text = TABLE.to_latex()
    assert r"\frac{x^{2}}{3}" in text and r"0.1 \theta_{1}" in text
    assert r"\caption{Losses \& more}" in text and r"\label{tab:my-table}" in text
    assert r"failed: 100\% | bad\_luck" in text and r"5 \% of \#3" in text
    assert r"2.333 \(\pm\) 1.528" in text
    plain = text.replace(r"\{", "").replace(r"\}", "")
    assert plain.count("{") == plain.count("}")
    body = text.split(r"\midrule")[1].split(r"\bottomrule")[0]
    assert [line.count(" & ") for line in body.strip().splitlines()] == [3, 3, 3]


def test_the_terminal_shows_what_markup_would_hide():
    """Square brackets in a text are shown, not read as rich's markup."""
    from rich.console import Console

    console = Console(width=100, record=True, file=io.StringIO())
    console.print(Table("t", "T", ("a", "b"), (("[red]x[/red]", 0.5),)).to_rich())
    shown = console.export_text()
    assert "[red]x[/red]" in shown and "0.5" in shown


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234567.0, "1.235e+06"), (0.00012345, "0.0001234"), (True, "True"), (-math.inf, "diverges")],
)
def test_numbers_are_shown_with_four_digits(value, text):
    """Four significant digits; what is infinite diverges."""
    assert format_value(value) == text


def test_a_table_without_rows_has_its_headings():
    """An empty table is written in every form."""
    empty = Table("t", "T", ("a", "b"), ())
    assert empty.to_csv() == "a,b\n" and "| a | b |" in empty.to_markdown()
    assert r"a & b \\" in empty.to_latex()
