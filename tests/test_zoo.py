"""The zoo: systems that stay bounded and move, halves that are fixed, scores that are right."""

import hashlib
import json
import runpy
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import sympy
from command_line import run
from sklearn.metrics import r2_score

from dynsr.benchmarks.zoo.catalogue import ZOO, find_animals
from dynsr.benchmarks.zoo.conditions import Condition, draw_conditions, measure
from dynsr.benchmarks.zoo.peers import answer_stlsq, answer_weak
from dynsr.benchmarks.zoo.running import (
    ZooRecord,
    answer_dynsr,
    make_methods,
    run_zoo,
    score_table,
    verdict_table,
)
from dynsr.benchmarks.zoo.scoring import Answer, follow, plain_form, score_answer
from dynsr.benchmarks.zoo.suite import read_suite
from dynsr.benchmarks.zoo.system import ZooSystem
from dynsr.data import Trajectory
from dynsr.engines import simulate
from dynsr.errors import InputError
from dynsr.expression import parse
from dynsr.fit import r_squared
from dynsr.methods import RationalSearch

ROOT = Path(__file__).parents[1]
DECAY = ZooSystem("decay", "test", "none", {"x": "-0.7*x"}, ((2.0,), (5.0,)), 3.0)
CLEAN = Condition(0.0, "clean", 60, False)
NOISY = Condition(0.05, "additive", 60, True)


def test_the_zoo_has_enough_systems_of_every_size():
    """At least sixty-four systems, of one to four states, each of its own name."""
    assert len({animal.name for animal in ZOO}) == len(ZOO) >= 64
    assert {len(animal.equations) for animal in ZOO} == {1, 2, 3, 4}


def test_the_zoo_stands_as_it_was_fixed():
    """The systems are those that earlier answers were measured on, and all of them are seen."""
    lines = [f"{a.name} {dict(a.equations)} {a.starts} {a.span}" for a in ZOO]
    digest = hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()
    assert digest[:16] == "49c9b6fd0eae349b" and {a.group for a in ZOO} == {"seen"}


@cache
def integrated(name):
    """Integrate a system of the zoo from both starts, once for all that look at it."""
    (animal,) = find_animals([name])
    return measure(animal, Condition(0.0, "clean", 200, False))


@pytest.mark.parametrize("animal", ZOO, ids=lambda animal: animal.name)
def test_a_system_moves_and_stays_bounded_from_both_starts(animal):
    """From two different starts every state moves by more than a hundredth of what it reaches."""
    assert animal.starts[0] != animal.starts[1]
    measured = integrated(animal.name)
    for solved, start in zip((measured.truth, measured.unseen), animal.starts, strict=True):
        assert tuple(solved.x[0]) == start and solved.t[-1] == animal.span
        assert np.all(np.abs(solved.x) < 200)
        assert np.all(np.ptp(solved.x, axis=0) > 0.01 * np.abs(solved.x).max(axis=0))


def test_another_name_is_refused():
    """A name that there is not is told in one line with those that there are."""
    with pytest.raises(InputError, match="unknown system 'worm'; they are: logistic"):
        find_animals(["worm"])


def test_conditions_are_drawn_once_and_for_each_system():
    """Seven conditions, the same whatever else is run; over the zoo all rows, half incomplete."""
    seven = draw_conditions("logistic")
    assert len(seven) == 7 and sum(c.kind == "clean" for c in seven) == 1
    assert set(draw_conditions("logistic", [0.05])) < set(seven)
    drawn = [c for animal in ZOO for c in draw_conditions(animal.name)]
    assert {c.rows for c in drawn} == {50, 100, 150, 300, 1000}
    assert 0.45 < np.mean([c.dropped for c in drawn]) < 0.55
    assert draw_conditions("logistic", seed=1) != seven
    with pytest.raises(InputError, match="noise -1 must be a number from 0 up"):
        draw_conditions("logistic", [-1])


