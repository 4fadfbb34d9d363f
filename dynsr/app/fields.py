"""Fields: sentences that name options of the shell name the fields of the page instead."""

from __future__ import annotations

import re
from typing import Any

# Option -> what the page has in its place, where a role is chosen above a column.
_ROLES = {
    "time": "time",
    "states": "state",
    "inputs": "input",
    "trajectory": "names the run",
    "quantity": "names the quantity",
    "dose": "doses of a state",
    "doses": "doses of a state",
}
# Option -> a field below the name of a column.
_OF_COLUMN = {"limit": "limit", "noise": "error", "hold": "between rows"}
_OF_SEARCH = {
    "map": "each row follows from the row before",
    "explicit-time": "equations may contain the time",
    "order": "equations for accelerations",
    "conserved": "Sums that stay constant",
    "stochastic": "noise in the motion",
    "units": "units must agree with those of the columns",
    "vary": "Runs that differ",
    "delays": "Delay",
    "hidden": "Hidden state",
    "time-budget": "Time limit",
}
# An option, and what is given to it: no word that goes on with the sentence.
_OPTION = re.compile(
    r"(?<![\w-])--(?P<option>[a-z][a-z-]*)"
    r"(?:[ =](?!(?:says|takes|keeps|gives|if|with|in|or|and)\b)(?P<given>[^\s()]*[^\s().,;:]))?"
)
# What is no sentence.
_CODE = ("python", "svg", "mathml", "latex", "formula")


def in_fields(content: Any) -> Any:
    """Give what the page shows, with its own fields in the place of options of the shell.

    Parameters
    ----------
    content : a sentence, or mappings and lists of them.

    >>> in_fields("leave it out (--states x,y), or try --map.")
    "leave it out (the role 'state' for x,y), or try 'each row follows from the row before'."
    """
    if isinstance(content, str):
        return _OPTION.sub(_field, content)
    if isinstance(content, dict):
        return {k: own if k in _CODE else in_fields(own) for k, own in content.items()}
    return [in_fields(own) for own in content] if isinstance(content, list) else content


def _field(found: re.Match[str]) -> str:
    option, given = found["option"], found["given"] or ""
    state, _, value = given.partition("=")
    if option in _ROLES:
        role = f"the role {_ROLES[option]!r}"
        if given == "none":
            return f"another role than {_ROLES[option]!r}"
        column, _, volume = value.partition("/")
        if value:
            divided = ", divided by a volume," if volume else ""
            return f"{role} for {column},{divided} added to {state}".replace(",,", ",")
        return f"{role} for {given}" if given else role
    if option in _OF_COLUMN:
        return f"the field {_OF_COLUMN[option]!r}" + (f" of {state}" if given else "")
    if option in _OF_SEARCH and given != "1":
        return repr(_OF_SEARCH[option])
    return f"the option {found[0]} of the shell"
