"""Errors of measurement in a column next to what was measured: by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence

from dynsr.data.name_parts import MEAN, bare_name, bracketed_unit

_ERROR = (
    r"s\.?d\.?|se|sem|std(?:[ _.]?(?:dev|err|error))?|stdev|stderr|err(?:or)?|sigma|uncertainty|unc"
)
_ERROR_BEHIND = re.compile(rf"(?P<stem>.+?)[\s_.-]+(?:{_ERROR})", re.IGNORECASE)
_ERROR_BEFORE = re.compile(
    rf"(?:(?:{_ERROR})[\s_.-]+(?:of[\s_.-]+)?|±\s*|\+/?-\s*)(?P<stem>.+)", re.IGNORECASE
)
# As catalogues of stars call the errors of a column, next to it.
_E = re.compile(r"e_(?P<stem>.+)")
_ERROR_ALONE = re.compile(rf"(?:{_ERROR}|±|\+/?-)", re.IGNORECASE)
_MEAN = re.compile(rf"[\s_.-]*(?:{MEAN.pattern})[\s_.-]*", re.IGNORECASE)
_COUNT = re.compile(r"(?P<stem>.+?)[\s_.-]+n|n[\s_.-]+(?P<other>.+)", re.IGNORECASE)


def find_measured(name: str, others: Sequence[str]) -> str | None:
    """Give the column whose measurement errors a column is called; None where there is none.

    Parameters
    ----------
    name : that of the column, such as x_sd, "sd x", "x (SD)" or sd alone.
    others : the columns that it may belong to.

    >>> find_measured("glc_sd", ["bm_mean", "glc_mean"]), find_measured("err", ["x", "y"])
    ('glc_mean', None)
    >>> find_measured("e_Vmag", ["Vmag"]), find_measured("e_coli", ["salmonella"])
    ('Vmag', None)
    """
    own = _own_name(name)
    if _ERROR_ALONE.fullmatch(own):
        alone = [n for n in others if not is_error_name(n)]
        return alone[0] if len(alone) == 1 else None
    match = _ERROR_BEHIND.fullmatch(own) or _ERROR_BEFORE.fullmatch(own) or _E.fullmatch(own)
    if match is None:
        return None
    stem = _stem(match["stem"])
    return next((n for n in others if not is_error_name(n) and _stem(n) == stem), None)


def is_error_name(name: str) -> bool:
    """Whether a column is called the measurement errors of another.

    >>> is_error_name("glc_sd"), is_error_name("std dev"), is_error_name("used")
    (True, True, False)
    """
    own = _own_name(name)
    return any(p.fullmatch(own) for p in (_ERROR_ALONE, _ERROR_BEHIND, _ERROR_BEFORE))


def is_error_word(name: str) -> bool:
    """Whether a column is called errors, and not of what.

    >>> is_error_word("sd"), is_error_word("±"), is_error_word("glc_sd")
    (True, True, False)
    """
    return _ERROR_ALONE.fullmatch(name.strip()) is not None


def counts_values(name: str, measured: str) -> bool:
    """Whether a column says how many values each mean of a measured column is of.

    >>> counts_values("glc_n", "glc_mean"), counts_values("n", "glc_mean")
    (True, False)
    """
    found = _COUNT.fullmatch(bare_name(name))
    return found is not None and _stem(found["stem"] or found["other"]) == _stem(measured)


def _own_name(name: str) -> str:
    """Give a name without its unit; what brackets say of an error is no unit."""
    said = bracketed_unit(name)
    return f"{bare_name(name)} {said}" if _ERROR_ALONE.fullmatch(said) else bare_name(name)


def _stem(name: str) -> str:
    """Give the name of a quantity without a word for its mean."""
    own = bare_name(name)
    return (_MEAN.sub("", own) or own).strip(" _.-").lower()
