"""Prior: the bits of writing a system down, by how often textbooks write such a thing.

A system is written equation by equation: how many terms it has, and for each of them whether
an earlier equation has it. A term is a product of factors, and a factor a template such as
v**2, sin(v) or v/(c + v), with columns put in: the state's own, other states, inputs or the time.
How often each of these choices is made is counted in ``corpus.txt`` (priors by counting: Bartlett
et al. 2023); what was never seen costs its length too. Constants are not included: their bits
come from a fit. How often two terms of one form share constants is counted here too.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib.resources import files
from itertools import permutations

import sympy

from dynsr.expression import expand_terms, free_constants, marks, number_bits, parse, unknown_calls
from dynsr.library.repeats import FACTORS, INSIDE, find_repeats

# Choices that were never made have a share too (Krichevsky and Trofimov 1981).
_MORE = 0.5
# Terms and factors from which on each more is as likely as the one before.
_MANY = 9
# Bits of a column that no equation has.
_NEVER = 30.0
# Terms from which on an equation may be a twin.
_TOLD = 3
# Columns of a template that are put into one order; states that are exchanged in all ways.
_ORDERED, _EXCHANGED = 4, 5
ROLES = ("own", "state", "input", "time")
CHOICES = (
    "terms",
    "factors",
    "template",
    "role of a power",
    "role in a function",
    "role",
    "cited",
    "again",
    "repeated",
    "twin",
    INSIDE,
    *FACTORS,
)
_FILES = files("dynsr.library")
_CONSTANT = sympy.Symbol("c")


@dataclass(frozen=True, order=True)
class Factor:
    """A template and the columns in it, in the order of its places."""

    template: str
    columns: tuple[str, ...]

    @property
    def plain(self) -> bool:
        """Whether it is a power of one column."""
        return re.fullmatch(r"v0(\*\*(\d+|c|\([-\d/]+\)))?|1/v0", self.template) is not None

    @property
    def roles(self) -> str:
        """The choice of CHOICES that counts what its columns are."""
        return "role of a power" if self.plain else "role in a function"


Term = tuple[Factor, ...]


def _functions(term: Term) -> dict[Factor, None]:
    return dict.fromkeys(factor for factor in term if not factor.plain)


@lru_cache(maxsize=50_000)
def read_term(body: sympy.Expr) -> Term:
    """Take a product apart; what saturates is one factor.

    Parameters
    ----------
    body : the product; pi stands for every constant.

    >>> x, y = sympy.symbols("x y")
    >>> [f.template for f in read_term(x * y**2 / (y**2 + sympy.pi))]
    ['v0', 'v0**2/(c + v0**2)']
    """
    factors = [f for f in sympy.Mul.make_args(body) if f.free_symbols]
    for line in [f for f in factors if f.is_Pow and f.base.is_Add and f.exp.is_negative]:
        powers = {a.as_coeff_Mul()[1] for a in line.base.args if len(line.base.args) == 2}
        over = [f for f in factors if f in powers]
        if over:
            saturating = min(over, key=lambda f: _read_factor(f * line).template)
            factors.remove(line)
            factors.remove(saturating)
            factors.append(saturating * line)
    return tuple(sorted(map(_read_factor, factors)))


@lru_cache(maxsize=50_000)
def _read_factor(factor: sympy.Expr) -> Factor:
    columns = sorted(factor.free_symbols, key=str)
    ways = permutations(columns) if len(columns) <= _ORDERED else [tuple(columns)]
    written = []
    for way in ways:
        places = {column: sympy.Symbol(f"v{i}") for i, column in enumerate(way)}
        template = str(_without_numbers(factor.xreplace(places))).removeprefix("-")
        written.append((template, tuple(map(str, way))))
    return Factor(*min(written))


def _without_numbers(node: sympy.Expr) -> sympy.Expr:
    """Write c for every constant; of a line that is divided by, one column's is 1."""
    if node.is_number and node.has(sympy.pi):
        return _CONSTANT
    if not node.args:
        return node
    args = [_without_numbers(a) for a in node.args]
    if node.is_Add:
        # A whole number that is added is a constant too.
        args = [_CONSTANT if a.is_Number else a for a in args]
    if node.is_Mul and _CONSTANT in args:
        # Signs and numbers beside a constant are its own.
        args = [a for a in args if not a.is_Number and a != _CONSTANT] + [_CONSTANT]
    if node.is_Pow and node.base.is_Add and node.exp.is_negative:
        args[0] = _monic(args[0])
    return node.func(*args)


