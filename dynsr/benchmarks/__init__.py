"""Suites of systems with known equations, and their runner."""
