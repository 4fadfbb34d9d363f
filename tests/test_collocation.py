"""Whole systems fitted to measured states by collocation, against independent answers."""

from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from dynsr.data import Trajectory
from dynsr.expression import parse
from dynsr.fit import Collocation, CollocationSettings, Measurements, Mesh, Probes


def mesh_of(runs, deviation, states, start=None, inputs=None):
    """Make the mesh of runs (t, x) with noise of known size; ``inputs`` are functions of time."""
    inputs = inputs or {}
    t = np.concatenate([own for own, _ in runs])
    x = np.concatenate([own for _, own in runs])
    ends = np.cumsum([len(own) for own, _ in runs])
    left = np.setdiff1d(np.arange(len(t) - 1), ends - 1)
    times = np.concatenate([t, (t[left] + t[left + 1]) / 2])
    driven = np.stack([*(np.asarray(u(times)) for u in inputs.values()), times])
    weights = np.broadcast_to(1 / np.asarray(deviation, dtype=float), x.shape)
    measured = np.where(weights > 0, x, 0.0)
    begin = x if start is None else start
    return Mesh(t, left, measured, weights, begin, driven, states, (*inputs, "t"))


def fit(exprs, mesh):
    """Fit equations that are given as text."""
    return Collocation({s: parse(e) for s, e in exprs.items()}, mesh).fit()


def coefficients(expr):
    """Give term -> coefficient of an equation."""
    return {str(t): float(c) for t, c in sympy.expand(expr).as_coefficients_dict().items()}


def likeliest(residuals, guess):
    """Give the minimum of squares and its standard errors by scipy alone."""
    found = least_squares(residuals, guess, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def solved(slope, t, start):
    """Integrate a system to tight tolerances."""
    return solve_ivp(slope, (t[0], t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-9).y.T


@pytest.mark.parametrize("uneven", [False, True], ids=["even times", "uneven times"])
def test_decay_is_fitted_as_likelihood_asks(uneven):
    """Rate, start and standard error of a noisy decay are those of its closed form's ML fit."""
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0, 4, 60)) if uneven else np.linspace(0, 4, 60)
    x = 2 * np.exp(-0.7 * t) + 0.05 * rng.normal(size=60)
    found = fit({"x": "-0.5*x"}, mesh_of([(t, x[:, None])], 0.05, ("x",)))
    (start, rate), errors = likeliest(
        lambda p: (p[0] * np.exp(-p[1] * (t - t[0])) - x) / 0.05, [1.0, 1.0]
    )
    assert -found.constants[0] == pytest.approx(rate, abs=0.01 * errors[1])
    assert found.states[0, 0] == pytest.approx(start, abs=0.01 * errors[0])
    assert found.errors[0] == pytest.approx(errors[1], rel=0.02)


def test_several_runs_share_their_constants():
    """Three decays of one rate give the ML fit of all, with a start for each."""
    rng = np.random.default_rng(2)
    times = [np.linspace(0, 3, 30), np.linspace(1, 2, 25), np.linspace(0, 5, 41)]
    starts = [2.0, -1.0, 0.5]
    runs = [
        (t, (a * np.exp(-0.7 * (t - t[0])) + 0.03 * rng.normal(size=len(t)))[:, None])
        for t, a in zip(times, starts, strict=True)
    ]
    found = fit({"x": "-0.4*x"}, mesh_of(runs, 0.03, ("x",)))

    def residuals(p):
        return np.concatenate(
            [
                (a * np.exp(-p[0] * (t - t[0])) - x[:, 0]) / 0.03
                for a, (t, x) in zip(p[1:], runs, strict=True)
            ]
        )

    best, errors = likeliest(residuals, [1.0, *starts])
    assert -found.constants[0] == pytest.approx(best[0], abs=0.01 * errors[0])
    assert found.errors[0] == pytest.approx(errors[0], rel=0.02)


