"""Held inputs: fits, integrations and verdicts see the same input, and no step sees a jump."""

from dataclasses import replace
from pathlib import Path

import command_line
import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import dynsr
from dynsr.data import Trajectory, read_trajectories
from dynsr.engines import Drive, EmbeddedEngine, InitialValueProblem
from dynsr.engines.adaptive import integrate_in_parts
from dynsr.fit import Measurements, fit_along, match_trajectories
from dynsr.selection.approximations import MeasuredRuns
from dynsr.verdict.flow_verdict import give_verdict
from dynsr.verdict.prediction import Measured, predict

T, U = sympy.symbols("T u")
TRUTH = np.array([-0.03, 0.02, 0.66])
LAW = {"T": 0.02 * U - 0.03 * T + 0.66}


def heater(fewest: int = 7, most: int = 15, rows: int = 240) -> Trajectory:
    """Give T' = 0.02 u - 0.03 (T - 22), u in steps every some uneven rows, in closed form."""
    rng = np.random.default_rng(0)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(2, 8, rows - 1))])
    u: list[float] = []
    while len(u) < rows:
        u += [float(rng.choice([0, 20, 40, 60, 80]))] * int(rng.integers(fewest, most + 1))
    x = [22.0]
    for i in range(rows - 1):
        rest = (0.02 * u[i] + 0.66) / 0.03
        x.append(rest + (x[-1] - rest) * np.exp(-0.03 * (t[i + 1] - t[i])))
    return Trajectory(t, np.array(x)[:, None], ("T",), np.array(u[:rows])[:, None], ("u",))


def noisy(run: Trajectory) -> Trajectory:
    """Add noise of 1 % of the spread."""
    noise = np.random.default_rng(1).normal(size=run.x.shape) * 0.01 * run.x.std()
    return replace(run, x=run.x + noise)


@pytest.mark.parametrize("most", [1, 3, 15])
def test_an_integration_meets_the_held_solution_in_closed_form(most: int) -> None:
    """The true law with its own input gives the data, to the tolerance of the solver."""
    run = heater(min(most, 7), most)
    found = predict(LAW, run.x[0], run.t, {"u": run.inputs[:, 0]})
    assert np.max(np.abs(found.x - run.x)) < 1e-5
    assert found.inputs[:, 0].tolist() == run.inputs[:, 0].tolist()


@pytest.mark.parametrize("most", [1, 3, 15])
def test_the_constants_of_exact_data_are_exact(most: int) -> None:
    """Shooting takes steps from row to row, each with the value that was held."""
    run = heater(min(most, 7), most)
    match = match_trajectories({"T": 0.018 * U - 0.027 * T + 0.6}, run)
    # The steps are as short as the misses of the start ask for.
    match = match_trajectories(match.exprs, run)
    found = sorted(value for value, _ in match.errors["T"])
    assert found == pytest.approx(TRUTH.tolist(), rel=1e-7)


@pytest.mark.parametrize("most", [1, 3, 15])
@pytest.mark.slow
def test_the_intervals_of_noisy_data_hold_the_truth(most: int) -> None:
    """Collocation has a row twice where the input jumps; its constants are those of the law."""
    run = noisy(heater(min(most, 7), most))
    data = Measurements.of([run], {}, 1000)
    fit = fit_along({"T": 0.018 * U - 0.027 * T + 0.6}, data)
    assert fit is not None
    order = np.argsort(fit.constants)
    assert fit.constants[order] == pytest.approx(TRUTH, rel=0.03)
    assert np.all(np.abs(fit.constants[order] - TRUTH) < 3 * fit.errors[order])


def test_a_mesh_has_a_row_twice_where_an_input_jumps() -> None:
    """The first of the two is measured and has the input before, the other the input after."""
    run = Trajectory(
        np.arange(6.0), np.ones((6, 1)), ("x",), np.array([[0.0, 0, 0, 3, 3, 3]]).T, ("u",)
    )
    mesh = Measurements.of([run], {}, 1000).mesh(("x",))
    (place,) = np.flatnonzero(np.diff(mesh.t) == 0)
    assert mesh.t[place] == 3.0
    assert mesh.driven[0, place : place + 2].tolist() == [0.0, 3.0]
    assert mesh.weights[place, 0] > 0
    assert mesh.weights[place + 1, 0] == 0
    assert int(np.count_nonzero(mesh.weights)) == len(run)


def test_an_input_in_ramps_goes_straight_between_rows() -> None:
    """A triangle that is integrated is a chain of parabolas."""
    t = np.linspace(0.0, 8.0, 17)
    run = Trajectory(t, t[:, None], ("x",), np.abs(t % 4 - 2)[:, None], ("u",))
    fine = np.linspace(0.0, 2.0, 41)
    found = predict(
        {"x": sympy.Symbol("u")}, [0.0], fine, {"u": Measured("u", t, run.inputs[:, 0])}
    )
    assert found.x[:, 0] == pytest.approx(2 * fine - fine**2 / 2, abs=1e-9)


