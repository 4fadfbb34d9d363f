"""Saved results with measured inputs or a delay in every format, integrated by the tool itself."""

import re
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from command_line import run as command
from scipy.integrate import solve_ivp
from targets import loaded, need_module, need_tool, run

import dynsr
from dynsr.data import Trajectory
from dynsr.discovery import Discovery, keep
from dynsr.errors import InputError
from dynsr.export import FORMATS, Source, make_casadi, make_control, make_do_mpc
from dynsr.expression import parse
from dynsr.parameters import Delay

END = 4.0
T = np.linspace(0.0, END, 9)
# Value of the measured input "u" in the first run and in the second.
GIVEN = (0.7, 1.3)
U = GIVEN[0]
STARTS = {"x": (1.2, 0.6), "y": (0.4, 0.9)}
# Systems without measured inputs are those of test_cross. Here an input is alone measured, and a
# constant of one equation differs from run to run.
RESULTS = {
    "input": {"x": "2*u - 0.5*x^1.5/(0.3 + x)", "y": "0.4*x^0.5 - 1.1*y*exp(-0.2*y)"},
    "differs": {"x": "u*x*(1 - x/3)", "y": "0.2*sin(x) - log(1 + y^2) + tanh(u)"},
}


def saved(name, folder):
    """Save a result with two runs that its own equations make; gives it as it is read again."""
    equations = {state: parse(text) for state, text in RESULTS[name].items()}
    bare = Discovery(equations, {}, {}, {})
    runs = []
    for place, u in enumerate(GIVEN):
        start = [STARTS[state][place] for state in equations]
        x = bare.simulate(start, T, {"u": str(u)}).x
        runs.append(Trajectory(T, x, tuple(equations), np.full((len(T), 1), u), ("u",)))
    settings = {"engine": "embedded"}
    found = Discovery(equations, {}, {}, {}, tuple(runs), settings=settings)
    return dynsr.load(found.save(folder / "discovery.json")), runs


@pytest.fixture(params=RESULTS)
def result(request, tmp_path):
    """Give a result that was saved, its runs, and a folder."""
    found, runs = saved(request.param, tmp_path)
    return found, runs, tmp_path


def same(states, runs):
    """Whether states are those of the first run, to 1e-6 of the widest."""
    states = np.asarray(states, dtype=float)
    expected = runs[0].x[-1] if states.ndim == 1 else runs[0].x
    return np.max(np.abs(states - expected)) < 1e-6 * np.max(np.abs(runs[0].x))


def integrated(slope, runs):
    """Give the states at the times of the first run."""
    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
    return solve_ivp(slope, (T[0], T[-1]), runs[0].x[0], t_eval=T, **options).y.T


def test_python_integrates(result):
    """The function, with a number for the input, gives the trajectory."""
    found, runs, _ = result
    space = loaded(found.export("python"), "found")
    assert same(integrated(lambda t, s: space["rhs"](t, s, u=U), runs), runs)


def test_torch_integrates(result):
    """The module gives the trajectory."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    found, runs, _ = result
    module = loaded(found.export("torch"), "found")["Found"]()
    with torch.no_grad():
        assert same(integrated(lambda t, s: module(t, torch.tensor(s), U).numpy(), runs), runs)


@pytest.mark.slow
def test_diffrax_integrates(result):
    """The function for JAX gives the trajectory by diffrax."""
    need_module("diffrax")
    found, runs, _ = result
    space = loaded(found.export("jax"), "found")
    import diffrax
    import jax.numpy as jnp

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(space["rhs"]),
        diffrax.Tsit5(),
        t0=T[0],
        t1=T[-1],
        dt0=None,
        y0=jnp.array(runs[0].x[0]),
        args={**space["PARAMETERS"], "u": U},
        saveat=diffrax.SaveAt(ts=jnp.array(T)),
        stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-12),
        max_steps=100_000,
    )
    assert same(solution.ys, runs)


# Runge-Kutta steps in C and Fortran, for both begin and end at the same times.
STEPS = 20_000
C = """#include "found.c"
#include <stdio.h>
int main(void) {
    double s[2] = {START}, k[4][2], z[2], u[1] = {INPUT}, h = SPAN / STEPS;
    double at[4] = {0, 0.5, 0.5, 1};
    for (int n = 0; n < STEPS; n++) {
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 2; j++) z[j] = s[j] + (i ? at[i] * h * k[i - 1][j] : 0);
            found_rhs((n + at[i]) * h, z, found_parameters, u, k[i]);
        }
        for (int j = 0; j < 2; j++) s[j] += h * (k[0][j] + 2 * k[1][j] + 2 * k[2][j] + k[3][j]) / 6;
    }
    printf("%.17g %.17g", s[0], s[1]);
}
"""
FORTRAN = """program main
use found
integer :: n
real(dp) :: s(2), k(2, 4), u(1), h
s = [START]; u = [real(dp) :: INPUT]; h = SPAN / STEPS
do n = 0, STEPS - 1
  call found_rhs(n * h, s, found_parameters, u, k(:, 1))
  call found_rhs((n + 0.5d0) * h, s + h / 2 * k(:, 1), found_parameters, u, k(:, 2))
  call found_rhs((n + 0.5d0) * h, s + h / 2 * k(:, 2), found_parameters, u, k(:, 3))
  call found_rhs((n + 1) * h, s + h * k(:, 3), found_parameters, u, k(:, 4))
  s = s + h / 6 * (k(:, 1) + 2 * k(:, 2) + 2 * k(:, 3) + k(:, 4))
