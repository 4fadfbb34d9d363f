"""Programs: equations as functions of Python, torch, JAX, C, Fortran, MATLAB, R and Julia."""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import sympy
from sympy.printing.c import C99CodePrinter, reserved_words_c99
from sympy.printing.fortran import FCodePrinter
from sympy.printing.numpy import JaxPrinter, NumPyPrinter
from sympy.printing.octave import OctaveCodePrinter
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.pycode import AbstractPythonCodePrinter
from sympy.printing.rcode import RCodePrinter
from sympy.printing.rcode import reserved_words as reserved_words_r

from dynsr.export.source import Source, Words, number, times
from dynsr.expression import FUNCTIONS, JULIA_WORDS, AllDigits, julia_code

PYTHON: Words = Words((*keyword.kwlist, "__debug__", "self"), local=True, underscore=True)
# What a module of torch is and has: a parameter of that name would take its place.
TORCH: Words = Words(
    (
        *PYTHON.kept,
        *("training", "forward", "train", "eval", "type", "half", "double", "float", "cpu", "cuda"),
        *("apply", "buffers", "children", "compile", "modules", "parameters", "to", "to_empty"),
        *("named_parameters", "named_modules", "named_children", "named_buffers", "state_dict"),
        *("load_state_dict", "zero_grad", "share_memory", "bfloat16", "xpu", "ipu", "mtia"),
        *("add_module", "extra_repr", "requires_grad_", "dump_patches", "call_super_init"),
        *("register_buffer", "register_module", "register_parameter", "get_parameter"),
        *("get_buffer", "get_submodule", "set_submodule", "get_extra_state", "set_extra_state"),
    ),
    local=True,
)
C: Words = Words(
    (*reserved_words_c99, "main", "NULL", *("j0", "j1", "jn", "y0", "y1", "yn", "gamma", "I")),
    "//",
)
# Intrinsic functions and words of statements are allowed as names, but not beside their own use.
FORTRAN: Words = Words(
    ("dp", "end", "if", "do", "real", "integer", "program", "result"), "!", fold=True
)
MATLAB: Words = Words(
    (
        *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for"),
        *("function", "global", "if", "otherwise", "parfor", "persistent", "return", "spmd"),
        *("switch", "try", "while", "do", "until", "unwind_protect", "ans", "nargin"),
        *("end_try_catch", "endfor", "endfunction", "endif", "endwhile", "unwind_protect_cleanup"),
        *("endswitch", "end_unwind_protect"),
    ),
    "%",
)
JULIA: Words = Words(JULIA_WORDS)
R: Words = Words(
    (*reserved_words_r, "TRUE", "FALSE", "NULL", "NA", "Inf", "NaN", "repeat", "c", "list")
)


class _Python(AllDigits, NumPyPrinter):
    pass


class _Jax(AllDigits, JaxPrinter):
    pass


class _Torch(AllDigits, AbstractPythonCodePrinter):
    # SymPy's own printer loads all of torch: a second and 200 MB for each report.
    _kf: ClassVar[dict[str, str]] = {
        one.sympy.__name__: f"torch.{one.torch}"
        for one in FUNCTIONS.values()
        if isinstance(one.sympy, type)
    }

    def _print_Pow(self, expr: sympy.Pow, **_: Any) -> str:  # noqa: N802 (SymPy's protocol)
        # torch.pow takes no number for a base, and a root of a tensor is a power too.
        tightest = PRECEDENCE["Atom"]
        base = self.parenthesize(expr.base, tightest, strict=True)
        return f"{base}**{self.parenthesize(expr.exp, tightest, strict=True)}"


class _C(AllDigits, C99CodePrinter):
    pass


