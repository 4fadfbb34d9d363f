"""SBML and PEtab: models of systems biology, and the problem of fitting one to its data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from sympy.printing.str import StrPrinter

from dynsr import __version__
from dynsr.data import Trajectory, carry
from dynsr.errors import InputError
from dynsr.export.reactions import Reaction, find_reactions
from dynsr.export.sbml_units import ModelUnits
from dynsr.export.source import Source, Words, number
from dynsr.expression import AllDigits

# Names of the language of formulas that libsbml reads.
SBML: Words = Words(
    (
        *("time", "avogadro", "pi", "exponentiale", "infinity", "inf", "nan", "notanumber", "true"),
        *("false", "piecewise", "delay", "rateOf", "root", "power", "pow", "factorial", "floor"),
        *("ceil", "ceiling", "min", "max", "rem", "quotient", "implies", "xor", "not", "and", "or"),
        *("plus", "times", "minus", "divide", "eq", "neq", "geq", "gt", "leq", "lt", "ln", "log10"),
        *("sqr", "acosh", "asinh", "atanh", "sec", "csc", "cot", "sech", "csch", "coth", "cell"),
        *("arcsin", "arccos", "arctan", "arcsinh", "arccosh", "arctanh", "lambda", "found"),
        *("sin", "cos", "tan", "exp", "sqrt", "abs", "sign", "log", "rate"),
    ),
    shared=False,
)
_LEVEL, _VERSION = 3, 2


class _Formula(AllDigits, StrPrinter):
    def _print_Abs(self, expr: sympy.Expr) -> str:  # noqa: N802 (SymPy's protocol)
        return f"abs({self._print(expr.args[0])})"

    def _print_sign(self, expr: sympy.Expr) -> str:
        inner = self._print(expr.args[0])
        return f"piecewise(1, ({inner}) > 0, -1, ({inner}) < 0, 0)"

    def _print_log(self, expr: sympy.Expr) -> str:
        return f"ln({self._print(expr.args[0])})"


def write_sbml(source: Source) -> str:
    """Write a model of SBML, Level 3 Version 2.

    Parameters
    ----------
    source : what is written.

    Equations of mass action are reactions, all others rate rules. An input that is known as a
    formula is an assignment rule; one whose values were measured is a parameter.
    """
    return _write(source, dict(zip(source.states, source.start, strict=True)), {})


def _write(source: Source, firsts: Mapping[str, float | str], extra: Mapping[str, float]) -> str:
    """Write a model whose states begin with numbers, or with parameters of these names."""
    import libsbml

    document = libsbml.SBMLDocument(_LEVEL, _VERSION)
    model = document.createModel()
    model.setId("found")
    settings = libsbml.L3ParserSettings()
    settings.setModel(model)
    settings.setComparisonCaseSensitivity(libsbml.L3P_COMPARE_BUILTINS_CASE_SENSITIVE)

    # A model of SBML begins at time 0, whenever its data did.
    begin = source.system.span[0] if source.timed else 0.0

    def formula(expr: sympy.Expr) -> Any:
        timed = expr.xreplace({sympy.Symbol("t"): sympy.Symbol("time") + (begin or sympy.S.Zero)})
        text = _Formula().doprint(timed).replace("**", "^")
        tree = libsbml.parseL3FormulaWithSettings(text, settings)
        assert tree is not None, libsbml.getLastParseL3Error()
        return tree

    units = ModelUnits(model, source)
    begins = {str(first): state for state, first in firsts.items()}
    for name, value in [*source.parameters.items(), *extra.items()]:
        _parameter(model, name, value, units.of(begins.get(name, name)))
    for name in source.measured:
        _parameter(model, name, 0.0, units.of(name))
    for name in source.known:
        _parameter(model, name, None, units.of(name))
    reactions = _reactions(source) if units.species else None
    if reactions is not None:
        _add_compartment(model, units)
    for state, first in firsts.items():
        if reactions is None:
            _add_variable(model, state, first, units)
        else:
            _add_species(model, state, first, units)
        if isinstance(first, str):
            start = model.createInitialAssignment()
            start.setSymbol(state)
            start.setMath(libsbml.parseL3FormulaWithSettings(first, settings))
    for name, expr in source.known.items():
        rule = model.createAssignmentRule()
        rule.setVariable(name)
        rule.setMath(formula(expr))
    if reactions is None:
        for state, expr in source.equations.items():
            rate = model.createRateRule()
            rate.setVariable(state)
            rate.setMath(formula(expr))
    for place, one in enumerate(reactions or [], 1):
        size = sympy.Symbol("cell") if units.concentrations else sympy.S.One
        _add_reaction(model, f"reaction_{place}", one, formula(size * one.rate))
    lines = [*source.about(), *([f"The time of this model is t - {begin:g}."] if begin else [])]
    about = "".join(f"<p>{line}</p>" for line in map(_escape, lines))
    model.setNotes(f'<body xmlns="http://www.w3.org/1999/xhtml">{about}</body>')
    return str(libsbml.writeSBMLToString(document))


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _reactions(source: Source) -> list[Reaction] | None:
    try:
        return find_reactions(source)
    except InputError:
        return None


def _parameter(model: Any, name: str, value: float | None, unit: str) -> None:
    """Add a parameter, which is constant where it has a value."""
    parameter = model.createParameter()
    parameter.setId(name)
    parameter.setConstant(value is not None)
    if value is not None:
        parameter.setValue(value)
    if unit:
        parameter.setUnits(unit)


def _add_compartment(model: Any, units: ModelUnits) -> None:
    cell = model.createCompartment()
    cell.setId("cell")
    cell.setSize(1.0)
    cell.setSpatialDimensions(3)
    cell.setConstant(True)
    if units.volume:
        cell.setUnits(units.volume)


def _add_variable(model: Any, state: str, first: float | str, units: ModelUnits) -> None:
    parameter = model.createParameter()
    parameter.setId(state)
    parameter.setConstant(False)
    if not isinstance(first, str):
        parameter.setValue(first)
    if unit := units.of(state):
        parameter.setUnits(unit)


def _add_species(model: Any, state: str, first: float | str, units: ModelUnits) -> None:
    species = model.createSpecies()
    species.setId(state)
    species.setCompartment("cell")
    species.setHasOnlySubstanceUnits(not units.concentrations)
    species.setBoundaryCondition(False)
    species.setConstant(False)
    if units.substance:
        species.setSubstanceUnits(units.substance)
    if not isinstance(first, str):
        set_first = species.setInitialAmount
        if units.concentrations:
            set_first = species.setInitialConcentration
        set_first(first)


def _add_reaction(model: Any, name: str, one: Reaction, rate: Any) -> None:
    reaction = model.createReaction()
    reaction.setId(name)
    reaction.setReversible(False)
    for counts, create in (
        (one.consumed, reaction.createReactant),
        (one.produced, reaction.createProduct),
    ):
        for state, count in counts.items():
            part = create()
            part.setSpecies(state)
            part.setStoichiometry(count)
            part.setConstant(True)
    reaction.createKineticLaw().setMath(rate)


def find_faults(text: str, units: bool = False) -> list[str]:
    """Give what libsbml finds inconsistent in a model.

    Parameters
    ----------
    text : the model.
    units : whether its units are looked at too.
    """
    import libsbml

    document = libsbml.readSBMLFromString(text)
    document.setConsistencyChecks(libsbml.LIBSBML_CAT_UNITS_CONSISTENCY, units)
    document.setConsistencyChecks(libsbml.LIBSBML_CAT_MODELING_PRACTICE, False)
    document.checkConsistency()
    errors = [document.getError(i) for i in range(document.getNumErrors())]
    return [error.getMessage().strip() for error in errors]


def check_petab(source: Source) -> None:
    """Check that the data are those of a PEtab problem.

    Parameters
    ----------
    source : what is to be written.

    Raises InputError when they are not there, lack a state or have an input that changes.
    """
    if not source.runs:
        raise InputError(
            "a PEtab problem needs the data, which a saved result does not keep; give them with "
            "--data FILE, in Python discover again"
        )
    for run in source.runs:
        if source.timed and run.t[0] != source.runs[0].t[0]:
            raise InputError(
                "the equations contain t, and the trajectories begin at different times; a PEtab "
                "problem has one"
            )
        for state in source.states:
            _column(source, run, state)
        for name in source.measured:
            _constant(source, run, name)


def write_petab(source: Source) -> dict[str, str]:
    """Write a PEtab problem (version 1): the model, its data, and what is to be estimated.

    Parameters
    ----------
    source : what is written, as :func:`check_petab` lets it pass.
    """
    taken = {*source.states, *source.parameters, *source.system.inputs}
    begins = {s: _unused(f"start_{s}", taken) for s in source.states}
    spreads = {s: _unused(f"noise_{s}", taken) for s in source.states if _is_measured(source, s)}
    inputs = source.measured
    header = ["conditionId", *begins.values(), *inputs]
    conditions, measurements = [header], [_MEASURED]
    # Where a run begins is estimated of a state that its first row lacks, from what is found on.
    carried = source.begun or tuple(carry(source.runs))
    unknown: dict[str, float] = {}
    for place, (run, begun) in enumerate(zip(source.runs, carried, strict=True), 1):
        condition = f"run_{place}"
        columns = {s: _column(source, run, s) for s in source.states}
        starts = {s: float(_column(source, begun, s)[0]) for s in source.states}
        cells = {s: number(value) for s, value in starts.items()}
        for state in source.states:
            if not math.isfinite(columns[state][0]):
                cells[state] = _unused(f"{begins[state]}_{condition}", taken)
                unknown[cells[state]] = starts[state]
        conditions.append(
            [condition, *cells.values(), *(number(_constant(source, run, u)) for u in inputs)]
        )
        for state in spreads:
            measurements += [
                [f"observed_{state}", condition, number(value), number(t - run.t[0])]
                for t, value in zip(run.t, columns[state], strict=True)
                if np.isfinite(value)
            ]
    observables = [
        _OBSERVED,
        *([f"observed_{s}", s, own, "normal"] for s, own in spreads.items()),
    ]
    estimated = {**source.parameters, **unknown}
    parameters = [_ESTIMATED, *([n, *_bounds(v)] for n, v in estimated.items())]
    for state, name in spreads.items():
        known = (source.noise or {}).get(state) or _spread(source, state)
        parameters.append([name, *_bounds(known)])
    # Alone, the model begins where the first trajectory does.
    firsts = {begins[s]: float(_column(source, carried[0], s)[0]) for s in source.states}
    return {
        "model.xml": _write(source, begins, firsts),
        "parameters.tsv": _table(parameters),
        "conditions.tsv": _table(conditions),
        "observables.tsv": _table(observables),
        "measurements.tsv": _table(measurements),
        "problem.yaml": (
            f"# Made by dynsr {__version__}.\nformat_version: 1\nparameter_file: parameters.tsv\n"
            "problems:\n- sbml_files: [model.xml]\n  condition_files: [conditions.tsv]\n"
            "  observable_files: [observables.tsv]\n  measurement_files: [measurements.tsv]\n"
        ),
    }


_MEASURED = ["observableId", "simulationConditionId", "measurement", "time"]
_OBSERVED = ["observableId", "observableFormula", "noiseFormula", "noiseDistribution"]
_ESTIMATED = [
    "parameterId",
    "parameterScale",
    "lowerBound",
    "upperBound",
    "nominalValue",
    "estimate",
]
# A parameter is sought within so many times its value.
_REACH = 100.0


def _unused(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _table(rows: Sequence[Sequence[str]]) -> str:
    return "".join("\t".join(row) + "\n" for row in rows)


def _bounds(value: float) -> list[str]:
    if value > 0:
        return ["log10", number(value / _REACH), number(value * _REACH), number(value), "1"]
    size = _REACH * (abs(value) or 1.0)
    return ["lin", number(-size), number(size), number(value), "1"]


def _own(source: Source, name: str) -> str:
    """Give what a name of the code is called in the data."""
    return (source.own or {}).get(name, name)


def _column(source: Source, run: Trajectory, name: str) -> np.ndarray:
    own = _own(source, name)
    if own not in run.names:
        raise InputError(f"the data have no column {own!r}, which a PEtab problem needs")
    return run.columns[:, run.names.index(own)]


def _is_measured(source: Source, state: str) -> bool:
    return any(len(run.own_rows(_own(source, state))) for run in source.runs)


def _constant(source: Source, run: Trajectory, name: str) -> float:
    values = _column(source, run, name)
    if np.ptp(values):
        raise InputError(
            f"input {_own(source, name)!r} changes within a trajectory; PEtab takes inputs that do "
            "not, or that are a formula of t"
        )
    return float(values[0])


def _spread(source: Source, state: str) -> float:
    """Give a hundredth of the spread of a state, to begin a search for its noise with."""
    values = np.concatenate([_column(source, run, state) for run in source.runs])
    return float(np.nanstd(values)) / _REACH or 1.0
