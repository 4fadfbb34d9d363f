"""Every format of programs and models on every system of the gallery, integrated by its target."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy
from known_systems import KNOWN
from scipy.integrate import solve_ivp
from targets import loaded, need_module, need_tool, run

from dynsr.data.system import System
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError
from dynsr.export.formats import FORMATS, write_files, write_format
from dynsr.export.source import Source
from dynsr.expression.curves import Curve
from dynsr.expression.export import to_numpy
from dynsr.expression.parsing import parse
from dynsr.parameters.parameters import ParametricSystem

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
# Beside the catalogue and the gallery: what these lack.
ODD = {
    "friction": System.from_strings({"x": "v", "v": "-4*x - 0.3*abs(v)*v + sin(5*x)"}, x0=[1.5, 0]),
    "late": System.from_strings({"x": "cos(t) - x/2 + t/7"}, x0=[0.5], train=(5.0, 7.0)),
    "plain": System.from_strings({"x": "y", "y": "1"}, x0=[0.5, -0.5]),
}
GALLERY = Path(__file__).parents[1] / "docs" / "gallery"
LAW = re.compile(r"^(\w+)('{1,2}|\[n\+1\]) = (.+)$", re.MULTILINE)
# What a page does not print with its law: inputs, constants that differ, and a curve.
INPUTS = {"u": "sin(0.3*t)", "heater": "1 + sin(t)^2", "kelvin": "300 + 10*sin(t)"}
CONSTANTS = {"k1": 0.0005, "k2": 0.19}
CURVE = Curve("f", np.linspace(-1.0, 3.0, 9), np.exp(-(np.linspace(-2.0, 2.0, 9) ** 2)))


def read_pages():
    """Give (page, what it prints)."""
    for page in sorted(GALLERY.glob("*.md")):
        for text in re.findall(r"^```text\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
            yield page.stem, text
    for page in sorted(GALLERY.glob("*.ipynb")):
        for cell in json.loads(page.read_text())["cells"]:
            for out in cell.get("outputs", ()):
                yield page.stem, "".join(out.get("text", out.get("data", {}).get("text/plain", "")))


def read_gallery(discrete):
    """Give each law that the gallery prints, flows or maps, as a system that begins near 1."""
    found = {}
    for page, text in read_pages():
        own = {}
        for state, mark, side in LAW.findall(text):
            if (mark == "[n+1]") is discrete and "(t - " not in side:
                second = {state: f"{state}_dot", f"{state}_dot": side.replace("'", "_dot")}
                own |= second if mark == "''" else {state: side}
        if not own:
            continue
        inputs = {n: parse(u) for n, u in INPUTS.items() if re.search(rf"\b{n}\b", str(own))}
        names = [*own, *inputs]
        read = [parse(side, names, CONSTANTS, {"f": CURVE.function}) for side in own.values()]
        x0 = tuple(0.9 - 0.2 * np.arange(len(own)))
        system = System("gallery", tuple(own), tuple(read), x0, inputs)
        if system not in found.values():
            found[f"{page}_{len(found)}".replace("-", "_")] = system
    return found


MAPS = read_gallery(discrete=True)
# Long enough to move, short enough that no chaos tells solvers apart, or a function ends.
SPANS = {"functions": 0.4, "late": 2.0}
SYSTEMS = {
    name: replace(
        system, train=(system.train[0], system.train[0] + SPANS.get(name, 2.0)), step=0.02
    )
    for name, system in {**KNOWN, **ODD, **read_gallery(discrete=False)}.items()
}
NAMES = list(SYSTEMS)
DOCUMENTS = ("latex", "mathml", "markdown", "bibtex")
# Where these are at hand, the last state is printed by a script of Julia.
JULIA = ("julia", "modelingtoolkit", "catalyst")


@cache
def truth(name):
    """Give the last state (k,) by scipy's Runge-Kutta method of order 8, and the size (k,)."""
    system = SYSTEMS[name]
    rhs = to_numpy(dict(zip(system.states, system.closed_rhs(), strict=True)))
    found = solve_ivp(rhs, system.train, system.x0, method="DOP853", rtol=1e-12, atol=1e-13)
    assert found.success
    return found.y[:, -1], np.abs(found.y).max(axis=1)


