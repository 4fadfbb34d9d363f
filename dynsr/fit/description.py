"""Description length: the bits a formula costs plus the bits its residuals cost.

With the noise floor eps and m independent residuals among n,

    L(f) = complexity(f) + m * mean_i log2(1 + (r_i / eps)^2) / 2.

A residual far above the floor costs log2(|r| / eps) bits, as in AI Feynman 2.0 (Udrescu et al.
2020, eq. 5); one below it costs next to nothing, so that a formula gains nothing by following
noise; and a few large residuals cost little, so that the errors of a few bad steps do not decide.
AI Feynman sets eps = 2^-30; here it is estimated from the data, because slopes taken from a
trajectory are never that exact.

Whole systems whose noise is known and whose constants are still floats are compared by the
precision of the constants in the same unit, :func:`residual_bits` and :func:`precision_bits`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import ByText, complexity, free_constants
from dynsr.fit.candidates import Candidate
from dynsr.fit.noise import Noise, noise_of, residuals

_DIGITS = 8


def data_bits(residual: np.ndarray, noise: Noise) -> float:
    """Bits of the residuals: m * mean log2(1 + (r / eps)^2) / 2; inf where one is not finite.

    >>> round(data_bits(np.array([0.0, np.sqrt(3.0)]), Noise(1.0, 2.0)), 12)
    1.0
    """
    with np.errstate(all="ignore"):
        bits = float(np.mean(np.log2(1 + np.square(residual / noise.floor)))) / 2
    return noise.effective_rows * bits if math.isfinite(bits) else math.inf


def mean_error_bits(residual: np.ndarray, resolution: float) -> np.ndarray:
    """Bits a row, mean log2(1 + |r| / resolution), of each row of ``residual`` (..., n).

    Equation 5 of Udrescu et al. (2020) as printed. It is linear below the resolution where
    :func:`data_bits` is square: it ranks formulas before any noise is known, from a resolution
    far below the residuals, where it grows as data_bits does.

    >>> float(mean_error_bits(np.array([[3.0, 1.0]]), 1.0)[0])
    1.5
    """
    with np.errstate(all="ignore"):
        return np.asarray(np.mean(np.log2(1 + np.abs(residual) / resolution), axis=-1))


def description_length(candidate: Candidate, samples: Samples, noise: Noise) -> float:
    """Bits of the formula plus bits of its residuals.

    With a loss of the user's own these are m/2 log2(mean loss), so that all of it counts.
    """
    bits = complexity(candidate.expr)
    if samples.loss is None:
        return bits + data_bits(residuals(candidate, samples), noise)
    mean = float(np.mean(np.square(residuals(candidate, samples))))
    if not math.isfinite(mean):
        return math.inf
    return bits + noise.effective_rows / 2 * math.log2(max(mean, noise.floor**2))


def structure_bits(expr: sympy.Expr) -> float:
    """Bits of a formula whose constants are still to be fitted: each float is one symbol.

    All floats are one kind of symbol, and none merges with another, so that two terms which
    differ in their constants alone are two terms.

    >>> x = sympy.Symbol("x")
    >>> structure_bits(2.5 * x) == structure_bits(-0.1 * x)
    True
    """
    template, values = free_constants(expr, "constant ")
    return complexity(template, values.keys())


def constant_bits(rows: float) -> float:
    """Bits of one fitted constant, log2(m) / 2 of m independent rows (Schwarz 1978).

    >>> constant_bits(256)
    4.0
    """
    return math.log2(max(rows, 2.0)) / 2


def residual_bits(
    mean_squares: np.ndarray, rows: np.ndarray, known: np.ndarray | bool = False
) -> float:
    """Bits of the residuals of a system: sum_s m_s/2 log2(mean squared residual of s).

    The logarithm is that of a likelihood whose noise is the residuals; where the noise is known,
    it is the mean squared residual itself, less 1, over ln 2. A state that was never measured
    misses what its own equation says of it, in units that are known.

    Parameters
    ----------
    mean_squares : (k,) mean squared residual of every state, in units of its noise; of one without
        rows the sum of the squares.
    rows : (k,) independent rows of every state, :func:`dynsr.fit.independent_rows`.
    known : (k,) whether the noise of a state is known.

    >>> float(residual_bits(np.array([4.0]), np.array([100.0])))
    100.0
    """
    missed = np.where(known, (mean_squares - 1) / math.log(2), np.log2(mean_squares))
    # Without rows of their own, the squares are a sum.
    with np.errstate(invalid="ignore"):
        bits = np.where(rows > 0, rows * missed, mean_squares / math.log(2))
    return float(np.sum(bits)) / 2


def precision_bits(
    information: np.ndarray, scales: np.ndarray, constants: np.ndarray | float = 0.0
) -> float:
    """Bits of constants, each to the precision that the data give it (MacKay 1992).

    With the information H and the usual sizes S they are log2 det(1 + S H S)/2: of one constant
    with the standard error s about log2(S/s), and almost 0 of one that is not determined.
    One that is larger than usual, as where terms cancel each other, costs log2(1 + c/S) more: what
    its size relative to the error takes.

    Parameters
    ----------
    information : (P, P) inverse covariance of the constants.
    scales : (P,) their usual sizes.
    constants : (P,) the constants.

    >>> round(precision_bits(np.array([[1e4]]), np.array([2.56])), 2)
    8.0
    """
    if not len(scales):
        return 0.0
    units = np.outer(scales, scales) * information
    if not np.all(np.isfinite(units)):
        return math.inf
    told = np.maximum(np.linalg.eigvalsh(units), 0.0)
    large = np.log2(1 + np.abs(constants / scales))
    return float(np.sum(np.log2(1 + told))) / 2 + float(np.sum(large))


def shortened_bits(
    information: np.ndarray,
    scales: np.ndarray,
    constants: np.ndarray,
    saved: Mapping[tuple[int, ...], float],
) -> float:
    """Bits of constants of which some are written otherwise: as simple numbers, or by other ones.

    A constant that is written otherwise is known, so that those that are correlated with it take
    more bits by themselves: what all take together falls by what it saves, and by no more than it
    takes after those that were written otherwise before it. Those that save most come first.

    Parameters
    ----------
    information : (P, P) inverse covariance of the constants.
    scales : (P,) their usual sizes.
    constants : (P,) the constants.
    saved : places of constants that are written otherwise together -> bits that they save by
        themselves then.

    >>> told = np.diag([1e4, 1e4])
    >>> alone = shortened_bits(told, np.ones(2), np.ones(2), {})
    >>> round(alone - shortened_bits(told, np.ones(2), np.ones(2), {(1,): 5.0}), 9)
    5.0
    """
    free = np.ones(len(constants), dtype=bool)
    told = whole = precision_bits(information, scales, constants)
    for places, bits in sorted(saved.items(), key=lambda one: -one[1]):
        at = list(places)
        if bits <= 0 or not np.all(free[at]):
            continue
        free[at] = False
        rest = precision_bits(information[np.ix_(free, free)], scales[free], constants[free])
        whole -= min(bits, max(told - rest, 0.0))
        told = rest
    return whole


def shift_bits(shift: float, error: float = 1.0) -> float:
    """Bits that the data lose when a constant moves: half its squared z-score, in base 2.

    ``shift`` is in the units of ``error``, the constant's standard error: the loss of a Gaussian
    likelihood near its top.

    >>> round(shift_bits(2.0), 3)
    2.885
    """
    return (shift / error) ** 2 / (2 * math.log(2))


def written_constant(value: float, error: float) -> float:
    """Round a constant to the digits that its standard error supports, nine at most.

    >>> written_constant(9.8123, 0.02)
    9.812
    """
    if not (math.isfinite(error) and error > 0 and value != 0):
        return float(f"{value:.{_DIGITS}e}")
    digits = max(0, min(_DIGITS, math.ceil(math.log10(abs(value) / error))))
    return float(f"{value:.{digits}e}")


def written_bits(
    exprs: Mapping[str, sympy.Expr], errors: Mapping[str, Sequence[tuple[float, float]]]
) -> float:
    """Complexity of equations, each constant written with the digits that its error supports.

    ``errors`` gives for every state (value, standard error) of its constants in their order.
    """
    bits = 0.0
    for state, expr in exprs.items():
        template, values = free_constants(expr, "constant ")
        pairs = zip(values, errors[state], strict=True)
        written = {c: sympy.Float(written_constant(*pair)) for c, pair in pairs}
        bits += complexity(template.xreplace(written))
    return bits


def choose(
    candidates: Iterable[Candidate], samples: Samples, noise: Noise | None = None
) -> Candidate:
    """Give the candidate of least description length; ValueError when there is none.

    >>> t = np.arange(9.0)
    >>> s = Samples(t[:, None], 2 * t, ("x",), "x", "given", t)
    >>> x = sympy.Symbol("x")
    >>> choose([Candidate(x, 4.76, 1.0), Candidate(2 * x, 0.0, 4.6)], s).expr
    2*x
    """
    pool = list(candidates)
    if not pool:
        raise ValueError("there is no candidate to choose from")
    measured = noise or noise_of(pool, samples)
    return min(pool, key=lambda c: (description_length(c, samples, measured), ByText(c.expr)))
