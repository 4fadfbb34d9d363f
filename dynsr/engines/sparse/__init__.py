"""Sparse regression as DataDrivenDiffEq.jl did it in 2021 and does it today."""
