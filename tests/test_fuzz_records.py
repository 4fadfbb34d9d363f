"""Saved discoveries, changed at random: each is read and shown, or one line says why not.

``DYNSR_FUZZ_SEED`` draws others.
"""

import copy
import io
import json
import os
import random
import traceback

import numpy as np
import pytest
from rich.console import Console

import dynsr
from dynsr.cli.results import summarise
from dynsr.discovery.result import Discovery
from dynsr.errors import DynsrError
from dynsr.jobs import to_json
from dynsr.report.discovery import render_discovery

SEED = int(os.environ.get("DYNSR_FUZZ_SEED", "0"))
COUNT = 500
T = np.linspace(0, 6, 61)
ODD = [
    *(None, True, False, 0, -1, 1.5, 1e308, -1e308, 1e-320, 10**30, "", " ", "x", "law", "map"),
    *("\x1b[31m", "\u202e", "ééé", "x'", "nan", "inf", "1e999", "a" * 5000, "<script>", "x/0"),
    *("x**x**x", "flow", "q_dot", "embedded", "julia", "../x", "days", "s\nimport os", "None"),
    *([], {}, [[]], [None], {"x": None}, {"": 1}, [1, 2, 3], ["a"], {"x": {"x": {"x": 1}}}),
    [["x", 0.1, 3.0, "s"]],
]
NAMES = ["x", "t", "", "new", "callable", "a b", "__class__", "kind", "velocities"]


@pytest.fixture(scope="module")
def records():
    """Give the records of a flow with an ensemble, of a map, and of a flow of second order."""
    flow = np.column_stack([np.exp(-0.5 * T), np.exp(-0.5 * T) * (1 + T)])
    steps = np.array([0.3 * 0.9**i for i in range(40)])[:, None]
    swing = np.cos(1.3 * T)[:, None] + 0.01 * np.random.default_rng(0).normal(size=(61, 1))
    asked = {"preset": "quick", "jobs": 1, "method": "sindy"}
    found = [
        dynsr.discover(dynsr.Trajectory(T, flow, ("x", "y")), **asked, ensemble=3),
        dynsr.discover(dynsr.Trajectory(np.arange(40.0), steps, ("n",)), **asked, discrete=True),
        dynsr.discover(dynsr.Trajectory(T, swing, ("q",)), **asked, order=2, time_budget=4),
    ]
    return [json.loads(to_json(one.as_record())) for one in found]


def places(value, place=()):
    """Give where anything stands in a record."""
    yield place
    if isinstance(value, (dict, list)):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(part, (*place, key))


def change(record, draw):
    """Put something else in a place, take it out, name it otherwise, or copy another part there."""
    every = [place for place in places(record) if place]
    near = [place for place in every if len(place) < 4]
    place = draw.choice(every if draw.random() < 0.6 else near)
    inside = record
    for key in place[:-1]:
        inside = inside[key]
    key, other = place[-1], draw.choice(every)
    match draw.randrange(6):
        case 0:
            del inside[key]
        case 1 if isinstance(inside, dict):
            inside[draw.choice(NAMES)] = inside.pop(key)
        case 2:
            part = record
            for step in other:
                part = part[step]
            inside[key] = copy.deepcopy(part)
        case _:
            inside[key] = copy.deepcopy(draw.choice(ODD))


def use(path):
    """Read a record, show it in every way there is, and save it again."""
    found = Discovery.load(path)
    Console(file=io.StringIO(), width=80).print(found)
    _ = repr(found), found._repr_html_(), found._repr_latex_(), found.latex(), found.heading
    _ = found.to_python(), found.to_julia(), found.to_numpy(), found.constants
    if {"engine", "seed"} <= {*found.settings}:
        to_json(summarise(found))
    render_discovery(found)
    again = path.with_name("again.json")
    again.unlink(missing_ok=True)
    Discovery.load(found.save(again))


@pytest.mark.slow
def test_every_changed_record_is_shown_or_refused_in_one_line(records, tmp_path):
    """Whatever stands in a saved discovery, reading and showing it ends well or in one line."""
    draw, faults, path = random.Random(SEED), {}, tmp_path / "law.json"
    for number in range(COUNT):
        record = copy.deepcopy(draw.choice(records))
        for _ in range(draw.choice([1, 1, 1, 2, 3])):
            change(record, draw)
        path.write_text(json.dumps(record))
        try:
            use(path)
        except DynsrError as error:
            if "\n" in str(error):
                faults[number] = str(error)
        except Exception:
            faults[number] = traceback.format_exc()[-600:]
    assert not faults, faults
