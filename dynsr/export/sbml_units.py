"""Units of a model of SBML: those that the user gave, as powers of SBML's base units, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from itertools import product
from typing import Any

from dynsr.errors import InputError
from dynsr.export.source import Source
from dynsr.expression import Unit, read_units

_BASE = {
    "[length]": "metre",
    "[mass]": "kilogram",
    "[time]": "second",
    "[current]": "ampere",
    "[temperature]": "kelvin",
    "[substance]": "mole",
    "[luminosity]": "candela",
}
_LITRE = Unit((("[length]", Fraction(3)),), 1e-3, (("l", Fraction(1)),))


class ModelUnits:
    """The units of a model, which are defined as they are asked for.

    Parameters
    ----------
    model : of libsbml; the unit of its time is set.
    source : the equations with the units of their columns and parameters.

    Attributes
    ----------
    species : whether the states can be species; those of other units are plain variables.
    concentrations : whether they are amounts in a volume.
    substance : name of the unit of their amounts; "" where it is not known.
    """

    def __init__(self, model: Any, source: Source) -> None:
        self._model = model
        self._names: dict[tuple[Any, float], str] = {}
        self._units: dict[str, Unit] = {}
        columns, time = source.system.units, source.system.time_unit
        texts = {p.name: p.unit for p in source.system.parameters.values()}
        texts |= {n: columns.get((source.own or {}).get(n, n), "") for n in source.columns}
        texts["t"] = columns.get("t", time)
        for name, text in texts.items():
            # Without pint, or where it cannot read one, a model has no unit there.
            with suppress(InputError):
                if text:
                    ((_, unit),) = read_units({name: text}).columns
                    if {base for base, _ in unit.dimensions} <= _BASE.keys():
                        self._units[name] = unit
        if time := self.of("t"):
            model.setTimeUnits(time)
        self.substance, self.concentrations = "", False
        self.species = self._set_species([self._units.get(state) for state in source.states])

    def of(self, name: str) -> str:
        """Give the name of a unit in the model; "" where it is not known.

        Parameters
        ----------
        name : of a state, an input, a parameter, or ``t``.
        """
        return self._define(self._units[name]) if name in self._units else ""

    def _set_species(self, units: list[Unit | None]) -> bool:
        known = [unit for unit in units if unit is not None]
        if not known:
            return True
        first = known[0]
        if len(known) < len(units) or not all(unit.same(first) for unit in known):
            return False
        for volume in (None, _LITRE):
            amount = first if volume is None else first.times(volume)
            if amount.dimensions in ((), *((((base, Fraction(1)),)) for base in _AMOUNTS)):
                self.concentrations = volume is not None
                self.substance = self._define(amount)
                self._model.setSubstanceUnits(self.substance)
                self._model.setExtentUnits(self.substance)
                return True
        return False

    @property
    def volume(self) -> str:
        """Name of the unit of the compartment's size; "" where it is not known."""
        return self._define(_LITRE) if self.substance else ""

    def _define(self, unit: Unit) -> str:
        key = (unit.dimensions, float(f"{unit.size:.12g}"))
        if key not in self._names:
            self._names[key] = f"unit_{len(self._names) + 1}"
            made = self._model.createUnitDefinition()
            made.setId(self._names[key])
            made.setName(str(unit))
            if unit.size != 1.0 or not unit.dimensions:
                add_unit(made, "dimensionless", 1.0, unit.size)
            for base, power in unit.dimensions:
                add_unit(made, _BASE[base], float(power), 1.0)
        return self._names[key]


_AMOUNTS = ("[substance]", "[mass]")


def add_unit(definition: Any, kind: str, exponent: float, multiplier: float) -> None:
    """Multiply a unit of a model by a power.

    Parameters
    ----------
    definition : of libsbml.
    kind : one of SBML's, such as "second".
    exponent, multiplier : the power, and what the kind is multiplied by before.
    """
    import libsbml

    part = definition.createUnit()
    part.setKind(libsbml.UnitKind_forName(kind))
    part.setExponent(exponent)
    part.setScale(0)
    part.setMultiplier(multiplier)


# Symbols that pint reads of each dimension, and their sizes in base units.
_SYMBOLS = {
    "[length]": {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "[mass]": {"kg": 1.0, "g": 1e-3, "mg": 1e-6, "ug": 1e-9},
    "[time]": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "ms": 1e-3},
    "[current]": {"A": 1.0, "mA": 1e-3},
    "[temperature]": {"K": 1.0},
    "[substance]": {"mol": 1.0, "mmol": 1e-3, "umol": 1e-6, "nmol": 1e-9},
    "[luminosity]": {"cd": 1.0},
}


def read_unit(definition: Any, names: Mapping[str, Unit]) -> str:
    """Give a unit of a model as text that pint reads; "" where there is none.

    Parameters
    ----------
    definition : of libsbml, a product of powers of its kinds.
    names : names that the model has for units, which are taken where they say the same.
    """
    import libsbml

    if definition is None or not definition.getNumUnits():
        return ""
    whole = Unit()
    for place in range(definition.getNumUnits()):
        part = definition.getUnit(place)
        kind = libsbml.UnitKind_toString(part.getKind())
        try:
            ((_, own),) = read_units({"unit": _CALLED.get(kind, kind)}).columns
        except InputError:
            return ""
        size = own.size * part.getMultiplier() * 10.0 ** part.getScale()
        exponent = Fraction(part.getExponentAsDouble()).limit_denominator(1000)
        whole = whole.times(Unit(own.dimensions, size).power(exponent))
    for name, unit in names.items():
        if unit.same(whole):
            return name
    symbols = [_SYMBOLS.get(base, {}).items() for base, _ in whole.dimensions]
    powers = [power for _, power in whole.dimensions]
    for chosen in product(*symbols):
        sizes = (s ** float(p) for (_, s), p in zip(chosen, powers, strict=True))
        if math.isclose(math.prod(sizes), whole.size, rel_tol=1e-6):
            named = zip((symbol for symbol, _ in chosen), powers, strict=True)
            return str(Unit(symbols=tuple(sorted(named))))
    return ""


_CALLED = {"item": "count", "dimensionless": "1", "Celsius": "delta_degC"}


def named_unit(model: Any, name: str) -> Any:
    """Give the definition of a unit by its name in a model, or of one of SBML's own; else None.

    Parameters
    ----------
    model : of libsbml.
    name : such as "unit_1" or "second".
    """
    import libsbml

    defined = model.getUnitDefinition(name)
    if defined is None and libsbml.UnitKind_forName(name) != libsbml.UNIT_KIND_INVALID:
        defined = libsbml.UnitDefinition(model.getLevel(), model.getVersion())
        add_unit(defined, name, 1.0, 1.0)
    return defined


def read_names(model: Any) -> dict[str, Unit]:
    """Give the names of a model's units that pint reads as what they are defined to be.

    Parameters
    ----------
    model : of libsbml.
    """
    found: dict[str, Unit] = {}
    for definition in model.getListOfUnitDefinitions():
        for name in (definition.getName(), definition.getId()):
            with suppress(InputError):
                if name:
                    ((_, unit),) = read_units({"unit": name}).columns
                    if read_unit(definition, {name: unit}) == name:
                        found[name] = unit
    return found