def check(name, found):
    """Compare a last state with scipy's, to a millionth of how large the state becomes."""
    expected, size = truth(name)
    assert np.shape(found) == expected.shape
    assert np.all(np.abs(found - expected) <= 1e-6 * size), (name, found, expected)


def source_of(name):
    """Give what is written of a system; a curve in it is written as a formula."""
    source = Source.of(SYSTEMS[name])
    curved = any("f(" in str(side) for side in SYSTEMS[name].rhs)
    return replace(source, curves=("f(x) is a curve.",)) if curved else source


def written(name, form):
    """Give the text of a system in a format."""
    return write_format(source_of(name), form)


def check_all(text, names=NAMES):
    """Compare the last states of systems, one after the other in what was printed."""
    numbers = [float(word) for word in text.replace("D", "E").split()]
    for name in names:
        k = len(SYSTEMS[name].states)
        check(name, np.array(numbers[:k]))
        numbers = numbers[k:]
    assert not numbers


def integrate(name, rhs, **options):
    """Integrate slopes of a target by scipy."""
    system = SYSTEMS[name]
    exact = {"method": "LSODA", "rtol": 1e-10, "atol": 1e-12, **options}
    return solve_ivp(rhs, system.train, system.x0, **exact).y[:, -1]


def test_no_format_is_left_out():
    """What is no document has a test of its own here."""
    tested = {name.removeprefix("test_in_") for name in globals() if name.startswith("test_in_")}
    done = {name.replace("_", "-") for name in tested} | {*JULIA, *DOCUMENTS}
    assert done == {*FORMATS}


@pytest.mark.parametrize("name", NAMES)
def test_in_python(name):
    """Right-hand side and Jacobian go into scipy's implicit method."""
    space = loaded(written(name, "python"), name)
    check(name, integrate(name, space["rhs"], jac=space["jacobian"]))