def test_noise_is_of_the_size_and_kind_that_is_asked_for():
    """Additive noise is a share of the deviation, multiplicative of each value; rows are lost."""
    (animal,) = find_animals(["cooling"])
    for kind in ("additive", "multiplicative"):
        measured = measure(animal, Condition(0.05, kind, 1000, True))
        miss = measured.data.x - measured.truth.x
        even = np.linspace(0, animal.span, 2000)
        whole = simulate(animal.system, t=even, reltol=1e-9).x
        size = whole.std() if kind == "additive" else np.abs(measured.truth.x)
        assert np.std(miss / size) == pytest.approx(0.05, rel=0.1)
        assert len(measured.data) == 1000 and set(measured.data.t) <= set(even)
    again = measure(animal, Condition(0.05, "additive", 1000, True))
    assert np.array_equal(
        again.data.x, measure(animal, Condition(0.05, "additive", 1000, True)).data.x
    )


def test_the_second_start_is_followed_and_never_given():
    """The data begin at the first start, what is unseen at the second."""
    measured = measure(DECAY, CLEAN)
    assert measured.data.x[0] == measured.truth.x[0] == 2.0 and measured.unseen.x[0] == 5.0
    assert measured.unseen.x[:, 0] == pytest.approx(5 * np.exp(-0.7 * measured.data.t), rel=1e-8)


