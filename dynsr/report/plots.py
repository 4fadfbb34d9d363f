"""Pictures, as matplotlib figures; no other file of dynsr names matplotlib.

Every function gives a new figure of its own and touches no global state. Colours are those of
Okabe and Ito, which colour-blind readers distinguish, and each curve has its own line style too.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from html import escape
from textwrap import fill
from typing import Any, Literal

import numpy as np
import sympy
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dynsr.data import Samples, Trajectory
from dynsr.engines import Branches, FixedPoint
from dynsr.expression import compile_numpy
from dynsr.parameters import Cells, FreePart, Profile, RunParameters, Suggestion

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STYLES = ("--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
MARKERS = ("o", "s", "^", "D", "v", "P")
# A page on a phone shows a picture of this many inches with letters that can be read.
_WIDTH = 5.2
_NOTEBOOK_DPI = 100
# Room in inches for what stands around axes: numbers and a label, an exponent, a legend. Measuring
# them, as a layout engine does, takes longer than drawing them.
_LEFT, _RIGHT, _TOP, _BOTTOM, _LEGEND = 1.0, 0.12, 0.25, 0.5, 0.3
# Inches of a legend: a mark with the spaces around it, a letter, a further line.
_LEGEND_MARK, _LEGEND_LETTER, _LEGEND_LINE = 0.65, 0.085, 0.21
# Letters of a line above one of two pictures side by side.
_TITLE = 30
# Numbers below it at most.
_TICKS = 3
# More dots than these hide each other: how many lie where is drawn instead.
MOST_DOTS = 5000
_BINS = (160, 80)
# What of an open side is drawn, in units of the other side or of the constant.
# Degrees by which names of runs are turned.
_SLANT = 30
_OPEN = 3.0
# Points across a picture of a flow, and the colour of its arrows.
_FLOW_GRID = 41
# Size in points of a dot of measured values: so much over the root of their number, within limits.
_DOT_SIZE, _DOT_SIZES = 40.0, (2.6, 4.5)
# More dots than these are a picture in the page and no shapes, which take a line of text each.
_MOST_SHAPES = 500
_DATA = "#7a7a7a"
_GREY = "#8a8a8a"
# What a curve that runs away may take of the picture: this many spans of the truth.
_ROOM = 0.6
_STYLE = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.hashsalt": "dynsr",
    # Letters stay letters: readers can select them, and a page sets them in its own type.
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.5,
}


class Drawing(Figure):
    """A figure that notebooks show, also where nothing has drawn with pyplot before."""

    def _repr_png_(self) -> bytes:
        return to_bytes(self, "png", _NOTEBOOK_DPI)


@dataclass(frozen=True)
class Panel:
    """One state over time: the truth, and what was inferred.

    Parameters
    ----------
    title : what is shown.
    state : name of the state, which labels the axis.
    t : (n,) times in seconds.
    truth : (n,) true values, in the state's unit.
    found : label -> (r, n) values of r runs; NaN from where a run diverged.
    unit : the state's unit, which follows its name.
    """

    title: str
    state: str
    t: np.ndarray
    truth: np.ndarray
    found: Mapping[str, np.ndarray] = field(default_factory=dict)
    unit: str = ""


def draw_panels(panels: Sequence[Panel], labels: Sequence[str] = ()) -> Figure:
    """Draw true and inferred curves, one panel next to the other (the paper's Figure 1).

    Every run is a thin line and the first run of each label a thick one. The axis follows the
    truth, so that a run that leaves it does not flatten the others. A label has the same colour
    in every panel.

    Parameters
    ----------
    panels : what to draw, one or more.
    labels : the order of the labels, for pictures whose colours are to agree with others.
    """
    order = list(dict.fromkeys([*labels, *(label for p in panels for label in p.found)]))
    figure, axes = _canvas(1, len(panels), (5.2 * len(panels), 3.6))
    for axis, panel in zip(axes.flat, panels, strict=True):
        axis.plot(panel.t, panel.truth, color="black", lw=2.6, label="truth", alpha=0.8)
        for label, runs in panel.found.items():
            k = order.index(label)
            for r, run in enumerate(np.atleast_2d(runs)):
                axis.plot(
                    panel.t,
                    run,
                    color=COLOURS[k % len(COLOURS)],
                    ls=STYLES[k % len(STYLES)],
                    lw=1.6 if r == 0 else 0.7,
                    alpha=1.0 if r == 0 else 0.45,
                    label=label if r == 0 else None,
                )
        _follow(axis, panel.truth, [np.asarray(runs) for runs in panel.found.values()])
        axis.set(title=panel.title, xlabel="time t (s)")
        axis.set_ylabel(f"{panel.state} ({panel.unit})" if panel.unit else panel.state)
    _legend_below(figure, max(axes.flat, key=lambda axis: len(axis.lines)))
    return figure


def draw_states(
    true: Trajectory,
    found: Trajectory | None = None,
    intervals: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> Figure:
    """Draw every state of a trajectory over time as points, the one found as a line.

    Parameters
    ----------
    true : the trajectory of the data, with k states; of one that was not measured at every row
        the points that there are, and small triangles at limits that it was beyond.
    found : a trajectory of the same states, at any times.
    intervals : state -> (lower, upper), each (n,) at the times of ``found``, in state units.
    """
    height = 1.6 * len(true.states) + 0.8
    figure, axes = _framed(len(true.states), 1, (_WIDTH, height), sharex=True)
    for axis, state in zip(axes.flat, true.states, strict=True):
        column = true.observed[:, true.index(state)]
        axis.plot(true.t, column, label="data", **_look_of(column))
        beyond = _draw_limits(axis, true, state)
        if found is not None:
            curve = found.x[:, found.index(state)]
            axis.plot(found.t, curve, color=COLOURS[1], lw=1.1, label="found")
            if intervals and state in intervals:
                axis.fill_between(
                    found.t, *intervals[state], color=COLOURS[1], alpha=0.25, label="interval"
                )
            # What nobody measured has nothing but its curve.
            seen = np.concatenate([column, *beyond])
            _follow(axis, seen if np.isfinite(seen).any() else curve, [curve])
        axis.set_ylabel(state if np.isfinite(column).any() else f"{state}, not measured")
    axes.flat[-1].set_xlabel(_time_label(true.time_unit))
    _legend_below(figure, *axes.flat)
    return figure


def _draw_limits(axis: Axes, run: Trajectory, state: str) -> list[np.ndarray]:
    """Draw a triangle at each limit that a state was below or above, which points to where it was.

    Gives the limits.
    """
    if state not in run.limits:
        return []
    sides = {"v": run.limits[state].below, "^": run.limits[state].above}
    words = {"v": "below a limit", "^": "above a limit"}
    for mark, limit in sides.items():
        if np.isfinite(limit).any():
            look: dict[str, Any] = {
                "ls": "",
                "mew": 0.8,
                "mfc": "none",
                "mec": _DATA,
                "ms": _DOT_SIZES[1] + 1,
            }
            axis.plot(run.t, limit, marker=mark, label=words[mark], **look)
    return [limit[np.isfinite(limit)] for limit in sides.values()]


def draw_residuals(
    samples: Samples, predicted: np.ndarray, time_unit: str = "", label: str = ""
) -> Figure:
    """Draw the residuals of a formula over time, and how they are distributed.

    Parameters
    ----------
    samples : the n slopes that it was fitted to; more than MOST_DOTS are drawn as a density.
    predicted : (n,) slopes that it gives there.
    time_unit : what times are counted in; "" where nobody knows.
    label : what the slopes are called; by default as time derivatives.
    """
    residuals = samples.y - np.asarray(predicted, dtype=float)
    figure, axes = _framed(1, 2, (_WIDTH, 3.2), width_ratios=(4, 1), sharey=True, legend=False)
    over_time, histogram = axes.flat
    _draw_dots(over_time, samples.t, residuals, COLOURS[0], 2.5)
    over_time.axhline(0.0, color="black", lw=0.8)
    over_time.set(
        xlabel=_time_label(time_unit), ylabel=f"residual of {label or f'd{samples.target}/dt'}"
    )
    finite = residuals[np.isfinite(residuals)]
    histogram.hist(
        finite,
        bins=40,
        histtype="stepfilled",
        orientation="horizontal",
        color=COLOURS[0],
        alpha=0.7,
    )
    histogram.set(xlabel="samples")
    return figure


def draw_slopes(
    samples: Samples, predicted: np.ndarray, time_unit: str = "", label: str = ""
) -> Figure:
    """Draw the slopes of the data over time, as dots, and what a formula gives there.

    Parameters
    ----------
    samples : the n slopes of the data; more than MOST_DOTS are drawn as a density.
    predicted : (n,) slopes of the formula.
    time_unit : what times are counted in; "" where nobody knows.
    label : what the slopes are called; by default as time derivatives.
    """
    figure, axes = _framed(1, 1, (_WIDTH, 3.2))
    axis = axes.flat[0]
    _draw_dots(axis, samples.t, samples.y, "0.6", 5, "data")
    few = slice(None, None, -(-len(samples.t) // MOST_DOTS))
    t, given = samples.t[few], np.array(predicted, dtype=float)[few]
    # Time that runs backwards is the start of the next trajectory: no line joins the two.
    given[1:][np.diff(t) <= 0] = np.nan
    axis.plot(t, given, color=COLOURS[1], lw=1.2, label="equation")
    _follow(axis, samples.y, [given])
    axis.set(xlabel=_time_label(time_unit), ylabel=label or f"d{samples.target}/dt")
    _legend_below(figure, axis)
    return figure


def draw_profiles(profiles: Sequence[Profile]) -> Figure:
    """Draw profile likelihoods of constants, two in a row.

    The dots are fits; the dashed parabola is what the standard error says; the horizontal line is
    where the 95 % interval, which is shaded, ends.

    Parameters
    ----------
    profiles : one or more.
    """
    columns = min(2, len(profiles))
    rows = -(-len(profiles) // columns)
    figure, axes = _canvas(rows, columns, (_WIDTH, 2.2 * rows + 0.6))
    for axis, own in zip(axes.flat, profiles, strict=False):
        _draw_profile(axis, own)
    for axis in axes.flat[len(profiles) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("loss of log-likelihood")
    _legend_below(figure, axes.flat[0])
    return figure


def draw_by_run(own: RunParameters) -> Figure:
    """Draw the parameters that differ from run to run with their 95 % intervals, two in a row.

    Parameters
    ----------
    own : parameters of which one or more differ.
    """
    columns = min(2, len(own))
    rows = -(-len(own) // columns)
    figure, axes = _canvas(rows, columns, (_WIDTH, 2.2 * rows + 0.6))
    for axis, (name, each) in zip(axes.flat, own.constants.items(), strict=False):
        values = np.array([p.value for p in each])
        # An interval that is unknown has no bar.
        ends = [(p.low or p.value, p.high or p.value) for p in each]
        bars = np.abs(np.array(ends).T - values)
        axis.errorbar(own.runs, values, bars, fmt="o", color=COLOURS[0], ms=4, capsize=3, lw=1.2)
        axis.set_title(f"{name} of {each[0].of} in {each[0].states[0]}'", fontsize=9)
        axis.tick_params(axis="x", labelrotation=_SLANT if max(map(len, own.runs)) > 3 else 0)
    for axis in axes.flat[len(own) :]:
        axis.set_axis_off()
    return figure


def draw_free(parts: Sequence[FreePart]) -> Figure:
    """Draw free functions, two in a row: the formula or curve, the 95 % band, and the data.

    Parameters
    ----------
    parts : one or more.
    """
    columns = min(2, len(parts))
    rows = -(-len(parts) // columns)
    height = 3.4 if columns == 1 else 2.6
    figure, axes = _canvas(rows, columns, (_WIDTH, height * rows + 0.4))
    for axis, part in zip(axes.flat, parts, strict=False):
        _draw_part(axis, part)
    for axis in axes.flat[len(parts) :]:
        axis.set_axis_off()
    _legend_below(figure, axes.flat[0])
    return figure


def draw_steps(cells: Sequence[Cells]) -> Figure:
    """Draw drift and diffusion of each state: found as lines, in cells of near rows as points.

    Parameters
    ----------
    cells : of each state.
    """
    figure, axes = _canvas(len(cells), 2, (_WIDTH, 2.6 * len(cells) + 0.4))
    for (left, right), own in zip(axes, cells, strict=True):
        dots = {"fmt": ".", "color": _DATA, "ms": 5, "lw": 1, "label": "steps of the data"}
        look = {"color": COLOURS[1], "lw": 1.4, "label": "found"}
        left.errorbar(own.at, own.slope, own.error, **dots)
        left.plot(own.at, own.drift, **look)
        left.set(xlabel=own.of, ylabel=f"drift of {own.state}")
        right.errorbar(own.value, own.variance, **dots)
        right.plot(own.value, own.diffusion, **look)
        right.set(xlabel=own.state, ylabel=f"diffusion of {own.state}")
        right.set_ylim(bottom=0)
    _legend_below(figure, axes.flat[0])
    return figure


def _draw_part(axis: Axes, part: FreePart) -> None:
    x = np.linspace(*part.span, 301)
    low, high = part.band(x)
    known = np.isfinite(low) & np.isfinite(high)
    shown = np.concatenate([part(x), low[known], high[known]])
    if part.points:
        columns, values = np.array(part.points).T
        axis.plot(columns, values, ".", color=_DATA, ms=3.5, label="slopes of the data")
    axis.fill_between(
        x, low, high, where=known, color=COLOURS[0], alpha=0.2, lw=0, label="95 % band of the curve"
    )
    axis.plot(x, part.curve(x), color=COLOURS[0], lw=1.4, label="curve")
    if not part.is_curve:
        axis.plot(x, part(x), color=COLOURS[1], lw=1.4, ls="--", label="formula")
    # Points whose slope says little are far away.
    room = _ROOM * max(float(np.ptp(shown)), 1e-300)
    axis.set_ylim(float(shown.min()) - room / 2, float(shown.max()) + room / 2)
    axis.set_xlabel(part.of)
    axis.set_ylabel(f"{part.name}({part.of})")


def _draw_profile(axis: Axes, own: Profile) -> None:
    top = 2.5 * own.limit
    near = own.values[own.criterion <= top]
    left, right = float(near.min()), float(near.max())
    # A side that is open goes far; its first part shows what the rest is like.
    if own.high is None:
        right = min(right, own.value + _OPEN * max(own.value - left, abs(own.value)))
    if own.low is None:
        left = max(left, own.value - _OPEN * max(right - own.value, abs(own.value)))
    axis.plot(own.values, own.criterion, "o-", color=COLOURS[0], ms=3, lw=1.4, label="profile")
    error = (own.wald[1] - own.wald[0]) / 2
    if np.isfinite(error) and error > 0:
        grid = np.linspace(left, right, 101)
        parabola = own.limit * ((grid - sum(own.wald) / 2) / error) ** 2
        axis.plot(grid, parabola, color=COLOURS[1], ls="--", lw=1.2, label="standard error")
    axis.axhline(own.limit, color="black", lw=0.8, ls=":", label="95 %")
    low = left if own.low is None else own.low
    high = right if own.high is None else own.high
    axis.axvspan(low, high, color=COLOURS[0], alpha=0.1, lw=0)
    axis.set_ylim(0, top)
    axis.set_xlim(left, right)
    axis.set_title(fill(own.title, _TITLE), fontsize=9)
    axis.ticklabel_format(axis="x", useOffset=False)
    axis.locator_params(axis="x", nbins=_TICKS)


def draw_suggestion(suggestion: Suggestion) -> Figure:
    """Draw the best experiment, and by how much alternatives differ from the answer there.

    On the left is what the answer and its alternatives do there, on the right what each alternative
    differs by from the answer, with twice the noise as a band.

    Parameters
    ----------
    suggestion : the experiments.
    """
    told = [(i, s, own) for i, (s, own) in enumerate(suggestion.noise.items()) if np.isfinite(own)]
    figure, axes = _canvas(len(told), 2, (_WIDTH, 1.7 * len(told) + 0.8), sharex=True)
    t = suggestion.times - suggestion.times[0]
    for (left, right), (i, state, noise) in zip(axes, told, strict=True):
        answer, *others = suggestion.curves[..., i]
        left.plot(t, answer, color=COLOURS[0], lw=1.8, label="found")
        right.axhspan(-2 * noise, 2 * noise, color=COLOURS[0], alpha=0.2, lw=0)
        for number, curve in enumerate(others, 1):
            line = {
                "color": COLOURS[number % len(COLOURS)],
                "ls": STYLES[(number - 1) % len(STYLES)],
                "lw": 1.4,
            }
            left.plot(t, curve, label=f"other {number}", **line)
            right.plot(t, curve - answer, **line)
        left.set_ylabel(state)
        right.set_ylabel(f"difference in {state}")
    for axis in axes[-1]:
        axis.set_xlabel("time from the start")
    _legend_below(figure, axes[0, 0])
    return figure


def draw_phase_portrait(true: Trajectory, found: Trajectory | None, across: str, up: str) -> Figure:
    """Draw one state against another: the data as points, the trajectory found as a line.

    Parameters
    ----------
    true : the trajectory of the data, with rows at which both were measured.
    found : one of the same states; None draws the data alone.
    across, up : names of the states on the two axes.
    """
    figure, axes = _framed(1, 1, (_WIDTH, 4.6))
    axis = axes.flat[0]
    i, j = true.index(across), true.index(up)
    both = true.observed[:, [i, j]]
    whole = both[np.all(np.isfinite(both), axis=1)]
    axis.plot(*whole.T, label="data", **_look_of(whole))
    if len(whole):
        axis.plot(*whole[0], "s", color="black", ms=7, mfc="none", mew=1.5, label="start")
    if found is not None:
        path = found.x[:, [found.index(across), found.index(up)]]
        axis.plot(*path.T, color=COLOURS[1], lw=1.1, label="found")
        whole = whole if len(whole) else path
        _follow(axis, whole[:, 1], [path[:, 1]])
        low, high = _limits(whole[:, 0], [path[:, 0]])
        axis.set_xlim(low, high)
    axis.set(xlabel=across, ylabel=up)
    _legend_below(figure, axis)
    return figure


def draw_flow(
    equations: Mapping[str, sympy.Expr],
    box: Mapping[str, tuple[float, float]],
    points: Sequence[FixedPoint] = (),
    runs: Sequence[Trajectory] = (),
) -> Figure:
    """Draw the flow of two states: directions, nullclines, fixed points, and the data.

    Parameters
    ----------
    equations : the two states -> right-hand sides in them alone.
    box : state -> (low, high) of what is drawn; near fixed points are drawn too.
    points : the fixed points; those that are stable are filled.
    runs : data of both states.

    >>> x, y = sympy.symbols("x y")
    >>> figure = draw_flow({"x": y, "y": -x}, {"x": (-1.0, 1.0), "y": (-1.0, 1.0)})
    >>> figure.axes[0].get_xlabel()
    'x'
    """
    across, up = equations
    figure, axes = _framed(1, 1, (_WIDTH, 4.8))
    axis = axes.flat[0]
    spans = [_with_points(box[s], [p.at[s] for p in points]) for s in (across, up)]
    grid = np.meshgrid(*(np.linspace(*span, _FLOW_GRID) for span in spans))
    rates = compile_numpy(list(equations.values()), [across, up])(np.array(grid))
    rates = np.where(np.isfinite(rates), rates, np.nan)
    axis.streamplot(*grid, *rates, color=_GREY, density=0.9, linewidth=0.6, arrowsize=0.7)
    for k, (state, rate) in enumerate(zip((across, up), rates, strict=True)):
        if np.nanmin(rate) < 0 < np.nanmax(rate):
            look = {"colors": COLOURS[k], "linestyles": STYLES[k], "linewidths": 1.6}
            axis.contour(*grid, rate, levels=[0.0], **look)
            axis.plot([], [], color=COLOURS[k], ls=STYLES[k], label=f"{state}' = 0")
    for k, run in enumerate(runs):
        path = run.x[:, [run.index(across), run.index(up)]]
        axis.plot(*path.T, label=None if k else "data", **_look_of(path))
    for stable, face in ((True, "black"), (False, "white")):
        some = [p for p in points if p.stable == stable]
        if some:
            places = np.array([[p.at[across], p.at[up]] for p in some]).T
            look = {"mec": "black", "mfc": face, "ms": 7, "ls": "", "zorder": 5}
            axis.plot(*places, "o", label="stable" if stable else "not stable", **look)
    axis.set(xlabel=across, ylabel=up, xlim=spans[0], ylim=spans[1])
    axis.grid(visible=False)
    _legend_below(figure, axis)
    return figure


def _with_points(span: tuple[float, float], places: Sequence[float]) -> tuple[float, float]:
    """Give a span with a margin, which contains places that are near it."""
    low, high = span
    width = (high - low) or max(abs(high), 1.0)
    near = [p for p in places if low - _ROOM * width <= p <= high + _ROOM * width]
    return min([low, *near]) - 0.08 * width, max([high, *near]) + 0.08 * width


def draw_branches(branches: Branches, state: str) -> Figure:
    """Draw the fixed points of a state along a parameter; those that are stable are filled.

    Parameters
    ----------
    branches : the fixed points at each value of the parameter.
    state : the state on the vertical axis.

    >>> figure = draw_branches(Branches("k", np.array([0.0]), ((),)), "x")
    >>> figure.axes[0].get_xlabel()
    'k'
    """
    figure, axes = _framed(1, 1, (_WIDTH, 3.6))
    axis = axes.flat[0]
    for stable, face in ((True, COLOURS[0]), (False, "white")):
        pairs = [
            (value, point.at[state])
            for value, points in zip(branches.values, branches.points, strict=True)
            for point in points
            if point.stable == stable
        ]
        if pairs:
            look = {"mec": COLOURS[0], "mfc": face, "ms": 3.5, "ls": ""}
            label = "stable" if stable else "not stable"
            axis.plot(*np.array(pairs).T, "o", label=label, **look)
    axis.set(xlabel=branches.parameter, ylabel=state)
    if axis.lines:
        _legend_below(figure, axis)
    return figure


def draw_recovery(
    levels: Sequence[float],
    rates: Mapping[str, Sequence[float]],
    intervals: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
) -> Figure:
    """Draw how often each method recovers the equation (0 to 1) as the noise grows.

    Parameters
    ----------
    levels : noise as a share of each state's deviation, 0 included if wanted.
    rates : method -> its rate at every level, from 0 to 1.
    intervals : method -> its (lower, upper) rates at every level.
    """
    figure, axes = _canvas(1, 1, (5.6, 3.6))
    axis = axes.flat[0]
    at = np.arange(len(levels))
    for k, (label, rate) in enumerate(rates.items()):
        colour = COLOURS[k % len(COLOURS)]
        style = STYLES[k % len(STYLES)]
        axis.plot(at, rate, color=colour, ls=style, marker=MARKERS[k % len(MARKERS)], label=label)
        if intervals and label in intervals:
            axis.fill_between(at, *intervals[label], color=colour, alpha=0.15)
    axis.set_xticks(at, [f"{100 * level:g}" for level in levels])
    axis.set(ylim=(-0.03, 1.03), xlabel="noise (% of each state's deviation)")
    axis.set_ylabel("share of runs that recover the equation")
    axis.legend(frameon=False)
    return figure


def to_bytes(figure: Figure, kind: str = "png", dpi: int = 150) -> bytes:
    """Give the picture as a file's content; the same figure gives the same bytes.

    Parameters
    ----------
    figure : the picture.
    kind : "png", "svg" or "pdf".
    dpi : dots per inch of a PNG.
    """
    out = io.BytesIO()
    # Without a date and a version, so that equal pictures are equal files.
    metadata: dict[str, None] = {"Software": None} if kind == "png" else {"Date": None}
    if kind == "pdf":
        metadata = {"CreationDate": None}
    with rc_context(_STYLE):
        figure.savefig(out, format=kind, dpi=dpi, metadata=metadata)
    return out.getvalue()


def to_svg(figure: Figure, label: str) -> str:
    """Give the picture as an ``svg`` element for a page, as wide as the page allows.

    Black becomes the colour of the page's letters, and there is no background, so that a dark
    page and a printed one both show it well. ``label`` is what a screen reader says.
    """
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    out = io.StringIO()
    with rc_context(_STYLE):
        figure.savefig(out, format="svg", dpi=200, metadata=metadata, transparent=True)
    drawn = re.search(r'viewBox="([^"]*)"[^>]*>(.*)</svg>', out.getvalue(), re.DOTALL)
    assert drawn is not None
    body = re.sub(r'<style.*?</style>|font-family: [^;"]*(; )?', "", drawn[2], flags=re.DOTALL)
    # A name that nothing refers to would stand on the page once for every picture.
    used = set(re.findall(r"#([\w.]+)", body))
    body = re.sub(r' id="([^"]*)"', lambda name: name[0] if name[1] in used else "", body)
    # Pictures of one page may have the same marks; each calls them its own.
    own = sha256((label + body).encode()).hexdigest()[:8]
    for name in re.findall(r' id="([^"]*)"', body):
        body = re.sub(rf'( id="|#){re.escape(name)}(?=["\)])', rf"\g<1>{name}-{own}", body)
    body = body.replace("#000000", "currentColor")
    head = f'role="img" aria-label="{escape(label)}" viewBox="{drawn[1]}"'
    return f'<svg class="picture" {head}>{body}</svg>'


def _canvas(
    rows: int,
    columns: int,
    size: tuple[float, float],
    width_ratios: Sequence[float] | None = None,
    sharex: bool = False,
    sharey: bool = False,
    layout: Literal["constrained"] | None = "constrained",
) -> tuple[Figure, np.ndarray]:
    with rc_context(_STYLE):
        figure = Drawing(figsize=size, layout=layout)
        FigureCanvasAgg(figure)
        axes = figure.subplots(
            rows,
            columns,
            squeeze=False,
            sharex=sharex,
            sharey=sharey,
            gridspec_kw={"width_ratios": width_ratios} if width_ratios else None,
        )
    return figure, axes


def _framed(
    rows: int, columns: int, size: tuple[float, float], legend: bool = True, **options: Any
) -> tuple[Figure, np.ndarray]:
    """Make axes within margins of so many inches, with room for a legend below or without."""
    figure, axes = _canvas(rows, columns, size, layout=None, **options)
    width, height = size
    bottom = _BOTTOM + (_LEGEND if legend else 0.0)
    figure.subplots_adjust(
        left=_LEFT / width,
        right=1 - _RIGHT / width,
        top=1 - _TOP / height,
        bottom=bottom / height,
        wspace=0.08,
        hspace=0.18,
    )
    return figure, axes


def _look_of(rows: np.ndarray) -> dict[str, Any]:
    """Give the look of measured values: points, the smaller the more there are."""
    size = float(np.clip(_DOT_SIZE / np.sqrt(max(len(rows), 1)), *_DOT_SIZES))
    many = len(rows) > _MOST_SHAPES
    # A dot that is a picture keeps its colour on a dark page, where black is not seen.
    colour = _DATA if many else "black"
    look = {"ls": "", "marker": "o", "ms": size, "mew": 0.0, "color": colour, "alpha": 0.8}
    return {**look, "rasterized": many}


def _draw_dots(
    axis: Axes, t: np.ndarray, values: np.ndarray, colour: str, size: float, label: str = ""
) -> None:
    """Draw values over time, each as a dot, or where these are too many how densely they lie."""
    if len(t) <= MOST_DOTS:
        axis.plot(t, values, ".", ms=size, color=colour, label=label or None, rasterized=True)
        return
    # The fewer, the more of the page shows through, be it light or dark.
    shades = [to_rgba(colour, 0.2), to_rgba(colour, 1.0)]
    finite = np.isfinite(values)
    axis.hist2d(
        t[finite],
        values[finite],
        bins=_BINS,
        cmin=1,
        cmap=LinearSegmentedColormap.from_list("density", shades),
        norm="log",
        rasterized=True,
    )
    # The legend shows a dot all the same.
    axis.plot([], [], ".", ms=size, color=colour, label=label or None)


def _time_label(unit: str) -> str:
    return f"time t ({unit})" if unit else "time t"


def _limits(truth: np.ndarray, found: Sequence[np.ndarray]) -> tuple[float, float]:
    """Limits that contain the truth, and as much of the curves found as is near it."""
    low, high = float(np.nanmin(truth)), float(np.nanmax(truth))
    room = _ROOM * ((high - low) or 1.0)
    for values in found:
        finite = values[np.isfinite(values)]
        if finite.size:
            low = min(low, max(float(finite.min()), float(np.nanmin(truth)) - room))
            high = max(high, min(float(finite.max()), float(np.nanmax(truth)) + room))
    margin = 0.05 * ((high - low) or 1.0)
    return low - margin, high + margin


def _follow(axis: Axes, truth: np.ndarray, found: Sequence[np.ndarray]) -> None:
    axis.set_ylim(*_limits(truth, found))


def _legend_below(figure: Figure, *some: Axes) -> None:
    """Put the legend of some axes below all, in as many lines as its words need."""
    pairs = [zip(*axis.get_legend_handles_labels(), strict=True) for axis in some]
    by_label = {label: handle for own in pairs for handle, label in own}
    labels, handles = list(by_label), list(by_label.values())
    measured = figure.get_layout_engine() is not None
    width = figure.get_figwidth()
    widest = _LEGEND_MARK + _LEGEND_LETTER * max(map(len, labels), default=0)
    columns = int(np.clip(width // widest, 1, max(len(labels), 1)))
    lines = -(-len(labels) // columns)
    if not measured and lines > 1:
        more = (lines - 1) * _LEGEND_LINE / figure.get_figheight()
        figure.subplots_adjust(bottom=figure.subplotpars.bottom + more)
    legend = figure.legend(
        handles,
        labels,
        loc="outside lower center" if measured else "lower center",
        ncols=columns,
        frameon=False,
    )
    for mark in legend.legend_handles:
        if isinstance(mark, Line2D):
            mark.set_markersize(max(mark.get_markersize(), _DOT_SIZES[1]))
