"""Settings are read: each one that stands in the record of a discovery decides something."""

import ast
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dynsr
from dynsr.discovery.problem import DISCOVERY
from dynsr.expression import parse
from dynsr.fit import CollocationSettings, ProfileSettings
from dynsr.jobs import to_plain
from dynsr.library import LibrarySettings
from dynsr.selection.first_look import look
from dynsr.selection.hidden import HiddenSettings
from dynsr.selection.parts import Parts
from dynsr.verdict.levels import OtherFormula, StateVerdict, VerdictSettings, explain

SOURCE = Path(dynsr.__file__).parent
QUICK = {"preset": "quick", "jobs": 1, "progress": False}
# What the user says in keywords of `discover`, which put it there.
SAID = {"demands", "vocabulary", "must", "loss"}
# Read only in data that are steep, chaotic, dense or of one column, or whose law is missed in some
# way.
SELDOM = {
    "delays.library.alone",
    "hidden.aside",
    *(f"vary.{name}" for name in ("joint", "near", "step", "structures")),
    *(f"vary.library.{field.name}" for field in fields(LibrarySettings)),
    "profile.first",
    "profile.halvings",
    "slopes.calm",
    "slopes.told",
    "slopes.biased",
    "selection.comparison.evaluations",
    "selection.comparison.noisy",
    "selection.comparison.pieces",
    "selection.comparison.reproduces",
    "selection.comparison.proposals.library.alone",
    "selection.comparison.softness",
    "selection.fit.explained",
    "selection.fit.match_follows",
    "selection.fit.tie_bits",
    "selection.look.proposals.doubt",
    "selection.look.stands_out",
    "stochastic.proposals.doubt",
    "stochastic.proposals.library.alone",
    "stochastic.proposals.library.degree",
    "verdict.hopeless",
    "verdict.sharp",
}


def leaves(settings, path=()):
    """Give the path and the value of every setting."""
    for field in fields(settings):
        value = getattr(settings, field.name)
        if field.name in SAID:
            continue
        if is_dataclass(value):
            yield from leaves(value, (*path, field.name))
        else:
            yield (*path, field.name), value


def holder(path):
    """Give the settings that hold the one at a path."""
    settings = DISCOVERY
    for name in path[:-1]:
        settings = getattr(settings, name)
    return settings


def put(settings, path, value):
    """Give the settings with another value at a path."""
    first, *rest = path
    inner = put(getattr(settings, first), rest, value) if rest else value
    return replace(settings, **{first: inner})


