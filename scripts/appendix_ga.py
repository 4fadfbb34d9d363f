#!/usr/bin/env python3
"""Tables 3 to 5: the formulas that the GA finds, with their losses, one table a system."""

from pathlib import Path

from rich import print

from dynsr.report.page import write_table
from experiment import read_options, run

options = read_options(__doc__)
for table in run(options, methods=["ga"]).tables[1:]:
    print(table.to_rich(), *write_table(table, Path(options.out) / "tables"), sep="\n")
