import numpy as np
import pytest

from dynsr.benchmarks.noise import compare_formulas, measure_recovery
from dynsr.data.system import CART_POLE, LOTKA_VOLTERRA, PENDULUM
from dynsr.errors import InputError
from dynsr.expression.parsing import parse


@pytest.mark.parametrize(
    ("found", "true", "off"),
    [
        ("1.5*x - 1.0*x*y", "x*(1.5 - y)", 0.0),
        ("-9.7*sin(1.0004*a) - 0.1*b", "-0.1*b - 9.81*sin(a)", 0.11 / 9.81),
        ("(2*x + 2*y)/(2*y + 6)", "(x + y)/(3 + y)", 0.0),
        ("0.6 - 1.5*x/(0.33 + x)", "0.6 - 1.5*x/(0.3 + x)", 1 / 11),
        ("sin(a)^3/(1 + sin(a)^2)", "sin(a)*(1 - cos(a)^2)/(2 - cos(a)^2)", 0.0),
        ("(3*x + 1)*(x - 2)", "3*x^2 - 5*x - 2", 0.0),
    ],
)
def test_same_form_however_written(found, true, off):
    """A formula that equals the true one in form is known as such, however it is written."""
    same, distance = compare_formulas(parse(found), parse(true))
    assert same and distance == pytest.approx(off, abs=1e-9)


@pytest.mark.parametrize(
    ("found", "true"),
    [
        ("1.5*x - x*y + 0.001", "x*(1.5 - y)"),
        ("1.5*x", "x*(1.5 - y)"),
        ("sin(2*a)", "sin(a)"),
        ("a", "sin(a)"),
        ("x/(1 + sin(a)^2)", "x/(1 + sin(a))"),
        ("x/(3 + y)", "(x + y)/(3 + y)"),
    ],
)
def test_other_form(found, true):
    """One term too many, too few or another one is another form."""
    assert not compare_formulas(parse(found), parse(true))[0]


@pytest.mark.parametrize("system", [LOTKA_VOLTERRA, PENDULUM, CART_POLE], ids=lambda s: s.name)
def test_truth_is_recovered(system):
    """The true equations count as recovered, ones with a constant 5 % off do not."""
    truth = dict(zip(system.states, system.rhs, strict=True))
    rows = list(measure_recovery([system], lambda data, seed: truth, noise=[0.0]))
    assert [row.state for row in rows] == list(system.states)
    assert all(row.recovered and row.constants_off < 1e-12 for row in rows)
    wrong = {**truth, system.target: truth[system.target] * 1.05}
    rows = list(measure_recovery([system], lambda data, seed: wrong, noise=[0.0]))
    assert [row.recovered for row in rows] == [True] * (len(rows) - 1) + [False]


def test_noise_is_what_was_asked_for():
    """The search sees data with the noise asked for, anew for each seed, and once without it."""
    seen = []

    def search(data, seed):
        seen.append((seed, data.x))
        return {}

    rows = list(measure_recovery([LOTKA_VOLTERRA], search, noise=[0.0, 0.05], seeds=[1, 2]))
    assert [seed for seed, _ in seen] == [1, 1, 2] and len(rows) == 6
    assert not any(row.recovered for row in rows)
    clean = seen[0][1]
    for _, noisy in seen[1:]:
        ratio = (noisy - clean).std(axis=0) / clean.std(axis=0)
        assert np.allclose(ratio, 0.05, rtol=0.1)
    assert not np.array_equal(seen[1][1], seen[2][1])
    with pytest.raises(InputError, match="noise -1"):
        list(measure_recovery([LOTKA_VOLTERRA], search, noise=[-1.0]))