def test_what_the_caller_says_is_used() -> None:
    """The same values held and in lines differ by half a step times the change."""
    t = np.arange(5.0)
    ends = [
        predict({"x": sympy.Symbol("u")}, [0.0], t, {"u": t}, hold=way).x[-1, 0]
        for way in ("previous", "linear", "smooth")
    ]
    assert ends == pytest.approx([6.0, 8.0, 8.0])
    with pytest.raises(dynsr.InputError, match="hold names 'v', which is no input"):
        predict({"x": sympy.Symbol("u")}, [0.0], t, {"u": t}, hold={"v": "linear"})


def test_no_step_of_an_engine_sees_a_jump() -> None:
    """Every part between two jumps is a problem whose inputs go on at its end."""
    pulse = Drive("u", np.array([0.0, 0.3, 0.5]), np.array([[0.0, 10.0, 0.0]]))
    seen: list[InitialValueProblem] = []

    def solve(problem: InitialValueProblem):  # type: ignore[no-untyped-def]
        seen.append(problem)
        return EmbeddedEngine().integrate(problem)

    problem = InitialValueProblem(
        (sympy.Symbol("u"),), ("x",), np.zeros(1), np.array([0.0, 0.4, 1.0]), drives=(pulse,)
    )
    found = integrate_in_parts(problem, solve)
    assert found.x[:, 0] == pytest.approx([0.0, 1.0, 2.0], abs=1e-12)
    assert [part.t.tolist() for part in seen] == [[0.0, 0.3], [0.3, 0.4, 0.5], [0.5, 1.0]]
    assert not any(len(part.drives[0].jumps) for part in seen)
    # Three steps would do; an error control that saw a jump would need dozens.
    assert found.accepted + found.rejected < 30


@pytest.mark.slow
def test_stiff_parts_go_on_by_the_implicit_method() -> None:
    """A fast system between jumps comes to rest at each level."""
    t = np.linspace(0.0, 4.0, 5)
    fast = {"x": -1e6 * (sympy.Symbol("x") - U)}
    found = predict(fast, [0.0], t, {"u": np.array([1.0, 1.0, 3.0, 3.0, 3.0])})
    assert found.x[1:, 0] == pytest.approx([1.0, 1.0, 3.0, 3.0], abs=1e-5)


def test_rows_at_which_an_input_steps_are_kept_when_rows_are_thinned() -> None:
    """Between the rows that are left the input has one value."""
    run = heater()
    thin = run.select(run.every(4))
    steps = run.t[1:][np.diff(run.inputs[:, 0]) != 0]
    assert set(steps) <= set(thin.t)
    assert len(thin) < 0.5 * len(run)


@pytest.mark.slow
def test_stretches_stand_for_a_run_whose_input_steps_at_every_row() -> None:
    """Where rows cannot be left out, whole stretches are kept: about as many rows in all."""
    run = heater(1, 1, 400)
    stretches = run.thin(4)
    assert [len(rows) for rows in stretches] == [25] * 4
    assert all(np.all(np.diff(rows) == 1) for rows in stretches)
    assert stretches[0][0] == 0
    assert stretches[-1][-1] == len(run) - 1
    fit = fit_along(LAW, Measurements.of([noisy(run)], {}, 100))
    assert fit is not None
    assert np.sort(fit.constants) == pytest.approx(TRUTH, rel=0.05)


def test_sums_of_terms_follow_a_held_input() -> None:
    """Runge and Kutta's steps of a follower end before each jump."""
    r2 = MeasuredRuns([heater(3, 5, 120)], {}, ("T",)).r2(LAW)
    assert 1 - r2[0] < 1e-10


def test_a_held_input_gives_the_slopes_of_a_hybrid_too() -> None:
    """Equations with no network to add integrate as they do alone."""
    pytest.importorskip("torch")
    from dynsr.discovery.hybrid import HybridModel, Residual

    class Nothing:
        def evaluate(self, X: np.ndarray) -> np.ndarray:
            return np.zeros(len(X))

    run = heater(3, 5, 60)
    nothing: dict[str, Residual] = {"T": Nothing()}  # type: ignore[dict-item]
    found = HybridModel(LAW, [run], {}, nothing).simulate()
    assert np.max(np.abs(found.x - run.x)) < 1e-5


def test_an_independent_solver_meets_the_closed_form() -> None:
    """The closed form of the test data is right: SciPy's DOP853 from row to row agrees."""
    run = heater(1, 3, 30)
    x = run.x[0]
    for i in range(len(run) - 1):
        u = run.inputs[i, 0]
        span = (run.t[i], run.t[i + 1])
        found = solve_ivp(lambda _, T, u=u: 0.02 * u - 0.03 * T + 0.66, span, x, rtol=1e-11)
        x = found.y[:, -1]
    assert x[0] == pytest.approx(run.x[-1, 0], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.0, 0.01])