def _monic(line: sympy.Expr) -> sympy.Expr:
    """Divide a denominator by the constant of one of its terms with a column."""
    terms = [t for t in line.args if t.free_symbols - {_CONSTANT}]
    scaled = [t for t in terms if t.has(_CONSTANT)]
    if not scaled or len(scaled) < len(terms):
        return line
    first = min(scaled, key=str)
    return sympy.Add(*[t / _CONSTANT if t is first else t for t in line.args])


def read_equation(expr: sympy.Expr) -> list[Term]:
    """Take the terms of a sum apart; those that differ in a constant inside are two.

    Parameters
    ----------
    expr : the sum; constants are floats.

    >>> x = sympy.Symbol("x")
    >>> len(read_equation(0.5 * x * (1 - 0.2 * x))), len(read_equation(0.5 * x + 0.2 * x**2))
    (2, 2)
    >>> len(read_equation(0.5 * x / (x + 1.5) - 0.2 * x / (x + 0.1)))
    2
    """
    numbers = dict.fromkeys(one for one in sympy.preorder_traversal(expr) if one.is_Float)
    # Symbols of their own: nothing cancels.
    signs = ({"positive": True} if c > 0 else {"negative": True} for c in numbers)
    own = [sympy.Symbol(f"constant {i}", **sign) for i, sign in enumerate(signs)]
    return list(_read_shape(expr.xreplace(dict(zip(numbers, own, strict=True))), frozenset(own)))


@lru_cache(maxsize=50_000)
def _read_shape(expr: sympy.Expr, constants: frozenset[sympy.Symbol]) -> tuple[Term, ...]:
    lines = [p for p in expr.atoms(sympy.Pow) if p.base.is_Add and p.exp.is_negative]
    held = {line: sympy.Dummy() for line in lines}
    terms = sympy.Add.make_args(expand_terms(expr.xreplace(held)))
    back = {dummy: line for line, dummy in held.items()}
    factors = (sympy.Mul.make_args(term.xreplace(back)) for term in terms)
    bodies = {sympy.Mul(*[f for f in own if f.free_symbols - constants]) for own in factors}
    like = {c: sympy.pi if c.is_positive else -sympy.pi for c in constants}
    return tuple(sorted((read_body(body.xreplace(like)) for body in bodies), key=str))


def exact_bits(expr: sympy.Expr) -> float:
    """Give the bits of exact numbers where textbooks have constants, such as of 2 in x/(x + 2).

    Parameters
    ----------
    expr : an equation.

    >>> x = sympy.Symbol("x")
    >>> exact_bits(x / (x + sympy.Float(2.1))), exact_bits(-x), exact_bits(1 - 3 * x)
    (0.0, 0.0, 5.0)
    """
    exact = [expr] if expr.is_Rational and expr != 0 else []
    for node in sympy.preorder_traversal(expr):
        if node.is_Add:
            exact += [a for a in node.args if a.is_Rational]
        elif node.is_Mul and node.args[0].is_Rational and abs(node.args[0]) != 1:
            exact.append(node.args[0])
    # One bit more says that it is exact.
    return float(sum(1 + number_bits(number) for number in exact))


def read_body(term: sympy.Expr) -> Term:
    """Take a term apart, whatever its constants.

    Parameters
    ----------
    term : the term, with its coefficient or without.
    """
    body = term.as_coeff_Mul()[1]
    return read_term(body.xreplace(dict.fromkeys(body.atoms(sympy.Float), sympy.pi)))


