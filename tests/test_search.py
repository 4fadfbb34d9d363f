from dataclasses import replace

import numpy as np
import pytest
import sympy

from dynsr.benchmarks.lectures import find_lectures
from dynsr.data.samples import Samples, make_samples
from dynsr.data.system import LOTKA_VOLTERRA, PENDULUM
from dynsr.engines.simulation import training_trajectory
from dynsr.errors import InputError
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import ParetoFront
from dynsr.methods.base import Progress
from dynsr.methods.feynman.search import DIRECT_STAGES, STAGES, DynAIFeynman, ExactStages
from dynsr.methods.feynman.stages.domain_change import DomainChange
from dynsr.methods.feynman.stages.polynomial import Polynomial
from dynsr.methods.rational import RationalSearch
from dynsr.verdict.scoring import trajectory_loss

_QUICK = DynAIFeynman(
    stages=("polynomial", "brute force", "refinement"), candidates=5000, exact_values=None
)


def _samples(law: str, count: int = 400) -> Samples:
    names = tuple(sorted(str(s) for s in parse(law).free_symbols))
    X = np.random.default_rng(0).uniform(0.5, 2.0, size=(count, len(names)))
    y = evaluate(parse(law), dict(zip(names, X.T, strict=True)))
    return Samples(X, y, names, "a", "given", np.arange(float(count)))


def _rng() -> np.random.Generator:
    return np.random.default_rng(1)


def _sources(front: ParetoFront) -> set[str]:
    return {candidate.source.partition(":")[0] for candidate in front}


@pytest.mark.parametrize(
    ("system", "state"),
    [(LOTKA_VOLTERRA, "x"), (PENDULUM, "theta2")],
    ids=lambda one: getattr(one, "name", one),
)
@pytest.mark.slow
def test_the_best_preset_finds_the_true_equation(system, state):
    """From the paper's training data alone the chosen formula is the true one, every digit."""
    # A long enumeration ends at the same choice.
    method = replace(DynAIFeynman.preset("best"), candidates=2000)
    samples = make_samples(training_trajectory(system), state, "central4")
    front = method.search(samples, _rng())
    chosen, truth = method.choose(front, samples).expr, system.rhs[system.index(state)]
    difference = sympy.nsimplify(sympy.expand(chosen - truth), rational=True)
    assert sympy.expand(difference) == 0, f"{state}: {chosen}"


@pytest.mark.slow
def test_the_paper_preset_is_at_least_as_good_as_the_paper():
    """Forward differences, lowest error: Lotka-Volterra's trajectory loss is below 0.19."""
    preset = DynAIFeynman.preset("paper")
    assert (preset.epochs, preset.candidates) == (500, 200_000)
    # The chosen polynomial is the same after all of them.
    method = replace(preset, epochs=10, candidates=20_000)
    samples = make_samples(training_trajectory(LOTKA_VOLTERRA), "y", "forward")
    front = method.search(samples, _rng())
    chosen = method.choose(front, samples)
    assert chosen is front.best_fit
    assert trajectory_loss(LOTKA_VOLTERRA, chosen.expr) <= 0.19


@pytest.mark.slow
def test_a_law_beyond_the_direct_stages_is_found_through_the_network():
    """A scaling symmetry that the trained network shows leads on; without it the law is missed."""
    samples = _samples("1/(1 + (a/b)^2)", 300)
    full = Polynomial(sparse=False)
    direct = DynAIFeynman(
        stages=("polynomial", "domain change"),
        polynomial=full,
        domain_change=DomainChange((full,), ("inv",)),
    )
    reduced = replace(direct, stages=(*direct.stages, "symmetry"), epochs=250)
    found, missed = (m.search(samples, _rng()).best_fit.loss for m in (reduced, direct))
    assert found < 1e-6 * missed


def test_the_same_seed_gives_the_same_front():
    """Two searches from equal generator states agree in every member, the network included."""
    samples = _samples("sin(a) + b^2", 120)
    method = DynAIFeynman(stages=("polynomial", "symmetry", "separability"), epochs=8)
    first, again = (method.search(samples, _rng()) for _ in range(2))
    assert [(c.expr, c.loss) for c in first] == [(c.expr, c.loss) for c in again]


def test_an_interrupted_search_gives_the_front_so_far():
    """Ctrl-C in the second stage leaves what the first one found."""
    seen: list[Progress] = []

    def stop(progress: Progress) -> None:
        seen.append(progress)
        if progress.stage == "brute force":
            raise KeyboardInterrupt

    front = _QUICK.search(_samples("sin(a*b) + 0.1*a^3"), _rng(), stop)
    assert len(front) >= 1
    assert seen[-1].stage == "brute force"
    assert {c.expr for c in seen[-1].front} <= {c.expr for c in front}


def test_an_interruption_inside_brute_force_ends_the_search():
    """Brute force gives what it has when interrupted; no later stage is begun."""
    seen: list[str] = []

    def stop(progress: Progress) -> None:
        seen.append(progress.stage)
        if seen.count("brute force") == 3:
            raise KeyboardInterrupt

    front = _QUICK.search(_samples("sin(a*b) + 0.1*a^3"), _rng(), stop)
    assert seen[-1] == "brute force"
    assert any(c.source.startswith("brute force") for c in front)


