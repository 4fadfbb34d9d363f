"""The first look at exact data: what it finds, and when nothing more is searched."""

import numpy as np
import pytest
import sympy
from looking import look_twice
from measured_systems import run

import dynsr
from dynsr.data import choose_samples, join_samples
from dynsr.expression import evaluate, parse, ratio_forms, skeleton
from dynsr.fit import (
    Shooting,
    approach,
    confirm,
    simplest_form,
    with_floats,
)
from dynsr.library import structure_in
from dynsr.selection import look

LAWS = {
    "two species": (
        lambda x, y: (0.7 * x - 0.4 * x * y, 0.3 * x * y - 0.9 * y),
        (2.0, 1.0),
        30.0,
        ("x", "y"),
        {"x": "0.7*x - 0.4*x*y", "y": "0.3*x*y - 0.9*y"},
    ),
    "an enzyme": (
        lambda s, p: (-1.3 * s / (s + 0.4), 1.3 * s / (s + 0.4) - 0.2 * p),
        (3.0, 0.1),
        6.0,
        ("s", "p"),
        {"s": "-1.3*s/(s + 0.4)", "p": "1.3*s/(s + 0.4) - 0.2*p"},
    ),
    "a pendulum": (
        lambda q, v: (v, -0.3 * v - 7.7 * np.sin(q)),
        (1.9, 0.0),
        9.0,
        ("q", "v"),
        {"q": "v", "v": "-0.3*v - 7.7*sin(q)"},
    ),
    "a pole on a cart": (
        lambda q, v: (v, -(np.sin(q) * (9 + v**2 * np.cos(q)) + v / 2) / (1 + np.sin(q) ** 2)),
        (1.9, 0.0),
        9.0,
        ("q", "v"),
        {"q": "v", "v": "(-9*sin(q) - v^2*sin(q)*cos(q) - v/2)/(sin(q)^2 + 1)"},
    ),
}


@pytest.mark.slow
def test_two_saturations_far_above_their_constants_are_found_together():
    """Alone each follows nothing; with all constants free they are expected to, and they do."""

    def circuit(a, b, c, d):
        return (
            -0.87 * a / (a + 0.98) + 0.27 * b + 1.8 * d**3 / (d**3 + 1) + 0.15,
            -0.49 * b + 0.38 * c + 0.26 + 2 / (a + 1),
            0.93 * b / (b + 0.54) - 0.98 * c / (c + 0.77),
            -0.49 * d / (d + 0.41) + 2.6 / (c**4 + 1),
        )

    data = run(circuit, (2.1, 1.6, 2.3, 1.7), 16.0, 300, ("a", "b", "c", "d"))
    found = dynsr.discover(data, targets=["c"], jobs=1)
    law = parse("0.93*b/(b + 0.54) - 0.98*c/(c + 0.77)")
    assert sympy.simplify(found.equations["c"] - law) == 0


# The pendulum's is told by distant rows below.
@pytest.mark.parametrize("name", [name for name in LAWS if name != "a pendulum"])
@pytest.mark.slow
def test_a_final_law_ends_the_search(name):
    """Sums and ratios of exact data are found; no other method runs, as the record says."""
    rhs, start, end, names, law = LAWS[name]
    found = dynsr.discover(run(rhs, start, end, 200, names), jobs=1)
    assert found.settings["first_look"] == sorted(names)
    assert found.verdict.level == "law"
    for state, expected in law.items():
        difference = found.equations[state] - parse(expected)
        assert sympy.simplify(sympy.nsimplify(difference, rational=True)) == 0
    assert all("rational" not in c.source for own in found.front.values() for c in own)


@pytest.mark.slow
def test_distant_rows_are_confirmed_on_the_states():
    """Ten rows a swing give slopes no nearer than 1e-4; the states leave no doubt of the law."""
    rhs, start, _, names, law = LAWS["a pendulum"]
    data = run(rhs, start, 8.0, 40, names)
    samples = choose_samples([data], "v")
    exact = evaluate(parse(law["v"]), samples.columns)
    assert np.std(samples.y - exact) > 1e-4 * np.std(exact)
    found = dynsr.discover(data, jobs=1)
    assert found.settings["first_look"] == ["q", "v"]
    assert found.verdict.level == "law" and str(found.equations["q"]) == "v"
    assert str(found.equations["v"]) == "-0.3*v - 7.7*sin(q)"