def write_down(equations: Iterable[tuple[str, sympy.Expr]]) -> Written:
    """Give what equations hold.

    Parameters
    ----------
    equations : states and equations.
    """
    written = Written()
    for state, expr in equations:
        written.add(state, read_equation(expr))
    return written


@dataclass(frozen=True)
class Choice:
    """How often one of several was taken."""

    counts: Mapping[str, int]

    @cached_property
    def _total(self) -> float:
        return sum(self.counts.values()) + _MORE * (len(self.counts) + 1)

    def bits(self, taken: str, among: Iterable[str] | None = None) -> float:
        """Bits of one of those that can be taken."""
        own = self.counts.get(taken, 0) + _MORE
        if among is None:
            return math.log2(self._total / own)
        return math.log2(sum(self.counts.get(o, 0) + _MORE for o in among) / own)

    def many(self, count: int) -> float:
        """Bits of a number; each more beyond many is as likely as the one before."""
        return self.bits(_name(count)) + max(count - _MANY, 0) + (count >= _MANY)


def _name(count: int) -> str:
    return str(min(count, _MANY))


@dataclass
class Written:
    """What a system has written so far.

    Parameters
    ----------
    terms, factors : of all equations before this one, those that are no power of a column.
    equations : states and the terms of their equations.
    """

    terms: dict[Term, None] = field(default_factory=dict)
    factors: dict[Factor, None] = field(default_factory=dict)
    equations: list[tuple[str, frozenset[Term]]] = field(default_factory=list)

    def add(self, state: str, terms: Sequence[Term]) -> None:
        """Add one more equation.

        Parameters
        ----------
        state, terms : whose equation it is, and its terms.
        """
        self.terms |= dict.fromkeys(t for t in terms if t)
        for term in terms:
            self.factors |= _functions(term)
        self.equations.append((state, frozenset(terms)))

    def has_twin(self, state: str, terms: Sequence[Term], states: Sequence[str]) -> bool:
        """Whether an equation is an earlier one with the names of states exchanged.

        States of one kind can be exchanged in all that is written, and not in two equations alone.

        Parameters
        ----------
        state, terms : whose equation it is, and its terms.
        states : of the system.
        """
        own = frozenset(terms)
        # Two products of columns are alike by chance.
        if len(own) < _TOLD and all(factor.plain for term in own for factor in term):
            return False
        every = {**dict(self.equations), state: own}
        return any(
            all(
                renamed(every[s], way) == every[n] for s, n in way.items() if {s, n} <= every.keys()
            )
            for other, theirs in self.equations
            for way in ways_of_twin(theirs, other, own, state, states)
        )


