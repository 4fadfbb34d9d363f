"""The genetic algorithm over bitstrings that the paper compares with (GA-Baseline, section 4)."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import sympy

from dynsr.arguments import checked
from dynsr.data import Samples
from dynsr.errors import InputError
from dynsr.expression import NAMED_FUNCTIONS
from dynsr.fit import ParetoFront, score_candidate
from dynsr.methods.base import AbstractMethod, Progress, Report, silent
from dynsr.methods.grammar import (
    DEFAULT_CONSTANTS,
    DEFAULT_FUNCTIONS,
    DEFAULT_OPERATORS,
    PAD,
    Grammar,
    evaluate_words,
    to_postfix,
    to_sympy,
    word_bits,
)
from dynsr.methods.limits import Limits
from dynsr.methods.own_terms import extend_samples
from dynsr.methods.parts import read_state, states, write_state


@checked
@dataclass(frozen=True)
class GeneticAlgorithm(AbstractMethod):
    """Evolve bitstrings that decode to words of a grammar.

    Each bit of the first population is 1 with probability 1/2. In every iteration the fitness of
    each word is its RMSE on the samples, the best half survives, and one mutant of each survivor,
    every bit flipped with probability ``mutation``, fills the rest. A string that is no word is
    drawn (or mutated) again until it is one. The front has everything seen.

    Parameters
    ----------
    bits : length of a bitstring.
    population, iterations : sizes; Table 2 of the paper.
    mutation : probability that a mutation flips a bit.
    constants, operators, functions : terminals and operations of the grammar.
    variables : names of the samples' columns that may occur; all of them when None.
    scaled : score each word f as a f + b with a, b fitted by least squares; the paper does not.
    terms : formulas in the samples' columns, in addition to the variables.

    >>> x = np.linspace(0.0, 6.0, 50)
    >>> samples = Samples(x[:, None], np.sin(x) + 2.0, ("x",), "x", "given", x)
    >>> GeneticAlgorithm().search(samples, np.random.default_rng(1)).best_fit.expr
    sin(x) + 2.0
    """

    bits: int = 60
    population: int = 100
    iterations: int = 100
    mutation: float = 0.1
    constants: tuple[float, ...] = DEFAULT_CONSTANTS
    operators: tuple[str, ...] = DEFAULT_OPERATORS
    functions: tuple[str, ...] = DEFAULT_FUNCTIONS
    variables: tuple[str, ...] | None = None
    scaled: bool = False
    terms: tuple[sympy.Expr, ...] = ()

    name = "genetic"
    # The class's own sizes are those of the cart-pole, the paper's largest.
    presets: ClassVar = {
        "best": {
            "bits": 120,
            "population": 1000,
            "iterations": 200,
            "mutation": 0.05,
            "scaled": True,
        },
        "quick": {"iterations": 10},
        "paper": {},
    }

    def __post_init__(self) -> None:
        """Check the numbers; raises InputError."""
        for key, least in (("bits", 1), ("population", 2), ("iterations", 0)):
            value = getattr(self, key)
            if int(value) != value or value < least:
                raise InputError(
                    f"{key} {value!r} of the GA must be a whole number from {least} up"
                )
        if not 0 < self.mutation < 1:
            raise InputError(f"mutation rate {self.mutation} of the GA must lie between 0 and 1")

    def grammar(self, names: Sequence[str]) -> Grammar:
        """Give the grammar over the columns of some samples.

        Parameters
        ----------
        names : the columns.

        Raises InputError when ``variables`` has one that is not there.
        """
        chosen = tuple(names) if self.variables is None else self.variables
        unknown = [name for name in chosen if name not in names]
        if unknown:
            raise InputError(
                f"the samples have no column {unknown[0]!r}; their columns are: {', '.join(names)}"
            )
        return Grammar(chosen, self.constants, self.operators, self.functions)

    def within(self, limits: Limits) -> GeneticAlgorithm:
        """Give the search with a grammar of what is allowed; see AbstractMethod."""
        vocabulary, changed = limits.vocabulary, replace(self, terms=limits.terms)
        if vocabulary is None:
            return changed
        return replace(
            changed,
            operators=tuple(o for o in self.operators if vocabulary.has(o)),
            functions=limits.tokens(self.functions, NAMED_FUNCTIONS),
        )

    def search(
        self, samples: Samples, rng: np.random.Generator, report: Report = silent
    ) -> ParetoFront:
        """Evolve; see AbstractMethod. Duplicate words are evaluated once in the whole search."""
        wider = extend_samples(samples, self.terms)
        grammar = self.grammar(samples.names)
        names = (*grammar.variables, *map(str, wider.meanings))
        seen = _Seen(replace(grammar, variables=names), wider.samples, self.scaled)
        with contextlib.suppress(KeyboardInterrupt):
            self._evolve(seen, rng, report)
        return ParetoFront(wider.bring_back(seen.front())) if wider.meanings else seen.front()

    def _evolve(self, seen: _Seen, rng: np.random.Generator, report: Report) -> None:
        last, keep = states("generations", _Generation)
        if last is None:
            done, parents = 0, np.zeros((self.population, self.bits), dtype=bool)
            population, words = self._valid(seen.grammar, parents, 0.5, rng)
            loss = seen.losses(words)
        else:
            done, population, loss = last.bring_back(seen, rng)
        survivors = (self.population + 1) // 2
        for iteration in range(done, self.iterations):
            best = np.argsort(loss, kind="stable")[:survivors]
            parents = population[best][: self.population - survivors]
            mutants, new = self._valid(seen.grammar, parents, self.mutation, rng)
            population = np.concatenate([population[best], mutants])
            loss = np.concatenate([loss[best], seen.losses(new)])
            if report is not silent:
                report(Progress("generations", iteration + 1, self.iterations, seen.front()))
            keep(partial(_Generation.of, iteration + 1, population, loss, seen, rng))

    def _valid(
        self, grammar: Grammar, parents: np.ndarray, rate: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Flip bits of each parent with probability ``rate``, again until the child is a word."""
        width = self.bits // max(grammar.symbol_bits, 1) + 1
        children, words = parents.copy(), np.full((len(parents), width), PAD)
        rows = np.arange(len(parents))
        if self.bits < grammar.symbol_bits:
            raise InputError(
                f"{self.bits} bits are too few for a symbol; this grammar needs "
                f"{grammar.symbol_bits} each"
            )
        while rows.size:
            drawn = parents[rows] ^ (rng.random((rows.size, self.bits)) < rate)
            infix, valid = grammar.decode(drawn)
            postfix = to_postfix(infix[valid], grammar)[:, :width]
            words[rows[valid], : postfix.shape[1]] = postfix
            children[rows[valid]] = drawn[valid]
            rows = rows[~valid]
        return children, words


