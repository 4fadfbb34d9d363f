"""From SBML: the differential equations of a model, with its parameters by their names.

Reactions become slopes: what each makes of a species times its rate. Functions that a model defines
are put in where they are used, and assignment rules where their variables are. What is no
differential equation of such formulas (events, delays, algebraic rules) is refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import sympy

from dynsr.arguments import checked
from dynsr.errors import InputError, MissingExtra, need, one_line
from dynsr.export.sbml_units import named_unit, read_names, read_unit
from dynsr.expression import check_name, parse
from dynsr.parameters import Parameter, Parameters, ParametricSystem

_TIME = sympy.Symbol("t")
# Assignments that stand in one another deeper than this go round in a circle.
_DEEPEST = 50
_LARGEST = 50_000_000
# Models of levels before this one have units where they name none.
_EXPLICIT = 3
# Of libsbml, from here on no warning.
_ERROR = 2


@checked
def read_sbml(path: str | Path) -> ParametricSystem:
    """Read a model of SBML as equations with named parameters, from its start.

    Parameters
    ----------
    path : the file.

    Raises InputError when it is no model, or no differential equations of dynsr's formulas;
    MissingExtra without python-libsbml.
    """
    return read_model(path, {})


def read_model(path: str | Path, values: Mapping[str, float]) -> ParametricSystem:
    """Read a model of SBML with other values for some of its parts.

    Parameters
    ----------
    path : the file.
    values : part of the model -> its value in the place of the model's own.

    Raises as :func:`read_sbml` does.
    """
    need("libsbml", "sbml", "reading SBML")
    import libsbml

    file = Path(path)
    try:
        if file.stat().st_size > _LARGEST:
            raise InputError(f"{str(file)!r} is larger than {_LARGEST // 10**6} MB; give a model")
        text = file.read_text("utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"cannot read {str(file)!r}: {error.strerror or error}") from None
    document = libsbml.readSBMLFromString(text)
    model = document.getModel()
    if model is None or document.getNumErrors(libsbml.LIBSBML_SEV_FATAL):
        raise InputError(f"{str(file)!r} is no model of SBML; give one")
    properties = libsbml.ConversionProperties()
    properties.addOption("expandFunctionDefinitions", True)
    if document.convert(properties) != libsbml.LIBSBML_OPERATION_SUCCESS:
        document.checkConsistency()
        errors = [document.getError(i) for i in range(document.getNumErrors())]
        first = next((e.getMessage() for e in errors if e.getSeverity() >= _ERROR), "unknown")
        raise InputError(f"{str(file)!r} is inconsistent: {one_line(first)[:200]}")
    try:
        return _Model.of(document.getModel()).system(file.stem, values)
    except InputError as error:
        raise InputError(f"in {str(file)!r}: {error}") from None


def _formula(node: Any, local: Mapping[str, sympy.Expr]) -> sympy.Expr:
    """Give a formula of SBML in SymPy; names as symbols, but for those that are local."""
    import libsbml as sb

    if node is None:
        raise InputError("a formula is missing")
    kind = node.getType()
    if kind in (sb.AST_NAME, sb.AST_FUNCTION):
        if kind == sb.AST_FUNCTION:
            raise InputError(f"the function {node.getName()!r} is not known")
        name = node.getName()
        return local[name] if name in local else sympy.Symbol(name)
    if kind == sb.AST_INTEGER:
        return sympy.Integer(node.getInteger())
    if kind in (sb.AST_REAL, sb.AST_REAL_E):
        return sympy.Float(node.getReal())
    if kind == sb.AST_RATIONAL:
        return sympy.Rational(node.getNumerator(), node.getDenominator())
    known = {sb.AST_NAME_TIME: _TIME, sb.AST_CONSTANT_PI: sympy.pi, sb.AST_CONSTANT_E: sympy.E}
    if kind in known:
        return known[kind]
    if kind == sb.AST_FUNCTION_PIECEWISE:
        return _sign(node, local)
    parts = [_formula(node.getChild(i), local) for i in range(node.getNumChildren())]
    make = _operators().get(kind)
    if make is None:
        raise InputError(f"{one_line(sb.formulaToL3String(node))[:80]!r} is no formula of dynsr's")
    return make(*parts)


def _operators() -> dict[int, Callable[..., sympy.Expr]]:
    import libsbml as sb

    def minus(*parts: sympy.Expr) -> sympy.Expr:
        return -parts[0] if len(parts) == 1 else parts[0] - parts[1]

    def log(*parts: sympy.Expr) -> sympy.Expr:
        base, inner = parts if len(parts) == 2 else (sympy.Integer(10), parts[0])
        return sympy.log(inner) / sympy.log(base)

    def root(*parts: sympy.Expr) -> sympy.Expr:
        degree, inner = parts if len(parts) == 2 else (sympy.Integer(2), parts[0])
        return inner ** (1 / degree)

    def power(base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
        return base**exponent

    return {
        sb.AST_PLUS: sympy.Add,
        sb.AST_TIMES: sympy.Mul,
        sb.AST_MINUS: minus,
        sb.AST_DIVIDE: lambda a, b: a / b,
        sb.AST_POWER: power,
        sb.AST_FUNCTION_POWER: power,
        sb.AST_FUNCTION_ROOT: root,
        sb.AST_FUNCTION_EXP: sympy.exp,
        sb.AST_FUNCTION_LN: sympy.log,
        sb.AST_FUNCTION_LOG: log,
        sb.AST_FUNCTION_ABS: sympy.Abs,
        sb.AST_FUNCTION_SIN: sympy.sin,
        sb.AST_FUNCTION_COS: sympy.cos,
        sb.AST_FUNCTION_TAN: sympy.tan,
        sb.AST_FUNCTION_SINH: sympy.sinh,
        sb.AST_FUNCTION_COSH: sympy.cosh,
        sb.AST_FUNCTION_TANH: sympy.tanh,
        sb.AST_FUNCTION_ARCSIN: sympy.asin,
        sb.AST_FUNCTION_ARCCOS: sympy.acos,
        sb.AST_FUNCTION_ARCTAN: sympy.atan,
    }


def _sign(node: Any, local: Mapping[str, sympy.Expr]) -> sympy.Expr:
    """Give the sign that a formula by cases is: 1 above 0, -1 below, else 0."""
    import libsbml as sb

    count = node.getNumChildren()
    cases = [node.getChild(i) for i in range(count)]
    if count == 5:
        above, when_above, below, when_below, rest = cases
        values = [_formula(part, local) for part in (above, below, rest)]
        kinds = [when_above.getType(), when_below.getType()]
        if values == [1, -1, 0] and kinds == [sb.AST_RELATIONAL_GT, sb.AST_RELATIONAL_LT]:
            inner = [_formula(w.getChild(0), local) for w in (when_above, when_below)]
            zero = [_formula(w.getChild(1), local) for w in (when_above, when_below)]
            if inner[0] == inner[1] and zero == [0, 0]:
                return sympy.sign(inner[0])
    raise InputError(f"{one_line(sb.formulaToL3String(node))[:80]!r} goes by cases; dynsr has none")


@dataclass
class _Model:
    """What a model says, by the names of its parts."""

    values: dict[str, float] = field(default_factory=dict)
    assigned: dict[str, sympy.Expr] = field(default_factory=dict)
    slopes: dict[str, sympy.Expr] = field(default_factory=dict)
    starts: dict[str, sympy.Expr] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, model: Any) -> _Model:
        """Take a model of libsbml apart."""
        if model.getNumEvents():
            raise InputError("the model has events, which no differential equation has")
        found = cls()
        for home in model.getListOfCompartments():
            found.values[home.getId()] = float(home.getSize()) if home.isSetSize() else math.nan
        for part in model.getListOfParameters():
            found.values[part.getId()] = float(part.getValue()) if part.isSetValue() else math.nan
        for start in model.getListOfInitialAssignments():
            found.starts[start.getSymbol()] = _formula(start.getMath(), {})
        found._take_rules(model)
        found._take_species(model)
        # Without pint, units are not read.
        with suppress(MissingExtra):
            found._take_units(model)
        first = [s.getId() for s in model.getListOfSpecies() if s.getId() in found.slopes]
        found.slopes = {name: found.slopes[name] for name in dict.fromkeys([*first, *found.slopes])}
        return found

    def _take_units(self, model: Any) -> None:
        names = read_names(model)
        for part in model.getListOfParameters():
            self.units[part.getId()] = read_unit(part.getDerivedUnitDefinition(), names)
        for part in model.getListOfSpecies():
            text = read_unit(part.getDerivedUnitDefinition(), names)
            home = model.getCompartment(part.getCompartment()).getDerivedUnitDefinition()
            amount = read_unit(named_unit(model, part.getSubstanceUnits()), names)
            volume = read_unit(home, names)
            if not part.getHasOnlySubstanceUnits() and amount and volume:
                text = f"{amount}/{volume}"
            self.units[part.getId()] = text
        time = model.getTimeUnits()
        if not time and model.getLevel() < _EXPLICIT:
            time = "time" if model.getUnitDefinition("time") else "second"
        self.units["t"] = read_unit(named_unit(model, time), names)

    def _take_rules(self, model: Any) -> None:
        for rule in model.getListOfRules():
            name, formula = rule.getVariable(), rule.getMath()
            if rule.isAlgebraic():
                raise InputError("the model has an algebraic rule, which is no slope")
            (self.slopes if rule.isRate() else self.assigned)[name] = _formula(formula, {})

    def _take_species(self, model: Any) -> None:
        compartments = {c.getId(): c for c in model.getListOfCompartments()}
        moved: dict[str, sympy.Expr] = {}
        for reaction in model.getListOfReactions():
            self._take_reaction(reaction, moved)
        for species in model.getListOfSpecies():
            name, home = species.getId(), species.getCompartment()
            amounts = species.getHasOnlySubstanceUnits()
            size = sympy.Symbol(home)
            if home in self.slopes or home in self.assigned:
                raise InputError(f"compartment {home!r} changes its size; give a model of amounts")
            if not amounts and compartments[home].getSpatialDimensions() == 0:
                amounts = True
            self.values[name] = self._first(species, amounts, self.values.get(home, 1.0))
            fixed = species.getConstant() or species.getBoundaryCondition()
            if name in self.slopes or name in self.assigned or fixed:
                continue
            terms = sympy.Add.make_args(moved.get(name, sympy.S.Zero))
            self.slopes[name] = sympy.Add(*(term / (1 if amounts else size) for term in terms))

    @staticmethod
    def _first(species: Any, amounts: bool, size: float) -> float:
        if species.isSetInitialAmount():
            return float(species.getInitialAmount()) / (1.0 if amounts else size)
        if species.isSetInitialConcentration():
            return float(species.getInitialConcentration()) * (size if amounts else 1.0)
        return math.nan

    def _take_reaction(self, reaction: Any, moved: dict[str, sympy.Expr]) -> None:
        name, law = reaction.getId(), reaction.getKineticLaw()
        if law is None or law.getMath() is None:
            raise InputError(f"reaction {name!r} has no rate; give its kinetic law")
        local = {}
        for own in (*law.getListOfParameters(), *law.getListOfLocalParameters()):
            called = f"{name}_{own.getId()}"
            local[own.getId()] = sympy.Symbol(called)
            self.values[called] = float(own.getValue()) if own.isSetValue() else math.nan
        rate = _formula(law.getMath(), local)
        for parts, sign in ((reaction.getListOfReactants(), -1), (reaction.getListOfProducts(), 1)):
            for part in parts:
                if part.isSetStoichiometryMath() or part.getId() in self.assigned:
                    raise InputError(f"a stoichiometry of reaction {name!r} changes")
                count = part.getStoichiometry() if part.isSetStoichiometry() else 1.0
                whole = sympy.Integer(int(count)) if count == int(count) else sympy.Float(count)
                species = part.getSpecies()
                moved[species] = moved.get(species, sympy.S.Zero) + sign * whole * rate

    def system(self, name: str, values: Mapping[str, float]) -> ParametricSystem:
        """Give the equations with the parameters that they hold; some values are given."""
        self.values.update(values)
        self.starts = {part: formula for part, formula in self.starts.items() if part not in values}
        slopes = {s: self._closed(e) for s, e in self.slopes.items()}
        if not slopes:
            raise InputError("the model has no variable that moves; give one with rates")
        known = dict(self.values)
        for part, formula in self.starts.items():
            known[part] = self._number(part, formula)
        used = {str(s) for e in slopes.values() for s in e.free_symbols} - {*slopes, "t"}
        taken = {*slopes, *used}
        new = {old: _allowed(old, taken) for old in taken}
        swaps = {sympy.Symbol(a): sympy.Symbol(b) for a, b in new.items() if a != b}
        equations = {new[s]: parse(e.xreplace(swaps)) for s, e in slopes.items()}
        for part in (*slopes, *sorted(used)):
            if math.isnan(known.get(part, math.nan)):
                raise InputError(f"{part!r} has no value; give one in the model")
        holders = {
            n: tuple(new[s] for s, e in slopes.items() if sympy.Symbol(n) in e.free_symbols)
            for n in used
        }
        order = sorted(used, key=list(known).index)
        units = self.units
        parameters = [
            Parameter(new[n], known[n], unit=units.get(n, ""), states=holders[n]) for n in order
        ]
        start = {new[s]: known[s] for s in slopes}
        given = {new.get(n, n): units[n] for n in (*slopes, "t") if units.get(n)}
        system = ParametricSystem(equations, Parameters(parameters), x0=start, name=name)
        return replace(system, units=given, time_unit=given.get("t", ""))

    def _closed(self, expr: sympy.Expr) -> sympy.Expr:
        """Put what is assigned in the place of its name."""
        swaps = {sympy.Symbol(name): formula for name, formula in self.assigned.items()}
        for _ in range(_DEEPEST):
            if not expr.free_symbols & swaps.keys():
                return expr
            expr = expr.xreplace(swaps)
        raise InputError("assignment rules refer to one another in a circle")

    def _number(self, name: str, formula: sympy.Expr) -> float:
        """Give what a formula is at the start."""
        closed = self._closed(formula)
        for _ in range(_DEEPEST):
            inner = {s: self.starts[str(s)] for s in closed.free_symbols if str(s) in self.starts}
            if not inner:
                break
            closed = self._closed(closed.xreplace(inner))
        known = {sympy.Symbol(n): sympy.Float(v) for n, v in self.values.items()}
        if odd := [s for s in closed.free_symbols if math.isnan(self.values.get(str(s), math.nan))]:
            if odd[0] != _TIME:
                raise InputError(f"{str(odd[0])!r} has no value; give one in the model")
        found = closed.xreplace({**known, _TIME: sympy.S.Zero})
        if not found.is_real:
            raise InputError(f"the initial value of {name!r} is no number")
        return float(found)


def _allowed(name: str, taken: set[str]) -> str:
    """Give a name that a formula of dynsr can hold."""
    found = name
    while True:
        try:
            check_name(found)
        except InputError:
            found += "_"
            continue
        if found == "t" or (found != name and found in taken):
            found += "_"
            continue
        return found
