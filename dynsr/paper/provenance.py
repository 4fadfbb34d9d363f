"""Provenance of a replication: what made each of its numbers, and how far two engines differ."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dynsr import __version__
from dynsr.data import Samples
from dynsr.paper.records import Record
from dynsr.report import Formula, Table

EMBEDDED = "embedded"
MADE_BY, ENGINES_BESIDE = "made_by", "engines"
LOSS_FIELDS = ("printed_loss", "trajectory_loss", "equation_rmse")
LOSS_TITLES = ("As printed", "Corrected", "Equation RMSE")
# Packages of a record that integrate, and those that search.
_INTEGRATING = ("julia", "OrdinaryDiffEqTsit5", "juliacall", "dynsr")
_REGRESSING = ("julia", "juliacall", "dynsr", "numpy")
_TODAY = ("DataDrivenDiffEq", "DataDrivenSparse")
_SEARCHING = ("dynsr", "numpy", "scipy", "sympy", "python")
_RELEASES = {
    "2021": "dynsr's own code of the optimizers of DataDrivenDiffEq.jl 0.5",
    "2021-corrected": "dynsr's own code of those optimizers, the best candidate of all",
}


def sample_difference(ours: Samples, theirs: Samples) -> float:
    """Give the largest difference of two sets of samples, each column in units of its maximum.

    >>> import numpy as np
    >>> one = Samples(np.array([[1.0], [2.0]]), np.array([1.0, 4.0]), ("x",), "x", "", np.arange(2))
    >>> sample_difference(Samples(one.X, one.y + 0.5, one.names, "x", "", one.t), one)
    0.125
    """
    a, b = (np.column_stack([s.X, s.y]) for s in (ours, theirs))
    if a.shape != b.shape:
        return math.inf
    size = np.abs(b).max(axis=0)
    return float(np.max(np.abs(a - b) / np.where(size > 0, size, 1.0)))


def made_by_table(records: Sequence[Record], recorded_steps: bool = False) -> Table:
    """Give what made each kind of number, engine and versions, from the records.

    Parameters
    ----------
    records : one for each cell.
    recorded_steps : whether SINDy's samples were made with the steps of 2021.
    """
    methods = {record.method for record in records}
    engine = ", ".join(dict.fromkeys(r.engine for r in records))
    integrates, searched = f"{engine}: Tsit5", _named(records, _SEARCHING)
    rows: list[tuple[str, str, str]] = []
    if "sindy" in methods and recorded_steps:
        how = "embedded: Tsit5 on the steps of 2021"
        rows.append(("samples of SINDy", how, searched))
    others = "samples of the other methods" if rows else "samples"
    rows.append((others, integrates, _named(records, _INTEGRATING)))
    releases = dict.fromkeys(r.settings.get("release") for r in records if r.method == "sindy")
    for release in releases:
        how = _RELEASES.get(str(release), "DataDrivenSparse.jl of today")
        parts = _REGRESSING if str(release) in _RELEASES else (*_TODAY, *_REGRESSING)
        rows.append(("formulas of SINDy", f"{engine}: {how}", _named(records, parts)))
    if methods - {"sindy"}:
        rows.append(("formulas of the other methods", "no engine: dynsr's search", searched))
    rows += [
        ("errors on the samples, bits", "no engine: NumPy", searched),
        ("our losses, the curves of Figure 1", integrates, _named(records, _INTEGRATING)),
        ("the paper's losses, corrected", "embedded: Tsit5", f"dynsr {__version__}"),
    ]
    return Table(MADE_BY, "What made each number", ("Number", "Made by", "Versions"), tuple(rows))


def engines_table(records: Sequence[Record]) -> Table:
    """Give what the embedded engine makes of each cell that another engine computed."""
    compared = [r for r in records if r.embedded]
    engine = ", ".join(dict.fromkeys(r.engine for r in compared))
    columns = (
        *(
            "System",
            "Method",
            "Run",
            "Samples differ by",
            f"Formula, {engine}",
            "Formula, embedded",
        ),
        *(f"{t}: {who}" for t in LOSS_TITLES for who in (engine, "embedded")),
    )
    return Table(
        ENGINES_BESIDE,
        f"Embedded against {engine}, cell by cell",
        columns,
        tuple(_beside(record, record.embedded or {}) for record in compared),
        "Samples differ by: the largest difference of the two training sets, each column in units "
        "of its largest value. SINDy is regressed again by the embedded engine, on samples of its "
        "own. The other searches ask no engine: their formula is the same, integrated again.",
    )


def _beside(record: Record, embedded: Mapping[str, Any]) -> tuple[Any, ...]:
    losses = [_loss(v) for name in LOSS_FIELDS for v in (getattr(record, name), embedded.get(name))]
    again = str(embedded.get("expression", ""))
    return (
        *(record.system, record.method, record.run, _loss(embedded.get("samples"))),
        *(Formula(record.expression), Formula(again) if again else "the same"),
        *losses,
    )


def _loss(value: Any) -> float:
    return math.nan if value is None else float(value)


def _named(records: Iterable[Record], packages: Sequence[str]) -> str:
    """Name those of some packages that the records name, with every version that they have."""
    found: dict[str, dict[str, None]] = {}
    for record in records:
        also = (record.embedded or {}).get("versions", {})
        for name, version in [*also.items(), *record.versions.items()]:
            found.setdefault(name, {})[str(version)] = None
    return ", ".join(f"{name} {' and '.join(found[name])}" for name in packages if name in found)
