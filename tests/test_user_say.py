"""The user's say: functions, length, terms, signs, conservation, positivity and time."""

from __future__ import annotations

import json
import signal
import time

import numpy as np
import pytest
import sympy
from command_line import run
from scipy.integrate import solve_ivp

import dynsr
from dynsr.errors import InputError
from dynsr.expression import NAMED_FUNCTIONS, Vocabulary, parse
from dynsr.fit import structure_bits
from dynsr.fit.variation import neighbours
from dynsr.jobs import Budget, End, TimeUp, Turn, finish_by, time_limit
from dynsr.methods import (
    AbstractMethod,
    AskedMethod,
    Demands,
    DynAIFeynman,
    GeneticAlgorithm,
    Limits,
    RationalSearch,
    SINDy,
    read_demands,
)

X, Y = sympy.symbols("x y")


def lotka_volterra() -> dynsr.Trajectory:
    """Clean prey and predators."""
    t = np.linspace(0, 8, 160)
    found = solve_ivp(
        lambda _, v: [1.3 * v[0] - 0.8 * v[0] * v[1], 0.9 * v[0] * v[1] - 2.6 * v[1]],
        (0, 8),
        [2.0, 1.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    )
    return dynsr.Trajectory(t, found.y.T, ("x", "y"))


def epidemic() -> dynsr.Trajectory:
    """Give a clean epidemic whose people stay in number."""
    t = np.linspace(0, 60, 150)
    found = solve_ivp(
        lambda _, v: [-0.4 * v[0] * v[1], 0.4 * v[0] * v[1] - 0.1 * v[1], 0.1 * v[1]],
        (0, 60),
        [0.99, 0.01, 0.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    return dynsr.Trajectory(t, found.y.T, ("S", "I", "R"))


def samples_of(values: np.ndarray, x: np.ndarray, target: str = "x") -> dynsr.Samples:
    """Exact values of a function of x."""
    return dynsr.Samples(x[:, None], values, ("x",), target, "given", np.arange(len(x)) * 1.0)


SEARCHES = {
    "rational": RationalSearch(),
    "sindy": SINDy.preset("best"),
    "dynaifeynman": DynAIFeynman.preset(
        "best",
        stages=("simple functions", "rational", "polynomial", "brute force", "domain change"),
        candidates=500,
        exact_values=None,
    ),
    "genetic": GeneticAlgorithm.preset("best", iterations=10, population=200),
}


@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("asked", [[], ["exp"], ["+", "-", "*"], ["tanh", "/", "**"]])
@pytest.mark.slow
def test_every_method_keeps_to_the_functions_asked(
    name: str, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Formulas of a function that is not allowed are found by no method, for data made with it."""
    fronts: list[dynsr.ParetoFront] = []
    kind = type(SEARCHES[name])
    search = kind.search

    def watched(*given: object) -> dynsr.ParetoFront:
        fronts.append(search(*given))
        return fronts[-1]

    monkeypatch.setattr(kind, "search", watched)
    x = np.linspace(0.3, 3.0, 60)
    samples = samples_of(np.sin(2 * x) / (1 + x) + np.sqrt(x), x)
    demands = Demands(Vocabulary.read(asked))
    found = AskedMethod.of(SEARCHES[name], demands, {}).search(samples, np.random.default_rng(0))
    assert all(demands.vocabulary.allows(c.expr) for c in found)
    assert found.best_fit.loss < float(np.std(samples.y))
    # The limits bound the search itself: what is left out afterwards was not what it is best at.
    assert found.best_fit.loss <= fronts[-1].best_fit.loss * 1.0001


@pytest.mark.parametrize("name", ["rational", "sindy", "dynaifeynman", "genetic"])
def test_every_method_uses_a_function_asked_for_that_it_lacks(name: str) -> None:
    """tanh is none of the methods' own functions; asked for, each finds 2 tanh x."""
    x = np.linspace(-3, 3, 100)
    samples = samples_of(2 * np.tanh(x), x)
    method = SEARCHES[name].within(Limits(Vocabulary(("tanh",))))
    best = method.search(samples, np.random.default_rng(0)).best_fit
    assert best.loss < 1e-9
    assert best.expr.has(sympy.tanh)


@pytest.mark.parametrize("name", ["rational", "sindy", "dynaifeynman", "genetic"])
def test_a_term_of_ones_own_is_found_by_every_method(name: str) -> None:
    """3 x/(1 + x^2)^2 takes one coefficient once its shape is offered, and the front is in x."""
    x = np.linspace(-2, 2, 80)
    term = X * sympy.exp(-X) / (1 + X**4)
    samples = samples_of(3 * x * np.exp(-x) / (1 + x**4), x)
    method = SEARCHES[name].within(Limits(terms=(term,)))
    best = method.search(samples, np.random.default_rng(0)).best_fit
    assert best.loss < 1e-9
    assert best.expr.free_symbols == {X}


@pytest.mark.parametrize(
    ("asked", "allowed", "refused"),
    [
        ([], ["x**2*y/(1+x)", "x**-3"], ["sqrt(x)", "x**0.7", "exp(x)", "abs(x)"]),
        (["exp"], ["exp(x)/y", "x**3"], ["sin(x)", "log(x)", "sqrt(x)"]),
        (["+", "*"], ["x*y - 3", "x**4"], ["x/y", "1/(1+x)", "x**-2", "sqrt(x)"]),
        (["/", "sin"], ["sin(x)/y"], ["cos(x)", "x**0.3"]),
        (["**"], ["x**0.7", "sqrt(x)", "x**y"], ["x**-1", "x**-0.5", "sin(x)"]),
        (["sqrt"], ["sqrt(x)", "1/sqrt(x + y)", "x**1.5"], ["x**0.7"]),
        (["ln", "^", "/"], ["log(x)", "x**-1.2"], ["exp(x)"]),
    ],
)
def test_what_a_vocabulary_allows(asked: list[str], allowed: list[str], refused: list[str]) -> None:
    """Whole powers always, / unless operators are listed without it, other powers only by **."""
    vocabulary = Vocabulary.read(asked)
    assert [text for text in allowed if not vocabulary.allows(parse(text))] == []
    assert [text for text in refused if vocabulary.allows(parse(text))] == []


def test_every_named_function_can_be_allowed_alone() -> None:
    """Each function's own formula passes a vocabulary of it, and none passes an empty one."""
    for name in NAMED_FUNCTIONS:
        expr = parse(f"{name}(x) + x")
        assert Vocabulary.read([name]).allows(expr), name
        assert not Vocabulary.read([]).allows(expr), name


def test_neighbours_of_a_formula_keep_to_the_vocabulary() -> None:
    """sin(v) is no neighbour of v where sines are not allowed."""
    assert neighbours(X * Y, Vocabulary()) == []
    assert len(neighbours(X * Y, Vocabulary(("sin",)))) == 2


@pytest.fixture(scope="module")
def prey() -> dynsr.Trajectory:
    """Give the prey and predators once for all tests."""
    return lotka_volterra()


@pytest.mark.slow
def test_signs_zero_and_length_hold_in_the_answer_and_on_its_front(prey: dynsr.Trajectory) -> None:
    """Without x y in x', with a length of 40 bits and no sines, all formulas keep to it."""
    found = dynsr.discover(
        prey,
        preset="quick",
        method="sindy",
        jobs=1,
        functions=["+", "*"],
        max_complexity=40,
        constraints={"x": {"x*y": 0}, "y": {"x*y": "+", "y": "-"}},
    )
    assert str(found.equations["y"]) == "0.9*x*y - 2.6*y"
    for candidate in (*found.front["x"], *found.front["y"]):
        assert candidate.expr.is_polynomial(X, Y)
        assert structure_bits(candidate.expr) <= 40
    assert all(sympy.expand(c.expr).coeff(X * Y) == 0 for c in found.front["x"])
    asked = {k: found.settings[k] for k in ("functions", "constraints", "max_complexity")}
    assert asked == {
        "functions": ["+", "-", "*"],
        "constraints": ["x: x*y = 0", "y: x*y > 0", "y: y < 0"],
        "max_complexity": 40.0,
    }


@pytest.mark.slow
def test_what_is_conserved_is_conserved_exactly() -> None:
    """S' + I' + R' is 0 symbolically; R' follows, and so do the errors of its constants."""
    found = dynsr.discover(
        epidemic(), preset="quick", jobs=1, functions=[], conserved=["S + I + R"]
    )
    assert sympy.expand(sum(found.equations.values())) == 0
    assert list(found.equations) == ["S", "I", "R"]
    assert str(found.equations["R"]) == "0.1*I"
    assert "conserved" in found.explanation["R"]
    assert found.errors["R"][0][1] == found.errors["I"][0][1]


def test_a_nonnegative_state_has_no_negative_slope_at_zero() -> None:
    """-0.3 and x - y fall below 0; -0.3 x, y - x and -x log x do not."""
    columns = {"x": np.linspace(0.1, 2, 30), "y": np.linspace(1, 3, 30)}
    demands = Demands(nonnegative=("x",))
    kept = [
        demands.stays_positive("x", parse(text), columns)
        for text in ("-0.3 - 0*x", "x - y", "-0.3*x", "y - x", "-x*log(x)", "-sqrt(x)")
    ]
    assert kept == [False, False, True, True, True, True]
    assert demands.stays_positive("y", parse("-3"), columns)


def test_a_formula_that_breaks_a_sign_loses_the_term_and_is_fitted_again() -> None:
    """y = 2x - x^2 with x^2 >= 0 asked is the least-squares line through 0."""
    x = np.linspace(0, 1, 50)
    samples = samples_of(2 * x - x**2, x)
    demands = read_demands(["x"], ["x"], constraints=["x: x**2 > 0"])
    pool = [dynsr.Candidate(2.0 * X - 1.0 * X**2, 0.0, 10.0, "test")]
    (mended,) = demands.select(pool, samples)
    slope = float(x @ samples.y / (x @ x))
    assert mended.expr.coeff(X) == pytest.approx(slope, rel=1e-6)
    assert mended.expr.coeff(X**2) == 0


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"functions": ["foo"]}, "unknown function 'foo'; the functions are: sqrt, exp"),
        ({"max_complexity": 0}, "max_complexity 0 must be"),
        ({"max_complexity": "many"}, "max_complexity 'many' must be"),
        ({"terms": ["x*z"]}, "unknown name 'z'"),
        ({"terms": ["3"]}, "is a number"),
        ({"terms": ["sin(x)"], "functions": []}, "contains what functions do not allow"),
        ({"constraints": {"z": {"x": "+"}}}, "constraint names 'z', which is no state"),
        ({"constraints": {"x": "+"}}, "must map terms"),
        ({"constraints": {"x": {"x": "up"}}}, "is 'up'; it is '+', '-' or 0"),
        ({"constraints": {"x": {"x + y": "+"}}}, "one term without its sign"),
        ({"constraints": {"x": {"-x": "+"}}}, "one term without its sign"),
        ({"constraints": ["x*y < 0"]}, "write it like 'x: x*y < 0'"),
        ({"constraints": ["x: y < 0", "x: y > 0"]}, "contradict"),
        ({"conserved": ["x*y"]}, "must be a sum of at least two states"),
        ({"conserved": ["x + y", "2*x + 2*y"]}, "follow from one another"),
        ({"conserved": ["x + y"], "targets": ["y"]}, "make it a target too"),
        ({"nonnegative": ["u"]}, "nonnegative names 'u', which is no state"),
        ({"time_budget": -1}, "time_budget -1 must be"),
        ({"time_budget": "soon"}, "time_budget 'soon' must be"),
    ],
)
def test_a_wrong_wish_is_one_clear_line(
    prey: dynsr.Trajectory, asked: dict[str, object], words: str
) -> None:
    """Every wrong value is an InputError of one line that names it."""
    with pytest.raises(InputError) as error:
        dynsr.discover(prey, jobs=1, **asked)  # type: ignore[arg-type]
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_wishes_belong_to_the_folder_of_a_discovery(tmp_path) -> None:
    """The same call goes on in its folder; another wish is another discovery."""
    t = np.linspace(0, 4, 60)
    decay = dynsr.Trajectory(t, np.exp(-0.7 * t)[:, None], ("x",))
    asked = {"preset": "quick", "jobs": 1, "out": tmp_path, "functions": []}
    first = dynsr.discover(decay, **asked)
    assert dynsr.discover(decay, **asked).equations == first.equations
    for other in ({"functions": ["sin"]}, {"nonnegative": ["x"]}, {"time_budget": 100}):
        with pytest.raises(InputError):
            dynsr.discover(decay, **{**asked, **other})


