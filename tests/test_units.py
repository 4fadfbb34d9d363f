"""Units of columns: which formulas make sense in them, and what coefficients are in."""

import numpy as np
import pandas as pd
import pytest
from command_line import run
from scipy.integrate import solve_ivp

import dynsr
from dynsr.data.name_parts import bracketed_unit
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError, MissingExtra
from dynsr.expression.dimensions import read_units
from dynsr.expression.parsing import parse
from dynsr.methods import RationalSearch
from dynsr.methods.demands import read_demands

pytest.importorskip("pint")
GIVEN = {"x": "m", "v": "m/s", "t": "s", "th": "rad", "w": "rad/s", "c": "mg/L", "n": "count"}
T = np.arange(0, 5, 0.05)
QUICK = {
    "method": RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1),
    "jobs": 1,
}


@pytest.fixture(scope="module")
def units():
    """Give units of a length, a speed, angles, a concentration and a count."""
    return read_units(GIVEN)


@pytest.mark.parametrize(
    "text",
    [
        "x*v - 3*x**2",
        "x + v",
        "sin(2*x)",
        "sin(th) + cos(n)",
        "x/(1 + x)",
        "1/(x + 2*v)",
        "sqrt(x)*abs(v)",
        "exp(-3*x/v)",
        "q*exp(q)",
        "sign(x)",
        "2**n",
    ],
)
def test_what_makes_sense_is_allowed(units, text):
    """Terms have coefficients, numbers carry units, and what has none given may be in any."""
    assert units.fault(parse(text)) == ""


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("3*sin(x)", "sin(x) of a quantity in m"),
        ("exp(x/v)", "exp(x/v) of a quantity in s"),
        ("1/(x + v)", "v + x of quantities in m/s and m"),
        ("x**v", "x**v of a quantity in m"),
        ("x*sin(w)", "sin(w) of a quantity in rad/s"),
        ("log(abs(c))", "log(Abs(c)) of a quantity in mg/l"),
    ],
)
def test_what_makes_none_is_named(units, text, fault):
    """A function of a length, and a sum of a length and a speed, are named with their units."""
    assert units.fault(parse(text)) == fault


def test_one_dimension_in_two_sizes_is_not_added():
    """Metres and kilometres, degrees and radians are told apart; a newton is what it is made of."""
    two = read_units({"a": "m", "b": "km", "f": "N", "g": "kg*m/s**2", "d": "deg"})
    assert two.fault(parse("1/(a + b)")) and two.fault(parse("sin(d)"))
    assert two.fault(parse("1/(f + g)")) == ""


@pytest.mark.parametrize(
    ("state", "term", "unit"),
    [
        ("v", "sin(th)", "m/s^2"),
        ("x", "v", "1"),
        ("c", "c**2", "l/(mg*s)"),
        ("c", "1", "mg/(l*s)"),
        ("w", "sqrt(x)", "rad/(m^(1/2)*s^2)"),
        ("x", "q", ""),
    ],
)
def test_a_coefficient_has_the_unit_that_its_term_lacks(units, state, term, unit):
    """It is the unit of the slope by that of the term, in the user's own units; "" if unknown."""
    assert units.of_coefficient(state, parse(term)) == unit


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"x": "xx yy"}, "'xx yy' of 'x' is unknown to pint"),
        ({"x": "m//"}, "is unknown to pint"),
        ({"x": "m;t=s"}, "'m;t=s' of 'x' is unknown to pint"),
        ({"x": "m,s"}, "'m,s' of 'x' is unknown to pint"),
        ({"x": "10**10**10**10"}, "is too long"),
        ({"x": "m*" * 40 + "m"}, "is too long"),
        ({"x": "degC"}, "counts from an offset"),
        ({"y": "m"}, "units name 'y', which is not one of: x, t"),
    ],
)
def test_units_that_cannot_be_read_are_one_line(given, said):
    """An unknown unit, one with an offset and an unknown column are named."""
    with pytest.raises(InputError, match=said):
        read_demands(["x"], ["x"], units=given)


