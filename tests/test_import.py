"""Models of SBML and problems of PEtab are read as equations, parameters and data."""

import importlib.util
import json

import numpy as np
import pytest
import sympy
from command_line import run as command
from known_systems import KNOWN, NAMES, points, slopes
from scipy.integrate import solve_ivp

pytest.importorskip("libsbml", reason="python-libsbml is not installed")
pytest.importorskip("yaml", reason="PyYAML is not installed")

import dynsr
from dynsr import read_petab, read_sbml
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.export.formats import write_format
from dynsr.export.source import Source
from dynsr.expression.export import to_numpy
from dynsr.parameters.parameters import ParametricSystem

HEAD = '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1">'
MATH = '<math xmlns="http://www.w3.org/1998/Math/MathML">'


def ci(*names):
    """Give names in MathML."""
    return "".join(f"<ci>{name}</ci>" for name in names)


# A reaction in a compartment of size 2, whose rate is a function that the model defines, with a
# constant of its own; an assignment; a start that is a formula; a parameter that moves.
MODEL = f"""<?xml version="1.0"?>
{HEAD}<model id="m">
<listOfFunctionDefinitions><functionDefinition id="mm">{MATH}<lambda>
<bvar><ci>s</ci></bvar><bvar><ci>v</ci></bvar><bvar><ci>k</ci></bvar>
<apply><divide/><apply><times/>{ci("v", "s")}</apply><apply><plus/>{ci("k", "s")}</apply></apply>
</lambda></math></functionDefinition></listOfFunctionDefinitions>
<listOfCompartments><compartment id="cell" size="2" constant="true" spatialDimensions="3"/>
</listOfCompartments>
<listOfSpecies>
<species id="S" compartment="cell" initialConcentration="3" hasOnlySubstanceUnits="false"
 boundaryCondition="false" constant="false"/>
<species id="P" compartment="cell" initialAmount="0.5" hasOnlySubstanceUnits="true"
 boundaryCondition="false" constant="false"/>
<species id="B" compartment="cell" initialConcentration="0.7" hasOnlySubstanceUnits="false"
 boundaryCondition="true" constant="false"/>
</listOfSpecies>
<listOfParameters>
<parameter id="Vmax" value="1.5" constant="true"/><parameter id="twice" constant="false"/>
<parameter id="q" constant="false"/>
</listOfParameters>
<listOfInitialAssignments><initialAssignment symbol="q">{MATH}
<apply><times/><cn>2</cn><ci>Vmax</ci></apply></math></initialAssignment></listOfInitialAssignments>
<listOfRules>
<assignmentRule variable="twice">{MATH}<apply><times/><cn>2</cn><ci>B</ci></apply></math>
</assignmentRule>
<rateRule variable="q">{MATH}<apply><minus/><apply><times/>{ci("q", "twice")}</apply></apply></math>
</rateRule></listOfRules>
<listOfReactions><reaction id="r" reversible="false" fast="false">
<listOfReactants><speciesReference species="S" stoichiometry="1" constant="true"/></listOfReactants>
<listOfProducts><speciesReference species="P" stoichiometry="2" constant="true"/></listOfProducts>
<kineticLaw>{MATH}<apply><ci>mm</ci>{ci("S", "Vmax", "Km")}</apply></math>
<listOfLocalParameters><localParameter id="Km" value="0.4"/></listOfLocalParameters></kineticLaw>
</reaction></listOfReactions>
</model></sbml>"""


def written(tmp_path, text, name="model.xml"):
    """Write a model and give its file."""
    (tmp_path / name).write_text(text)
    return tmp_path / name


@pytest.mark.parametrize("name", NAMES)
def test_what_is_written_is_read_again(name, tmp_path):
    """Of every known system, slopes and start are the same, and each parameter keeps its value."""
    system = ParametricSystem.of(KNOWN[name])
    again = read_sbml(written(tmp_path, write_format(Source(system), "sbml")))
    rhs, states = to_numpy(again.in_numbers), list(again.equations)
    order = [list(KNOWN[name].states).index(s) for s in states if s in KNOWN[name].states]
    assert len(order) == len(KNOWN[name].states)
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        assert np.allclose(rhs(t, state[order]), expected[order], rtol=1e-12)
    assert [again.x0[s] for s in states] == pytest.approx([system.x0[s] for s in states])
    assert again.parameters.numbers == pytest.approx(system.parameters.numbers)


