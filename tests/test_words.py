import numpy as np
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.errors import InputError
from dynsr.expression.bits import complexity
from dynsr.expression.evaluation import evaluate
from dynsr.expression.parsing import parse
from dynsr.methods.grammar import PAD, Grammar, evaluate_words, to_postfix, to_sympy, word_bits

GRAMMAR = Grammar(("x", "y"), (1.0, -3.0, 0.5))
COLUMNS = np.random.default_rng(1).uniform(0.2, 2.0, (2, 40))


def words(*texts):
    """Postfix words of printed texts."""
    rows = np.array([GRAMMAR.encode(text, 120) for text in texts])
    return to_postfix(GRAMMAR.decode(rows)[0], GRAMMAR)


@given(st.integers(0, 2**31))
@settings(max_examples=30, deadline=None, database=None)
def test_words_mean_what_they_say_as_printed(seed):
    """Values of a whole population equal those of their printed text, read by Python's parser."""
    bits = np.random.default_rng(seed).integers(0, 2, (20, 60))
    infix, valid = GRAMMAR.decode(bits)
    infix = infix[valid]
    values = evaluate_words(to_postfix(infix, GRAMMAR), COLUMNS, GRAMMAR)
    for tokens, value in zip(infix, values, strict=True):
        text = GRAMMAR.text(tokens)
        if "exp(exp(" in text or text.count("^") > 2:
            continue  # numbers of this size are not compared
        try:
            expr = parse(text)
        except InputError:
            continue  # not a real number
        expected = evaluate(expr, {"x": COLUMNS[0], "y": COLUMNS[1]})
        both = np.isfinite(expected) & np.isfinite(value) & (np.abs(expected) < 1e100)
        np.testing.assert_allclose(value[both], expected[both], rtol=1e-8, atol=1e-8)


def test_precedence_and_associativity():
    """^ binds tightest and to the right; * and / before + and -, all to the left."""
    texts = ["x-y-1.0", "x/y/0.5", "x^y^0.5", "x+y*0.5", "x*y^0.5", "x-y*sin(x-y-1.0)^0.5"]
    values = evaluate_words(words(*texts), COLUMNS, GRAMMAR)
    x, y = COLUMNS
    with np.errstate(invalid="ignore"):
        last = x - y * np.sin(x - y - 1) ** 0.5
    expected = [x - y - 1, x / y / 0.5, x ** (y**0.5), x + y * 0.5, x * y**0.5, last]
    np.testing.assert_allclose(values, np.array(expected))


def test_a_large_population_is_evaluated_in_parts_alike():
    """The values of a population do not depend on how many words are evaluated together."""
    bits = np.random.default_rng(0).integers(0, 2, (3000, 60))
    infix, valid = GRAMMAR.decode(bits)
    postfix = to_postfix(infix[valid], GRAMMAR)
    columns = np.random.default_rng(2).normal(size=(2, 500))
    values = evaluate_words(postfix, columns, GRAMMAR)
    parts = [evaluate_words(postfix[i : i + 1], columns, GRAMMAR)[0] for i in range(0, 2000, 100)]
    np.testing.assert_array_equal(values[:2000:100], np.array(parts))


def test_a_domain_error_is_not_a_number():
    """log and a broken power of a negative number are NaN, without a warning."""
    values = evaluate_words(words("log((-3.0))", "(-3.0)^0.5"), COLUMNS, GRAMMAR)
    assert np.isnan(values).all()


def test_constants_are_folded_as_numbers():
    """A part without variables is a number, however it was written, and never overflows SymPy."""
    word = words("x+(-3.0)^1.0")[0]
    assert to_sympy(word, GRAMMAR) == sympy.Symbol("x") - 3.0
    tower = Grammar(("x",), (1000.0,))
    bits = tower.encode("x+exp(exp(exp(1000.0)))", 80)
    assert to_sympy(to_postfix(tower.decode(bits[None])[0], tower)[0], tower) is None


def test_written_length_is_the_complexity_where_nothing_simplifies():
    """For words that SymPy leaves as they are, bits equal dynsr.expression.complexity."""
    texts = ["x", "x+y", "sin(x)+y", "x*y+exp(x)", "x+0.5*y"]
    postfix = words(*texts)
    assert (postfix[0] != PAD).sum() == 1
    expected = [complexity(parse(text)) for text in texts]
    np.testing.assert_allclose(word_bits(postfix, GRAMMAR), expected)
