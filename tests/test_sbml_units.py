"""Units of SBML: those that the user gave are written, are consistent, and are read again."""

import re

import numpy as np
import pytest

pytest.importorskip("libsbml", reason="python-libsbml is not installed")
pytest.importorskip("pint", reason="pint is not installed")

from dynsr import read_sbml
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.export.sbml import find_faults
from dynsr.expression.parsing import parse

INFECTION = {"a": "-0.3*a*b", "b": "0.3*a*b - 0.1*b"}
# Name -> equations, units, whether they are reactions, and the unit of k1.
CASES = {
    "mass a volume": (INFECTION, {"t": "h", "a": "g/L", "b": "g/L"}, True, "l/(g*h)"),
    "substance a volume": (INFECTION, {"t": "min", "a": "mmol/L", "b": "mmol/L"}, True, None),
    "substance": (INFECTION, {"t": "day", "a": "mmol", "b": "mmol"}, True, "1/(d*mmol)"),
    "counted": (INFECTION, {"t": "day", "a": "count", "b": "count"}, True, "1/d"),
    "saturation": ({"s": "-0.7*s/(0.4 + s)"}, {"t": "h", "s": "uM"}, False, None),
    "fall": ({"h": "v", "v": "0.05*v**2 - 9.81"}, {"t": "s", "h": "m", "v": "m/s"}, False, "1/m"),
    "cooling": ({"T": "29 - 0.1*T"}, {"t": "s", "T": "kelvin"}, False, "K/s"),
}


def made(equations, units):
    """Give a discovery of known equations, whose columns have units."""
    t = np.linspace(0, 2, 21)
    run = Trajectory(t, np.full((21, len(equations)), 1.5), tuple(equations))
    read = {state: parse(text) for state, text in equations.items()}
    return Discovery(read, {}, {}, {}, (run,), settings={"column_units": units})


@pytest.mark.parametrize("name", CASES)
def test_units_are_consistent(name):
    """libsbml checks each formula's units, and finds nothing wrong or left open."""
    equations, units, reactions, _ = CASES[name]
    text = made(equations, units).export("sbml")
    assert find_faults(text, units=True) == []
    assert ("<reaction " in text) == reactions


@pytest.mark.parametrize("name", CASES)
def test_units_are_read_again(name, tmp_path):
    """Columns, parameters and the time have the units that they were given."""
    equations, units, _, unit = CASES[name]
    found = made(equations, units)
    (tmp_path / "model.xml").write_text(found.export("sbml"))
    system = read_sbml(tmp_path / "model.xml")
    assert system.parameters.numbers == pytest.approx(found.parameters.numbers)
    again = {p.name: p.unit for p in system.parameters.values()}
    assert again == {p.name: p.unit for p in found.parameters.values()}
    assert unit is None or again["k1"] == unit
    known = Discovery.from_system(system)
    assert {p.name: p.unit for p in known.parameters.values()} == again
    assert set(system.units) == {*equations, "t"} and system.time_unit == system.units["t"]


@pytest.mark.parametrize("name", CASES)
def test_units_change_no_trajectory(name):
    """Another simulator gives the numbers that dynsr gives."""
    roadrunner = pytest.importorskip("roadrunner", reason="libroadrunner is not installed")
    equations, units, *_ = CASES[name]
    found = made(equations, units)
    runner = roadrunner.RoadRunner(found.export("sbml"))
    runner.integrator.relative_tolerance, runner.integrator.absolute_tolerance = 1e-11, 1e-13
    runner.timeCourseSelections = ["time", *equations]
    truth = found.simulate([1.5] * len(equations), np.linspace(0, 2, 5)).x[-1]
    assert np.allclose(runner.simulate(0, 2, 5)[-1, 1:], truth, rtol=1e-6)


def test_what_has_no_unit_is_written_as_before():
    """Without units nothing is said of them; where some are known, the others stay open."""
    assert "unitDefinition" not in made(INFECTION, {}).export("sbml")
    text = made(INFECTION, {"t": "h", "a": "g/L"}).export("sbml")
    assert 'timeUnits="' in text and "<reaction " not in text


def test_a_volume_of_another_size_divides_out(tmp_path):
    """A law that is multiplied by its compartment, as most models write it, has none in a slope."""
    text = made(*CASES["mass a volume"][:2]).export("sbml")
    (tmp_path / "model.xml").write_text(text.replace('size="1"', 'size="3"'))
    assert "cell" not in read_sbml(tmp_path / "model.xml").parameters


KINDS = """<?xml version="1.0"?>
<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1">
<model id="m" timeUnits="second">
<listOfUnitDefinitions><unitDefinition id="rate"><listOfUnits>
<unit kind="litre" exponent="1" scale="-3" multiplier="1"/>
<unit kind="second" exponent="-1" scale="0" multiplier="60"/>
</listOfUnits></unitDefinition></listOfUnitDefinitions>
<listOfParameters><parameter id="x" value="1" constant="false" units="litre"/>
<parameter id="k" value="2" constant="true" units="rate"/>
<parameter id="n" value="3" constant="true"/></listOfParameters>
<listOfRules><rateRule variable="x"><math xmlns="http://www.w3.org/1998/Math/MathML">
<apply><times/><ci>k</ci><ci>n</ci></apply></math></rateRule></listOfRules>
</model></sbml>"""


def test_units_that_others_wrote_are_read(tmp_path):
    """Scales and multipliers become prefixes; what has no unit has none."""
    (tmp_path / "model.xml").write_text(KINDS)
    system = read_sbml(tmp_path / "model.xml")
    assert system.time_unit == "s" and system.units["x"] == "dm^3"
    assert {n: p.unit for n, p in system.parameters.items()} == {"k": "cm^3/min", "n": ""}


def test_an_older_model_counts_seconds(tmp_path):
    """Level 2 has a unit of the time where none is named; Level 3 has none."""
    older = KINDS.replace("level3/version1/core", "level2/version4").replace(
        'level="3"', 'level="2"'
    )
    older = older.replace('version="1">', 'version="4">', 1).replace(' timeUnits="second"', "")
    older = re.sub(r' (?:constant|exponent|scale|multiplier)="1"', "", older)
    (tmp_path / "older.xml").write_text(older)
    assert read_sbml(tmp_path / "older.xml").time_unit == "s"
    (tmp_path / "later.xml").write_text(KINDS.replace(' timeUnits="second"', ""))
    assert read_sbml(tmp_path / "later.xml").time_unit == ""