@dataclass(frozen=True)
class _Generation:
    """One generation as it is kept: its words in bits, and the best words of all so far."""

    done: int
    population: tuple[str, ...]
    loss: tuple[float, ...]
    words: tuple[tuple[int, ...], ...]
    word_bits: tuple[float, ...]
    word_loss: tuple[float, ...]
    state: str

    @classmethod
    def of(
        cls,
        done: int,
        population: np.ndarray,
        loss: np.ndarray,
        seen: _Seen,
        rng: np.random.Generator,
    ) -> _Generation:
        return cls(
            done,
            tuple("".join(map(str, row)) for row in population.astype(int).tolist()),
            tuple(loss.tolist()),
            tuple(map(tuple, seen.words.tolist())),
            tuple(map(float, seen.bits.tolist())),
            tuple(seen.loss.tolist()),
            write_state(rng),
        )

    def bring_back(
        self, seen: _Seen, rng: np.random.Generator
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """Give how many are done, population and losses; bring all else to where it was."""
        if self.words:
            seen.words = np.array(self.words, dtype=np.int64)
            seen.bits, seen.loss = np.array(self.word_bits), np.array(self.word_loss)
        read_state(rng, self.state)
        rows = [[digit == "1" for digit in row] for row in self.population]
        return self.done, np.array(rows, dtype=bool), np.array(self.loss)


class _Seen:
    """Every distinct word seen, with its loss; and the front of them."""

    def __init__(self, grammar: Grammar, samples: Samples, scaled: bool) -> None:
        self.grammar, self.samples, self.scaled = grammar, samples, scaled
        columns = [samples.names.index(name) for name in grammar.variables]
        self.columns = np.ascontiguousarray(samples.X[:, columns].T)
        self.known: dict[bytes, float] = {}
        self.words = np.empty((0, 0), dtype=np.int64)
        self.bits = self.loss = np.empty(0)
        self.made: tuple[bytes, ParetoFront] = (b"", ParetoFront())

    def losses(self, words: np.ndarray) -> np.ndarray:
        """RMSE of each word (N, T) on the samples; only words not seen before are evaluated."""
        keys = [word.tobytes() for word in words]
        new = {key: row for row, key in reversed(list(enumerate(keys))) if key not in self.known}
        if new:
            fresh = words[sorted(new.values())]
            loss = self._evaluate(fresh)
            self.known.update(zip((w.tobytes() for w in fresh), loss.tolist(), strict=True))
            self._keep(fresh, loss)
        return np.array([self.known[key] for key in keys])

    def _evaluate(self, words: np.ndarray) -> np.ndarray:
        values, y = evaluate_words(words, self.columns, self.grammar), self.samples.y
        with np.errstate(all="ignore"):
            if self.scaled:
                slope, offset = _line(values, y)
                values = slope[:, None] * values + offset[:, None]
            loss = np.sqrt(np.mean((values - y) ** 2, axis=1))
        return np.where(np.isfinite(loss), loss, np.inf)

    def _keep(self, words: np.ndarray, loss: np.ndarray) -> None:
        """Keep what no other word beats in both loss and length as it is written."""
        finite = np.isfinite(loss)
        if not finite.any():
            return
        words, loss = words[finite], loss[finite]
        bits = word_bits(words, self.grammar)
        if len(self.words):
            words = np.concatenate([self.words, words])
            loss, bits = np.concatenate([self.loss, loss]), np.concatenate([self.bits, bits])
        order = np.lexsort((loss, bits))
        lowest = np.minimum.accumulate(loss[order])
        better = np.append(True, loss[order][1:] < lowest[:-1])
        kept = order[better]
        self.words, self.loss, self.bits = words[kept], loss[kept], bits[kept]

    def front(self) -> ParetoFront:
        """Give the front as SymPy candidates; made again only when it has changed."""
        key = self.words.tobytes()
        if key != self.made[0]:
            found = [e for e in map(self._expression, self.words) if e is not None]
            front = ParetoFront(
                score_candidate(e, self.samples, GeneticAlgorithm.name) for e in found
            )
            self.made = (key, front)
        return self.made[1]

    def _expression(self, word: np.ndarray) -> sympy.Expr | None:
        expr = to_sympy(word, self.grammar)
        if expr is None or not self.scaled:
            return expr
        values = evaluate_words(word[None], self.columns, self.grammar)
        slope, offset = _line(values, self.samples.y)
        return sympy.Float(slope[0]) * expr + sympy.Float(offset[0])


def _line(values: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and offsets a, b (N,) of the least-squares lines y = a f + b, a = 0 for constant f."""
    mean = values.mean(axis=1)
    centred = values - mean[:, None]
    spread = np.einsum("ij,ij->i", centred, centred)
    flat = spread <= 1e-24 * (1 + mean**2) * len(y)
    slope = np.where(flat, 0.0, centred @ (y - y.mean()) / np.where(flat, 1.0, spread))
    return slope, y.mean() - slope * mean