@pytest.mark.parametrize("name", NAMES)
def test_in_torch(name):
    """The module gives the slopes."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    module = loaded(written(name, "torch"), name)["Found"]()
    with torch.no_grad():
        check(name, integrate(name, lambda t, x: module(t, torch.tensor(x)).numpy()))


@pytest.mark.parametrize("name", NAMES)
def test_in_c(name, tmp_path):
    """The example is compiled without a warning and takes steps of Runge-Kutta."""
    compiler = need_tool("gcc")
    (tmp_path / "found.c").write_text(written(name, "c"))
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-DFOUND_EXAMPLE"]
    run(compiler, *strict, "found.c", "-o", "found", "-lm", cwd=tmp_path)
    check_all(run(tmp_path / "found"), [name])


@pytest.mark.parametrize("name", NAMES)
def test_in_fortran(name, tmp_path):
    """The module is compiled, and steps of Runge-Kutta taken with it."""
    compiler = need_tool("gfortran")
    start, end = SYSTEMS[name].train
    k, steps = len(SYSTEMS[name].states), 8000
    (tmp_path / "found.f90").write_text(written(name, "fortran"))
    (tmp_path / "main.f90").write_text(
        f"program main\nuse found\nreal(dp) :: t, h, x({k}), a({k}), b({k}), c({k}), d({k})\n"
        f"integer :: i\nx = found_start\nh = ({end}d0 - {start}d0) / {steps}\n"
        f"do i = 0, {steps - 1}\n"
        f"t = {start}d0 + i * h\ncall found_rhs(t, x, found_parameters, [1d0], a)\n"
        "call found_rhs(t + h / 2, x + h / 2 * a, found_parameters, [1d0], b)\n"
        "call found_rhs(t + h / 2, x + h / 2 * b, found_parameters, [1d0], c)\n"
        "call found_rhs(t + h, x + h * c, found_parameters, [1d0], d)\n"
        "x = x + h / 6 * (a + 2 * b + 2 * c + d)\nend do\nprint '(es26.17e3)', x\nend program\n"
    )
    run(compiler, "-ffree-line-length-none", "found.f90", "main.f90", "-o", "main", cwd=tmp_path)
    check_all(run(tmp_path / "main"), [name])


def test_in_matlab(tmp_path):
    """Octave integrates each function with ode45."""
    octave = need_tool("octave-cli")
    lines = ["o = odeset('RelTol', 1e-9, 'AbsTol', 1e-11);"]
    for place, name in enumerate(NAMES):
        code = written(name, "matlab").replace("slope = rhs(", f"slope = rhs{place}(", 1)
        (tmp_path / f"rhs{place}.m").write_text(code)
        start, end = SYSTEMS[name].train
        first = ";".join(map(str, SYSTEMS[name].x0))
        lines.append(f"[t, y] = ode45(@(t, s) rhs{place}(t, s), [{start} {end}], [{first}], o);")
        lines.append("printf('%.17g ', y(end, :));")
    (tmp_path / "main.m").write_text("\n".join(lines))
    check_all(run(octave, "--no-init-file", "--quiet", "main.m", cwd=tmp_path))


def test_in_r(tmp_path):
    """R integrates each function with deSolve."""
    rscript = need_tool("Rscript")
    if "TRUE" not in run(rscript, "-e", 'cat(requireNamespace("deSolve", quietly = TRUE))'):
        pytest.skip("deSolve is not installed")
    lines = []
    for name in NAMES:
        (tmp_path / f"{name}.R").write_text(written(name, "r"))
        start, end = SYSTEMS[name].train
        lines += [
            f"source('{name}.R')",
            f"o <- deSolve::ode(start, c({start}, {end}), rhs, parameters, rtol=1e-10, atol=1e-12)",
            "cat(sprintf('%.17g', o[2, -1]), '')",
        ]
    (tmp_path / "main.R").write_text("\n".join(lines))
    check_all(run(rscript, "--vanilla", "main.R", cwd=tmp_path))


@pytest.mark.parametrize("form", JULIA)
def test_julia_integrates(form, tmp_path):
    """Each example is solved, where Julia and the packages are there."""
    julia = need_tool("julia")
    package = {"modelingtoolkit": "ModelingToolkit", "catalyst": "Catalyst"}.get(form)
    used = [name for name in ("OrdinaryDiffEq", package) if name]
    if subprocess.run([julia, "-e", f"using {', '.join(used)}"], capture_output=True).returncode:
        pytest.skip(f"{' and '.join(used)} are not installed")
    for name in NAMES:
        try:
            code = written(name, form)
        except InputError:
            assert form == "catalyst"
            continue
        code = re.sub("^# (using|solution)", r"\1", code, flags=re.MULTILINE)
        exact = "Tsit5(); reltol=1e-10, abstol=1e-12)"
        code = re.sub(r"Tsit5\(\).*\)", exact, code)
        order = "" if form == "julia" else f"; idxs = [{', '.join(SYSTEMS[name].states)}]"
        last = f"solution(solution.t[end]{order})"
        (tmp_path / "main.jl").write_text(f"{code}\nprint(join({last}, ' '))\n")
        check_all(run(julia, "main.jl", cwd=tmp_path), [name])


def sides_of(code, form):
    """Give values, and state -> formula, that a text of Julia says."""
    code = re.sub("#.*", "", code)
    given = dict(re.findall(r"(?:^| )(\w+) = (-?[\d.e-]+)(?=,|\)|$)", code, re.MULTILINE))
    if form == "catalyst":
        rows = re.findall(r"^    (.+), (.+?) (-->|=>) (.+)$", code, re.MULTILINE)
        sides = {}
        for rate, before, arrow, after in rows:
            ends = [_counts(before), _counts(after)]
            law = [rate, *(f"{n}^{k}" for n, k in ends[0].items() if arrow == "-->")]
            for name in {*ends[0], *ends[1]}:
                gain = ends[1].get(name, 0) - ends[0].get(name, 0)
                sides[name] = f"{sides.get(name, '0')} + ({gain})*({')*('.join(law)})"
        return given, sides
    if form == "modelingtoolkit":
        return given, dict(
            re.findall(r"^    Differential\(t\)\((\w+)\) ~ (.+),$", code, re.MULTILINE)
        )
    states = dict(re.findall(r"^    (\w+) = u\[(\d+)\]$", code, re.MULTILINE))
    slopes = dict(re.findall(r"^    du\[(\d+)\] = (.+)$", code, re.MULTILINE))
    known = re.findall(r"^    (\w+) = (?!u\[|p\.)(.+)$", code, re.MULTILINE)
    places = {place: name for name, place in states.items()}
    sides = {places.get(place, f"unused{place}"): text for place, text in slopes.items()}
    for name, text in known:
        sides = {n: re.sub(rf"\b{name}\b", f"({text})", side) for n, side in sides.items()}
    return given, sides


def _counts(side):
    """Read one side of a reaction: name -> how many."""
    parts = re.findall(r"(\d*)([^\W\d]\w*)", side.replace("\u2205", ""))
    return {name: int(count or 1) for count, name in parts}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("form", JULIA)
def test_formulas_of_julia_are_the_equations(form, name):
    """Where Julia is not at hand, its formulas, read by dynsr's parser, give the trajectory."""
    try:
        code = written(name, form)
    except InputError:
        assert form == "catalyst"
        return
    given, sides = sides_of(code, form)
    own = list(Source.of(SYSTEMS[name]).states)
    assert len(sides) <= len(own)
    put = {sympy.Symbol(n): sympy.Float(v) for n, v in given.items() if n not in own}
    text = {n: sides.get(n, sides.get(f"{n}_", "0")) for n in own}
    words = [*given, *sides, *own, "t"]
    called = {n: n if n in sides else f"{n}_" for n in own}
    swaps = {sympy.Symbol(c): sympy.Symbol(n) for n, c in called.items()}
    read = {n: parse(side, words).xreplace(put).xreplace(swaps) for n, side in text.items()}
    if form == "julia":
        read |= {
            n: parse(sides[f"unused{i}"], words).xreplace(put).xreplace(swaps)
            for i, n in enumerate(own, 1)
            if f"unused{i}" in sides
        }
    check(name, integrate(name, to_numpy(read)))


