"""Demands: what the user asks of the equations, read once and kept by every step of a discovery.

Functions and operators, length and terms bound every search (:class:`dynsr.methods.Limits`); signs,
conservation and positivity are asked of the equations themselves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError, quoted
from dynsr.expression import (
    Units,
    Vocabulary,
    bare_term,
    evaluate,
    parse,
    read_units,
    to_text,
)
from dynsr.fit import (
    Candidate,
    loosen,
    missing_terms,
    refit,
    score_candidate,
    structure_bits,
)
from dynsr.methods.limits import Limits

SIGNS = {"-": "negative", "+": "positive", "0": "zero"}
_CONSTRAINT = re.compile(r"\s*(\w+)\s*:\s*(.+?)\s*(<=?|>=?|==?)\s*0(?:\.0*)?\s*")
_OF_RELATION = {"<": "-", ">": "+", "=": "0"}
# Slopes below this share of their root mean square are rounding.
_ROUNDING = 1e-6

# A coefficient from which the fit of a forced term begins.
_BEGIN = 0.1

Constraints = Mapping[str, Mapping[str, str | int]] | Sequence[str] | str
Must = Mapping[str, str | sympy.Expr | Sequence[str | sympy.Expr]] | Sequence[str] | str


@dataclass(frozen=True)
class SignConstraint:
    """The coefficient of one term of a state's equation is of one sign, or 0.

    Parameters
    ----------
    state : whose equation it is.
    term : the term without its coefficient; 1 is the constant term.
    sign : "-", "+" or "0"; an equation without the term keeps to all of them.
    """

    state: str
    term: sympy.Expr
    sign: str

    def holds(self, expr: sympy.Expr) -> bool:
        """Whether it holds for an equation, multiplied out.

        >>> x, y = sympy.symbols("x y")
        >>> rule = SignConstraint("x", x * y, "-")
        >>> rule.holds(x * (1.5 - y)), rule.holds(x * (1.5 + y)), rule.holds(y)
        (True, False, True)
        """
        coefficient = terms_of(expr).get(self.term, 0.0)
        if self.sign == "0":
            return coefficient == 0
        return coefficient <= 0 if self.sign == "-" else coefficient >= 0

    def __str__(self) -> str:
        """Write it as the command line reads it."""
        relation = {"-": "<", "+": ">", "0": "="}[self.sign]
        return f"{self.state}: {to_text(self.term)} {relation} 0"


def terms_of(expr: sympy.Expr) -> dict[sympy.Expr, float]:
    """Give term -> coefficient of a formula that is multiplied out; 1 is the constant term.

    >>> x = sympy.Symbol("x")
    >>> terms_of(2 * (x + 1))
    {1: 2.0, x: 2.0}
    """
    found: dict[sympy.Expr, float] = {}
    for term in sympy.Add.make_args(sympy.expand(expr)):
        rest = bare_term(term)
        coefficient = term / rest
        if coefficient.is_finite:
            found[rest] = found.get(rest, 0.0) + float(coefficient)
    return found


@dataclass(frozen=True)
class Demands:
    """What the user asks of the equations.

    Parameters
    ----------
    vocabulary : functions and operators that may occur; None allows what the methods use.
    max_complexity : most bits of an equation, each fitted constant counted as one symbol
        (:func:`dynsr.fit.structure_bits`).
    terms : terms that the user offers, in the columns.
    constraints : signs of terms.
    conserved : (state, linear combination of states that does not change); the equation of that
        state follows from those of the others.
    nonnegative : states that never fall below 0.
    units : the units of columns, in which formulas must make sense.
    must : (state, term) that the equation of the state holds, with a coefficient of its own.
    """

    vocabulary: Vocabulary | None = None
    max_complexity: float = math.inf
    terms: tuple[sympy.Expr, ...] = ()
    constraints: tuple[SignConstraint, ...] = ()
    conserved: tuple[tuple[str, sympy.Expr], ...] = ()
    nonnegative: tuple[str, ...] = ()
    units: Units | None = None
    must: tuple[tuple[str, sympy.Expr], ...] = ()

    @property
    def offered(self) -> tuple[sympy.Expr, ...]:
        """Every term that the user named for the equations."""
        return tuple(dict.fromkeys([*self.terms, *(term for _, term in self.must)]))

    @property
    def asked(self) -> bool:
        """Whether anything is asked at all."""
        return self != Demands()

    def limits(self, state: str) -> Limits:
        """Give what the search for one state's equation may use.

        Parameters
        ----------
        state : whose equation is searched.
        """
        never = tuple(c.term for c in self.constraints if c.state == state and c.sign == "0")
        own = [term for s, term in self.must if s == state]
        terms = tuple(dict.fromkeys([*self.terms, *own]))
        return Limits(self.vocabulary, terms, never, self.max_complexity)

    def lacking(self, state: str, expr: sympy.Expr) -> list[sympy.Expr]:
        """Give the terms that an equation must hold and does not.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation, its known part included.
        """
        return missing_terms(expr, [term for s, term in self.must if s == state])

    def force(self, state: str, expr: sympy.Expr, known: sympy.Expr = sympy.S.Zero) -> sympy.Expr:
        """Give an equation with the terms that it must hold, their coefficients to be fitted.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation without its known part.
        known : that part.

        >>> x, y = sympy.symbols("x y")
        >>> Demands(must=(("x", x * y),)).force("x", 2 * x)
        0.1*x*y + 2*x
        """
        missing = self.lacking(state, known + expr)
        return sympy.Add(expr, *(sympy.Float(_BEGIN) * term for term in missing))

    def allows(self, expr: sympy.Expr) -> bool:
        """Whether a formula keeps to the functions, operators, length and units allowed.

        Parameters
        ----------
        expr : the formula.
        """
        if self.vocabulary is not None and not self.vocabulary.allows(expr):
            return False
        if self.units is not None and self.units.fault(expr):
            return False
        return math.isinf(self.max_complexity) or structure_bits(expr) <= self.max_complexity

    def broken(self, state: str, expr: sympy.Expr) -> list[SignConstraint]:
        """Give the constraints on signs that an equation breaks.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation, its known part included.
        """
        return [c for c in self.constraints if c.state == state and not c.holds(expr)]

    def drop_broken(
        self, state: str, expr: sympy.Expr, known: sympy.Expr = sympy.S.Zero
    ) -> sympy.Expr:
        """Give an equation without the terms that break a constraint; itself where none does.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation without its known part.
        known : that part.
        """
        broken = {c.term for c in self.broken(state, known + expr)}
        if not broken:
            return expr
        kept = [
            term
            for term in sympy.Add.make_args(sympy.expand(expr))
            if bare_term(term) not in broken
        ]
        return sympy.Add(*kept)

    def stays_positive(
        self, state: str, expr: sympy.Expr, columns: Mapping[str, np.ndarray]
    ) -> bool:
        """Whether an equation lets a state that may not fall below 0 fall there.

        The slope at 0 must not be negative, wherever the other columns have been. Where it is not
        finite at 0, as x log x, it is taken a billionth of the largest value above.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation.
        columns : name -> (n,) values of the data.
        """
        if state not in self.nonnegative:
            return True
        size = float(np.abs(columns[state]).max())
        at_zero = {**columns, state: np.zeros_like(columns[state])}
        slopes = evaluate(expr, at_zero)
        if not np.all(np.isfinite(slopes)):
            above = {**columns, state: np.full_like(columns[state], 1e-9 * size)}
            slopes = np.where(np.isfinite(slopes), slopes, evaluate(expr, above))
        usual = float(np.sqrt(np.mean(np.square(np.nan_to_num(evaluate(expr, columns))))))
        return bool(np.all(slopes >= -_ROUNDING * usual))

    def keeps(
        self, state: str, expr: sympy.Expr, columns: Mapping[str, np.ndarray] | None = None
    ) -> bool:
        """Whether an equation keeps to every demand on it.

        Parameters
        ----------
        state : whose equation it is.
        expr : the equation.
        columns : name -> (n,) values of the data, for the slopes at 0; without, these are not
            looked at.
        """
        if not self.allows(expr) or self.broken(state, expr) or self.lacking(state, expr):
            return False
        return columns is None or self.stays_positive(state, expr, columns)

    def keep_all(self, equations: Mapping[str, sympy.Expr]) -> bool:
        """Whether every equation keeps to the demands, its slopes at 0 aside.

        Parameters
        ----------
        equations : state -> equation.
        """
        return not self.asked or all(self.keeps(s, e) for s, e in equations.items())

    def select(
        self,
        pool: Iterable[Candidate],
        samples: Samples,
        known: sympy.Expr = sympy.S.Zero,
    ) -> list[Candidate]:
        """Give the formulas of a pool that keep to the demands, and 0 where none does.

        Ctrl-C ends it with those that were looked at.

        A formula that breaks a sign loses the terms that do, its other constants are fitted again,
        and it is looked at once more.

        Parameters
        ----------
        pool : formulas for the samples' target.
        samples : what they are fitted to.
        known : the given part of the equation, which the samples leave out.
        """
        if not self.asked:
            return list(pool)
        kept: dict[sympy.Expr, Candidate] = {}
        with suppress(KeyboardInterrupt):
            for candidate in pool:
                if not self.allows(candidate.expr):
                    continue
                mended = self._mend(candidate, samples, known)
                if mended is not None:
                    kept.setdefault(mended.expr, mended)
        if not kept:
            least = self.force(samples.target, sympy.S.Zero, known)
            return [score_candidate(refit(least, samples), samples, "no term")]
        return list(kept.values())

    def _mend(self, candidate: Candidate, samples: Samples, known: sympy.Expr) -> Candidate | None:
        state = samples.target
        for _ in range(1 + len(self.constraints)):
            rest = self.drop_broken(state, candidate.expr, known)
            if rest == candidate.expr:
                break
            fitted = refit(loosen(rest), samples) if rest.free_symbols else rest
            candidate = score_candidate(fitted, samples, candidate.source)
        else:
            return None
        whole = self.force(state, candidate.expr, known)
        if whole != candidate.expr:
            candidate = score_candidate(refit(loosen(whole), samples), samples, candidate.source)
        positive = self.stays_positive(state, known + candidate.expr, samples.timed)
        return candidate if positive and self.allows(candidate.expr) else None

    def complete(self, equations: Mapping[str, sympy.Expr]) -> dict[str, sympy.Expr]:
        """Add the equations that follow from what is conserved, where the others are there.

        Parameters
        ----------
        equations : state -> equation, of all other states of the combinations.

        >>> S, R = sympy.symbols("S R")
        >>> Demands(conserved=(("R", S + R),)).complete({"S": -0.1 * S})
        {'S': -0.1*S, 'R': 0.1*S}
        """
        found = dict(equations)
        for state, total in self.conserved:
            shares = {str(symbol): share for symbol, share in terms_of(total).items()}
            if not {*shares} <= {*found, state}:
                continue
            others = sympy.Add(
                *(_factor(v / shares[state]) * found[s] for s, v in shares.items() if s != state)
            )
            found[state] = sympy.expand(-others)
        return found

    def as_record(self) -> dict[str, object]:
        """Give what was asked, as plain values; nothing for what was not."""
        vocabulary = self.vocabulary
        record: dict[str, object] = {
            "terms": [to_text(term) for term in self.terms],
            "constraints": [str(constraint) for constraint in self.constraints],
            "conserved": [to_text(total) for _, total in self.conserved],
            "nonnegative": list(self.nonnegative),
            "must": [f"{state}: {to_text(term)}" for state, term in self.must],
        }
        record = {name: value for name, value in record.items() if value}
        if vocabulary is not None:
            record["functions"] = [
                *vocabulary.functions,
                *(["/"] if vocabulary.divide else ["+", "-", "*"]),
                *(["**"] if vocabulary.power else []),
            ]
        if not math.isinf(self.max_complexity):
            record["max_complexity"] = self.max_complexity
        return record


def _factor(value: float) -> sympy.Expr:
    return sympy.Integer(int(value)) if value.is_integer() else sympy.Float(value)


def read_demands(
    states: Sequence[str],
    names: Sequence[str],
    *,
    functions: Sequence[str] | None = None,
    max_complexity: float | None = None,
    terms: Sequence[str | sympy.Expr] = (),
    constraints: Constraints | None = None,
    conserved: Sequence[str | sympy.Expr] = (),
    nonnegative: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    must: Must | None = None,
) -> Demands:
    """Read what the user asks.

    Parameters
    ----------
    states, names : the states, and all columns of the data.
    functions : names of functions and operators, see :meth:`dynsr.expression.Vocabulary.read`;
        None allows what the methods use.
    max_complexity : most bits of an equation, each fitted constant counted as one symbol.
    terms : terms in the columns, to be searched in addition to the methods' own.
    constraints : state -> term -> "+", "-" or 0; or lines such as "x: x*y < 0".
    conserved : linear combinations of states whose slope is 0.
    nonnegative : states that never fall below 0.
    units : column, or "t", -> its unit.
    must : state -> a term, or several, that its equation holds; or lines such as "x: x*y".

    Raises InputError, one line that names the value, for what cannot be read.

    >>> asked = read_demands(["x"], ["x"], functions=["exp"], constraints={"x": {"x": "-"}})
    >>> asked.as_record()
    {'constraints': ['x: x < 0'], 'functions': ['exp', '/']}
    """
    demands = Demands(
        None if functions is None else Vocabulary.read(functions),
        _read_complexity(max_complexity),
        tuple(_read_term(term, names) for term in _listed(terms)),
        tuple(_read_constraints(constraints, states, names)),
        _read_conserved(_listed(conserved), states),
        tuple(_read_state(state, states, "nonnegative") for state in _listed(nonnegative)),
        None if units is None else _read_units(units, names),
        tuple(dict.fromkeys(_read_must(must, states, names))),
    )
    _check(demands, states)
    return demands


def _read_units(units: Mapping[str, str], names: Sequence[str]) -> Units:
    for name in units:
        if name not in (*names, "t"):
            columns = ", ".join((*names, "t"))
            raise InputError(f"units name {quoted(name)}, which is not one of: {columns}")
    return read_units(units)


def _listed(given: Iterable[Any]) -> list[Any]:
    return [given] if isinstance(given, (str, sympy.Basic)) else list(given)


def _read_complexity(value: float | None) -> float:
    if value is None:
        return math.inf
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        raise InputError(f"max_complexity {value!r} must be a positive number of bits, such as 60")
    return float(value)


def _read_term(term: str | sympy.Expr, names: Sequence[str]) -> sympy.Expr:
    expr = parse(term, names)
    coefficient, rest = expr.as_coeff_Mul()
    if not expr.free_symbols:
        raise InputError(f"term {str(term)!r} is a number; a term contains a column")
    return rest if coefficient.is_finite else expr


def _read_state(state: object, states: Sequence[str], option: str) -> str:
    if state not in states:
        raise InputError(
            f"{option} names {quoted(state)}, which is no state; they are: {', '.join(states)}"
        )
    return str(state)


def _read_constraints(
    given: Constraints | None, states: Sequence[str], names: Sequence[str]
) -> Iterable[SignConstraint]:
    if isinstance(given, Mapping):
        for state, signs in given.items():
            if not isinstance(signs, Mapping):
                raise InputError(
                    f"constraints of {state!r} must map terms to '+', '-' or 0, "
                    "such as {'x*y': '-'}"
                )
            for term, sign in signs.items():
                yield _make_constraint(state, term, str(sign), states, names)
        return
    for line in _listed(given or ()):
        match = _CONSTRAINT.fullmatch(str(line))
        if match is None:
            raise InputError(f"cannot read constraint {quoted(line)}; write it like 'x: x*y < 0'")
        state, term, relation = match.groups()
        yield _make_constraint(state, term, _OF_RELATION[relation[0]], states, names)


def _make_constraint(
    state: str, term: str | sympy.Expr, sign: str, states: Sequence[str], names: Sequence[str]
) -> SignConstraint:
    _read_state(state, states, "constraint")
    if sign not in SIGNS:
        raise InputError(f"constraint on {str(term)!r} is {sign[:20]!r}; it is '+', '-' or 0")
    expanded = sympy.expand(parse(term, names))
    coefficient, rest = expanded.as_coeff_Mul()
    if expanded.is_Number and expanded > 0:
        rest = sympy.S.One
    elif expanded.is_Add or expanded.is_Number or not coefficient > 0:
        raise InputError(
            f"constraint on {str(term)!r} must be on one term without its sign, such as 'x*y'"
        )
    return SignConstraint(state, rest, sign)


def _read_must(
    given: Must | None, states: Sequence[str], names: Sequence[str]
) -> Iterable[tuple[str, sympy.Expr]]:
    pairs: list[tuple[str, Any]] = []
    if isinstance(given, Mapping):
        pairs = [(state, term) for state, own in given.items() for term in _listed(own)]
    else:
        for line in _listed(given or ()):
            state, colon, term = str(line).partition(":")
            if not colon or not term.strip():
                raise InputError(f"cannot read must {quoted(line)}; write it like 'x: x*y'")
            pairs.append((state.strip(), term))
    for state, term in pairs:
        _read_state(state, states, "must")
        expanded = sympy.expand(parse(term, names))
        if expanded.is_Add or expanded == 0:
            raise InputError(
                f"must of {state!r} has {quoted(str(term).strip())}, which is not one term; name "
                "its terms one by one, without their coefficients"
            )
        yield state, bare_term(expanded)


def _read_conserved(
    totals: Sequence[str | sympy.Expr], states: Sequence[str]
) -> tuple[tuple[str, sympy.Expr], ...]:
    """Give each sum with the last of its states, in the data's order, that has none yet."""
    found: dict[str, sympy.Expr] = {}
    for total in totals:
        expr = parse(total, states)
        shares = terms_of(expr)
        if len(shares) < 2 or any(not term.is_Symbol for term in shares):
            raise InputError(
                f"conserved {quoted(total)} must be a sum of at least two states times "
                "numbers, such as 'S + I + R'"
            )
        free = [s for s in states if sympy.Symbol(s) in shares and s not in found]
        if not free:
            raise InputError(
                f"conserved {quoted(total)} leaves no state whose equation could follow; "
                "give fewer sums"
            )
        found[free[-1]] = expr
    return tuple(found.items())


