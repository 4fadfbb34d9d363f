"""Terms of the user's own as further columns, for searches that know nothing but columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from dynsr.data import Samples
from dynsr.expression import evaluate
from dynsr.fit import Candidate, score_candidate


@dataclass(frozen=True, eq=False)
class ExtendedSamples:
    """Samples with one more column for every term that is finite on them.

    Parameters
    ----------
    original : the samples as they were.
    samples : the same with the columns of the terms behind their own.
    meanings : symbol of such a column -> its term.
    """

    original: Samples
    samples: Samples
    meanings: dict[sympy.Symbol, sympy.Expr]

    def bring_back(self, candidates: Iterable[Candidate]) -> list[Candidate]:
        """Give formulas in the samples' own columns, scored on them."""
        if not self.meanings:
            return list(candidates)
        return [
            score_candidate(c.expr.xreplace(self.meanings), self.original, c.source)
            for c in candidates
        ]


def extend_samples(samples: Samples, terms: Sequence[sympy.Expr]) -> ExtendedSamples:
    """Add the values of terms to samples as columns.

    Parameters
    ----------
    samples : (n, p) rows.
    terms : formulas in their columns.

    >>> x = np.linspace(1.0, 2.0, 5)
    >>> samples = Samples(x[:, None], x, ("x",), "x", "given", x)
    >>> extend_samples(samples, [sympy.log(sympy.Symbol("x"))]).samples.names
    ('x', 'term_1')
    """
    meanings, columns = {}, []
    number = 0
    for term in terms:
        values = evaluate(term, samples.columns)
        if not np.all(np.isfinite(values)) or term.is_Symbol:
            continue
        number += 1
        while f"term_{number}" in samples.names:
            number += 1
        meanings[sympy.Symbol(f"term_{number}")] = term
        columns.append(values)
    if not columns:
        return ExtendedSamples(samples, samples, {})
    names = (*samples.names, *map(str, meanings))
    wider = replace(samples, X=np.column_stack([samples.X, *columns]), names=names)
    return ExtendedSamples(samples, wider, meanings)
