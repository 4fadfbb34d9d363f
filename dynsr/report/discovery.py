"""The report of one discovery: a single HTML page that needs no network."""

from __future__ import annotations

import itertools
import math
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from time import monotonic
from typing import Any
from urllib.parse import quote as quote_url

import numpy as np
import sympy

from dynsr import __version__
from dynsr.data import (
    Samples,
    Trajectory,
    check_replaceable,
    choose_samples,
    is_own_page,
    write_page,
)
from dynsr.discovery import DISCOVERY, Discovery, name_windows
from dynsr.engines import DEFAULT_ENGINE, FixedPoint
from dynsr.errors import DynsrError, InputError
from dynsr.export import Source, list_formats, pack_format
from dynsr.expression import (
    arguments_of,
    complexity,
    counting,
    evaluate,
    free_constants,
    left_of,
    shown,
    to_mathml,
    write_line,
)
from dynsr.fit import (
    Candidate,
    ParetoFront,
    is_noisy,
    loosen,
    rmse,
)
from dynsr.jobs import finish_by, to_plain
from dynsr.methods import choose_methods
from dynsr.parameters import FreePart, Parameter, cells_of
from dynsr.report.page import Picture, render_page
from dynsr.report.plots import (
    MOST_DOTS,
    draw_free,
    draw_phase_portrait,
    draw_profiles,
    draw_residuals,
    draw_slopes,
    draw_states,
    draw_steps,
)
from dynsr.report.tables import Table
from dynsr.verdict import StateVerdict, pair_rows, write_map_mathml

HEIGHT = 220.0
_HEADINGS = {
    "law": "Equations found",
    "approximation": "An approximation",
    "not found": "Equations not found",
    "": "Equations",
}
# Level of an equation whose reason is at the top -> what its folded reason is called.
_FOLDED = {
    "law": "Why it is a law",
    "approximation": "Why it is an approximation",
    "not found": "Why it is not found",
}
_SMALLEST = 1e-16
# A loss is smaller than another where it is less than this share of it; polishing moves them a bit.
_CLEARLY = 0.99
_MOST_FORMULAS = 5
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Dot:
    """One formula of a front: its place, its text, what it costs, and whether it was chosen."""

    x: float
    y: float
    formula: str
    detail: str
    chosen: bool
    candidate: Candidate


@dataclass(frozen=True)
class Chart:
    """A front as it is drawn.

    ``rows`` and ``columns`` are (place, label) of the ticks; ``steps`` are (x1, y1, x2, y2) of the
    line that no formula is below; ``note`` says what is special about the chosen formula.
    """

    dots: tuple[Dot, ...]
    rows: tuple[tuple[float, str], ...]
    columns: tuple[tuple[float, str], ...]
    steps: tuple[tuple[float, float, float, float], ...]
    note: str = ""


def place_front(front: ParetoFront, chosen: Candidate | str) -> Chart:
    """Place a front over description length (across) and the logarithm of the loss (down).

    Parameters
    ----------
    front : its losses in state units per second, its complexities in bits.
    chosen : the text of the equation that was chosen, or a candidate, which is drawn even where
        the front does not hold it.

    >>> import sympy
    >>> x = sympy.Symbol("x")
    >>> front = ParetoFront([Candidate(x, 1.0, 2.0), Candidate(2 * x, 0.1, 4.0)])
    >>> chart = place_front(front, "2*x")
    >>> [(dot.x, dot.y, dot.chosen) for dot in chart.dots]
    [(50.0, 0.0, False), (100.0, 220.0, True)]
    >>> chart.columns
    ((0.0, '0'), (25.0, '1'), (50.0, '2'), (75.0, '3'), (100.0, '4'))
    """
    text = chosen if isinstance(chosen, str) else shown(chosen.expr)
    some, line, note = list(front), front, ""
    if isinstance(chosen, Candidate) and all(shown(c.expr) != text for c in some):
        some = sorted([*some, chosen], key=lambda c: (c.complexity, -c.loss))
        line, note = ParetoFront(some), _note_of(front, chosen)
    logs = [math.log10(max(c.loss, _SMALLEST)) for c in some] or [0.0]
    low, high = math.floor(min(logs)), max(math.ceil(max(logs)), math.floor(min(logs)) + 1)
    bits = _ticks(max((c.complexity for c in some), default=1.0))

    def place(candidate: Candidate) -> tuple[float, float]:
        height = (high - math.log10(max(candidate.loss, _SMALLEST))) / (high - low)
        return round(100 * candidate.complexity / bits[-1], 2), round(HEIGHT * height, 1)

    every = math.ceil((high - low) / _MOST_FORMULAS)
    return Chart(
        tuple(Dot(*place(c), shown(c.expr), _cost(c), shown(c.expr) == text, c) for c in some),
        tuple(
            (round(HEIGHT * (high - power) / (high - low), 1), "10" + str(power).translate(_RAISED))
            for power in range(high, low - 1, -every)
        ),
        tuple((round(100 * b / bits[-1], 2), f"{b:g}") for b in bits),
        tuple(_steps([place(c) for c in line])),
        note,
    )