class Endless(AbstractMethod):
    """Searches until it is stopped; its front is then x."""

    name = "endless"

    def search(self, samples, rng, report=dynsr.methods.silent):
        """Wait."""
        front = dynsr.ParetoFront([dynsr.Candidate(X, 1.0, 1.0, "endless")])
        try:
            while True:
                report(dynsr.methods.Progress("waiting", 0, None, front))
                time.sleep(0.001)
        except KeyboardInterrupt:
            return front


@pytest.mark.slow
def test_a_budget_ends_a_search_that_would_not_end(prey: dynsr.Trajectory) -> None:
    """The endless search gives what it has, the answer is complete and the record names it."""
    found = dynsr.discover(prey, method=[Endless(), "sindy"], jobs=1, time_budget=1)
    assert found.complete
    assert set(found.equations) == {"x", "y"}
    assert "search-x-endless" in found.settings["ended_by_budget"]
    assert found.settings["time_budget"] == 1
    assert "The time budget ended endless" in found.explanation["x"]


def test_the_smallest_budget_leaves_more_than_a_constant(prey: dynsr.Trajectory) -> None:
    """With a hundredth of a second for all, quadratics are still fitted."""
    found = dynsr.discover(prey, method=[Endless()], jobs=1, time_budget=0.01)
    assert {str(s) for s in found.equations["x"].free_symbols} == {"x", "y"}
    assert "search-y-endless" in found.settings["ended_by_budget"]


