"""Tsit5 as OrdinaryDiffEq.jl takes it, for one system and for many at once."""
