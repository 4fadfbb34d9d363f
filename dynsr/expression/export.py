"""Exports: the equations as text, LaTeX, MathML and numpy functions, all from the same SymPy."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from html import unescape
from typing import Any, ClassVar

import numpy as np
import sympy
from sympy.printing.julia import JuliaCodePrinter
from sympy.printing.latex import LatexPrinter
from sympy.printing.mathml import MathMLPresentationPrinter
from sympy.printing.str import StrPrinter

from dynsr.expression.evaluation import compile_numpy
from dynsr.expression.writing import as_float_tree

# From here on a number is too long for a fraction of a reader's.
_LONG = 20


def arguments_of(equations: Mapping[str, sympy.Expr]) -> tuple[str, ...]:
    """Names that the equations need besides their states and the time: the inputs, sorted."""
    used = {str(s) for e in equations.values() for s in e.free_symbols}
    return tuple(sorted(used - set(equations) - {"t"}))


# Words of Julia that name no variable; those that formulas cannot hold are left out.
JULIA_WORDS = (
    *("abstract", "baremodule", "begin", "catch", "ccall", "const", "do", "elseif", "end"),
    *("export", "false", "function", "im", "isa", "let", "local", "macro", "module", "mutable"),
    *("outer", "primitive", "quote", "struct", "true", "type", "using", "where"),
)
# What a call passes itself, in one export or another.
_CALL_NAMES = ("callable", "numpy", "self", "state", "t", "__debug__", *JULIA_WORDS)


def call_names(equations: Mapping[str, sympy.Expr]) -> dict[str, str]:
    """Give input -> the name by which every export takes it; an underscore where its own is kept.

    >>> call_names({"x": sympy.Symbol("u") + sympy.Symbol("state")})
    {'state': 'state_', 'u': 'u'}
    """
    inputs, new = arguments_of(equations), {}
    for name in inputs:
        new[name] = _free(name, _CALL_NAMES, (*equations, *inputs))
    return new


def _free(name: str, kept: Collection[str], others: Collection[str]) -> str:
    other = name
    while other in kept or (other != name and other in others):
        other += "_"
    return other


def with_signs(expr: sympy.Expr) -> sympy.Expr:
    """Write roots of squares of real numbers as ``abs``, and their quotients as ``sign``.

    ``v/sqrt(v**2)`` is 0/0 at v = 0, where ``sign(v)`` is 0, and ``v**3/sqrt(v**2)`` goes to 0.

    >>> v = sympy.Symbol("v")
    >>> with_signs(sympy.sqrt(v**2)), with_signs(-v / sympy.sqrt(v**2)), with_signs(v**3 / abs(v))
    (Abs(v), -sign(v), v**2*sign(v))
    """
    if not expr.args:
        return expr
    expr = expr.func(*map(with_signs, expr.args))
    if expr.is_Pow and expr.base.is_Pow and expr.base.exp.is_Integer and expr.base.exp % 2 == 0:
        power = expr.base.exp * expr.exp
        half = sympy.nsimplify(expr.exp) if expr.exp.is_Float else expr.exp
        if half.is_Rational and half.q == 2:
            return sympy.Abs(expr.base.base) ** sympy.Integer(round(power))
    return _cancel_signs(expr) if expr.is_Mul else expr


def _cancel_signs(product: sympy.Expr) -> sympy.Expr:
    """Cancel ``b**n * abs(b)**-m`` to what has no division by ``b`` where n is not below m."""
    powers = product.as_powers_dict()
    for size in [base for base in powers if base.func is sympy.Abs]:
        inner = size.args[0]
        up, down = powers.get(inner, sympy.S.Zero), -powers[size]
        if not (up.is_Integer and down.is_Integer and down > 0 and up > 0):
            continue
        rest = product / inner**up * size**down
        if up < down:
            return rest * sympy.sign(inner) ** (up % 2) * size ** (up - down)
        return rest * inner ** (up - down) * sympy.sign(inner) ** (down % 2)
    return product


class _Latex(LatexPrinter):
    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return super()._print_Float(sympy.Float(f"{float(expr):.6g}"))

    def _print_Symbol(self, expr: sympy.Symbol) -> str:  # noqa: N802 (SymPy's protocol)
        # LaTeX sets a word as a product of its letters.
        return re.sub("^[A-Za-z]{2,}", r"\\mathrm{\g<0>}", super()._print_Symbol(expr))


# No name begins with it, and it sorts before all that names begin with.
_BEFORE = "!"


def _put_first(expr: sympy.Expr, first: Collection[str]) -> sympy.Expr:
    """Give a formula whose printer sets names, such as those of parameters, before the others."""
    if not first:
        return expr
    return expr.xreplace({sympy.Symbol(n): sympy.Symbol(_BEFORE + n) for n in first})


def to_latex(
    equations: Mapping[str, sympy.Expr], time_unit: str = "", first: Collection[str] = ()
) -> str:
    r"""Write the equations as a LaTeX ``aligned`` block, constants to six digits.

    A comment above it says what the time is counted in where a ``time_unit`` is given. Names that
    come ``first``, such as those of parameters, precede the others in a product.

    >>> print(to_latex({"x": -2 * sympy.Symbol("x")}))
    \begin{aligned}
    \dot{x} &= - 2 x
    \end{aligned}
    >>> x, y, k = sympy.symbols("x y z1")
    >>> print(to_latex({"x": k * x * y}, first=["z1"]).splitlines()[1])
    \dot{x} &= z_{1} x y
    """
    rows = [f"{slope_latex(s)} &= {to_latex_formula(e, first)}" for s, e in equations.items()]
    unit = f"% time in {time_unit}\n" if time_unit else ""
    return unit + "\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}"


def slope_latex(state: str) -> str:
    r"""Write the time derivative of a state as LaTeX: a letter has a dot, a word a fraction.

    >>> print(slope_latex("x"), slope_latex("substrate"))
    \dot{x} \frac{\mathrm{d} \mathrm{substrate}}{\mathrm{d} t}
    """
    name = to_latex_formula(sympy.Symbol(state))
    if _is_word(name):
        return rf"\frac{{\mathrm{{d}} {name}}}{{\mathrm{{d}} t}}"
    return rf"\dot{{{name}}}"


def _is_word(latex: str) -> bool:
    return latex.startswith(r"\mathrm")


def to_latex_formula(expr: sympy.Expr, first: Collection[str] = ()) -> str:
    r"""Write one formula as LaTeX, constants to six digits; names that come ``first`` do.

    >>> print(to_latex_formula(sympy.sqrt(sympy.Symbol("x")) / 3))
    \frac{\sqrt{x}}{3}
    """
    plain = _Latex()
    names = {s: plain.doprint(s) for s in expr.free_symbols}
    # Without a space two words are one.
    between = r" \, " if any(map(_is_word, names.values())) else None
    names |= {sympy.Symbol(_BEFORE + n): plain.doprint(sympy.Symbol(n)) for n in first}
    printer = _Latex({"symbol_names": names, "mul_symbol": between})
    return str(printer.doprint(_put_first(expr, first)))


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
    left = "" if state is None else f"{_slope(printer.doprint(sympy.Symbol(state)))}<mo>=</mo>"
    signed = [
        f'<mo form="infix">\u2212</mo>{write(-term)}'
        if term.could_extract_minus_sign()
        else f'<mo form="infix">+</mo>{write(term)}'
        for term in others
    ]
    return " ".join(f"<math>{piece}</math>" for piece in (left + write(first), *signed))


def _slope(name: str) -> str:
    """Write a time derivative: a dot over a letter, not over its index; a fraction of a word."""
    letters = re.search("<mi>(.*?)</mi>", name)
    if letters and len(unescape(letters[1])) > 1:
        d = '<mi mathvariant="normal">d</mi>'
        space = '<mspace width="0.15em"/>'
        return f"<mfrac><mrow>{d}{space}{name}</mrow><mrow>{d}<mi>t</mi></mrow></mfrac>"
    dotted = '<mover accent="true">\\g<0><mo>\u02d9</mo></mover>'
    return re.sub("<mi>.*?</mi>", dotted, name, count=1)


class AllDigits:
    """Writes floats with all their digits, as Python does; a base before a SymPy printer."""

    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return repr(float(expr))


def to_numpy(
    equations: Mapping[str, sympy.Expr],
) -> Callable[..., np.ndarray]:
    """Give a function ``rhs(t, state, inputs...)`` of numbers or arrays.

    ``state`` is (k, ...); inputs, by their place or by name, are functions of ``t``, numbers or
    arrays of shape (...); gives (k, ...).

    >>> to_numpy({"x": -2 * sympy.Symbol("x")})(0.0, np.array([3.0])).tolist()
    [-6.0]
    """
    calls = call_names(equations)
    rows = [with_signs(expr) for expr in equations.values()]
    function = compile_numpy(rows, [*equations, "t", *calls])

    def rhs(
        t: float, state: np.ndarray, *given: Any, **named: float | np.ndarray | Callable[..., Any]
    ) -> np.ndarray:
        values = take_inputs(calls, t, given, named)
        rows = np.broadcast_arrays(*np.asarray(state, dtype=float), t, *values)
        return function(np.array(rows, dtype=float))

    return rhs


def take_inputs(
    calls: Mapping[str, str], t: Any, given: Sequence[Any], named: Mapping[str, Any]
) -> list[Any]:
    """Give the values of inputs at a time, in their order.

    Parameters
    ----------
    calls : what :func:`call_names` gave.
    t : the time.
    given, named : what a call got by place and by name: functions of ``t``, or values.

    Raises TypeError when one is missing or none of that name is needed.
    """
    both = dict(zip(calls.values(), given, strict=False)) | dict(named)
    if len(given) > len(calls) or set(both) - set(calls.values()):
        raise TypeError(f"the inputs are: {', '.join(calls.values()) or 'none'}")
    if missing := [name for name in calls.values() if name not in both]:
        raise TypeError(f"input {missing[0]!r} is missing")
    values = [both[name] for name in calls.values()]
    return [value(t) if callable(value) else value for value in values]


class _Julia(AllDigits, JuliaCodePrinter):
    pass


def julia_code(expr: sympy.Expr) -> str:
    """Write one expression in Julia, for numbers.

    >>> julia_code(sympy.Symbol("x") ** 2 / 3)
    '0.3333333333333333 * x ^ 2'
    """
    # On numbers Julia's plain operators serve; SymPy prints the elementwise ones.
    code = str(_Julia({"contract": False}).doprint(as_float_tree(expr)))
    return code.replace(".*", "*").replace("./", "/").replace(".^", "^")


def left_of(state: str, discrete: bool) -> str:
    """Write the left side of the equation of a state: its slope, or its next row."""
    return f"{state}[n+1]" if discrete else f"{state}'"


def write_line(
    state: str,
    expr: sympy.Expr,
    discrete: bool = False,
    digits: int = 6,
    first: Collection[str] = (),
) -> str:
    """Write the equation of one state, or its map, in a line; see :func:`shown`."""
    return f"{left_of(state, discrete)} = {shown(expr, digits, first)}"


def shown(expr: sympy.Expr, digits: int = 6, first: Collection[str] = ()) -> str:
    """Write one expression for reading: floats to so many digits, no trailing zeros.

    Names that come ``first``, such as those of parameters, precede the others in a product.

    >>> shown(sympy.Float(9.81) * sympy.Symbol("x") - sympy.Float(0.1))
    '9.81*x - 0.1'
    >>> shown(sympy.Rational(981, 100) * sympy.Symbol("x") / 3 + sympy.Rational(8, 3))
    '3.27*x + 8/3'
    """
    text = _Text({"digits": digits}).doprint(_with_few_fractions(_put_first(expr, first)))
    return str(text).replace(_BEFORE, "")


def abridged(text: str) -> str:
    """Give a formula as it is written within a sentence: a long one without its end."""
    return text if len(text) <= 80 else text[:77] + "..."


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