def _check(demands: Demands, states: Sequence[str]) -> None:
    for term in demands.terms:
        if demands.vocabulary is not None and not demands.vocabulary.allows(term):
            raise InputError(
                f"term {to_text(term)!r} contains what functions do not allow; allow it or drop it"
            )
    for state, term in demands.must:
        text = f"must of {state!r} has {to_text(term)!r}"
        if demands.vocabulary is not None and not demands.vocabulary.allows(term):
            raise InputError(f"{text}, which functions do not allow; allow it or drop it")
        if state in dict(demands.conserved):
            raise InputError(f"{text}, but that equation follows from conserved; drop one of them")
        if any((c.state, c.term, c.sign) == (state, term, "0") for c in demands.constraints):
            raise InputError(f"{text}, which a constraint sets to 0; drop one of them")
    signs: dict[tuple[str, sympy.Expr], str] = {}
    for constraint in demands.constraints:
        key = (constraint.state, constraint.term)
        if signs.setdefault(key, constraint.sign) != constraint.sign:
            raise InputError(f"two constraints on {to_text(key[1])!r} of {key[0]!r} contradict")
    totals = [
        [terms_of(total).get(sympy.Symbol(s), 0.0) for s in states]
        for _, total in demands.conserved
    ]
    if totals and np.linalg.matrix_rank(np.array(totals)) < len(totals):
        raise InputError("the conserved sums follow from one another; give each once")
