"""Records of formulas that are given, for tests of what is made from records."""

from dataclasses import replace

from dynsr.data.system import find_system
from dynsr.expression.parsing import parse
from dynsr.paper.protocol import score_as_printed
from dynsr.paper.records import Record

# The first expressions of the paper's own appendix tables (GA), as records of ours.
PRINTED = {
    "lotka-volterra": ["x - 3", "x - 3", "x - 3*y", "y^cos(y + 1)", "x - 3*y"],
    "cart-pole": ["-12*w", "-2*w - z^2/y", "-2*w", "-4*w", "-2*w"],
}


def record(system, expression, run=1, method="ga", **fields):
    """Give a record of a formula, with its losses as they are scored."""
    found = find_system(system)
    score = score_as_printed(found, [parse(expression)], method)[0]
    return replace(
        Record(system, method, run, found.target, (0,), "done", "embedded", {}, "paper", {}),
        expression=expression,
        equation_rmse=score.equation_rmse,
        printed_loss=score.printed_loss,
        trajectory_loss=score.trajectory_loss,
        seconds=0.5 * run,
        **{"source": method, **fields},
    )
