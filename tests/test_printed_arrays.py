"""Arrays and frames that programs printed into a file."""

import numpy as np
import pandas as pd
import pytest

from dynsr.data import read_trajectories
from dynsr.errors import InputError

T = np.linspace(0.0, 3.0, 31)
ARRAY = np.column_stack([T, np.exp(-T), np.cos(T)])
BY_SPACES = [f"{a:g} {b:g} {c:g}" for a, b, c in ARRAY]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (str(ARRAY), ["x1", "x2"]),
        (repr(ARRAY), ["x1", "x2"]),
        (f"x = {ARRAY.tolist()}", ["x1", "x2"]),
        ("\n".join(map(str, ARRAY)), ["x1", "x2"]),
        (f"t a b\n{ARRAY}", ["a", "b"]),
        ("t,a,b\n" + "\n".join(str(tuple(row)) for row in ARRAY.tolist()), ["a", "b"]),
        ("data = [\n" + ";\n".join(BY_SPACES) + "];", ["x1", "x2"]),
        ("A = [" + "; ".join(BY_SPACES) + "]", ["x1", "x2"]),
        ("31\u00d73 Matrix{Float64}:\n " + "\n ".join(BY_SPACES), ["x1", "x2"]),
        (
            "double x[31][3] = {"
            + ",\n".join("{" + row.replace(" ", ", ") + "}" for row in BY_SPACES)
            + "};",
            ["x1", "x2"],
        ),
    ],
    ids=["NumPy", "repr", "list", "rows", "names", "tuples", "MATLAB", "a line", "Julia", "C"],
)
def test_arrays_are_read_as_programs_print_them(tmp_path, text, names):
    """All rows and columns are there, under the names that stand above them."""
    path = tmp_path / "array.txt"
    path.write_text(text, encoding="utf-8")
    (run,) = read_trajectories(path).trajectories
    assert list(run.states) == names
    np.testing.assert_allclose(np.column_stack([run.t, run.x]), ARRAY, rtol=1e-5, atol=1e-5)


def test_an_array_that_is_cut_is_refused(tmp_path):
    """NumPy leaves out the middle of a long one; the line says so, and what to do."""
    path = tmp_path / "array.txt"
    path.write_text(np.array2string(np.tile(ARRAY, (10, 1)), threshold=10))
    with pytest.raises(InputError, match=r"left out \(\.\.\.\); save all of it.*savetxt"):
        read_trajectories(path)


def test_a_frame_that_was_printed_is_read_without_its_row_numbers(tmp_path):
    """pandas counts from 0, or from where a part begins, and has no name for that."""
    frame = pd.DataFrame(ARRAY, columns=["t", "a", "b"])
    for part in (frame, frame[10:]):
        path = tmp_path / "frame.txt"
        path.write_text(part.to_string())
        (run,) = read_trajectories(path).trajectories
        assert run.states == ("a", "b")
        np.testing.assert_allclose(run.t, part.t, atol=1e-6)


PRINTED = {
    "Julia": "31\u00d73 DataFrame\n Row \u2502 t  a  b\n     \u2502 Float64  Float64  Float64\n"
    "\u2500\u2500\u2500\u2500\u2500\u253c\u2500\u2500\u2500\u2500\n{}",
    "R": "# A tibble: 31 \u00d7 3\n       t     a     b\n   <dbl> <dbl> <dbl>\n{}",
    "Polars": "shape: (31, 3)\n\u250c\u2500\u2500\u2510\n\u2502 t \u2506 a \u2506 b \u2502\n"
    "\u2502 --- \u2506 --- \u2506 --- \u2502\n\u2502 f64 \u2506 f64 \u2506 f64 \u2502\n"
    "\u255e\u2550\u2550\u2561\n{}\n\u2514\u2500\u2500\u2518",
    "grid": "+---+---+---+\n| t | a | b |\n+===+===+===+\n{}\n+---+---+---+",
    "log": "{}",
    "logging": "{}",
}
ROWS = {
    "Julia": "{i:4d} \u2502 {t:.5f} {a:.5f} {b:.5f}",
    "R": "{i} {t:.5f} {a:.5f} {b:.5f}",
    "Polars": "\u2502 {t:.5f} \u2506 {a:.5f} \u2506 {b:.5f} \u2502",
    "grid": "| {t:.5f} | {a:.5f} | {b:.5f} |",
    "log": "INFO:root:t={t:.5f} a={a:.5f} b={b:.5f}",
    "logging": "2024-01-01 10:00:00,{ms:03d} - run - INFO - a={a:.5f} b={b:.5f}",
}


@pytest.mark.parametrize("kind", PRINTED)
def test_frames_and_logs_are_read_as_programs_print_them(tmp_path, kind):
    """Lines around cells, types, row numbers and the heads of logs are no part of the table."""
    rows = [
        ROWS[kind].format(i=i + 1, t=t, a=a, b=b, ms=round(100 * t))
        for i, (t, a, b) in enumerate(ARRAY)
    ]
    between = "\n+---+---+---+\n" if kind == "grid" else "\n"
    path = tmp_path / "printed.txt"
    path.write_text(PRINTED[kind].format(between.join(rows)), encoding="utf-8")
    (run,) = read_trajectories(path).trajectories
    assert run.states == ("a", "b")
    t = run.t * (10 if kind == "logging" else 1)
    np.testing.assert_allclose(np.column_stack([t, run.x]), ARRAY, atol=1e-5)


def test_plots_of_gromacs_are_read(tmp_path):
    """Lines with @ say how to draw the table."""
    path = tmp_path / "energy.xvg"
    path.write_text('# by g_energy\n@ title "E"\n@TYPE xy\n' + "\n".join(BY_SPACES))
    (run,) = read_trajectories(path).trajectories
    np.testing.assert_allclose(run.x, ARRAY[:, 1:], atol=1e-5)