@pytest.mark.slow
def test_a_coupled_system_is_fitted_as_shooting_does():
    """Four constants of Lotka-Volterra are those of least squares over integrated solutions."""
    rng = np.random.default_rng(3)
    t = np.linspace(0, 12, 80)

    def slope(_, z, a=1.1, b=0.4, c=0.1, d=0.4):
        return [a * z[0] - b * z[0] * z[1], c * z[0] * z[1] - d * z[1]]

    clean = solved(slope, t, [10.0, 5.0])
    sd = 0.05 * clean.std(axis=0)
    x = clean + sd * rng.normal(size=clean.shape)
    exprs = {"x": "0.9*x - 0.3*x*y", "y": "0.15*x*y - 0.5*y"}
    found = fit(exprs, mesh_of([(t, x)], sd, ("x", "y")))

    def residuals(p):
        return ((solved(lambda s, z: slope(s, z, *p[2:]), t, p[:2]) - x) / sd).ravel()

    best, errors = likeliest(residuals, [10, 5, 1.1, 0.4, 0.1, 0.4])
    terms = {**coefficients(found.exprs["x"]), **coefficients(found.exprs["y"])}
    assert terms["x"] == pytest.approx(best[2], abs=0.05 * errors[2])
    assert terms["y"] == pytest.approx(-best[5], abs=0.05 * errors[5])
    assert coefficients(found.exprs["x"])["x*y"] == pytest.approx(-best[3], abs=0.05 * errors[3])
    assert terms["x*y"] == pytest.approx(best[4], abs=0.05 * errors[4])
    np.testing.assert_allclose(np.sort(found.errors), np.sort(errors[2:]), rtol=0.05)


def test_standard_errors_are_the_spread_over_draws():
    """Over 40 draws of noise the errors told are the spread found, within its sampling error."""
    t = np.linspace(0, 6, 60)
    clean = np.stack([np.cos(2 * t), -2 * np.sin(2 * t)], axis=1) * np.exp(-0.1 * t)[:, None]
    clean[:, 1] -= 0.1 * clean[:, 0]
    values, errors = [], []
    for seed in range(40):
        x = clean + 0.05 * np.random.default_rng(seed).normal(size=clean.shape)
        mesh = mesh_of([(t, x)], 0.05, ("x", "v"), start=clean)
        found = fit({"x": "v", "v": "-4.01*x - 0.2*v"}, mesh)
        values.append(found.constants)
        errors.append(found.errors)
    told = np.mean(errors, axis=0)
    # The standard deviation of n normal draws is known to 1 / sqrt(2 (n - 1)).
    np.testing.assert_allclose(np.std(values, axis=0, ddof=1) / told, 1, atol=3 / np.sqrt(78))
    bias = (
        np.abs(
            np.mean(values, axis=0)
            - Collocation({"x": parse("v"), "v": parse("-4.01*x - 0.2*v")}, mesh).constants
        )
        / told
    )
    assert bias.max() < 3 / np.sqrt(40)


def test_a_velocity_that_nobody_measured_follows():
    """From positions alone the constants of an oscillator are their ML fit, and v is found."""
    rng = np.random.default_rng(5)
    t = np.linspace(0, 8, 100)
    system = np.array([[0, 1], [-4, -0.3]])

    def positions(p):
        a = np.array([[0, 1], [-p[2], -p[3]]])
        values, vectors = np.linalg.eig(a)
        weights = np.linalg.solve(vectors, np.array(p[:2], dtype=complex))
        return np.real(vectors @ (weights[:, None] * np.exp(np.outer(values, t))))

    clean = positions([1.0, 0.0, 4.0, 0.3])
    np.testing.assert_allclose(np.gradient(clean[0], t)[5:-5], clean[1][5:-5], atol=0.02)
    x = np.stack([clean[0] + 0.05 * rng.normal(size=100), np.zeros(100)], axis=1)
    start = np.stack([clean[0], np.gradient(x[:, 0], t)], axis=1)
    mesh = mesh_of([(t, x)], [0.05, np.inf], ("x", "v"), start=start)
    found = fit({"x": "v", "v": "-3.5*x - 0.2*v"}, mesh)
    best, errors = likeliest(lambda p: (positions(p)[0] - x[:, 0]) / 0.05, [1, 0, *-system[1]])
    np.testing.assert_allclose(np.sort(-found.constants), np.sort(best[2:]), atol=0.02 * errors[2])
    assert found.states[:, 1] == pytest.approx(positions(best)[1], abs=0.01)
    assert not found.misses[:, 1].any()


