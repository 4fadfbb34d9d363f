"""Search: from trajectories to the equations of every state, in one call."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any
from warnings import warn

import sympy
from threadpoolctl import threadpool_limits

from dynsr.arguments import checked
from dynsr.data import Missing, Trajectory, read_sums
from dynsr.discovery.apart import check_vary, search_apart
from dynsr.discovery.asked import FLAGS, check_asked
from dynsr.discovery.confirmation import confirm
from dynsr.discovery.delayed import check_delays, search_delayed
from dynsr.discovery.every_row import on_every_row, take_windows
from dynsr.discovery.free import check_free, search_free
from dynsr.discovery.hidden import check_hidden
from dynsr.discovery.options import Options
from dynsr.discovery.orders import Order
from dynsr.discovery.problem import DISCOVERY, DiscoverySettings
from dynsr.discovery.provenance import with_provenance
from dynsr.discovery.result import Discovery, ended_early, keep_if_asked, with_profiles, with_words
from dynsr.discovery.scaling import Units, hidden_in_units, search_in_units
from dynsr.discovery.second_order import search_orders
from dynsr.discovery.stages import search_once
from dynsr.discovery.start import Start
from dynsr.discovery.stochastic import check_stochastic, search_stochastic
from dynsr.discovery.uncertainty import check_ensemble, with_ensemble
from dynsr.discovery.unseen import search_stepped, take_steps
from dynsr.discovery.volumes import with_volumes
from dynsr.discovery.watching import shown_progress
from dynsr.engines import DEFAULT_ENGINE, AbstractEngine, start_engine
from dynsr.errors import DynsrWarning
from dynsr.expression import counting, read_own_bits
from dynsr.fit import LossFunction
from dynsr.jobs import Budget, Step, finish_by
from dynsr.methods import AUTO, DEFAULT_PRESET, AbstractMethod, Constraints, Must
from dynsr.verdict import LAW


@checked
def discover(
    data: Any,
    *,
    time: float | str | Sequence[Any] | None = None,
    states: Sequence[str] | str | None = None,
    trajectory: Sequence[str] | str | None = None,
    quantity: str | None = None,
    decimal: str | None = None,
    missing: Missing | None = None,
    method: str | AbstractMethod | Sequence[str | AbstractMethod] = AUTO,
    preset: str = DEFAULT_PRESET,
    targets: str | Sequence[str] = "all",
    inputs: Mapping[str, Any] | Sequence[str] | str | None = None,
    hold: Mapping[str, str] | str | None = None,
    doses: Mapping[str, str] | None = None,
    noise: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
    observed: Mapping[str, str | sympy.Expr] | None = None,
    known: Mapping[str, str | sympy.Expr] | None = None,
    seed: int = 0,
    jobs: int = -1,
    engine: str | AbstractEngine = DEFAULT_ENGINE,
    scheme: str | None = None,
    slopes: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    progress: Callable[[Step], None] | bool | None = None,
    snap: bool = True,
    order: Order | None = None,
    explicit_time: bool = False,
    discrete: bool = False,
    settings: DiscoverySettings = DISCOVERY,
    functions: Sequence[str] | None = None,
    max_complexity: float | None = None,
    complexity: Mapping[str, float] | None = None,
    loss: str | LossFunction | None = None,
    terms: Sequence[str | sympy.Expr] = (),
    must: Must | None = None,
    constraints: Constraints | None = None,
    conserved: Sequence[str | sympy.Expr] = (),
    nonnegative: Sequence[str] = (),
    units: Mapping[str, str] | str | None = None,
    time_budget: float | None = None,
    vary: bool | str | Sequence[str] = False,
    delays: bool | float | Sequence[float] = False,
    hidden: bool | int | str = False,
    stochastic: bool = False,
    ensemble: bool | int = False,
    start: Discovery | Start | str | Path | None = None,
) -> Discovery:
    """Find the equation of every state from trajectories.

    Parameters
    ----------
    data : a Trajectory, a list of them, ``(t, x)`` arrays, or what
        :func:`dynsr.data.reading.read_trajectories` reads or gives: a file, a frame, a mapping.
        Cells may be empty (NaN): each state is used where it was measured. In a list, sources
        without a common state are one experiment, joined on the time.
    time : the name of the time column, the (n,) times, or the step from row to row; guessed by
        default.
    states : the names of the state columns; every other column by default.
    trajectory : the column, or columns, whose values together name the trajectory of a row.
    quantity : the column of a long table that names the quantity of each row. Each quantity gets
        its own column. Guessed by default; "none" for a table without such a column.
    decimal : the decimal mark of numbers that are text, "." or ","; guessed by default.
    missing : the numbers that stand for no value, such as -999; "none" for no number. By default
        usual ones that are far from all others of their column are read so, with a note.
    method : "auto", the name of a method, a method with its settings, or several.
    preset : "best", "quick" or "paper".
    targets : the states whose equations are searched; "all" by default.
    inputs : columns that are inputs; or input name -> expression in ``t``, function of one time,
        or values at the times.
    hold : input -> what it does between rows: "previous" (keeps its value), "linear" or "smooth".
        One word applies to all inputs. Chosen from the values by default.
    doses : state -> column of amounts. The state jumps by the amount right after that row. Each
        part between doses counts as a trajectory. "dose/V" divides the amounts by a volume V,
        which is fitted; "dose/2.5" by a number.
    noise : state -> its known measurement errors: a standard deviation in its units, a share of
        its value such as "5 %", a column of errors, or a value for each row. They weight the rows
        and are not estimated. A column such as x_sd that is not named here gives relative errors,
        whose size is estimated.
    limits : state -> the limit of its measurement in its units. Values at or below it, and cells
        such as "BDL", say only that the state was below it, which counts by its likelihood. Also
        the upper end of the range, such as ">100", both, such as "0.05..100", or the column of the
        limits of detection. Cells such as "<0.05" say their limit themselves.
    observed : column -> the linear combination of states that it is, such as {"total": "S + I"}.
        A state in it that has no column was not measured alone: it takes the place of the column.
        Each such state needs one sum.
    known : state -> the given part of its equation; the rest is searched. A function that has no
        other meaning is free, as in "a - f(x)*y": it is found, or stays a curve. Then all of these
        equations are whole, and names that are no columns are constants. See ``found.free``.
    seed : the source of all randomness; the result does not depend on ``jobs``.
    jobs : the number of searches at a time; -1 uses every core.
    engine : "embedded", "julia" or an engine, for regression and integration. Searches for
        constants on the states always use the embedded engine. The record says which engine did
        what (``settings["engines"]``). Another engine also integrates the result over the data
        (``settings["confirmed"]``).
    scheme : how slopes are estimated. "auto" lets the data choose. It is the default, except for
        preset "paper", which uses forward differences. Other names are those of
        :func:`dynsr.data.slopes.smooth_column`; "weak" is the weak form. In noise, "auto" is
        better than any of them, because it uses no slopes.
    slopes : state -> your own slopes, one array, or one for each trajectory.
    out : a folder that keeps every finished task, the result as discovery.json, and the data as
        data.csv (of long records, the windows that were searched), with which :func:`dynsr.load`
        reads it. The same call on it continues where it stopped.
    progress : a function that is called with a :class:`Step` as tasks end, and every half second
        while they run. True shows live lines, as a notebook does by default; False shows none.
    snap : whether constants become simple numbers where the data allow it. False leaves them as
        fitted. Terms are chosen in both cases, and exponents stay whole.
    order : 1, or 2 for ``x'' = f(x, x', ...)``, for all targets or state -> order. By default 1, or
        2 where states that come back to the same values with other slopes ask for it. The velocity
        ``x_dot`` is estimated from the data and is a state, with ``x' = x_dot``.
    explicit_time : whether equations may contain the time ``t``.
    discrete : whether to find a map ``x[n+1] = f(x[n])`` from row to row. Then nothing is
        differentiated or integrated, and the constants are those of least squares on one step.
    settings : the numbers that decide outside the methods.
    functions : functions and operators that equations may contain, such as ["exp", "/"]. Sums,
        products and whole powers are always allowed. None allows what each method has; [] allows
        sums and ratios of powers. See :meth:`dynsr.expression.Vocabulary.read`.
    max_complexity : the most bits of an equation; each fitted constant counts as one symbol
        (:func:`dynsr.fit.structure_bits`).
    complexity : function or operator -> bits that it adds to the description length of a formula,
        such as {"sin": 8, "/": 4}, wherever bits are counted.
    loss : "squared", "absolute", "huber", "cauchy", or a function of predicted and actual slopes
        (n,) that gives the loss of each row. It ranks formulas on slopes and fits the constants of
        the best ones. It does not affect the searches, the comparison of whole systems in noise,
        the last fit to the states, the verdict, or errors on fronts.
    terms : terms in the columns that every method searches in addition to its own.
    must : state -> a term, or several, that its equation must contain, with fitted coefficients;
        or lines such as "x: x*y". Floats inside a term are fitted too.
    constraints : state -> term -> "+", "-" or 0: the sign of its coefficient in the expanded
        equation; or lines such as "x: x*y < 0".
    conserved : linear combinations of states that do not change, such as "S + I + R". The equation
        of the last state of each follows from the others.
    nonnegative : states that never fall below 0: their slope at 0 is not negative.
    units : column, or "t" for the time, -> its unit as pint reads it, such as "m/s"; "columns"
        reads units in brackets from the names of the columns. No equation adds different units, or
        takes a function of a number with a unit. Coefficients may have any unit.
    time_budget : seconds after which the best result is taken, without the time for loading
        libraries. A budget that ends a search makes the result depend on the machine, and the
        record names what it ended. A budget that does not changes nothing.
    vary : True if constants may differ from run to run. Some runs are searched alone, all are
        fitted together, and the description length decides which constants are shared. A state,
        or several, allows it in their equations only. See :meth:`Discovery.vary`.
    delays : True if equations may contain states and inputs as they were some time before, such as
        ``x(t - 1.6)``. The data determine the delay, one for all columns, or that none is needed. A
        number, or several, is where its fit starts. ``found.delays`` has it with its interval.
    hidden : the name of one more state, which nobody measured and whose equation is searched too.
        True or 1 names it "hidden". Its scale, its sign and a function of the measured states that
        is added to it cannot be known: the simplest form is given. The explanation says what the
        data determine.
    stochastic : True if the motion itself has noise, ``dx = f dt + sqrt(D) dW``: the drift f of
        each state is found, with the variance D of its noise, which may depend on the columns.
        Errors of measurement are fitted with it where they are seen. ``found.diffusion`` has D
        with its intervals, and ``found.simulate_paths()`` draws paths.
    ensemble : True, or a number of draws: how often each term is kept, and the interval of its
        coefficient, in fits to data drawn with replacement (:func:`dynsr.bootstrap`). The result
        is in ``found.ensemble``, in the report and in the shell's output.
    start : an earlier discovery of the same columns, or the file or folder that it was saved to.
        Its formulas are fitted to these data and are candidates. If they are a law of these data
        too, the search ends.

    Ctrl-C ends the searches and gives what they have found: a Discovery whose ``complete`` is
    False, without a verdict. The same call on the same ``out`` continues. If nothing was found
    yet, it raises KeyboardInterrupt.

    The searches do not see a part of the data, which then chooses among their formulas. The
    constants are fitted to all of the data. Raises InputError when the data cannot be used,
    ``out`` has another discovery or the engine is unknown, EngineUnavailable when it is absent.

    >>> import numpy as np
    >>> t = np.linspace(0, 3, 301)
    >>> found = discover((t, np.exp(-0.5 * t)[:, None]), preset="quick", jobs=1)
    >>> found.equations
    {'x': -0.5*x}
    """
    asked = Options(**{name: value for name, value in locals().items() if name != "data"})
    with shown_progress(progress) as lines:
        return _discover(data, replace(asked, progress=lines))


def _discover(data: Any, asked: Options) -> Discovery:
    """Read the data, search in them as is asked, and see what all rows say of what was found."""
    # What cannot integrate is refused before the data are read.
    start_engine(asked.engine)
    runs, asked = asked.read(data)
    runs = read_sums(runs, asked.observed)
    given = {name: getattr(asked, name) for name in ("settings", "slopes", *FLAGS)}
    seed = check_asked(runs[0].states, asked.seed, **given)
    members = check_ensemble(asked.ensemble, runs, asked.discrete)
    vary = check_vary(asked.vary, runs, asked.discrete)
    kind, delayed = _Kind.read(runs, asked), asked.delays is not False
    if any(run.limits for run in runs) and (kind.noisy or asked.discrete):
        warn(
            "maps and noise in the motion: cells beyond a limit count as empty there",
            DynsrWarning,
            stacklevel=4,
        )
    uncut = bool(vary or kind.together or delayed or asked.observed or members)
    stepped = take_steps(runs, asked, uncut)
    every, runs = stepped.runs, list(stepped.runs)
    # Where runs have constants of their own, a window would be another run, and the start of a
    # hidden state is a constant of a run. Maps and delays are not fitted to all rows later.
    sizes, unfitted = asked.settings.windows, asked.discrete or delayed
    most = math.inf if vary or kind.uncut else sizes.block if unfitted else sizes.above
    if kind.hidden and (rows := sum(map(len, runs))) > sizes.above:
        warn(
            f"all {rows:,} rows are fitted together with {kind.hidden}, which takes long; where "
            f"states move little from row to row, one row in {rows // (sizes.count * sizes.rows)} "
            "shows the same law",
            DynsrWarning,
            stacklevel=4,
        )
    runs, windows, slopes = take_windows(runs, sizes, asked.slopes, most, asked.discrete)
    options = replace(asked.within, slopes=slopes, seed=seed)
    until = Budget(asked.time_budget).until(1.0)

    def in_time(make: Callable[[], Discovery], found: Discovery) -> tuple[Discovery, bool]:
        return finish_by(until, make, lambda: found)

    with counting(read_own_bits(asked.complexity)):
        # Its arrays are small: more threads than one only wait for each other.
        with threadpool_limits(1):
            if delayed:
                delays = check_delays(asked.delays, runs, options, bool(vary))
                found = search_delayed(_search, runs, options, delays)
            elif kind.together:
                found = kind.search(runs, options)
            elif vary:
                found = search_apart(_search, runs, options, vary)
            elif windows or asked.observed:
                found = search_orders(_search, runs, options)
            else:
                found, stepped = search_stepped(partial(search_orders, _search), stepped, options)
                runs = list(stepped.runs)
            found = with_provenance(found, runs, asked.observed)
            found, _ = in_time(partial(confirm, found), found)
            found, _ = in_time(partial(on_every_row, found, every, windows, asked.settings), found)
            profile = asked.settings.profile
            found, late = in_time(lambda: with_volumes(with_profiles(found, profile)), found)
        found, cut = in_time(partial(with_ensemble, found, members, seed), found)
    if ended := ["profiles"] * late + ["ensemble"] * bool(members and cut):
        found = ended_early(found, ended)
    return _keep_fitted(stepped.say(found), asked.out)


def _search(runs: Sequence[Trajectory], options: Options) -> Discovery:
    """Search in units in which the data are of the size of 1."""
    return search_in_units(search_once, Units.of(runs), runs, options)


@dataclass(frozen=True)
class _Kind:
    """What is fitted together with the equations: a hidden state, noise in the motion, free parts.

    Parameters
    ----------
    hidden : the name of a state that was not measured; "" for none.
    noisy : whether the motion has noise.
    free : whether known equations have free functions.
    """

    hidden: str
    noisy: bool
    free: bool

    @classmethod
    def read(cls, runs: Sequence[Trajectory], asked: Options) -> _Kind:
        """Take what is asked for; raises InputError for what does not go together."""
        return cls(check_hidden(runs, asked), check_stochastic(runs, asked), check_free(asked))

    @property
    def together(self) -> bool:
        """Whether there is any of these."""
        return bool(self.hidden or self.noisy or self.free)

    @property
    def uncut(self) -> bool:
        """Whether all rows are searched, however many there are."""
        return bool(self.hidden or self.noisy)

    def search(self, runs: Sequence[Trajectory], options: Options) -> Discovery:
        """Search with it."""
        units = Units.of(runs)
        if self.noisy:
            found = search_in_units(search_stochastic, units, runs, options)
            keep_if_asked(found, options.out)
            return found
        if self.hidden:
            return _search_both(runs, options, self.hidden)
        return search_free(_search, runs, options, {**units.columns, "t": units.time})


def _search_both(runs: Sequence[Trajectory], options: Options, name: str) -> Discovery:
    """Search with a hidden state, and without one where that gives no law; the better verdict."""
    budget = Budget(options.time_budget)
    found = hidden_in_units(Units.of(runs), runs, options, name)
    if found is not None and (found.verdict.level == LAW or not found.complete):
        alone = None
    else:
        late = found is None and monotonic() >= budget.until(options.details.shares.choices)
        alone = _search(runs, replace(options, out=None, time_budget=budget.rest()))
        if late:
            said = f" No equations with {name} were found in this time; give more."
            found, alone = ended_early(alone, ["hidden"], said), None
    best = _better(found, alone, name)
    keep_if_asked(best, options.out)
    return best


def _better(found: Discovery | None, alone: Discovery | None, name: str) -> Discovery:
    """Give the discovery of the better verdict, that with the hidden state if they are alike."""
    if alone is None:
        assert found is not None
        return found
    if found is not None and found.verdict.rank <= alone.verdict.rank:
        return found
    sure = alone.verdict.level == LAW
    said = f" No {name} is needed." if sure else f" Equations with {name} are no better."
    return with_words(alone, said)


def _keep_fitted(found: Discovery, out: str | Path | None) -> Discovery:
    """Keep volumes, and what all rows say in the place of what the windows said."""
    record = found.settings
    later = found.volumes or record.get("windows", {}).get("fitted") or "unseen_steps" in record
    keep_if_asked(found, out if later else None)
    return found
