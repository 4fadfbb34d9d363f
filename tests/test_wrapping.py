"""Tables of text in what is around them: pages, LaTeX, colours, quotation marks, ARFF."""

import numpy as np
import pytest

from dynsr.data import read_trajectories

T = np.linspace(0.0, 3.0, 31)
X, Y = np.exp(-T), 5 + np.cos(T)
NAMES = ("t", "prey", "y")
ROWS = [NAMES, *((f"{a:.1f}", f"{b:.5f}", f"{c:.5f}") for a, b, c in zip(T, X, Y, strict=True))]


def page(rows):
    """Write a page of the web with a menu, the table, and a footnote in it."""
    cells = ("".join(f"<td>{cell}<sup>[1]</sup></td>\n" for cell in row) for row in rows)
    table = "<table class='data'>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"
    menu = "<table><tr><td>Home</td><td>About</td></tr></table>"
    return (
        f"<!DOCTYPE html>\n<html><style>td {{color: red}}</style><body>{menu}{table}</body></html>"
    )


def latex(rows):
    """Write a table of a paper."""
    lines = [" & ".join(f"${cell}$" for cell in row) + " \\\\" for row in rows]
    head = "\\begin{tabular}{lrr}\n\\toprule\n"
    body = "\n".join([lines[0] + " \\midrule", *lines[1:]])
    return head + body + "\n\\bottomrule\n\\end{tabular}\n"


def arff(rows):
    """Write a file of Weka."""
    names = "".join(f"@ATTRIBUTE '{name}' NUMERIC\n" for name in rows[0])
    body = "\n".join(map(",".join, rows[1:]))
    return f"% made by hand\n@RELATION prey\n\n{names}\n@DATA\n{body}\n"


def coloured(rows):
    """Write the log of a program that colours its lines."""
    pairs = (zip(rows[0], row, strict=True) for row in rows[1:])
    lines = (" ".join(f"{name}={cell}" for name, cell in pair) for pair in pairs)
    return "\n".join(f"\x1b[32mINFO\x1b[0m {line}" for line in lines)


def quoted(rows):
    """Put each line in quotation marks, as a spreadsheet does with what it took for one cell."""
    return "\n".join(f'"{",".join(row)}"' for row in rows)


@pytest.mark.parametrize("write", [page, latex, arff, coloured, quoted])
@pytest.mark.parametrize("name", ["table.txt", "table.html"])
def test_a_table_is_taken_out_of_its_wrapping(tmp_path, write, name):
    """Names and values are those inside, whatever the file is called."""
    path = tmp_path / name
    path.write_text(write(ROWS), encoding="utf-8")
    (run,) = read_trajectories(path).trajectories
    assert run.states == ("prey", "y")
    np.testing.assert_allclose(run.t, T, atol=1e-12)
    np.testing.assert_allclose(run.x, np.column_stack([X, Y]), atol=1e-5)


def test_the_mark_of_one_column_is_that_of_all(tmp_path):
    """A comma that is the decimal mark of one column separates no thousands in another."""
    rows = [f"{a:.1f};{b}".replace(".", ",") for a, b in zip(T, [5, *Y.round(3)[1:]], strict=True)]
    path = tmp_path / "table.csv"
    path.write_text("t;y\n" + "\n".join(rows))
    (run,) = read_trajectories(path).trajectories
    np.testing.assert_allclose(run.x[1:, 0], Y[1:], atol=1e-3)
