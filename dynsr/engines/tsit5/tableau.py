"""Tsit5: the numbers of the method, and the step-size rules of OrdinaryDiffEq.jl.

Ch. Tsitouras, "Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying
assumption", Computers & Mathematics with Applications 62 (2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

Slopes = Callable[..., Sequence[float]]

C2, C3, C4, C5 = 0.161, 0.327, 0.9, 0.9800255409045097
A21 = 0.161
A31, A32 = -0.008480655492356989, 0.335480655492357
A41, A42, A43 = 2.8971530571054935, -6.359448489975075, 4.3622954328695815
A51, A52, A53, A54 = (
    5.325864828439257,
    -11.748883564062828,
    7.4955393428898365,
    -0.09249506636175525,
)
A61, A62, A63, A64, A65 = (
    5.86145544294642,
    -12.92096931784711,
    8.159367898576159,
    -0.071584973281401,
    -0.028269050394068383,
)
# The last stage is the step itself (first same as last).
B1, B2, B3, B4, B5, B6 = (
    0.09646076681806523,
    0.01,
    0.4798896504144996,
    1.379008574103742,
    -3.290069515436081,
    2.324710524099774,
)
# Difference between the orders 5 and 4: the error estimate.
E1, E2, E3, E4, E5, E6, E7 = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    1.0 / 66.0,
)

NODES = np.array([0.0, C2, C3, C4, C5, 1.0, 1.0])
STAGES = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [A21, 0, 0, 0, 0, 0],
        [A31, A32, 0, 0, 0, 0],
        [A41, A42, A43, 0, 0, 0],
        [A51, A52, A53, A54, 0, 0],
        [A61, A62, A63, A64, A65, 0],
        [B1, B2, B3, B4, B5, B6],
    ]
)
ERROR = np.array([E1, E2, E3, E4, E5, E6, E7])

# Free interpolant of order 4: row i holds stage i's weights of theta, ..., theta^4, where
# x(t + theta h) = x(t) + h * sum_i k_i (row i . powers of theta).
INTERPOLANT = np.array(
    [
        [1.0, -2.763706197274826, 2.9132554618219126, -1.0530884977290216],
        [0.0, 0.13169999999999998, -0.2234, 0.1017],
        [0.0, 3.9302962368947516, -5.941033872131505, 2.490627285651253],
        [0.0, -12.411077166933676, 30.33818863028232, -16.548102889244902],
        [0.0, 37.50931341651104, -88.1789048947664, 47.37952196281928],
        [0.0, -27.896526289197286, 65.09189467479366, -34.87065786149661],
        [0.0, 1.5, -4.0, 2.5],
    ]
)

BETA1, BETA2, GAMMA = 7 / 50, 2 / 25, 0.9
SHRINK_AT_MOST, GROW_AT_MOST = 5.0, 10.0
FIRST_ERROR = 1e-4


def stages_of_step(
    f: Slopes, x: list[float], t: float, h: float, k1: Sequence[float]
) -> tuple[tuple[Sequence[float], ...], list[float]]:
    """Give the seven stages of one step in plain floats, and the state it ends in.

    ``f(*x, t)`` gives k slopes of k states; ``k1`` are those at the start.
    """
    y = [u + h * (A21 * a) for u, a in zip(x, k1, strict=False)]
    k2 = f(*y, t + C2 * h)
    y = [u + h * (A31 * a + A32 * b) for u, a, b in zip(x, k1, k2, strict=False)]
    k3 = f(*y, t + C3 * h)
    y = [u + h * (A41 * a + A42 * b + A43 * c) for u, a, b, c in zip(x, k1, k2, k3, strict=False)]
    k4 = f(*y, t + C4 * h)
    y = [
        u + h * (A51 * a + A52 * b + A53 * c + A54 * d)
        for u, a, b, c, d in zip(x, k1, k2, k3, k4, strict=False)
    ]
    k5 = f(*y, t + C5 * h)
    y = [
        u + h * (A61 * a + A62 * b + A63 * c + A64 * d + A65 * e)
        for u, a, b, c, d, e in zip(x, k1, k2, k3, k4, k5, strict=False)
    ]
    k6 = f(*y, t + h)
    y = [
        u + h * (B1 * a + B2 * b + B3 * c + B4 * d + B5 * e + B6 * g)
        for u, a, b, c, d, e, g in zip(x, k1, k2, k3, k4, k5, k6, strict=False)
    ]
    return (k1, k2, k3, k4, k5, k6, f(*y, t + h)), y


def error_of_step(
    x: Sequence[float],
    new: Sequence[float],
    h: float,
    stages: tuple[Sequence[float], ...],
    reltol: float,
    abstol: float,
) -> float:
    """Root mean square of the embedded difference over the states; 1 is just acceptable."""
    total = 0.0
    for u, v, a, b, c, d, e, g, i in zip(x, new, *stages, strict=False):
        r = h * (E1 * a + E2 * b + E3 * c + E4 * d + E5 * e + E6 * g + E7 * i)
        r /= abstol + reltol * max(abs(u), abs(v))
        total += r * r
    return math.sqrt(total / len(new))


_F32 = np.float32
_F32_MAX = float(np.finfo(_F32).max)
_LOG2_A, _LOG2_B, _LOG2_C = _F32(0.338953), _F32(2.198599), _F32(1.523692)


def fast_power(x: float, y: float) -> float:
    """Approximate x^y in single precision, as the controller of OrdinaryDiffEq.jl does.

    exp2(y log2(x)) with Goldberg's rational log2, good to about 1e-3. The step times of the
    reference depend on this approximation in their fifth digit. Needs x >= 0.
    """
    if not x < _F32_MAX:
        return math.inf
    single = _F32(x)
    if single == 0:
        return 0.0
    mantissa, exponent = math.frexp(float(single))
    if mantissa < 0.75:
        mantissa, exponent = 2 * mantissa, exponent - 1
    s = _F32(mantissa) - _F32(1)
    log2 = _F32(exponent) + s * (_LOG2_A * s + _LOG2_B) / (s + _LOG2_C)
    return float(_F32(2.0 ** float(_F32(y) * log2)))


def divisor(error: float, last_error: float) -> float:
    """Divisor of the step length after a step of that error (PI control; above 1, rejected)."""
    growth = fast_power(error, BETA1)
    if error > 1.0:
        return min(SHRINK_AT_MOST, growth / GAMMA)
    q = growth / fast_power(last_error, BETA2)
    return max(1.0 / GROW_AT_MOST, min(SHRINK_AT_MOST, q / GAMMA))


def fast_powers(x: np.ndarray, y: float) -> np.ndarray:
    """Approximate x^y for an array, the same as :func:`fast_power` element by element."""
    single = np.asarray(x, dtype=_F32)
    mantissa, exponent = np.frexp(single)
    low = mantissa < _F32(0.75)
    s = np.where(low, 2 * mantissa, mantissa) - _F32(1)
    exponent = (exponent - low).astype(_F32)
    log2 = exponent + s * (_LOG2_A * s + _LOG2_B) / (s + _LOG2_C)
    powers = np.exp2((_F32(y) * log2).astype(float)).astype(_F32).astype(float)
    return np.where(single == 0, 0.0, np.where(np.isinf(single), np.inf, powers))
