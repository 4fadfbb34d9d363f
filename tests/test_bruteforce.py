import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy

from dynsr.data.samples import Samples, make_samples
from dynsr.data.trajectory import Trajectory
from dynsr.errors import InputError
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.fit.description import choose
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, search_values
from dynsr.methods.feynman.enumeration.finishing import Pool
from dynsr.methods.feynman.stages.base import Context
from dynsr.methods.feynman.stages.brute_force import Enumeration

GOLDEN = Path(__file__).parent / "golden" / "tsit5"
SMALL = BruteForce(max_size=5, beam=0, device="cpu")


def planted(formula: str, names: str, rows: int = 300, seed: int = 0) -> Samples:
    """Samples of a formula of one-letter variables drawn from (0.5, 2)."""
    X = np.random.default_rng(seed).uniform(0.5, 2.0, (rows, len(names)))
    y = evaluate(parse(formula, list(names)), dict(zip(names, X.T, strict=True)))
    return Samples(X, y, tuple(names), "y", "given", np.arange(float(rows)))


def skeleton(expr: sympy.Expr) -> sympy.Expr:
    """The formula with every float replaced by 1."""
    return expr.xreplace({a: sympy.Integer(1) for a in expr.atoms(sympy.Float)})


@pytest.mark.slow
@pytest.mark.parametrize(
    "formula",
    [
        "3.7*sin(x*y) - 1.2",
        "x/(x+y)",
        "2*sqrt(x + y^2) + 0.5",
        "exp(1.5*x*y - 0.3)",
        "1/(2*x*y + 3)",
        "asin(0.2*x*y)",
        "1.5*x*y - 0.3*y^2 + 2",
        "0.4*x^(3/2)/y^2",
        "2*x*exp(-0.7*x*y)/y",
        "sqrt(1.3*x^2 + 0.6*y)",
    ],
)
def test_planted_functions_are_found_exactly(formula):
    """Affine forms, domain changes, sums, power laws and exponentials come out to rounding."""
    samples = planted(formula, "xy")
    result = search_values(samples.X, samples.y, samples.names, SMALL)
    assert result.stopped == "exact"
    fresh = planted(formula, "xy", seed=1)
    best = min(result.candidates, key=lambda c: c.loss)
    assert np.allclose(evaluate(best.expr, fresh.columns), fresh.y, rtol=1e-8)


def load(name: str, states: tuple[str, ...]) -> Trajectory:
    """The paper's training data from OrdinaryDiffEq."""
    rows = np.loadtxt(GOLDEN / f"{name}_train_saveat0.01_default.csv.gz", delimiter=",")
    return Trajectory(rows[:, 0], rows[:, 1:], states)


@pytest.mark.parametrize(
    ("system", "states", "target", "truth"),
    [
        ("lotka_volterra", ("x", "y"), "x", "1.5*x - 1.0*x*y"),
        ("lotka_volterra", ("x", "y"), "y", "1.0*x*y - 3.0*y"),
        ("simple_pendulum", ("theta1", "theta2"), "theta1", "theta2"),
        ("simple_pendulum", ("theta1", "theta2"), "theta2", "-0.1*theta2 - 9.81*sin(theta1)"),
    ],
)
def test_the_papers_systems_are_found_from_its_own_data(system, states, target, truth):
    """Every equation has its exact form and constants within 1 % under Tsit5's slope errors."""
    samples = make_samples(load(system, states), target, "central4")
    settings = replace(SMALL, patience=1)
    result = search_values(samples.X, samples.y, samples.names, settings)
    assert result.stopped == "stable"
    chosen = choose(result.candidates, samples).expr
    true = parse(truth, states)
    difference = sympy.Poly(chosen - true, *(true.atoms(sympy.sin) | {*map(sympy.Symbol, states)}))
    largest = sympy.Poly(true, *difference.gens)
    assert set(difference.monoms()) <= set(largest.monoms()) | {(0,) * len(difference.gens)}
    for monom, coefficient in zip(difference.monoms(), difference.coeffs(), strict=True):
        assert abs(coefficient) <= 0.01 * abs(largest.coeff_monomial(monom))


