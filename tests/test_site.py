"""The site as a reader has it: built, opened from a folder, without a network, on a phone too.

Where there is no Chromium these tests are skipped; with DYNSR_REQUIRE_CHROMIUM=1 they fail.
"""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from browser import Browser, require_chromium

ROOT = Path(__file__).parents[1]
PHONE, DESK = 390, 1280
WITH_MATHS = ("fits", "noise", "methods/dynaifeynman", "methods/sindy", "gallery/noisy")

# One worker runs them all, so that the site is built once.
pytestmark = [pytest.mark.xdist_group("site"), pytest.mark.slow]


def build(folder, *config, site_url=""):
    """Build the site as ``scripts/check`` does, where any warning is an error."""
    pytest.importorskip("mkdocs")
    line = next(
        line
        for line in (ROOT / "scripts" / "check").read_text("utf-8").splitlines()
        if "mkdocs build" in line
    )
    options = line.partition("mkdocs build ")[2].partition(" --site-dir")[0].split()
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", *options, "--site-dir", folder, *config],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={
            **os.environ,
            "NO_MKDOCS_2_WARNING": "1",
            "PYTHONPATH": str(ROOT),
            "SITE_URL": site_url,
        },
    )


def write_config(folder, home):
    """Write a site of one page with the theme of the real one; give its settings."""
    (folder / "docs").mkdir()
    (folder / "docs" / "index.md").write_text(home)
    config = folder / "mkdocs.yml"
    nav = "docs_dir: docs\nextra_css: []\nextra_javascript: []\nplugins: []\nnav: [index.md]\n"
    theme = f"theme: {{custom_dir: {ROOT / 'scripts' / 'site' / 'theme'}}}\n"
    config.write_text(f"INHERIT: {ROOT / 'mkdocs.yml'}\n{theme}{nav}")
    return config


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site once."""
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_a_dead_link_ends_the_build(tmp_path):
    """A page, a heading or a picture that is not there is an error of ``scripts/check``; a live
    heading is none.
    """
    dead = ["there.md", "away.md#here", "#here", "there.png"]
    text = "\n\n".join(f"[text]({target})" for target in ("#live", *dead))
    config = write_config(tmp_path, f"# Live\n\n{text}\n")
    done = build(tmp_path / "site", "--config-file", config)
    assert done.returncode == 1, done.stderr
    # Each of them is a warning, and there is no other.
    said = [line for line in done.stderr.splitlines() if line.startswith("WARNING")]
    assert [target for target in dead if sum(f"'{target}'" in line for line in said) != 1] == []
    assert len(said) == len(dead), done.stderr


@pytest.fixture(scope="module")
def browser():
    """Start one browser for all."""
    with Browser(require_chromium()) as started:
        yield started


def test_no_page_loads_anything_from_elsewhere(site):
    """Scripts, styles, fonts and pictures of every page are files of the site, and they are there;
    the licences of what others wrote lie beside it.
    """
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        text = page.read_text("utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\ssrc=\"([^\"]*)", text)
        loaded += re.findall(r"<link[^>]*rel=\"?(?:stylesheet|icon)\"?[^>]*href=\"([^\"]*)", text)
        for address in loaded:
            if address and not address.startswith("data:"):
                base = site if address.startswith("/") else page.parent
                assert (base / address.lstrip("/").partition("?")[0]).is_file(), (page, address)
    style = (site / "lib" / "katex" / "katex.min.css").read_text("utf-8")
    fonts = set(re.findall(r"url\((fonts/[^)]*woff2)\)", style))
    assert len(fonts) == 20 and all((site / "lib" / "katex" / f).is_file() for f in fonts)
    for library in ("katex", "iframe-worker"):
        assert "Permission is hereby granted" in (site / "lib" / library / "LICENSE").read_text(
            "utf-8"
        )


@pytest.mark.parametrize("page", WITH_MATHS)
def test_formulas_are_set(browser, site, page):
    """Every formula is set by KaTeX without an error, and no TeX is left to be read as text."""
    browser.open(site / f"{page}.html", DESK)
    count = browser.run("document.querySelectorAll('.katex').length")
    marked = "document.querySelectorAll('.arithmatex').length"
    assert count >= max(3, browser.run(marked))
    assert browser.run("document.querySelectorAll('.katex-error').length") == 0
    # KaTeX keeps the source for screen readers where it is not seen.
    left = "[...document.querySelectorAll('.arithmatex')].filter(e => !e.querySelector('.katex'))"
    assert browser.run(f"{left}.length") == 0
    assert [url for url in browser.requests() if not url.startswith(("file:", "data:"))] == []


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ("<p style='width: 700px'>wide</p>", ["scrolls sideways, to 7"]),
        (
            "<div style='overflow: hidden'><p style='width: 700px'>cut off</p></div>",
            ["beyond the edge: <p style"],
        ),
        ("<pre style='overflow: auto'><b style='display: block; width: 700px'>x</b></pre>", []),
        ("<script>console.error('lost')</script>", ["console: "]),
    ],
)
def test_what_is_wrong_with_an_opened_page_is_found(browser, tmp_path, opened, inside, says):
    """``scripts/check`` opens each page: wide things scroll in a box, and the console is silent."""
    page = tmp_path / "page.html"
    page.write_text(f"<meta name=viewport content='width=device-width'><article>{inside}</article>")
    faults = list(opened.find_faults(browser, page, PHONE))
    assert len(faults) == len(says)
    assert all(fault.startswith(own) for fault, own in zip(faults, says, strict=True)), faults
    assert "scripts/site/opened.py" in (ROOT / "scripts" / "check").read_text("utf-8")


def test_the_options_are_read_on_a_phone_without_scrolling(browser, site):
    """Every cell of the tables of options lies within the width of a phone."""
    browser.open(site / "options.html", PHONE)
    cells = "[...document.querySelectorAll('.stack td')]"
    assert browser.run(f"{cells}.length") > 100
    right = f"Math.max(...{cells}.map(e => e.getBoundingClientRect().right))"
    assert browser.run(right) <= PHONE
    assert browser.run(f"{cells}.some(e => e.scrollWidth > e.clientWidth + 1)") is False


def test_no_markdown_and_no_tex_is_left_as_text(browser, site, visible):
    """No fence and no dollars are read on any page, built or opened; code may hold them."""
    for page in site.rglob("*.html"):
        assert list(visible.find_faults(page.read_text("utf-8"))) == [], page
    for page in ("noise", "fits", "gallery/noisy"):
        browser.open(site / f"{page}.html", DESK)
        assert "$$" not in browser.run("document.querySelector('article').innerText")


def load_script(name):
    """Load a script that ``scripts/check`` runs on the built pages."""
    path = ROOT / "scripts" / "site" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def visible():
    """Load the one that reads the pages."""
    return load_script("visible")


@pytest.fixture(scope="module")
def opened():
    """Load the one that opens the pages in a browser."""
    return load_script("opened")


def test_what_is_left_as_text_is_found(visible):
    """A fence with a word that superfences does not know, and a formula in the middle of a line."""
    assert list(visible.find_faults("<p>so: ```python notest x ```</p>"))
    assert list(visible.find_faults("<li>$$ x $$</li>"))
    assert not list(visible.find_faults("<pre>```</pre><script>'$$'</script><code>$$</code>"))


def test_a_missing_address_below_a_folder_leads_home(tmp_path):
    """The page for a missing address loads nothing and links to where the site is served."""
    config = write_config(tmp_path, "# Home\n")
    done = build(tmp_path / "site", "--config-file", config, site_url="https://example.org/dynsr/")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "404.html").read_text("utf-8")
    assert re.findall(r'(?:href|src)="([^"]*)"', page) == ["data:,", "/dynsr/index.html"]


def test_the_search_answers_from_a_folder(browser, site):
    """Words typed into the search of a page that was opened as a file find pages of the site."""
    browser.open(site / "index.html", DESK)
    browser.run(
        "(field => { field.focus(); field.value = 'michaelis';"
        "field.dispatchEvent(new Event('keyup', {bubbles: true})) })"
        "(document.querySelector('.md-search__input'))"
    )
    results = "[...document.querySelectorAll('.md-search-result__link')].map(e => e.href)"
    found = browser.run(
        "new Promise(r => { const again = n => { const some = " + results + ";"
        "some.length || !n ? r(some) : setTimeout(() => again(n - 1), 100) }; again(100) })"
    )
    assert any("gallery/rational.html" in address for address in found)
