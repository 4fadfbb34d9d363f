"""Systems of populations: growth laws, ecology, epidemics."""

from __future__ import annotations

from dynsr.benchmarks.zoo.system import ZooSystem

GROWTH = (
    ZooSystem(
        "logistic",
        "growth",
        "Verhulst 1838",
        {"n": "0.83*n*(1 - n/7.4)"},
        ((0.41,), (12.6,)),
        12.0,
    ),
    ZooSystem(
        "theta-logistic",
        "growth",
        "Gilpin and Ayala 1973",
        {"n": "0.71*n*(1 - (n/5.3)^1.6)"},
        ((0.35,), (7.9,)),
        12.0,
    ),
    ZooSystem(
        "gompertz",
        "growth",
        "Gompertz 1825; tumours: Laird 1964",
        {"v": "0.62*v*log(9.3/v)"},
        ((0.27,), (16.5,)),
        9.0,
    ),
    ZooSystem(
        "von-bertalanffy",
        "growth",
        "von Bertalanffy 1957",
        {"m": "1.46*m^(2/3) - 0.52*m"},
        ((0.12,), (31.0,)),
        18.0,
    ),
    ZooSystem(
        "allee",
        "growth",
        "Allee 1931; Lewis and Kareiva 1993",
        {"n": "0.24*n*(n/1.3 - 1)*(1 - n/6.2)"},
        ((1.72,), (1.06,)),
        22.0,
    ),
    ZooSystem(
        "budworm",
        "growth",
        "Ludwig, Jones and Holling 1978",
        {"n": "0.48*n*(1 - n/9.7) - 0.87*n^2/(1.44 + n^2)"},
        ((3.1,), (9.2,)),
        30.0,
    ),
    ZooSystem(
        "constant-harvest",
        "growth",
        "Brauer and Sanchez 1975",
        {"n": "0.92*n*(1 - n/8.6) - 1.15"},
        ((1.83,), (11.4,)),
        14.0,
    ),
    ZooSystem(
        "bass-diffusion",
        "growth",
        "Bass 1969",
        {"a": "(0.028 + 0.41*a)*(1 - a)"},
        ((0.012,), (0.35,)),
        16.0,
    ),
    ZooSystem(
        "grazing",
        "growth",
        "Noy-Meir 1975; May 1977",
        {"v": "0.74*v*(1 - v/6.8) - 0.93*v/(1.1 + v)"},
        ((0.62,), (9.3,)),
        22.0,
    ),
    ZooSystem(
        "language-death",
        "growth",
        "Abrams and Strogatz 2003",
        {"x": "1.16*(1 - x)*x^1.31 - 0.74*x*(1 - x)^1.31"},
        ((0.24,), (0.09,)),
        18.0,
    ),
)

