#!/usr/bin/env python3
"""Figure 1: true and inferred trajectories of Lotka-Volterra and the cart-pole."""

from pathlib import Path

from dynsr.paper.results import FIGURE_1, figure_1
from dynsr.report.plots import to_bytes
from experiment import read_options, run

options = read_options(__doc__)
figure = figure_1(run(options, systems=FIGURE_1).records)
for kind in ("png", "pdf"):
    path = Path(options.out) / f"figure1.{kind}"
    path.write_bytes(to_bytes(figure, kind, dpi=200))
    print(path)
