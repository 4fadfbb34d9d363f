"""Models: equations for tools that build models, ModelingToolkit, Catalyst, Modelica, CasADi."""

from __future__ import annotations

import numpy as np
import sympy
from sympy.printing.pycode import PythonCodePrinter

from dynsr.export.programs import PYTHON, numpy_code
from dynsr.export.reactions import Reaction, find_reactions
from dynsr.export.source import Source, Words, number, times
from dynsr.expression import JULIA_WORDS, AllDigits, julia_code, to_text

MODELINGTOOLKIT: Words = Words((*JULIA_WORDS, "D", "System", "complete", "Differential"))
CATALYST: Words = Words((*JULIA_WORDS, "D", "im", "nothing", "\u2205"))
MODELICA: Words = Words(
    (
        *("algorithm", "and", "annotation", "block", "break", "class", "connect", "connector"),
        *("constant", "constrainedby", "der", "discrete", "each", "else", "elseif", "elsewhen"),
        *("encapsulated", "end", "enumeration", "equation", "expandable", "extends", "external"),
        *("false", "final", "flow", "for", "function", "if", "import", "impure", "in", "initial"),
        *("inner", "input", "loop", "model", "not", "operator", "or", "outer", "output"),
        *("package", "parameter", "partial", "protected", "public", "pure", "record"),
        *("redeclare", "replaceable", "return", "stream", "then", "true", "type", "when"),
        *("while", "within", "time", "Real", "Integer", "Boolean", "String"),
    ),
    "//",
)
CONTROL: Words = Words(PYTHON.kept)


class CasadiPrinter(AllDigits, PythonCodePrinter):
    """Writes formulas in functions of CasADi."""

    def _print_Pow(self, expr: sympy.Pow, rational: bool = False) -> str:  # noqa: N802
        if expr.exp.is_Float and float(expr.exp) == 0.5:
            return f"casadi.sqrt({self._print(expr.base)})"
        return str(self._hprint_Pow(expr, rational=True, sqrt="casadi.sqrt"))

    def _print_Abs(self, expr: sympy.Expr) -> str:  # noqa: N802 (SymPy's protocol)
        return f"casadi.fabs({self._print(expr.args[0])})"

    def _print_Function(self, expr: sympy.Expr) -> str:  # noqa: N802 (SymPy's protocol)
        return f"casadi.{expr.func.__name__}({', '.join(map(self._print, expr.args))})"


for _name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log"):
    setattr(CasadiPrinter, f"_print_{_name}", CasadiPrinter._print_Function)  # noqa: SLF001
CasadiPrinter._print_sign = CasadiPrinter._print_Function  # noqa: SLF001


def write_modelingtoolkit(source: Source) -> str:
    """Write a system of ModelingToolkit.jl, version 9 or later.

    Parameters
    ----------
    source : what is written.
    """
    start, end, _ = times(source)
    values = [f"{n} = {number(v)}" for n, v in source.parameters.items()]
    values += [f"{u} = 0.0" for u in source.measured]
    firsts = [f"{s}(t) = {number(v)}" for s, v in zip(source.states, source.start, strict=True)]
    put = {sympy.Symbol(u): e for u, e in source.known.items()}
    lines = [
        f"    Differential(t)({s}) ~ {julia_code(e.xreplace(put))},"
        for s, e in source.equations.items()
    ]
    return "\n".join(
        [
            f"{source.comment('#')}using ModelingToolkit\n",
            "@independent_variables t",
            *_block("@parameters", values),
            *_block("@variables", firsts),
            "",
            "equations = vcat(",
            *lines,
            ")",
            "# The name of a system of equations is System from version 10 on.",
            "const Make = isdefined(ModelingToolkit, :System) ? ModelingToolkit.System : "
            "ModelingToolkit.ODESystem",
            "found = complete(Make(equations, t; name = :found))",
            "",
            "# using OrdinaryDiffEq",
            f"# solution = solve(ODEProblem(found, [], ({start}, {end})), Tsit5())",
            "",
        ]
    )