def test_inputs_drive_the_states():
    """Gain and rate of a driven lag are those of least squares over its closed form."""
    rng = np.random.default_rng(6)
    t = np.linspace(0, 10, 80)

    def answer(p):
        start, rate, gain = p
        scale = gain / (1 + rate**2)
        forced = scale * (rate * np.sin(t) - np.cos(t))
        return (start + scale) * np.exp(-rate * t) + forced

    x = answer([1.0, 0.5, 2.0]) + 0.05 * rng.normal(size=80)
    mesh = mesh_of([(t, x[:, None])], 0.05, ("x",), inputs={"u": np.sin})
    found = fit({"x": "-0.8*x + 1.2*u"}, mesh)
    best, errors = likeliest(lambda p: (answer(p) - x) / 0.05, [1.0, 0.8, 1.2])
    have = coefficients(found.exprs["x"])
    assert -have["x"] == pytest.approx(best[1], abs=0.02 * errors[1])
    assert have["u"] == pytest.approx(best[2], abs=0.02 * errors[2])


def test_chaos_is_followed_over_the_whole_run():
    """Lorenz' system at 1 %: constants within 4 errors, every state nearer than its measurement."""
    rng = np.random.default_rng(7)
    t = np.linspace(0, 20, 2001)

    def slope(_, z):
        return [10 * (z[1] - z[0]), z[0] * (28 - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]]

    clean = solved(slope, t, [-8.0, 7.0, 27.0])
    sd = 0.01 * clean.std(axis=0)
    x = clean + sd * rng.normal(size=clean.shape)
    exprs = {"x": "9.5*y - 10.5*x", "y": "27.1*x - x*z - y", "z": "x*y - 2.5*z"}
    found = fit(exprs, mesh_of([(t, x)], sd, ("x", "y", "z")))
    assert len(found.constants) == 4
    truth = np.array([-10.0, -8 / 3, 10.0, 28.0])
    order = np.argsort(found.constants)
    off = np.abs(found.constants[order] - truth)
    assert np.all(off < 4 * found.errors[order])
    assert np.all(np.std(found.states - clean, axis=0) < 0.4 * sd)
    np.testing.assert_allclose(found.mean_squares, 1, atol=4 * np.sqrt(2 / len(t)))


def test_stiff_steps_are_stable():
    """A lag of 0.1 ms on rows of 50 ms: its level is found, where an explicit step overflows."""
    rng = np.random.default_rng(8)
    t = np.linspace(0, 5, 101)
    x = 2 * np.cos(t) + 0.02 * rng.normal(size=101)
    found = fit(
        {"x": "10000*(1.5*u - x)"}, mesh_of([(t, x[:, None])], 0.02, ("x",), None, {"u": np.cos})
    )
    level = x @ np.cos(t) / (np.cos(t) @ np.cos(t))
    assert np.abs(found.states[:, 0] - level * np.cos(t)).max() < 0.02


def test_relaxation_is_fitted_through_its_jumps():
    """Van der Pol's oscillator at mu = 20 from rows that a classical step diverges on."""
    rng = np.random.default_rng(9)
    t = np.linspace(0, 60, 1500)
    clean = solve_ivp(
        lambda _, z: [20 * (z[0] - z[0] ** 3 / 3 - z[1]), z[0] / 20],
        (0, 60), [2.0, 0.0], "Radau", t, rtol=1e-8, atol=1e-8,
    ).y.T  # fmt: skip
    sd = 0.01 * clean.std(axis=0)
    x = clean + sd * rng.normal(size=clean.shape)
    exprs = {"x": "19*(x - x^3/3 - y)", "y": "0.055*x"}
    found = fit(exprs, mesh_of([(t, x)], sd, ("x", "y"), start=clean))
    assert found is not None
    assert coefficients(found.exprs["y"])["x"] == pytest.approx(0.05, rel=0.01)


