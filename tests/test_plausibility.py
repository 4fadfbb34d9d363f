"""The prior by which unusual functions cost more than laws that people write."""

from __future__ import annotations

import pytest

from dynsr.expression import complexity, parse, plausibility_bits
from dynsr.fit import structure_bits


@pytest.mark.parametrize(
    "law",
    [
        "0.8*x - 0.3*x*y",
        "1.2*S/(0.4 + S)",
        "0.3*V*log(8.1/V)",
        "2.1*x**2/(1.0 + x**2)",
        "-9.81*sin(theta) - 0.2*omega",
        "1.5 + 0.4*sin(b - a)",
        "-0.3*sqrt(h)",
        "1.7*y*exp(-0.4*x)",
        "0.5*cos(1.2*t + 0.3)",
        "tanh(0.7*x - 0.1)",
        "cos(theta)*sin(theta)/(2 - cos(theta)**2)",
        "sin(2*theta)",
        "0.4*V**(3/2)",
    ],
)
def test_textbook_laws_cost_nothing(law: str) -> None:
    """Growth laws, saturation, pendula, coupled phases and driven oscillators cost no more."""
    assert plausibility_bits(parse(law)) == 0


@pytest.mark.parametrize(
    ("unusual", "usual"),
    [
        ("cos(0.25*V - 1)", "0.25*V*log(8.0/V)"),
        ("0.7*exp(1/(S + 1)) - 1.9", "-1.9*S/(0.7 + S)"),
        ("exp(sin(x))", "exp(x)*sin(x)"),
        ("sin(0.3*x)", "sin(3*x)"),
        ("sin(x + 0.4)", "sin(x) + 0.4*cos(x)"),
        ("sin(x*y)", "sin(x)*y"),
        ("log(x + sqrt(y))", "log(x) + sqrt(y)"),
        ("exp(x**2 + y)", "exp(x + y)"),
        ("exp(x + y)", "exp(x)"),
        ("x**1.37", "x**2"),
        ("x**y", "x*y"),
        ("x**8", "x**4"),
        ("tan(x)", "sin(x)"),
        ("sqrt(1 + 1/(x + y))", "sqrt(1 + x)"),
    ],
)
def test_unusual_places_cost_more_than_usual_ones(unusual: str, usual: str) -> None:
    """Fitted frequencies, phases, nesting, curved arguments and odd powers cost extra bits."""
    assert plausibility_bits(parse(unusual)) > plausibility_bits(parse(usual))


def test_the_two_known_offenders_lose_to_the_laws_behind_their_data() -> None:
    """With the bits of their structure, both unphysical answers cost more than the true laws."""
    pairs = (
        ("cos(0.25*V - 1.0)", "0.25*V*log(8.3/V)"),
        ("0.7*exp(1/(S + 1.0)) - 1.9", "-1.9*S/(0.71 + S)"),
    )
    for wrong, right in pairs:
        bits = [structure_bits(e) + plausibility_bits(e) for e in map(parse, (wrong, right))]
        assert bits[0] > bits[1] + 4


def test_a_column_that_is_no_angle_has_a_dearer_sine() -> None:
    """Where angles are named, the sine of another column costs extra; time needs no naming."""
    pendulum = parse("sin(theta)")
    assert plausibility_bits(pendulum, angles=("theta",)) == 0
    assert plausibility_bits(pendulum, angles=("x",)) > 0
    assert plausibility_bits(parse("sin(1.3*t)"), angles=()) == 0


def test_the_length_in_bits_is_as_it_was() -> None:
    """The complexity that the paper's tables rank by knows nothing of plausibility."""
    assert complexity(parse("cos(x*y)")) == complexity(parse("exp(x*y)"))