end do
print '(2es26.17e3)', s
end program
"""


def filled(code, runs, ending=""):
    """Put the numbers of a run into a program."""
    start = ", ".join(f"{v!r}{ending}" for v in runs[0].x[0].tolist())
    puts = {"START": start, "INPUT": f"{U!r}{ending}", "SPAN": f"{END!r}{ending}"}
    for name, text in {**puts, "STEPS": str(STEPS)}.items():
        code = code.replace(name, text)
    return code


@pytest.mark.slow
@pytest.mark.parametrize("form", ["c", "fortran"])
def test_compiled_code_integrates(result, form):
    """The compiled function gives the trajectory by Runge-Kutta steps."""
    found, runs, folder = result
    compiler = need_tool({"c": "gcc", "fortran": "gfortran"}[form])
    found.export(form, folder / f"found{FORMATS[form].suffix}")
    if form == "c":
        (folder / "main.c").write_text(filled(C, runs))
        run(compiler, "-O2", "main.c", "-o", "main", "-lm", cwd=folder)
    else:
        (folder / "main.f90").write_text(filled(FORTRAN, runs, "d0"))
        run(compiler, "-O2", "found.f90", "main.f90", "-o", "main", cwd=folder)
    assert same(np.array(run(folder / "main").split(), dtype=float), runs)


@pytest.mark.slow
def test_octave_integrates(result):
    """ode45 gives the trajectory of the function, with the input as a field."""
    found, runs, folder = result
    octave = need_tool("octave-cli")
    found.export("matlab", folder / "rhs.m")
    values = {**found.parameters.numbers, "u": U}
    fields = ", ".join(f"'{name}', {value!r}" for name, value in values.items())
    start = "; ".join(map(repr, runs[0].x[0].tolist()))
    (folder / "main.m").write_text(
        f"p = struct({fields}); o = odeset('RelTol', 1e-9, 'AbsTol', 1e-11);\n"
        f"[t, y] = ode45(@(t, s) rhs(t, s, p), [0 {END!r}], [{start}], o);\n"
        "printf('%.17g ', y(end, :));"
    )
    told = run(octave, "--no-init-file", "--quiet", "main.m", cwd=folder)
    assert same(np.array(told.split(), dtype=float), runs)


def desolve(code, folder):
    """Run R with deSolve and give the numbers that it prints."""
    rscript = need_tool("Rscript")
    (folder / "main.R").write_text(code)
    there = "cat(requireNamespace('deSolve', quietly = TRUE))"
    if run(rscript, "--vanilla", "-e", there) != "TRUE":
        pytest.skip("deSolve is not installed")
    return np.array(run(rscript, "--vanilla", "main.R", cwd=folder).split(), dtype=float)


@pytest.mark.slow
def test_desolve_integrates(result):
    """R's deSolve gives the trajectory of the function, with the input in a list."""
    found, runs, folder = result
    found.export("r", folder / "found.R")
    told = desolve(
        "source('found.R')\n"
        f"out <- deSolve::ode(start, c(0, {END!r}), rhs, parameters, rtol = 1e-10, "
        f"atol = 1e-12, inputs = list(u = {U!r}))\ncat(sprintf('%.17g', out[2, -1]), '')",
        folder,
    )
    assert same(told, runs)