@pytest.mark.slow
def test_a_law_beyond_the_library_is_not_final():
    """Where no sum of few terms is the law, many that are not miss as little: search goes on."""
    rhs = lambda x, y: (y, -0.5 * np.arctan(3 * x) - 0.1 * y)  # noqa: E731
    data = run(rhs, (1.0, 0.0), 12.0, 300, ("x", "y"))
    assert not look(choose_samples([data], "y")).final
    assert confirm({"x": parse("y"), "y": parse("-0.9*x - 0.1*y")}, [data], {}) is None


@pytest.mark.slow
def test_a_short_arc_is_not_final():
    """A tenth of a turn of a law with a root is followed by many sums, and none is taken for it."""
    rhs = lambda x: (-np.sqrt(1.7 + x**2) * np.exp(-x),)  # noqa: E731
    data = run(rhs, (1.0,), 0.3, 60, ("x",))
    assert not look(choose_samples([data], "x")).final


def test_exact_states_are_met_from_far_off():
    """Twelve wrong constants are led to the law of exact rows, and what is nothing is left out;
    in noise of a thousandth nothing is met, nor by what lacks a term.
    """
    rhs, start, _, names, law = LAWS["two species"]
    exact = run(rhs, start, 12.0, 60, names)
    rng = np.random.default_rng(1)
    products = [parse(text) for text in ("1", "x", "y", "x*y", "x^2", "y^2")]
    true = {"x": (0, 0.7, 0, -0.4, 0, 0), "y": (0, 0, -0.9, 0.3, 0, 0)}
    wrong = {state: own + 0.2 * rng.normal(size=6) for state, own in true.items()}

    def summed(numbers, count=6):
        return sum(sympy.Float(c) * b for c, b in zip(numbers[:count], products, strict=False))

    far = {state: summed(own) for state, own in wrong.items()}
    met = approach(far, [exact], {})
    for state, own in law.items():
        assert skeleton(met[state]) == skeleton(parse(own))
        assert evaluate(met[state] - parse(own), exact.by_name) == pytest.approx(0, abs=1e-5)
    noise = 1e-3 * exact.x.std(axis=0) * rng.standard_normal(exact.x.shape)
    assert approach(far, [dynsr.Trajectory(exact.t, exact.x + noise, names)], {}) is None
    assert approach({s: summed(own, 3) for s, own in wrong.items()}, [exact], {}) is None


def test_what_exact_states_do_not_confirm_is_given_up_soon(monkeypatch):
    """Of a law each step leaves a small part of the misses; where steps creep no more are taken."""
    rhs, start, _, names, _ = LAWS["two species"]
    exact = run(rhs, start, 30.0, 60, names)
    steps = []
    linearise = Shooting.linearise
    monkeypatch.setattr(
        Shooting, "linearise", lambda self, *given: steps.append(1) or linearise(self, *given)
    )
    creeping = {"x": parse("0.9*sqrt(x) - 0.5*x*y/(x + 0.3)"), "y": parse("0.4*x - 0.8*y")}
    assert confirm(creeping, [exact], {}) is None
    assert 0 < len(steps) < 15


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("state", ["x", "y"])
@pytest.mark.slow
def test_little_noise_ends_a_search_only_with_the_law(state, seed):
    """With noise of a ten thousandth of the spread, what is final has the terms of the law.

    The states confirm nothing then, since they are missed by the noise.
    """
    rhs, start, end, names, laws = LAWS["two species"]
    data = run(rhs, start, end / 2, 100, names)
    rng = np.random.default_rng(seed)
    x = data.x + 1e-4 * data.x.std(axis=0) * rng.standard_normal(data.x.shape)
    noisy = dynsr.Trajectory(data.t, x, names)
    seen = look(choose_samples([noisy], state))
    shapes = [skeleton(with_floats(e)) for e in (seen.candidates[0].expr, parse(laws[state]))]
    assert not seen.final or shapes[0] == shapes[1]
    assert confirm({s: parse(e) for s, e in laws.items()}, [noisy], {}) is None