def _note_of(front: ParetoFront, chosen: Candidate) -> str:
    """Say why a chosen formula is not one of those that the search found."""
    near = [c for c in front if c.complexity <= chosen.complexity]
    below = [c for c in near if c.loss < _CLEARLY * chosen.loss]
    if below:
        best = min(below, key=lambda c: c.loss)
        return (
            f"The chosen formula is above the front: {shown(best.expr)} is no longer and misses"
            f" the slopes less ({_cost(best)}). Slopes alone do not decide. Formulas are"
            " compared on whole trajectories, and constants are fitted to the states."
        )
    return (
        "The constants of the chosen formula were fitted to the states after the search. Those of"
        " the others are as the search fitted them to the slopes."
    )


def _cost(candidate: Candidate) -> str:
    source = f", found by {candidate.source}" if candidate.source else ""
    bits = f"{candidate.complexity:.0f} bit" + "s" * (round(candidate.complexity) != 1)
    return f"{bits}, RMSE {candidate.loss:.3g}{source}"


def _steps(places: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float, float, float]]:
    for (x1, y1), (x2, y2) in itertools.pairwise(places):
        yield x1, y1, x2, y1
        yield x2, y1, x2, y2


def _ticks(largest: float) -> list[float]:
    """Give round numbers from 0 to the first that is not below the largest, at most six of them."""
    power = 10.0 ** math.floor(math.log10(max(largest, 1.0)))
    step = next(s for s in (0.1, 0.2, 0.25, 0.5, 1, 2) if largest <= 5 * s * power) * power
    return [k * step for k in range(max(1, math.ceil(largest / step - 1e-9)) + 1)]


# What gave the chosen formula its constants.
_FITTED = "the fit to the states"
_MOST_RUNS = 3
_MOST_PROFILES = 12
# A page is waited for. What takes longer has a command of its own.
_SECONDS_TO_SUGGEST = 10.0
_CURVE_ROWS = 21
_ROUNDED = " Fitted: the number before it was made a simple one."
_PROFILED = " Where the standard error is wrong, the interval is that of the profile likelihood."
_MOST_ROWS = 2000
_MOST_STEPS = 200
# Is it a map? -> what was done with the equations.
_FOLLOWED = {
    False: "integrated from the first row. The band contains 95 % of the curves that "
    "constants drawn within their errors give.",
    True: "iterated from the first row.",
}
# Settings that are shown by themselves, or that only a program reads.
_TOLD_ELSEWHERE = ("version", "seed", "columns", "table", "details")
_TARGETS = {False: "slopes", True: "next values"}
_DRAWS = 20
# How finely a constant goes from half its value to twice that, and the states of what is followed.
_BRANCH_STEPS = 17
_MOST_FOLLOWED = 4
# Share of a constant below which its error moves no curve that is drawn.
_INVISIBLE = 1e-6


Bands = dict[str, tuple[np.ndarray, np.ndarray]]


def write_report(found: Discovery, path: Path) -> Path:
    """Write the page of a discovery and give its path.

    Parameters
    ----------
    found : the discovery; one that was loaded has no data, and its page no pictures.
    path : the file to write; folders above it are made.

    Raises InputError when it cannot be written, or a file that is no page of dynsr is there.
    """
    check_replaceable(path, is_own_page)
    write_page(path, render_discovery(found))
    return path


