#!/usr/bin/env python3
"""Check the text of built pages: no fence of Markdown and no dollars of TeX may be visible.

Usage: visible.py FOLDER. Prints `page: text` of each fault, and ends with 1 if there is any.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

_FAULT = re.compile(r"```|\$\$|~~~|<!--|\]\([\w./#-]+\)")
_UNREAD = frozenset({"script", "style", "pre", "code"})


class _Text(HTMLParser):
    """Gathers the text that is outside code, scripts and styles."""

    def __init__(self) -> None:
        """Begin outside of all."""
        super().__init__()
        self.depth, self.parts = 0, []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Count what is open and not read."""
        self.depth += tag in _UNREAD

    def handle_endtag(self, tag: str) -> None:
        """Count what is closed."""
        self.depth -= tag in _UNREAD

    def handle_data(self, data: str) -> None:
        """Keep a text that is read."""
        if not self.depth:
            self.parts.append(data)


def find_faults(html: str) -> Iterator[str]:
    """Give the places of a page where Markdown or TeX is left as text."""
    reader = _Text()
    reader.feed(html)
    text = "".join(reader.parts)
    for match in _FAULT.finditer(text):
        yield " ".join(text[max(0, match.start() - 30) : match.end() + 30].split())


def main() -> None:
    """Check every page of a folder."""
    folder = Path(sys.argv[1])
    pages = sorted(folder.rglob("*.html"))
    if not pages:
        sys.exit(f"{folder}: no pages")
    found = [(page, fault) for page in pages for fault in find_faults(page.read_text("utf-8"))]
    for page, fault in found:
        print(f"{page.relative_to(folder)}: {fault}")
    sys.exit(1 if found else None)


if __name__ == "__main__":
    main()
