from xml.etree import ElementTree

import numpy as np
import pytest
from known_systems import made
from scipy.integrate import solve_ivp

from dynsr.data.system import CART_POLE
from dynsr.discovery.result import Discovery
from dynsr.engines.simulation import simulate
from dynsr.errors import InputError
from dynsr.expression.export import (
    call_names,
    to_latex,
    to_mathml,
    to_numpy,
    with_signs,
)
from dynsr.expression.parsing import parse
from dynsr.verdict.prediction import predict

EQUATIONS = dict(zip(CART_POLE.states, CART_POLE.rhs, strict=True))
STATE = np.array([0.3, -0.2, 1.1, 0.4])
FORCE = 0.7


@pytest.fixture(scope="module")
def expected():
    """Give the slopes of the cart-pole written out by hand."""
    w, _, y, z = STATE
    below = 2 - np.cos(w) ** 2
    return np.array(
        [
            y,
            z,
            -(19.62 * np.sin(w) + np.sin(w) * np.cos(w) * y**2 + FORCE * np.cos(w)) / below,
            -(np.sin(w) * y**2 + 9.81 * np.sin(w) * np.cos(w) + FORCE) / below,
        ]
    )


def test_the_numpy_function_is_the_equations(expected):
    """One state or many at once give the slopes worked out by hand."""
    rhs = to_numpy(EQUATIONS)
    assert np.allclose(rhs(0.0, STATE, F=FORCE), expected, rtol=1e-14)
    many = rhs(0.0, np.column_stack([STATE, STATE]), F=np.array([FORCE, FORCE]))
    assert np.allclose(many, expected[:, None], rtol=1e-14)


def test_the_python_code_runs_on_its_own(expected):
    """The written module holds all it needs, and integrates with scipy."""
    space: dict = {}
    exec(made(EQUATIONS).to_python(), space)
    assert np.allclose(space["rhs"](0.0, STATE, lambda t: FORCE), expected, rtol=1e-14)
    solved = solve_ivp(space["rhs"], (0, 1), STATE, args=(lambda t: FORCE,))
    assert solved.success


def test_the_torch_module_is_the_equations_and_can_be_trained(expected):
    """It gives the same slopes, and the gradient by a constant is the true one."""
    import torch

    from dynsr.discovery.hybrid import EquationModule

    module = EquationModule(EQUATIONS)
    out = module(0.0, torch.tensor(STATE), F=torch.tensor(FORCE, dtype=torch.float64))
    assert np.allclose(out.detach().numpy(), expected, rtol=1e-12)
    decay = EquationModule({"x": parse("-0.5*x")})
    decay(0.0, torch.tensor([3.0], dtype=torch.float64)).sum().backward()
    assert decay.constants.grad.tolist() == [3.0]
    assert decay.equations() == {"x": "-0.5*x"}


def test_the_julia_code_parses_as_julia():
    """A Julia parser finds no error in the function written."""
    tree_sitter = pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
    julia = pytest.importorskip("tree_sitter_julia", reason="tree-sitter-julia is not installed")
    parser = tree_sitter.Parser(tree_sitter.Language(julia.language()))
    code = made({**EQUATIONS, "r": parse("x/3 + abs(y)^1.5")}).to_julia()
    assert not parser.parse(code.encode()).root_node.has_error
    assert "p.F(t)" in code and ".*" not in code


def test_latex_is_short_and_complete():
    """Constants have six digits and every state its dot."""
    text = to_latex({"theta1": parse("9.810000001*theta2"), "theta2": parse("1/theta1")})
    assert r"\dot{\theta_{1}} &= 9.81 \theta_{2}" in text
    assert r"\frac{1}{\theta_{1}}" in text