def test_a_model_is_read_as_its_equations(tmp_path):
    """Amounts and concentrations, functions, local constants, rules: as SBML says, by hand."""
    system = read_sbml(written(tmp_path, MODEL))
    s, p, q = (system.equations[name] for name in ("S", "P", "q"))
    S, Q, B, V, K, C = sympy.symbols("S q B Vmax r_Km cell")
    rate = V * S / (K + S)
    assert sympy.simplify(s + rate / C) == 0
    assert sympy.simplify(p - 2 * rate) == 0
    assert sympy.expand(q + 2 * Q * B) == 0
    assert system.parameters.numbers == {"cell": 2.0, "Vmax": 1.5, "B": 0.7, "r_Km": 0.4}
    assert dict(system.x0) == {"S": 3.0, "P": 0.5, "q": 3.0}


def test_another_simulator_agrees_on_the_model(tmp_path):
    """Integrated, the equations give what libRoadRunner gives."""
    roadrunner = pytest.importorskip("roadrunner", reason="libroadrunner is not installed")
    system = read_sbml(written(tmp_path, MODEL))
    rhs = to_numpy(system.in_numbers)
    start = list(system.x0.values())
    ours = solve_ivp(rhs, (0, 3), start, rtol=1e-10, atol=1e-12).y[:, -1]
    runner = roadrunner.RoadRunner(MODEL)
    runner.integrator.relative_tolerance, runner.integrator.absolute_tolerance = 1e-10, 1e-12
    runner.timeCourseSelections = ["[S]", "P", "q"]
    assert np.allclose(runner.simulate(0, 3, 4)[-1], ours, rtol=1e-7)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((MODEL, "hello"), "is no model of SBML"),
        (('value="1.5"', ""), "'Vmax' has no value"),
        ((f'<rateRule variable="q">{MATH}', f"<algebraicRule>{MATH}"), "no model|algebraic"),
        (
            (
                "</listOfReactions>",
                "</listOfReactions><listOfEvents><event "
                'useValuesFromTriggerTime="true"><trigger initialValue="true" persistent="true">'
                f"{MATH}<true/></math></trigger></event></listOfEvents>",
            ),
            "the model has events",
        ),
        (("<cn>2</cn><ci>B</ci>", "<cn>2</cn><ci>twice</ci>"), "is inconsistent"),
        (("<cn>2</cn><ci>B</ci>", "<cn>2</cn><apply><factorial/><ci>B</ci></apply>"), "no formula"),
    ],
)
def test_what_is_no_system_of_equations_is_refused(change, words, tmp_path):
    """Another file, a value that is missing, rules and events that are no slopes: one line each."""
    text = MODEL.replace(*change)
    if "algebraic" in words:
        text = text.replace("</rateRule>", "</algebraicRule>")
    with pytest.raises(InputError, match=words) as caught:
        read_sbml(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_named():
    """Neither a model nor a problem."""
    for read in (read_sbml, read_petab):
        with pytest.raises(InputError, match="cannot read 'nowhere"):
            read("nowhere.yaml")


@pytest.fixture
def problem(tmp_path):
    """Write a PEtab problem of two runs of prey and predators; give it and what it was made of."""
    system = KNOWN["lotka-volterra"]
    rhs = to_numpy(dict(zip(system.states, system.rhs, strict=True)))
    t = np.linspace(0, 5, 21)
    runs = [
        Trajectory(t, solve_ivp(rhs, (0, 5), x0, t_eval=t, rtol=1e-9).y.T, ("x", "y"))
        for x0 in ([1.0, 2.0], [2.0, 1.0])
    ]
    found = Discovery.from_system(system, runs).rename({"k1": "bite"})
    found.export("petab", tmp_path / "problem")
    return tmp_path / "problem" / "problem.yaml", found


@pytest.mark.slow
def test_a_problem_is_read_with_its_data(problem):
    """Each condition is a run with its measurements; parameters have their nominal values."""
    path, found = problem
    system, runs = read_petab(path)
    assert len(runs) == 2 and runs[0].states == ("x", "y")
    for own, theirs in zip(runs, found.trajectories, strict=True):
        assert np.allclose(own.x, theirs.x, rtol=1e-12) and np.allclose(own.t, theirs.t)
    assert system.parameters.numbers == {"bite": 1.0, "k2": 1.5, "k3": 3.0}
    # It begins where the first run does, as the model does by itself.
    assert system.x0 == {"x": 1.0, "y": 2.0} == read_sbml(path.parent / "model.xml").x0
    again = Discovery.from_system(system, runs)
    assert list(again.parameters) == ["bite", "k2", "k3"]
    scores = again.score()
    assert all(own["trajectory_rmse"] < 1e-5 for own in scores.values())


def test_a_parameter_that_conditions_set_is_an_input(problem):
    """What differs from run to run keeps its value within each; replicates are averaged."""
    path, _ = problem
    table = path.parent / "conditions.tsv"
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([f"{head}\tk2", f"{rows[0]}\t1.5", f"{rows[1]}\t1.7"]) + "\n")
    measured = path.parent / "measurements.tsv"
    lines = measured.read_text().splitlines()
    first = lines[1].split("\t")
    first[2] = str(float(first[2]) + 0.2)
    measured.write_text("\n".join([*lines, "\t".join(first)]) + "\n")
    system, runs = read_petab(path)
    assert "k2" not in system.parameters and system.inputs == {"k2": None}
    assert [run.inputs[0, 0] for run in runs] == [1.5, 1.7]
    assert runs[0].x[0, 0] == pytest.approx(1.1)
    # A start that a condition gives is the condition's, not the mean of what was measured there.
    assert system.x0 == {"x": 1.0, "y": 2.0}


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (
            "problem.yaml",
            ("format_version: 1", "format_version: 9"),
            "no PEtab problem of version 1",
        ),
        ("problem.yaml", ("[model.xml]", "[../../model.xml]"), "lies outside the folder"),
        ("problem.yaml", ("problems:", "problem:"), "must contain one problem"),
        ("parameters.tsv", ("nominalValue", "value"), "no column 'nominalValue'"),
        ("measurements.tsv", ("observed_x", "observed_z"), "is of 'observed_z'"),
        ("measurements.tsv", ("\t0.0\n", "\tsoon\n"), "time 1 is 'soon'"),
    ],
)
def test_a_problem_that_cannot_be_read_is_told(problem, file, change, words):
    """What is missing or odd is named in one line, and no file elsewhere is read."""
    path, _ = problem
    other = path.parent / file
    other.write_text(other.read_text().replace(*change))
    with pytest.raises(InputError, match=words):
        read_petab(path)