def compute(node, known):
    """Give the value of a formula that a parser of Modelica has read."""
    if hasattr(node, "operator"):
        values = [compute(part, known) for part in node.operands]
        name = str(node.operator)
        if len(values) == 2:
            return {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "^": np.power}[
                name
            ](*values)
        plain = {"-": "negative", "asin": "arcsin", "acos": "arccos", "atan": "arctan"}
        return getattr(np, plain.get(name, name))(*values)
    return known[node.name] if hasattr(node, "name") else float(node.value)


@pytest.mark.parametrize("name", NAMES)
def test_in_modelica(name):
    """A parser of Modelica reads it; the equations of its tree are integrated."""
    parser = pytest.importorskip("pymoca.parser", reason="pymoca is not installed")
    from pymoca.ast import ComponentRef
    from pymoca.tree import flatten

    tree = flatten(parser.parse(written(name, "modelica")), ComponentRef(name="Found"))
    model = tree.classes["Found"]
    parts = model.symbols.items()
    values = {n: compute(s.value, {}) for n, s in parts if "parameter" in s.prefixes}
    starts = {n: compute(s.start, {}) for n, s in parts if s.start.value is not None}
    assert list(starts.values()) == list(SYSTEMS[name].x0)
    sides = [(e.left, e.right) for e in model.equations]
    drives = {left.name: right for left, right in sides if not hasattr(left, "operator")}
    slopes = {left.operands[0].name: e for left, e in sides if hasattr(left, "operator")}
    assert list(slopes) == list(starts)

    def rhs(t, x):
        known = {"time": t, **values, **dict(zip(slopes, x, strict=True))}
        known |= {n: compute(e, known) for n, e in drives.items()}
        return [compute(e, known) for e in slopes.values()]

    check(name, integrate(name, rhs))