def test_a_word_is_set_as_one_in_latex():
    """A word is upright, two words have a space between, and its slope is a fraction, not a dot."""
    text = to_latex({"substrate": parse("2*biomass*substrate"), "x": parse("x*y")})
    assert text.splitlines()[1:3] == [
        r"\frac{\mathrm{d} \mathrm{substrate}}{\mathrm{d} t} &= "
        r"2 \, \mathrm{biomass} \, \mathrm{substrate} \\",
        r"\dot{x} &= x y",
    ]


@pytest.mark.parametrize("name", ["substrate", "substrate_2"])
def test_the_slope_of_a_word_is_a_fraction_in_mathml(name):
    """It is d(substrate)/dt; a letter, a Greek one too, has a dot."""
    left = to_mathml(parse("1"), name).partition("<mo>=")[0]
    assert left.startswith("<math><mfrac>") and "\u02d9" not in left and "substrate" in left
    for letter in ("x", "theta", "theta1"):
        assert "\u02d9" in to_mathml(parse("1"), letter)


def test_prediction_by_expression_by_values_and_by_the_simulator_agree():
    """The force as expression or as sampled values gives the simulator's own trajectory."""
    t = np.linspace(0, 3, 301)
    truth = simulate(CART_POLE, t=t, reltol=1e-10, abstol=1e-12).x
    by_expression = predict(EQUATIONS, CART_POLE.x0, t, CART_POLE.inputs)
    values = -0.2 + 0.5 * np.sin(6 * t)
    by_values = predict(EQUATIONS, CART_POLE.x0, t, {"F": values})
    assert np.allclose(by_expression.x, truth, atol=1e-6)
    assert np.allclose(by_values.x, truth, atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0], [0.0, 1.0]), "nothing says what 'F' does"),
        (([1.0], [0.0, 1.0], {"F": [1.0]}), r"input 'F' has shape \(1,\)"),
        (([1.0, 2.0], [0.0, 1.0], {"F": "t"}), "x0 must be 1 numbers"),
    ],
)
def test_what_is_missing_is_named(arguments, message):
    """A missing input, one of the wrong length, and a wrong start are each one clear line."""
    with pytest.raises(InputError, match=message):
        predict({"x": parse("F - x")}, *arguments)


def test_formulas_are_mathml():
    """A quotient becomes a fraction, a power a superscript; floats are short, 1e-7 a power."""
    text = to_mathml(parse("9.810000001*x^2/(1 + y)"))
    assert "<mfrac>" in text and "<msup>" in text and "<mn>9.81</mn>" in text
    small = to_mathml(parse("2.5e-7*x"))
    assert "<mn>2.5</mn><mo>&#215;</mo><msup><mn>10</mn><mn>&#8722;7</mn></msup>" in small


def test_each_term_of_an_equation_is_an_element_of_its_own():
    """Browsers can break lines between terms; signs stand before them, the dot over the letter."""
    terms = to_mathml(parse("y - 3*x - exp(x)"), "theta1").split(" <math>")
    assert len(terms) == 3 and terms[0].startswith("<math><msub><mover")
    assert terms[1].startswith('<mo form="infix">+') and terms[2].startswith('<mo form="infix">−')
    for text in (terms[0], *("<math>" + term for term in terms[1:])):
        ElementTree.fromstring(text.replace("&InvisibleTimes;", "").replace("&ExponentialE;", "e"))


@pytest.mark.parametrize("name", ["F", "u", "state", "math", "end", "self", "rhs"])
@pytest.mark.parametrize("value", [0.7, lambda t: 0.5 + 0.1 * t])
def test_inputs_are_called_alike_in_every_export(name, value):
    """By place or by the same name, as a number or a function of time: each gives the same."""
    import torch

    from dynsr.discovery.hybrid import EquationModule

    equations = {"x": parse(f"2*{name} - x*k")}
    called = call_names(equations)[name]
    space: dict = {}
    exec(made(equations).to_python(), space)
    module = EquationModule(equations)
    for function in (space["rhs"], to_numpy(equations)):
        for found in (
            function(2.0, np.array([3.0]), *((value, 2.0) if name < "k" else (2.0, value))),
            function(2.0, np.array([3.0]), **{called: value, "k": 2.0}),
        ):
            assert np.allclose(found, [2 * 0.7 - 6.0])
    found = module(2.0, torch.tensor([3.0], dtype=torch.float64), **{called: value, "k": 2.0})
    assert np.allclose(found.detach().numpy(), [2 * 0.7 - 6.0])
    assert f"p.{called} isa Number ? p.{called} : p.{called}(t)" in made(equations).to_julia()