def render_discovery(found: Discovery) -> str:
    """Give the page: equations, reasons, interactive fronts, trajectories, residuals, phases.

    Pictures need the data, which a loaded discovery does not have; the rest is always there.
    """
    samples, latex = _samples(found), found.latex()
    refused = found.verdict.tested and found.verdict.level == "not found"
    return render_page(
        "discovery.html.j2",
        heading=_HEADINGS[found.verdict.level if found.verdict.tested else ""],
        verdict=found.heading,
        level=(found.verdict.level if found.verdict.tested else "none").replace(" ", "-"),
        verdicts=_verdicts(found),
        ensemble=_ensemble(found),
        profiles=list(_profiles(found)),
        known=_known(found),
        suggestion=_suggestion(found),
        summary=_summary(found),
        equations=[_equation(found, state) for state in found.equations],
        constants=_constants(found),
        by_run=list_by_run(found),
        free=found.free.sentences,
        free_pictures=_free(found),
        noise=list(found.noise_notes.values()),
        steps=[picture] if (picture := show_noise(found)) else [],
        free_tables=[_values(part) for part in found.free.curves.values()],
        fronts={
            state: _front(found, state, samples.get(state))
            for state in found.equations
            if state not in {**found.hidden, **dict.fromkeys(found.free.states), **found.diffusion}
        },
        trajectories=list(_trajectories(found)),
        # What the data refuse has no fixed points that anybody needs.
        fixed=None if refused else _fixed_points(found),
        flow=[
            picture
            for draw in (show_flow, show_branches)
            if not refused and (picture := draw(found))
        ],
        refused=refused,
        left_out=max(0, len(found.trajectories) - _MOST_RUNS),
        left=left_of("", found.is_map),
        targets=_TARGETS[found.is_map],
        slopes=[picture for state in samples for picture in _slopes(found, samples[state])],
        scores=_scores(found),
        exports=[("LaTeX", latex), ("Python", found.to_python()), ("Julia", found.to_julia())],
        formats=list(_formats(found)),
        facts=_facts(found),
        settings=_settings(found),
    )


def _samples(found: Discovery) -> dict[str, tuple[Samples, np.ndarray]]:
    """Give for each state its slopes, and what its equation says they are."""
    pairs = {}
    # Where the motion has noise, no curve of a state has a slope.
    sloped = found.trajectories and not found.diffusion
    for state, expr in found.equations.items() if sloped else ():
        if state in found.hidden:
            continue
        samples = _slopes_of(found, state)
        pairs[state] = samples, evaluate(expr, samples.timed)
    return pairs


def _slopes_of(found: Discovery, state: str) -> Samples:
    """Make the slopes as the discovery did; the user's own are not kept, so the data choose."""
    runs = list(found.trajectories)
    if found.is_map:
        return pair_rows(runs, state)
    chosen = choose_samples(runs, state)
    scheme = found.settings.get("scheme", {}).get(state, chosen.scheme)
    if scheme == chosen.scheme:
        return chosen
    try:
        return choose_samples(runs, state, scheme=scheme)
    except (InputError, ValueError):
        return chosen


def _summary(found: Discovery) -> str:
    states = ", ".join(found.equations)
    known = f"{len(found.equations)} equation{'s' * (len(found.equations) > 1)}, for {states}"
    if not found.trajectories:
        return f"{known}. The data are not in this report: it was made from a saved discovery."
    rows, count = sum(len(run) for run in found.trajectories), len(found.trajectories)
    start, end = found.trajectories[0].t[[0, -1]]
    unit = f" {found.time_unit}" if found.time_unit else ""
    over = f"from t = {start:g} to {end:g}{unit}" if count == 1 else f"in {count} trajectories"
    if windows := name_windows(found.settings):
        return f"{known}, found on {windows}. These {rows} rows are the data of this report."
    return f"{known}, from {rows} rows {over}."


def _is_said(found: Discovery, own: StateVerdict) -> bool:
    """Whether the line at the top gives the reason already, as it does for all laws."""
    return own.level == "law" or own.reason in found.heading


def _equation(found: Discovery, state: str) -> dict[str, Any]:
    expr = found.equations[state]
    text = write_line(state, expr, found.is_map)
    why, own = found.explanation.get(state, ""), found.verdict.states.get(state)
    if why.startswith(f"{text}: "):
        why = why.removeprefix(f"{text}: ")
        why = why[:1].upper() + why[1:]
    return {
        "state": state,
        "text": text,
        "mathml": (write_map_mathml if found.is_map else to_mathml)(expr, state),
        "why": why,
        "level": own.level.replace(" ", "-") if own else "",
        "folded": _FOLDED[own.level] if own and _is_said(found, own) else "",
        "details": found.details.get(state, ""),
    }


