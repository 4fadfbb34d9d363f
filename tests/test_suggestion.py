"""Suggestions: the next experiment is the one from which the data tell most."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from command_line import run
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from test_profile_likelihood import enzyme, found_in, noisy_rabbits, solved

import dynsr
from dynsr.discovery import Discovery
from dynsr.errors import InputError
from dynsr.parameters import SuggestionSettings
from dynsr.verdict import Verdict

GROWTH, RELAXED = "x - 0.1*x**2", "9 - 0.9*x"


def near_the_top(noise, start=8.0, seed=0):
    """Give logistic growth seen near its capacity of 10, where x' = a - b*x does almost as well."""
    t, x = solved(lambda _, s: s * (1 - s / 10), [start], 6.0, 60)
    x = x + noise * np.std(x) * np.random.default_rng(seed).standard_normal(x.shape)
    found = found_in(t, x, x=GROWTH)
    front = [
        dynsr.Candidate(dynsr.parse(RELAXED), 0.1, 9.0),
        dynsr.Candidate(dynsr.parse(GROWTH), 0.05, 12.0),
    ]
    return replace(found, front={"x": dynsr.ParetoFront(front)})


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_growth_is_told_from_relaxation_far_from_the_top(noise):
    """The start that tells them apart is as far below the capacity as it may lie."""
    found = near_the_top(noise)
    made = found.suggest()
    (other,) = made.alternatives
    assert other.text.startswith("x' = ") and "x**2" not in other.text
    low = found.trajectories[0].x.min()
    assert made.best.start["x"] < low and made.best.bits > 3 * made.again.bits
    assert [own.bits for own in made.experiments] == sorted(
        (own.bits for own in made.experiments), reverse=True
    )


@pytest.mark.slow
def test_the_bits_are_those_that_the_experiment_then_tells():
    """Made six times with scipy, it tells as many bits as were expected, on average to a third."""
    noise = 0.05
    found = near_the_top(noise)
    made = found.suggest()
    run_, sd = found.trajectories[0], made.noise["x"]
    t = made.times - made.times[0]

    def missed(rhs, data, constants, starts):
        parts = [
            solve_ivp(rhs, (0, 6.0), [start], t_eval=t, args=tuple(constants), rtol=1e-8).y[0] - own
            for start, own in zip(starts, data, strict=True)
        ]
        return np.concatenate(parts) / sd

    def least(rhs, data, begin):
        begin = [*begin, *(own[0] for own in data)]
        fit = least_squares(lambda p: missed(rhs, data, p[:2], p[2:]), begin)
        return 2 * fit.cost

    def growth(_, s, a, b):
        return a * s - b * s**2

    def relaxed(_, s, a, b):
        return a - b * s

    old, rng = run_.x[:, 0], np.random.default_rng(1)
    before = least(relaxed, [old], (9.0, 0.9)) - least(growth, [old], (1.0, 0.1))
    truth = solve_ivp(growth, (0, 6.0), [made.best.start["x"]], t_eval=t, args=(1.0, 0.1)).y[0]
    gains = []
    for _ in range(6):
        new = truth + sd * rng.standard_normal(len(t))
        both = least(relaxed, [old, new], (9.0, 0.9)) - least(growth, [old, new], (1.0, 0.1))
        gains.append((both - before) / (2 * math.log(2)))
    assert np.mean(gains) == pytest.approx(made.best.bits, rel=1 / 3)


def test_without_alternatives_it_is_the_constants_that_are_told():
    """Far below saturation a high start tells most of speed and half-saturation."""
    made = enzyme(0.05).suggest()
    assert made.alternatives == () and "of the constants" in made.heading
    low, high = 0.0, enzyme(0.05).trajectories[0].x.max()
    assert made.best.start["x"] > high + 0.3 * (high - low)
    assert made.best.bits > made.again.bits