def test_an_input_that_is_missing_or_too_much_is_named():
    """A call with too few or unknown inputs says which there are."""
    rhs = to_numpy({"x": parse("F + G")})
    with pytest.raises(TypeError, match="input 'G' is missing"):
        rhs(0.0, np.array([1.0]), F=1.0)
    with pytest.raises(TypeError, match="the inputs are: F, G"):
        rhs(0.0, np.array([1.0]), F=1.0, G=2.0, H=3.0)


@pytest.mark.parametrize(
    ("text", "truth"),
    [
        ("-0.3*v/sqrt(v**2)", lambda v: -0.3 * np.sign(v)),
        ("v**2*v/sqrt(v**2) - v", lambda v: v * np.abs(v) - v),
        ("2*v/abs(v)", lambda v: 2 * np.sign(v)),
        ("v**2/(v**2)**0.5", np.abs),
        ("(v - 1)/sqrt((v - 1)**2)", lambda v: np.sign(v - 1)),
        ("sqrt(9*v**2)*v", lambda v: 3 * np.abs(v) * v),
    ],
)
def test_exports_divide_by_nothing_that_the_formula_does_not(text, truth):
    """Friction written as a quotient of roots is a sign: at rest it is 0 and no error."""
    import torch

    from dynsr.discovery.hybrid import EquationModule

    equations = {"v": parse(text)}
    space: dict = {}
    exec(made(equations).to_python(), space)
    module = EquationModule(equations)
    for v in (-1.5, 0.0, 1.0, 2.0):
        assert space["rhs"](0.0, [v])[0] == pytest.approx(truth(v), abs=1e-15)
        assert to_numpy(equations)(0.0, np.array([v]))[0] == pytest.approx(truth(v), abs=1e-15)
        found = module(0.0, torch.tensor([v], dtype=torch.float64))
        assert found.item() == pytest.approx(truth(v), abs=1e-15)
    assert " / " not in made(equations).to_julia()


def test_a_division_of_the_formula_stays():
    """What divides by a size that may be 0 in truth still does."""
    assert "Abs(v)" in str(with_signs(parse("1/abs(v)")))
    assert with_signs(parse("v/abs(v)**3")) == parse("sign(v)/abs(v)**2")


def test_code_says_what_the_time_is_counted_in():
    """A unit that is known stands in a comment of every export; one that is not, nowhere."""
    equations = {"x": parse("-x")}
    for write in (Discovery.to_python, Discovery.to_julia):
        assert "# The time t is in days.\n" in write(made(equations, time_unit="days"))
        assert "t is in" not in write(made(equations))
    assert to_latex(equations, "days").startswith("% time in days\n")


def test_numbers_stand_in_code_where_no_names_are_asked_for():
    """The short forms hold each number, whole ones as such; else they are the named forms."""
    found = made({"x": parse("-2*x + u/3")})
    code = found.to_python()
    assert "def rhs(t, state, u):" in code and "- 2*x" in code and "0.3333333333333333*u" in code
    assert "k1" not in code + found.to_julia()
    assert "k1=" in found.export("python") and "k1 = p.k1" in found.export("julia")
    named, plain = {}, {}
    exec(found.export("python"), named)
    exec(code, plain)
    for function in ("rhs", "jacobian"):
        assert np.allclose(named[function](0.0, [1.5], 0.6), plain[function](0.0, [1.5], 0.6))