def test_r_squared_agrees_with_scikit_learn():
    """The mean over states is scikit-learn's; each state counts from -1 up."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(40, 3))
    found = truth + 0.3 * rng.normal(size=(40, 3))
    assert r_squared(truth, found) == pytest.approx(r2_score(truth, found), rel=1e-12)
    far = found + np.array([0.0, 0.0, 1e6])
    two = r2_score(truth[:, :2], found[:, :2])
    assert r_squared(truth, far) == pytest.approx((2 * two - 1) / 3, rel=1e-12)
    assert r_squared(truth, np.full((40, 3), np.nan)) == -1


def test_equations_are_followed_from_time_zero():
    """Where the first row is lost, the integration still begins at time 0; divergence is NaN."""
    x = sympy.Symbol("x")
    run = Trajectory([0.5, 0.75, 1.5], np.ones((3, 1)), ("x",))
    found = follow({"x": -0.7 * x}, run, [2.0])
    assert found[:, 0] == pytest.approx(2 * np.exp(-0.7 * run.t), rel=1e-6)
    blown = follow({"x": x**2}, run, [1.0])
    assert blown[:2, 0] == pytest.approx([2, 4], rel=1e-5) and np.isnan(blown[2, 0])
    assert np.isnan(follow({"y": x}, run, [1.0])).all()


@pytest.mark.parametrize(
    ("found", "exact", "law", "off"),
    [
        ("-0.7*x", True, True, 0.0),
        ("-0.63*x", True, True, 0.1),
        ("-0.5*x", False, False, 0.2 / 0.7),
        ("-0.7*x + 0.001*x**2", False, True, np.inf),
        ("-0.2*x**2", False, False, np.inf),
        ("0", False, False, np.inf),
    ],
)
def test_a_law_has_the_terms_or_is_the_function(found, exact, law, off):
    """Exact needs the terms, constants within 20 %; a law may be another form of one function."""
    scores = score_answer(Answer({"x": parse(found)}), DECAY, measure(DECAY, CLEAN))
    assert (scores.exact, scores.is_law) == (exact, law)
    assert scores.constants_off == pytest.approx(off, abs=1e-9)


def test_scores_of_another_rate_are_what_closed_forms_give():
    """R2 of exp(-t/2) held against exp(-0.7 t), from both starts, and the share of the slopes."""
    measured = measure(DECAY, CLEAN)
    scores = score_answer(Answer({"x": parse("-0.5*x")}), DECAY, measured)
    t = measured.data.t
    wanted = r2_score(np.exp(-0.7 * t), np.exp(-0.5 * t))
    assert scores.reproduced == pytest.approx(wanted, rel=1e-6)
    assert scores.unseen == pytest.approx(wanted, rel=1e-6)
    assert scores.slopes_off == pytest.approx(0.2 / 0.7, rel=1e-6)


def test_intervals_are_held_against_the_constants_of_the_form_that_was_found():
    """0.7 x (1 - x/7) in another form has other constants; the intervals are held against these."""
    logistic = replace(DECAY, equations={"x": "0.7*x*(1 - x/7)"}, starts=((0.5,), (9.0,)))
    form = parse("x*(0.71 - 0.098*x)")
    for widths, covered in (((0.02, 0.004), 2), ((0.02, 0.001), 1), ((0.001, 0.001), 0)):
        floats = [0.71, -0.098] if str(form).startswith("x*(0.71") else [-0.098, 0.71]
        pairs = dict(zip((0.71, -0.098), widths, strict=True))
        intervals = [(v, v - pairs[v], v + pairs[v]) for v in floats]
        answer = Answer({"x": form}, intervals={"x": (form, intervals)})
        scores = score_answer(answer, logistic, measure(logistic, NOISY))
        assert (scores.covered, scores.constants) == (covered, 2)


@pytest.mark.slow
@pytest.mark.parametrize("animal", ZOO, ids=lambda animal: animal.name)
def test_every_law_is_exact_in_its_own_and_in_its_opened_form(animal):
    """The truth, its products multiplied out and its numbers as floats, scores as exact."""
    opened = {
        s: sympy.N(sympy.expand(e))
        for s, e in zip(animal.system.states, animal.system.rhs, strict=True)
    }
    scores = score_answer(Answer(opened), animal, integrated(animal.name))
    assert scores.exact and scores.constants_off < 1e-6 and scores.unseen > 0.9999


def test_logarithms_and_powers_are_written_alike():
    """A log of a quotient is a difference, and a power of 1.312 that of 1.3."""
    x = sympy.Symbol("x")
    assert plain_form(sympy.log(x / 2)) == plain_form(sympy.log(x) - sympy.log(2))
    assert plain_form(x**1.312) == plain_form(x**1.29)


def fake_truth(data, seed):
    """Know the law of DECAY, and say so."""
    return Answer({"x": parse("-0.7*x")}, "law")


def fake_boast(data, seed):
    """Call a law what is none."""
    return Answer({"x": parse("-0.2*x**2")}, "law")


def fake_fault(data, seed):
    """Fail."""
    raise ValueError("no luck\ntoday")


FAKES = {"truth": fake_truth, "boast": fake_boast, "fault": fake_fault}


@pytest.mark.slow
def test_cases_are_kept_and_faults_do_not_spread(tmp_path):
    """Each method has its case; one that raises is told; a second call reads what is there."""
    draw = partial(draw_conditions, levels=[0.0, 0.05])
    records = run_zoo([DECAY], FAKES, draw, out=tmp_path)
    assert len(records) == 9 and len(list((tmp_path / "records").iterdir())) == 9
    assert [r.method for r in records if r.exact] == ["truth"] * 3
    assert {r.failure for r in records if r.failure} == {"ValueError: no luck today"}
    assert run_zoo([DECAY], FAKES, draw, out=tmp_path) == records
    assert run_zoo([DECAY], {"truth": fake_truth}, draw, jobs=2)[0].equations == {"x": "-0.7*x"}
    with pytest.raises(InputError, match="holds results with seed 0, not 1"):
        run_zoo([DECAY], FAKES, draw, seed=1, out=tmp_path)


def fake_nonsense(data, seed):
    """Give what is no formula."""
    return Answer({"x": "nonsense"})


def test_an_answer_that_is_no_formula_is_told():
    """What cannot be scored counts as not found, with the reason."""
    (record,) = run_zoo([DECAY], {"nonsense": fake_nonsense}, lambda name: [CLEAN])
    assert record.failure.startswith("cannot be scored") and record.reproduced == -1


def test_the_tables_count_cases():
    """Shares are of cases, verdicts of those that gave one, and intervals of noisy cases."""
    records = run_zoo([DECAY], FAKES, partial(draw_conditions, levels=[0.0, 0.05]))
    records[3] = replace(records[3], covered=3, constants=4)
    by = {
        row[:2]: dict(zip(score_table(records).columns, row, strict=True))
        for row in score_table(records).rows
    }
    assert by[5.0, "truth"]["cases"] == 2 and by[5.0, "truth"]["law exact (%)"] == 100
    assert by[5.0, "truth"]["intervals right (%)"] == 75
    assert by[0.0, "fault"]["failed"] == 1 and by[0.0, "fault"]["R2 > 0.9 (%)"] == 0
    said = {(r[0], r[1]): r[2:] for r in verdict_table(records).rows}
    assert said[5.0, "truth"] == ("law", 2, 2, 100.0) and said[5.0, "boast"] == ("law", 2, 0, 0.0)
    assert (5.0, "fault") not in said


@pytest.mark.parametrize(
    ("verdict", "reproduced", "is_law", "right"),
    [
        ("law", 1.0, True, True),
        ("law", 1.0, False, False),
        ("approximation", 0.95, False, None),
        ("approximation", 0.5, False, None),
        ("not found", 0.5, False, True),
        ("not found", 0.95, False, False),
        ("", 0.95, True, None),
    ],
)
def test_a_verdict_is_right_by_the_truth(verdict, reproduced, is_law, right):
    """A law is the law, what is not found does not follow, and an approximation claims nothing."""
    (record,) = run_zoo([DECAY], {"truth": fake_truth}, lambda name: [CLEAN])
    changed = replace(record, verdict=verdict, reproduced=reproduced, is_law=is_law)
    assert isinstance(record, ZooRecord) and changed.right is right


@pytest.mark.slow
@pytest.mark.parametrize("alternative", [answer_stlsq, answer_weak])
def test_a_rival_finds_a_polynomial_law_in_clean_data(alternative):
    """Both forms of pysindy find the logistic law, and the same again."""
    pytest.importorskip("pysindy")
    (animal,) = find_animals(["logistic"])
    measured = measure(animal, Condition(0.0, "clean", 100, False))
    answer = alternative(measured.data, 0)
    scores = score_answer(answer, animal, measured)
    assert scores.exact and scores.constants_off < 1e-3 and scores.unseen > 0.999
    assert alternative(measured.data, 0).equations == answer.equations


@pytest.mark.slow
def test_dynsr_answers_with_intervals():
    """The discovery's equations come with an interval for each constant of the form."""
    measured = measure(DECAY, NOISY)
    few = RationalSearch(costs=(2,), max_terms=2, rounds=1)
    answer = answer_dynsr(measured.data, preset="quick", method=few)
    (form, intervals) = answer.intervals["x"]
    assert len(intervals) == 1 and intervals[0][1] < intervals[0][0] < intervals[0][2]
    assert form.free_symbols == {sympy.Symbol("x")}


