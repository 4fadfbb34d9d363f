import numpy as np
import pytest

from dynsr.expression.operators import OPERATORS
from dynsr.methods.feynman.enumeration.alphabet import make_letters
from dynsr.methods.feynman.enumeration.brute_force import BruteForce, search_values

OPERATORS_TRIED = (
    ("+", "-", "*", "/", "square", "sqrt", "inv", "sin", "exp", "log"),
    ("+", "*", "inv", "sqrt"),
    ("-", "/", "square", "abs", "cos"),
)


def every_string(X: np.ndarray, operators: tuple[str, ...], length: int) -> list[np.ndarray]:
    """Values of every string of up to ``length`` letters over the variables and 1, one by one."""
    letters, _ = make_letters(operators, False)
    levels = [[], [(column, 0) for column in (*X.T, np.ones(len(X)))]]
    for size in range(2, length + 1):
        level = []
        for letter in letters:
            apply = OPERATORS[letter.token].numpy
            if letter.arity == 1:
                level += [
                    (apply(letter.sign * a), used | letter.family)
                    for a, used in levels[size - 1]
                    if not used & letter.family
                ]
            else:
                level += [
                    (apply(a, b), used | other)
                    for left in range(1, size - 1)
                    for a, used in levels[left]
                    for b, other in levels[size - 1 - left]
                ]
        levels.append(level)
    return [values for level in levels for values, _ in level]


def classes(functions: list[np.ndarray]) -> set[tuple[float, ...]]:
    """The functions that are finite and not constant, each class of affine maps once."""
    values = np.array(functions)
    size = np.sqrt(np.square(values).mean(axis=1))
    values = values[np.isfinite(values).all(axis=1) & (size > 1e-9) & (size < 1e9)]
    spread = values - values.mean(axis=1, keepdims=True)
    norm = np.linalg.norm(spread, axis=1)
    keep = norm > 1e-3 * np.linalg.norm(values, axis=1)
    shapes = spread[keep] / norm[keep, None]
    shapes *= np.sign(shapes[:, :1])
    return {tuple(row) for row in np.round(shapes[:, :6], 5) + 0.0}


@pytest.mark.parametrize("operators", OPERATORS_TRIED)
def test_what_algebra_leaves_out_is_not_missing(operators):
    """As many functions are tested as there are among all strings, formed naively."""
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(0.5, 2.0, 32), rng.uniform(0.3, 1.0, 32)])
    X[::3, 1] *= -1
    settings = BruteForce(
        operators=operators, changes=(), monomials=False, max_size=4, sums=(), beam=0, device="cpu"
    )
    result = search_values(X, np.cos(7 * X[:, 0]) + X[:, 1], ("x", "y"), settings)
    with np.errstate(all="ignore"):
        expected = classes(every_string(X, operators, 4))
    assert result.complete == 4
    assert result.distinct == len(expected)
