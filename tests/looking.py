"""Looking at exact slopes as a discovery does: among usual functions, then among rare ones."""

from dynsr.selection import look


def look_twice(samples, limits=None, **known):
    """Look among usual functions, and where that shows no law among rare ones."""
    seen = look(samples, limits, **known)
    if seen.final:
        return seen
    return look(samples, limits, earlier=[c.expr for c in seen.candidates], rare=True)