def test_a_constant_and_a_probe_along_it_are_one_direction():
    """What the data say of constants in several equations they say of probes in their places."""
    t = np.linspace(0, 4, 60)
    x = solved(lambda _, z: [-0.5 * z[0] + 0.8 * z[1], -0.9 * z[0]], t, [1.0, 0.3])
    mesh = mesh_of([(t, x)], 0.05, ("x", "y"))
    found = fit({"x": "-0.5*x + 0.8*y", "y": "-0.9*x"}, mesh)
    problem = Collocation(found.exprs, mesh)
    first, second = problem.points(found.states, found.constants)[:2]
    along = {"x": first, "y": second}
    slopes = [along[str(term)] for e in problem.exprs.values() for term in e.free_symbols]
    owners = [place for place, e in enumerate(problem.exprs.values()) for _ in e.free_symbols]
    probes = Probes(np.array(owners), np.array(slopes))
    both = problem.normal(found.states, found.constants, probes).information
    alone = Collocation({"x": sympy.S.Zero, "y": sympy.S.Zero}, mesh)
    own = np.sort(np.linalg.eigvalsh(both[:3, :3]))
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(both[3:, 3:])), own, rtol=1e-4)
    assert alone.normal(found.states, np.zeros(0), probes).information.shape == (3, 3)


def test_information_is_the_curvature_of_the_profile():
    """The information is half the second derivative of the cost with the states following."""
    t = np.linspace(0, 4, 60)
    x = 2 * np.exp(-0.7 * t) + 0.5

    def problem(rate, level):
        inputs = {"p": lambda s: np.full_like(s, rate), "q": lambda s: np.full_like(s, level)}
        mesh = mesh_of([(t, x[:, None])], 0.05, ("x",), inputs=inputs)
        return Collocation({"x": parse("p + q*x")}, mesh)

    def profile(shift):
        """Cost of the best states at fixed constants, which stand in driven columns here."""
        own = problem(0.35 + shift[0], -0.7 + shift[1])
        return own.normal(own.fit().states, np.zeros(0)).squares

    mesh = mesh_of([(t, x[:, None])], 0.05, ("x",))
    found = Collocation({"x": parse("0.35 - 0.7*x")}, mesh).fit()
    steps = 0.005 * np.eye(2)
    base = profile([0, 0])
    second = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            corners = [
                profile(a * steps[i] + b * steps[j]) * a * b for a in (1, -1) for b in (1, -1)
            ]
            second[i, j] = sum(corners) / (4 * 0.005**2)
    assert base < 1e-3
    order = np.argsort(-found.constants)
    have = found.information[np.ix_(order, order)]
    np.testing.assert_allclose(have, second / 2, rtol=0.03)


def test_a_jump_between_rows_is_charged():
    """A slope that is steep only where no row is would follow anything; its misses are counted."""
    rng = np.random.default_rng(10)
    t = np.linspace(0, 4, 81)
    x = (t + 0.05 * rng.normal(size=81))[:, None]
    mesh = mesh_of([(t, x)], 0.05, ("x",), start=t[:, None])
    plain = fit({"x": "1.01"}, mesh)
    # 0 at rows, in the middle between them, and 1 at the quarters.
    hidden = Collocation({"x": 1 + 5 * sympy.sin(40 * sympy.pi * sympy.Symbol("t")) ** 2}, mesh)
    found = hidden.fit()
    assert np.mean(found.misses**2) < 1.5
    assert found.mean_squares[0] > 3
    # Of a slope that hides nothing, it is what the fit made least.
    least = Collocation(plain.exprs, mesh).cost(plain.states.T, plain.constants)
    assert plain.mean_squares[0] == pytest.approx(least / 81, rel=1e-9)