@pytest.mark.slow
def test_a_budget_that_is_not_hit_changes_nothing() -> None:
    """With an hour for a moment's work, equations, fronts and words are those without a budget."""
    t = np.linspace(0, 4, 60)
    decay = dynsr.Trajectory(t, np.exp(-0.7 * t)[:, None], ("x",))
    asked = {"method": "rational", "functions": (), "preset": "quick", "jobs": 1}
    without = dynsr.discover(decay, **asked)
    within = dynsr.discover(decay, **asked, time_budget=3600)
    assert within.as_record()["equations"] == without.as_record()["equations"]
    assert within.as_record()["front"] == without.as_record()["front"]
    assert within.explanation == without.explanation
    assert "ended_by_budget" not in within.settings


def test_time_is_shared_by_those_that_wait() -> None:
    """Of ten seconds for two equal tasks on one worker the first has five, the last the rest."""
    end = time.monotonic() + 10
    assert Turn(End(end), 0.5, 1).until() == pytest.approx(end - 5, abs=1)
    assert Turn(End(end), 1.0, 1).until() == pytest.approx(end, abs=1)
    assert Turn(End(end), 0.5, 4).until() == pytest.approx(end, abs=1)
    assert Budget(10.0, 100.0).until(0.5) == 105.0


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm on this system")
def test_work_that_does_not_report_is_ended_too() -> None:
    """A loop without reports is cut, the shorter work is done, and the alarm before is back."""
    before = signal.getsignal(signal.SIGALRM)

    def work() -> str:
        while True:
            sum(range(1000))

    assert finish_by(time.monotonic() + 0.05, work, lambda: "shorter") == ("shorter", True)
    assert signal.getsignal(signal.SIGALRM) is before


