"""Options that several commands share, each written once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from dynsr.engines import ENGINES
from dynsr.methods import AUTO, METHODS, PRESETS, describe_methods, describe_presets

OUTPUT, SEARCH, DATA, NUMERICS = "Output", "Search", "Data", "Numerics"


def complete_system(incomplete: str) -> Iterator[tuple[str, str]]:
    """Offer the names of the known systems to the shell."""
    from dynsr.data import DEFINITIONS

    for name, system in DEFINITIONS.items():
        if name.startswith(incomplete):
            yield name, system.description


def complete_method(incomplete: str) -> list[str]:
    """Offer the names of the methods to the shell."""
    return [name for name in (AUTO, *METHODS) if name.startswith(incomplete)]


def complete_preset(incomplete: str) -> Iterator[tuple[str, str]]:
    """Offer the presets to the shell, with what they mean."""
    for name, meaning in PRESETS.items():
        if name.startswith(incomplete):
            yield name, meaning


def complete_engine(incomplete: str) -> list[str]:
    """Offer the names of the engines to the shell."""
    return [name for name in ENGINES if name.startswith(incomplete)]


def complete_column(ctx: typer.Context, incomplete: str) -> list[str]:
    """Offer the columns of the files on the line; after a comma the next one."""
    # While a line is unfinished, files are among the arguments that have no place yet.
    files = (*(ctx.params.get("files") or ()), *ctx.args)
    found = [name for file in files for name in _columns_of(Path(file))]
    done, comma, start = incomplete.rpartition(",")
    taken = done.split(",")
    return [
        f"{done}{comma}{name}"
        for name in dict.fromkeys(found)
        if name.startswith(start) and name not in taken and name.isprintable()
    ]


def _columns_of(file: Path) -> tuple[str, ...]:
    from dynsr.data import read_names_only
    from dynsr.errors import InputError

    try:
        return read_names_only(file)
    except (InputError, OSError, ValueError):  # the command itself will say so
        return ()


def complete_scheme(incomplete: str) -> list[str]:
    """Offer the schemes of slopes to the shell."""
    from dynsr.data import SCHEMES, SMOOTHERS

    names = ("auto", *SCHEMES, "savgol(11,3)", *SMOOTHERS)
    return [name for name in names if name.startswith(incomplete)]


def complete_loss(incomplete: str) -> list[str]:
    """Offer the losses to the shell."""
    from dynsr.fit import LOSSES

    return [name for name in LOSSES if name.startswith(incomplete)]


Json = Annotated[
    bool, typer.Option("--json", help="Print JSON alone on stdout.", rich_help_panel=OUTPUT)
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress.", rich_help_panel=OUTPUT)
]
Engine = Annotated[
    str,
    typer.Option(
        help="embedded, or julia (DifferentialEquations.jl and DataDrivenDiffEq.jl).",
        autocompletion=complete_engine,
        rich_help_panel=NUMERICS,
    ),
]
OwnEngine = Annotated[
    str | None,
    typer.Option(
        "--engine",
        help="embedded or julia; that of the discovery by default.",
        autocompletion=complete_engine,
        rich_help_panel=NUMERICS,
    ),
]
Seed = Annotated[
    int,
    typer.Option(min=0, help="Seed of all randomness; same seed, same result.", show_default=True),
]
Jobs = Annotated[int, typer.Option("--jobs", "-j", help="Processes; -1 uses every core.")]
Reltol = Annotated[float, typer.Option(help="Relative tolerance.", rich_help_panel=NUMERICS)]
Abstol = Annotated[float, typer.Option(help="Absolute tolerance.", rich_help_panel=NUMERICS)]
Step = Annotated[
    float | None,
    typer.Option(
        "--dt",
        help="Time between rows, in the unit of the data or else seconds.",
        rich_help_panel=DATA,
    ),
]
Span = Annotated[
    str | None,
    typer.Option(help="First and last time, such as 0,10.", rich_help_panel=DATA),
]
Start = Annotated[
    str | None,
    typer.Option("--x0", help="Start state, one number for each state: 1,1.", rich_help_panel=DATA),
]
OutFile = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="File to write (.csv or .tsv).", rich_help_panel=OUTPUT),
]


Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Replace the file of --out if it is there.", rich_help_panel=OUTPUT
    ),
]


Names = list[str] | None

TimeColumn = Annotated[
    str | None,
    typer.Option(
        "--time",
        help="Time column, or the step between rows: 0.1.",
        autocompletion=complete_column,
        rich_help_panel=DATA,
    ),
]
StateColumns = Annotated[
    Names,
    typer.Option(
        "--states",
        help="State columns: x,y.",
        autocompletion=complete_column,
        rich_help_panel=DATA,
    ),
]
Inputs = Annotated[
    Names,
    typer.Option(
        "--inputs",
        help='Input columns, or expressions in t: u or "F=0.5*sin(6*t)".',
        autocompletion=complete_column,
        rich_help_panel=DATA,
    ),
]
Hold = Annotated[
    Names,
    typer.Option(
        "--hold",
        help="What inputs do between rows: previous (keep the value), linear or smooth. For all "
        "inputs, or for each: u=previous,v=linear.",
        rich_help_panel=DATA,
    ),
]
Doses = Annotated[
    Names,
    typer.Option(
        "--dose",
        "--doses",
        help="State that jumps right after a row, and the column of the amounts: x=dose; x=dose/V "
        "with a volume V that is fitted. Also a table of doses: doses.csv with time and amount.",
        rich_help_panel=DATA,
    ),
]
KnownNoise = Annotated[
    Names,
    typer.Option(
        "--noise",
        help="Known measurement errors of states: a standard deviation in the state's units, a "
        "share of its value, or a column of errors: x=0.1,y=5%,z=z_sd.",
        rich_help_panel=DATA,
    ),
]
Limits = Annotated[
    Names,
    typer.Option(
        "--limit",
        "--limits",
        help="Limits of measurement. Values at or below x=0.05, and cells such as BDL, say only "
        "that x was below it. Also the end of the range, 'x=>100', both, x=0.05..100, or a column "
        "of limits, x=x_lod.",
        rich_help_panel=DATA,
    ),
]
Observed = Annotated[
    Names,
    typer.Option(
        "--observed",
        help="A column that is a sum of states, of which one has no column: total=S+I.",
        rich_help_panel=DATA,
    ),
]
Delays = Annotated[
    str | None,
    typer.Option(
        "--delays",
        help="Let equations contain states and inputs as they were some time before: auto, or "
        "about how long.",
        metavar="auto|TIME,...",
        rich_help_panel=SEARCH,
    ),
]
Hidden = Annotated[
    str | None,
    typer.Option(
        "--hidden",
        help="Name of one more state, which nobody measured; its equation is searched too.",
        metavar="NAME",
        rich_help_panel=SEARCH,
    ),
]
Vary = Annotated[
    str | None,
    typer.Option(
        "--vary",
        help="Let constants differ from trajectory to trajectory: all, or those in the equations "
        "of some states: x,y. The description length decides which are shared.",
        metavar="all|STATE,...",
        rich_help_panel=SEARCH,
    ),
]
TrajectoryColumn = Annotated[
    str | None,
    typer.Option(
        "--trajectory",
        help="Column that names the trajectories; several with commas.",
        autocompletion=complete_column,
        rich_help_panel=DATA,
    ),
]
Decimal = Annotated[
    str | None,
    typer.Option(
        "--decimal",
        metavar="MARK",
        help="Decimal mark of numbers in text: . or , if the file leaves it open.",
        rich_help_panel=DATA,
    ),
]
Missing = Annotated[
    str | None,
    typer.Option(
        "--missing",
        metavar="NUMBERS",
        help="Numbers that stand for no value: -999,-1; none for no number. By default usual ones "
        "far from all others.",
        rich_help_panel=DATA,
    ),
]
Quantity = Annotated[
    str | None,
    typer.Option(
        "--quantity",
        help="Column of a long table that names the quantity of each row; none for no column.",
        autocompletion=complete_column,
        rich_help_panel=DATA,
    ),
]
MethodName = Annotated[
    str,
    typer.Option(
        "--method",
        help=f"{describe_methods()}. Several with commas.",
        autocompletion=complete_method,
        rich_help_panel=SEARCH,
    ),
]
Preset = Annotated[
    str,
    typer.Option(
        help=f"{describe_presets()}.", autocompletion=complete_preset, rich_help_panel=SEARCH
    ),
]

SAY = "What you know"
Functions = Annotated[
    str | None,
    typer.Option(
        help="Functions that equations may contain: exp,sqrt; none for sums and ratios of powers. "
        "Operators too: +,* excludes /, and ** adds powers like x**0.7.",
        rich_help_panel=SAY,
    ),
]
MaxComplexity = Annotated[
    float | None,
    typer.Option(
        help="The most bits of an equation; each fitted constant counts as one symbol.",
        rich_help_panel=SAY,
    ),
]
Complexity = Annotated[
    Names,
    typer.Option(
        help="Additional bits for each function or operator: sin=8,/=4.",
        rich_help_panel=SAY,
    ),
]
Loss = Annotated[
    str | None,
    typer.Option(
        help="How a residual counts when formulas are ranked on slopes: squared, absolute, huber "
        "or cauchy.",
        autocompletion=complete_loss,
        rich_help_panel=SAY,
    ),
]
Terms = Annotated[
    Names,
    typer.Option(
        "--terms",
        "--term",
        help='Your own terms to try: "x*y/(1+x)".',
        rich_help_panel=SAY,
    ),
]
Must = Annotated[
    Names,
    typer.Option(
        "--must",
        help='Term that an equation must contain, with a fitted coefficient: "x: x*y".',
        rich_help_panel=SAY,
    ),
]
Constraint = Annotated[
    Names,
    typer.Option(
        "--constraints",
        "--constraint",
        help='Sign of a coefficient, or a forbidden term: "x: x*y < 0", "x: x**2 = 0".',
        rich_help_panel=SAY,
    ),
]
Conserved = Annotated[
    Names,
    typer.Option(help="Sums of states that do not change: S+I+R.", rich_help_panel=SAY),
]
Nonnegative = Annotated[
    Names,
    typer.Option(help="States that never fall below 0: x,y.", rich_help_panel=SAY),
]
Units = Annotated[
    str | None,
    typer.Option(
        help="Units of the columns, which equations must respect: x=m,v=m/s,t=s; or the word "
        "columns, for units in brackets in the names of the columns.",
        rich_help_panel=SAY,
    ),
]
TimeBudget = Annotated[
    float | None,
    typer.Option(help="Seconds after which the best result so far is taken.", rich_help_panel=SAY),
]


def read_functions(text: str | None) -> list[str] | None:
    """Read names of functions and operators; an empty list for "" and "none".

    >>> read_functions("exp, sqrt"), read_functions("none"), read_functions(None)
    (['exp', 'sqrt'], [], None)
    """
    if text is None:
        return None
    names = text.replace(",", " ").split()
    return [] if names == ["none"] else names


def read_numbers(text: str | None, option: str, count: int | None = None) -> list[float] | None:
    """Read ``1,2.5`` as numbers; raises InputError that names the option.

    >>> read_numbers("0, 10", "--span", 2)
    [0.0, 10.0]
    """
    from dynsr.errors import InputError

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    finite = all(abs(number) < float("inf") for number in numbers)
    if not numbers or not finite or (count is not None and len(numbers) != count):
        many = "numbers" if count is None else f"{count} numbers"
        raise InputError(f"{option} {text!r} is not {many}; write them like 0,10")
    return numbers


def read_names(values: Sequence[str] | None, option: str = "") -> list[str] | None:
    """Split repeated or comma-separated names; None where the option was not given.

    Raises InputError, with the name of the ``option`` if it is given, where no name is left.

    >>> read_names(["x,y", "z"])
    ['x', 'y', 'z']
    """
    if not values:
        return None
    names = [part.strip() for value in values for part in value.split(",") if part.strip()]
    if option and not names:
        from dynsr.errors import InputError

        raise InputError(f"{option} names nothing; name at least one, or leave the option out")
    return names


def read_pairs(values: Sequence[str] | None, option: str) -> dict[str, float] | None:
    """Read ``sin=8,/=4`` as numbers by name; None where the option was not given.

    Raises InputError that names what is not such a pair.

    >>> read_pairs(["sin=8,/=4.5"], "--complexity")
    {'sin': 8.0, '/': 4.5}
    """
    from dynsr.errors import InputError

    names = read_names(values, option)
    if names is None:
        return None
    found: dict[str, float] = {}
    for pair in names:
        name, _, number = pair.rpartition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            name = ""
        if not name.strip():
            raise InputError(f"{option} {pair!r} must be a name and a number, such as sin=8")
    return found


def read_hold(values: Sequence[str] | None) -> dict[str, str] | str | None:
    """Read ``previous``, or ``u=previous,v=linear``; None where the option was not given.

    Raises InputError that names what is neither of them.

    >>> read_hold(["u=previous,v=linear"]), read_hold(["smooth"]), read_hold(None)
    ({'u': 'previous', 'v': 'linear'}, 'smooth', None)
    """
    from dynsr.errors import InputError

    names = read_names(values, "--hold")
    if names is None:
        return None
    if len(names) == 1 and "=" not in names[0]:
        return names[0]
    pairs = [name.rpartition("=") for name in names]
    wrong = [name for name, (key, _, _) in zip(names, pairs, strict=True) if not key.strip()]
    if wrong:
        raise InputError(
            f"--hold {wrong[0]!r} must be an input and a word, such as u=previous, or one word "
            "for all"
        )
    return {key.strip(): word.strip() for key, _, word in pairs}


def read_doses(values: Sequence[str] | None) -> dict[str, str] | None:
    """Read ``x=dose`` as the column of the amounts given to a state; None without the option.

    Raises InputError that names what is not such a pair.

    >>> read_doses(["x=dose"]), read_doses(None)
    ({'x': 'dose'}, None)
    """
    return _read_texts(
        values, "--dose", "a state and a column, such as x=dose, or a table of doses"
    )


def read_observed(values: Sequence[str] | None) -> dict[str, str] | None:
    """Read ``total=S+I`` as the sum of states that a column is; None without the option.

    Raises InputError that names what is not such a pair.

    >>> read_observed(["total=S + I"]), read_observed(None)
    ({'total': 'S + I'}, None)
    """
    return _read_texts(values, "--observed", "a column and a sum of states, such as total=S+I")


def _read_texts(values: Sequence[str] | None, option: str, what: str) -> dict[str, str] | None:
    from dynsr.errors import InputError

    names = read_names(values, option)
    if names is None:
        return None
    pairs = {name: name.partition("=") for name in names}
    for name, (left, _, right) in pairs.items():
        if not left.strip() or not right.strip():
            raise InputError(f"{option} {name!r} must be {what}")
    return {left.strip(): right.strip() for left, _, right in pairs.values()}


def read_noise(values: Sequence[str] | None) -> dict[str, str] | None:
    """Read ``x=0.1,y=5%,z=z_sd`` as what is said of the noise of states; None without the option.

    Raises InputError that names what is not such a pair.

    >>> read_noise(["x=0.1,y=5%"]), read_noise(None)
    ({'x': '0.1', 'y': '5%'}, None)
    """
    return _read_texts(values, "--noise", "a state and its errors, such as x=0.1, x=5% or x=x_sd")


def read_limits(values: Sequence[str] | None) -> dict[str, str] | None:
    """Read ``x=0.05,y=>100`` as the limits of states; None without the option.

    Raises InputError that names what is not such a pair.

    >>> read_limits(["x=0.05,y=>100"]), read_limits(None)
    ({'x': '0.05', 'y': '>100'}, None)
    """
    return _read_texts(values, "--limit", "a state and its limit, such as x=0.05 or 'x=>100'")


def read_orders(values: Sequence[str] | None) -> int | dict[str, int]:
    """Read ``2``, or ``x=2,y=1``, as the order of all equations or of each; 1 without any.

    Raises InputError that names what is no order.

    >>> read_orders(["2"]), read_orders(["x=2", "y=1"]), read_orders(None)
    (2, {'x': 2, 'y': 1}, 1)
    """
    from dynsr.errors import InputError

    names = read_names(values) or ["1"]
    pairs = [name.rpartition("=") for name in names]
    for text, (_, _, number) in zip(names, pairs, strict=True):
        if number.strip() not in ("1", "2"):
            raise InputError(f"--order {text!r} must end in 1 or 2; write 2, or x=2 for one state")
    if len(pairs) > 1 and not all(state for state, _, _ in pairs):
        raise InputError(f"--order {','.join(names)!r} mixes all states with single ones")
    if not pairs[0][0]:
        return int(pairs[0][2])
    return {state.strip(): int(number) for state, _, number in pairs}


def read_vary(text: str | None) -> bool | list[str]:
    """Give whether constants may differ, or the states in whose equations.

    >>> read_vary("all"), read_vary("x, y"), read_vary(None)
    (True, ['x', 'y'], False)
    """
    if text is None or text == "all":
        return text is not None
    return [name.strip() for name in text.split(",")]


def read_delays(text: str | None) -> bool | list[float]:
    """Give whether there may be delays, or about how long they are; raises InputError.

    >>> read_delays("auto"), read_delays("1.5,3"), read_delays(None)
    (True, [1.5, 3.0], False)
    """
    from dynsr.errors import InputError

    if text is None or text == "auto":
        return text is not None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--delays {text!r} must be auto, or times such as 1.5") from None