def test_casadi_integrates(result):
    """CasADi's integrator gives the trajectory of the text, and the object the same slopes."""
    need_module("casadi")
    found, runs, _ = result
    space = loaded(found.export("casadi"), "found")
    end = space["integrate"](x0=runs[0].x[0], u=[U], p=space["PARAMETERS"])["xf"]
    assert same(end.full().ravel(), runs)
    p = list(found.parameters.numbers.values())
    slope = found.to_casadi()
    assert same(integrated(lambda t, s: slope(t, s, [U], p).full().ravel(), runs), runs)


def test_python_control_integrates(result):
    """python-control gives the trajectory of the text and of the object."""
    need_module("control")
    import control

    found, runs, _ = result
    exact = {"rtol": 1e-10, "atol": 1e-12, "method": "LSODA"}
    for system in (loaded(found.export("control"), "found")["found"], found.to_control()):
        response = control.input_output_response(
            system, T, np.full((1, len(T)), U), runs[0].x[0], solve_ivp_kwargs=exact
        )
        assert same(response.states.T, runs)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_do_mpc_integrates(result):
    """The simulator of do-mpc gives the trajectory, step by step."""
    need_module("do_mpc")
    found, runs, _ = result
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        space = loaded(found.export("do-mpc"), "found")
    simulator = space["simulate"]()
    for _ in range(len(T) - 1):
        state = simulator.make_step(np.array([[U]]))
    assert same(state[:2, 0], runs)


def roadrunner_of(model):
    """Give the simulator of an SBML model."""
    roadrunner = pytest.importorskip("roadrunner", reason="libroadrunner is not installed")
    runner = roadrunner.RoadRunner(model)
    runner.integrator.relative_tolerance = 1e-10
    runner.integrator.absolute_tolerance = 1e-13
    return runner


def test_roadrunner_integrates(result):
    """A simulator of SBML gives the trajectory, with the input as a parameter."""
    need_module("libsbml")
    found, runs, _ = result
    runner = roadrunner_of(found.export("sbml"))
    runner.setValue("u", U)
    assert same(runner.simulate(T[0], T[-1], len(T), ["x", "y"]), runs)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_petab_problem_gives_every_run(result):
    """Each condition of the problem, simulated, gives the measurements of its run."""
    need_module("libsbml")
    petab = pytest.importorskip("petab", reason="petab is not installed")
    found, runs, folder = result
    whole = Discovery.from_system(found.system, runs)
    whole.export("petab", folder / "problem")
    problem = petab.v1.Problem.from_yaml(str(folder / "problem" / "problem.yaml"))
    for own in problem.condition_df.itertuples():
        runner = roadrunner_of((folder / "problem" / "model.xml").read_text())
        for name in problem.condition_df.columns:
            runner.setValue(f"init({name})", getattr(own, name))
        runner.reset()
        states = runner.simulate(T[0], T[-1], len(T), ["x", "y"])
        rows = problem.measurement_df.query("simulationConditionId == @own.Index")
        for place, state in enumerate("xy"):
            seen = rows[rows.observableId == f"observed_{state}"].measurement
            assert np.allclose(states[:, place], seen, atol=1e-6)


def test_modelica_integrates(result):
    """The formulas of the model, read by dynsr's parser, give the trajectory."""
    found, runs, _ = result
    code = found.export("modelica")
    values = {n: float(v) for n, v in re.findall(r"parameter Real (\w+) = (\S+);", code)}
    sides = dict(re.findall(r"^  der\((\w+)\) = (.*);$", code, re.MULTILINE))
    read = {s: parse(re.sub(r"\btime\b", "t", e)).subs(values) for s, e in sides.items()}
    made = Discovery(read, {}, {}, {}).simulate(runs[0].x[0], T, {"u": str(U)})
    assert same(made.x, runs)


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_is_written_or_refused_in_one_line(result, form):
    """What a format cannot express is one line that says why."""
    need_module("libsbml")
    found, _, folder = result
    try:
        text = found.export(form, folder / f"written{FORMATS[form].suffix}")
    except InputError as refusal:
        text = "" if form in ("catalyst", "petab") and "\n" not in str(refusal) else None
    assert text is not None


LAG = 1.5


@pytest.fixture
def late(tmp_path):
    """Give a saved law with a delay, which was 0.8 all the time before its first row."""
    equations = {"x": parse("0.9*x*(1 - x_delayed/2) + 0.1*cos(t)")}
    delays = {"x_delayed": Delay("x", LAG, 0.01, 1.48, 1.52)}
    found = Discovery(equations, {}, {}, {}, settings={"engine": "embedded"}, delays=delays).save(
        tmp_path / "discovery.json"
    )
    return dynsr.load(found)


