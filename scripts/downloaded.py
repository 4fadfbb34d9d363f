"""Show on one line of a terminal how much pip has downloaded; its other words are left out.

It reads what ``pip install --progress-bar raw`` writes: "Progress 1024 of 4096" for each file.
"""

import sys
from collections.abc import Iterable, Iterator

MEGABYTE = 1e6


def megabytes(lines: Iterable[str]) -> Iterator[float]:
    """Give after each report how many megabytes have come in all.

    >>> list(megabytes(["Collecting a", "Progress 0 of 2000000", "Progress 2000000 of 2000000",
    ...                 "Progress 1000000 of 9000000"]))
    [0.0, 2.0, 3.0]
    """
    before = now = 0
    for line in lines:
        words = line.split()
        if len(words) == 4 and words[0] == "Progress" and words[1].isdigit():
            here = int(words[1])
            if here < now:
                before += now
            now = here
            yield (before + now) / MEGABYTE


if __name__ == "__main__":
    shown = -1
    for amount in megabytes(sys.stdin):
        if int(amount) > shown and sys.stderr.isatty():
            shown = int(amount)
            print(f"\r  {shown} of about {sys.argv[1]} MB", end="", file=sys.stderr, flush=True)
    if shown >= 0:
        print(file=sys.stderr)
