"""Exports: the equations as LaTeX, Python, numpy functions and Julia, all from the same SymPy."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import sympy
from sympy.printing.julia import JuliaCodePrinter
from sympy.printing.latex import LatexPrinter
from sympy.printing.mathml import MathMLPresentationPrinter
from sympy.printing.pycode import PythonCodePrinter
from sympy.printing.str import StrPrinter

from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.writing import as_float_tree

# From here on a number is too long for a fraction of a reader's.
_LONG = 20


def arguments_of(equations: Mapping[str, sympy.Expr]) -> tuple[str, ...]:
    """Names that the equations need besides their states and the time: the inputs, sorted."""
    used = {str(s) for e in equations.values() for s in e.free_symbols}
    return tuple(sorted(used - set(equations) - {"t"}))


class _Latex(LatexPrinter):
    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return super()._print_Float(sympy.Float(f"{float(expr):.6g}"))


def to_latex(equations: Mapping[str, sympy.Expr]) -> str:
    r"""Write the equations as a LaTeX ``aligned`` block, constants to six digits.

    >>> print(to_latex({"x": -2 * sympy.Symbol("x")}))
    \begin{aligned}
    \dot{x} &= - 2 x
    \end{aligned}
    """
    printer = _Latex()
    rows = [
        f"\\dot{{{sympy.latex(sympy.Symbol(s))}}} &= {printer.doprint(e)}"
        for s, e in equations.items()
    ]
    return "\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}"


class _MathML(MathMLPresentationPrinter):
    def _print_Float(self, expr: sympy.Float) -> Any:  # noqa: N802 (SymPy's protocol)
        digits, _, power = f"{float(expr):.6g}".replace("-", "\u2212").partition("e")
        number = self._node("mn", digits)
        if not power:
            return number
        row, ten = self.dom.createElement("mrow"), self.dom.createElement("msup")
        ten.appendChild(self._node("mn", "10"))
        ten.appendChild(self._node("mn", power.replace("+", "").replace("\u22120", "\u2212")))
        for part in (number, self._node("mo", "\u00d7"), ten):
            row.appendChild(part)
        return row

    def _node(self, tag: str, text: str) -> Any:
        node = self.dom.createElement(tag)
        node.appendChild(self.dom.createTextNode(text))
        return node


def to_mathml(expr: sympy.Expr, state: str | None = None) -> str:
    """Write a formula, or the equation of a state, as MathML; browsers show it without a script.

    Every term of a sum is a ``math`` element of its own, because browsers break lines between
    such elements and never within one.

    >>> x, y = sympy.symbols("x y")
    >>> to_mathml(x - y)
    '<math><mi>x</mi></math> <math><mo form="infix">...</mo><mi>y</mi></math>'
    """
    printer = _MathML()

    def write(term: sympy.Expr) -> str:
        # Browsers set factors without any space; a thin one keeps "x y" and "sin" readable.
        times = "<mo>&InvisibleTimes;</mo>"
        text = printer.doprint(term).replace(times, times + '<mspace width="0.15em"/>')
        return text.replace("<mo>-</mo>", "<mo>\u2212</mo>")

    first, *others = expr.as_ordered_terms()
    left = "" if state is None else f"{_dotted(printer.doprint(sympy.Symbol(state)))}<mo>=</mo>"
    signed = [
        f'<mo form="infix">\u2212</mo>{write(-term)}'
        if term.could_extract_minus_sign()
        else f'<mo form="infix">+</mo>{write(term)}'
        for term in others
    ]
    return " ".join(f"<math>{piece}</math>" for piece in (left + write(first), *signed))


def _dotted(name: str) -> str:
    """Set the dot of a time derivative over the letter of a name, not over its index."""
    return re.sub(
        "<mi>.*?</mi>",
        r'<mover accent="true">\g<0><mo>\u02d9</mo></mover>'.replace("\\u02d9", "\u02d9"),
        name,
        count=1,
    )


class _Python(PythonCodePrinter):
    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return repr(float(expr))


def to_python(equations: Mapping[str, sympy.Expr], name: str = "rhs") -> str:
    """Write a Python function ``rhs(t, state, inputs...)`` for scipy's ``solve_ivp``.

    It needs nothing but Python's ``math``; inputs are functions of ``t``.

    >>> print(to_python({"x": -2 * sympy.Symbol("x")}))
    import math
    <BLANKLINE>
    <BLANKLINE>
    def rhs(t, state):
        x, = state
        return [-2*x]
    """
    inputs = arguments_of(equations)
    printer = _Python({"fully_qualified_modules": True})
    body = ", ".join(printer.doprint(as_float_tree(e)) for e in equations.values())
    names = ", ".join(equations) + ("," if len(equations) == 1 else "")
    values = "".join(f"    {i} = {i}(t)\n" for i in inputs)
    head = ", ".join(["t", "state", *inputs])
    return (
        f"import math\n\n\ndef {name}({head}):\n    {names} = state\n{values}    return [{body}]\n"
    )


def to_numpy(
    equations: Mapping[str, sympy.Expr],
) -> Callable[..., np.ndarray]:
    """Give a function ``rhs(t, state, **inputs)`` of numbers or arrays.

    ``state`` is (k, ...), inputs are numbers or arrays of shape (...); gives (k, ...).

    >>> to_numpy({"x": -2 * sympy.Symbol("x")})(0.0, np.array([3.0])).tolist()
    [-6.0]
    """
    inputs = arguments_of(equations)
    function = compile_numpy(list(equations.values()), [*equations, "t", *inputs])

    def rhs(t: float, state: np.ndarray, **values: float | np.ndarray) -> np.ndarray:
        rows = np.broadcast_arrays(*np.asarray(state, dtype=float), t, *(values[i] for i in inputs))
        return function(np.array(rows, dtype=float))

    return rhs


class _Julia(JuliaCodePrinter):
    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return repr(float(expr))


def to_julia(equations: Mapping[str, sympy.Expr], name: str = "rhs!") -> str:
    """Write a Julia function ``rhs!(du, u, p, t)`` for DifferentialEquations.jl.

    Inputs are functions of ``t`` in the named tuple ``p``.

    >>> print(to_julia({"x": -2 * sympy.Symbol("x")}))
    function rhs!(du, u, p, t)
        x = u[1]
        du[1] = -2 * x
        return nothing
    end
    """
    printer = _Julia({"contract": False})
    inputs = arguments_of(equations)
    lines = [f"    {state} = u[{i}]" for i, state in enumerate(equations, 1)]
    lines += [f"    {i} = p.{i}(t)" for i in inputs]
    for i, expr in enumerate(equations.values(), 1):
        # On numbers Julia's plain operators serve; SymPy prints the elementwise ones.
        code = printer.doprint(as_float_tree(expr)).replace(".*", "*").replace("./", "/")
        code = code.replace(".^", "^")
        lines.append(f"    du[{i}] = {code}")
    return "\n".join([f"function {name}(du, u, p, t)", *lines, "    return nothing", "end"]) + "\n"


def to_text_block(equations: Mapping[str, sympy.Expr], digits: int = 6) -> str:
    """Write the equations as plain text, one a line, constants to so many digits.

    >>> to_text_block({"x": -2 * sympy.Symbol("x")})
    "x' = -2*x"
    """
    return "\n".join(f"{s}' = {shown(e, digits)}" for s, e in equations.items())


def shown(expr: sympy.Expr, digits: int = 6) -> str:
    """Write one expression for reading: floats to so many digits, no trailing zeros.

    >>> shown(sympy.Float(9.81) * sympy.Symbol("x") - sympy.Float(0.1))
    '9.81*x - 0.1'
    >>> shown(sympy.Rational(981, 100) * sympy.Symbol("x") / 3 + sympy.Rational(8, 3))
    '3.27*x + 8/3'
    """
    return _Text({"digits": digits}).doprint(_with_few_fractions(expr))


def _with_few_fractions(expr: sympy.Expr) -> sympy.Expr:
    """Write fractions of large numbers as decimals, but for exponents."""
    if expr.is_Rational:
        long = expr.q > 1 and (expr.q >= _LONG or abs(expr.p) >= _LONG)
        return sympy.Float(float(expr)) if long else expr
    if expr.is_Pow:
        return sympy.Pow(_with_few_fractions(expr.base), expr.exp)
    return expr.func(*map(_with_few_fractions, expr.args)) if expr.args else expr


class _Text(StrPrinter):
    _default_settings: ClassVar = {**StrPrinter._default_settings, "digits": 6}  # noqa: SLF001

    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return f"{float(expr):.{self._settings['digits']}g}"
