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


def fluent(rows):
    """Write a report of Fluent."""
    names = " ".join(f'"{name}"' for name in rows[0])
    return f'"report-def-0"\n{names}\n({names})\n' + "\n".join(map(" ".join, rows[1:]))


def gromacs(rows):
    """Write a plot of GROMACS."""
    names = "\n".join(f'@ s{j} legend "{name}"' for j, name in enumerate(rows[0][1:]))
    head = f'# gmx energy\n@    title "E"\n@    xaxis  label "Time (ps)"\n@TYPE xy\n{names}\n'
    return head + "\n".join(map("   ".join, rows[1:]))


def lammps(rows):
    """Write a log of LAMMPS, with words between its rows."""
    lines = [" ".join(row) for row in rows]
    lines.insert(20, "WARNING: pressure is being computed (src/compute.cpp:12) now")
    return "\n".join([*lines, "Loop time of 1.2 on 1 procs for 30 steps"])


@pytest.mark.parametrize(
    "write",
    [page, latex, arff, coloured, quoted, fluent, gromacs, lammps],
    ids=lambda w: w.__name__,
)
def test_a_table_is_taken_out_of_its_wrapping(tmp_path, write):
    """Names and values are those inside."""
    path = tmp_path / ("table.html" if write is page else "table.txt")
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


def test_vectors_in_brackets_are_columns(tmp_path):
    """OpenFOAM puts the parts of a vector in brackets."""
    path = tmp_path / "U"
    rows = (f"{a:.1f} ({b:.5f} {c:.5f} 0)" for a, b, c in zip(T, X, Y, strict=True))
    path.write_text("# Probe 0 (0 0 0)\n# Time\n" + "\n".join(rows))
    (run,) = read_trajectories(path).trajectories
    np.testing.assert_allclose(run.x, np.column_stack([X, Y]), atol=1e-5)


@pytest.mark.parametrize(
    ("line", "step"),
    [
        ("Sampling rate: 10 Hz", 0.1),
        ("Sample Rate (kHz),2", 5e-4),
        ("Fs = 50", 0.02),
        ("# sampling interval: 5 ms", 5e-3),
        ("dt=0,5 s", 0.5),
        ("Frame rate;25 fps", 0.04),
    ],
)
@pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
def test_a_rate_above_a_table_without_times_says_its_steps(tmp_path, line, step):
    """The rows are counted in seconds, and the answer says by which line."""
    path = tmp_path / "rate.csv"
    rows = "\n".join(f"{b:.5f},{c:.5f}" for b, c in zip(X, Y, strict=True))
    path.write_text(f"Operator: me\n{line}\n\nprey,y\n{rows}\n")
    table = read_trajectories(path)
    (run,) = table.trajectories
    assert run.states == ("prey", "y") and run.time_unit == "s"
    np.testing.assert_allclose(run.t, step * np.arange(31))
    assert any(f"{step:g} s apart" in note for note in table.notes)


@pytest.mark.filterwarnings("ignore::dynsr.errors.DynsrWarning")
def test_a_rate_above_a_table_with_times_says_nothing(tmp_path):
    """The column of times stays the time."""
    path = tmp_path / "timed.csv"
    path.write_text("Sampling rate: 100 Hz\n" + "\n".join(map(",".join, ROWS)))
    (run,) = read_trajectories(path).trajectories
    np.testing.assert_allclose(run.t, T)
