"""Forty equations of the Feynman Lectures on Physics, with data made from stated ranges.

R. P. Feynman, R. B. Leighton, M. Sands, "The Feynman Lectures on Physics", volumes I to III; the
number in front is volume, chapter and equation. Formulas and choice of ranges are ours: every
variable is drawn evenly from its range, which keeps clear of poles and domain ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import evaluate, parse

Range = tuple[float, float]


@dataclass(frozen=True)
class Lecture:
    """One equation: its number, what it gives, the formula, and the range of each variable."""

    number: str
    title: str
    formula: str
    ranges: tuple[tuple[str, Range], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(name for name, _ in self.ranges)

    @cached_property
    def expr(self) -> sympy.Expr:
        """The formula in SymPy."""
        return parse(self.formula, self.names)

    def samples(self, rows: int, rng: np.random.Generator, widen: float = 0.0) -> Samples:
        """Draw samples; ``widen`` moves both ends of every range out by that part of its width.

        >>> LECTURES[0].samples(5, np.random.default_rng(0)).X.shape
        (5, 1)
        """
        low = np.array([a - widen * (b - a) for _, (a, b) in self.ranges])
        high = np.array([b + widen * (b - a) for _, (a, b) in self.ranges])
        X = rng.uniform(low, high, (rows, len(low)))
        y = evaluate(self.expr, dict(zip(self.names, X.T, strict=True)))
        return Samples(X, y, self.names, "y", "given", np.arange(float(rows)))


def _lecture(number: str, title: str, formula: str, **ranges: Range) -> Lecture:
    return Lecture(number, title, formula, tuple(ranges.items()))


_A, _B, _C = (1.0, 3.0), (1.0, 5.0), (0.5, 2.0)
_V, _LIGHT = (0.5, 2.0), (3.0, 10.0)
LECTURES: tuple[Lecture, ...] = (
    _lecture("I.6.2a", "normal distribution", "exp(-theta^2/2)/sqrt(2*pi)", theta=_A),
    _lecture(
        "I.6.2",
        "normal distribution of width sigma",
        "exp(-(theta/sigma)^2/2)/(sqrt(2*pi)*sigma)",
        theta=_A,
        sigma=_A,
    ),
    _lecture(
        "I.6.2b",
        "normal distribution about theta1",
        "exp(-((theta-theta1)/sigma)^2/2)/(sqrt(2*pi)*sigma)",
        theta=_A,
        theta1=_A,
        sigma=_A,
    ),
    _lecture(
        "I.8.14",
        "distance in the plane",
        "sqrt((x2-x1)^2+(y2-y1)^2)",
        x1=_B,
        x2=_B,
        y1=_B,
        y2=_B,
    ),
    _lecture("I.10.7", "relativistic mass", "m/sqrt(1-v^2/c^2)", m=_B, v=_V, c=_LIGHT),
    _lecture("I.12.2", "Coulomb force", "q1*q2/(4*pi*eps*r^2)", q1=_B, q2=_B, eps=_B, r=_B),
    _lecture(
        "I.12.11",
        "Lorentz force at an angle",
        "q*(E1+B*v*sin(theta))",
        q=_B,
        E1=_B,
        B=_B,
        v=_B,
        theta=_B,
    ),
    _lecture("I.13.4", "kinetic energy", "m*(v^2+u^2+w^2)/2", m=_B, v=_B, u=_B, w=_B),
    _lecture(
        "I.13.12",
        "change of potential energy",
        "m1*m2*G*(1/r2-1/r1)",
        m1=_B,
        m2=_B,
        r1=(1.0, 2.0),
        r2=(2.5, 5.0),
        G=_B,
    ),
    _lecture(
        "I.15.3x",
        "Lorentz transformation",
        "(x-u*t)/sqrt(1-u^2/c^2)",
        x=(5.0, 10.0),
        u=(1.0, 2.0),
        c=(3.0, 20.0),
        t=(1.0, 2.0),
    ),
    _lecture("I.15.10", "momentum", "m*v/sqrt(1-v^2/c^2)", m=_B, v=_V, c=_LIGHT),
    _lecture("I.16.6", "sum of velocities", "(u+v)/(1+u*v/c^2)", c=_B, v=_B, u=_B),
    _lecture("I.18.4", "centre of mass", "(m1*r1+m2*r2)/(m1+m2)", m1=_B, m2=_B, r1=_B, r2=_B),
    _lecture("I.18.16", "angular momentum", "m*r*v*sin(theta)", m=_B, r=_B, v=_B, theta=_B),
    _lecture("I.24.6", "energy of an oscillator", "m*(w^2+w0^2)*x^2/4", m=_A, w=_A, w0=_A, x=_A),
    _lecture("I.26.2", "law of refraction", "asin(n*sin(theta2))", n=(0.2, 0.9), theta2=_B),
    _lecture("I.27.6", "focal length", "1/(1/d1+n/d2)", d1=_B, d2=_B, n=_B),
    _lecture(
        "I.29.16",
        "interference of two waves",
        "sqrt(x1^2+x2^2+2*x1*x2*cos(theta1-theta2))",
        x1=_B,
        x2=_B,
        theta1=_B,
        theta2=_B,
    ),
    _lecture(
        "I.30.3",
        "diffraction grating",
        "I0*sin(n*theta/2)^2/sin(theta/2)^2",
        I0=_B,
        theta=(1.0, 5.0),
        n=_B,
    ),
    _lecture(
        "I.32.17",
        "scattered power",
        "c*E0^2*r^2*w^4/(w^2-w0^2)^2",
        c=_C,
        E0=_C,
        r=_C,
        w=(1.0, 2.0),
        w0=(3.0, 5.0),
    ),
    _lecture("I.34.10", "Doppler shift", "w0/(1-v/c)", c=_LIGHT, v=_V, w0=_B),
    _lecture(
        "I.34.14",
        "relativistic Doppler shift",
        "w0*(1+v/c)/sqrt(1-v^2/c^2)",
        c=_LIGHT,
        v=_V,
        w0=_B,
    ),
    _lecture(
        "I.37.4",
        "intensity of interference",
        "I1+I2+2*sqrt(I1*I2)*cos(delta)",
        I1=_B,
        I2=_B,
        delta=_B,
    ),
    _lecture("I.39.22", "ideal gas", "n*k*T/V", n=_B, T=_B, V=_B, k=_B),
    _lecture(
        "I.40.1", "barometric formula", "n0*exp(-m*g*x/(k*T))", n0=_B, m=_C, g=_C, x=_C, T=_A, k=_A
    ),
    _lecture(
        "I.41.16", "black body", "h*w^3/(pi^2*c^2*(exp(h*w/(k*T))-1))", w=_C, T=_A, h=_C, k=_A, c=_A
    ),
    _lecture("I.43.43", "thermal conductivity", "k*v/((g-1)*A)", g=(2.0, 5.0), k=_B, v=_B, A=_B),
    _lecture("I.44.4", "work of an expansion", "n*k*T*log(V2/V1)", n=_B, k=_B, T=_B, V1=_B, V2=_B),
    _lecture("I.47.23", "speed of sound", "sqrt(g*p/rho)", g=_B, p=_B, rho=_B),
    _lecture("I.48.20", "energy of a particle", "m*c^2/sqrt(1-v^2/c^2)", m=_B, v=_V, c=_LIGHT),
    _lecture(
        "I.50.26",
        "anharmonic vibration",
        "x1*(cos(w*t)+a*cos(w*t)^2)",
        x1=_A,
        w=_A,
        t=_A,
        a=_A,
    ),
    _lecture(
        "II.6.11",
        "field of a dipole",
        "p*cos(theta)/(4*pi*eps*r^2)",
        eps=_A,
        p=_A,
        theta=(0.2, 1.4),
        r=_A,
    ),
    _lecture(
        "II.11.3",
        "driven oscillator",
        "q*E1/(m*(w0^2-w^2))",
        q=_A,
        E1=_A,
        m=_A,
        w0=(3.0, 5.0),
        w=(1.0, 2.0),
    ),
    _lecture(
        "II.11.27",
        "polarisation",
        "n*a*eps*E1/(1-n*a/3)",
        n=(0.1, 1.0),
        a=(0.1, 1.0),
        eps=_B,
        E1=_B,
    ),
    _lecture(
        "II.24.17", "wave guide", "sqrt(w^2/c^2-pi^2/d^2)", w=(4.0, 6.0), c=(1.0, 2.0), d=(2.0, 4.0)
    ),
    _lecture(
        "II.35.18",
        "magnetised atoms",
        "n0/(exp(m*B/(k*T))+exp(-m*B/(k*T)))",
        n0=_A,
        k=_A,
        T=_A,
        m=_A,
        B=_A,
    ),
    _lecture("II.35.21", "magnetisation", "n*m*tanh(m*B/(k*T))", n=_B, m=_B, B=_B, k=_B, T=_B),
    _lecture("III.4.33", "mean energy of a mode", "h*w/(exp(h*w/(k*T))-1)", h=_B, w=_B, k=_B, T=_B),
    _lecture("III.10.19", "energy of a spin", "m*sqrt(Bx^2+By^2+Bz^2)", m=_B, Bx=_B, By=_B, Bz=_B),
    _lecture("III.15.14", "effective mass", "h^2/(2*E1*d^2)", h=_B, E1=_B, d=_B),
)


def find_lectures(numbers: Sequence[str]) -> list[Lecture]:
    """Give the lectures of some numbers, all for none named.

    >>> [lecture.title for lecture in find_lectures(["I.12.2"])]
    ['Coulomb force']
    """
    known = {lecture.number: lecture for lecture in LECTURES}
    for number in numbers:
        if number not in known:
            raise InputError(f"unknown equation {number!r}; they are: {', '.join(known)}")
    return [known[number] for number in numbers] or list(LECTURES)