@pytest.mark.parametrize(
    ("ratio", "form"),
    [
        ("(0.6*x*y + 0.3*y - 1.4*x)/(2*x + 1)", "0.3*y - 0.7*x/(x + 0.5)"),
        ("(-0.2*x**3 + 0.8*x**2 - 0.1*x)/(x + 1)", "-0.2*x**2 + x - 1.1*x/(x + 1)"),
    ],
)
def test_a_ratio_is_written_as_it_is_shortest(ratio, form):
    """Of the forms of one ratio that with the fewest bits is taken, whatever it came as."""
    columns = {"x": np.linspace(0.2, 3, 40), "y": np.cos(np.linspace(0, 9, 40))}
    found = simplest_form(parse(ratio).evalf(), columns)
    assert sympy.simplify(sympy.nsimplify(found - parse(form), rational=True)) == 0
    assert sympy.count_ops(found) <= sympy.count_ops(parse(ratio))


@pytest.mark.parametrize(
    ("fitted", "form"),
    [
        (
            "0.14*y - 4.655172413793103*x**2/(x**2 + 0.58) + 4.875172413793103",
            "0.22 + 2.7/(x**2 + 0.58) + 0.14*y",
        ),
        ("0.82*x/(x + 0.51) + 0.69 - 0.759/(x + 1.1)", "0.82*x/(x + 0.51) + 0.69*x/(x + 1.1)"),
        # What 1.258 misses its simple number by is much where it is written as 0.058.
        (
            "1.2*x**3/(x**3 + 1) - 1.2*x/(x + 0.84) + 0.05800074",
            "0.058 + 1.2*x**3/(x**3 + 1) - 1.2*x/(x + 0.84)",
        ),
    ],
)
def test_sums_of_ratios_are_written_in_simple_numbers(fitted, form):
    """Each ratio of a sum takes the form in which all constants are simple numbers."""
    columns = {"x": np.linspace(0.2, 3, 40), "y": np.cos(np.linspace(0, 9, 40))}
    length = structure_in(columns)
    found = simplest_form(parse(fitted).evalf(), columns, length=lambda e: length({"x": e}))
    assert skeleton(found.evalf()) == skeleton(parse(form).evalf())
    assert sympy.simplify(found - sympy.nsimplify(parse(form), rational=True)) == 0


@pytest.mark.parametrize(
    "text",
    ["(0.6*x*y + 0.3*y - 1.4*x**2)/(2*x + 1)", "1.3/(0.4 + x**2) + y*x/(x + 2) - 0.1*y + 0.7"],
)
def test_forms_of_a_ratio_are_one_function(text):
    """Every form has the same values."""
    expr = parse(text).evalf()
    point = {"x": 0.73, "y": -1.9}
    values = [float(form.subs(point)) for form in ratio_forms(expr)]
    assert len(values) > 3
    np.testing.assert_allclose(values, float(expr.subs(point)), rtol=1e-12)


def test_rows_where_differences_fail_do_not_bend_the_others():
    """A run that begins fast has wrong slopes there; x - x^3 is exact in all other rows."""
    starts = ((-2.0, 120), (-0.1, 150), (0.3, 80))
    runs = [run(lambda x: (x - x**3,), (start,), 4.0, rows, ("x",)) for start, rows in starts]
    samples = join_samples([choose_samples(one, "x") for one in runs])
    seen = look(samples)
    assert seen.final and str(seen.candidates[0].expr) == "-x**3 + x"


