"""Parts of names of columns: units, as in "x [m/s]"; runs, as in "x run 2" and "x c0=0.5"."""

from __future__ import annotations

import re

from dynsr.data.amounts import is_unit

# A unit in brackets or after a blank bracket: "x [m/s]", "theta (rad)".
_UNIT = re.compile(r"\s*[\[(][\w\s/^*.°%µμ·²³-]*[\])]\s*$")
# The same behind a slash, as standards for physics write it: "x / m", "v / (m/s)".
_DIVIDED = re.compile(r"(?P<name>.*[^\s/])\s+/\s+(?P<unit>[^\s()]+|\([^()]+\))")
_WORD = (
    r"rep(?:lica(?:te)?|eat|l|et)?|run|trial|exp(?:eriment)?|batch|lauf|versuch|wdh|wiederholung|"
    r"replikat|data.?set|essai|r[ée]p(?:[ée]tition|licat)?|ensayo|r[ée]plica|series|culture|flask|well|plate"
)
BEHIND = re.compile(
    rf"(?P<stem>.*?)[\s_.-]*[\[(]?\s*(?<![^\W\d_])(?P<word>{_WORD})[\s_.#-]*(?P<which>\d+|(?<=[\s_.#-])[a-z])\s*[\])]?",
    re.IGNORECASE,
)
BEFORE = re.compile(
    rf"(?P<word>{_WORD})[\s_.#-]*(?P<which>\d+|(?<=[\s_.#-])[a-z])[\s_.:-]+(?P<stem>.+)",
    re.IGNORECASE,
)
# A condition of the run, such as "S (mM), S0 = 0.5".
GIVEN = re.compile(
    r"(?P<stem>.*?[^\s,;:_@-])[\s,;:_@-]*[\[(]?\s*(?<!\w)(?P<word>[^\W\d]\w*)\s*=\s*"
    r"(?P<which>[-+]?\d+(?:[.,]\d+)?)\s*(?:[^\W\d_][\w/^%]*)?\s*[\])]?",
    re.IGNORECASE,
)
# What says that values are means, which is no unit.
MEAN = re.compile(r"mean|avg|average|median|value|mittel\w*|mw", re.IGNORECASE)
# A concentration alone, such as "0.5 mM"; a length would be the depth of one of several states.
CONCENTRATION = re.compile(
    r"(?P<stem>)(?P<which>\d+(?:[.,]\d+)?)\s*(?P<word>[fpnuµμm]?M|(?:[nuµμm]|k)?g/[uµμm]?[lL])"
)
# A number or a letter alone, which may be anything else too.
NUMBERED = re.compile(r"(?P<stem>.*[^\W\d_])[\s_.-]*(?P<which>\d+)")
LETTERED = re.compile(r"(?P<stem>.+?)[\s_.-]+[\[(]?(?P<which>[a-l])[\])]?", re.IGNORECASE)
# A well of a plate, such as B07; so many columns of such names are a plate.
WELL = re.compile(r"(?P<stem>)(?P<which>[A-P](?:0?[1-9]|1\d|2[0-4]))")
FEWEST_WELLS = 6
# Those that say by themselves that a column is one of a run.
SAYING = (BEHIND, BEFORE, GIVEN, CONCENTRATION)
CONDITIONS = (GIVEN, CONCENTRATION)


_RUN = (
    r"traj(ectory)?|run|trial|episode|exp(eriment)?|series|rep(lica(te)?|eat|l)?|sample|group|"
    r"lauf|versuch|wiederholung|essai|r[ée]p[ée]tition|r[ée]plicat|ensayo|r[ée]plica"
)
_ENDING = r"([ _.-]?(id|n[ro]\.?|num(ber)?|name|code|#))?"
_NAMED = re.compile(rf"({_RUN}){_ENDING}|id", re.IGNORECASE)
# Names of what is watched, which as numbers may count it too.
_SUBJECT = re.compile(
    r"(id[ _.-])?(wells?|subjects?|mouse|mice|rat|animals?|patients?|plants?|specimen|individuals?|"
    r"participants?|person|cage|batch|colony|culture|device|tank|plot|station|unit|cell|fish|bird|flask|tube|vial|"
    r"dish|plate|bottle|pot|pond|chamber|block|site|donor|clone|line|strain|probe|kolben|platte|"
    rf"tier|maus|proband(en)?|patienten|pflanze|souris|sujet){_ENDING}|\w+[ _]id",
    re.IGNORECASE,
)


def _take_unit(name: str) -> tuple[str, str] | None:
    """Take a name and a unit that is known behind a slash apart."""
    found = _DIVIDED.fullmatch(name.strip())
    unit = found["unit"].strip("()") if found else ""
    return (found["name"], unit) if found and is_unit(unit) else None


def bare_name(name: str) -> str:
    """Give the name of a column without a unit in brackets, or behind a slash.

    >>> [bare_name(name) for name in ("theta (rad)", "v / (m/s)", "x / y")]
    ['theta', 'v', 'x / y']
    """
    if divided := _take_unit(name):
        return divided[0]
    return _UNIT.sub("", name).strip()


def bracketed_unit(name: str) -> str:
    """Give the unit in brackets, or behind a slash, of a column; "" where there is none.

    >>> [bracketed_unit(name) for name in ("v [m/s]", "x / m", "x / y")]
    ['m/s', 'm', '']
    """
    if divided := _take_unit(name):
        return divided[1]
    found = _UNIT.search(name)
    unit = "" if found is None else found[0].strip().strip("[]()").strip()
    return "" if MEAN.fullmatch(unit) else unit


def is_run_name(name: str) -> bool:
    """Whether a column of that name is one that distinguishes trajectories."""
    return _NAMED.fullmatch(bare_name(name)) is not None


def is_label_name(name: str) -> bool:
    """Whether a column of that name is one of trajectories, or of what is watched in each."""
    return is_run_name(name) or _SUBJECT.fullmatch(bare_name(name)) is not None