ECOLOGY = (
    ZooSystem(
        "predator-prey",
        "ecology",
        "Lotka 1925; Volterra 1926",
        {"prey": "1.23*prey - 0.58*prey*pred", "pred": "0.31*prey*pred - 0.87*pred"},
        ((2.4, 0.9), (5.1, 3.3)),
        15.0,
    ),
    ZooSystem(
        "competition",
        "ecology",
        "Volterra 1926; Gause 1934",
        {
            "a": "0.92*a*(1 - (a + 0.63*b)/4.7)",
            "b": "0.57*b*(1 - (b + 0.48*a)/3.6)",
        },
        ((0.31, 0.84), (6.2, 0.22)),
        14.0,
    ),
    ZooSystem(
        "rosenzweig-macarthur",
        "ecology",
        "Rosenzweig and MacArthur 1963",
        {
            "x": "1.15*x*(1 - x/6.3) - 1.42*x*y/(1.7 + x)",
            "y": "0.86*x*y/(1.7 + x) - 0.37*y",
        },
        ((1.1, 1.6), (4.6, 0.5)),
        40.0,
    ),
    ZooSystem(
        "holling-three",
        "ecology",
        "Holling 1959",
        {
            "x": "0.94*x*(1 - x/5.1) - 1.28*x^2*y/(1.69 + x^2)",
            "y": "0.72*x^2*y/(1.69 + x^2) - 0.33*y",
        },
        ((3.4, 0.6), (0.7, 1.9)),
        30.0,
    ),
    ZooSystem(
        "crowded-prey",
        "ecology",
        "Volterra 1931",
        {"x": "x*(1.06 - 0.19*x - 0.47*y)", "y": "y*(0.36*x - 0.74)"},
        ((1.2, 0.6), (5.3, 2.2)),
        18.0,
    ),
    ZooSystem(
        "holling-tanner",
        "ecology",
        "Tanner 1975; May 1973",
        {
            "x": "1.12*x*(1 - x/7.6) - 0.88*x*y/(0.67 + x)",
            "y": "0.23*y*(1 - y/(0.76*x))",
        },
        ((2.3, 0.7), (6.1, 2.7)),
        40.0,
    ),
    ZooSystem(
        "beddington-deangelis",
        "ecology",
        "Beddington 1975; DeAngelis et al. 1975",
        {
            "x": "0.97*x*(1 - x/7.2) - 1.36*x*y/(1 + 0.64*x + 0.29*y)",
            "y": "0.81*x*y/(1 + 0.64*x + 0.29*y) - 0.46*y",
        },
        ((2.8, 0.5), (0.8, 2.6)),
        35.0,
    ),
    ZooSystem(
        "cyclic-competition",
        "ecology",
        "May and Leonard 1975",
        {
            "a": "a*(1 - a - 0.72*b - 1.42*c)",
            "b": "b*(1 - 1.42*a - b - 0.72*c)",
            "c": "c*(1 - 0.72*a - 1.42*b - c)",
        },
        ((0.62, 0.17, 0.31), (0.15, 0.25, 0.55)),
        45.0,
    ),
    ZooSystem(
        "food-chain",
        "ecology",
        "Hastings and Powell 1991",
        {
            "x": "x*(1 - x) - 4.86*x*y/(1 + 2.93*x)",
            "y": "4.86*x*y/(1 + 2.93*x) - 0.11*y*z/(1 + 2.1*y) - 0.41*y",
            "z": "0.11*y*z/(1 + 2.1*y) - 0.012*z",
        },
        ((0.72, 0.18, 8.1), (0.41, 0.29, 6.9)),
        120.0,
    ),
    ZooSystem(
        "four-competitors",
        "ecology",
        "Vano et al. 2006",
        {
            "a": "a*(1 - a - 1.09*b - 1.52*c)",
            "b": "0.72*b*(1 - b - 0.44*c - 1.36*d)",
            "c": "1.53*c*(1 - 2.33*a - c - 0.47*d)",
            "d": "1.27*d*(1 - 1.21*a - 0.51*b - 0.35*c - d)",
        },
        ((0.27, 0.46, 0.13, 0.38), (0.52, 0.18, 0.24, 0.11)),
        40.0,
    ),
)

EPIDEMICS = (
    ZooSystem(
        "kermack-mckendrick",
        "epidemics",
        "Kermack and McKendrick 1927",
        {"s": "-0.64*s*i", "i": "0.64*s*i - 0.21*i", "r": "0.21*i"},
        ((0.96, 0.04, 0.0), (0.71, 0.11, 0.18)),
        35.0,
    ),
    ZooSystem(
        "waning-immunity",
        "epidemics",
        "SIRS: Hethcote 1976",
        {"s": "-0.92*s*i + 0.063*(1 - s - i)", "i": "0.92*s*i - 0.31*i"},
        ((0.94, 0.05), (0.52, 0.36)),
        60.0,
    ),
    ZooSystem(
        "ross-malaria",
        "epidemics",
        "Ross 1911; Macdonald 1957",
        {"h": "0.38*m*(1 - h) - 0.12*h", "m": "0.46*h*(1 - m) - 0.27*m"},
        ((0.07, 0.02), (0.83, 0.14)),
        25.0,
    ),
    ZooSystem(
        "virus-dynamics",
        "epidemics",
        "Nowak and Bangham 1996",
        {
            "x": "1.3 - 0.17*x - 0.42*x*v",
            "y": "0.42*x*v - 0.61*y",
            "v": "2.9*y - 1.7*v",
        },
        ((6.8, 0.02, 0.09), (2.1, 0.7, 1.6)),
        20.0,
    ),
    ZooSystem(
        "seir",
        "epidemics",
        "Anderson and May 1991",
        {
            "s": "-1.14*s*i",
            "e": "1.14*s*i - 0.37*e",
            "i": "0.37*e - 0.26*i",
            "r": "0.26*i",
        },
        ((0.95, 0.02, 0.03, 0.0), (0.64, 0.17, 0.06, 0.13)),
        35.0,
    ),
    ZooSystem(
        "saturated-incidence",
        "epidemics",
        "Capasso and Serio 1978",
        {"s": "0.13*(1 - s) - 1.74*s*i/(1 + 2.6*i)", "i": "1.74*s*i/(1 + 2.6*i) - 0.44*i"},
        ((0.93, 0.04), (0.38, 0.47)),
        35.0,
    ),
)

POPULATIONS = (*GROWTH, *ECOLOGY, *EPIDEMICS)