def write_catalyst(source: Source) -> str:
    """Write a reaction network of Catalyst.jl, where the equations are mass action.

    Parameters
    ----------
    source : what is written.

    Raises InputError where they are not.
    """
    values = [f"{n} = {number(v)}" for n, v in source.parameters.items()]
    values += [f"{u} = 0.0" for u in source.measured]
    firsts = [f"{s}(t) = {number(v)}" for s, v in zip(source.states, source.start, strict=True)]
    put = {sympy.Symbol(u): e for u, e in source.known.items()}
    lines = [f"    {_arrow(one, put)}" for one in find_reactions(source)]
    start, end, _ = times(source)
    return "\n".join(
        [
            f"{source.comment('#')}using Catalyst\n",
            "found = @reaction_network found begin",
            *(f"    {line}" for line in _block("@parameters", values)),
            *(f"    {line}" for line in _block("@species", firsts)),
            *lines,
            "end",
            "",
            "# using OrdinaryDiffEq",
            f"# solution = solve(ODEProblem(found, [], ({start}, {end})), Tsit5())",
            "",
        ]
    )


def _block(macro: str, lines: list[str]) -> list[str]:
    return [f"{macro} begin", *(f"    {line}" for line in lines), "end"] if lines else []


def _arrow(one: Reaction, put: dict[sympy.Symbol, sympy.Expr]) -> str:
    def side(counts: dict[str, int]) -> str:
        some = [f"{n if n > 1 else ''}{s}" for s, n in counts.items()]
        return " + ".join(some) or "\u2205"

    # Of one kind twice, Catalyst counts pairs: there the whole rate is given, with another arrow.
    alone = all(count == 1 for count in one.consumed.values())
    rate = julia_code((one.constant if alone else one.rate).xreplace(put))
    arrow = "-->" if alone else "=>"
    return f"{rate}, {side(dict(one.consumed))} {arrow} {side(dict(one.produced))}"


def write_modelica(source: Source) -> str:
    """Write a model of Modelica.

    Parameters
    ----------
    source : what is written.
    """
    swap = {sympy.Symbol("t"): sympy.Symbol("time")}
    swap |= {
        sympy.Symbol(name): sympy.Function("delay")(sympy.Symbol(own.state), own.value)
        for name, own in source.late.items()
    }

    def written(expr: sympy.Expr) -> str:
        return to_text(expr.xreplace(swap)).replace("**", "^").replace("Abs(", "abs(")

    lines = [f"  parameter Real {n} = {number(v)};" for n, v in source.parameters.items()]
    lines += [f"  input Real {u};" for u in source.measured if u not in source.late]
    lines += [f"  Real {u};" for u in source.known]
    lines += [
        f"  Real {s}(start = {number(v)}, fixed = true);"
        for s, v in zip(source.states, source.start, strict=True)
    ]
    lines += ["equation"]
    lines += [f"  {u} = {written(e)};" for u, e in source.known.items()]
    lines += [f"  der({s}) = {written(e)};" for s, e in source.equations.items()]
    start, end, count = times(source)
    width = (end - start) / (count - 1)
    about = f"StartTime = {start}, StopTime = {end}, Interval = {width}, Tolerance = 1e-9"
    return "\n".join(
        [
            f"{source.comment('//')}model Found",
            *lines,
            f"  annotation(experiment({about}));",
            "end Found;",
            "",
        ]
    )


def _spoken(source: Source) -> tuple[list[str], list[str]]:
    """Give lines of Python that set what is known of inputs, and the slopes."""
    printer = CasadiPrinter({"fully_qualified_modules": True})
    known = [f"{u} = {printer.doprint(e)}" for u, e in source.known.items()]
    return known, [printer.doprint(e) for e in source.equations.values()]