def other(value):
    """Give another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + 1
    return (*value, *(value[:1] or ["citing"]))


def at(plain, path):
    """Give what stands at a path of a record."""
    for name in path:
        plain = plain[name]
    return plain


def watched(settings, seen, path=()):
    """Give the same settings; the paths of those that dynsr reads are added to ``seen``.

    Reads of what only writes or compares them, such as a record, are none.
    """
    kind = type(settings)
    names = {field.name for field in fields(kind)}

    def read(self, name):
        if name in names and (*path, name) not in seen:
            file = sys._getframe(1).f_code.co_filename
            if file.startswith(str(SOURCE)) and "jobs" not in Path(file).parts:
                seen.add((*path, name))
        return object.__getattribute__(self, name)

    found = object.__new__(type(kind.__name__, (kind,), {"__getattribute__": read}))
    for name in names:
        value = object.__getattribute__(settings, name)
        inner = watched(value, seen, (*path, name)) if is_dataclass(value) else value
        object.__setattr__(found, name, inner)
    return found


def rabbits(rows, noise=0.0, end=10.0):
    """Give a table of predator and prey with noise in shares of their size."""
    t = np.linspace(0, end, rows)
    truth = solve_ivp(
        lambda _, s: [1.5 * s[0] - s[0] * s[1], s[0] * s[1] - 3 * s[1]],
        (0, end),
        [1.0, 1.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    ).y
    x, y = truth * (1 + noise * np.random.default_rng(0).normal(size=truth.shape))
    return {"t": t, "x": x, "y": y}


def logistic_map():
    """Give sixty steps of the logistic map."""
    x = [0.3]
    for _ in range(60):
        x.append(3.7 * x[-1] * (1 - x[-1]))
    return {"t": np.arange(61.0), "x": np.array(x)}


def growth(noise=0.1):
    """Give one population that grows to its capacity, in noise."""
    t = np.linspace(0, 6, 40)
    noise = noise * np.random.default_rng(0).normal(size=40)
    return {"t": t, "x": 10 / (1 + 9 * np.exp(-t)) + noise}


def two_waves():
    """Give a state that no equation of first order has."""
    t = np.linspace(0, 12, 60)
    return {"t": t, "x": np.sin(t) * np.exp(-0.02 * t) + 0.3 * np.sin(2.2 * t)}


def oscillator_with_delay():
    """Give x' = -0.8 x(t - 1.6) at 81 rows, by the method of steps with Heun's rule."""
    step, back, x = 0.002, 800, [0.5] * 801
    for _ in range(8000):
        first, last = -0.8 * x[-back - 1], -0.8 * x[-back]
        x.append(x[-1] + step * (first + last) / 2)
    return dynsr.Trajectory(np.arange(81) * 0.2, np.array(x[back::100])[:, None], ("x",))


# Fewer delays are tried than usual; windows are cut from 60 rows; no parabola is one to the last
# digit; a hidden state is looked for in one way.
FEW_DELAYS = replace(DISCOVERY, delays=replace(DISCOVERY.delays, grid=13, minima=1))
NO_PARTS = replace(DISCOVERY.selection.comparison, parts=Parts(()))
FEW_COUPLINGS = replace(DISCOVERY, hidden=HiddenSettings(couplings=1, improved=1, rounds=1))
EVERYTHING = replace(
    DISCOVERY,
    selection=replace(DISCOVERY.selection, comparison=NO_PARTS),
    windows=replace(DISCOVERY.windows, above=50, rows=20),
    profile=ProfileSettings(parabola=1.0),
)


# Small discoveries that together pass through every part of a discovery.
def walking():
    """A state that chance moves, measured with small errors."""
    rng = np.random.default_rng(0)
    x = [1.0]
    for step in rng.standard_normal(300):
        x.append(0.9 * x[-1] + 0.2 * step)
    return {"t": 0.1 * np.arange(301.0), "x": np.array(x) + 0.05 * rng.standard_normal(301)}


DISCOVERIES = [
    (rabbits(200), DISCOVERY, {}),
    (rabbits(60, 0.03), EVERYTHING, {}),
    (rabbits(60, 0.03), DISCOVERY, {"known": {"x": "1.5*x"}, "method": "sindy"}),
    (logistic_map(), DISCOVERY, {"discrete": True}),
    (oscillator_with_delay(), FEW_DELAYS, {"delays": True, "method": "sindy"}),
    (two_waves(), FEW_COUPLINGS, {"hidden": "y"}),
    (rabbits(60, 0.03), DISCOVERY, {"known": {"x": "a*x - f(x)*y", "y": "x*y - 3*y"}}),
    ([growth(0.0)] * 2, DISCOVERY, {"vary": True, "method": "sindy"}),
    (walking(), DISCOVERY, {"stochastic": True}),
]


@pytest.mark.slow
def test_every_setting_stands_in_the_record():
    """Each of more than a hundred, changed, is another one in the record of a discovery."""
    paths = dict(leaves(DISCOVERY))
    assert len(paths) > 100
    plain = to_plain(dynsr.discover(rabbits(200), **QUICK).settings["details"])
    for path, value in paths.items():
        changed = to_plain(put(DISCOVERY, path, other(value)))
        assert at(changed, path) != at(plain, path), path


@pytest.mark.slow
def test_what_is_seldom_read_is_read_where_it_belongs():
    """The settings that small discoveries do not reach are read in the room that has them."""
    reads = {}
    for file in SOURCE.rglob("*.py"):
        room = file.relative_to(SOURCE).parts[0]
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                reads.setdefault(node.attr, set()).add(room)
    names = {".".join(path): path for path, _ in leaves(DISCOVERY)}
    assert names.keys() >= SELDOM
    for path in map(names.get, SELDOM):
        room = type(holder(path)).__module__.split(".")[1]
        assert room in reads[path[-1]], path


@pytest.mark.slow
def test_every_setting_is_read():
    """A setting that no part of some small discoveries reads should be gone."""
    seen = set()
    for data, settings, options in DISCOVERIES:
        dynsr.discover(data, settings=watched(settings, seen), **QUICK, **options)
    unread = {".".join(path) for path, _ in leaves(DISCOVERY) if path not in seen}
    assert unread - SELDOM == set()


def test_the_words_keep_to_the_bits_of_the_verdict():
    """A formula 20 bits behind does as well where a law must lead by 40, and not where by 8."""
    own = StateVerdict("law", "it follows.", 1.0, alternatives=(OtherFormula("2*x", 20.0),))
    assert explain("x", parse("x"), own).endswith("follows the data clearly worse.")
    strict = VerdictSettings(alternative_bits=40.0)
    assert explain("x", parse("x"), own, settings=strict).endswith("does as well.")


@pytest.mark.slow
def test_the_first_look_writes_constants_as_the_fit_says():
    """Without simple numbers the first look gives constants as fitted, of the same law."""
    samples = dynsr.data.choose_samples(
        dynsr.Trajectory(*[(d := rabbits(200))["t"], np.stack([d["x"], d["y"]], 1)], ("x", "y")),
        "x",
    )
    simple = look(samples)
    plain = look(samples, fit=replace(DISCOVERY.selection.fit, snap=False))
    assert simple.final and plain.final
    assert str(simple.candidates[0].expr) == "-x*y + 3*x/2"
    first = plain.candidates[0].expr
    assert len(first.atoms(parse("0.5").func)) == 2
    assert float(first.coeff(parse("x")).subs({"y": 0})) == pytest.approx(1.5, abs=1e-5)


@pytest.mark.slow
def test_settings_change_results_in_noise():
    """In noise the alternatives and the last fit follow their settings."""
    data = growth(0.03)
    usual = DISCOVERY.selection
    plain = dynsr.discover(data, **QUICK)

    def with_selection(**changes):
        settings = replace(DISCOVERY, selection=replace(usual, **changes))
        return dynsr.discover(data, settings=settings, **QUICK)

    far = with_selection(comparison=replace(usual.comparison, apart=50.0))
    assert plain.verdict.alternatives["x"] and not far.verdict.alternatives["x"]
    short = CollocationSettings(stiffness=(1.0,), steps=1)
    assert with_selection(fit=replace(usual.fit, along=short)).fitted != plain.fitted
