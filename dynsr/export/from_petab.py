"""From PEtab: a problem's model with its parameters, and its measurements as trajectories.

A model parameter or a start that a condition sets is one of that run: parameters that differ from
run to run are inputs, which keep their values within each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynsr.arguments import checked
from dynsr.data import Trajectory
from dynsr.errors import InputError, need
from dynsr.export.from_sbml import read_model, read_sbml
from dynsr.parameters import Parameters, ParametricSystem

_VERSIONS = (1, "1")


@checked
def read_petab(path: str | Path) -> tuple[ParametricSystem, list[Trajectory]]:
    """Read a PEtab problem of version 1: its model, and its measurements, one run a condition.

    Parameters
    ----------
    path : the YAML file.

    Replicates of one time are averaged; an observable that is a state is called so. Raises
    InputError when the problem cannot be read, MissingExtra without the extra ``sbml``.
    """
    need("libsbml", "sbml", "reading PEtab")
    need("yaml", "sbml", "reading PEtab")
    import yaml

    file = Path(path)
    try:
        asked = yaml.safe_load(file.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        raise InputError(
            f"cannot read {str(file)!r}; give the YAML file of a PEtab problem"
        ) from None
    if not isinstance(asked, Mapping) or asked.get("format_version") not in _VERSIONS:
        raise InputError(f"{str(file)!r} is no PEtab problem of version 1; give one")
    problems = asked.get("problems")
    if not isinstance(problems, list) or len(problems) != 1 or not isinstance(problems[0], Mapping):
        raise InputError(f"{str(file)!r} must contain one problem; give each a file of its own")
    parts = {key: _files(file, problems[0], key) for key in _TABLES}
    model = parts["sbml_files"][0]
    nominal = {}
    if "parameter_file" in asked:
        nominal = _numbers(_read(_inside(file, asked["parameter_file"])), "nominalValue")
    tables = {key: _read_all(parts[key]) for key in _TABLES if key != "sbml_files"}
    # A condition may name a parameter in the place of a number.
    set_by = tables["condition_files"]
    for name in set_by.columns.difference(["conditionId", "conditionName"]):
        set_by[name] = [str(nominal.get(text, text)) for text in set_by[name]]
    system, runs = _with_runs(_with_values(read_sbml(model), nominal), tables)
    if not runs:
        return system, runs
    listed = tables["condition_files"].to_dict("records")
    first = next(one for one in listed if one["conditionId"] == runs[0].origin["condition"])
    # A start may be a parameter that a condition sets.
    set_there = {
        name: float(text)
        for name, text in first.items()
        if name != "conditionId" and _is_number(text)
    }
    begins = read_model(model, {**nominal, **set_there})
    return replace(system, x0=begins.x0), runs


def _is_number(text: object) -> bool:
    try:
        return math.isfinite(float(str(text)))
    except ValueError:
        return False


_TABLES = ("sbml_files", "condition_files", "observable_files", "measurement_files")


def _inside(file: Path, name: Any) -> Path:
    """Give a file that a problem names, which lies next to it or below."""
    found = (file.parent / str(name)).resolve()
    if not found.is_relative_to(file.parent.resolve()):
        raise InputError(f"{str(name)!r} lies outside the folder of {str(file)!r}; move it there")
    return found


def _files(file: Path, problem: Mapping[str, Any], key: str) -> list[Path]:
    names = problem.get(key)
    if not isinstance(names, list) or not names:
        raise InputError(f"{str(file)!r} names no {key}; give a PEtab problem of version 1")
    return [_inside(file, name) for name in names]


def _read(path: Path) -> Any:
    import pandas as pd

    try:
        return pd.read_csv(path, sep="\t", dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {str(path)!r} as a table ({error})") from None


def _read_all(paths: list[Path]) -> Any:
    import pandas as pd

    return pd.concat([_read(path) for path in paths], ignore_index=True)


def _column(table: Any, name: str) -> list[str]:
    if name not in table.columns:
        raise InputError(f"a table of the problem has no column {name!r}; give one")
    return list(map(str, table[name]))


def _number(text: str, what: str) -> float:
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise InputError(f"{what} is {text!r}; give a number")
    return found


def _numbers(table: Any, column: str) -> dict[str, float]:
    names = _column(table, "parameterId")
    pairs = zip(names, _column(table, column), strict=True)
    return {name: _number(text, f"{column} of {name!r}") for name, text in pairs if text}


def _with_values(system: ParametricSystem, values: Mapping[str, float]) -> ParametricSystem:
    own = {n: v for n, v in values.items() if n in system.parameters}
    return system.with_parameters(**own)


def _with_runs(
    system: ParametricSystem, tables: Mapping[str, Any]
) -> tuple[ParametricSystem, list[Trajectory]]:
    names = dict(
        zip(
            _column(tables["observable_files"], "observableId"),
            _column(tables["observable_files"], "observableFormula"),
            strict=True,
        )
    )
    called = {
        one: formula if formula in system.equations else one for one, formula in names.items()
    }
    if len(set(called.values())) < len(called):
        called = {one: one for one in names}
    listed = tables["condition_files"]
    pairs = zip(_column(listed, "conditionId"), listed.to_dict("records"), strict=True)
    conditions = dict(pairs)
    rows: dict[str, dict[float, dict[str, list[float]]]] = {}
    measured = tables["measurement_files"]
    for place, (observable, condition, value, when) in enumerate(
        zip(
            _column(measured, "observableId"),
            _column(measured, "simulationConditionId"),
            _column(measured, "measurement"),
            _column(measured, "time"),
            strict=True,
        ),
        1,
    ):
        if observable not in called or condition not in conditions:
            raise InputError(
                f"measurement {place} is of {observable!r} in {condition!r}; the problem lacks one"
            )
        at = rows.setdefault(condition, {}).setdefault(_number(when, f"time {place}"), {})
        at.setdefault(called[observable], []).append(_number(value, f"measurement {place}"))
    varied = _varied(system, conditions, list(rows))
    alike = {n: next(iter(v.values())) for n, v in varied.items() if len(set(v.values())) == 1}
    system = _with_values(system, alike)
    varied = {n: v for n, v in varied.items() if n not in alike}
    columns = tuple(dict.fromkeys(called.values()))
    runs = []
    for condition, by_time in rows.items():
        t = np.array(sorted(by_time))
        x = np.array([[np.mean(by_time[time].get(c, [math.nan])) for c in columns] for time in t])
        held = np.array([varied[name][condition] for name in varied])
        inputs = np.tile(held, (len(t), 1))
        runs.append(Trajectory(t, x, columns, inputs, tuple(varied), {"condition": condition}))
    kept = [p for n, p in system.parameters.items() if n not in varied]
    driven = {**system.inputs, **dict.fromkeys(varied)}
    return replace(system, parameters=Parameters(kept), inputs=driven), runs


def _varied(
    system: ParametricSystem, conditions: Mapping[str, Mapping[str, str]], used: list[str]
) -> dict[str, dict[str, float]]:
    """Give parameter -> condition -> value, of those that a condition sets."""
    found: dict[str, dict[str, float]] = {}
    for name, parameter in system.parameters.items():
        values = {}
        for condition in used:
            text = str(conditions[condition].get(name, "")).strip()
            values[condition] = (
                parameter.value if not text else _number(text, f"{name!r} in {condition!r}")
            )
        if any(value != parameter.value for value in values.values()):
            found[name] = values
    return found
