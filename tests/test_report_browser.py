"""Reports as a browser shows them: on a desk, on a phone, in the dark, on paper, offline.

Where there is no Chromium these tests are skipped; with DYNSR_REQUIRE_CHROMIUM=1 they fail.
"""

import numpy as np
import pytest
from axe import require_axe, violations
from browser import Browser, require_chromium
from fake_records import PRINTED, record

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.paper.page import render_replication
from dynsr.report.discovery import render_discovery

# One worker runs them all, so that one browser is started.
pytestmark = [pytest.mark.xdist_group("browser"), pytest.mark.slow]

PHONE, DESK, PAPER = 390, 1200, 680
LONG = "-x + " + " + ".join(f"{k}.12345e-9*x**{k}*y*sin(x*y)" for k in range(1, 9))
FORMULAS = (("0", 0.7, 1.0), ("y", 1e-3, 20.0), (LONG, 1e-5, 400.0))
OVERFLOWING = """
[...document.body.querySelectorAll("*")]
  .filter(e => !e.parentElement.closest(".scroll, svg"))
  .map(e => [e.getBoundingClientRect(), e.outerHTML.slice(0, 80)])
  .filter(([box]) => box.width > 0 && (box.right > innerWidth + 1 || box.left < -1))
"""
# Letters whose contrast with what is behind them is below what WCAG 2.2 asks for (1.4.3: 4.5).
PALE = """
(() => {
  const light = colour => {
    const [r, g, b] = colour.match(/[0-9.]+/g).slice(0, 3).map(v => v / 255)
      .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05;
  };
  const behind = e => {
    for (; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (!/, 0\\)$/.test(colour)) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const kinds = "h1, h2, p, a, td, th, figcaption, math, code, summary, text";
  return [...document.querySelectorAll(kinds)]
    .map(e => {
      const style = getComputedStyle(e);
      const pair = [light(e.matches("text") ? style.fill : style.color), light(behind(e))];
      return [Math.max(...pair) / Math.min(...pair), e.outerHTML.slice(0, 80)];
    })
    .filter(([contrast]) => contrast < 4.5);
})()
"""


@pytest.fixture(scope="module")
def browser():
    """Start one browser for all; afterwards nothing of it is left."""
    with Browser(require_chromium()) as started:
        yield started
    assert not started.profile.exists()
    assert started.survivors() == []


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Write the report of a discovery with a very long alternative, and that of a replication."""
    folder = tmp_path_factory.mktemp("pages")
    t = np.linspace(0, 6, 60)
    run = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))
    front = ParetoFront([Candidate(parse(f), e, bits, "sindy") for f, e, bits in FORMULAS])
    found = Discovery(
        {"x": parse("y"), "y": parse(LONG)},
        {"x": (), "y": ((1.12345e-9, 1e-12),)},
        {"x": front, "y": front},
        {"x": "It is the shortest.", "y": "The next best, " + "0.001*x*y" * 30},
        (run,),
        settings={"seed": 0, "methods": ["sindy"], "scheme": {"x": "central4"}},
    )
    runs = [record(s, text, r) for s, some in PRINTED.items() for r, text in enumerate(some[2:], 1)]
    settings = {
        "seed": 5,
        "engine": "embedded",
        "quick": True,
        "recorded_steps": False,
        "version": "0.1.0",
    }
    texts = {
        "discovery": render_discovery(found),
        "replication": render_replication(
            [*runs, record("cart-pole", LONG.replace("x", "w"), method="sindy")], settings
        ),
    }
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, "utf-8")
    return {name: folder / f"{name}.html" for name in texts}


both = pytest.mark.parametrize("name", ["discovery", "replication"])


@both
@pytest.mark.parametrize("width", [320, PHONE, DESK])
def test_nothing_sticks_out(browser, pages, name, width):
    """At any width the page itself does not scroll sideways; what is wide scrolls in its box."""
    browser.open(pages[name], width)
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run(OVERFLOWING) == []
    assert browser.complaints() == []


def test_a_wide_table_scrolls_in_its_box(browser, pages):
    """On a phone the wide table is reached by scrolling its box, also from the keyboard."""
    browser.open(pages["replication"], PHONE)
    box = "document.querySelector('#losses').closest('.scroll')"
    assert browser.run(f"{box}.scrollWidth > {box}.clientWidth && {box}.tabIndex === 0")
    assert browser.run(f"{box}.scrollLeft = 1e6, {box}.scrollLeft > 100")


@both
def test_no_network_is_asked_for_or_allowed(browser, pages, name):
    """Only the file itself and what it holds are loaded; more is refused by the page's own rule."""
    browser.open(pages[name], DESK)
    outside = [url for url in browser.requests() if not url.startswith("data:")]
    assert outside == [pages[name].as_uri()]
    browser.run("new Image().src = 'http://192.0.2.1/a.png'; document.images.length")
    browser.wait_for_complaint()
    assert "Content Security Policy" in browser.complaints()[0]


@both
@pytest.mark.parametrize("dark", [False, True])
def test_letters_stand_out(browser, pages, name, dark):
    """By day and in the dark every letter, those in pictures too, has a contrast of 4.5 or more."""
    browser.open(pages[name], PHONE, dark=dark)
    assert browser.run("getComputedStyle(document.body).backgroundColor") == (
        "rgb(21, 23, 26)" if dark else "rgb(255, 255, 255)"
    )
    assert browser.run(PALE) == []


