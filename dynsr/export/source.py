"""Source: what an exporter is given, in names that its language allows."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import sympy

from dynsr import __version__
from dynsr.data import System, Trajectory
from dynsr.discovery import Discovery
from dynsr.errors import InputError
from dynsr.expression import (
    call_names,
    check_name,
    differentiate,
    with_signs,
    write_line,
    write_out,
)
from dynsr.parameters import Delay, Parameters, ParametricSystem, write_interval

_TEXT = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'")
_IDENTIFIER = re.compile(r"(?<![.\w])[^\W\d]\w*")
_DEFINED = re.compile(r"\b(?:def|class) \w+")
_EXAMPLE = "if __name__"
_LONGEST = 48


@dataclass(frozen=True)
class Source:
    """What an exporter writes.

    Parameters
    ----------
    system : the equations with their named parameters.
    runs : the data; empty where they are not there.
    noise : state -> standard deviation of its measurement noise, where it is known.
    methods, engine : what found the equations, for citations.
    own : name in the code -> name in the equations, where they differ.
    calls : input -> the name by which a call gives it, where that is another than in the code.
    dosed : states that were given doses, which are no part of the equations.
    delays : input -> the state, or other input, and the delay that it is.
    curves : what functions that are curves are, in words.
    chance : what is known of noise in the motion, which is no part of the equations, in words.
    begun : the data whose empty cells are on curves, from the start that the equations have.
    """

    system: ParametricSystem
    runs: tuple[Trajectory, ...] = ()
    noise: Mapping[str, float] | None = None
    methods: tuple[str, ...] = ()
    engine: str = ""
    own: Mapping[str, str] | None = None
    calls: Mapping[str, str] | None = None
    dosed: tuple[str, ...] = ()
    delays: Mapping[str, Delay] = field(default_factory=dict)
    curves: tuple[str, ...] = ()
    chance: tuple[str, ...] = ()
    begun: tuple[Trajectory, ...] = ()

    @classmethod
    def of(cls, found: Discovery | ParametricSystem | System) -> Source:
        """Give what is written of a discovery or of a system.

        Parameters
        ----------
        found : the discovery, or a system with or without named parameters.
        """
        if isinstance(found, System):
            return cls(ParametricSystem.of(found))
        if isinstance(found, ParametricSystem):
            return cls(found)
        given = found.settings.get("doses")
        doses = given if isinstance(given, Mapping) else {}
        # A verdict has the noise as a share of the spread.
        data = found.data_summary
        noise = {
            state: own.noise * data.spread[state]
            for state, own in found.verdict.states.items()
            if data and state in data.spread
        }
        return cls(
            found.system,
            found.trajectories,
            noise,
            tuple(map(str, found.settings.get("methods", ()))),
            str(found.settings.get("engine", "")),
            dosed=tuple(state for state in found.equations if state in doses),
            delays=found.delays,
            curves=tuple(f"{part.text}." for part in found.free.curves.values()),
            chance=tuple(found.noise_notes.values()),
            begun=found.carried if data else (),
        )

    @property
    def written_out(self) -> Source:
        """The same with formulas in the places of curves: a line, and cubes of distances."""
        if not self.curves:
            return self
        equations = {s: write_out(e) for s, e in self.system.equations.items()}
        said = "Where the data end, a curve goes on as a line; it is written as cubes of distances."
        return replace(
            self,
            system=replace(self.system, equations=equations),
            curves=(*self.curves, said),
        )

    @property
    def in_numbers(self) -> Source:
        """The same with numbers in the place of parameters."""
        put = {
            sympy.Symbol(n): sympy.Integer(int(v)) if v.is_integer() else sympy.Float(v)
            for n, v in self.parameters.items()
        }
        equations = {s: e.xreplace(put) for s, e in self.system.equations.items()}
        return replace(
            self, system=replace(self.system, equations=equations, parameters=Parameters(()))
        )

    def called(self, name: str) -> str:
        """Give the name by which a call gives an input.

        Parameters
        ----------
        name : of the input in the code.
        """
        return (self.calls or {}).get(name, name)

    @property
    def states(self) -> list[str]:
        """Names of the states."""
        return list(self.system.equations)

    @property
    def columns(self) -> list[str]:
        """Names of the states and inputs."""
        return [*self.system.equations, *self.system.inputs]

    @property
    def parameters(self) -> dict[str, float]:
        """Parameter -> value."""
        return self.system.parameters.numbers

    @property
    def known(self) -> dict[str, sympy.Expr]:
        """Input -> its expression in ``t``."""
        return {n: as_code(e) for n, e in self.system.inputs.items() if e is not None}

    @property
    def measured(self) -> list[str]:
        """Inputs whose values alone are known: the code takes them."""
        return [name for name, expr in self.system.inputs.items() if expr is None]

    @cached_property
    def equations(self) -> dict[str, sympy.Expr]:
        """State -> right-hand side as code can compute it."""
        return {state: as_code(expr) for state, expr in self.system.equations.items()}

    @cached_property
    def jacobian(self) -> list[list[sympy.Expr]]:
        """Derivatives (k, k) of the right-hand sides by the states."""
        columns = [sympy.Symbol(state) for state in self.states]
        return [
            [differentiate(e, c) if c in e.free_symbols else sympy.S.Zero for c in columns]
            for e in self.equations.values()
        ]

    @property
    def start(self) -> list[float]:
        """(k,) values of the states at the first time; ones where the data are not there."""
        return [float(self.system.x0.get(state, 1.0)) for state in self.states]

    @property
    def late(self) -> dict[str, Delay]:
        """Input -> the state and delay that it is; a delayed input is an input as any other."""
        return {name: own for name, own in self.delays.items() if own.state in self.states}

    def refuse_delays(self, title: str, able: Collection[str]) -> None:
        """Raise InputError where the equations have delayed states.

        Parameters
        ----------
        title : the tool that takes none.
        able : the formats that do.
        """
        if self.late:
            raise InputError(f"{title} takes no delay; formats that do: {', '.join(able)}")

    @property
    def timed(self) -> bool:
        """Whether the right-hand sides contain the time, themselves or in an input."""
        return "t" in self.needed(*self.equations.values())

    def needed(self, *exprs: sympy.Expr) -> set[str]:
        """Give the names that expressions hold, with those that their known inputs hold.

        Parameters
        ----------
        exprs : the expressions.
        """
        found = {str(s) for e in exprs for s in e.free_symbols}
        return found | {
            str(s) for n in found & self.known.keys() for s in self.known[n].free_symbols
        }

    def about(self) -> Iterator[str]:
        """Give lines of a comment: who made it, the unit of the time, the parameters."""
        kind = "a map, from one row to the next" if self.system.discrete else "equations"
        yield f"Made by dynsr {__version__}: {kind}."
        for new, old in (self.own or {}).items():
            if self.called(new) != old:
                yield f"{new} is {old}."
        if self.system.time_unit:
            yield f"The time t is in {self.system.time_unit}."
        if self.chance:
            yield "These are the drift alone; the noise in the motion is no part of them."
        yield from self.chance
        for state in self.dosed:
            yield f"Doses of {state} are no part of the equations: add them to the state."
        if self.timed and self.system.span[0]:
            yield f"The states begin at t = {self.system.span[0]:g}."
        for p in self.system.parameters.values():
            unit = f" {p.unit}" if p.unit else ""
            known = p.low is not None or p.high is not None
            within = f" (95 %: {write_interval(p.low, p.high)})" if known else ""
            yield f"{p.name} = {p.value:.6g}{unit}{within}"
        yield from self.curves
        for name, own in self.delays.items():
            given = "" if name in self.late else "; give it as an input"
            yield f"{self.called(name)} is {own.text}{given}."
        for name in self.measured:
            if name not in self.delays:
                yield f"{self.called(name)} is an input whose values were measured."

    def comment(self, mark: str) -> str:
        """Give the lines of :meth:`about` behind the mark of a comment.

        Parameters
        ----------
        mark : such as "#".
        """
        return "".join(f"{mark} {line}\n" for line in self.about())

    def lines(self) -> list[str]:
        """Give the equations in words of a person."""
        names, discrete = self.system.parameters, self.system.discrete
        return [write_line(s, e, discrete, first=names) for s, e in self.system.equations.items()]


def as_code(expr: sympy.Expr) -> sympy.Expr:
    """Give an expression with floats for fractions and pi, and signs for roots of squares.

    Parameters
    ----------
    expr : the expression.

    >>> as_code(sympy.pi * sympy.Symbol("x") / 2)
    1.5707963267949*x
    """
    return _plain(with_signs(expr))


def _plain(expr: sympy.Expr) -> sympy.Expr:
    if expr.is_number:
        return expr if expr.is_Integer else sympy.Float(float(expr))
    return expr.func(*map(_plain, expr.args)) if expr.args else expr


@dataclass(frozen=True)
class Words:
    """What a language allows as a name.

    Parameters
    ----------
    kept : words that name no variable.
    comment : what begins a comment that runs to the end of a line.
    fold : whether capitals are small letters.
    shared : whether a name may be no word that the code itself uses.
    local : whether names are set within functions alone, so that an example hides none of them.
    underscore : whether a name may begin with an underscore.
    """

    kept: Collection[str] = ()
    comment: str = "#"
    fold: bool = False
    shared: bool = True
    local: bool = False
    underscore: bool = False


def name_in(source: Source, words: Words, write: Callable[[Source], str]) -> Source:
    """Give a source in which no name of the equations is one that code or language uses.

    Parameters
    ----------
    source : what is written.
    words : what the language allows.
    write : writes the code.

    Raises InputError where a name could not be used in a formula, and so would not in code.
    """
    names = [*source.states, *source.parameters, *source.system.inputs]
    for name in names:
        check_name(name)
    # Names that can be none of the code's own show which those are.
    blank = {name: f"blank{place}q" for place, name in enumerate(names)}
    code = _TEXT.sub("", write(_renamed(source, blank)))
    code = re.sub(rf"{re.escape(words.comment)}.*", "", code)
    if words.local:
        code = _DEFINED.sub("", code.partition(_EXAMPLE)[0])

    def folded(name: str) -> str:
        return name.lower() if words.fold else name

    used = _IDENTIFIER.findall(code) if words.shared else []
    taken = {folded(n) for n in (*used, *words.kept, "t")}
    taken -= {*blank.values()}
    new: dict[str, str] = {}
    calls: dict[str, str] = {}
    given = call_names(source.system.in_numbers)
    for name in names:
        called = other = plain_name(given.get(name, name), words.underscore)
        while folded(other) in taken:
            other += "_"
        taken.add(folded(other))
        new[name] = other
        if name in source.measured:
            kept = {*calls.values(), *(new[n] for n in source.parameters)}
            calls[other] = called if called not in kept else other
    return replace(_renamed(source, new), calls=calls)


def plain_name(name: str, underscore: bool = False) -> str:
    """Give a name in ASCII that begins with a letter, as every language takes it.

    Parameters
    ----------
    name : a name of the equations.
    underscore : whether it may begin with an underscore.

    >>> [plain_name(name) for name in ("x", "\u03b8_1", "na\u00efve", "_x", "\u6e29")]
    ['x', 'theta_1', 'naive', 'v_x', 'u6e29']
    """
    found = "".join(map(_plain_letter, unicodedata.normalize("NFKD", name)))[:_LONGEST]
    return found if found[:1].isalpha() or (underscore and found[:1] == "_") else f"v{found}"


def _plain_letter(letter: str) -> str:
    if letter.isascii():
        return letter
    if unicodedata.combining(letter):
        return ""
    called = unicodedata.name(letter, "")
    greek = called.startswith("GREEK") and " LETTER " in called
    return called.split()[-1].lower() if greek else f"u{ord(letter):x}"


def _renamed(source: Source, new: Mapping[str, str]) -> Source:
    """Give a source with other names, noting those that differ."""
    swaps = {sympy.Symbol(a): sympy.Symbol(b) for a, b in new.items()}
    system = source.system
    changed = replace(
        system,
        equations={new[s]: e.xreplace(swaps) for s, e in system.equations.items()},
        parameters=Parameters(
            [
                replace(p, name=new[n], states=tuple(new.get(s, s) for s in p.states))
                for n, p in system.parameters.items()
            ]
        ),
        inputs={new[name]: expr for name, expr in system.inputs.items()},
        x0={new[s]: v for s, v in system.x0.items()},
    )
    noise = source.noise and {new.get(s, s): v for s, v in source.noise.items()}
    own = {b: a for a, b in new.items() if a != b and not b.startswith("blank")}
    delays = {new[n]: replace(d, state=new.get(d.state, d.state)) for n, d in source.delays.items()}
    return replace(source, system=changed, noise=noise, own=own, delays=delays)


def times(source: Source) -> tuple[float, float, int]:
    """Give the first time, the last one, and how many rows the data have between.

    Parameters
    ----------
    source : what is written.
    """
    start, end = source.system.span
    return start, end, max(2, round((end - start) / source.system.step) + 1)


def number(value: float) -> str:
    """Write a number with all its digits.

    Parameters
    ----------
    value : the number.

    >>> number(2), number(1 / 3)
    ('2.0', '0.3333333333333333')
    """
    assert math.isfinite(value)
    return repr(float(value))
