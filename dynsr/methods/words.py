"""Words of a grammar, many at once: their postfix form, their values, and their SymPy trees."""

from __future__ import annotations

import numpy as np
import sympy

from dynsr.expression import OPERATORS, number_bits
from dynsr.methods.grammar import CLOSE, PAD, Grammar

_PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "^": 3}
_CHUNK_BYTES = 1 << 25


def to_postfix(infix: np.ndarray, grammar: Grammar) -> np.ndarray:
    """Bring infix words (N, T) to postfix (N, T), padded with PAD, by precedence.

    Dijkstra's shunting yard, one step for all words at once. A function stands on the operator
    stack as the bracket that it opens.
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
    """Give the SymPy tree of one postfix word (T,); None where it holds a number out of range.

    Parts without variables are computed in float64, as :func:`evaluate_words` does.
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
