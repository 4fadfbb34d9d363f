"""Every format on every known system, run by the tool that it is for where that is there."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import sympy
from command_line import run as command
from known_systems import KNOWN, NAMES, points, slopes
from scipy.integrate import solve_ivp
from targets import loaded, need_module, need_tool, run

from dynsr import read_petab
from dynsr.data.reading import write_csv
from dynsr.data.system import System
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.export.formats import FORMATS, write_files, write_format
from dynsr.export.source import Source
from dynsr.expression.export import to_numpy
from dynsr.expression.parsing import parse
from dynsr.parameters.parameters import ParametricSystem


def last(name):
    """Give the last state of the train span by scipy, from dynsr's numpy function."""
    system = KNOWN[name]
    rhs = to_numpy(dict(zip(system.states, system.closed_rhs(), strict=True)))
    found = solve_ivp(rhs, system.train, system.x0, method="LSODA", rtol=1e-11, atol=1e-13)
    return found.y[:, -1]


def written(name, form):
    """Give the text of a system in a format."""
    return write_format(Source.of(KNOWN[name]), form)


def numbers(text):
    """Read the numbers that a program printed."""
    return np.array([float(word) for word in text.split()])


MASS_ACTION = ("lotka-volterra", "sir", "names")
# A chaotic system leaves any other solver's trajectory: there slopes alone are compared.
CALM = [name for name in NAMES if name not in ("lorenz", "rossler", "names", "functions")]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_python_is_the_equations(name):
    """Slopes are dynsr's, and the Jacobian that of differences."""
    space = loaded(written(name, "python"), name)
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        assert np.allclose(space["rhs"](t, state), expected, rtol=1e-12)
        step = 1e-6
        near = np.array(
            [
                (space["rhs"](t, state + step * e) - space["rhs"](t, state - step * e)) / (2 * step)
                for e in np.eye(len(state))
            ]
        ).T
        assert np.allclose(space["jacobian"](t, state), near, atol=1e-5, rtol=1e-5)