def test_a_fit_that_came_to_rest_early_pays_for_its_defects():
    """Of states that do not follow the system, only noise is left; the defects count all the same.

    A fit of one soft stage leaves defects of the size of the noise.
    """
    rng = np.random.default_rng(3)
    t = np.linspace(0, 4, 81)
    x = (np.exp(-t) + 0.02 * rng.normal(size=81))[:, None]
    mesh = mesh_of([(t, x)], 0.02, ("x",))
    wrong = Collocation({"x": parse("-0.9*x^2")}, mesh)
    stiff = wrong.fit()
    early = wrong.as_fit(*wrong._finish(mesh.start.T.copy(), stiff.constants))
    assert np.mean(early.misses**2) < np.mean(stiff.misses**2)
    assert early.mean_squares[0] > 10 * stiff.mean_squares[0]


def test_a_system_that_is_not_finite_is_no_fit():
    """A logarithm of states on both sides of 0 gives None, without a warning."""
    t = np.linspace(0, 4, 41)
    mesh = mesh_of([(t, np.cos(t)[:, None])], 0.05, ("x",))
    assert fit({"x": "0.5*log(x)"}, mesh) is None


def test_a_system_without_constants_is_fitted_too():
    """With nothing to fit but its start, a decay gives the ML start and no errors."""
    rng = np.random.default_rng(11)
    t = np.linspace(0, 3, 50)
    x = 2 * np.exp(-t) + 0.05 * rng.normal(size=50)
    found = Collocation({"x": -sympy.Symbol("x")}, mesh_of([(t, x[:, None])], 0.05, ("x",))).fit()
    start = x @ np.exp(-t) / (np.exp(-t) @ np.exp(-t))
    assert found.constants.shape == found.errors.shape == (0,)
    assert found.states[0, 0] == pytest.approx(start, abs=0.002)


def test_a_fit_goes_on_from_one_near_it():
    """Beginning at a neighbour's states gives the same answer as beginning at the data."""
    rng = np.random.default_rng(12)
    t = np.linspace(0, 4, 60)
    x = (2 * np.exp(-0.7 * t) + 0.05 * rng.normal(size=60))[:, None]
    mesh = mesh_of([(t, x)], 0.05, ("x",))
    own = Collocation({"x": parse("-0.5*x + 0.01")}, mesh)
    near = fit({"x": "-0.5*x"}, mesh)
    np.testing.assert_allclose(own.fit(near).constants, own.fit().constants, rtol=1e-3, atol=1e-4)


def test_a_fit_that_did_not_close_misses_by_what_is_open():
    """States that do not follow the system count as missed, although they stay on the data."""
    rng = np.random.default_rng(13)
    t = np.linspace(0, 4, 60)
    x = (2 * np.exp(-0.7 * t) + 0.05 * rng.normal(size=60))[:, None]
    mesh = mesh_of([(t, x)], 0.05, ("x",))
    system = {"x": parse("-0.1*x")}
    begun = Collocation(system, mesh, CollocationSettings(steps=0)).fit()
    assert begun.mean_squares[0] > 2 * Collocation(system, mesh).fit().mean_squares[0]


def test_constants_that_nothing_tells_have_no_error():
    """Of a product of two constants each alone may be anything, and is known beside no other."""
    rng = np.random.default_rng(14)
    t = np.linspace(0, 4, 60)
    x = (2 * np.exp(-0.7 * t) + 0.05 * rng.normal(size=60))[:, None]
    found = fit({"x": "-0.5*x + 0.000000001*tanh(0.00000001*x)"}, mesh_of([(t, x)], 0.05, ("x",)))
    assert np.count_nonzero(np.isinf(found.errors)) == 2
    assert np.count_nonzero(np.isinf(found.covariance)) == 8


