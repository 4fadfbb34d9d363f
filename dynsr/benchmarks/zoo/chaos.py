"""Chaotic flows, watched for a few of the times in which neighbours part by a factor e."""

from __future__ import annotations

from dynsr.benchmarks.zoo.system import ZooSystem

CHAOS = (
    ZooSystem(
        "lorenz-convection",
        "chaos",
        "Lorenz 1963",
        {"x": "9.7*(y - x)", "y": "x*(27.4 - z) - y", "z": "x*y - 2.63*z"},
        ((-4.2, -6.1, 21.0), (7.4, 3.2, 28.0)),
        4.0,
    ),
    ZooSystem(
        "chen",
        "chaos",
        "Chen and Ueta 1999",
        {"x": "34.6*(y - x)", "y": "-6.8*x - x*z + 27.8*y", "z": "x*y - 3.1*z"},
        ((-3.4, 2.1, 17.0), (6.2, 8.9, 24.0)),
        2.0,
    ),
    ZooSystem(
        "rossler-flow",
        "chaos",
        "Rossler 1976",
        {"x": "-y - z", "y": "x + 0.21*y", "z": "0.19 + z*(x - 5.6)"},
        ((-3.7, -4.2, 0.04), (4.4, 2.3, 0.31)),
        30.0,
    ),
    ZooSystem(
        "thomas",
        "chaos",
        "Thomas 1999",
        {
            "x": "sin(y) - 0.19*x",
            "y": "sin(z) - 0.19*y",
            "z": "sin(x) - 0.19*z",
        },
        ((1.3, -0.4, 2.6), (-2.2, 0.9, 0.7)),
        40.0,
    ),
    ZooSystem(
        "sprott-b",
        "chaos",
        "Sprott 1994",
        {"x": "y*z", "y": "x - y", "z": "1 - x*y"},
        ((0.6, -0.8, 1.1), (-1.7, -0.5, 0.4)),
        18.0,
    ),
    ZooSystem(
        "halvorsen",
        "chaos",
        "Sprott 2003",
        {
            "x": "-1.42*x - 4*y - 4*z - y^2",
            "y": "-1.42*y - 4*z - 4*x - z^2",
            "z": "-1.42*z - 4*x - 4*y - x^2",
        },
        ((-4.6, -1.7, 1.2), (-0.8, 2.4, -6.3)),
        5.0,
    ),
    ZooSystem(
        "lorenz-84",
        "chaos",
        "Lorenz 1984",
        {
            "x": "-y^2 - z^2 - 0.26*x + 2.05",
            "y": "x*y - 3.9*x*z - y + 1.03",
            "z": "3.9*x*y + x*z - z",
        },
        ((1.2, 0.7, -0.4), (0.3, -1.1, 1.4)),
        12.0,
    ),
    ZooSystem(
        "nose-hoover",
        "chaos",
        "Nose 1984; Hoover 1985",
        {"x": "y", "y": "-x + y*z", "z": "1.07 - y^2"},
        ((0.3, 4.6, 0.2), (1.8, -0.7, -1.3)),
        25.0,
    ),
    ZooSystem(
        "rabinovich-fabrikant",
        "chaos",
        "Rabinovich and Fabrikant 1979",
        {
            "x": "y*(z - 1 + x^2) + 0.1*x",
            "y": "x*(3*z + 1 - x^2) + 0.1*y",
            "z": "-2*z*(0.14 + x*y)",
        },
        ((-1.1, 0.2, 0.6), (0.4, -0.9, 0.3)),
        20.0,
    ),
    ZooSystem(
        "rikitake",
        "chaos",
        "Rikitake 1958",
        {"x": "-1.9*x + z*y", "y": "-1.9*y + (z - 4.8)*x", "z": "1 - x*y"},
        ((1.4, -0.7, 3.2), (-2.1, -0.6, 5.9)),
        14.0,
    ),
    ZooSystem(
        "hyperchaos",
        "chaos",
        "Rossler 1979",
        {
            "x": "-y - z",
            "y": "x + 0.26*y + w",
            "z": "2.9 + x*z",
            "w": "-0.48*z + 0.052*w",
        },
        ((-9.6, -5.8, 0.2, 10.3), (-14.0, 8.6, 0.3, 16.2)),
        18.0,
    ),
    ZooSystem(
        "arneodo",
        "chaos",
        "Arneodo, Coullet and Tresser 1981",
        {"x": "y", "y": "z", "z": "5.43*x - 3.52*y - z - 1.03*x^3"},
        ((0.6, -0.3, 0.8), (-1.7, 1.1, 0.4)),
        16.0,
    ),
)
