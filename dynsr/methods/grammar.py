"""The paper's grammar of expressions: decoding bitstrings to its words, and words to values.

Words are decoded many at a time: their postfix form, their values, and their SymPy trees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.errors import InputError
from dynsr.expression import OPERATORS, check_name, number_bits

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

        Gives the infix tokens (N, T), padded with PAD, a function's argument ended by CLOSE, and
        valid (N,), false where the string ended before the word.

        Parameters
        ----------
        bits : (N, L) of 0 and 1.
        """
        bits = np.atleast_2d(np.asarray(bits, dtype=np.int64))
        derivation = _Derivation(self, bits)
        while derivation.step():
            pass
        return derivation.words(), derivation.complete

    def encode(self, text: str, length: int) -> np.ndarray:
        """Give a bitstring that decodes to a word, (length,); unused bits are 0.

        Parameters
        ----------
        text : the word, as :meth:`text` prints it.
        length : bits in all.

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
        printed = ""
        for token in (int(t) for t in infix if t != PAD):
            printed += ")" if token == CLOSE else self.symbols[token]
            printed += "(" if token >= self.first_function else ""
        return printed


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


_PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "^": 3}
_CHUNK_BYTES = 1 << 25


def to_postfix(infix: np.ndarray, grammar: Grammar) -> np.ndarray:
    """Bring infix words (N, T) to postfix (N, T), padded with PAD, by precedence.

    Dijkstra's shunting yard, one step for all words at once. A function is on the operator
    stack as the bracket that it opens.

    Parameters
    ----------
    infix : (N, T) tokens, padded with PAD, as :meth:`Grammar.decode` gives them.
    grammar : whose tokens they are.
    """
    count, width = infix.shape
    rank = _ranks(grammar)
    right = np.array([token == "^" for token in grammar.symbols])
    out, written = np.full((count, width), PAD), np.zeros(count, dtype=np.int64)
    stack, height = np.zeros((count, width + 1), dtype=np.int64), np.zeros(count, dtype=np.int64)

    def pop(rows: np.ndarray) -> None:
        height[rows] -= 1
        out[rows, written[rows]] = stack[rows, height[rows]]
        written[rows] += 1

    def pop_while(rows: np.ndarray, least: np.ndarray) -> None:
        """Pop operators of at least that rank; a function's rank is 0."""
        while rows.size:
            top = stack[rows, height[rows] - 1]
            go = (height[rows] > 0) & (rank[top] >= least)
            rows, least = rows[go], least[go]
            pop(rows)

    for column in infix.T:
        rows = np.flatnonzero(column >= grammar.leaves)
        tokens = column[rows]
        binary = tokens < grammar.first_function
        pop_while(rows[binary], (rank + right)[tokens[binary]])
        stack[rows, height[rows]] = tokens
        height[rows] += 1
        rows = np.flatnonzero((column >= 0) & (column < grammar.leaves))
        out[rows, written[rows]] = column[rows]
        written[rows] += 1
        rows = np.flatnonzero(column == CLOSE)
        pop_while(rows, np.ones_like(rows))
        pop(rows)
    pop_while(np.arange(count), np.ones(count, dtype=np.int64))
    return out


def _ranks(grammar: Grammar) -> np.ndarray:
    """Precedence of every token; 0 for what is no binary operator."""
    rank = np.zeros(len(grammar.symbols), dtype=np.int64)
    for k, token in enumerate(grammar.operators):
        rank[grammar.leaves + k] = _PRECEDENCE[token]
    return rank


