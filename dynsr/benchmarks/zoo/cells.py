"""Systems of cells: chemical reactions and enzymes, gene circuits, nerves."""

from __future__ import annotations

from dynsr.benchmarks.zoo.system import ZooSystem

REACTIONS = (
    ZooSystem(
        "enzyme",
        "reactions",
        "Michaelis and Menten 1913",
        {"s": "-1.27*s/(0.63 + s)"},
        ((3.9,), (7.2,)),
        6.0,
    ),
    ZooSystem(
        "substrate-inhibition",
        "reactions",
        "Haldane 1930; Andrews 1968",
        {"s": "0.31*(4.2 - s) - 1.93*s/(0.57 + s + 0.44*s^2)"},
        ((1.35,), (0.06,)),
        14.0,
    ),
    ZooSystem(
        "chemostat",
        "reactions",
        "Monod 1950",
        {
            "s": "0.42*(3.8 - s) - 1.73*s*x/(0.61 + s)",
            "x": "0.86*s*x/(0.61 + s) - 0.42*x",
        },
        ((3.1, 0.12), (0.4, 2.3)),
        16.0,
    ),
    ZooSystem(
        "enzyme-complex",
        "reactions",
        "Briggs and Haldane 1925",
        {"s": "-1.42*s*(0.83 - c) + 0.36*c", "c": "1.42*s*(0.83 - c) - 0.91*c"},
        ((2.7, 0.03), (1.1, 0.61)),
        7.0,
    ),
    ZooSystem(
        "brusselator",
        "reactions",
        "Prigogine and Lefever 1968",
        {"x": "1.1 + x^2*y - 3.9*x", "y": "2.9*x - x^2*y"},
        ((1.3, 1.8), (0.4, 3.7)),
        25.0,
    ),
    ZooSystem(
        "oregonator",
        "reactions",
        "Field and Noyes 1974; two variables: Tyson 1985",
        {
            "x": "5.4*(x*(1 - x) - 0.96*z*(x - 0.013)/(x + 0.013))",
            "z": "x - z",
        },
        ((0.41, 0.06), (0.05, 0.31)),
        14.0,
    ),
    ZooSystem(
        "selkov",
        "reactions",
        "Selkov 1968",
        {"x": "-1.06*x + 0.083*y + x^2*y", "y": "0.61 - 0.083*y - x^2*y"},
        ((0.9, 1.4), (0.3, 2.6)),
        40.0,
    ),
    ZooSystem(
        "higgins",
        "reactions",
        "Higgins 1964",
        {"x": "0.74 - 1.12*x*y", "y": "1.12*x*y - 1.83*y/(0.91 + y)"},
        ((1.6, 0.4), (0.6, 1.5)),
        25.0,
    ),
    ZooSystem(
        "chlorine-dioxide",
        "reactions",
        "Lengyel, Rabai and Epstein 1990",
        {"x": "9.6 - x - 4*x*y/(1 + x^2)", "y": "2.3*x*(1 - y/(1 + x^2))"},
        ((1.4, 2.9), (3.3, 7.1)),
        14.0,
    ),
    ZooSystem(
        "stirred-tank-reactor",
        "reactions",
        "Uppal, Ray and Poore 1974",
        {
            "x": "-x + 0.135*(1 - x)*exp(y)",
            "y": "-2.6*y + 1.08*(1 - x)*exp(y)",
        },
        ((0.12, 0.35), (0.74, 1.1)),
        9.0,
    ),
)

