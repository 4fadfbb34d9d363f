"""The enumeration's speed, its time to the right form on two systems, and its growth.

All figures are for one process; times are CPU seconds of that process with the wall clock beside
them, so that a busy machine shows. What peers do is measured by peers.py.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import sympy
from rich.console import Console
from rich.table import Table

from dynsr.data.samples import Samples, make_samples
from dynsr.data.system import LOTKA_VOLTERRA, PENDULUM, System
from dynsr.engines.simulation import training_trajectory
from dynsr.errors import DynsrError
from dynsr.fit.description import choose
from dynsr.methods.feynman.enumeration.backend import choose_backend
from dynsr.methods.feynman.enumeration.brute_force import (
    BruteForce,
    BruteForceResult,
    search_values,
)

SCHEME, TOLERANCE = "central4", 0.01
SYSTEMS = (LOTKA_VOLTERRA, PENDULUM)
SHALLOW = BruteForce(max_size=5, beam=0, patience=1, device="cpu")
console = Console(width=160, highlight=False)


def clock(work: Callable[[], object]) -> tuple[object, float, float]:
    """Give what ``work`` gives, CPU seconds and wall seconds."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return result, time.process_time() - cpu, time.perf_counter() - wall


def is_right(found: sympy.Expr, truth: sympy.Expr, loose: bool = False) -> bool:
    """Whether the terms are those of the truth and every coefficient is within 1 %.

    ``loose`` forgives further terms whose coefficients are below 1 % of the largest; it is given
    to the peers alone.
    """
    got, want = (sympy.expand(sympy.N(e)).as_coefficients_dict() for e in (found, truth))
    if loose:
        largest = max(abs(c) for c in got.values())
        got = {t: c for t, c in got.items() if t in want or abs(c) > TOLERANCE * largest}
    return set(got) == set(want) and all(
        abs(got[t] - c) <= TOLERANCE * abs(c) for t, c in want.items()
    )


def problems() -> list[tuple[System, str, Samples, sympy.Expr]]:
    """Give each system's targets with samples and true slope."""
    made = []
    for system in SYSTEMS:
        trajectory = training_trajectory(system)
        for target, truth in zip(system.states, system.rhs, strict=True):
            made.append((system, target, make_samples(trajectory, target, SCHEME), truth))
    return made


def show_speed(samples: Samples, settings: BruteForce) -> None:
    """Print candidates per second and core."""
    found, cpu, wall = clock(lambda: search_values(samples.X, samples.y, samples.names, settings))
    assert isinstance(found, BruteForceResult)
    console.print(
        f"one core, {settings.probes} probe rows, up to {settings.max_candidates:.0e} functions "
        f"(CPU {cpu:.2f} s, wall {wall:.2f} s, stopped by {found.stopped}):"
    )
    for label, count in (
        (f"strings covered (all up to {found.complete} letters)", found.covered),
        ("functions formed and evaluated", found.formed),
        ("distinct functions tested, up to affine maps", found.distinct),
    ):
        console.print(f"  {label:48} {count:12,d}  {count / cpu / 1e6:8.2f} M/s")


def show_times() -> None:
    """Print the time from samples to the chosen formula on both systems."""
    table = Table(
        "system", "target", "right", "CPU s", "wall s", "chosen", title="time to the right form"
    )
    for system, target, samples, truth in problems():

        def work(samples: Samples = samples) -> sympy.Expr:
            result = search_values(samples.X, samples.y, samples.names, SHALLOW)
            return choose(result.candidates, samples).expr

        found, cpu, wall = clock(work)
        right = is_right(found, truth)
        table.add_row(
            system.name, target, "yes" if right else "NO", f"{cpu:.2f}", f"{wall:.2f}", str(found)
        )
    console.print(table)


def show_devices(samples: Samples, settings: BruteForce) -> None:
    """Print the same search on every device there is: counts, formula and time against numpy's."""
    table = Table("device", "formed", "distinct", "best formula", "wall s", "times numpy's speed")
    usual = None
    for device in ("cpu", "torch-cpu", "cuda"):
        try:
            choose_backend(device)
        except DynsrError as error:
            console.print(f"{device}: skipped: {error}")
            continue
        chosen = replace(settings, device=device)
        found, _, wall = clock(
            lambda chosen=chosen: search_values(samples.X, samples.y, samples.names, chosen)
        )
        usual = usual or wall
        best = min(found.candidates, key=lambda c: c.loss)
        row = (found.device, f"{found.formed:,}", f"{found.distinct:,}", str(best.expr))
        table.add_row(*row, f"{wall:.2f}", f"{usual / wall:.2f}")
    console.print(table)


def show_growth(samples: Samples) -> None:
    """Print CPU seconds against rows, probe rows and size."""
    table = Table(
        "rows", "probe rows", "size", "formed", "distinct", "strings", "CPU s", title="growth"
    )
    bare = replace(SHALLOW, patience=0, max_candidates=1e7)
    for rows, probes, size in (
        *((n, 32, 5) for n in (250, 500, 997)),
        *((997, r, 5) for r in (16, 64, 128)),
        *((997, 32, s) for s in (4, 6, 7)),
    ):
        part = samples.select(np.linspace(0, len(samples) - 1, rows).astype(int))
        settings = replace(bare, probes=probes, max_size=size)
        found, cpu, _ = clock(
            lambda part=part, settings=settings: search_values(part.X, part.y, part.names, settings)
        )
        counts = (found.formed, found.distinct, found.covered)
        table.add_row(str(rows), str(probes), str(size), *(f"{c:,}" for c in counts), f"{cpu:.2f}")
    console.print(table)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", type=float, default=3e6)
    parser.add_argument("--probes", type=int, default=32, help="probe rows of the devices' table")
    options = parser.parse_args()
    samples = problems()[1][2]
    search_values(samples.X, samples.y, samples.names, BruteForce(max_size=2))
    bare = replace(SHALLOW, max_size=12, sums=(), patience=0, max_candidates=options.candidates)
    show_speed(samples, bare)
    show_times()
    show_growth(samples)
    show_devices(samples, replace(bare, probes=options.probes))


if __name__ == "__main__":
    main()