def _is_doubtful(found: Discovery) -> bool:
    """Whether noise leaves a doubt of constants and alternatives; exact data leave none."""
    judged = found.verdict.tested and found.verdict.level != "not found"
    noisy = judged and bool(found.trajectories) and not found.is_map
    return noisy and is_noisy(found.measured)


def _suggestion(found: Discovery) -> Table | None:
    """Give the experiments that distinguish the answer best from its alternatives.

    A law has none; to find the experiment that bounds its constants best would take longer than
    many a search.
    """
    if not _is_doubtful(found) or found.verdict.level == "law":
        return None
    try:
        made, late = finish_by(monotonic() + _SECONDS_TO_SUGGEST, found.suggest, lambda: None)
    except DynsrError:  # too few rows, or not to be followed
        return None
    if late or made is None:
        how = ("found.suggest(), or dynsr suggest with the folder of the discovery",)
        note = "To find the experiment that distinguishes formulas takes longer than this report."
        return Table("suggestion", "The next experiment", ("how to find it",), (how,), note)
    note = (
        f"{made.heading} Each has {made.size}. A bit is a factor of two in how likely one is "
        "against the other, as is expected before the experiment is made."
    )
    rows = tuple(made.table())
    return Table("suggestion", "The next experiment", made.columns, rows, note)


def _profiles(found: Discovery) -> Iterator[Picture]:
    """Draw the profile likelihoods of constants in noise."""
    if not _is_doubtful(found):
        return
    try:
        every = found.profiles()
    except InputError:  # too few rows, or not to be followed
        return
    some = every[:_MOST_PROFILES]
    left_out = f" The first {len(some)} of {len(every)} are drawn." if some != every else ""
    # Two in a picture, so that pictures fill a page of any width.
    for first in range(0, len(some), 2):
        pair = some[first : first + 2]
        names = " and ".join(f"{own.of} in {own.state}'" for own in pair)
        last = first + len(pair) == len(some)
        yield Picture.of(draw_profiles(pair), f"Constant of {names}.{left_out if last else ''}")


def _known(found: Discovery) -> str:
    """Say which parameters are known where some are not; nothing where all are.

    Exact data leave no doubt, and to find that out would take longer than many a search.
    """
    if not _is_doubtful(found) or not any(found.constants.values()):
        return ""
    try:
        known = found.identifiability()
    except InputError:  # too few rows, or not to be followed
        return ""
    return " ".join(known.sentences) if known.unknown or known.weak else ""


def _constants(found: Discovery) -> Table | None:
    """Give the constants as parameters with names, each once; None without any."""
    system = found.system
    if not found.parameters.rows():
        return None
    lines = "; ".join(
        write_line(state, e, found.is_map, first=system.parameters)
        for state, e in system.equations.items()
    )
    rows = [
        (
            *(name, value, interval, _fitted(found, found.parameters[name]), error, unit),
            of.replace("'", left_of("", found.is_map)),
        )
        for name, value, error, interval, unit, of in found.parameters.rows()
    ]
    head = ("Name", "Value", "95 % interval", "Fitted", "Standard error", "Unit", "Constant of")
    kept = [i for i in range(len(head)) if any(row[i] for row in rows)]
    profiled = any(c.profiled for own in found.constants.values() for c in own)
    return Table(
        "constants",
        "Each constant with its 95 % interval",
        tuple(head[i] for i in kept),
        tuple(tuple(row[i] for i in kept) for row in rows),
        f"In these names: {lines}.{_ROUNDED if 3 in kept else ''}{_PROFILED if profiled else ''}",
    )


def _free(found: Discovery) -> list[Picture]:
    """Draw the free functions of known equations."""
    parts = list(found.free.parts.values())
    words = (
        "Each free function: the fitted curve with its 95 % band, the formula where one was found, "
        "and the values that the slopes of the data give row by row."
    )
    return [Picture.of(draw_free(parts), words)] if parts else []


def _values(part: FreePart) -> Table:
    """Give the values of a function that stays a curve."""
    return Table(
        f"free-{part.name}",
        f"Values of {part.name}({part.of})",
        (part.of, part.name, "From", "To"),
        tuple(part.table(_CURVE_ROWS).itertuples(index=False, name=None)),
        "From, to: the 95 % band of the curve.",
    )


