"""The Julia engine: OrdinaryDiffEqTsit5 and DataDrivenSparse in a process of their own."""