def test_no_function_is_tested_twice():
    """Over x alone with + and *, the tests are the polynomial classes counted by hand."""
    x = np.linspace(0.5, 2.0, 100)
    settings = BruteForce(
        operators=("+", "*"),
        constants=(),
        changes=(),
        monomials=False,
        max_size=5,
        sums=(),
        device="cpu",
    )
    y = np.cos(7 * x)
    result = search_values(x[:, None], y, ["x"], settings)
    # Size 1: x. Size 3: 2x (affine in x) and x^2. Size 5, a leaf with one of size 3: x + x^2 and
    # x^3 beside 3x and 2x^2, which are affine in earlier ones.
    assert result.distinct == 4
    assert result.formed == 1 + 2 + 4
    assert result.complete == 5
    # Strings: 1 of size 1, 2 of size 3, 2 * 2 * 2 of size 5.
    assert result.covered == 11


@pytest.mark.slow
def test_two_searches_agree_to_the_last_digit():
    """The same samples and settings give the same candidates, counts and order."""
    samples = planted("sin(x) + cos(y)*exp(x)/y", "xy")
    settings = BruteForce(max_size=4, beam=16, sums=(50,), device="cpu")
    first = search_values(samples.X, samples.y, samples.names, settings)
    second = search_values(samples.X, samples.y, samples.names, settings)
    assert first.candidates == second.candidates
    assert (first.formed, first.distinct) == (second.formed, second.distinct)


def test_torch_gives_what_numpy_gives():
    """The same code on torch's CPU arrays looks at the same functions and finds the same forms."""
    samples = planted("3.7*sin(x*y) - 1.2/x", "xy")
    results = [
        search_values(
            samples.X,
            samples.y,
            samples.names,
            BruteForce(max_size=4, sums=(), beam=0, device=device),
        )
        for device in ("cpu", "torch-cpu")
    ]
    assert abs(results[0].distinct - results[1].distinct) <= 0.001 * results[0].distinct
    assert results[0].formed == pytest.approx(results[1].formed, rel=0.001)
    forms = [skeleton(min(r.candidates, key=lambda c: c.loss).expr) for r in results]
    assert forms[0] == forms[1]


@pytest.mark.slow
def test_memory_bound_is_kept():
    """Once the bound is met nothing more is stored, but the search goes on to its other bounds."""
    samples = planted("cos(x)*sin(y) + x*exp(-y*y)/(x+log(1+y))", "xy")
    settings = BruteForce(max_memory=3.0, max_candidates=100_000, sums=(), beam=0, device="cpu")
    result = search_values(samples.X, samples.y, samples.names, settings)
    free = BruteForce(max_candidates=100_000, sums=(), beam=0, device="cpu")
    unbounded = search_values(samples.X, samples.y, samples.names, free)
    assert result.nbytes <= 3.0 * 2**20 < unbounded.nbytes
    assert result.formed >= 100_000 and result.stopped == "candidates"
    assert result.stored < unbounded.stored


def test_deadline_ends_the_search():
    """A search of unbounded size ends within its seconds, with candidates."""
    samples = planted("cos(x)*sin(y) + x*exp(-y*y)/(x+log(1+y))", "xy")
    settings = BruteForce(seconds=0.2, max_candidates=1e12, sums=(100,), device="cpu")
    began = time.monotonic()
    result = search_values(samples.X, samples.y, samples.names, settings)
    assert result.stopped == "deadline" and result.candidates
    assert time.monotonic() - began < 10