INSIDE = {
    "a saturation of order two, half of few rows lost": (
        lambda x, y: (
            1.5 * x - 0.3 * x**2 - 1.8 * x**2 * y / (x**2 + 1.6),
            0.7 * x**2 * y / (x**2 + 1.6) - 0.3 * y,
        ),
        (1.1, 1.3),
        24.0,
        ("x", "y"),
    ),
    "a power of a difference": (
        lambda h, g: (-0.7 * (h - g) ** 1.25, 0.4 * (h - g) ** 1.25 - 0.2 * g),
        (5.0, 0.5),
        9.0,
        ("h", "g"),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", INSIDE)
def test_a_constant_inside_a_function_is_found_from_few_exact_rows(name):
    """Laws with a constant inside are final, and true at other states than those of the run."""
    rhs, start, end, names = INSIDE[name]
    whole = run(rhs, start, end, 120, names, rtol=1e-11)
    kept = np.sort(np.random.default_rng(1).choice(120, 60, replace=False))
    data = dynsr.Trajectory(whole.t[kept], whole.x[kept], names)
    others = {n: 1.2 * whole.x[::-1, i] + 0.1 * (1 - i) for i, n in enumerate(names)}
    true = rhs(*others.values())
    for place, state in enumerate(names):
        seen = look(choose_samples([data], state))
        assert seen.final
        found = evaluate(seen.candidates[0].expr, others)
        assert np.max(np.abs(found - true[place])) < 1e-4 * np.std(true[place])


COUPLED = {
    # The text of each equation, a start, the span, and what is known of the others.
    "a step of a line of two columns": (
        {"x": "-x + 1.6*tanh(1.4*x - 0.9*y)", "y": "-y + 1.6*tanh(1.4*y + 0.9*x)"},
        (0.3, 1.2),
        8.0,
        (),
    ),
    "a twin with constants of its own": (
        {"x": "0.8 - x*exp(-0.7*x*y)", "y": "1.1 - 0.9*y*exp(-0.4*x*y)"},
        (2.6, 0.4),
        8.0,
        ("y",),
    ),
    "what levels off to either side": (
        {"x": "0.75*y/sqrt(0.9 + y^2) - 0.35*x", "y": "1.1 - 0.8*x - 0.2*y"},
        (0.1, 2.5),
        14.0,
        (),
    ),
    "a vortex": (
        {"x": "-0.8*y/(x^2 + y^2) - 0.2*x", "y": "0.8*x/(x^2 + y^2) - 0.2*y"},
        (1.6, 0.3),
        5.0,
        (),
    ),
    "a planet, all of whose columns keep relations": (
        {
            "u": "-1.2*x/(x^2 + y^2)^(3/2)",
            "w": "-1.2*y/(x^2 + y^2)^(3/2)",
            "x": "u",
            "y": "w",
        },
        (0.0, 1.3, 0.9, 0.0),
        9.0,
        (),
    ),
    "what two others take": (
        {
            "r": "0.8*r - 0.2*r^2 - 0.5*r*x/(1 + r) - 0.7*r*y/(2 + r)",
            "x": "0.35*r*x/(1 + r) - 0.2*x",
            "y": "0.4*r*y/(2 + r) - 0.15*y",
        },
        (2.5, 0.6, 0.9),
        20.0,
        ("x", "y"),
    ),
}


def coupled(name):
    """Give the equations of a system, exact rows of it, and which equations are known."""
    texts, start, end, told = COUPLED[name]
    laws = {state: parse(text) for state, text in texts.items()}
    rhs = sympy.lambdify(list(map(sympy.Symbol, laws)), list(laws.values()))
    return laws, run(rhs, start, end, 250, tuple(laws), 1e-12, every_row=True), told


# What two others take is found in a discovery below.
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in COUPLED if name != "what two others take"])
def test_exact_slopes_are_looked_at_again_beside_other_equations(name):
    """Terms of several columns are found, and those that other equations have too."""
    laws, data, told = coupled(name)
    state = next(iter(laws))
    samples = choose_samples([data], state)
    seen = look_twice(samples, known={other: laws[other] for other in told})
    assert seen.final
    beside = {s: np.roll(x, 40 * i) for i, (s, x) in enumerate(samples.columns.items())}
    assert evaluate(seen.candidates[0].expr, beside) == pytest.approx(
        evaluate(laws[state], beside), rel=1e-6
    )