def list_by_run(found: Discovery) -> Table | None:
    """Give the parameters that differ from run to run; None where all are shared.

    Parameters
    ----------
    found : the discovery.
    """
    own = found.by_run
    if not own.constants:
        return None
    head = tuple(name[:1].upper() + name[1:] if name == "run" else name for name in own.head)
    return Table(
        "by-run",
        "Parameters that differ from run to run",
        head,
        tuple(own.rows()),
        f"{' '.join(own.sentences)} All other constants are shared by the runs. The intervals are "
        "those of one fit of all runs.",
    )


def _fitted(found: Discovery, parameter: Parameter) -> str:
    """Give the fitted number of a parameter whose value is a simpler one; else nothing."""
    same = [
        c
        for c in found.constants[parameter.states[0]]
        if c.of == parameter.of and abs(c.value) == abs(parameter.value)
    ]
    if not same or "fitted" not in same[0].text:
        return ""
    text = same[0].fitted_text
    return text if same[0].value == parameter.value else text.removeprefix("-")


def _ensemble(found: Discovery) -> Table | None:
    rows = tuple(
        (state, one.term, one.probability, one.low, one.high)
        for state, own in found.ensemble.items()
        for one in own
    )
    if not rows:
        return None
    return Table(
        "ensemble",
        "An ensemble of fits",
        ("State", "Term", "Kept", "From", "To"),
        rows,
        "Kept: the share of fits, to pieces of the data drawn with replacement, that keep the "
        "term. From, to: the 95 % interval of its coefficient in these fits.",
    )


def _verdicts(found: Discovery) -> Table | None:
    if not found.verdict.tested:
        return None
    rows = tuple(
        (state, own.level, *_numbers(own, state in found.hidden), _surest(own))
        for state, own in found.verdict.states.items()
    )
    return Table(
        "verdict",
        "What the verdict rests on",
        ("State", "Verdict", "R2", "Chi-square", "Forecast", "Noise", "Terms"),
        rows,
        "R2: share of the variance that the equations explain, integrated from fitted starts. "
        "Chi-square: mean squared residual in units of the noise; 1 is noise alone. Forecast: "
        "error at the held-back end, as a share of the spread, by constants fitted to the rest. "
        "Terms: the probability that each belongs.",
    )


def _numbers(own: StateVerdict, hidden: bool) -> tuple[float | None, ...]:
    """R2, chi-square, forecast and noise; of a state that was not measured there are none."""
    found = own.r2, own.chi_square, own.forecast, own.noise
    return (None,) * len(found) if hidden else found


def _surest(own: StateVerdict) -> str:
    return ", ".join(f"{term.term}: {term.probability:.0%}" for term in own.terms)


def _front(found: Discovery, state: str, samples: tuple[Samples, np.ndarray] | None) -> Chart:
    expr = found.equations[state]
    if samples is None:
        return place_front(found.front[state], shown(expr))
    loss = rmse(samples[1], samples[0].y)
    if not np.isfinite(loss):
        return place_front(found.front[state], shown(expr))
    with counting(found.own_bits):
        shown_bits = complexity(expr)
    return place_front(found.front[state], Candidate(expr, loss, shown_bits, _FITTED))


def _trajectories(found: Discovery) -> Iterator[Picture]:
    for number, run in enumerate(found.carried[:_MOST_RUNS], 1):
        # A map goes from row to row: none may be left out between.
        rows = slice(_MOST_STEPS) if found.is_map else run.every(_stride(run))
        thin = run.select(rows)
        drawn = _say_thinned(run, thin, found.is_map)
        model, bands = _path(found, run, rows) if found.diffusion else _curve(found, thin)
        name = f"Trajectory {number}" if len(found.trajectories) > 1 else "The trajectory"
        yield Picture.of(
            draw_states(thin, model, bands),
            f"{name}: the data, and the equations {_followed(found)}{drawn}"
            if model
            else f"{name}: the data. The equations cannot be integrated over it.{drawn}",
        )
        if len(run.states) > 1 and np.any(np.all(thin.measured[:, :2], axis=1)):
            yield Picture.of(
                draw_phase_portrait(thin, model, *run.states[:2]),
                f"{name} as a phase portrait: {run.states[1]} against {run.states[0]}.{drawn}",
            )


def _followed(found: Discovery) -> str:
    """Say what was done with the equations."""
    if found.diffusion:
        return (
            "with noise in the motion: one path from the first row, and the band of 95 % of such "
            "paths."
        )
    return _FOLLOWED[found.is_map]


