"""Random tables as people and machines write them, and broken: described, or one line says why not.

``DYNSR_FUZZ_SEED`` draws others.
"""

import os
import random
import warnings

import numpy as np
import pytest

import dynsr
from dynsr.errors import DynsrError, DynsrWarning

SEED = int(os.environ.get("DYNSR_FUZZ_SEED", "0"))
COUNT = 500
CELLS = [
    *(
        "",
        "NA",
        "n.d.",
        "nan",
        "-",
        "--",
        "#N/A",
        "<8.0",
        ">1e3",
        "40 %",
        "ON",
        "off",
        "1,633",
        "1.2.3",
    ),
    *("1e999", "0x1F", "1_000", "½", "−3.5", "3°", "true", "None", "12:30", "24:00:00"),
    *("1/2/2024", "1.2.3", "e", "+"),
    *(
        '"',
        "'",
        "#81",
        "81#7",
        "a,b",
        "\t",
        "\x00",
        "\x1b[31m",
        "😀",
        "1 234,5",
        "1'234.5",
        "+",
        "e",
    ),
    *("2024-02-30", "9" * 400, "∞", "inf", "-inf", "=1+1", "NULL", "?", "1e", "..", "1..2"),
]
NAMES = [
    *(
        "t",
        "time",
        "Time (s)",
        "t [h]",
        "x",
        "y",
        "x",
        "X",
        "temperature (°C)",
        "date",
        "",
        " ",
        "1",
    ),
    *(
        "a b",
        "λ",
        "µ",
        "x'",
        "sin",
        "inf",
        "nan",
        "if",
        "__class__",
        "run",
        "id",
        "sd_x",
        "x_sd",
        "N",
    ),
    *(
        "x.1",
        "Unnamed: 0",
        "index",
        "label",
        "=cmd",
        "t",
        "state",
        "callable",
        "\ufeffx",
        "é",
        "a" * 200,
    ),
]
TIMES = [
    lambda i: f"{i * 0.1:g}",
    str,
    lambda i: f"2024-03-0{1 + i // 24 % 9} {i % 24:02}:00",
    lambda i: f"{1 + i // 24 % 28}.03.2024 {i % 24:02}:00:00",
    lambda i: f"{i // 60:02}:{i % 60:02}",
    lambda i: f"{i % 12 + 1}:00 {'AM' if i % 24 < 12 else 'PM'}",
    lambda i: f"{i * 0.1:g}".replace(".", ","),
    lambda i: str(i % 7),
    lambda i: f"{1.7e9 + 60 * i:.0f}",
]


def make_table(draw: random.Random) -> bytes:
    """Write one table, with a few things in it that do not belong there."""
    rows, width = draw.choice([0, 1, 3, 8, 12, 40, 150]), draw.randrange(1, 7)
    mark, comma = draw.choice([",", ";", "\t", " ", "|", ","]), draw.random() < 0.2
    end = draw.choice(["\n", "\n", "\r\n", "\r"])
    when = draw.choice(TIMES)
    odd = draw.choice([0.0, 0.0, 0.02, 0.2])
    lines = []
    for i in range(rows):
        cells = [when(i)]
        for j in range(width):
            number = f"{np.exp(-0.05 * i) * (j + 1) + draw.gauss(0, 0.01):.5g}"
            cells.append(number.replace(".", ",") if comma else number)
        cells = [draw.choice(CELLS) if draw.random() < odd else cell for cell in cells]
        if draw.random() < odd / 4:
            cells = cells[: draw.randrange(len(cells) + 1)]
        if draw.random() < 0.1:
            cells = [f'"{cell}"' for cell in cells]
        lines.append(mark.join(cells))
    head = [mark.join(["t", *draw.sample(NAMES, width)])] if draw.random() < 0.8 else []
    if draw.random() < 0.2:
        head.append(mark.join(["(s)", *draw.choices(["(m)", "[kg]", "-", "mmHg"], k=width)]))
    above = draw.choices(["# made by hand", "Logger 7;;;", "", "Experiment 3", "sep=;"], k=2)
    lines = [*(above if draw.random() < 0.3 else []), *head, *lines]
    for _ in range(draw.choice([0, 0, 0, 1, 2])):
        lines.insert(draw.randrange(len(lines) + 1), draw.choice(["", mark * width, "total", "#"]))
    code = draw.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1", "cp1252"])
    content = end.join([*lines, ""] if draw.random() < 0.8 else lines).encode(code, "replace")
    if draw.random() < 0.1:
        at = draw.randrange(len(content) + 1)
        content = content[:at] + bytes(draw.randrange(256) for _ in range(3)) + content[at:]
    return content


def fault_of(path) -> str:
    """Describe a table; say what is wrong with how that ends, "" for nothing."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            str(dynsr.describe(path))
        except DynsrError as error:
            if "\n" in str(error) or len(str(error)) > 700:
                return f"no one line: {error}"
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    foreign = [w for w in heard if not issubclass(w.category, DynsrWarning)]
    return f"a foreign warning: {foreign[0].message}" if foreign else ""


@pytest.mark.slow
def test_every_table_is_described_or_refused_in_one_line(tmp_path):
    """Whatever stands in a file, reading it ends in a description or in one line of dynsr's own."""
    draw, faults = random.Random(SEED), {}
    for number in range(COUNT):
        path = tmp_path / f"{number}.{draw.choice(['csv', 'csv', 'tsv', 'txt', 'dat'])}"
        path.write_bytes(make_table(draw))
        if fault := fault_of(path):
            faults[number] = fault
    assert not faults, faults
