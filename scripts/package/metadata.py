"""Metadata of the package that are made when it is built: its page, and its addresses.

Links of README.md lead to files of the repository, which a package index does not have. With
``DYNSR_URL=https://example.org/dynsr`` they lead to that repository; without it they are words.
"""

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[((?:[^\[\]]|\n)*)\]\((?!https?:|#|mailto:)([^)\s]+)\)")
PAGES = {"Documentation": "docs/index.md", "Changelog": "CHANGELOG.md"}


def lead_outside(text: str, address: str = "") -> str:
    """Give a page whose links and pictures hold without the files of the repository.

    >>> page = "![a picture](docs/a.png) and [the docs](docs/index.md), [a site](https://a.org)"
    >>> print(lead_outside(page, "https://b.org/c"))
    ![a picture](https://b.org/c/raw/main/docs/a.png) and
    [the docs](https://b.org/c/blob/main/docs/index.md), [a site](https://a.org)
    >>> lead_outside(page)
    ' and the docs, [a site](https://a.org)'
    """

    def write(link: re.Match[str]) -> str:
        picture, words, path = link.groups()
        if not address:
            return "" if picture else words
        return f"{picture}[{words}]({address}/{'raw' if picture else 'blob'}/main/{path})"

    return LINK.sub(write, text)


class PageHook(MetadataHookInterface):
    """Fills in what pyproject.toml calls dynamic, but for the version."""

    def update(self, metadata: dict) -> None:
        """Set the page and the addresses."""
        address = os.environ.get("DYNSR_URL", "").rstrip("/")
        page = Path(self.root, "README.md").read_text("utf-8")
        text = lead_outside(page, address)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        pages = {name: f"{address}/blob/main/{path}" for name, path in PAGES.items()}
        metadata["urls"] = {"Repository": address, **pages} if address else {}