def _curve(found: Discovery, run: Trajectory) -> tuple[Trajectory | None, Bands]:
    model = _simulate(found, run)
    return model, _bands(found, run) if model else {}


def _path(found: Discovery, run: Trajectory, rows: Any) -> tuple[Trajectory | None, Bands]:
    try:
        model, bands = found.path_and_band(run)
    except DynsrError:
        return None, {}
    return model.select(rows), {s: (low[rows], high[rows]) for s, (low, high) in bands.items()}


def show_noise(found: Discovery) -> Picture | None:
    """Draw the changes of each state in cells of near rows, and the drift and diffusion there.

    Parameters
    ----------
    found : the discovery, with its data; None where its motion has no noise.
    """
    if not (found.diffusion and found.trajectories):
        return None
    words = (
        "Left: the mean change of each state in unit time, in cells of near rows, with its "
        "standard error, and the drift found. Right: the variance in unit time of what each step "
        "misses, and the diffusion found."
    )
    return Picture.of(draw_steps(cells_of(found.steps_of())), words)


def list_fixed_points(found: Discovery) -> tuple[FixedPoint, ...]:
    """Give the fixed points of equations that say by themselves where these are.

    Parameters
    ----------
    found : the discovery; without its data there are none.
    """
    if not found.trajectories or arguments_of(found.equations):
        return ()
    try:
        return found.fixed_points()
    except InputError:  # they hold the time
        return ()


def _fixed_points(found: Discovery) -> Table | None:
    rows = tuple(
        (*(f"{v:.6g}" for v in p.at.values()), p.kind, ", ".join(map(_complex, p.eigenvalues)))
        for p in list_fixed_points(found)
    )
    if not rows:
        return None
    return Table(
        "fixed-points",
        "Fixed points",
        (*found.equations, "Kind", "Eigenvalues"),
        rows,
        "The fixed points of the equations, in the range of the data and half as much around it. "
        "Eigenvalues: of the equations linearised there"
        + (
            "; beyond size 1 deviations grow."
            if found.is_map
            else "; with a real part above 0 deviations grow."
        ),
    )


def _complex(value: complex) -> str:
    sign = "+" if value.imag > 0 else "\u2212"
    turning = f" {sign} {abs(value.imag):.4g}i" if value.imag else ""
    return f"{value.real:.4g}{turning}"


def show_flow(found: Discovery) -> Picture | None:
    """Draw the flow of two states that nothing drives; None where there is none to draw.

    Parameters
    ----------
    found : the discovery, with its data.
    """
    if len(found.equations) != 2 or found.is_map or arguments_of(found.equations):
        return None
    timed = any("t" in map(str, e.free_symbols) for e in found.equations.values())
    if not found.trajectories or timed:
        return None
    return Picture.of(
        found.phase_portrait(),
        "The flow of the equations: arrows show where states go, lines where one of them does not "
        "change. Fixed points are where both do not. The data are drawn too.",
    )


