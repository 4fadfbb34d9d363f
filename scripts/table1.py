#!/usr/bin/env python3
"""Table 1: losses of the three methods on the three systems, next to the paper's."""

from pathlib import Path

from rich import print

from dynsr.report.page import write_table
from experiment import read_options, run

options = read_options(__doc__)
table = run(options).tables[0]
print(table.to_rich(), *write_table(table, Path(options.out) / "tables"), sep="\n")