def test_interruption_returns_what_was_found():
    """Ctrl-C in the middle gives the candidates so far."""
    samples = planted("cos(x)*sin(y) + x*exp(-y*y)/(x+log(1+y))", "xy")

    def interrupt(running):
        if running.formed > 100:
            raise KeyboardInterrupt

    settings = BruteForce(max_candidates=50_000, device="cpu")
    result = search_values(samples.X, samples.y, samples.names, settings, interrupt)
    assert result.stopped == "interrupted"
    assert result.candidates
    assert result.formed < 50_000


def test_stage_gives_candidates_scored_on_its_samples():
    """The stage's losses are RMSEs on the samples it was given."""
    samples = planted("3.7*sin(x*y) - 1.2", "xy")
    context = Context(np.random.default_rng(0), deadline=time.monotonic() + 60)
    found = Enumeration(SMALL).run(samples, context)
    for candidate in found:
        error = evaluate(candidate.expr, samples.columns) - samples.y
        assert candidate.loss == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6, abs=1e-13)


@pytest.mark.slow
def test_a_stage_writes_formulas_out_at_its_end_alone(monkeypatch):
    """What the reports of a stage do not show is not written out for them."""
    written = []
    candidates = Pool.candidates
    monkeypatch.setattr(
        Pool, "candidates", lambda pool, name: written.append(name) or candidates(pool, name)
    )
    told = []
    samples = planted("3.7*sin(x*y) - 1.2", "xy")
    Enumeration(SMALL).run(samples, Context(np.random.default_rng(0), report=told.append))
    assert len(told) > 1 and told[-1].done > told[0].done > 0
    assert len(written) == 1
    SMALL.search(samples, np.random.default_rng(0), told.append)
    assert len(told[-1].front) > 0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"operators": ("+", "gamma")}, "gamma"),
        ({"max_size": 0}, "max_size"),
        ({"probes": 2}, "probes"),
    ],
)
def test_bad_settings_are_refused(change, named):
    """The line names the setting."""
    with pytest.raises(InputError, match=named):
        BruteForce(**change)


def test_bad_values_are_refused():
    """Shapes that do not fit, values that are not finite and unknown changes are InputErrors."""
    X = np.ones((4, 2))
    with pytest.raises(InputError, match="do not fit"):
        search_values(X, np.ones(4), ["x"])
    with pytest.raises(InputError, match="not finite"):
        search_values(X, np.array([1.0, np.nan, 1.0, 1.0]), ["x", "y"])
    with pytest.raises(InputError, match="unknown domain change 'cube'"):
        search_values(X, np.arange(4.0), ["x", "y"], BruteForce(changes=("cube",)))
    with pytest.raises(InputError, match="unknown device 'tpu'"):
        search_values(X, np.arange(4.0), ["x", "y"], BruteForce(device="tpu"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "formula",
    ["a*exp(-b*c/(d*e))", "c*(1.5*a*sin(b) + d - 2)", "(a+b)*c/(1 + c*d)"],
)
def test_ratios_and_beam_find_what_no_single_function_is(formula):
    """Nested power laws, a variable times a sum, and products with a sum come out to rounding."""
    samples = planted(formula, "abcde" if "*e" in formula else "abcd")
    settings = BruteForce(max_candidates=20_000, ratios=True, device="cpu")
    result = search_values(samples.X, samples.y, samples.names, settings)
    assert result.stopped == "exact"
    alone = BruteForce(max_candidates=20_000, beam=0, sums=(), device="cpu")
    assert search_values(samples.X, samples.y, samples.names, alone).stopped != "exact"


@pytest.mark.slow
def test_an_exact_formula_is_chosen_though_its_errors_have_one_sign():
    """Rounding errors of one sign do not make thousands of exact rows count as two."""
    samples = planted("0.3989422804*exp(-0.5*(x/y)^2)/y", "xy")
    result = search_values(samples.X, samples.y, samples.names, SMALL)
    fresh = planted("0.3989422804*exp(-0.5*(x/y)^2)/y", "xy", seed=1)
    chosen = choose(result.candidates, samples)
    assert np.allclose(evaluate(chosen.expr, fresh.columns), fresh.y, rtol=1e-9)
