#!/usr/bin/env python3
"""Table 9: every formula that SINDy finds, with its losses, one table a system."""

from pathlib import Path

from rich import print

from dynsr.report.page import write_table
from experiment import read_options, run

options = read_options(__doc__)
for table in run(options, methods=["sindy"]).tables[1:]:
    print(table.to_rich(), *write_table(table, Path(options.out) / "tables"), sep="\n")
