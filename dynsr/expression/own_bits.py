"""Own bits: what the user adds to the complexity of functions and operators.

Every count of bits asks :func:`dynsr.expression.complexity`, in searches, fits, choices and fronts
alike, and none may be left out; so the own bits belong to the context of a run, not to each call.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import sympy

from dynsr.errors import InputError, quoted
from dynsr.expression.operators import FUNCTIONS
from dynsr.expression.parsing import FUNCTION_ALIASES
from dynsr.expression.vocabulary import NAMED_FUNCTIONS

_OPERATORS = ("+", "*", "/", "**")
_TOKENS = {FUNCTIONS[token].sympy: token for token in NAMED_FUNCTIONS}
_IN_FORCE: ContextVar[Mapping[str, float] | None] = ContextVar("own bits", default=None)


def read_own_bits(given: Mapping[str, Any] | None) -> dict[str, float]:
    """Read the bits of functions and operators, in the order of the table.

    Parameters
    ----------
    given : name of a function, or ``+ * / **``, -> bits that each occurrence costs in addition to
        those of :func:`dynsr.expression.complexity`.

    Raises InputError, one line that names the value, for an unknown name or what is no number of
    bits.

    >>> read_own_bits({"/": 4, "ln": 8.5})
    {'log': 8.5, '/': 4.0}
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise InputError(
            f"complexity {quoted(given)} must map functions and operators to bits, such as "
            "{'sin': 8, '/': 4}"
        )
    found: dict[str, float] = {}
    for name, bits in given.items():
        token = "**" if name == "^" else FUNCTION_ALIASES.get(str(name), str(name))
        if token not in (*NAMED_FUNCTIONS, *_OPERATORS):
            raise InputError(
                f"complexity of {quoted(name)}, which is unknown; the functions are: "
                f"{', '.join(NAMED_FUNCTIONS)}; the operators: {' '.join(_OPERATORS)}"
            )
        if isinstance(bits, bool) or not isinstance(bits, (int, float)):
            bits = math.nan
        if not 0 <= bits < math.inf:
            raise InputError(
                f"complexity of {token!r} is {str(given[name])[:20]!r}; give bits from 0 up, such "
                "as 8"
            )
        found[token] = float(bits)
    return {token: found[token] for token in (*NAMED_FUNCTIONS, *_OPERATORS) if token in found}


@contextmanager
def counting(bits: Mapping[str, float]) -> Iterator[None]:
    """Let every count of bits within it add these; nothing changes where there are none.

    Parameters
    ----------
    bits : what :func:`read_own_bits` gave.

    >>> from dynsr.expression import complexity
    >>> wave = sympy.sin(sympy.Symbol("x"))
    >>> plain = complexity(wave)
    >>> with counting({"sin": 8.0}):
    ...     complexity(wave) - plain
    8.0
    """
    token = _IN_FORCE.set(bits or None)
    try:
        yield
    finally:
        _IN_FORCE.reset(token)


def bits_in_force() -> tuple[tuple[str, float], ...]:
    """Give the own bits that are counted now: what depends on bits depends on these.

    >>> with counting({"sin": 8.0}):
    ...     bits_in_force()
    (('sin', 8.0),)
    """
    return tuple((_IN_FORCE.get() or {}).items())


def added_bits(expr: sympy.Expr) -> float:
    """Give the own bits in force of all operations of an expression.

    A sum of j terms has j - 1 "+". A product has one "*" fewer than factors in its numerator, where
    -1 does not count, and a "/" for each in its denominator. A square root is "sqrt", every other
    power "**".

    Parameters
    ----------
    expr : the expression.
    """
    bits = _IN_FORCE.get()
    if bits is None:
        return 0.0
    nodes = sympy.preorder_traversal(expr)
    return math.fsum(bits.get(token, 0.0) for node in nodes for token in _operations(node))


def _operations(node: sympy.Expr) -> Iterable[str]:
    if node.is_Add:
        return ["+"] * (len(node.args) - 1)
    if node.is_Mul:
        above = [a for a in node.args if a != -1 and not _is_below(a)]
        return ["*"] * max(len(above) - 1, 0)
    if node.is_Pow:
        line = ["/"] if _is_below(node) else []
        size = abs(node.exp) if node.exp.is_Number else None
        return line if size == 1 else [*line, "sqrt" if size == sympy.S.Half else "**"]
    return [_TOKENS[node.func]] if node.func in _TOKENS else []


def _is_below(factor: sympy.Expr) -> bool:
    return bool(factor.is_Pow and factor.exp.could_extract_minus_sign())