@dataclass(frozen=True)
class Place:
    """Where a term is: the equation of a state, and the columns it may contain.

    Parameters
    ----------
    state : whose equation it is.
    states, columns : of the system; what is no state is an input, but for the time t.
    angles : columns that may be angles; by default all of them.
    """

    state: str
    states: tuple[str, ...]
    columns: tuple[str, ...]
    angles: tuple[str, ...] | None = None

    def is_usual(self, factor: Factor) -> bool:
        """Whether a factor is what its template is in textbooks: sines there are those of angles.

        Parameters
        ----------
        factor : the factor.
        """
        wave = factor.template.startswith(("sin(", "cos("))
        return not wave or self.angles is None or {*factor.columns} <= {*self.angles, "t"}

    def role(self, name: str) -> str:
        """Say what a column is to the equation.

        Parameters
        ----------
        name : of the column.
        """
        if name == self.state:
            return "own"
        if name in self.states:
            return "state"
        return "time" if name == "t" else "input"

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Role -> how many columns have it."""
        inputs = [c for c in self.columns if c not in self.states and c != "t"]
        return {"own": 1, "state": len(self.states) - 1, "input": len(inputs), "time": 1}


@dataclass(frozen=True, eq=False)
class Prior:
    """How often textbooks make each choice.

    Parameters
    ----------
    counts : for each of CHOICES, how often each outcome was taken.
    """

    counts: Mapping[str, Mapping[str, int]]

    @cached_property
    def _choices(self) -> dict[str, Choice]:
        return {name: Choice(self.counts[name]) for name in CHOICES}

    @cached_property
    def _unseen(self) -> float:
        """Bits of a template that was never seen (Good 1953): as many as were seen but once."""
        counts = self.counts["template"].values()
        return math.log2(sum(counts) / max(1, sum(c == 1 for c in counts)))

    @cached_property
    def _letter(self) -> float:
        """Bits of one symbol of a template that has to be spelt out."""
        known = {symbol for template in self.counts["template"] for symbol in _symbols(template)}
        return math.log2(max(len(known), 2))

    @cached_property
    def driven_bits(self) -> float:
        """Bits of an equation that contains the time, among all equations."""
        timed = sum(c for role, c in self.counts["role"].items() if role.startswith("time "))
        return self._bits_of(timed)

    @cached_property
    def loose_bits(self) -> float:
        """Bits of a system that does not hold exactly: of all equations, not one does not."""
        return self._bits_of(0)

    def _bits_of(self, equations: int) -> float:
        """Bits of being one of so many, among all equations."""
        return math.log2(sum(self.counts["terms"].values()) / max(equations, _MORE))

    def share(self, question: str) -> float:
        """Share of textbooks' answers to a question of CHOICES that are yes.

        Parameters
        ----------
        question : the choice.

        >>> textbooks().share("same inside") > textbooks().share("same factor of a column")
        True
        """
        return 2.0 ** -self._says(question, True)

    def _says(self, question: str, yes: bool) -> float:
        return self._choices[question].bits("yes" if yes else "no", ("no", "yes"))

    def system_bits(
        self,
        exprs: Mapping[str, sympy.Expr],
        columns: Sequence[str],
        states: Sequence[str] = (),
        angles: Sequence[str] | None = None,
    ) -> float:
        """Give the bits of a system without its constants.

        Parameters
        ----------
        exprs : state -> equation.
        columns : names of all columns.
        states : of them, what moves by equations; by default those that are given.
        angles : columns that may be angles; by default all of them.

        >>> x, y = sympy.symbols("x y")
        >>> prey, predators = 1.1 * x - 0.4 * x * y, 0.1 * x * y - 0.4 * y
        >>> hunt = textbooks().system_bits({"x": prey, "y": predators}, ["x", "y"])
        >>> hunt < textbooks().system_bits({"x": prey, "y": 0.1 * sympy.sin(x) - 0.4}, ["x", "y"])
        True
        """
        states, written, bits = tuple(states or exprs), Written(), 0.0
        may_turn = None if angles is None else tuple(angles)
        for state, expr in exprs.items():
            place = Place(state, states, tuple(columns), may_turn)
            terms = read_equation(expr)
            bits += self._together(terms, exact_bits(expr), place, written)
            written.add(state, terms)
        return bits

    def bits_together(self, expr: sympy.Expr, place: Place, written: Written) -> float:
        """Give the bits of one equation without its constants, or of naming an earlier one like it.

        Parameters
        ----------
        expr : the equation.
        place : where it is.
        written : the equations before it.
        """
        return self._together(read_equation(expr), exact_bits(expr), place, written)

    def _together(
        self, terms: Sequence[Term], exact: float, place: Place, written: Written
    ) -> float:
        alone = self.equation_bits(terms, place, written) + exact
        if not written.equations:
            return alone
        alone += self._says("twin", False)
        named = self._says("twin", True) + math.log2(len(written.equations))
        is_named = named < alone and written.has_twin(place.state, terms, place.states)
        return named if is_named else alone

    def equation_bits(self, terms: Sequence[Term], place: Place, written: Written) -> float:
        """Give the bits of one equation, written term by term.

        Parameters
        ----------
        terms : of it.
        place : where they are.
        written : the equations before it.
        """
        bits = self._choices["terms"].many(len(terms)) - math.lgamma(len(terms) + 1) / math.log(2)
        within = Written(written.terms, dict(written.factors), written.equations)
        own: set[Term] = set()
        for term in terms:
            functions = _functions(term)
            if functions and own:
                bits += self._says("again", term in own)
            if term in own:
                bits += math.log2(len(own))
                continue
            bits += self.term_bits(term, place, within)
            within.factors |= functions
            own |= {term} if functions else set()
        return bits

    def term_bits(self, term: Term, place: Place, written: Written) -> float:
        """Give the bits of one term.

        Parameters
        ----------
        term : its factors.
        place : where it is.
        written : the equations before it.
        """
        anew = self._choices["factors"].many(len(term)) - _orders(term)
        anew += sum(self._factor_bits(factor, place, written) for factor in term)
        if not written.equations:
            return anew
        anew += self._says("cited", False)
        if term not in written.terms:
            return anew
        return min(anew, self._says("cited", True) + math.log2(len(written.terms)))

    def knows(self, expr: sympy.Expr, place: Place) -> bool:
        """Whether every factor of an equation is one that textbooks have there.

        Parameters
        ----------
        expr, place : the equation, and where it is.

        >>> growth, place = sympy.Symbol("x"), Place("x", ("x",), ("x",), ())
        >>> textbooks().knows(growth**2, place), textbooks().knows(sympy.sin(growth), place)
        (True, False)
        """
        known = self.counts["template"]
        factors = (factor for term in read_equation(expr) for factor in term)
        return all(f.template in known and place.is_usual(f) for f in factors)

    def _role_bits(self, factor: Factor, role: str, place: Place) -> float:
        """Bits of the role of a column, by its template as far as that was seen.

        What is known of all powers or of all functions is worth one more that was seen.
        """
        there = [one for one in ROLES if place.sizes[one]]
        general = self._choices[factor.roles]
        own = self.counts["role"]
        seen = {one: own.get(f"{one} in {factor.template}", 0) for one in there}
        if role not in seen:
            return _NEVER
        share = 2.0 ** -general.bits(role, there)
        return math.log2((sum(seen.values()) + 1) / (seen[role] + share))

    def _factor_bits(self, factor: Factor, place: Place, written: Written) -> float:
        template = self._choices["template"]
        if factor.template in template.counts and place.is_usual(factor):
            bits = template.bits(factor.template)
        else:
            bits = self._unseen + self._letter * len(_symbols(factor.template))
        for role in map(place.role, factor.columns):
            bits += self._role_bits(factor, role, place) + math.log2(max(place.sizes[role], 1))
        if factor.plain or not written.factors:
            return bits
        bits += self._says("repeated", False)
        if factor not in written.factors:
            return bits
        return min(bits, self._says("repeated", True) + math.log2(len(written.factors)))


def ways_of_twin(
    own: frozenset[Term], other: str, terms: frozenset[Term], state: str, states: Sequence[str]
) -> list[dict[str, str]]:
    """Give the exchanges of the names of states by which the equation of another is one's own.

    Parameters
    ----------
    own, other : the terms of the other equation, and whose it is.
    terms, state : the same of the equation.
    states : of the system.
    """
    if len(own) != len(terms) or _shapes(own) != _shapes(terms):
        return []
    plain = {name: name for name in states}
    if len(states) > _EXCHANGED:
        ways: Iterable[dict[str, str]] = [{**plain, other: state, state: other}]
    else:
        ways = (dict(zip(states, way, strict=True)) for way in permutations(states))
    return [way for way in ways if way[other] == state and renamed(own, way) == terms]


def _shapes(terms: frozenset[Term]) -> Counter[tuple[str, ...]]:
    return Counter(tuple(f.template for f in term) for term in terms)


def renamed(terms: frozenset[Term], way: Mapping[str, str]) -> frozenset[Term]:
    """Give terms with other names of columns.

    Parameters
    ----------
    terms, way : of an equation, and name -> name.
    """
    return frozenset(
        tuple(sorted(Factor(f.template, tuple(way.get(c, c) for c in f.columns)) for f in term))
        for term in terms
    )


def _orders(term: Term) -> float:
    """Bits of the order of factors, which says nothing."""
    repeats = sum(math.lgamma(n + 1) for n in Counter(term).values())
    return (math.lgamma(len(term) + 1) - repeats) / math.log(2)


@lru_cache(maxsize=20_000)
def _symbols(template: str) -> tuple[str, ...]:
    """Give what a template is spelt with: operations, functions, places and numbers."""
    # A curve is one more function.
    curves = {name: sympy.Function(name) for name, _ in unknown_calls(template)}
    nodes = sympy.preorder_traversal(parse(template, functions=curves))
    return tuple(str(node) if node.is_Atom else str(node.func) for node in nodes)


def read_corpus(text: str) -> Iterator[tuple[str, dict[str, sympy.Expr]]]:
    """Give name and equations of the systems of a corpus; constants become floats."""
    for block in re.split(r"\n\s*\n", text):
        lines = [line for line in block.splitlines() if line and not line.startswith("#")]
        if not lines:
            continue
        inputs: list[str] = []
        equations = {}
        for line in lines[1:]:
            if line.startswith("inputs"):
                inputs = re.split(r",\s*", line.removeprefix("inputs").strip())
            else:
                state, right = re.split(r"'\s*=\s*", line)
                equations[state] = right
        columns = [*equations, *inputs, "t"]
        read = {state: parse(right) for state, right in equations.items()}
        names = sorted({str(v) for expr in read.values() for v in expr.free_symbols} - {*columns})
        # No two are alike, so that none merge.
        numbers = dict(zip(map(sympy.Symbol, names), marks(len(names)), strict=True))
        yield lines[0], {state: expr.xreplace(numbers) for state, expr in read.items()}


def count(systems: Iterable[Mapping[str, sympy.Expr]]) -> Prior:
    """Count the choices that the systems of a corpus make.

    Parameters
    ----------
    systems : state -> equation, of each.
    """
    counts: dict[str, Counter[str]] = {name: Counter() for name in CHOICES}

    def ask(question: str, yes: bool) -> bool:
        counts[question]["yes" if yes else "no"] += 1
        return yes

    for exprs in systems:
        written, states = Written(), tuple(exprs)
        for state, expr in exprs.items():
            place, terms = Place(state, states, ()), read_equation(expr)
            if not (written.equations and ask("twin", written.has_twin(state, terms, states))):
                counts["terms"][_name(len(terms))] += 1
                factors, before = dict(written.factors), set[Term]()
                for term in terms:
                    functions = _functions(term)
                    if functions and before and ask("again", term in before):
                        continue
                    before |= {term} if functions else set()
                    if written.equations and ask("cited", term in written.terms):
                        continue
                    counts["factors"][_name(len(term))] += 1
                    for factor in term:
                        if not factor.plain and factors and ask("repeated", factor in factors):
                            continue
                        counts["template"][factor.template] += 1
                        held = [place.role(name) for name in factor.columns]
                        counts[factor.roles].update(held)
                        counts["role"].update(f"{role} in {factor.template}" for role in held)
                    factors |= functions
            written.add(state, terms)
        sizes = [abs(c) for e in exprs.values() for c in free_constants(e, "c")[1].values()]
        for repeat in find_repeats(exprs):
            own, *earlier = ([sizes[i] for i in at] for at in (repeat.own, *repeat.earlier))
            ask(repeat.choice, own in earlier)
    return Prior(counts)


@lru_cache(maxsize=1)
def textbooks() -> Prior:
    """Give what ``scripts/prior`` has counted in the corpus of textbooks' laws."""
    return Prior(json.loads(_FILES.joinpath("prior.json").read_text("utf-8")))


def corpus() -> list[dict[str, sympy.Expr]]:
    """Give the systems of the corpus, state -> equation, their constants floats."""
    text = _FILES.joinpath("corpus.txt").read_text("utf-8")
    return [exprs for _, exprs in read_corpus(text)]