@pytest.mark.slow
def test_of_what_one_ellipse_leaves_open_a_planet_obeys_what_holds_for_its_other_axis():
    """Alone, exact slopes leave many forms; the twin of the first equation, with the same
    constants, is none of many.
    """
    laws, data, _ = coupled("a planet, all of whose columns keep relations")
    samples = choose_samples([data], "w")
    seen = look(samples, known={"u": laws["u"]})
    assert seen.final
    assert seen.candidates[0].expr == sympy.nsimplify(laws["w"], rational=True)


@pytest.mark.slow
def test_a_discovery_ends_where_looks_find_all_states():
    """Three equations with terms in common are found, no method runs, and none is planned."""
    laws, data, _ = coupled("what two others take")
    steps = []
    found = dynsr.discover(data, jobs=1, progress=steps.append)
    assert steps[-1].done == steps[-1].total == 3
    assert found.settings["first_look"] == sorted(laws)
    assert found.verdict.level == "law"
    assert all("rational" not in c.source for own in found.front.values() for c in own)
    beside = {s: np.roll(data.x[:, i], 40 * i) for i, s in enumerate(laws)}
    for state, law in laws.items():
        truth = evaluate(law, beside)
        assert evaluate(found.equations[state], beside) == pytest.approx(truth, rel=1e-5)


@pytest.mark.slow
def test_what_is_left_to_do_is_counted_to_its_end():
    """One state is done at once; the searches and the choice of the other stay in the plan."""
    data = run(
        lambda x, y: (-0.7 * x, 0.3 * x - y * np.abs(np.sin(8.7 * x * y)) ** 1.3),
        (2.0, 0.6),
        6.0,
        60,
        ("x", "y"),
    )
    steps = []
    found = dynsr.discover(data, preset="quick", jobs=1, progress=steps.append)
    assert found.settings["first_look"] == ["x"]
    assert all(step.done <= step.total for step in steps)
    named = dict.fromkeys(step.what for step in steps if step.what)
    assert list(named)[-1] == "choice of y'"
    assert steps[-1].done == steps[-1].total == len(named)


@pytest.mark.slow
def test_a_spring_that_swings_round_keeps_its_momentum_and_is_no_other_law():
    """Along one run r^2 w stays the same, so that 1.584 w / r, 2.509 / r^3 and r w^2 are one.

    What has whole coefficients is taken, and none of the others is called a law.
    """
    r, u, w = sympy.symbols("r u w")
    laws = (u, w, r * w**2 - 3.1 * (r - 1.4), -2 * u * w / r)
    rhs = sympy.lambdify([r, sympy.Symbol("a"), u, w], laws)
    whole = run(rhs, (1.2, 0.0, 0.3, 1.1), 10.0, 300, ("r", "a", "u", "w"), 1e-11)
    kept = np.sort(np.random.default_rng(0).choice(300, 150, replace=False))
    found = dynsr.discover(dynsr.Trajectory(whole.t[kept], whole.x[kept], whole.states), jobs=1)
    assert found.equations["u"] == r * w**2 - 3.1 * r + 4.34
    assert found.equations["w"] == -2 * u * w / r
    assert found.verdict.states["u"].level == "approximation"
    assert "satisfy a relation" in found.verdict.states["u"].reason


@pytest.mark.slow
def test_a_term_of_another_equation_brings_its_constant():
    """A prey whose growth slows as Gompertz says is found where its predator's equation is known.

    What is eaten stands there, with its constant 0.7, and costs no constant a second time.
    """

    def hunt(n, p):
        eaten = n * p / (n + 0.7)
        return 0.8 * n * np.log(3 / n) - 0.6 * eaten, 0.5 * eaten - 0.3 * p

    samples = choose_samples(run(hunt, (1.0, 1.0), 30.0, 300, ("n", "p")), "n")
    seen = look(samples, known={"p": parse("0.5*n*p/(n + 0.7) - 0.3*p")})
    assert seen.final
    law = parse("0.878889831*n - 0.8*n*log(n) - 0.6*n*p/(n + 0.7)")
    columns = samples.columns
    np.testing.assert_allclose(
        evaluate(seen.candidates[0].expr, columns), evaluate(law, columns), rtol=1e-6, atol=1e-7
    )
