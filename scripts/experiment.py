"""What the scripts of single tables and figures share: their options, and the cells they need."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from dynsr.cli.progress import SearchProgress
from dynsr.errors import DynsrError
from dynsr.methods.registry import PAPER_METHODS
from dynsr.paper.replication import PAPER_NAMES, Replication, replicate


def read_options(description: str | None) -> Namespace:
    """Read --out and --quick from the command line."""
    parser = ArgumentParser(description=description)
    parser.add_argument("--out", help="folder of the results (results, or results-quick)")
    parser.add_argument("--quick", action="store_true", help="small searches, two runs each")
    options = parser.parse_args()
    options.out = options.out or ("results-quick" if options.quick else "results")
    return options


def run(
    options: Namespace,
    methods: Sequence[str] = PAPER_METHODS,
    systems: Sequence[str] = PAPER_NAMES,
) -> Replication:
    """Compute the cells of some methods that the folder does not hold yet, and give all of them."""
    try:
        with SearchProgress() as progress:
            return replicate(
                systems,
                methods,
                out=options.out,
                quick=options.quick,
                progress=progress,
                report=False,
            )
    except DynsrError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