def evaluate_words(postfix: np.ndarray, columns: np.ndarray, grammar: Grammar) -> np.ndarray:
    """Evaluate postfix words (N, T) on the grammar's variables, columns (p, n); gives (N, n).

    A stack machine on arrays: at each position all words with the same token take their step
    together. Values outside an operator's domain become NaN or inf without a warning.

    Parameters
    ----------
    postfix : (N, T) tokens, padded with PAD.
    columns : (p, n) values of the variables, in the grammar's order.
    grammar : whose tokens they are.
    """
    count, n = len(postfix), columns.shape[1]
    arity = np.array([_arity(token, grammar) for token in range(len(grammar.symbols))])
    depth = np.cumsum(np.where(postfix == PAD, 0, 1 - arity[postfix]), axis=1)
    most = int(depth.max(initial=1))
    size = max(1, _CHUNK_BYTES // (8 * n * most))
    out = np.empty((count, n))
    with np.errstate(all="ignore"):
        for start in range(0, count, size):
            rows = slice(start, start + size)
            out[rows] = _run(postfix[rows], depth[rows], columns, grammar, most)
    return out


def _run(
    postfix: np.ndarray, depth: np.ndarray, columns: np.ndarray, grammar: Grammar, most: int
) -> np.ndarray:
    stack = np.empty((most, len(postfix), columns.shape[1]))
    p = len(grammar.variables)
    for j in range(postfix.shape[1]):
        for token in np.unique(postfix[:, j]):
            if token == PAD:
                continue
            rows = np.flatnonzero(postfix[:, j] == token)
            top = depth[rows, j] - 1
            if token < p:
                stack[top, rows] = columns[token]
            elif token < grammar.leaves:
                stack[top, rows] = grammar.constants[token - p]
            elif token < grammar.first_function:
                operation = OPERATORS[grammar.symbols[token]].numpy
                stack[top, rows] = operation(stack[top, rows], stack[top + 1, rows])
            else:
                operation = OPERATORS[grammar.symbols[token]].numpy
                stack[top, rows] = operation(stack[top, rows])
    return stack[0]


def _arity(token: int, grammar: Grammar) -> int:
    if token < grammar.leaves:
        return 0
    return 2 if token < grammar.first_function else 1


def to_sympy(postfix: np.ndarray, grammar: Grammar) -> sympy.Expr | None:
    """Give the SymPy tree of one postfix word (T,); None where it has a number out of range.

    Subtrees without variables are computed in float64, as :func:`evaluate_words` does.
    """
    stack: list[sympy.Expr] = []
    for token in (int(t) for t in postfix if t != PAD):
        if token < len(grammar.variables):
            stack.append(sympy.Symbol(grammar.variables[token]))
            continue
        if token < grammar.leaves:
            stack.append(sympy.Float(grammar.constants[token - len(grammar.variables)]))
            continue
        operator = OPERATORS[grammar.symbols[token]]
        arguments = stack[-operator.arity :]
        del stack[-operator.arity :]
        if all(a.is_Number for a in arguments):
            with np.errstate(all="ignore"):
                value = float(operator.numpy(*(np.float64(float(a)) for a in arguments)))
            stack.append(sympy.Float(value))
            if not np.isfinite(value):
                return None
        else:
            stack.append(operator.sympy(*arguments))
    return stack[0]


def word_bits(postfix: np.ndarray, grammar: Grammar) -> np.ndarray:
    """Description length in bits of postfix words (N, T) as they are written; gives (N,).

    k log2(n) for k occurrences of n distinct variables, operators and functions, plus the bits of
    every number: :func:`dynsr.expression.complexity` without any simplification.
    """
    count = len(grammar.symbols)
    seen = np.zeros((len(postfix), count + 1), dtype=np.int64)
    np.add.at(seen, (np.arange(len(postfix))[:, None], postfix), 1)
    numbers = np.zeros(count, dtype=bool)
    numbers[len(grammar.variables) : grammar.leaves] = True
    bits = np.array([number_bits(sympy.Float(c)) for c in grammar.constants])
    seen = seen[:, :count]
    kinds = seen[:, ~numbers]
    distinct = np.maximum((kinds > 0).sum(axis=1), 2)
    return kinds.sum(axis=1) * np.log2(distinct) + seen[:, numbers] @ bits