def test_the_law_of_a_heater_is_found(level: float) -> None:
    """Exact: exact constants. With 1 % noise: within 3 %, in intervals that hold the truth."""
    run = heater() if level == 0 else noisy(heater())
    found = dynsr.discover([run], jobs=1)
    assert found.verdict.tested
    assert found.verdict.level == "law"
    constants = {round(c.value, 2): c for c in found.constants["T"]}
    for truth in (-0.03, 0.02, 0.66):
        own = constants[truth]
        assert own.value == pytest.approx(truth, rel=1e-6 if level == 0 else 0.03)
        assert own.low <= truth <= own.high or own.value == pytest.approx(truth, rel=1e-9)


@pytest.mark.slow
def test_a_discovery_says_how_its_inputs_were_held_and_goes_on_so(tmp_path: Path) -> None:
    """The record has it; simulate and score take new values of the input in the same way."""
    run = heater()
    found = dynsr.discover([run], preset="quick", jobs=1)
    assert found.settings["hold"] == {"u": "previous"}
    found.save(tmp_path / "found.json")
    again = dynsr.Discovery.load(tmp_path / "found.json")
    assert again.hold == {"u": "previous"}
    ramp = np.arange(len(run.t)) / 3
    made = again.simulate(run.x[0], run.t, {"u": ramp})
    assert made.hold == {"u": "previous"}
    straight = again.simulate(run.x[0], run.t, {"u": ramp}, hold="linear")
    assert np.max(np.abs(straight.x - made.x)) > 0.01
    # Rows of one level alone say nothing of how the input is held.
    rising = replace(run, x=made.x, inputs=ramp[:, None], hold={})
    assert again.score([rising])["T"]["trajectory_rmse"] < 1e-5
    assert again.score([rising], hold={"u": "linear"})["T"]["trajectory_rmse"] > 0.01


def test_the_caller_says_how_inputs_are_held() -> None:
    """In reading, discovering and the estimator; a wrong name or word is one line."""
    run = heater(rows=60)
    table = {"t": run.t, "T": run.x[:, 0], "u": run.inputs[:, 0]}
    read = read_trajectories(table, inputs=["u"], hold={"u": "linear"})
    assert read.trajectories[0].hold == {"u": "linear"}
    assert dict(read.description.hold) == {"u": "linear"}
    for hold, says in (
        ({"v": "linear"}, "hold names 'v', which is no input; the inputs are: u"),
        ({"u": "zoh"}, "input 'u' cannot be held 'zoh'; the ways are: previous, linear, smooth"),
    ):
        for call in (
            lambda hold: read_trajectories(table, inputs=["u"], hold=hold),
            lambda hold: dynsr.discover([run], hold=hold, jobs=1),
            lambda hold: dynsr.TrajectoryRegressor(hold=hold).fit(
                run.x, t=run.t, u=run.inputs, feature_names=["T", "u"]
            ),
        ):
            with pytest.raises(dynsr.InputError, match=says):
                call(hold)
    with pytest.raises(dynsr.InputError, match="is an expression in t"):
        dynsr.discover([run.select(slice(None))], inputs={"w": "sin(t)"}, hold={"w": "linear"})
    with pytest.raises(dynsr.InputError, match="a map has no time between rows"):
        dynsr.discover([run], discrete=True, hold="linear")


def test_several_files_hold_an_input_alike() -> None:
    """A file in which an input rests says nothing against one in which it swings."""
    t = np.linspace(0.0, 10.0, 101)
    tables = [{"t": t, "x": t, "u": level + 0 * t} for level in (1.0, 2.0)]
    tables[1]["u"] = np.sin(t)
    read = read_trajectories([*tables], inputs=["u"])
    assert [run.hold for run in read.trajectories] == [{"u": "smooth"}] * 2


def test_the_command_line_says_it_too(tmp_path: Path) -> None:
    """discover, describe and score take --hold; what is wrong is one line and exit code 2."""
    run = heater(rows=60)
    file = tmp_path / "heater.csv"
    lines = [f"{t},{x},{u}" for t, x, u in zip(run.t, run.x[:, 0], run.inputs[:, 0], strict=True)]
    file.write_text("\n".join(["t,T,u", *lines]) + "\n")
    told = command_line.run("describe", file, "--inputs", "u", "--hold", "u=linear")
    assert "straight" in told.output
    for command in ("describe", "discover"):
        for word, says in (("u=zoh", "cannot be held 'zoh'"), ("=zoh", "must be an input")):
            wrong = command_line.run(command, file, "--inputs", "u", "--hold", word, code=2)
            assert says in wrong.output


@pytest.mark.slow
def test_a_law_with_a_held_input_in_noise_is_judged() -> None:
    """Terms in the time are tried beside it, and where the input jumps no row counts twice."""
    run = noisy(heater())
    noise = [np.full_like(run.x, 0.01 * run.x.std())]
    match = match_trajectories(LAW, run)
    assert give_verdict(match.exprs, [run], noise=noise).level == "law"
    bent = {"T": match.exprs["T"] + sympy.Float(0.004) * U * sympy.Symbol("t") / 1000}
    assert give_verdict(bent, [run], noise=noise).level != "law"