def test_formulas_that_make_no_sense_are_left_out():
    """The demand keeps a formula out of every pool, as other demands do."""
    demands = read_demands(["x"], ["x"], units={"x": "m"})
    assert (
        demands.asked and demands.allows(parse("sin(3*x)")) and not demands.allows(parse("sin(x)"))
    )


@pytest.fixture(scope="module")
def swing():
    """Give a damped pendulum whose columns say their units."""
    s = solve_ivp(
        lambda t, s: [s[1], -9.81 * np.sin(s[0]) - 0.3 * s[1]],
        (0, 5),
        [1.0, 0.0],
        t_eval=T,
        rtol=1e-10,
        atol=1e-10,
    ).y.T
    return pd.DataFrame({"t [s]": T, "th [rad]": s[:, 0], "w [rad/s]": s[:, 1]})


@pytest.mark.filterwarnings("ignore:columns were renamed")
@pytest.mark.slow
def test_a_discovery_in_units(swing, tmp_path):
    """Units from the names: coefficients have theirs in the shell, the report and the result."""
    assert bracketed_unit("w [rad/s]") == "rad/s"
    swing.to_csv(tmp_path / "swing.csv", index=False)
    words = ["--units", "columns", "--preset", "quick", "-j", "1"]
    done = run("discover", tmp_path / "swing.csv", *words, "-o", tmp_path / "out")
    assert "rad/s^2" in done.stdout
    assert "rad/s^2" in (tmp_path / "out" / "report.html").read_text("utf-8")
    found = Discovery.load(tmp_path / "out" / "discovery.json")
    assert found.equations == {"th": parse("w"), "w": parse("-0.3*w - 9.81*sin(th)")}
    assert found.constant_units["w"] == ("1/s", "rad/s^2")
    with pytest.warns(DeprecationWarning, match="constant_units has the units"):
        assert found.coefficient_units()["w"] == {"w": "1/s", "sin(th)": "rad/s^2"}
    assert found.unit_faults() == {}


def test_a_constant_within_a_function_has_its_unit():
    """In a saturation both the rate and the half point have units, in the shell as in the table."""
    read_units({"x": "m"})
    found = Discovery(
        {"s": parse("-2*s/(s + 1.5)")},
        {"s": ((-2.0, 0.1), (1.5, 0.1))},
        {},
        {},
        settings={"column_units": {"s": "mol", "t": "h"}},
    )
    assert found.constant_units == {"s": ("mol/h", "mol")}
    assert [one.unit for one in found.parameters.values()] == ["mol/h", "mol"]


@pytest.mark.slow
def test_a_variation_that_makes_no_sense_is_not_taken(swing):
    """With a length in the place of the angle, no equation holds its sine."""
    t, th, w = swing.to_numpy().T
    data = (t, np.column_stack([th, w]))
    units = {"th": "m", "w": "m/s", "t": "s"}
    found = dynsr.discover(data, states=["th", "w"], units=units, **QUICK)
    assert found.unit_faults() == {}
    assert not found.equations["w"].has(parse("sin(th)"))


def test_a_misfit_that_stays_is_said():
    """A given part of an equation that makes no sense in the units is named in the explanation."""
    found = dynsr.discover(
        (T, 2 * np.arctan(np.exp(-T) * np.tan(0.5))),
        known={"x": "-sin(x)"},
        units="x=m, t=s",
        **QUICK,
    )
    assert "it is no equation: sin(x) of a quantity in m." in found.explanation["x"]
    with pytest.raises(InputError, match="the columns have no units"):
        dynsr.Discovery({"x": parse("-x")}, {}, {}, {}).unit_faults()
    with pytest.raises(InputError, match="no column has a unit in its name"):
        dynsr.discover((T, T**2), units="columns", **QUICK)


def test_without_pint_the_remedy_is_said(monkeypatch):
    """Units need the extra, and the message holds the command."""
    monkeypatch.setattr("dynsr.expression.dimensions.need", _none)
    with pytest.raises(MissingExtra, match=r"dynsr\[units\]"):
        read_units({"x": "m"})


def _none(module, extra, user):
    raise MissingExtra(f'{user} needs {module}: pip install "dynsr[{extra}]"')
