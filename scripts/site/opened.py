"""Open every page of the built site in Chromium, as wide as a phone and as a desk.

Prints `page, width: what` for each page that scrolls sideways, has something beyond its edge, or
makes the console of the browser complain, and ends with 1 if there is any. What is wide, such as a
table, may scroll in a box of its own. Without Chromium no page is opened, which a line says.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from browser import Browser, find_chromium

WIDTHS = (390, 1280)
BOXES = ".md-typeset__scrollwrap, .arithmatex, pre, .jp-OutputArea-output, .katex, svg, nav"
BEYOND = (
    "[...document.querySelectorAll('article *')]"
    f".filter(e => !e.parentElement.closest('{BOXES}') && e.getBoundingClientRect().width)"
    ".filter(e => e.getBoundingClientRect().right > innerWidth + 1)"
    ".map(e => e.outerHTML.slice(0, 80))"
)


def find_faults(browser: Browser, page: Path, width: int) -> Iterator[str]:
    """Give what is wrong with a page at a width, in pixels."""
    browser.open(page, width)
    if (wide := browser.run("document.documentElement.scrollWidth")) > width:
        yield f"scrolls sideways, to {wide}"
    yield from (f"beyond the edge: {element}" for element in browser.run(BEYOND))
    yield from (f"console: {words}" for words in browser.complaints())


def main(site: Path) -> None:
    """Open the pages and print what was found."""
    program = find_chromium()
    if program is None:
        print("Chromium is not installed; no page was opened", file=sys.stderr)
        return
    faults = 0
    with Browser(program) as browser:
        for page in sorted(site.rglob("*.html")):
            for width in WIDTHS:
                for fault in find_faults(browser, page, width):
                    print(f"{page.relative_to(site)}, {width}: {fault}")
                    faults += 1
    sys.exit(1 if faults else None)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