@both
def test_letters_of_pictures_can_be_read_on_a_phone(browser, pages, name):
    """No letter on the page is smaller than 9 pixels on a phone, and equations are large."""
    browser.open(pages[name], PHONE)
    sizes = browser.run(
        "[...document.querySelectorAll('svg text')].map(e => parseFloat(getComputedStyle(e)"
        ".fontSize) * Math.hypot(e.getScreenCTM().a, e.getScreenCTM().b))"
    )
    assert len(sizes) > 20 and min(sizes) >= 9
    if name == "discovery":
        assert (
            browser.run(
                "parseFloat(getComputedStyle(document.querySelector('.equation math')).fontSize)"
            )
            > 20
        )


@both
def test_paper_shows_everything(browser, pages, name, tmp_path):
    """In print nothing is cut off or folded away, links of the page are gone, and a PDF is made."""
    browser.open(pages[name], PAPER, media="print")
    assert browser.run("document.documentElement.scrollWidth") <= PAPER
    assert browser.run("getComputedStyle(document.querySelector('nav')).display") == "none"
    hidden = (
        "[...document.querySelectorAll('details > :not(summary)')].filter(e => !e.offsetHeight)"
    )
    assert browser.run(f"{hidden}.length") == 0
    cut = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1)"
    assert browser.run(f"{cut}.map(e => e.innerText.slice(0, 60))") == []
    assert browser.print_pdf(tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


@both
@pytest.mark.parametrize("width", [PHONE, DESK])
def test_reports_keep_the_rules_of_accessibility(browser, pages, name, width):
    """axe-core finds nothing against WCAG 2.2 at level AA, also in what is folded."""
    script = require_axe()
    browser.open(pages[name], width)
    browser.run("for (const one of document.querySelectorAll('details')) one.open = true")
    assert violations(browser, script) == []


def formula(browser):
    """Read the formula that the first front shows."""
    return browser.run("document.querySelector('.front output code').textContent")


def test_a_tap_on_a_front_shows_its_formula(browser, pages):
    """A finger beside a point shows the nearest one's formula, its bits and its error."""
    browser.open(pages["discovery"], PHONE)
    assert formula(browser) == "x' = y"
    for index, (text, *_) in enumerate(FORMULAS[:2]):
        x, y = browser.run(
            f"(dot => {{ dot.scrollIntoView({{block: 'center'}}); const box = "
            "dot.getBoundingClientRect(); return [box.x + 9, box.y - 5]; })"
            f"(document.querySelectorAll('.front circle')[{index}])"
        )
        browser.tap(x, y)
        assert formula(browser) == f"x' = {text}"
    assert "20 bits, RMSE 0.001" in browser.run("document.querySelector('.front output').innerText")


def test_a_front_is_walked_by_keyboard(browser, pages):
    """Tab reaches each front once, at its chosen formula; arrows, Home and End walk along it."""
    browser.open(pages["discovery"], DESK)
    stops = "document.querySelectorAll('.front circle[tabindex=\"0\"]').length"
    assert browser.run(stops) == 2
    chosen = "document.activeElement.classList.contains('chosen')"
    for _ in range(30):
        browser.press("Tab")
        if browser.run(chosen):
            break
    assert browser.run(chosen)
    seen = []
    for key in ("ArrowLeft", "End", "ArrowLeft", "Home", "ArrowLeft"):
        browser.press(key)
        seen.append(formula(browser))
    texts = [f"x' = {text}" for text, *_ in FORMULAS]
    assert [seen[0], *seen[2:]] == [texts[0], texts[1], texts[0], texts[0]]
    assert "8.12345e-09*x**8" in seen[1]


def test_a_page_without_scripts_still_shows_its_fronts(browser, pages):
    """Where scripts are forbidden the points, the axis, the chosen formula and the table stand."""
    try:
        browser.ask("Emulation.setScriptExecutionDisabled", value=True)
        browser.open(pages["discovery"], PHONE)
        assert browser.run("document.querySelectorAll('.front circle[tabindex=\"0\"]').length") == 0
        assert formula(browser) == "x' = y"
        places = (
            "[...document.querySelectorAll('.front circle')].map(e => e.getBoundingClientRect().x)"
        )
        assert len(set(browser.run(places)[:3])) == 3
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize(("number", "kind"), [(0, "LaTeX"), (1, "Python"), (2, "Julia")])
def test_code_is_copied_at_a_touch(browser, pages, number, kind, guarded):
    """From a file, one touch puts the code on the clipboard, which a paste gives back; also where
    a browser keeps pages from its clipboard.
    """
    allowed = ["clipboardReadWrite", "clipboardSanitizedWrite"]
    browser.ask("Browser.grantPermissions", permissions=allowed)
    browser.open(pages["discovery"], PHONE)
    browser.run("navigator.clipboard.writeText('nothing')")
    if guarded:
        browser.run("navigator.clipboard.writeText = () => Promise.reject(new Error())")
    button = f"document.querySelectorAll('.copy button')[{number}]"
    assert browser.run(f"{button}.checkVisibility() && {button}.textContent") == kind
    x, y = browser.run(
        f"{button}.scrollIntoView(), (box => [box.x + 9, box.y + 9])"
        f"({button}.getBoundingClientRect())"
    )
    browser.tap(x, y)
    said = "document.querySelector('.copy output').textContent"
    assert browser.run(f"new Promise(r => setTimeout(() => r({said}), 200))") == f"{kind} is copied"
    copied = browser.run("navigator.clipboard.readText()")
    assert copied == browser.run(f"document.getElementById('code-{kind}').textContent")
    assert {"LaTeX": "aligned", "Python": "def ", "Julia": "function"}[kind] in copied
