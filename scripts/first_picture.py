#!/usr/bin/env python3
"""Draw docs/img/first.png, the picture of the README: noisy data, equations, trajectory."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import sympy

import dynsr

mpl.use("Agg")
import matplotlib.pyplot as plt

TARGET = Path(__file__).parents[1] / "docs" / "img" / "first.png"
NOISE, INK = 0.01, "#3f51b5"

system = dynsr.find_system("lorenz")
times = np.arange(0, 10, 0.01)
clean = dynsr.simulate(system, t=times)
noise = NOISE * clean.x.std(axis=0) * np.random.default_rng(0).normal(size=clean.x.shape)
data = dynsr.Trajectory(clean.t, clean.x + noise, clean.states)
found = dynsr.discover(data, seed=0)
curve = found.simulate(clean.x[0], times)

figure, (left, middle, right) = plt.subplots(
    1, 3, figsize=(9, 2.8), layout="constrained", width_ratios=(1, 1.1, 1)
)
left.plot(data.x[:, 0], data.x[:, 2], ".", color="#d55e00", markersize=2)
left.set_title("measured rows, 1 % noise", fontsize=11)
right.plot(curve.x[:, 0], curve.x[:, 2], color=INK, linewidth=0.8)
right.set_title("the equations, integrated", fontsize=11)
for axes in (left, right):
    axes.set_xlabel("x")
    axes.set_ylabel("z")
    axes.spines[["top", "right"]].set_visible(False)
middle.set_axis_off()
middle.set_title(f"equations: {found.verdict.level}", fontsize=11)
for place, (state, equation) in enumerate(found.equations.items()):
    text = rf"$\dot{{{state}}} = {sympy.latex(sympy.nsimplify(equation, rational=True))}$"
    middle.text(0.5, 0.75 - 0.27 * place, text, ha="center", va="center", fontsize=14)
figure.savefig(TARGET, dpi=110, metadata={"Software": None})