def test_measurements_tell_what_is_measured():
    """A velocity that was made from positions carries no weight; other states are read off."""
    rng = np.random.default_rng(13)
    t = np.linspace(0, 10, 120)
    x = np.sin(t) + 0.05 * rng.normal(size=120)
    run = Trajectory(t, np.stack([x, np.cos(t)], axis=1), ("x", "v"))
    data = Measurements.of([run], {}, 2000, {"x": sympy.Symbol("v")})
    mesh = data.mesh(("x", "v"))
    assert not mesh.weights[:, 1].any()
    assert 1 / np.median(mesh.weights[:, 0]) == pytest.approx(0.05, rel=0.3)
    alone = data.mesh(("x",))
    assert alone.driven_names == ("v", "t")
    both = np.concatenate([t, (t[1:] + t[:-1]) / 2])
    np.testing.assert_allclose(alone.driven[0], np.cos(both), atol=0.05)
    assert data.beside("v") == {"x": sympy.Symbol("v")}
    assert data.beside("x") == {}


def test_measurements_are_thinned_to_so_many_rows():
    """Of more rows than asked for every second, third, ... is kept, of each run."""
    runs = [
        Trajectory(np.linspace(0, 9, n), np.sin(np.linspace(0, 9, n))[:, None], ("x",))
        for n in (300, 200)
    ]
    data = Measurements.of(runs, {}, 250)
    assert [len(run) for run in data.runs] == [150, 100]
    mesh = data.mesh(("x",))
    assert len(mesh.left) == 248
    for a, b in pairwise(mesh.left):
        assert b - a in (1, 2)
    assert np.all(mesh.h > 0)


def test_measurements_follow_a_system():
    """Along other states the curves are theirs, and so are their slopes."""
    t = np.linspace(0, 6, 121)
    run = Trajectory(t, np.sin(t)[:, None] + 0.3, ("x",))
    data = Measurements.of([run], {}, 2000).along(np.cos(t)[:, None], ["x"])
    np.testing.assert_allclose(data.smoothed[0].slope[:, 0], -np.sin(t), atol=1e-4)
    np.testing.assert_allclose(data.smoothed[0].x[:, 0], np.cos(t))


@pytest.mark.slow
def test_many_short_runs_are_kept():
    """Of 4 runs of eight rows all are kept, though they have more rows in all than asked for."""
    t = np.linspace(0, 1, 8)
    runs = [Trajectory(t, a * np.exp(-t)[:, None], ("x",)) for a in np.linspace(1, 2, 4)]
    data = Measurements.of(runs, {}, 30)
    assert [len(run) for run in data.runs] == [8] * 4


@pytest.mark.slow
def test_rows_far_apart_have_others_between_them():
    """Of eight rows an oscillation the time between two is cut into three, or into four where the
    rows are exact; of forty it is not.
    """
    for rows, noise, parts in ((8, 0.01, 3), (8, 0.0, 4), (40, 0.01, 1)):
        t = np.linspace(0.0, 6 * np.pi, 3 * rows + 1)
        x = np.column_stack([np.sin(t), np.cos(t)])
        off = np.random.default_rng(1).normal(0.0, noise, x.shape)
        run = Trajectory(t, x + off, ("x", "y"))
        data = Measurements.of([run], {}, 2000)
        mesh = data.mesh(("x", "y"))
        assert data.parts == parts
        assert len(mesh.t) == 3 * rows * parts + 1
        assert mesh.t[mesh.measured] == pytest.approx(t, abs=1e-12)
        assert mesh.rows.tolist() == [len(t), len(t)]
        assert np.all(np.isfinite(mesh.unit)) and np.all(mesh.unit > 0)


def test_few_rows_an_oscillation_bend_no_constant():
    """Van der Pol's oscillator at nine rows a turn: the damping comes out to 1e-3, by SciPy's own
    integration, where steps from row to row are off by more than a hundredth.
    """
    t = np.linspace(0.0, 30.0, 42)
    x = solved(lambda _, s: [s[1], 1.5 * (1 - s[0] ** 2) * s[1] - s[0]], t, [2.0, 0.0])
    data = Measurements.of([Trajectory(t, x, ("x", "y"))], {}, 2000)
    equations = {"x": parse("1.0*y"), "y": parse("1.2*y - 1.2*x**2*y - 0.9*x")}
    whole = Collocation(equations, data.mesh(("x", "y"))).fit()
    apart = coefficients(whole.exprs["y"])
    assert apart["y"] == pytest.approx(1.5, abs=1e-3 * 1.5)
    assert data.parts > 1
    bare = mesh_of([(t, x)], [0.01, 0.01], ("x", "y"))
    rough = coefficients(Collocation(equations, bare).fit().exprs["y"])
    assert abs(rough["y"] - 1.5) > 0.015