@pytest.mark.slow
def test_known_equations_are_as_if_found(tmp_path):
    """They are scored, saved, reported, and a search starts from them."""
    t = np.linspace(0, 3, 151)
    data = Trajectory(t, 2 * np.exp(-0.5 * t)[:, None], ("x",))
    known = Discovery.from_system(dynsr.System.from_strings({"x": "-0.4*x"}), data)
    assert known.score()["x"]["trajectory_rmse"] > 0.01 and not known.verdict.tested
    assert "Parameters" in known.report(tmp_path / "report.html").read_text()
    found = dynsr.discover(data, start=known, preset="quick", jobs=1)
    assert str(found.equations["x"]) == "-0.5*x"


@pytest.mark.slow
def test_the_command_reads_models(tmp_path, problem):
    """Equations and parameters are shown; a folder takes them, and the data of a problem."""
    model = written(tmp_path, MODEL)
    said = command("import", model).stdout
    assert "S' = " in said and "Vmax" in said and "unit" not in said
    shown = written(tmp_path, MODEL.replace('id="Vmax"', 'id="Vmax" units="mole"'), "units.xml")
    if importlib.util.find_spec("pint"):
        assert "mol" in command("import", shown).stdout
        assert json.loads(command("import", shown, "--json").stdout)["units"]["Vmax"] == "mol"
    out = tmp_path / "read"
    told = json.loads(command("import", problem[0], "-o", out, "--json").stdout)
    assert told["parameters"] == {"bite": 1.0, "k2": 1.5, "k3": 3.0} and told["runs"] == 2
    assert sorted(p.name for p in out.iterdir()) == ["data.csv", "discovery.json"]
    scores = json.loads(command("score", out, out / "data.csv", "--json").stdout)
    assert scores["x"]["trajectory_rmse"] < 1e-5
    assert "bite" in command("export", out, "--to", "c").stdout
    assert (
        "is no model of SBML"
        in command("import", problem[0].parent / "parameters.tsv", code=2).stderr
    )
