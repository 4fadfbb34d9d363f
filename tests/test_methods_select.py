"""The registry: each method and preset once, read by the API, the command line and its help."""

import json
import subprocess
import sys
from inspect import signature

import numpy as np
import pytest
from command_line import run

import dynsr
from dynsr.data.samples import Samples
from dynsr.data.system import LORENZ, PENDULUM, System
from dynsr.discovery.estimator import DynsrRegressor
from dynsr.errors import InputError
from dynsr.methods.registry import (
    DEFAULT_PRESET,
    METHODS,
    PAPER_METHODS,
    PRESETS,
    choose_methods,
    find_method,
    make_method,
)
from dynsr.paper.protocol import paper_method

EVERY = pytest.mark.parametrize("name", METHODS)


def test_a_method_is_made_by_each_of_its_names():
    """The four methods are made by name, the genetic one by its alias too, as one of a kind."""
    assert list(METHODS) == ["rational", "sindy", "dynaifeynman", "genetic"]
    assert make_method("ga", "paper") == make_method("genetic", "paper")
    assert choose_methods(["ga", "genetic"]) == {"genetic": make_method("genetic")}


@EVERY
def test_an_entry_is_true(name):
    """An entry's class goes by its name, has all presets and no other, and a line for the help."""
    entry = METHODS[name]
    assert entry.load().name == name == make_method(name).name
    assert list(entry.presets) == list(entry.load().presets) == list(PRESETS)
    assert entry.description and all(entry.presets.values())
    assert getattr(dynsr, entry.class_name) is entry.load()


@EVERY
def test_one_default_preset(name):
    """What names no preset gets the one default, in the API, the estimator and the shell."""
    assert make_method(name) == make_method(name, DEFAULT_PRESET)
    assert choose_methods(name) == {name: make_method(name, DEFAULT_PRESET)}
    assert DynsrRegressor().preset == DEFAULT_PRESET
    assert signature(dynsr.discover).parameters["preset"].default == DEFAULT_PRESET


def test_changes_replace_single_settings():
    """A preset with one setting changed keeps the others; an unknown one is refused."""
    method = make_method("dynaifeynman", "paper", epochs=3)
    assert (method.epochs, method.selection) == (3, "lowest error")
    with pytest.raises(InputError, match="GeneticAlgorithm has no setting 'speed'; it has: bits"):
        make_method("ga", speed=1)


@pytest.mark.parametrize("command", ["discover", "benchmark"])
def test_the_help_lists_what_the_registry_holds(command):
    """Every method with its aliases and every preset stand in the help of a search."""
    words = run(command, "--help").stdout
    for entry in METHODS.values():
        assert all(name in words for name in (entry.name, *entry.aliases))
    assert all(f"{preset}:" in words for preset in PRESETS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("eureqa",),
            "unknown method 'eureqa'; the methods are: "
            "auto, rational, sindy, dynaifeynman, genetic \\(ga\\)",
        ),
        (("ga", "worst"), "unknown preset 'worst'; the presets are: best, quick, paper"),
    ],
)
def test_unknown_names_are_refused(arguments, message):
    """One line names what is unknown and what there is."""
    with pytest.raises(InputError, match=message):
        make_method(*arguments)
    with pytest.raises(InputError, match=message):
        choose_methods(*arguments)


def test_two_methods_of_one_name_are_refused():
    """Two SINDy with different settings would be one in the results; the message says so."""
    two = [make_method("sindy"), make_method("sindy", "paper")]
    with pytest.raises(InputError, match="two methods are called 'sindy'"):
        choose_methods(two)
    with pytest.raises(InputError, match="no method was given; use 'auto'"):
        choose_methods([])


def test_the_papers_settings_belong_to_the_papers_systems():
    """Table 2 goes with the catalogue's pendulum, not with a user's system of that name."""
    assert paper_method("ga", PENDULUM).iterations == 40
    assert paper_method("ga", PENDULUM, quick=True).iterations == 4
    own = System.from_strings({"x": "-x"}, name="pendulum")
    assert paper_method("ga", own) == make_method("ga", "paper")
    with pytest.raises(InputError, match="no paper settings for 'pendulum'"):
        paper_method("sindy", own)
    with pytest.raises(
        InputError, match="unknown method 'rational' of the paper; the methods are: dyn"
    ):
        paper_method("rational", LORENZ)
    assert [find_method(name).name for name in PAPER_METHODS] == [
        "dynaifeynman",
        "genetic",
        "sindy",
    ]


def test_the_papers_sindy_runs_on_data_of_ones_own():
    """Without a library chosen by hand the grown one stands in; what is found is a ratio or none.

    The relation dx = -x holds among the functions, so the implicit search of 2021 has an answer.
    """
    t = np.linspace(0.0, 2.0, 201)
    x = np.exp(-t)
    samples = Samples(x[:, None], -x, ("x",), "x", "given", t)
    method = make_method("sindy", "paper")
    assert method.implicit and method.release == "2021"
    front = method.search(samples, np.random.default_rng(0))
    assert all(np.isfinite(c.loss) for c in front)


@pytest.mark.slow
def test_a_choice_loads_only_what_it_chose():
    """To name the methods loads no numbers; to make a GA loads neither torch nor SINDy."""
    code = (
        "import sys; from dynsr.methods.registry import find_method, make_method;"
        "find_method('ga'); early = 'numpy' in sys.modules; make_method('ga');"
        "sys.exit(early or 'torch' in sys.modules or 'dynsr.methods.sindy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.fixture(scope="module")
def as_published():
    """Discover decay, as data of a user's own, with the preset of the paper."""
    t = np.linspace(0.0, 3.0, 151)
    return dynsr.discover({"t": t, "x": 2 * np.exp(-0.5 * t)}, preset="paper", jobs=1)


@pytest.mark.slow
def test_the_preset_of_the_paper_works_on_data_of_ones_own(as_published):
    """With the default method it runs the paper's three, on forward differences, and finds decay.

    Forward differences over h see (exp(-h/2) - 1) / h in the place of -1/2; the constants are
    fitted to the states, which know better.
    """
    assert as_published.settings["methods"] == ["sindy", "dynaifeynman", "genetic"]
    assert as_published.settings["scheme"] == {"x": "forward"}
    assert str(as_published.equations["x"]) == "-0.5*x"


@pytest.mark.slow
def test_several_methods_by_commas(tmp_path):
    """What a report prints as its command is understood: --method takes names by commas."""
    path = tmp_path / "x.csv"
    t = np.linspace(0.0, 3.0, 151)
    path.write_text("t,x\n" + "".join(f"{a},{2 * np.exp(-0.5 * a)}\n" for a in t))
    words = ("--preset", "quick", "--functions", "none", "-j", 1, "-q", "--json")
    found = json.loads(run("discover", path, "--method", "rational,sindy", *words).stdout)
    assert found["settings"]["methods"] == ["rational", "sindy"]
    result = run("discover", path, "--method", "rational,eureqa", *words, code=2)
    assert "unknown method 'eureqa'" in result.stderr