def test_an_unknown_competitor_is_refused():
    """Who is not there is told with those who are."""
    with pytest.raises(InputError, match="unknown competitor 'me'; they are: dynsr, stlsq, weak"):
        make_methods(["me"])


SUITE = [
    {"id": 1, "dim": 1, "init": [[2.0], [5.0]], "substituted": [["-0.7*x_0"]], "eq": "c_0*x_0"},
    {"id": 2, "init": [[1, 2], [2, 1]], "substituted": ["x_1", "-x_0 - 0.3*x_1**3"], "dim": 2},
]


def write(path, entries):
    """Write a suite."""
    path.write_text(json.dumps(entries), encoding="utf-8")
    return path


def test_a_suite_in_the_public_layout_is_read(tmp_path):
    """Lists of lists and plain lists give the systems that are written there."""
    one, two = read_suite(write(tmp_path / "s.json", SUITE), span=4.0)
    assert one.system.equations() == {"x_0": "-0.7*x_0"} and one.starts == ((2.0,), (5.0,))
    assert one.span == 4.0 and two.system.equations()["x_1"] == "-x_0 - 0.3*x_1**3"
    assert [a.name for a in read_suite(tmp_path / "s.json", ["2"])] == ["2"]
    (alone,) = read_suite(write(tmp_path / "t.json", [{**SUITE[0], "init": [2.0]}]))
    (record,) = run_zoo([alone], {"truth": _names_x0}, lambda name: [CLEAN])
    assert record.reproduced > 0.999 and record.unseen == np.inf
    assert score_table([record]).rows[0][5:7] == (None, None)