@pytest.mark.slow
def test_where_no_experiment_distinguishes_the_alternatives_that_is_said():
    """Over a moment two formulas do the same; the bits of a table near 0 would say it to nobody."""
    found = near_the_top(0.05)
    short, longer = found.suggest(span=1e-6), found.suggest()
    assert short.alternatives and short.best.bits < 1 < longer.best.bits
    assert short.heading.startswith("No experiment of 60 rows over 1e-06 that was tried")
    assert str(short).startswith(short.heading) and "a longer span" in short.heading
    assert longer.heading.startswith("The bits")


@pytest.mark.slow
def test_no_start_is_negative_where_no_state_was():
    """Counts and amounts start at 0 or more, however far beyond their range starts may lie."""
    made = noisy_rabbits(0.05).suggest(settings=SuggestionSettings(beyond=3.0))
    assert all(value >= 0 for own in made.experiments for value in own.start.values())


@pytest.mark.slow
def test_the_same_seed_suggests_the_same():
    """All chance comes from the seed."""
    found = near_the_top(0.05)
    assert found.suggest(seed=3).experiments == found.suggest(seed=3).experiments
    assert found.suggest(seed=3).experiments != found.suggest(seed=4).experiments


@pytest.mark.slow
def test_rows_and_span_are_those_asked_for():
    """A longer experiment of more rows tells more."""
    found = near_the_top(0.05)
    short, long = found.suggest(rows=10, span=1.0), found.suggest(rows=100, span=6.0)
    assert short.size == "10 rows over 1" and long.size == "100 rows over 6"
    assert long.best.bits > short.best.bits


@pytest.mark.slow
def test_inputs_are_suggested_too():
    """A gain that rest does not show is told by an input that moves the state."""
    t = np.linspace(0, 10, 80)
    u = np.where(t > 5, 0.1, 0.0)
    rng = np.random.default_rng(0)
    path = solve_ivp(
        lambda s, y: -0.8 * y + 0.5 * (0.1 if s > 5 else 0.0),
        (0, 10),
        [0.02],
        t_eval=t,
        max_step=0.1,
    )
    x = path.y.T + 0.002 * rng.standard_normal((80, 1))
    run_ = dynsr.Trajectory(t, x, ("x",), u[:, None], ("u",), hold={"u": "previous"})
    found = Discovery({"x": dynsr.parse("-0.7*x + 0.6*u")}, {}, {}, {}, trajectories=(run_,))
    made = found.suggest()
    assert {own.inputs for own in made.experiments} <= {
        "as in run 1",
        "u = 0",
        "u = 0.05",
        "u = 0.1",
    }
    assert made.again.inputs == "as in run 1" and made.best.bits > made.again.bits
    assert "inputs" in made.columns and "u = 0.1" in str(made)


@pytest.mark.slow
def test_a_suggestion_is_read_and_drawn():
    """It is text, a frame of pandas and a picture with a curve for each system."""
    made = near_the_top(0.05).suggest()
    frame = made.to_frame()
    assert list(frame.columns) == ["experiment", "x(0)", "bits"] and len(frame) >= 3
    assert str(made).count("\n") == len(frame) + 2
    left, right = made.plot().axes
    assert [line.get_label() for line in left.lines] == ["found", "other 1"]
    assert len(right.lines) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rows": 1}, "1 rows shows no motion"),
        ({"span": -1.0}, "a span of -1.0 is no time"),
        ({"span": math.nan}, "a span of nan is no time"),
        ({"seed": -1}, "seed"),
    ],
)
def test_what_no_experiment_can_be_is_refused(options, words):
    """Rows, spans and seeds that are none end in one line."""
    with pytest.raises(InputError, match=words) as error:
        near_the_top(0.05).suggest(**options)
    assert "\n" not in str(error.value)


def test_what_has_no_suggestion_says_why():
    """Without data, of a map, or with a state without an equation there is one line."""
    with pytest.raises(InputError, match="the data are not here"):
        Discovery({"x": dynsr.parse("-x")}, {}, {}, {}).suggest()
    with pytest.raises(InputError, match="a map"):
        Discovery({"x": dynsr.parse("2*x")}, {}, {}, {}, settings={"kind": "map"}).suggest()
    part = noisy_rabbits(0.05)
    alone = replace(part, equations={"x": part.equations["x"]})
    with pytest.raises(InputError, match="'y' has no equation"):
        alone.suggest()