GENES = (
    ZooSystem(
        "gene-switch",
        "genes",
        "Lewis, Slack and Wolpert 1977",
        {"g": "0.08 - 0.72*g + 1.53*g^2/(0.81 + g^2)"},
        ((0.72,), (2.9,)),
        16.0,
    ),
    ZooSystem(
        "self-repression",
        "genes",
        "Becskei and Serrano 2000",
        {"p": "2.6/(1 + 1.83*p^2) - 0.41*p"},
        ((0.04,), (4.7,)),
        8.0,
    ),
    ZooSystem(
        "toggle-switch",
        "genes",
        "Gardner, Cantor and Collins 2000",
        {"u": "3.4/(1 + v^2) - 0.87*u", "v": "2.7/(1 + u^2) - 0.87*v"},
        ((0.31, 0.22), (2.4, 3.3)),
        12.0,
    ),
    ZooSystem(
        "repressilator",
        "genes",
        "Elowitz and Leibler 2000",
        {
            "a": "5.2/(1 + c^3) - 0.93*a",
            "b": "5.2/(1 + a^3) - 0.93*b",
            "c": "5.2/(1 + b^3) - 0.93*c",
        },
        ((0.4, 1.7, 2.6), (3.1, 0.3, 0.9)),
        22.0,
    ),
    ZooSystem(
        "activator-inhibitor",
        "genes",
        "Gierer and Meinhardt 1972",
        {"a": "0.14 - 0.84*a + 1.12*a^2/h", "h": "1.12*a^2 - 0.63*h"},
        ((0.8, 0.4), (1.7, 2.9)),
        25.0,
    ),
    ZooSystem(
        "end-product",
        "genes",
        "Bliss, Painter and Marr 1982",
        {
            "x": "5.3/(1 + z) - 0.47*x",
            "y": "0.47*(x - y)",
            "z": "0.47*y - 1.38*z/(0.86 + z)",
        },
        ((0.6, 0.9, 0.2), (4.1, 1.3, 3.4)),
        40.0,
    ),
    ZooSystem(
        "p53",
        "genes",
        "Geva-Zatorsky et al. 2006",
        {
            "p": "0.92 - 1.64*m*p/(0.13 + p)",
            "q": "1.07*p - 0.81*q",
            "m": "0.81*q - 0.93*m",
        },
        ((0.21, 0.35, 0.12), (1.1, 0.2, 0.9)),
        30.0,
    ),
    ZooSystem(
        "goodwin",
        "genes",
        "Goodwin 1965",
        {
            "x": "2.4/(1 + z^4) - 0.38*x",
            "y": "0.61*x - 0.44*y",
            "z": "0.57*y - 0.52*z",
        },
        ((0.3, 0.2, 0.5), (2.6, 1.1, 0.3)),
        35.0,
    ),
)

NERVES = (
    ZooSystem(
        "fitzhugh-nagumo",
        "nerves",
        "FitzHugh 1961; Nagumo et al. 1962",
        {"v": "v - 0.33*v^3 - w + 0.52", "w": "0.083*(v + 0.71 - 0.79*w)"},
        ((-1.1, 0.4), (1.6, -0.3)),
        90.0,
    ),
    ZooSystem(
        "morris-lecar",
        "nerves",
        "Morris and Lecar 1981",
        {
            "v": "4.9 - 0.1*(v + 60) - 0.4*w*(v + 84) - 0.11*(1 + tanh((v + 1.2)/18))*(v - 120)",
            "w": "0.04*(0.5 + 0.5*tanh((v - 2)/30) - w)*cosh((v - 2)/60)",
        },
        ((-35.0, 0.06), (12.0, 0.31)),
        220.0,
    ),
    ZooSystem(
        "hindmarsh-rose",
        "nerves",
        "Hindmarsh and Rose 1982",
        {"x": "y - 0.97*x^3 + 2.91*x^2 + 1.3", "y": "1.04 - 4.93*x^2 - y"},
        ((-0.9, -1.2), (1.4, -6.1)),
        20.0,
    ),
    ZooSystem(
        "wilson-cowan",
        "nerves",
        "Wilson and Cowan 1972",
        {
            "e": "-e + 1/(1 + exp(1.9 - 10.3*e + 9.8*i))",
            "i": "-i + 1/(1 + exp(4.1 - 10.6*e - 1.8*i))",
        },
        ((0.12, 0.08), (0.83, 0.27)),
        30.0,
    ),
)

CELLS = (*REACTIONS, *GENES, *NERVES)