@pytest.mark.slow
def test_the_example_in_python_integrates():
    """Run as a script, the file prints the last state of the trajectory."""
    name = "lotka-volterra"
    found = numbers(run(sys.executable, "-c", written(name, "python")))
    assert np.allclose(found, last(name), rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_torch_is_the_equations(name):
    """One state or many, the module gives dynsr's slopes, and every parameter has a gradient."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    module = loaded(written(name, "torch"), name)["Found"]()
    times, states = points(name)
    for t, state, expected in zip(times, states, slopes(name), strict=True):
        out = module(t, torch.tensor(state))
        assert np.allclose(out.detach().numpy(), expected, rtol=1e-10)
    both = module(times[0], torch.tensor(np.array([states[0], states[0]])))
    assert np.allclose(both.detach().numpy()[1], slopes(name)[0], rtol=1e-10)
    module(times[0], torch.tensor(states[0])).sum().backward()
    own = list(module.parameters())
    assert len(own) == len(ParametricSystem.of(KNOWN[name]).parameters)
    assert all(p.grad is not None for p in own)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_jax_is_the_equations(name):
    """The function for diffrax gives dynsr's slopes."""
    need_module("jax")
    space = loaded(written(name, "jax"), name)
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        assert np.allclose(space["rhs"](t, state, space["PARAMETERS"]), expected, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_c_is_the_equations(name, tmp_path):
    """Compiled without a warning, slopes are dynsr's; the example integrates."""
    compiler = need_tool("gcc")
    (tmp_path / "found.c").write_text(written(name, "c"))
    times, states = points(name)
    calls = "".join(
        f"{{ double s[] = {{{', '.join(map(repr, state.tolist()))}}};"
        f" found_rhs({float(t)!r}, s, found_parameters, 0, out);"
        f' for (int q = 0; q < {len(state)}; q++) printf("%.17g ", out[q]); }}\n'
        for t, state in zip(times, states, strict=True)
    )
    (tmp_path / "main.c").write_text(
        '#include "found.c"\n#include <stdio.h>\n'
        f"int main(void) {{ double out[{len(states[0])}];\n{calls}return 0; }}\n"
    )
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"]
    run(compiler, *strict, "main.c", "-o", "main", "-lm", cwd=tmp_path)
    found = numbers(run(tmp_path / "main")).reshape(len(times), -1)
    assert np.allclose(found, slopes(name), rtol=1e-12)
    if name in CALM:
        example = [*strict, "-O2", "-DFOUND_EXAMPLE", "found.c", "-o", "example", "-lm"]
        run(compiler, *example, cwd=tmp_path)
        assert np.allclose(numbers(run(tmp_path / "example")), last(name), rtol=1e-6, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_fortran_is_the_equations(name, tmp_path):
    """Compiled, slopes and Jacobian are those of the other formats."""
    compiler = need_tool("gfortran")
    times, states = points(name)
    k = len(states[0])
    calls = "".join(
        f"t = {float(t)!r}d0\nstate = [{', '.join(f'{v!r}d0' for v in state.tolist())}]\n"
        "call found_rhs(t, state, found_parameters, [1d0], out)\nprint '(es26.17e3)', out\n"
        "call found_jacobian(t, state, found_parameters, [1d0], matrix)\n"
        "print '(es26.17e3)', transpose(matrix)\n"
        for t, state in zip(times, states, strict=True)
    )
    (tmp_path / "found.f90").write_text(written(name, "fortran"))
    (tmp_path / "main.f90").write_text(
        f"program main\nuse found\nreal(dp) :: t, state({k}), out({k}), matrix({k}, {k})\n"
        f"{calls}end program\n"
    )
    line = ["-std=f2008", "-ffree-line-length-none", "found.f90", "main.f90", "-o", "main"]
    run(compiler, *line, cwd=tmp_path)
    assert max(map(len, (tmp_path / "found.f90").read_text().splitlines())) <= 132
    found = numbers(run(tmp_path / "main")).reshape(len(times), k + k * k)
    assert np.allclose(found[:, :k], slopes(name), rtol=1e-12)
    space = loaded(written(name, "python"), name)
    theirs = [space["jacobian"](t, s).ravel() for t, s in zip(times, states, strict=True)]
    assert np.allclose(found[:, k:], np.array(theirs, dtype=float), rtol=1e-10)


@pytest.mark.slow
def test_octave_computes_the_equations(tmp_path):
    """Slopes of all systems are dynsr's, and ode45 integrates."""
    octave = need_tool("octave-cli")
    lines = []
    for place, name in enumerate(NAMES):
        code = written(name, "matlab").replace("slope = rhs(", f"slope = rhs{place}(", 1)
        (tmp_path / f"rhs{place}.m").write_text(code)
        for t, state in zip(*points(name), strict=True):
            column = ";".join(map(repr, state.tolist()))
            lines.append(f"printf('%.17g ', rhs{place}({float(t)!r}, [{column}]));")
    where = NAMES.index("lotka-volterra")
    lines += [
        "o = odeset('RelTol', 1e-9, 'AbsTol', 1e-11);",
        f"[t, y] = ode45(@(t, s) rhs{where}(t, s), [0 10], [1; 1], o);",
        "printf('%.17g ', y(end, :));",
    ]
    (tmp_path / "main.m").write_text("\n".join(lines))
    found = numbers(run(octave, "--no-init-file", "--quiet", "main.m", cwd=tmp_path))
    expected = np.concatenate([slopes(name).ravel() for name in NAMES])
    assert np.allclose(found[: len(expected)], expected, rtol=1e-12)
    assert np.allclose(found[len(expected) :], last("lotka-volterra"), rtol=1e-6)


@pytest.mark.slow
def test_r_computes_the_equations(tmp_path):
    """Slopes of all systems are dynsr's, and deSolve integrates where it is there."""
    rscript = need_tool("Rscript")
    lines, expected = [], []
    for place, name in enumerate(NAMES):
        (tmp_path / f"{place}.R").write_text(written(name, "r"))
        lines.append(f"source('{place}.R')")
        for t, state in zip(*points(name), strict=True):
            lines.append(f"values <- c({', '.join(map(repr, state.tolist()))})")
            lines.append("names(values) <- names(start)")
            lines.append(
                f"cat(sprintf('%.17g', unname(rhs({float(t)!r}, values, parameters)[[1]])), '')"
            )
        expected.append(slopes(name).ravel())
    lines += [
        f"source('{NAMES.index('lotka-volterra')}.R')",
        "if (requireNamespace('deSolve', quietly = TRUE)) {",
        "  out <- deSolve::ode(start, c(0, 10), rhs, parameters, rtol = 1e-10, atol = 1e-12)",
        "  cat(sprintf('%.17g', out[2, -1]), '')",
        "}",
    ]
    (tmp_path / "main.R").write_text("\n".join(lines))
    found = numbers(run(rscript, "--vanilla", "main.R", cwd=tmp_path))
    whole = np.concatenate(expected)
    assert np.allclose(found[: len(whole)], whole, rtol=1e-12)
    if len(found) > len(whole):
        assert np.allclose(found[len(whole) :], last("lotka-volterra"), rtol=1e-6)


@pytest.mark.parametrize("form", ["julia", "modelingtoolkit", "catalyst"])
def test_julia_reads_what_is_written(form):
    """A Julia parser finds no error in any system."""
    tree_sitter = pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
    julia = pytest.importorskip("tree_sitter_julia", reason="tree-sitter-julia is not installed")
    parser = tree_sitter.Parser(tree_sitter.Language(julia.language()))
    for name in NAMES:
        if form == "catalyst" and name not in MASS_ACTION:
            with pytest.raises(InputError, match="not mass action"):
                written(name, form)
            continue
        code = written(name, form)
        assert not parser.parse(code.encode()).root_node.has_error, code


def test_reactions_are_the_equations():
    """What reactions take and give, times their rates, are the slopes; of SIR there are two."""
    from dynsr.export.reactions import find_reactions

    counts = {}
    for name in ("sir", "lotka-volterra", "lorenz"):
        source = Source.of(KNOWN[name])
        try:
            reactions = find_reactions(source)
        except InputError:
            assert name == "lorenz"
            continue
        counts[name] = len(reactions)
        for state, expr in source.equations.items():
            total = sum(
                (one.produced.get(state, 0) - one.consumed.get(state, 0)) * one.rate
                for one in reactions
            )
            assert sympy.expand(total - expr) == 0
    assert counts == {"sir": 2, "lotka-volterra": 3}
    (pairs,) = find_reactions(Source.of(System.from_strings({"x": "-x^2/4", "y": "x^2/4"})))
    assert pairs.consumed == {"x": 2} and pairs.produced == {"x": 1, "y": 1}


def test_what_is_no_mass_action_is_refused_in_the_users_names():
    """The line names the term; what leaves a state that is not in it is none."""
    with pytest.raises(InputError, match=r"k1\*x/\(k2 \+ x\) is no product of states"):
        written("michaelis-menten", "catalyst")
    with pytest.raises(InputError, match="leaves x and is not in it"):
        write_format(Source.of(System.from_strings({"x": "-2*y", "y": "-y"})), "catalyst")


@pytest.mark.parametrize("name", NAMES)
def test_modelica_is_the_equations(name):
    """Its formulas, read again by dynsr's parser, give the slopes."""
    code = written(name, "modelica")
    values = {n: float(v) for n, v in re.findall(r"parameter Real (\w+) = (\S+);", code)}
    own = re.findall(r"Real (\w+)\(start", code)
    sides = dict(re.findall(r"^  (?:der\()?(\w+)\)? = (.*);$", code, re.MULTILINE))
    timed = {n: re.sub(r"\btime\b", "t", text) for n, text in sides.items()}
    inputs = [n for n in timed if n not in own]
    read = {n: parse(text, [*own, *values, *inputs, "t"]) for n, text in timed.items()}
    put = {sympy.Symbol(n): sympy.Float(v) for n, v in values.items()}
    closed = {sympy.Symbol(n): read[n].xreplace(put) for n in inputs}
    rhs = to_numpy({n: read[n].xreplace(put).xreplace(closed) for n in own})
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        assert np.allclose(rhs(t, state), expected, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_casadi_computes_the_equations(name):
    """The function gives dynsr's slopes, and the integrator the trajectory of calm systems."""
    need_module("casadi")
    space = loaded(written(name, "casadi"), name)
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        out = space["rhs"](t, state, [], space["PARAMETERS"]).full().ravel()
        assert np.allclose(out, expected, rtol=1e-10)
    if name in CALM:
        found = space["integrate"](x0=space["START"], p=space["PARAMETERS"])["xf"]
        assert np.allclose(found.full().ravel(), last(name), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_python_control_computes_the_equations(name):
    """The system gives dynsr's slopes."""
    need_module("control")
    found = loaded(written(name, "control"), name)["found"]
    for t, state, expected in zip(*points(name), slopes(name), strict=True):
        assert np.allclose(found.dynamics(t, state, []), expected, rtol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_sbml_is_consistent(name):
    """libsbml finds no fault in any model."""
    need_module("libsbml")
    from dynsr.export.sbml import find_faults

    assert find_faults(written(name, "sbml")) == []


def made(equations, run, **fields):
    """Give a discovery with data."""
    read = {state: parse(text) for state, text in equations.items()}
    return Discovery(read, {}, {}, {}, (run,), **fields)


@pytest.fixture
def noisy():
    """Give prey and predators with their data."""
    system = KNOWN["lotka-volterra"]
    rhs = to_numpy(dict(zip(system.states, system.rhs, strict=True)))
    t = np.linspace(5, 10, 21)
    x = solve_ivp(rhs, (5, 10), [1.0, 2.0], t_eval=t, rtol=1e-9).y.T
    return made({"x": "1.5*x - x*y", "y": "x*y - 3*y"}, Trajectory(t, x, ("x", "y")))


@pytest.mark.filterwarnings("ignore")
def test_a_petab_problem_is_whole(noisy, tmp_path):
    """petab finds no fault; times begin at 0, each parameter is to be estimated from its value."""
    need_module("libsbml")
    files = noisy.export("petab", tmp_path / "problem")
    assert "format_version: 1" in files
    rows = (tmp_path / "problem" / "measurements.tsv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 21 and rows[1].split("\t")[-1] == "0.0"
    petab = pytest.importorskip("petab", reason="petab is not installed")
    from petab.v1.lint import lint_problem

    problem = petab.v1.Problem.from_yaml(str(tmp_path / "problem" / "problem.yaml"))
    assert not lint_problem(problem)
    assert set(problem.x_ids) == {"k1", "k2", "k3", "noise_x", "noise_y"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_petab_problem_of_data_with_empty_cells_is_whole(noisy, tmp_path):
    """Where a state begins that the first row lacks is to be estimated; an empty cell is no
    measurement; the problem is read again.
    """
    need_module("libsbml")
    petab = pytest.importorskip("petab", reason="petab is not installed")
    from petab.v1.lint import lint_problem

    (run_,) = noisy.trajectories
    x = run_.x.copy()
    x[0, 1] = x[5, 0] = np.nan
    replace(noisy, trajectories=(replace(run_, x=x),)).export("petab", tmp_path / "problem")
    problem = petab.v1.Problem.from_yaml(str(tmp_path / "problem" / "problem.yaml"))
    assert not lint_problem(problem)
    assert len(problem.measurement_df) == 2 * 21 - 2
    (condition,) = problem.condition_df.to_dict("records")
    assert (condition["start_x"], condition["start_y"]) == (1.0, "start_y_run_1")
    row = problem.parameter_df.loc["start_y_run_1"]
    assert row["estimate"] == 1 and row["lowerBound"] < 2.0 < row["upperBound"]
    system, (again,) = read_petab(tmp_path / "problem" / "problem.yaml")
    assert system.x0 == {"x": 1.0, "y": row["nominalValue"]} and len(system.parameters) == 3
    assert np.array_equal(np.isnan(again.x), np.isnan(x))


def test_a_petab_problem_needs_its_data(noisy, tmp_path):
    """Without data, or with an input that moves, one line says what is the matter."""
    need_module("libsbml")
    with pytest.raises(InputError, match="a PEtab problem needs the data"):
        write_files(Source.of(KNOWN["sir"]), "petab")
    with pytest.raises(InputError, match="several files; give a folder"):
        noisy.export("petab")
    t = np.linspace(0, 1, 11)
    run_ = Trajectory(t, np.ones((11, 1)), ("x",), t[:, None], ("u",))
    with pytest.raises(InputError, match="input 'u' changes within a trajectory"):
        made({"x": "u - x"}, run_).export("petab", tmp_path / "p")
    later = replace(run_, t=run_.t + 1)
    twice = replace(made({"x": "cos(t) - x"}, run_), trajectories=(run_, later))
    with pytest.raises(InputError, match="the trajectories begin at different times"):
        twice.export("petab", tmp_path / "p")


def test_measured_inputs_are_given_to_the_code():
    """An input without a formula is an argument: a number, or a function of time."""
    found = Discovery({"x": parse("2*u - 0.5*x")}, {}, {}, {})
    space = loaded(found.export("python"), "python")
    assert space["rhs"](0.0, [4.0], 3.0) == pytest.approx([4.0])
    assert space["rhs"](2.0, [4.0], u=lambda t: t) == pytest.approx([2.0])
    torch = pytest.importorskip("torch", reason="torch is not installed")
    module = loaded(found.export("torch"), "torch")["Found"]()
    state = torch.tensor([4.0], dtype=torch.float64)
    assert module(0.0, state, 3.0).tolist() == pytest.approx([4.0])
    assert module(0.0, state, u=lambda t: t + 1).tolist() == pytest.approx([0.0])


@pytest.mark.slow
def test_measured_inputs_run_in_other_tools(tmp_path):
    """Octave takes a field, R a list, each a number or a function."""
    found = Discovery({"x": parse("2*u - 0.5*x")}, {}, {}, {})
    octave = need_tool("octave-cli")
    (tmp_path / "rhs.m").write_text(found.export("matlab"))
    (tmp_path / "main.m").write_text(
        "p = struct('k1', 2, 'k2', 0.5, 'u', 3); printf('%g ', rhs(0, 4, p));"
        "p.u = @(t) t; printf('%g ', rhs(2, 4, p));"
    )
    said = numbers(run(octave, "--no-init-file", "--quiet", "main.m", cwd=tmp_path))
    assert found.parameters.numbers == {"k1": 2.0, "k2": 0.5} and said.tolist() == [4.0, 2.0]
    rscript = need_tool("Rscript")
    (tmp_path / "found.R").write_text(
        found.export("r") + "\ncat(rhs(0, c(x = 4), parameters, list(u = 3))[[1]], "
        "rhs(2, c(x = 4), parameters, list(u = function(t) t))[[1]])"
    )
    assert numbers(run(rscript, "--vanilla", "found.R", cwd=tmp_path)).tolist() == [4.0, 2.0]


def test_a_map_is_written_where_it_can_be():
    """Python, C and others step; tools of differential equations refuse it by name."""
    found = Discovery({"x": parse("3.7*x - 3.7*x^2")}, {}, {}, {}, settings={"kind": "map"})
    space = loaded(found.export("python"), "map")
    assert space["step"](0, [0.4]) == pytest.approx([3.7 * 0.4 * 0.6])
    for form, one in FORMATS.items():
        if one.maps:
            assert found.export(form)
        else:
            with pytest.raises(InputError, match="takes no map; formats that do: python"):
                found.export(form)


def test_a_map_in_julia_gets_the_time_of_the_row_that_it_leaves():
    """FunctionMap counts rows from 0, and calls a map with the next one."""
    system = ParametricSystem.of(System.from_strings({"x": "cos(t) - x/2"}, train=(3.0, 5.0)))
    code = write_format(Source(replace(system, discrete=True, step=0.5)), "julia")
    assert "using OrdinaryDiffEqFunctionMap" in code
    assert "DiscreteProblem((du, u, p, n) -> step!(du, u, p, 3.0 + (n - 1) * 0.5)" in code
    assert "start, (0, 4), parameters), FunctionMap())" in code


@pytest.mark.parametrize("form", FORMATS)
def test_files_say_what_the_parameters_are(form, tmp_path):
    """Every file names its parameters, and a name outside ASCII is one the language takes."""
    need_module("libsbml")
    found = Discovery({"\u03b8": parse("-2.25*\u03b8*\u00e9t\u00e9")}, {}, {}, {})
    if form == "petab":
        return
    text = found.export(form)
    if form != "bibtex":
        assert "2.25" in text
    if FORMATS[form].words is not None:
        body = [
            line
            for line in text.splitlines()
            if not line.lstrip().startswith(("#", "//", "!", "%", "<p>"))
        ]
        assert "\n".join(body).replace("\u2205", "").isascii()
        assert "theta" in text and "ete" in text


def test_a_format_is_asked_for_by_name(noisy, tmp_path):
    """An unknown one is told what there is; no file is replaced unless it is said."""
    with pytest.raises(InputError, match=r"unknown format 'fortrn' \(did you mean 'fortran'\?\)"):
        noisy.export("fortrn")
    text = noisy.export("c", tmp_path / "new" / "found.c")
    assert (tmp_path / "new" / "found.c").read_text() == text == noisy.export("c")
    with pytest.raises(InputError, match="is there already"):
        noisy.export("c", tmp_path / "new" / "found.c")
    assert noisy.export("c", tmp_path / "new" / "found.c", force=True)


def test_citations_are_of_what_ran():
    """Methods and engine that found the equations are cited, each once."""
    x = {"x": parse("-x")}
    sindy = Discovery(x, {}, {}, {}, settings={"methods": ["sindy", "rational"]})
    assert "brunton2016" in sindy.cite() and "udrescu2020" not in sindy.cite()
    other = {"methods": ["dynaifeynman", "ga"], "engine": "julia"}
    cited = Discovery(x, {}, {}, {}, settings=other).cite()
    assert cited.count("@article{weilbach2021") == 1 and "rackauckas2017" in cited
    assert cited.count("{") == cited.count("}")


def test_the_command_writes_formats(noisy, tmp_path):
    """Without --to the formats are listed; text goes to stdout or to a file that is not there."""
    found = noisy.rename({"k1": "bite"})
    saved = replace(found, settings={"engine": "embedded"}).save(tmp_path / "discovery.json")
    listed = json.loads(command("export", "--json").stdout)
    assert listed == json.loads(command("export", saved, "--json").stdout)
    assert "give the discovery to write" in command("export", "--to", "julia", code=2).stderr
    assert [one["format"] for one in listed] == list(FORMATS)
    assert "bite" in command("export", saved, "--to", "julia").stdout
    out = tmp_path / "found.m"
    said = json.loads(command("export", saved, "--to", "octave", "-o", out, "--json").stdout)
    assert said == {"format": "octave", "files": [str(out)]}
    assert "bite" in out.read_text()
    again = command("export", saved, "--to", "octave", "-o", out, code=2)
    assert "is there already" in again.stderr
    command("export", saved, "--to", "octave", "-o", out, "--force")
    assert (
        "unknown format 'jula' (did you mean 'julia'?)"
        in command("export", saved, "--to", "jula", code=2).stderr
    )


def test_the_command_writes_a_problem_with_data(noisy, tmp_path):
    """Data that are given go into a PEtab problem, which is a folder."""
    need_module("libsbml")
    saved = replace(noisy, settings={"engine": "embedded"}).save(tmp_path / "discovery.json")
    write_csv(noisy.trajectories[0], tmp_path / "measured.csv")
    asked = ("export", saved, "--to", "petab", "-o", tmp_path / "problem")
    assert "a saved result does not keep" in command(*asked, code=2).stderr
    command(*asked, "--data", tmp_path / "measured.csv")
    assert len(list((tmp_path / "problem").iterdir())) == 6


def test_doses_are_named_where_they_are_left_out():
    """A comment says which states were given doses; a text that is no state is not written."""
    given = {"x": "dose", "y\nimport os": "z"}
    found = Discovery({"x": parse("-x/3")}, {}, {}, {}, settings={"doses": given})
    for form in ("python", "c", "modelica"):
        text = found.export(form)
        assert "Doses of x are no part of the equations" in text and "import os" not in text