def _names_x0(data, seed):
    return Answer({"x_0": parse("-0.7*x_0")})


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({}, "has no systems"),
        ([3], "entry 1 of the suite has no id"),
        ([{"id": 1}], "has no right-hand sides in 'substituted'"),
        ([{**SUITE[0], "substituted": [[]]}], "has no right-hand sides in 'substituted'"),
        ([{**SUITE[0], "dim": 2}], "has dim 2 but 1 equations"),
        ([{**SUITE[0], "init": [[1.0, 2.0]]}], "must be lists of 1 finite numbers"),
        ([{**SUITE[0], "init": [["a"]]}], "must be lists of 1 finite numbers"),
        ([SUITE[0], SUITE[0]], "has an id twice"),
        ([{**SUITE[0], "substituted": [["__import__('os')"]]}], "system '1' of the suite: "),
        ([{**SUITE[0], "substituted": [["y*2"]]}], "unknown name 'y'"),
        ([{**SUITE[0], "substituted": [["9**9**9**9"]]}], "beyond what float64 holds"),
    ],
)
def test_a_bad_suite_is_told_in_one_line(tmp_path, entries, words):
    """Whatever is wrong with a file is one line on stderr, and exit code 2."""
    told = run("benchmark", str(write(tmp_path / "s.json", entries)), code=2).stderr
    assert words in told and len(told.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_command_runs_a_suite(tmp_path):
    """A suite goes through discovery and scores; every case and the tables stand in the JSON."""
    path = write(tmp_path / "s.json", SUITE[:1])
    words = ("--method", "rational", "--preset", "quick", "--rows", "60", "-j", "1", "--json", "-q")
    found = json.loads(run("benchmark", str(path), *words, "-o", str(tmp_path / "out")).stdout)
    (case,) = found["cases"]
    assert case["exact"] and case["rows"] == 60 and case["unseen"] > 0.999
    assert found["zoo"][0]["unseen > 0.9 (%)"] == 100


@pytest.mark.slow
def test_the_script_writes_the_tables_into_the_page(tmp_path, monkeypatch):
    """What was measured replaces what stood between the marks of docs/zoo.md, and nothing else."""
    pytest.importorskip("pysindy")
    page = tmp_path / "zoo.md"
    page.write_text((ROOT / "docs" / "zoo.md").read_text(encoding="utf-8"), encoding="utf-8")
    head, _, rest = page.read_text(encoding="utf-8").partition("<!-- measured -->")
    tail = rest.partition("<!-- end of measured -->")[2]
    words = ["zoo.py", "enzyme", "--noise", "0.05", "--methods", "weak", "--jobs", "1"]
    words += ["--out", str(tmp_path / "out"), "--page", str(page)]
    monkeypatch.setattr(sys, "argv", words)
    script = runpy.run_path(str(ROOT / "scripts" / "benches" / "zoo.py"))
    for _ in range(2):
        script["main"]()
        text = page.read_text(encoding="utf-8")
        # Once for all noise, and once for each kind of it.
        assert text.count("| 5 | weak | 2 |") == 1 and text.count("| 5 | weak | 1 |") == 2
        assert text.startswith(head) and text.endswith(tail)
    assert (tmp_path / "out" / "zoo-cases.csv").read_text().count("enzyme,seen,weak") == 2
