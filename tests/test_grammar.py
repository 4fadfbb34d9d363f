import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynsr.data.system import find_system
from dynsr.errors import InputError
from dynsr.methods.grammar import CLOSE, PAD, Grammar
from dynsr.paper.protocol import paper_method

FULL = Grammar(("x", "y"), (1.0, -3.0, 0.5))

# The longest words of the paper's appendix B.1 to B.3, per system.
PRINTED = {
    "lotka-volterra": (
        "identity(x+(-3.0)^1.0)",
        "x+(-3.0)^1.0",
        "x+y*(-3.0)",
        "y^cos(y+1.0)",
        "x+(-3.0)*y",
    ),
    "pendulum": (
        "identity(theta2*(-9.81)+(-0.1))",
        "(-1.0)+theta2*(-9.81)",
        "identity(theta2+theta2*(-9.81))",
    ),
    "cart-pole": (
        "(-1.0)*6.0*w/0.5",
        "(-1.0)*w/0.5+z/y*z/(-1.0)",
        "(-1.0)*2.0*w",
        "(-1.0)*w/0.5^identity(2.0)",
        "2.0*(-1.0)*w",
    ),
}
NAMES = {
    "lotka-volterra": ("x", "y"),
    "pendulum": ("theta1", "theta2"),
    "cart-pole": ("w", "x", "y", "z", "F"),
}


@pytest.mark.parametrize("system", PRINTED)
def test_every_printed_word_is_reachable_in_the_printed_length(system):
    """Each word of the paper's GA tables has a bitstring of Table 2's length that decodes to it."""
    method = paper_method("ga", find_system(system))
    grammar = method.grammar(NAMES[system])
    assert method.bits == {"lotka-volterra": 20, "pendulum": 20, "cart-pole": 60}[system]
    for text in PRINTED[system]:
        infix, valid = grammar.decode(grammar.encode(text, method.bits)[None])
        assert valid.tolist() == [True]
        assert grammar.text(infix[0]) == text


def test_the_lotka_volterra_equation_itself_is_a_word_of_twenty_bits():
    """The true right-hand side is in the space that the paper searched: 20 bits suffice exactly."""
    grammar = paper_method("ga", find_system("lotka-volterra")).grammar(("x", "y"))
    grammar.encode("y*identity(x+(-3.0))", 20)
    with pytest.raises(InputError, match="needs 20 bits, more than the length 19"):
        grammar.encode("y*identity(x+(-3.0))", 19)


def scalar_decode(bits, grammar):
    """Decode one string by plain recursion: the grammar's text, read as a program."""
    position = 0

    def read(width, count):
        nonlocal position
        if position + width > len(bits):
            raise EOFError
        value = int("".join(map(str, bits[position : position + width])) or "0", 2)
        position += width
        return value % count

    def expr():
        code = read(grammar.symbol_bits, grammar.alternatives)
        if code < grammar.leaves:
            return grammar.symbols[code]
        if code < grammar.first_function:
            left = expr()
            return left + grammar.symbols[code] + expr()
        code += read(grammar.function_bits, len(grammar.functions))
        return f"{grammar.symbols[code]}({expr()})"

    try:
        return expr()
    except EOFError:
        return None


@pytest.mark.slow
@given(st.lists(st.integers(0, 1), min_size=40, max_size=40))
@settings(max_examples=200, deadline=None, database=None)
def test_decoding_a_population_equals_recursive_descent(bits):
    """The vectorised derivation gives, for any string, what a recursive reading of it gives."""
    rows = np.array([bits, bits[::-1]])
    infix, valid = FULL.decode(rows)
    for row, tokens, ok in zip(rows, infix, valid, strict=True):
        expected = scalar_decode(row.tolist(), FULL)
        assert ok == (expected is not None)
        if expected is not None:
            assert FULL.text(tokens) == expected


@pytest.mark.slow
@given(st.lists(st.integers(0, 1), min_size=60, max_size=60))
@settings(max_examples=100, deadline=None, database=None)
def test_encoding_a_word_and_decoding_it_gives_the_word(bits):
    """decode(encode(word)) is the word, for every word that a string of 60 bits can decode to."""
    infix, valid = FULL.decode(np.array([bits]))
    if valid[0]:
        text = FULL.text(infix[0])
        again, ok = FULL.decode(FULL.encode(text, 60)[None])
        assert ok[0] and FULL.text(again[0]) == text


def test_a_string_that_ends_before_its_word_is_invalid():
    """An operator that lacks an operand at the end of the bits makes no word."""
    plus = FULL.leaves
    bits = np.array([int(b) for b in f"{plus:0{FULL.symbol_bits}b}"] * 3)
    infix, valid = FULL.decode(bits[None])
    assert not valid[0] and set(infix[0].tolist()) == {PAD}


def test_a_function_closes_its_brackets():
    """A function's argument is ended by CLOSE in the infix form."""
    infix, _ = FULL.decode(FULL.encode("sin(x)+y", 40)[None])
    assert CLOSE in infix[0].tolist() and FULL.text(infix[0]) == "sin(x)+y"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x+q", "'q' is no symbol"),
        ("x+", "no symbol"),
        ("sin x", "needs brackets"),
        ("sin(x", "not closed"),
        ("x y", "no word of the grammar at 'y'"),
        ("x&y", "cannot read"),
    ],
)
def test_what_is_no_word_is_refused(text, message):
    """encode names what it cannot read in one line."""
    with pytest.raises(InputError, match=message):
        FULL.encode(text, 60)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((), ()), "no variable and no constant"),
        ((("x",), (1.0,), ("%",)), "unknown operator '%'"),
        ((("x",), (1.0,), ("+",), ("sine",)), "unknown function 'sine'"),
        ((("x",), (float("nan"),)), "must be a finite number"),
    ],
)
def test_a_grammar_that_cannot_be_is_refused(arguments, message):
    """Symbols that mean nothing raise InputError."""
    with pytest.raises(InputError, match=message):
        Grammar(*arguments)