def show_branches(found: Discovery) -> Picture | None:
    """Draw the fixed points along the constant that changes their kinds most, or along the first.

    Parameters
    ----------
    found : the discovery, with its data; None of many states, which would take long.
    """
    constants = [one for one in found.parameters.values() if one.value]
    few = len(found.equations) <= _MOST_FOLLOWED
    if not few or not constants or not list_fixed_points(found):
        return None
    steps = np.geomspace(0.5, 2, _BRANCH_STEPS)
    changes = [
        len(found.bifurcation(one.name, one.value * steps[:: len(steps) // 2]).changes())
        for one in constants
    ]
    chosen = constants[int(np.argmax(changes))]
    branches = found.bifurcation(chosen.name, chosen.value * steps)
    places = {s: [p.at[s] for points in branches.points for p in points] for s in found.equations}
    state = next((s for s, own in places.items() if np.ptp(own) > 0), next(iter(places)))
    said = "; ".join(f"near {chosen.name} = {v:.3g}: {text}" for v, text in branches.changes())
    return Picture.of(
        branches.plot(state),
        f"Bifurcation: the fixed points of {state} while {chosen.name}, which was found as "
        f"{chosen.value:.4g}, goes from half of that to twice that. "
        f"{said[:1].upper()}{said[1:] or 'Their number and kinds stay the same'}. "
        "Points are searched as below; cycles are not computed.",
    )


def _stride(run: Trajectory) -> int:
    return max(1, len(run) // _MOST_ROWS)


def _say_thinned(run: Trajectory, thin: Trajectory, is_map: bool) -> str:
    """Say which rows are drawn, where these are not all."""
    if len(thin) == len(run):
        return ""
    which = f"The first {len(thin)} rows" if is_map else f"One row in {_stride(run)}"
    return f" {which} of {len(run)} {'are' if is_map else 'is'} drawn."


def _slopes(found: Discovery, pair: tuple[Samples, np.ndarray]) -> Iterator[Picture]:
    samples, predicted = pair
    unit, state = found.time_unit, samples.target
    kind = _TARGETS[found.is_map]
    upper = state if len(state) == 1 else f"({state})"
    label = f"next {state}" if found.is_map else f"d{upper}/dt"
    scheme = {"gp": "a Gaussian process"}.get(samples.scheme, samples.scheme)
    taken = "in the data" if found.is_map else f"taken from the data by {scheme}"
    count = len(samples.t)
    dense = f" There are {count}: the stronger the colour, the more of them lie there."
    how = dense if count > MOST_DOTS else ""
    yield Picture.of(
        draw_slopes(samples, predicted, unit, label),
        f"The {kind} of {state}, {taken}, and those of the equation.{how}",
    )
    yield Picture.of(
        draw_residuals(samples, predicted, unit, label),
        f"The residuals of the {kind} of {state} over time, and how often each size occurs.{how}",
    )


def _simulate(found: Discovery, run: Trajectory) -> Trajectory | None:
    """Integrate from the run's first row; None where the equations diverge or need more states."""
    if set(found.equations) != set(run.states):
        return None
    try:
        return replace(found, trajectories=(run,)).simulate()
    except DynsrError:
        return None


def _bands(found: Discovery, run: Trajectory) -> Bands:
    """Give for each state the 2.5 % and 97.5 % quantiles over drawn constants; none for a map.

    None either where all constants are as sure as in exact data, which no picture could show.
    """
    known = [pair for errors in found.errors.values() for pair in errors]
    if found.is_map or all(error <= _INVISIBLE * abs(value) for value, error in known):
        return {}
    rng = np.random.default_rng(0)
    curves = []
    for _ in range(_DRAWS):
        drawn = {s: _draw(e, found.errors.get(s, ()), rng) for s, e in found.equations.items()}
        try:
            alone = replace(found, equations=drawn, trajectories=(run,))
            curves.append(alone.simulate(engine=DEFAULT_ENGINE).x)
        except DynsrError:
            continue
    if len(curves) < _DRAWS // 2:
        return {}
    low, high = np.quantile(np.array(curves), [0.025, 0.975], axis=0)
    return {s: (low[:, i], high[:, i]) for i, s in enumerate(found.equations)}


def _draw(
    expr: sympy.Expr, errors: tuple[tuple[float, float], ...], rng: np.random.Generator
) -> sympy.Expr:
    """Move every constant by its own error; one without an error stays."""
    template, values = free_constants(loosen(expr), "constant ")
    moved = {}
    for symbol, value in values.items():
        nearest = min(errors, key=lambda pair: abs(pair[0] - value), default=(value, 0.0))
        error = nearest[1] if np.isfinite(nearest[1]) else 0.0
        moved[symbol] = sympy.Float(value + error * rng.standard_normal())
    return template.xreplace(moved)


def _scores(found: Discovery) -> Table | None:
    if not found.trajectories:
        return None
    rows = tuple((state, *scores.values()) for state, scores in found.score().items())
    if found.diffusion:
        return Table(
            "scores",
            "Errors on the data",
            ("State", "One step", "Share"),
            rows,
            "One step: RMSE from each row to the next one. Share: its mean square in units of what "
            "the noise in the motion and the errors of measurement add up to; 1 where these are "
            "right.",
        )
    return Table(
        "scores",
        "Errors on the data",
        ("State", "Slopes", "Forecast", "Whole trajectory"),
        rows,
        "Slopes: RMSE of the equation against the slopes of the data, in units of the state per "
        "unit of time. Forecast: the median error over 50 rows, as a share of the state's "
        "standard deviation. Whole trajectory: RMSE of one integration from the first row to the "
        "last. In a chaotic system it becomes large for every equation.",
    )


def _formats(found: Discovery) -> Iterator[tuple[str, str, str, str]]:
    """Give (title, file, text, address) of the equations with named parameters for other tools.

    An archive has no text to read. One with more rows than are drawn would make a large page.
    """
    source = Source.of(found)
    small = sum(map(len, found.trajectories)) <= _MOST_ROWS
    for name, one in list_formats(source).items():
        if one.folder is None:
            file, packed = pack_format(source, name)
            address = f"data:text/plain;charset=utf-8,{quote_url(packed)}"
            yield one.title, file, packed.decode(), address
        elif small:
            file, packed = pack_format(source, name)
            yield one.title, file, "", f"data:application/zip;base64,{b64encode(packed).decode()}"


def _facts(found: Discovery) -> list[tuple[str, str]]:
    """Give what a reader asks first: with what, and from which data, the equations were found."""
    settings, runs = found.settings, found.trajectories
    count = "1 trajectory" if len(runs) == 1 else f"{len(runs)} trajectories"
    rows = f"{sum(map(len, runs))} rows in {count}" if runs else ""
    return [
        ("made by", f"dynsr {settings.get('version', __version__)}"),
        ("command", _command(found)),
        *([("data", about)] if (about := str(settings.get("columns", rows))) else []),
        *((f"input {name}", shown(expr)) for name, expr in found.inputs.items()),
        ("seed", str(settings.get("seed", ""))),
        ("time of the search", f"{found.seconds:.1f} s"),
    ]


def _settings(found: Discovery) -> list[tuple[str, str]]:
    """Give the settings: those of the call, then each number that is not the usual one."""
    settings = found.settings
    of_call = {k: v for k, v in settings.items() if k not in _TOLD_ELSEWHERE and v not in ("", {})}
    usual = dict(_flat(to_plain(DISCOVERY)))
    try:
        methods = choose_methods(str(settings["method"]).split(","), settings["preset"])
    except (KeyError, DynsrError):  # of an older version, or the user's own
        methods = {}
    usual |= dict(_flat({"methods": to_plain(methods)}))
    changed = [
        (name, value)
        for name, value in _flat(settings.get("details", {}))
        if not name.endswith(".engine") and usual.get(name) != value
    ]
    return [(name, _read(value)) for name, value in (*of_call.items(), *changed)]


def _flat(values: object, before: str = "") -> Iterator[tuple[str, Any]]:
    """Give the values of nested mappings, each by its path; a damaged record may have none."""
    if not isinstance(values, Mapping):
        return
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _figure(value: Any) -> str:
    """Write a number of a record; "" for anything else that a changed one has there."""
    return f"{value:g}" if isinstance(value, (int, float)) else ""


def _command(found: Discovery) -> str:
    """Give the command that searches the same data in the same way."""
    settings = found.settings
    known = settings.get("known", {})
    own = found.columns_asked.get("inputs", [])
    # Delayed columns are none of the data.
    hold = {n: how for n, how in settings.get("hold", {}).items() if not found.delays or n in own}
    options = {
        "inputs": ",".join(f"{name}={shown(e)}" for name, e in found.inputs.items()),
        "method": settings.get("method", "auto"),
        "preset": settings.get("preset", ""),
        "known": "; ".join(f"{state}'={text}" for state, text in known.items()),
        "seed": str(settings.get("seed", "")),
        "engine": settings.get("engine", ""),
        "order": ",".join(f"{state}=2" for state in settings.get("velocities", {})),
        "hold": ",".join(f"{name}={how}" for name, how in hold.items()),
        "delays": ",".join({f"{delay.value:.6g}": None for delay in found.delays.values()}),
        "functions": ",".join(settings.get("functions", ())),
        "max-complexity": _figure(settings.get("max_complexity")),
        "complexity": ",".join(f"{k}={v:g}" for k, v in settings.get("complexity", {}).items()),
        "loss": settings.get("loss", ""),
        "nonnegative": ",".join(settings.get("nonnegative", ())),
        "time-budget": _figure(settings.get("time_budget")),
    }
    given = [f"--{name} {quote(value)}" for name, value in options.items() if value]
    given += [
        f"--{name} {quote(str(value))}"
        for name in ("terms", "must", "constraints", "conserved")
        for value in settings.get(name, ())
    ]
    given += ["--explicit-time"] * bool(settings.get("explicit_time"))
    given += ["--map"] * found.is_map
    return " ".join(["dynsr discover DATA", *given])


def _read(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}: {v}" for k, v in value.items())
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
