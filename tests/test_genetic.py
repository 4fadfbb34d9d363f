from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.data.samples import Samples
from dynsr.data.system import find_system
from dynsr.errors import InputError
from dynsr.expression.evaluation import evaluate
from dynsr.methods.genetic import GeneticAlgorithm
from dynsr.paper.protocol import paper_method


def planted(formula, seed=0, n=120):
    """Samples of a formula of x and y at random points."""
    X = np.random.default_rng(seed).uniform(0.5, 3.0, (n, 2))
    return Samples(X, formula(*X.T), ("x", "y"), "y", "given", np.arange(n, dtype=float))


def rng(seed=0):
    """Give the generator of a seed."""
    return np.random.default_rng(seed)


def test_a_planted_word_is_found():
    """The algorithm finds x*y - 3 from samples alone, exactly."""
    samples = planted(lambda x, y: x * y - 3.0)
    method = GeneticAlgorithm(bits=30, iterations=60, constants=(1.0, -3.0), operators=("+", "*"))
    best = method.search(samples, rng()).best_fit
    x, y = sympy.symbols("x y")
    assert sympy.simplify(best.expr - (x * y - 3.0)) == 0
    assert best.loss < 1e-12


def test_the_sizes_are_those_of_table_2():
    """The paper preset holds bits, candidates and iterations of the paper's Table 2."""
    sizes = {
        name: (m.bits, m.population, m.iterations, m.mutation)
        for name in ("lotka-volterra", "pendulum", "cart-pole")
        for m in [paper_method("ga", find_system(name))]
    }
    assert sizes == {
        "lotka-volterra": (20, 70, 100, 0.1),
        "pendulum": (20, 70, 40, 0.1),
        "cart-pole": (60, 100, 100, 0.1),
    }


def test_the_same_seed_gives_the_same_front():
    """Two searches from equal generators agree; another seed goes another way."""
    samples = planted(lambda x, y: np.sin(x) * y - 0.7 * x**2)
    method = GeneticAlgorithm(iterations=10, population=30)
    fronts = [[(str(c.expr), c.loss) for c in method.search(samples, rng(s))] for s in (4, 4, 5)]
    assert fronts[0] == fronts[1] != fronts[2]


def test_losses_on_the_front_are_those_of_its_expressions():
    """Each candidate's loss is the RMSE of its SymPy expression, and no candidate is beaten."""
    samples = planted(lambda x, y: x / y + np.cos(x))
    front = GeneticAlgorithm(iterations=15, population=60).search(samples, rng())
    for candidate in front:
        error = evaluate(candidate.expr, samples.columns) - samples.y
        assert candidate.loss == pytest.approx(np.sqrt(np.mean(error**2)))
    losses = [c.loss for c in front]
    assert len(losses) > 1 and losses == sorted(losses, reverse=True)


def test_selection_never_loses_the_best():
    """The best loss so far never gets worse from one generation to the next."""
    best = []
    samples = planted(lambda x, y: x * y * y - 2.0)
    GeneticAlgorithm(iterations=12, population=20).search(
        samples, rng(2), lambda p: best.append(p.front.best_fit.loss)
    )
    assert len(best) == 12 and best == sorted(best, reverse=True)


def test_an_interrupt_gives_the_best_so_far():
    """KeyboardInterrupt in the third generation ends the search with what was found."""

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    samples = planted(lambda x, y: x + y)
    front = GeneticAlgorithm(iterations=1000, population=20).search(samples, rng(), stop)
    assert len(front) >= 1


def test_scaling_fits_coefficients_that_no_terminal_has():
    """With scaled words, 2.37 sin(x) - 0.81 is found though no constant is near."""
    samples = planted(lambda x, y: 2.37 * np.sin(x) - 0.81)
    method = replace(GeneticAlgorithm.preset("best"), population=60, iterations=10)
    best = method.search(samples, rng()).best_fit
    assert best.loss < 1e-10
    assert sorted(round(float(a), 6) for a in best.expr.atoms(sympy.Float)) == [-0.81, 2.37]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bits": 0}, "bits 0 of the GA"),
        ({"population": 1}, "population 1 of the GA"),
        ({"mutation": 0.0}, "mutation rate 0.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(change, message):
    """A wrong number raises InputError that names it."""
    with pytest.raises(InputError, match=message):
        GeneticAlgorithm(**change)


def test_unknown_presets_and_columns_are_named():
    """The message lists the presets, or the columns there are."""
    with pytest.raises(InputError, match="its presets are: best, quick, paper"):
        GeneticAlgorithm.preset("papre")
    with pytest.raises(InputError, match="no column 'w'; their columns are: x, y"):
        paper_method("ga", find_system("cart-pole")).search(planted(np.add), rng())
    with pytest.raises(InputError, match="3 bits are too few for a symbol"):
        GeneticAlgorithm(bits=3).search(planted(np.add), rng())
