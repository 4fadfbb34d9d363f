"""The paper's grammar of expressions, and the decoding of bitstrings to its words.

The grammar (section 2 of the paper)::

    <expr>    ::= <expr> <op> <expr> | <unit-op> <expr> | <var>
    <op>      ::= + | - | * | / | ^
    <unit-op> ::= sin | cos | log | exp | identity
    <var>     ::= x_1 | ... | x_k | c

**What a bitstring means.** It is a leftmost derivation: each choice reads a fixed number of bits,
most significant first. ``<var>`` and ``<op>`` are written into ``<expr>``, so that one choice
among variables, constants, operators and "a function" makes one symbol; a function reads
a second choice. A choice among n alternatives reads ceil(log2 n) bits and takes their value
modulo n. Bits left over when the word is complete mean nothing; a string that ends before is
invalid.

**Why so.** The paper prints no encoding, but its words bound it: each of the longest words that
it found with 20 bits has six symbols, one of them a function. Separate choices for ``<expr>``,
``<op>``, ``<unit-op>`` and ``<var>`` would need 22 bits or more even for a uniform code without
waste. Six choices of 3 bits and one of 2 are exactly 20, with eight alternatives and four
functions; 4 bits hold the sixteen alternatives of the cart-pole's words, up to fifteen in 60 bits.

**What a word means.** What it says as it is printed: the grammar has no brackets, so ``x+y*c`` is
``x+(y*c)`` however it was derived. ``^`` binds tightest and to the right, then ``*`` and ``/``,
then ``+`` and ``-``, both to the left; a function applies to all of its ``<expr>``, in brackets.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynsr.errors import InputError
from dynsr.expression import OPERATORS, check_name

PAD, CLOSE, _EXPR = -1, -2, -3
DEFAULT_OPERATORS = ("+", "-", "*", "/", "^")
DEFAULT_FUNCTIONS = ("sin", "cos", "log", "exp", "identity")
DEFAULT_CONSTANTS = (-1.0, 0.5, 1.0, 2.0, 3.0, 10.0)
_LEXEME = re.compile(r"\s*(\(-\d[\d.e]*\)|\d[\d.e]*|[A-Za-z_]\w*|[-+*/^()])")


@dataclass(frozen=True)
class Grammar:
    """Variables, constants, binary operators and functions, numbered as tokens in this order.

    Raises InputError when there is nothing to end a word with, or an operator is unknown.

    >>> grammar = Grammar(("x", "y"), (1.0, -3.0), ("+", "*", "^"), ("sin", "cos"))
    >>> bits = grammar.encode("x+y*(-3.0)", 20)
    >>> infix, valid = grammar.decode(bits[None])
    >>> grammar.text(infix[0])
    'x+y*(-3.0)'
    """

    variables: tuple[str, ...]
    constants: tuple[float, ...] = DEFAULT_CONSTANTS
    operators: tuple[str, ...] = DEFAULT_OPERATORS
    functions: tuple[str, ...] = DEFAULT_FUNCTIONS

    def __post_init__(self) -> None:
        """Check the symbols."""
        if not self.variables and not self.constants:
            raise InputError("the grammar has no variable and no constant; give at least one")
        for name in self.variables:
            check_name(name)
        for tokens, arity, role in (
            (self.operators, 2, "operator"),
            (self.functions, 1, "function"),
        ):
            known = [token for token, operator in OPERATORS.items() if operator.arity == arity]
            for token in tokens:
                if token not in known:
                    raise InputError(
                        f"unknown {role} {token!r}; the {role}s are: {', '.join(known)}"
                    )
        for value in self.constants:
            if not np.isfinite(value):
                raise InputError(f"constant {value} of the grammar must be a finite number")

    @cached_property
    def leaves(self) -> int:
        """Count the variables and constants: tokens below this number end a branch."""
        return len(self.variables) + len(self.constants)

    @cached_property
    def first_function(self) -> int:
        """Number of the first function's token; below it and not a leaf is an operator."""
        return self.leaves + len(self.operators)

    @cached_property
    def alternatives(self) -> int:
        """Count the alternatives of ``<expr>``; "a function" is the last, if there are any."""
        return self.first_function + bool(self.functions)

    @cached_property
    def symbol_bits(self) -> int:
        """Bits that the choice of one symbol reads."""
        return _width(self.alternatives)

    @cached_property
    def function_bits(self) -> int:
        """Bits that the choice of a function reads after that."""
        return _width(len(self.functions))

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """Every token as it is printed."""
        numbers = (repr(c) if c >= 0 else f"({c!r})" for c in map(float, self.constants))
        return (*self.variables, *numbers, *self.operators, *self.functions)

    def decode(self, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derive the words of a whole population of bitstrings at once.

        Takes bits (N, L); gives the infix tokens (N, T), padded with PAD, a function's argument
        ended by CLOSE, and valid (N,), false where the string ended before the word.
        """
        bits = np.atleast_2d(np.asarray(bits, dtype=np.int64))
        derivation = _Derivation(self, bits)
        while derivation.step():
            pass
        return derivation.words(), derivation.complete

    def encode(self, text: str, length: int) -> np.ndarray:
        """Give a bitstring of ``length`` that decodes to the word ``text``; unused bits are 0.

        Raises InputError when the text is no word of the grammar or needs more bits.
        """
        lexemes = [m.group(1) for m in _LEXEME.finditer(text)]
        if "".join(lexemes) != re.sub(r"\s", "", text):
            raise InputError(f"cannot read {text!r} as a word of the grammar")
        tokens = self._derive(lexemes)
        if lexemes:
            raise InputError(f"{text!r} is no word of the grammar at {lexemes[0]!r}")
        out: list[int] = []
        for token in tokens:
            out += _to_bits(min(token, self.first_function), self.symbol_bits)
            if token >= self.first_function:
                out += _to_bits(token - self.first_function, self.function_bits)
        if len(out) > length:
            raise InputError(f"{text!r} needs {len(out)} bits, more than the length {length}")
        return np.array(out + [0] * (length - len(out)), dtype=np.uint8)

    def _derive(self, lexemes: list[str]) -> list[int]:
        """Prefix tokens of the word at the head of ``lexemes``, which are used up."""
        first = self._token(lexemes.pop(0) if lexemes else "")
        if first >= self.first_function:
            if lexemes[:1] != ["("]:
                raise InputError("a function in a word of the grammar needs brackets")
            del lexemes[0]
            term = [first, *self._derive(lexemes)]
            if lexemes[:1] != [")"]:
                raise InputError("a bracket in a word of the grammar is not closed")
            del lexemes[0]
        else:
            term = [first]
        if lexemes and lexemes[0] in self.operators:
            return [self._token(lexemes.pop(0)), *term, *self._derive(lexemes)]
        return term

    def _token(self, lexeme: str) -> int:
        if lexeme[:1].isdigit() or lexeme[:2] == "(-":
            value = float(lexeme.strip("()"))
            lexeme = repr(value) if value >= 0 else f"({value!r})"
        if lexeme not in self.symbols:
            raise InputError(f"{lexeme!r} is no symbol of the grammar: {' '.join(self.symbols)}")
        return self.symbols.index(lexeme)

    def text(self, infix: np.ndarray) -> str:
        """Print one word, (T,) infix tokens, as the paper prints it."""
        parts = []
        for token in (int(t) for t in infix if t != PAD):
            parts.append(")" if token == CLOSE else self.symbols[token])
            if token >= self.first_function:
                parts.append("(")
        return "".join(parts)


class _Derivation:
    """Leftmost derivations of N words, one stack of what is still to be written for each."""

    def __init__(self, grammar: Grammar, bits: np.ndarray) -> None:
        count, self.length = bits.shape
        self.grammar = grammar
        widest = max(grammar.symbol_bits, grammar.function_bits)
        self.bits = np.pad(bits, ((0, 0), (0, widest)))
        room = 2 * (self.length // max(grammar.symbol_bits, 1)) + 4
        self.stack = np.full((count, room), _EXPR)
        self.height = np.ones(count, dtype=np.int64)
        self.position = np.zeros(count, dtype=np.int64)
        self.out = np.full((count, room), PAD)
        self.written = np.zeros(count, dtype=np.int64)
        self.failed = np.zeros(count, dtype=bool)

    @property
    def complete(self) -> np.ndarray:
        return ~self.failed & (self.height == 0)

    def words(self) -> np.ndarray:
        width = int(self.written[self.complete].max(initial=1))
        return np.where(self.complete[:, None], self.out, PAD)[:, :width]

    def step(self) -> bool:
        """Take one item from every stack that has one; false when there is none left."""
        rows = np.flatnonzero(~self.failed & (self.height > 0))
        if not rows.size:
            return False
        self.height[rows] -= 1
        items = self.stack[rows, self.height[rows]]
        open_ = items == _EXPR
        self._write(rows[~open_], items[~open_])
        rows = rows[open_]
        if not rows.size:
            return True
        rows, tokens = self._choose(rows)
        binary = (tokens >= self.grammar.leaves) & (tokens < self.grammar.first_function)
        unary = tokens >= self.grammar.first_function
        self._push(rows[binary], _EXPR)
        self._push(rows[binary], tokens[binary])
        self._push(rows[unary], CLOSE)
        self._push(rows[binary | unary], _EXPR)
        self._write(rows[~binary], tokens[~binary])
        return True

    def _choose(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Read one symbol for each row; give the rows whose bits sufficed, and their tokens."""
        grammar = self.grammar
        tokens = self._read(rows, grammar.symbol_bits) % grammar.alternatives
        function = (tokens == grammar.first_function) & ~self.failed[rows]
        if function.any():
            choice = self._read(rows[function], grammar.function_bits)
            tokens[function] += choice % len(grammar.functions)
        alive = ~self.failed[rows]
        return rows[alive], tokens[alive]

    def _read(self, rows: np.ndarray, width: int) -> np.ndarray:
        where = np.minimum(self.position[rows], self.length)
        window = self.bits[rows[:, None], where[:, None] + np.arange(width)]
        self.position[rows] += width
        self.failed[rows[self.position[rows] > self.length]] = True
        return window @ (1 << np.arange(width)[::-1])

    def _push(self, rows: np.ndarray, items: np.ndarray | int) -> None:
        self.stack[rows, self.height[rows]] = items
        self.height[rows] += 1

    def _write(self, rows: np.ndarray, tokens: np.ndarray) -> None:
        self.out[rows, self.written[rows]] = tokens
        self.written[rows] += 1


def _width(alternatives: int) -> int:
    return max(alternatives - 1, 0).bit_length()


def _to_bits(value: int, width: int) -> list[int]:
    return [value >> k & 1 for k in range(width)][::-1]