@pytest.mark.slow
def test_progress_names_the_stages_and_carries_the_front():
    """Reports come stage by stage, and the front on them only gets better."""
    seen: list[Progress] = []
    _QUICK.search(_samples("sin(a*b) + 0.1*a^3"), _rng(), seen.append)
    stages = list(dict.fromkeys(p.stage for p in seen))
    assert stages[:2] == ["polynomial", "brute force"]
    losses = [p.front.best_fit.loss for p in seen]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < losses[0]


def test_a_spent_time_budget_still_gives_an_answer():
    """With no time at all the constant is the answer, not an error."""
    front = DynAIFeynman(time_budget=1e-9).search(_samples("a + b"), _rng())
    assert len(front) >= 1


def test_a_constant_slope_needs_no_search():
    """A target that never changes is its own formula."""
    samples = _samples("a + b")
    constant = Samples(samples.X, np.full(400, 2.5), samples.names, "a", "given", samples.t)
    front = DynAIFeynman().search(constant, _rng())
    assert front.best_fit.expr == parse("2.5") and front.best_fit.loss == 0.0


@pytest.mark.parametrize("stage", ["polynomial", "brute force"])
def test_a_stage_that_is_switched_off_gives_no_candidates(stage):
    """No member of the front comes from a stage that is not listed."""
    kept = tuple(s for s in _QUICK.stages if s != stage)
    method = DynAIFeynman(stages=kept, candidates=5000)
    front = method.search(_samples("exp(a)/b", 100), _rng())
    assert not any(c.source.startswith(stage) for c in front)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"stages": ("magic",)}, "unknown stage 'magic'"),
        ({"selection": "luck"}, "unknown selection 'luck'"),
        ({"epochs": 0}, "epochs 0"),
        ({"time_budget": -1.0}, "time_budget -1.0"),
    ],
)
def test_settings_that_cannot_be_used_are_named(settings, says):
    """A misprint in the settings is one clear line."""
    with pytest.raises(InputError, match=says):
        DynAIFeynman(**settings)


def test_settings_of_a_stage_that_cannot_be_used_are_named():
    """A change of the target that does not exist, or a negative degree, is one clear line."""
    with pytest.raises(InputError, match="unknown domain change 'cube'; they are: inv, square"):
        DomainChange((Polynomial(),), ("cube",))
    with pytest.raises(InputError, match="degree -1 must be at least 0"):
        Polynomial(-1)


def test_an_unknown_preset_is_named():
    """The presets are listed when another is asked for."""
    with pytest.raises(InputError, match="'fast' of DynAIFeynman; its presets are: best"):
        DynAIFeynman.preset("fast")


def test_every_stage_is_part_of_the_best_preset():
    """The preset of most power leaves nothing out."""
    assert set(DynAIFeynman.preset("best").stages) == set(STAGES)


@pytest.mark.slow
def test_the_source_of_a_formula_names_the_stage_that_found_it():
    """Every member of the front says its stage, alone or before a colon."""
    clean = _samples("sin(a*b) + 0.1*a^3", 80)
    noisy = clean.y + 0.01 * _rng().normal(size=80)
    samples = replace(clean, y=noisy, scheme="central4")
    sums = RationalSearch(costs=(2,), rounds=1)
    method = DynAIFeynman(epochs=2, agreement=0, candidates=200, rational=sums)
    found = _sources(method.search(samples, _rng()))
    assert found <= {*STAGES, "mean"} and len(found) > 1


@pytest.mark.parametrize(
    ("scheme", "first"),
    [
        ("given", ("simple functions", "sums of powers", "sums of functions", "brute force")),
        ("central4", ("simple functions", "rational", "polynomial", "brute force")),
    ],
)
@pytest.mark.slow
def test_values_that_may_be_exact_have_stages_of_their_own(scheme, first):
    """Given values get the sums and the long enumeration first; slopes the robust stages."""
    clean = _samples("sin(a*b) + 0.1*a^3", 100)
    noisy = clean.y + 0.01 * _rng().normal(size=100)
    samples = replace(clean, y=noisy, scheme=scheme)
    seen: list[str] = []

    def note(progress: Progress) -> None:
        seen.append(progress.stage)
        if len(set(seen)) == len(first):
            raise KeyboardInterrupt

    sums = RationalSearch(costs=(2,), rounds=1)
    exact = ExactStages(sums_of_powers=sums, sums_of_functions=sums)
    DynAIFeynman(stages=DIRECT_STAGES, candidates=100, rational=sums, exact_values=exact).search(
        samples, _rng(), note
    )
    assert tuple(dict.fromkeys(seen)) == first


@pytest.mark.slow
@pytest.mark.parametrize("number", ["I.18.4", "II.24.17"])
def test_the_best_preset_recovers_equations_of_the_lectures(number):
    """The formula that the preset chooses is the law itself at points it did not see."""
    (lecture,) = find_lectures([number])
    learn, check = np.random.default_rng(0).spawn(2)
    samples, fresh = lecture.samples(200, learn), lecture.samples(200, check, 0.05)
    # As above, a long enumeration ends at the same choice.
    method = replace(DynAIFeynman.preset("best"), candidates=2000)
    front = method.search(samples, _rng())
    assert _sources(front) <= {*STAGES, "mean"}
    chosen = method.choose(front, samples)
    error = np.abs(evaluate(chosen.expr, fresh.columns) - fresh.y)
    assert error.max() <= 1e-6 * np.abs(fresh.y).max()