@pytest.mark.slow
def test_the_shell_and_the_report_suggest(tmp_path):
    """The command prints the table; the page has it too, of what is no law: a law has no other."""
    found = near_the_top(0.05)
    model, table = found.save(tmp_path / "discovery.json"), tmp_path / "data.csv"
    run_ = found.trajectories[0]
    np.savetxt(table, np.column_stack([run_.t, run_.x]), "%.12g", ",", header="t,x", comments="")
    shown = run("suggest", model, table, "--rows", 30).stdout
    assert "5.25 bits behind" in shown and "first run again" in shown and "30 rows over 6" in shown
    told = json.loads(run("suggest", model, table, "--json").stdout)
    assert told["experiments"][0]["bits"] > told["again"]["bits"]
    assert "is no time" in run("suggest", model, table, "--span", "-1", code=2).stderr
    heading = "The next experiment"
    doubted = replace(found, verdict=Verdict("approximation", "it may be another."))
    assert heading in doubted.report(tmp_path / "doubted.html").read_text("utf-8")
    assert heading not in found.report(tmp_path / "law.html").read_text("utf-8")


@pytest.mark.slow
def test_an_alternative_that_runs_away_is_told_apart():
    """Sensitivities of any size end in no fault: a formula that explodes there is told at once."""
    found = near_the_top(0.05, start=4.0)
    front = [*found.front["x"], dynsr.Candidate(dynsr.parse("0.2 + 0.001*x**4"), 0.2, 8.0)]
    wild = replace(found, front={"x": dynsr.ParetoFront(front)})
    made = wild.suggest(settings=SuggestionSettings(plausible=1e9, farthest=1e9))
    assert len(made.alternatives) >= 2 and math.isfinite(made.best.bits)


@pytest.mark.slow
def test_a_first_run_that_an_alternative_cannot_make_again_has_no_row():
    """A longer span makes an alternative explode from the first start, but not from every start."""
    t, x = solved(lambda _, s: s, [1.0], 2.0, 40)
    x = x + 0.1 * np.random.default_rng(0).standard_normal(x.shape)
    front = [dynsr.Candidate(dynsr.parse("0.2*x**2"), 0.2, 8.0)]
    found = replace(found_in(t, x, x="x"), front={"x": dynsr.ParetoFront(front)})
    settings = SuggestionSettings(plausible=1e9, farthest=1e9)
    assert found.suggest(settings=settings).again is not None
    made = found.suggest(span=6.0, settings=settings)
    assert made.again is None and made.experiments
    assert "first run again" not in repr(made)
    # From each of the starts the equation found is beyond numbers.
    with pytest.raises(InputError, match="ask for a shorter span"):
        found.suggest(span=1e4)


@pytest.mark.slow
def test_a_formula_that_holds_the_answer_is_no_alternative():
    """What has one term more can always do what the answer does: nothing tells them apart."""
    found = near_the_top(0.05)
    wider = dynsr.Candidate(dynsr.parse("0.01 + x - 0.1*x**2"), 0.04, 15.0)
    more = replace(found, front={"x": dynsr.ParetoFront([*found.front["x"], wider])})
    texts = [own.text for own in more.suggest().alternatives]
    assert texts and not any("x**2" in text for text in texts)


def test_other_numbers_inside_its_terms_make_no_alternative_of_a_formula():
    """Of x/(x + 3) with a term more, the constant in the denominator comes out a bit different."""
    t = np.linspace(0, 12, 60)
    x = solve_ivp(lambda _, s: -s / (s + 3), (0, 12), [4.0], t_eval=t, rtol=1e-9).y.T
    x = x + 0.02 * np.random.default_rng(0).standard_normal(x.shape)
    found = found_in(t, x, x="-x/(x + 3)")
    wider = dynsr.Candidate(dynsr.parse("0.001*x**3 - 1.05*x/(x + 3.2)"), 0.04, 15.0)
    made = replace(found, front={"x": dynsr.ParetoFront([wider])}).suggest()
    assert made.alternatives == ()
