#!/usr/bin/env python3
"""Table 2: the settings of the genetic algorithm, read from the code that uses them."""

from pathlib import Path

from rich import print

from dynsr.paper.results import table_2
from dynsr.report.page import write_table
from experiment import read_options

options = read_options(__doc__)
print(table_2().to_rich(), *write_table(table_2(), Path(options.out) / "tables"), sep="\n")