def simulate_sbml(text, name, starts=()):
    """Give the last state of a model by libRoadRunner, its parameters set to what starts say."""
    roadrunner = pytest.importorskip("roadrunner", reason="libroadrunner is not installed")
    import libsbml

    document = libsbml.readSBMLFromString(text)
    for key, value in dict(starts).items():
        document.getModel().getParameter(key).setValue(value)
    runner = roadrunner.RoadRunner(libsbml.writeSBMLToString(document))
    runner.integrator.relative_tolerance, runner.integrator.absolute_tolerance = 1e-11, 1e-13
    runner.timeCourseSelections = ["time", *SYSTEMS[name].states]
    start, end = SYSTEMS[name].train
    return runner.simulate(0, end - start, 11)[-1, 1:]


@pytest.mark.parametrize("name", NAMES)
def test_in_sbml(name):
    """Another simulator of SBML takes the model."""
    need_module("libsbml")
    check(name, simulate_sbml(written(name, "sbml"), name))


@pytest.mark.parametrize("name", NAMES)
def test_in_petab(name, tmp_path):
    """petab finds no fault, and the model begins where the condition of its data says."""
    need_module("libsbml")
    petab = pytest.importorskip("petab", reason="petab is not installed")
    from petab.v1.lint import lint_problem

    system = SYSTEMS[name]
    t = np.linspace(*system.train, 9)
    rhs = to_numpy(dict(zip(system.states, system.closed_rhs(), strict=True)))
    x = solve_ivp(rhs, system.train, system.x0, t_eval=t, rtol=1e-9).y.T
    run_ = Trajectory(t, x, system.states)
    source = replace(source_of(name), runs=(run_,), noise=dict.fromkeys(system.states, 0.1))
    for file, text in write_files(source, "petab").items():
        (tmp_path / file).write_text(text)
    problem = petab.Problem.from_yaml(str(tmp_path / "problem.yaml"))
    assert not lint_problem(problem)
    (condition,) = problem.condition_df.to_dict("records")
    assert len(problem.measurement_df) == x.size
    check(name, simulate_sbml((tmp_path / "model.xml").read_text(), name, condition))


@pytest.mark.parametrize("name", NAMES)
def test_in_casadi(name):
    """The integrator that the file makes ends there."""
    need_module("casadi")
    space = loaded(written(name, "casadi"), name)
    found = space["integrate"](x0=space["START"], p=space["PARAMETERS"])["xf"]
    check(name, found.full().ravel())


def run_scripts(form, tmp_path):
    """Run the scripts of all systems in one process and give what they printed."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(written(name, form))
    lines = [f"runpy.run_path({f'{name}.py'!r}, run_name='__main__')" for name in NAMES]
    code = "\n".join(["import runpy", *lines])
    return run(sys.executable, "-W", "ignore", "-c", code, cwd=tmp_path)


def test_in_control(tmp_path):
    """Each script prints the last state."""
    need_module("control")
    check_all(run_scripts("control", tmp_path))


def test_in_do_mpc(tmp_path):
    """Each script prints the last state of its simulator."""
    need_module("do_mpc")
    check_all(run_scripts("do-mpc", tmp_path))


def test_in_jax(tmp_path):
    """Each script integrates with diffrax."""
    need_module("diffrax")
    check_all(run_scripts("jax", tmp_path))


# Rows that a map goes on: a chaotic one multiplies what is rounded.
ROWS = 20
MAP_FORMATS = [name for name, one in FORMATS.items() if one.maps and name not in DOCUMENTS]


def go(step, start):
    """Go from row to row."""
    state = np.array(start)
    for row in range(ROWS):
        state = np.asarray(step(float(row), state), dtype=float).ravel()
    return state


def go_in_torch(text, start, folder):
    """Go by the module of PyTorch."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    module = loaded(text, "map")["Found"]()
    return go(lambda t, x: module(t, torch.tensor(x)).detach().numpy(), start)


