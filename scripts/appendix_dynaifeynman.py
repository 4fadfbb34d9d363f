#!/usr/bin/env python3
"""Tables 6 to 8: every formula that DynAIFeynman finds, with its losses, one table a system."""

from pathlib import Path

from rich import print

from dynsr.paper.results import APPENDIX
from dynsr.report.page import write_table
from experiment import read_options, run

options = read_options(__doc__)
tables = run(options, methods=["dynaifeynman"]).tables
for table in (table for table in tables if table.name.startswith(APPENDIX)):
    print(table.to_rich(), *write_table(table, Path(options.out) / "tables"), sep="\n")