def test_lost_rows_bend_no_constant():
    """Van der Pol's oscillator with half of its rows lost: where many are missing in a row, the
    time between two is cut into more parts, and the damping comes out to 1e-3, by SciPy's own
    integration. Even rows are not cut otherwise than before.
    """
    t = np.linspace(0.0, 30.0, 121)
    t = np.sort(np.random.default_rng(3).choice(t, 60, replace=False))
    x = solved(lambda _, s: [s[1], 1.5 * (1 - s[0] ** 2) * s[1] - s[0]], t, [2.0, 0.0])
    data = Measurements.of([Trajectory(t, x, ("x", "y"))], {}, 2000)
    mesh = data.mesh(("x", "y"))
    rows = np.flatnonzero(mesh.measured)
    parts, steps = np.diff(rows), np.diff(t)
    assert mesh.t[rows] == pytest.approx(t, abs=1e-12)
    assert mesh.x[rows] == pytest.approx(x, abs=1e-12)
    assert parts[np.argmax(steps)] > parts[np.argmin(steps)]
    assert np.max(steps / parts) < 2 * np.median(steps / parts)
    equations = {"x": parse("1.0*y"), "y": parse("1.2*y - 1.2*x**2*y - 0.9*x")}
    found = Collocation(equations, mesh).fit()
    assert coefficients(found.exprs["y"])["y"] == pytest.approx(1.5, abs=1.5e-3)
    # What is smoothed along the fit is read at the measured rows.
    along = data.along(found.states, ("x", "y")).smoothed[0]
    assert along.x == pytest.approx(x, abs=1e-2)


def test_a_long_pause_is_cut_no_further_than_others_at_ten_times_the_usual():
    """A pause of a thousand times the time between rows has more parts than that, yet not many."""
    t = np.concatenate([np.linspace(0.0, 6.0, 40), 160 + np.linspace(0.0, 6.0, 40)])
    x = np.column_stack([np.sin(t), np.cos(t)])
    data = Measurements.of([Trajectory(t, x, ("x", "y"))], {}, 2000)
    parts = np.diff(np.flatnonzero(data.mesh(("x", "y")).measured))
    assert 2 * parts[0] < parts[39] == parts.max() <= 40


def test_a_step_takes_a_constant_inside_not_far():
    """Growth without end has no half-saturation: one step makes it at most four times as large.

    What stands before the ratio goes as far as the line of least squares says.
    """
    t = np.linspace(0, 8, 90)
    mesh = mesh_of([(t, np.exp(0.4 * t)[:, None])], 0.02, ("x",))
    begun = Collocation({"x": parse("0.5*x/(2.5 + x)")}, mesh, CollocationSettings((10.0,), 1))
    factor, inside = begun.fit().constants
    assert begun.inside.tolist() == [2.5]
    assert inside == pytest.approx(4 * 2.5)
    assert factor > 4 * 0.5


def test_small_defects_count_with_their_weight():
    """States that leave their solution by a little at every row have missed it by a lot.

    A line at rest is offered 400 rows of a slope of 1 with noise of 1: each row is off by 0.01.
    """
    t = np.linspace(0, 4, 401)
    mesh = mesh_of([(t, t[:, None].copy())], 1.0, ("x",))
    settings = CollocationSettings(steps=0)
    begun = Collocation({"x": parse("0.0*x")}, mesh, settings).fit()
    expected = settings.stiffness[-1] * 0.01**2 * 400 / 401
    assert begun.mean_squares[0] == pytest.approx(expected, rel=0.01)