def write_casadi(source: Source) -> str:
    """Write a function of CasADi, and an integrator.

    Parameters
    ----------
    source : what is written.
    """
    known, slopes = _spoken(source)
    start, end, count = times(source)
    names = [*source.states, *source.measured, *source.parameters]
    values = ", ".join(map(number, source.parameters.values()))
    zeros = ", ".join(["0.0"] * len(source.measured))
    lines = [
        f"{source.comment('#')}import casadi\n",
        't = casadi.SX.sym("t")',
        *(f'{n} = casadi.SX.sym("{n}")' for n in names),
        *known,
        f"STATE = casadi.vertcat({', '.join(source.states)})",
        f"INPUT = casadi.vertcat({', '.join(source.measured)})",
        f"PARAMETER = casadi.vertcat({', '.join(source.parameters)})",
        f"SLOPE = casadi.vertcat({', '.join(slopes)})",
        f"PARAMETERS = [{values}]",
        f"START = [{', '.join(map(number, source.start))}]",
        "GIVEN = [t, STATE, INPUT, PARAMETER]",
        'rhs = casadi.Function("rhs", GIVEN, [SLOPE], ["t", "x", "u", "p"], ["slopes"])',
    ]
    if source.system.discrete:
        lines += [
            "",
            'if __name__ == "__main__":',
            "    state = START",
            f"    for row in range({count - 1}):",
            f"        now = {start} + row * {number(source.system.step)}",
            f"        state = rhs(now, state, [{zeros}], PARAMETERS)",
            "    print(*state.full().ravel())",
        ]
    else:
        lines += [
            'problem = {"t": t, "x": STATE, "u": INPUT, "p": PARAMETER, "ode": SLOPE}',
            'options = {"reltol": 1e-10, "abstol": 1e-12, "max_num_steps": 100000}',
            f'integrate = casadi.integrator("found", "cvodes", problem, {start}, {end}, options)',
            "",
            'if __name__ == "__main__":',
            f"    solution = integrate(x0=START, u=[{zeros}], p=PARAMETERS)",
            '    print(*solution["xf"].full().ravel())',
        ]
    return "\n".join([*lines, ""])


def write_control(source: Source) -> str:
    """Write a system of python-control.

    Parameters
    ----------
    source : what is written.
    """
    known = [f"    {u} = {numpy_code(e)}" for u, e in source.known.items()]
    slopes = ", ".join(numpy_code(e) for e in source.equations.values())
    start, end, count = times(source)
    used = source.needed(*source.equations.values())
    values = ", ".join(f'"{n}": {number(v)}' for n, v in source.parameters.items())
    lists = [str(list(names)).replace("'", '"') for names in (source.measured, source.states)]
    zero = ", 0.0" if source.measured else ""
    discrete = source.system.discrete
    step = f"    dt={number(source.system.step)},\n" if discrete else ""
    exact = '{"rtol": 1e-10, "atol": 1e-12, "method": "LSODA"}'
    return "\n".join(
        [
            f"{source.comment('#')}import control",
            "import numpy",
            "",
            f"PARAMETERS = {{{values}}}",
            f"START = [{', '.join(map(number, source.start))}]",
            "",
            "",
            "def update(t, state, inputs, params):",
            f"    {', '.join(source.states)}, = state",
            *(f"    {u}, = inputs" for u in [", ".join(source.measured)] if u),
            *(f'    {n} = params["{n}"]' for n in source.parameters if n in used),
            *known,
            f"    return numpy.array([{slopes}])",
            "",
            "",
            "found = control.nlsys(",
            "    update,",
            "    None,",
            f"    inputs={lists[0]},",
            f"    states={lists[1]},",
            f"    outputs={lists[1]},",
            "    params=PARAMETERS,",
            '    name="found",',
            f"{step})",
            "",
            'if __name__ == "__main__":',
            f"    times = numpy.linspace({start}, {end}, {count})",
            "    response = control.input_output_response(",
            f"        found, times{zero}, initial_state=START,",
            *([] if discrete else [f"        solve_ivp_kwargs={exact},"]),
            "    )",
            "    print(*response.states[:, -1])",
            "",
        ]
    )


