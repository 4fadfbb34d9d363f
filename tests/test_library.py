"""The library: one table of functions, and the terms that are made of it."""

import numpy as np
import pytest
import sympy

from dynsr.expression import evaluate
from dynsr.library import Form, FormValues, Library, LibrarySettings, read_body
from dynsr.library.atoms import ATOMS
from dynsr.library.forms import Factor


def _columns(rng: np.random.Generator) -> np.ndarray:
    return np.sort(rng.uniform(0.1, 0.9, (3, 40)), axis=0)[::-1]


@pytest.mark.parametrize("name", sorted(ATOMS))
def test_values_of_an_atom_are_those_of_its_formula(name: str) -> None:
    """What an atom gives of columns is what SymPy gives of the formula that it writes."""
    atom, points = ATOMS[name], _columns(np.random.default_rng(1))
    form = Form((), (Factor(atom, (0, 1, 2)[: atom.columns]),))
    constants = np.full((1, form.constants), 0.7)
    library = Library(("x", "y", "z"), (form,), (constants,))
    values, _ = FormValues(library, points).begun
    expr = form.write(["x", "y", "z"], constants[0])
    np.testing.assert_allclose(values[0], evaluate(expr, dict(zip("xyz", points, strict=True))))


@pytest.mark.parametrize("name", sorted(n for n, a in ATOMS.items() if a.inside))
def test_the_slope_of_an_atom_is_that_of_a_small_step(name: str) -> None:
    """Slopes by the constants inside are those of differences along the way that they are moved."""
    atom, points = ATOMS[name], _columns(np.random.default_rng(2))
    form = Form(((1, 1),), (Factor(atom, (0, 1, 2)[: atom.columns]),))
    names, begun = ["x", "y", "z"], atom.begin(points[: atom.columns], np.array([0.7, 0.9]))
    library = Library(tuple(names), (form,), (np.concatenate([begun / 2, 2 * begun]),))
    here = begun[0]
    own, first = FormValues(library, points), np.zeros(1, dtype=int)
    values, slopes = own.of(first, here[None])
    assert np.all(np.isfinite(values))
    for step, slope in zip(1e-6 * np.eye(len(here)), slopes[0], strict=True):
        up, down = (library.moved(np.array(0), here, way * step) for way in (1, -1))
        ends = [own.of(first, end[None])[0] for end in (up, down)]
        np.testing.assert_allclose((ends[0] - ends[1])[0] / 2e-6, slope, rtol=1e-4, atol=1e-8)


@pytest.mark.slow
def test_forms_of_the_same_atoms_are_evaluated_as_they_are_written() -> None:
    """Each form of a whole library, with every one of its starts, has the values that SymPy has."""
    names, points = ["x", "y", "z"], _columns(np.random.default_rng(5))
    own = [sympy.Symbol("x") * sympy.cos(sympy.Symbol("t"))]
    points = np.vstack([points, np.linspace(0, 1, 40)])
    library = Library.of(names, points, ["x"], own, beside=["t"])
    values, slopes = FormValues(library, points).begun
    columns = dict(zip((*names, "t"), points, strict=True))
    for row, place, constants in zip(values, library.owners, library.constants, strict=True):
        expr = library.forms[place].write((*names, "t"), constants)
        np.testing.assert_allclose(row, evaluate(expr, columns), rtol=1e-9)
    inside = library.inside[library.owners]
    assert slopes.shape == (len(library.owners), library.most, 40)
    assert not np.any(slopes[inside == 1, 1:])


def test_a_library_holds_no_more_rows_than_it_may() -> None:
    """Of many columns the forms with the fewest factors are kept."""
    points = np.random.default_rng(3).uniform(0.4, 2.5, (6, 30))
    names = [f"x{i}" for i in range(6)]
    library = Library.of(names, points, settings=LibrarySettings(most=500))
    assert len(library.owners) <= 500
    assert sympy.Symbol("x5") in [
        f.write(names, s[0]) for f, s in zip(library.forms, library.starts, strict=True)
    ]


def test_a_column_of_both_signs_has_no_logarithm() -> None:
    """Atoms stand only of columns in their domain."""
    x = np.linspace(-1.0, 1.0, 30)[None]
    forms = Library.of(["x"], x).forms
    names = {f.atom.name for form in forms for f in form.factors}
    assert "size" in names
    assert not names & {"logarithm", "root", "power", "saturates1", "inverse"}


@pytest.mark.parametrize("names", [["x", "y", "z"], ["z", "x10", "x2"], ["b", "t", "a"]])
@pytest.mark.parametrize("rare", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_form_is_read_as_what_it_writes(names: list[str], rare: bool, sign: float) -> None:
    """Whatever its columns are called, what a form is made of is what is read in its formula."""
    points = _columns(np.random.default_rng(4)) * [[1.0], [sign], [1.0]]
    library = Library.of(names, points, names, settings=LibrarySettings(rare=rare))
    for form, starts in zip(library.forms, library.starts, strict=True):
        assert form.read(names) == read_body(form.write(names, starts[0])), form