def test_a_delay_is_said_or_refused(late):
    """Formats without delays refuse them by name; the others say which delay it is."""
    need_module("libsbml")
    for form, one in FORMATS.items():
        if not one.delays:
            with pytest.raises(InputError, match="takes no delay; formats that do: python"):
                late.export(form)
        elif form != "bibtex":
            assert "1.5" in late.export(form)
    for make in (make_casadi, make_control, make_do_mpc):
        with pytest.raises(InputError, match="takes no delay"):
            make(Source.of(late))


@pytest.mark.slow
def test_python_follows_a_delay(late):
    """Run as a script, the file goes by the method of steps, as dynsr does."""
    code = late.export("python").replace("[1.0]", "[0.8]").replace("10.0", "4.0")
    end = float(run(sys.executable, "-c", code))
    assert end == pytest.approx(late.simulate([0.8], T).x[-1, 0], rel=1e-6)


@pytest.mark.slow
def test_desolve_follows_a_delay(late, tmp_path):
    """R's dede, as the file shows it, gives the same."""
    code = late.export("r", tmp_path / "found.R").replace("x = 1.0", "x = 0.8")
    example = code.partition("# library(deSolve)")[2].replace("\n# ", "\n").replace("\n#", "\n")
    example = re.sub(r"times = seq\(.*?\)", f"times = c(0, {END!r})", example)
    example = example.replace("parms = parameters)", "parms = parameters, rtol=1e-10, atol=1e-12)")
    given = code.partition("# library(deSolve)")[0]
    end = desolve(f"{given}\nlibrary(deSolve){example}\ncat(solution[2, -1], '')", tmp_path)
    assert end == pytest.approx(late.simulate([0.8], T).x[-1], rel=1e-6)


@pytest.mark.slow
def test_octave_follows_a_delay(late, tmp_path):
    """Octave has no dde23: steps of Heun, halved once, give what dynsr gives, with the delayed
    state as a field.
    """
    octave = need_tool("octave-cli")
    (tmp_path / "rhs.m").write_text(late.export("matlab"))
    fields = ", ".join(f"'{n}', {v!r}" for n, v in late.parameters.numbers.items())
    (tmp_path / "main.m").write_text(
        "1;\nfunction x = go(m, p)\n"
        f"h = {LAG} / m; n = round({END!r} / h); x = 0.8 * ones(1, n + 1);\n"
        "for i = 1:n\np.x_delayed = x(max(i - m, 1)); a = rhs((i - 1) * h, x(i), p);\n"
        "p.x_delayed = x(max(i + 1 - m, 1)); b = rhs(i * h, x(i) + h * a, p);\n"
        "x(i + 1) = x(i) + h / 2 * (a + b);\nend\nx = x(end);\nend\n"
        f"p = struct({fields}); printf('%.17g', (4 * go(600, p) - go(300, p)) / 3);\n"
    )
    end = float(run(octave, "--no-init-file", "--quiet", "main.m", cwd=tmp_path))
    assert end == pytest.approx(late.simulate([0.8], T).x[-1, 0], rel=1e-6)


def test_julia_and_modelica_have_the_delay(late):
    """A Julia parser finds no error, the example's neither; Modelica has its own word for it."""
    assert "delay(x, 1.5)" in late.export("modelica")
    tree_sitter = pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
    julia = pytest.importorskip("tree_sitter_julia", reason="tree-sitter-julia is not installed")
    parser = tree_sitter.Parser(tree_sitter.Language(julia.language()))
    code = late.export("julia")
    assert "idxs = 1" in code
    about, _, example = code.partition("# using")
    code = about + "using" + example.replace("\n# ", "\n")
    assert not parser.parse(code.encode()).root_node.has_error


def test_a_saved_problem_takes_the_data_next_to_it(tmp_path):
    """Without --data the command takes those kept in the folder, or says that it needs the data."""
    need_module("libsbml")
    found, runs = saved("differs", tmp_path)
    asked = ("export", tmp_path, "--to", "petab", "-o", tmp_path / "problem")
    assert (
        "a saved result does not keep; give them with --data FILE" in command(*asked, code=2).output
    )
    keep(replace(found, trajectories=tuple(runs)), tmp_path)
    command(*asked)
    rows = (tmp_path / "problem" / "measurements.tsv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 2 * len(T)