class _Fortran(FCodePrinter):
    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802 (SymPy's protocol)
        return real(float(expr))


class _Octave(AllDigits, OctaveCodePrinter):
    pass


class _R(AllDigits, RCodePrinter):
    pass


def numpy_code(expr: sympy.Expr) -> str:
    """Write one expression for numpy.

    Parameters
    ----------
    expr : the expression, as :func:`dynsr.export.source.as_code` gives it.

    >>> numpy_code(sympy.exp(sympy.Symbol("x")))
    'numpy.exp(x)'
    """
    return str(_Python({"fully_qualified_modules": True}).doprint(expr))


def real(value: float) -> str:
    """Write a number of double precision in Fortran.

    Parameters
    ----------
    value : the number.

    >>> real(1e-07), real(0.5)
    ('1d-07', '0.5d0')
    """
    text = repr(value)
    return text.replace("e", "d") if "e" in text else f"{text}d0"


def _unpacked(names: Sequence[str]) -> str:
    return ", ".join(names) + ("," if len(names) == 1 else "")


def write_python(source: Source) -> str:
    """Write a module: right-hand side and Jacobian for numpy, and an example for solve_ivp.

    Parameters
    ----------
    source : what is written.
    """
    name = "step" if source.system.discrete else "rhs"
    options = [f"{n}={number(v)}" for n, v in source.parameters.items()]
    given = ["t", "state", *source.measured, *(["*"] if options else [])]
    head = ", ".join([*given, *options])
    body = [f"    {_unpacked(source.states)} = state"]
    body += [f"    {u} = {u}(t) if callable({u}) else {u}" for u in source.measured]
    body += [f"    {u} = {numpy_code(e)}" for u, e in source.known.items()]
    slopes = ", ".join(numpy_code(e) for e in source.equations.values())
    rows = ",\n        ".join(
        f"[{', '.join(numpy_code(e) for e in row)}]" for row in source.jacobian
    )
    start, end, count = times(source)
    first = f"[{', '.join(map(number, source.start))}]"
    inputs = [f"{u}=0.0" for u in source.measured if u not in source.late]
    inputs += [f"{u}=past({n}, {d})" for u, n, d in _delayed(source)]
    call = f"lambda t, state: {{}}(t, state, {', '.join(inputs)})" if inputs else "{}"
    remark = "    # Put in what the inputs do: numbers, or functions of t.\n" if inputs else ""
    if source.system.discrete:
        example = (
            f"    state = {first}\n"
            f"    for t in numpy.linspace({start}, {end}, {count})[:-1]:\n"
            f"        state = {name}(t, state{''.join(f', {i}' for i in inputs)})\n"
            "    print(state)\n"
        )
        load = ""
    elif source.late:
        load = "    from scipy.integrate import solve_ivp\n\n"
        remark = "    # Put in the states before the first time, and what other inputs do.\n"
        example = _steps(source, start, end, first, call.format("rhs"))
    else:
        load = "    from scipy.integrate import solve_ivp\n\n"
        example = (
            f"    solution = solve_ivp(\n        {call.format('rhs')},\n        ({start}, {end}),\n"
            f'        {first},\n        method="LSODA",\n        jac={call.format("jacobian")},\n'
            "        rtol=1e-9,\n        atol=1e-12,\n    )\n    print(*solution.y[:, -1])\n"
        )
    return (
        f"{source.comment('#')}import numpy\n\n\ndef {name}({head}):\n"
        + "\n".join(body)
        + f"\n    return numpy.array([{slopes}])\n\n\ndef jacobian({head}):\n"
        + "\n".join(body)
        + f"\n    return numpy.array([\n        {rows},\n    ])\n\n\n"
        + f'if __name__ == "__main__":\n{load}{remark}{example}'
    )


def _delayed(source: Source) -> list[tuple[str, int, str]]:
    """Give the name of each delayed state, the place of its state, and the delay."""
    return [(u, source.states.index(d.state), number(d.value)) for u, d in source.late.items()]


def _steps(source: Source, start: float, end: float, first: str, call: str) -> str:
    """Write the method of steps: within the shortest delay, delayed states are known."""
    shortest = number(min(own.value for own in source.late.values()))
    return (
        f"    before = {first}\n"
        "    parts = []\n\n"
        "    def past(place, delay):\n"
        "        def value(t):\n"
        "            for begin, part in reversed(parts):\n"
        "                if t - delay >= begin:\n"
        "                    return part(t - delay)[place]\n"
        "            return before[place]\n\n"
        "        return value\n\n"
        f"    now, state = {start}, before\n"
        f"    while now < {end}:\n"
        f"        later = min(now + {shortest}, {end})\n"
        f"        solution = solve_ivp(\n            {call},\n            (now, later),\n"
        '            state,\n            method="DOP853",\n            dense_output=True,\n'
        "            rtol=1e-9,\n            atol=1e-12,\n        )\n"
        "        parts.append((now, solution.sol))\n"
        "        now, state = later, solution.y[:, -1]\n"
        "    print(*state)\n"
    )


def write_torch(source: Source) -> str:
    """Write a module of torch whose parameters can be trained.

    Parameters
    ----------
    source : what is written.
    """
    printer = _Torch({"fully_qualified_modules": True})
    own = [
        f"        self.{n} = torch.nn.Parameter(torch.tensor({number(v)}, dtype=torch.float64))"
        for n, v in source.parameters.items()
    ]
    used = source.needed(*source.equations.values())
    body = [f"        {_unpacked(source.states)} = state.unbind(-1)"]
    body += [f"        {n} = self.{n}" for n in source.parameters if n in used]
    for u in source.measured:
        body.append(f"        {u} = {u}(t) if callable({u}) else {u}")
        body.append(f"        {u} = torch.as_tensor({u}, dtype=state.dtype)")
    if source.timed:
        body.append("        t = torch.as_tensor(t, dtype=state.dtype)")
    body += [f"        {u} = {printer.doprint(e)}" for u, e in source.known.items()]
    slopes = [
        f"            torch.as_tensor({printer.doprint(e)}, dtype=state.dtype),"
        for e in source.equations.values()
    ]
    head = ", ".join(["self", "t", "state", *source.measured])
    return "\n".join(
        [
            f"{source.comment('#')}import torch\n\n",
            "class Found(torch.nn.Module):",
            "    def __init__(self):",
            "        super().__init__()",
            *own,
            "",
            f"    def forward({head}):",
            *body,
            "        slopes = torch.broadcast_tensors(",
            *slopes,
            "        )",
            "        return torch.stack(slopes, -1)",
            "",
        ]
    )


def write_jax(source: Source) -> str:
    """Write a right-hand side ``rhs(t, state, args)`` for JAX, and an example for diffrax.

    Parameters
    ----------
    source : what is written.
    """
    printer = _Jax({"fully_qualified_modules": True})
    used = source.needed(*source.equations.values())
    inputs = {u: source.called(u) for u in source.measured}
    given = {**source.parameters, **dict.fromkeys(inputs.values(), 0.0)}
    values = ", ".join(f'"{n}": {number(v)}' for n, v in given.items())
    body = [f"    {_unpacked(source.states)} = state"]
    body += [f'    {n} = args["{n}"]' for n in source.parameters if n in used]
    body += [
        f'    {u} = args["{c}"](t) if callable(args["{c}"]) else args["{c}"]'
        for u, c in inputs.items()
    ]
    body += [f"    {u} = {printer.doprint(e)}" for u, e in source.known.items()]
    slopes = ", ".join(printer.doprint(e) for e in source.equations.values())
    start, end, _ = times(source)
    first = ", ".join(map(number, source.start))
    lines = [
        f"{source.comment('#')}import jax",
        "import jax.numpy",
        "",
        'jax.config.update("jax_enable_x64", True)',
        f"PARAMETERS = {{{values}}}",
        "",
        "",
        "def rhs(t, state, args):",
        *body,
        f"    return jax.numpy.stack(jax.numpy.broadcast_arrays({slopes}))",
        "",
        "",
        'if __name__ == "__main__":',
        "    import diffrax",
        "",
        "    solution = diffrax.diffeqsolve(",
        "        diffrax.ODETerm(rhs),",
        "        diffrax.Tsit5(),",
        f"        t0={start},",
        f"        t1={end},",
        "        dt0=None,",
        f"        y0=jax.numpy.array([{first}]),",
        "        args=PARAMETERS,",
        "        stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-12),",
        "        max_steps=1_000_000,",
        "    )",
        "    print(*solution.ys[-1])",
        "",
    ]
    return "\n".join(lines)


def write_c(source: Source) -> str:
    """Write C99: right-hand side, Jacobian, and an example that integrates.

    Parameters
    ----------
    source : what is written.
    """
    printer = _C()
    k = len(source.states)
    name = "found_step" if source.system.discrete else "found_rhs"

    def body(exprs: Sequence[sympy.Expr]) -> list[str]:
        used = source.needed(*exprs)
        lines = [
            f"    const double {s} = state[{i}];" for i, s in enumerate(source.states) if s in used
        ]
        lines += [
            f"    const double {p} = parameters[{i}];"
            for i, p in enumerate(source.parameters)
            if p in used
        ]
        lines += [
            f"    const double {u} = inputs[{i}];"
            for i, u in enumerate(source.measured)
            if u in used
        ]
        return lines + [
            f"    const double {u} = {printer.doprint(e)};"
            for u, e in source.known.items()
            if u in used
        ]

    given = "double t, const double *state, const double *parameters, const double *inputs"
    idle = "    (void)t; (void)state; (void)parameters; (void)inputs;"
    exprs = list(source.equations.values())
    entries = [e for row in source.jacobian for e in row]
    values = ", ".join(map(number, source.parameters.values())) or "0.0"
    start, end, _ = times(source)
    steps = 100 * times(source)[2]
    lines = [
        source.comment("//") + "#include <math.h>\n",
        f"const double found_parameters[{max(1, len(source.parameters))}] = {{{values}}};",
        f"const double found_start[{k}] = {{{', '.join(map(number, source.start))}}};\n",
        f"void {name}({given}, double *slope) {{",
        idle,
        *body(exprs),
        *(f"    slope[{i}] = {printer.doprint(e)};" for i, e in enumerate(exprs)),
        "}\n",
        "// Row by row: derivatives of slope[i] by state[j] at slot i * number of states + j.",
        f"void found_jacobian({given}, double *slope) {{",
        idle,
        *body(entries),
        *(f"    slope[{i}] = {printer.doprint(e)};" for i, e in enumerate(entries)),
        "}",
    ]
    if not source.system.discrete and not source.measured:
        lines += [
            "",
            "// cc -DFOUND_EXAMPLE found.c -lm: Runge-Kutta steps, the last state printed.",
            "#ifdef FOUND_EXAMPLE",
            "#include <stdio.h>",
            "int main(void) {",
            f"    const int steps = {steps}, states = {k};",
            f"    const double begin = {start}, width = ({end} - ({start})) / steps;",
            "    const double part[4] = {0.0, 0.5, 0.5, 1.0}, share[4] = {1.0, 2.0, 2.0, 1.0};",
            f"    double now[{k}], after[{k}], inner[{k}], slope[{k}];",
            "    for (int item = 0; item < states; item++) now[item] = found_start[item];",
            "    for (int step = 0; step < steps; step++) {",
            "        for (int item = 0; item < states; item++) {",
            "            after[item] = now[item];",
            "            slope[item] = 0.0;",
            "        }",
            "        for (int stage = 0; stage < 4; stage++) {",
            "            for (int item = 0; item < states; item++)",
            "                inner[item] = now[item] + part[stage] * width * slope[item];",
            "            const double when = begin + (step + part[stage]) * width;",
            "            found_rhs(when, inner, found_parameters, 0, slope);",
            "            for (int item = 0; item < states; item++)",
            "                after[item] += share[stage] * width * slope[item] / 6.0;",
            "        }",
            "        for (int item = 0; item < states; item++) now[item] = after[item];",
            "    }",
            '    for (int item = 0; item < states; item++) printf("%.17g\\n", now[item]);',
            "    return 0;",
            "}",
            "#endif",
        ]
    return "\n".join(lines) + "\n"


def write_fortran(source: Source) -> str:
    """Write a module of Fortran 2003 with the right-hand side and the Jacobian.

    Parameters
    ----------
    source : what is written.
    """
    printer = _Fortran({"source_format": "free", "standard": 2003, "name_mangling": False})
    k = len(source.states)
    name = "found_step" if source.system.discrete else "found_rhs"
    inputs = source.measured

    def routine(title: str, size: str, exprs: Sequence[sympy.Expr], slots: Sequence[str]) -> str:
        used = source.needed(*exprs)
        own = {s: f"state({i})" for i, s in enumerate(source.states, 1)}
        own |= {p: f"parameters({i})" for i, p in enumerate(source.parameters, 1)}
        own |= {u: f"inputs({i})" for i, u in enumerate(inputs, 1)}
        own |= dict.fromkeys(source.known, "")
        local = [n for n in own if n in used]
        lines = [
            f"  subroutine {title}(t, state, parameters, inputs, slope)",
            "    real(dp), intent(in) :: t, state(:), parameters(:), inputs(:)",
            f"    real(dp), intent(out) :: slope{size}",
            *(f"    real(dp) :: {n}" for n in local),
            *(f"    {n} = {own[n]}" for n in local if own[n]),
            *(_assign(printer, n, source.known[n]) for n in local if not own[n]),
            *(_assign(printer, slot, e) for slot, e in zip(slots, exprs, strict=True)),
            f"  end subroutine {title}",
        ]
        return "\n".join(lines)

    values = source.parameters.values()
    count = len(values)
    entries = [e for row in source.jacobian for e in row]
    slots = [f"slope({i}, {j})" for i in range(1, k + 1) for j in range(1, k + 1)]
    return "\n".join(
        [
            source.comment("!") + "module found",
            "  implicit none",
            "  integer, parameter :: dp = kind(1d0)",
            f"  real(dp), parameter :: found_parameters({count}) = {_list(values)}",
            f"  real(dp), parameter :: found_start({k}) = {_list(source.start)}",
            "contains",
            routine(
                name,
                f"({k})",
                list(source.equations.values()),
                [f"slope({i})" for i in range(1, k + 1)],
            ),
            "",
            routine("found_jacobian", f"({k}, {k})", entries, slots),
            "end module found\n",
        ]
    )


def _list(values: Iterable[float]) -> str:
    # A line of Fortran has 132 letters at most.
    return "[real(dp) :: &\n    " + ", &\n    ".join(map(real, values)) + "]"


def _assign(printer: FCodePrinter, name: str, expr: sympy.Expr) -> str:
    lines = printer.doprint(expr, assign_to=sympy.Symbol("assigned")).splitlines()
    return "\n".join(f"    {line}" for line in lines).replace("assigned", name, 1)


def write_matlab(source: Source) -> str:
    """Write a function for MATLAB and Octave.

    Parameters
    ----------
    source : what is written.
    """
    printer = _Octave()
    name = "step" if source.system.discrete else "rhs"
    used = source.needed(*source.equations.values())
    values = ", ".join(f"'{n}', {number(v)}" for n, v in source.parameters.items())
    start, end, _ = times(source)
    first = "; ".join(map(number, source.start))
    call = f"@(t, state) {name}(t, state{', p' if source.measured else ''})"
    example = f"% [t, states] = ode45({call}, [{start} {end}], [{first}]);\n"
    if source.late:
        lags = "; ".join(delay for *_, delay in _delayed(source))
        put = "p"
        for column, (u, place, _) in enumerate(_delayed(source), 1):
            put = f"setfield({put}, '{source.called(u)}', Z({place + 1}, {column}))"
        example = (
            f"% solution = dde23(@(t, state, Z) rhs(t, state, {put}), [{lags}], [{first}], "
            f"[{start} {end}]);\n"
        )
    lines = [f"  {s} = state({i});" for i, s in enumerate(source.states, 1) if s in used]
    lines += [f"  {n} = p.{n};" for n in source.parameters if n in used]
    for u in source.measured:
        called = source.called(u)
        lines += [f"  {u} = p.{called};", f"  if isa({u}, 'function_handle'), {u} = {u}(t); end"]
    lines += [f"  {u} = {_plain(printer, e)};" for u, e in source.known.items() if u in used]
    slopes = "; ...\n    ".join(_plain(printer, e) for e in source.equations.values())
    default = f"  if nargin < 3, p = struct({values}); end\n" if not source.measured else ""
    fields = ", ".join([*source.parameters, *map(source.called, source.measured)])
    taken = [f"% p has the fields {fields}.\n"] if fields else []
    return (
        f"function slope = {name}(t, state, p)\n"
        f"{source.comment('%')}{''.join(taken)}{'' if source.system.discrete else example}"
        f"{default}" + "\n".join(lines) + f"\n  slope = [ ...\n    {slopes}];\nend\n"
    )


def _plain(printer: OctaveCodePrinter, expr: sympy.Expr) -> str:
    # On numbers plain operators serve; SymPy prints the elementwise ones.
    code = str(printer.doprint(expr))
    return code.replace(".*", "*").replace("./", "/").replace(".^", "^")


def write_r(source: Source) -> str:
    """Write a function of R for deSolve.

    Parameters
    ----------
    source : what is written.
    """
    printer = _R()
    name = "step" if source.system.discrete else "rhs"
    used = source.needed(*source.equations.values())
    start, end, count = times(source)
    values = ", ".join(f"{n} = {number(v)}" for n, v in source.parameters.items())
    first = ", ".join(
        f"{s} = {number(v)}" for s, v in zip(source.states, source.start, strict=True)
    )
    lines = [f'  {s} <- state[["{s}"]]' for s in source.states if s in used]
    lines += [f'  {n} <- parameters[["{n}"]]' for n in source.parameters if n in used]
    for u in source.measured:
        lines += [f"  {u} <- inputs${source.called(u)}", f"  if (is.function({u})) {u} <- {u}(t)"]
    lines += [f"  {u} <- {printer.doprint(e)}" for u, e in source.known.items() if u in used]
    slopes = ", ".join(printer.doprint(e) for e in source.equations.values())
    call = f"times = seq({start}, {end}, length.out = {count}), func = rhs, parms = parameters"
    more = ", inputs = list(" + ", ".join(f"{source.called(u)} = 0" for u in source.measured) + ")"
    example = (
        ""
        if source.system.discrete
        else (
            "# library(deSolve)\n"
            f"# solution <- ode(y = start, {call}{more if source.measured else ''})\n"
        )
    )
    if source.late:
        late = ", ".join(
            f"{source.called(u)} = if (t - {d} > {start}) lagvalue(t - {d}, {n + 1}) "
            f"else start[[{n + 1}]]"
            for u, n, d in _delayed(source)
        )
        example = (
            "# library(deSolve)\n# late <- function(t, state, parameters)\n"
            f"#   rhs(t, state, parameters, list({late}))\n"
            f"# solution <- dede(y = start, {call.replace('func = rhs', 'func = late')})\n"
        )
    head = ", ".join(["t", "state", "parameters", *(["inputs"] if source.measured else [])])
    return (
        f"{source.comment('#')}parameters <- c({values})\nstart <- c({first})\n\n"
        f"{name} <- function({head}) {{\n"
        + "\n".join(lines)
        + f"\n  list(c({slopes}))\n}}\n\n{example}"
    )


def write_julia(source: Source) -> str:
    """Write a function of Julia for DifferentialEquations.jl.

    Parameters
    ----------
    source : what is written.
    """
    name = "step!" if source.system.discrete else "rhs!"
    used = source.needed(*source.equations.values())
    inputs = {u: source.called(u) for u in source.measured}
    given = {**source.parameters, **dict.fromkeys(inputs.values(), 0.0)}
    values = ", ".join(f"{n} = {number(v)}" for n, v in given.items())
    lines = [f"    {s} = u[{i}]" for i, s in enumerate(source.states, 1) if s in used]
    lines += [f"    {n} = p.{n}" for n in source.parameters if n in used]
    lines += [f"    {u} = p.{c} isa Number ? p.{c} : p.{c}(t)" for u, c in inputs.items()]
    lines += [f"    {u} = {julia_code(e)}" for u, e in source.known.items() if u in used]
    lines += [f"    du[{i}] = {julia_code(e)}" for i, e in enumerate(source.equations.values(), 1)]
    start, end, count = times(source)
    first = ", ".join(map(number, source.start))
    package, more = "OrdinaryDiffEq", ""
    problem = f"ODEProblem({name}, start, ({start}, {end}), parameters)"
    solver, exact = "Tsit5()", "; reltol=1e-9, abstol=1e-12"
    if source.system.discrete:
        package, solver, exact = "OrdinaryDiffEqFunctionMap", "FunctionMap()", ""
        # Julia counts rows, and calls a map with the row that comes next.
        row = f"{start} + (n - 1) * {number(source.system.step)}"
        called = f"(du, u, p, n) -> {name}(du, u, p, {row})" if source.timed else name
        problem = f"DiscreteProblem({called}, start, (0, {count - 1}), parameters)"
    if source.late:
        late = ", ".join(
            f"{source.called(u)} = h(p, t - {d}; idxs = {n + 1})" for u, n, d in _delayed(source)
        )
        lags = ", ".join(delay for *_, delay in _delayed(source))
        more = (
            "# using DelayDiffEq\n"
            "# past(p, t; idxs = nothing) = idxs === nothing ? start : start[idxs]\n"
            f"# late!(du, u, h, p, t) = rhs!(du, u, merge(p, (; {late})), t)\n"
        )
        rest = f"({start}, {end}), parameters; constant_lags = [{lags}]"
        problem, solver = f"DDEProblem(late!, start, past, {rest})", "MethodOfSteps(Tsit5())"
    return (
        f"{source.comment('#')}parameters = (; {values})\nstart = [{first}]\n\n"
        f"function {name}(du, u, p, t)\n"
        + "\n".join(lines)
        + f"\n    return nothing\nend\n\n# using {package}\n{more}"
        + f"# solution = solve({problem}, {solver}{exact})\n"
    )