def go_in_script(text, start, folder):
    """Run the example of the file."""
    return run(sys.executable, "-W", "ignore", "-c", text)


def go_in_c(text, start, folder):
    """Compile a loop over the rows."""
    (folder / "found.c").write_text(text)
    (folder / "main.c").write_text(
        f'#include "found.c"\n#include <stdio.h>\nint main(void) {{\nenum {{ k = {len(start)} }};'
        "\ndouble x[k], next[k];\nfor (int i = 0; i < k; i++) x[i] = found_start[i];\n"
        f"for (int n = 0; n < {ROWS}; n++) {{\nfound_step(n, x, found_parameters, 0, next);\n"
        "for (int i = 0; i < k; i++) x[i] = next[i];\n}\n"
        'for (int i = 0; i < k; i++) printf("%.17g ", x[i]);\nreturn 0; }\n'
    )
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
    run(need_tool("gcc"), *strict, "main.c", "-o", "main", "-lm", cwd=folder)
    return run(folder / "main")


def go_in_fortran(text, start, folder):
    """Compile a loop over the rows."""
    (folder / "found.f90").write_text(text)
    (folder / "main.f90").write_text(
        f"program main\nuse found\nreal(dp) :: x({len(start)}), next({len(start)})\ninteger :: n\n"
        f"x = found_start\ndo n = 0, {ROWS - 1}\n"
        "call found_step(real(n, dp), x, found_parameters, [1d0], next)\nx = next\nend do\n"
        "print '(es26.17e3)', x\nend program\n"
    )
    run(need_tool("gfortran"), "found.f90", "main.f90", "-o", "main", cwd=folder)
    return run(folder / "main")


def go_in_matlab(text, start, folder):
    """Go from row to row in Octave."""
    (folder / "step.m").write_text(text)
    (folder / "main.m").write_text(
        f"x = [{';'.join(map(str, start))}];\nfor n = 0:{ROWS - 1}\nx = step(n, x);\nend\n"
        "printf('%.17g ', x);"
    )
    tool = need_tool("octave-cli")
    return run(tool, "--no-init-file", "--quiet", "main.m", cwd=folder)


def go_in_r(text, start, folder):
    """Go from row to row in R."""
    (folder / "main.R").write_text(
        f"{text}\nx <- start\nfor (n in 0:{ROWS - 1}) "
        "x[] <- step(n, x, parameters)[[1]]\ncat(sprintf('%.17g', x))"
    )
    return run(need_tool("Rscript"), "--vanilla", "main.R", cwd=folder)


def go_in_julia(text, start, folder):
    """Read the formulas by dynsr's parser."""
    given, sides = sides_of(text, "julia")
    own = list(sides)
    put = {sympy.Symbol(n): sympy.Float(v) for n, v in given.items() if n not in own}
    return go(to_numpy({n: parse(side).xreplace(put) for n, side in sides.items()}), start)


@pytest.mark.parametrize("form", MAP_FORMATS)
@pytest.mark.parametrize("name", MAPS)
def test_a_map_goes_from_row_to_row(form, name, tmp_path):
    """Every format that can express a map of the gallery gives its last row."""
    system = MAPS[name]
    rhs = to_numpy(dict(zip(system.states, system.rhs, strict=True)))
    whole = replace(ParametricSystem.of(system), discrete=True, span=(0.0, float(ROWS)), step=1.0)
    text = write_format(Source(whole), form)
    if form in ("python", "casadi", "control", "do-mpc"):
        if form != "python":
            need_module(form.replace("-", "_"))
        found = go_in_script(text, system.x0, tmp_path)
    else:
        found = globals()[f"go_in_{form}"](text, system.x0, tmp_path)
    if isinstance(found, str):
        found = [float(word) for word in found.strip("[] \n").split()]
    assert np.allclose(found, go(rhs, system.x0), rtol=1e-6, atol=1e-6)