def test_a_report_is_never_cut_in_two() -> None:
    """The time is up during a report; the report ends before the search hears of it."""
    ended = []

    def report(progress: object) -> None:
        time.sleep(0.2)
        ended.append(progress)

    with pytest.raises(TimeUp), time_limit(time.monotonic() + 0.05) as clock:
        clock.through(report)("whole")
    assert ended == ["whole"]


@pytest.mark.slow
def test_the_shell_has_the_same_say(tmp_path) -> None:
    """Options reach the record as the arguments of the same names do."""
    data = tmp_path / "people.csv"
    people = epidemic()
    np.savetxt(
        data, np.column_stack([people.t, people.x]), delimiter=",", header="t,S,I,R", comments=""
    )
    words = [
        *("discover", data, "--json", "--quiet", "--preset", "quick", "--jobs", "1"),
        *("--functions", "none", "--conserved", "S+I+R", "--nonnegative", "S,I"),
        *("--constraint", "S: S*I < 0", "--term", "I*S", "--max-complexity", "50"),
        *("--time-budget", "600"),
    ]
    told = json.loads(run(*words).stdout)
    assert told["equations"]["R"] == "0.1*I"
    asked = ("functions", "conserved", "nonnegative", "constraints", "terms", "max_complexity")
    assert {name: told["settings"][name] for name in (*asked, "time_budget")} == {
        "functions": ["/"],
        "conserved": ["I + R + S"],
        "nonnegative": ["S", "I"],
        "constraints": ["S: I*S < 0"],
        "terms": ["I*S"],
        "max_complexity": 50.0,
        "time_budget": 600.0,
    }


def test_a_wrong_word_in_the_shell_is_one_line() -> None:
    """An unknown function ends with exit code 2 and a line that lists the functions."""
    result = run("discover", "--system", "pendulum", "--functions", "foo", code=2)
    assert "unknown function 'foo'; the functions are:" in " ".join(result.output.split())