def write_do_mpc(source: Source) -> str:
    """Write a model of do-mpc with a simulator, and a controller where there are inputs.

    Parameters
    ----------
    source : what is written; the time, where the equations hold it, is one more state.
    """
    known, slopes = _spoken(source)
    values = ", ".join(f'"{n}": {number(v)}' for n, v in source.parameters.items())
    start, end, count = times(source)
    discrete = source.system.discrete
    step = number(source.system.step if discrete else (end - start) / (count - 1))
    clock = f"t + {step}" if discrete else "casadi.SX(1)"
    first = [*map(number, source.start), *([number(start)] if source.timed else [])]
    lines = [
        f"{source.comment('#')}import casadi",
        "import do_mpc",
        "",
        f'model = do_mpc.model.Model("{"discrete" if discrete else "continuous"}")',
        *(f'{s} = model.set_variable("_x", "{s}")' for s in source.states),
        *(['t = model.set_variable("_x", "t")'] if source.timed else []),
        *(f'{u} = model.set_variable("_u", "{u}")' for u in source.measured),
        *(f'{n} = model.set_variable("_p", "{n}")' for n in source.parameters),
        *known,
        *(
            f'model.set_rhs("{s}", casadi.SX({e}))'
            for s, e in zip(source.states, slopes, strict=True)
        ),
        *([f'model.set_rhs("t", {clock})'] if source.timed else []),
        "model.setup()",
        f"PARAMETERS = {{{values}}}",
        f"START = [{', '.join(first)}]",
        f"STEP = {step}",
        "",
        "",
        "def simulate():",
        "    simulator = do_mpc.simulator.Simulator(model)",
        f"    simulator.set_param(t_step={'1' if discrete else 'STEP'})",
        *(
            []
            if discrete
            else [
                '    simulator.set_param(integration_tool="cvodes", abstol=1e-12, reltol=1e-10)',
            ]
        ),
        *_known_to("simulator", "get_p_template()", bool(source.parameters)),
        "    simulator.setup()",
        "    simulator.x0 = casadi.DM(START)",
        "    return simulator",
        "",
        "",
    ]
    if source.measured:
        lines += _controller(source)
    lines += [
        'if __name__ == "__main__":',
        "    state, simulator = casadi.DM(START), simulate()",
        *(["    controller = control(START)"] if source.measured else []),
        f"    for row in range({count - 1}):",
        "        state = simulator.make_step("
        + ("controller.make_step(state)" if source.measured else "")
        + ")",
        f"    print(*state[:{len(source.states)}, 0])",
    ]
    return "\n".join([*lines, ""])


def _known_to(part: str, template: str, some: bool, place: str = "") -> list[str]:
    """Write what gives a part of do-mpc the values of the parameters."""
    if not some:
        return []
    return [
        f"    known = {part}.{template}",
        "    for name, value in PARAMETERS.items():",
        f"        known[{place}name] = value",
        f"    {part}.set_p_fun(lambda now: known)",
    ]


def _controller(source: Source) -> list[str]:
    """Write a controller that brings the states to values, the inputs within those of the data."""
    bounds = []
    for name in source.measured:
        old = (source.own or {}).get(name, name)
        values = [run.by_name[old] for run in source.runs if old in run.names]
        if values:
            ends = {
                "lower": np.min(np.concatenate(values)),
                "upper": np.max(np.concatenate(values)),
            }
            bounds += [
                f'    controller.bounds["{side}", "_u", "{name}"] = {number(end)}'
                for side, end in ends.items()
            ]
    miss = " + ".join(f"({s} - aim[{place}]) ** 2" for place, s in enumerate(source.states))
    rates = ", ".join(f"{u}=0.01" for u in source.measured)
    discrete = source.system.discrete
    return [
        "def control(aim):",
        '    """Give a controller that brings the states to aim; weights and bounds are yours."""',
        "    controller = do_mpc.controller.MPC(model)",
        f"    controller.set_param(n_horizon=20, t_step={'1' if discrete else 'STEP'})",
        "    controller.settings.supress_ipopt_output()",
        f"    miss = {miss}",
        "    controller.set_objective(mterm=miss, lterm=miss)",
        f"    controller.set_rterm({rates})",
        *bounds,
        *_known_to("controller", "get_p_template(1)", bool(source.parameters), '"_p", 0, '),
        "    controller.setup()",
        "    controller.x0 = casadi.DM(START)",
        "    controller.set_initial_guess()",
        "    return controller",
        "",
        "",
    ]
