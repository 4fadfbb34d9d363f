"""Names: what a column is called in the source, in formulas, and by the caller."""

from __future__ import annotations

import re
import unicodedata
import warnings
from collections.abc import Mapping, Sequence

from dynsr.data.columns import Columns
from dynsr.data.name_parts import bare_name
from dynsr.errors import DynsrWarning, InputError, quoted
from dynsr.expression import check_name

# How a warning of new names begins.
RENAMED = "columns were renamed so that formulas can use them"


def list_names(names: Sequence[str]) -> str:
    """List names for a message, the first of many.

    >>> list_names(["t", "x"])
    't, x'
    """
    listed = ", ".join(names[:12])
    return listed if len(names) <= 12 else f"{listed}, ... ({len(names)} in all)"


def find_column(name: str, columns: Columns, role: str) -> str:
    """Find a column by its name in the source, without its unit too, or by its name in formulas.

    Parameters
    ----------
    name : the name.
    columns : the columns of the source.
    role : what a message says it is for.

    Raises InputError that lists the columns where there is none.
    """
    if name in columns.twice:
        raise InputError(
            f"column name {name!r} for the {role} is used twice in {columns.label}; rename one"
        )
    if name in columns.names:
        return name
    if name in columns.left_out:
        raise InputError(
            f"column {name!r} of {columns.label} was left out since it {columns.left_out[name]}; "
            f"it cannot be the {role}"
        )
    # A name that looks the same may be written otherwise, as the micro sign is.
    alike = unicodedata.normalize("NFKC", name)
    for original in columns.names:
        if clean_name(original) == name or unicodedata.normalize("NFKC", original) == alike:
            return original
    if len(bare := [own for own in columns.names if bare_name(own) == name]) == 1:
        return bare[0]
    raise InputError(
        f"no column {name!r} for the {role} in {columns.label}; "
        f"its columns are: {list_names(columns.names)}"
    )


def clean_name(name: str) -> str:
    """Give the name that a column has in formulas: its own where formulas can use it.

    Units in brackets go, other signs become underscores, and names of functions get a number.

    >>> [clean_name(name) for name in ("theta (rad)", "x-1", "sin", "2nd", "inf_")]
    ['theta', 'x_1', 'sin_1', 'x2nd', 'inf_']
    """
    text = unicodedata.normalize("NFKC", bare_name(name) or name)
    if not text.isidentifier():
        text = re.sub(r"_{2,}", "_", re.sub(r"\W", "_", text)).strip("_") or "x"
    if not text.isidentifier():
        text = f"x{text}"
    try:
        return check_name(text)
    except InputError:
        return f"{text}_1"


def rename(names: Sequence[str], formulas: Mapping[str, str]) -> dict[str, str]:
    """Give each column its name in formulas, with a warning where more than its unit is gone.

    Parameters
    ----------
    names : those of the source.
    formulas : inputs that are expressions, whose names are taken.
    """
    renamed: dict[str, str] = {}
    taken = {"t", *formulas}
    own = {name for name in names if clean_name(name) == name} - taken
    for name in names:
        new, number = clean_name(name), 1
        while new in taken or (new in own and new != name):
            number += 1
            new = f"{clean_name(name)}_{number}"
        taken.add(new)
        renamed[name] = new
    changed = {name: new for name, new in renamed.items() if bare_name(name) != new}
    if changed:
        shown = ", ".join(f"{quoted(name)} -> {new}" for name, new in changed.items())
        warnings.warn(
            f"{RENAMED}: {shown}",
            DynsrWarning,
            stacklevel=4,
        )
    return renamed
