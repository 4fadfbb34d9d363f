"""How often the equations of the paper's three systems are found again under noise.

Every cell (system, level, draw of the noise) is kept in the folder of --out as it ends; the next
call goes on where this one was stopped. Writes noise.md, noise.csv, noise-formulas.csv, and the
picture as noise.png and noise.svg.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from dynsr.benchmarks.noise import (
    NOISE_LEVELS,
    NoiseRow,
    formula_table,
    noise_table,
    recovery_rates,
    run_noise,
)
from dynsr.data.system import PAPER_SYSTEMS, find_system
from dynsr.errors import DynsrError
from dynsr.jobs import Step
from dynsr.report.plots import draw_recovery, to_bytes


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("systems", nargs="*", default=[s.name for s in PAPER_SYSTEMS])
    parser.add_argument("--levels", default=",".join(f"{v:g}" for v in NOISE_LEVELS))
    parser.add_argument("--seeds", type=int, default=5, help="draws of the noise")
    parser.add_argument("--quick", action="store_true", help="one draw")
    parser.add_argument("--method", default="auto", help="auto, or methods by commas")
    parser.add_argument("--preset", default="best")
    parser.add_argument("--jobs", type=int, default=1, help="cells at a time")
    parser.add_argument("--out", type=Path, default=Path("results/noise"))
    return parser.parse_args()


def write_results(rows: Sequence[NoiseRow], out: Path) -> None:
    """Write the tables and the picture."""
    table = noise_table(rows)
    (out / "noise.md").write_text(table.to_markdown(), encoding="utf-8")
    (out / "noise.csv").write_text(table.to_csv(), encoding="utf-8")
    (out / "noise-formulas.csv").write_text(formula_table(rows).to_csv(), encoding="utf-8")
    figure = draw_recovery(*recovery_rates(rows))
    figure.axes[0].set_ylabel("share of exact equations")
    for kind in ("png", "svg"):
        (out / f"noise.{kind}").write_bytes(to_bytes(figure, kind))


def main() -> None:
    """Run, print and write."""
    options = read_options()
    console = Console(width=160)

    def say(step: Step) -> None:
        for r in (row.recovery for row in step.record.rows) if step.what else ():
            verdict = f"exact, off {r.constants_off:.1e}" if r.same_form else "OTHER FORM"
            place = f"{r.system} {100 * r.noise:g} % seed {r.seed} {r.state}'"
            console.print(f"{place}: {verdict}: {r.found}", highlight=False, soft_wrap=True)

    method = options.method.split(",") if "," in options.method else options.method
    try:
        rows = run_noise(
            [find_system(name) for name in options.systems],
            [float(level) for level in options.levels.split(",")],
            range(1 if options.quick else options.seeds),
            method=method,
            preset=options.preset,
            out=options.out,
            jobs=options.jobs,
            progress=say,
        )
    except DynsrError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    write_results(rows, options.out)
    console.print(noise_table(rows).to_rich())


if __name__ == "__main__":
    main()
