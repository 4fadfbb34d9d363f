"""Reading the data that a command is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dynsr.commands import options, output
from dynsr.commands.known import read_equations

if TYPE_CHECKING:
    from dynsr.trajectory import Trajectory


def load_table(
    files: Sequence[Path],
    time_column: str | None,
    states: options.Names,
    inputs: options.Names,
    trajectory: str | None,
    say: Callable[[str], None] = output.note,
) -> list[Trajectory]:
    """Read the trajectories of files and say how their columns were understood."""
    from dynsr.tabular import read_trajectories

    table = read_trajectories(
        list(files) if len(files) > 1 else files[0],
        time_column,
        options.read_names(states),
        inputs,
        trajectory,
    )
    say(table.guess)
    return table.trajectories


def split_inputs(inputs: options.Names) -> tuple[options.Names, dict[str, str]]:
    """Tell columns, split at commas, from ``name=formula``; None where no column is named."""
    if inputs is None:
        return None, {}
    formulas = read_equations([text for text in inputs if "=" in text])
    return options.read_names([text for text in inputs if "=" not in text]), formulas
