"""Vocabulary: the functions and operators that a formula may hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy

from dynsr.errors import InputError, quoted
from dynsr.expression.operators import FUNCTIONS
from dynsr.expression.parsing import FUNCTION_ALIASES

# Tokens of the table that are arithmetic by another name.
_ARITHMETIC = ("identity", "neg", "inv", "square")
NAMED_FUNCTIONS = tuple(token for token in FUNCTIONS if token not in _ARITHMETIC)
NAMED_OPERATORS = ("+", "-", "*", "/", "**")


@dataclass(frozen=True)
class Vocabulary:
    """What a formula may be made of in addition to +, -, *, numbers, columns and whole powers.

    Parameters
    ----------
    functions : names of functions, of sin, cos, exp, log, sqrt and the others of the table.
    divide : fractions and negative powers are allowed.
    power : powers other than whole ones are allowed, such as x**0.7 or x**y. Without, a square
        root needs "sqrt".

    >>> from dynsr.expression import parse
    >>> few = Vocabulary(("exp",))
    >>> [few.allows(parse(text)) for text in ("x**2/(1 + exp(y))", "sin(x)", "x**0.7")]
    [True, False, False]
    """

    functions: tuple[str, ...] = ()
    divide: bool = True
    power: bool = False

    @classmethod
    def read(cls, names: Sequence[str]) -> Vocabulary:
        """Read names of functions and operators.

        Parameters
        ----------
        names : of :data:`NAMED_FUNCTIONS` and ``+ - * / **``. Sums, products and whole powers are
            always allowed. "/" is too, unless the list names operators and "/" is not one of them;
            "**" stands for powers that are not whole. An empty list leaves sums and ratios of
            whole powers.

        Raises InputError that lists the names when one is unknown.

        >>> Vocabulary.read(["exp", "log"])
        Vocabulary(functions=('exp', 'log'), divide=True, power=False)
        >>> Vocabulary.read(["+", "*"])
        Vocabulary(functions=(), divide=False, power=False)
        """
        if isinstance(names, str):
            names = names.replace(",", " ").split()
        functions, operators = set(), set()
        for name in names:
            token = FUNCTION_ALIASES.get(str(name), str(name))
            if token in ("^", *NAMED_OPERATORS):
                operators.add("**" if token == "^" else token)
            elif token in NAMED_FUNCTIONS:
                functions.add(token)
            else:
                raise InputError(
                    f"unknown function {quoted(name)}; the functions are: "
                    f"{', '.join(NAMED_FUNCTIONS)}; the operators: {' '.join(NAMED_OPERATORS)}"
                )
        return cls(
            tuple(token for token in NAMED_FUNCTIONS if token in functions),
            divide=not operators or "/" in operators,
            power="**" in operators,
        )

    @property
    def roots(self) -> bool:
        """Whether square roots are allowed."""
        return self.power or "sqrt" in self.functions

    def has(self, token: str) -> bool:
        """Whether an operator of the table may be used.

        Parameters
        ----------
        token : its name in :data:`dynsr.expression.OPERATORS`.
        """
        if token in ("/", "inv"):
            return self.divide
        if token == "^":
            return self.power
        if token == "sqrt":
            return self.roots
        return token in self.functions or token not in NAMED_FUNCTIONS

    def allows(self, expr: sympy.Expr) -> bool:
        """Whether a formula holds nothing else.

        Parameters
        ----------
        expr : the formula.
        """
        return all(self._allows(node) for node in sympy.preorder_traversal(expr))

    def _allows(self, node: sympy.Expr) -> bool:
        if node.is_Pow:
            return self._allows_power(node)
        if not node.is_Function:
            return True
        return any(node.func is FUNCTIONS[token].sympy for token in self.functions)

    def _allows_power(self, node: sympy.Pow) -> bool:
        if not node.free_symbols:
            return True
        if not node.exp.is_Number:
            return self.power
        exponent = float(node.exp)
        if exponent < 0 and not self.divide:
            return False
        return exponent.is_integer() or self.power or (self.roots and (2 * exponent).is_integer())
