"""The local page in a browser, from a dropped file to the downloads, on a desk and on a phone.

Where there is no Chromium these tests are skipped; with DYNSR_REQUIRE_CHROMIUM=1 they fail.
"""

import json
import math
import time

import numpy as np
import pytest

import dynsr

pytest.importorskip("tornado", reason="the extra app is not installed")
from axe import require_axe, violations
from browser import Browser, require_chromium
from served_page import Page, rabbits

pytestmark = [pytest.mark.xdist_group("browser"), pytest.mark.slow]

PHONE, DESK = 390, 1280
IDLE = "!document.getElementById('ask').hidden"
FOUND = "!document.getElementById('found').hidden && !!document.querySelector('#svg svg')"
UNIT = f"({IDLE}) && document.getElementById('unit-0').value === 'days' && !parts.busy"
OVERFLOWING = """
[...document.body.querySelectorAll("*")]
  .filter(e => !e.parentElement.closest(".scroll, svg, .formula, pre"))
  .map(e => [e.getBoundingClientRect(), e.outerHTML.slice(0, 80)])
  .filter(([box]) => box.width > 0 && (box.right > innerWidth + 1 || box.left < -1))
"""


@pytest.fixture(scope="module")
def browser():
    """Start one browser for all."""
    with Browser(require_chromium()) as started:
        yield started


@pytest.fixture(scope="module")
def served():
    """Serve one page for all tests that do not end it."""
    started = Page()
    yield started
    started.end()


@pytest.fixture
def page(browser, served):
    """Give the page without data; afterwards it forgets those of the test."""
    yield served
    # A page that is still open would answer to the next test's wishes too.
    browser.open("about:blank", DESK)
    served.post("stop")
    served.wait(lambda parts: not parts["busy"])
    served.post("forget")
    served.wait(lambda parts: not parts["busy"] and parts["table"] is None)


def text(browser, selector):
    """Give the text of an element."""
    return browser.run(f"document.querySelector({json.dumps(selector)}).innerText")


def click(browser, selector):
    """Press an element."""
    browser.run(f"document.querySelector({json.dumps(selector)}).click()")


def change(browser, selector, value, event="change"):
    """Give a control another value, as its reader does."""
    browser.run(
        f"(e => {{ e.value = {json.dumps(value)}; e.dispatchEvent(new Event('{event}')); }})"
        f"(document.querySelector({json.dumps(selector)}))"
    )


def test_the_whole_way_from_a_file_to_its_equations(browser, page, tmp_path):
    """Drop, look, correct, search, read, move a constant, download: all of it on one page."""
    (tmp_path / "rabbits.csv").write_text(rabbits())
    browser.open(page.url, DESK)
    browser.wait("document.getElementById('limit').textContent === 'Up to 50 MB'")
    browser.choose_file("#file", tmp_path / "rabbits.csv")
    browser.wait(IDLE)
    assert text(browser, "#guess") == (
        "rabbits.csv: time 't', 160 rows from 0 to 7.95 every 0.05; states x, y"
    )
    change(browser, "#unit-0", "days")
    browser.wait(UNIT)
    click(browser, "[name=preset][value=quick]")
    click(browser, "#search")
    browser.wait("!document.getElementById('progress').hidden")
    live = browser.wait(
        "document.querySelector('#best .formula math') && document.getElementById('best').innerText"
    )
    assert "best so far" in live or "not judged" in live
    browser.wait(FOUND)
    assert text(browser, "#verdict").startswith("Law: every equation reproduces")
    formulas = browser.run(
        "[...document.querySelectorAll('#equations .formula')].map(e => e.title)"
    )
    assert formulas == ["x' = -x*y + 1.5*x", "y' = x*y - 3*y"]
    chips = browser.run("[...document.querySelectorAll('#equations .chip')].map(e => e.innerText)")
    assert chips == ["law", "law"]
    drawn = "[...document.querySelectorAll('#equations math')].map(e => e.getBoundingClientRect())"
    assert browser.run(f"{drawn}.every(box => box.width > 60 && box.height > 15)")
    constants = "[...document.querySelectorAll('.constants input[type=number]')].map(e => +e.value)"
    assert browser.run(constants) == [-1, 1.5, 1, -3]
    assert " to " in text(browser, ".constants") and "k1" in text(browser, ".constants")
    assert text(browser, "#points").splitlines()[1] == "x = 3, y = 1.5: centre"
    assert browser.run(
        "[...document.querySelectorAll('#flow svg, #branches svg')]"
        ".map(e => e.getBoundingClientRect().height > 100)"
    ) == [True, True]
    assert "time t (days)" in text(browser, "#svg")

    # The picture follows the slider, and comes back.
    curve = "document.querySelector('#svg').innerHTML"
    before = browser.run(curve)
    change(browser, ".constants input[type=range]", "-0.8", "input")
    browser.wait("document.getElementById('lines').innerText.startsWith(\"x' = -0.8*x*y\")")
    assert browser.run(curve) != before
    click(browser, "#reset")
    browser.wait("document.getElementById('lines').innerText.startsWith(\"x' = -x*y\")")
    assert browser.run(constants) == [-1, 1.5, 1, -3]

    # Files come as a browser downloads them.
    browser.ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    browser.run("document.querySelector('#exports').closest('details').open = true")
    for name in ("report.html", "model.py", "discovery.json", "found_matlab.m"):
        click(browser, f"a[href='{name}']")
        end = time.monotonic() + 30
        while not (tmp_path / f"rabbits-{name}").exists():
            assert time.monotonic() < end, name
            time.sleep(0.05)
    found = dynsr.Discovery.load(tmp_path / "rabbits-discovery.json")
    assert str(found).partition("\n")[2] == "x' = -x*y + 1.5*x\ny' = x*y - 3*y"
    assert "def rhs(t, state)" in (tmp_path / "rabbits-model.py").read_text()
    assert (tmp_path / "rabbits-report.html").read_text().startswith("<!doctype html>")

    assert browser.complaints() == []
    outside = [u for u in browser.requests() if not u.startswith((page.url, "data:"))]
    assert outside == []


def test_guessed_columns_are_corrected(browser, page):
    """Each column shows its role, and takes another one; there is never a second time."""
    page.drop(rabbits(), "rabbits.csv")
    browser.open(page.url, DESK)
    browser.wait(IDLE)
    roles = "[...document.querySelectorAll('#columns select')].map(e => e.value)"
    assert browser.run(roles) == ["time", "state", "state"]
    assert browser.run("document.querySelectorAll('#columns tbody tr').length") == 8
    change(browser, "#role-2", "input")
    browser.wait("document.getElementById('guess').innerText.includes('inputs y')")
    change(browser, "#role-2", "state")
    browser.wait("document.getElementById('guess').innerText.endsWith('states x, y')")
    change(browser, "#role-1", "time")
    browser.wait("document.getElementById('guess').className === 'bad'")
    assert browser.run(roles) == ["unused", "time", "state"]
    assert "runs backwards" in text(browser, "#guess")
    assert browser.run("document.getElementById('ask').hidden")


def test_a_page_that_is_loaded_again_is_where_it_was(browser, page, tmp_path):
    """Data, equations and picture are there after a reload, also on a phone in the dark."""
    (tmp_path / "rabbits.csv").write_text(rabbits())
    page.drop(rabbits(), "rabbits.csv")
    page.post("search", options={"preset": "quick", "functions": []})
    page.wait(lambda parts: not parts["busy"] and parts["found"] and parts["picture"])
    for width, dark in ((DESK, False), (PHONE, True), (320, False)):
        browser.open(page.url, width, dark=dark)
        browser.wait(FOUND)
        browser.run("document.getElementById('more').open = true")
        assert browser.run("document.documentElement.scrollWidth") <= width
        assert browser.run(OVERFLOWING) == []
        assert browser.complaints() == []


def test_a_search_is_cancelled(browser, page):
    """Cancel ends a search that runs, and the page shows what it has or that there is nothing."""
    rows = "\n".join(f"{k},{(k * 7919) % 101},{(k * 104729) % 97}" for k in range(300))
    page.drop("t,a,b\n" + rows)
    browser.open(page.url, DESK)
    browser.wait(IDLE)
    click(browser, "#search")
    browser.wait("document.getElementById('left').innerText.includes('tasks')")
    click(browser, "#stop")
    browser.wait(f"({IDLE}) && (!!parts.found || !!parts.said)")
    said = text(browser, "#verdict") + text(browser, "#said")
    assert "Cancelled. These are the best" in said or "stopped" in said


def test_a_page_that_is_loaded_again_shows_the_same(browser, page):
    """Moved sliders, the curve and its formula are one state, and As found is there to go back."""
    page.drop(rabbits(), "rabbits.csv")
    page.post("search", options={"preset": "quick", "functions": []})
    browser.open(page.url, DESK)
    browser.wait(FOUND)
    constants = "[...document.querySelectorAll('.constants input[type=number]')].map(e => +e.value)"
    lines = "document.getElementById('lines').innerText"
    reset = "document.getElementById('reset').hidden"
    browser.wait(f'{lines}.startsWith("x\' = -x*y")')
    assert browser.run(constants) == [-1, 1.5, 1, -3] and browser.run(reset) is True
    change(browser, ".constants input[type=range]", "-0.8", "input")
    browser.wait(f"{lines}.startsWith(\"x' = -0.8*x*y\") && !document.querySelector('.waiting')")
    moved = browser.run("document.getElementById('svg').innerHTML")
    for _ in range(2):
        browser.open(page.url, DESK)
        browser.wait(FOUND)
        assert browser.run(constants) == [-0.8, 1.5, 1, -3]
        assert browser.run(lines).startswith("x' = -0.8*x*y + 1.5*x")
        assert browser.run("document.getElementById('svg').innerHTML") == moved
        assert browser.run(reset) is False
    # A second slider moves from where the first was left.
    change(browser, ".constants tr:nth-child(3) input", "1.25")
    browser.wait(f'{lines}.startsWith("x\' = -0.8*x*y + 1.25*x")')
    click(browser, "#reset")
    browser.wait(f'{lines}.startsWith("x\' = -x*y + 1.5*x")')
    assert browser.run(constants) == [-1, 1.5, 1, -3] and browser.run(reset) is True
    assert browser.complaints() == []


def test_two_windows_show_the_same(browser, page):
    """What another window moves moves here too; what is moved here is not pulled back."""
    page.drop(rabbits(), "rabbits.csv")
    page.post("search", options={"preset": "quick", "functions": []})
    browser.open(page.url, DESK)
    browser.wait(FOUND)
    lines = "document.getElementById('lines').innerText"
    constants = "[...document.querySelectorAll('.constants input[type=number]')].map(e => +e.value)"
    page.post("redraw", values={"y": [2.0, -3.0]}, run=0)
    browser.wait(f'{lines}.includes("y\' = 2*x*y")')
    assert browser.run(constants) == [-1, 1.5, 2, -3]
    for value in ("-0.5", "-0.6", "-0.7"):
        change(browser, ".constants input[type=range]", value, "input")
        time.sleep(0.2)
    browser.wait(f'{lines}.startsWith("x\' = -0.7*x*y")')
    assert browser.run(constants) == [-0.7, 1.5, 2, -3]


def test_names_of_columns_are_only_words(browser, page, tmp_path):
    """A name that is markup, or a file called so, is shown as it is written and never run."""
    bad = '<img src=x onerror="document.title=1">'
    rows = "\n".join(f"{k},{k * k}" for k in range(20))
    (tmp_path / "bad.csv").write_text(f"t,{bad}\n{rows}")
    browser.open(page.url, DESK)
    browser.wait("document.getElementById('limit').textContent")
    browser.choose_file("#file", tmp_path / "bad.csv")
    browser.wait("!document.getElementById('table').hidden")
    assert bad.replace('"', "") in text(browser, "#columns thead").replace('"', "")
    assert browser.run("document.images.length") == 0
    assert browser.run("document.title") == "dynsr"
    assert browser.complaints() == []


def test_what_is_wrong_is_said_on_the_page(browser, page, tmp_path):
    """A file that cannot be read, or is too large, gives its one line; another one may follow."""
    browser.open(page.url, DESK)
    browser.wait("document.getElementById('limit').textContent")
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,2,3,4\n")
    browser.choose_file("#file", tmp_path / "bad.csv")
    said = browser.wait(
        "!document.getElementById('said').hidden && document.getElementById('said').innerText"
    )
    assert said.startswith("row 2 of 'bad.csv' has 3 cells or more, where there are 2 columns")
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(60 << 20)
    browser.choose_file("#file", tmp_path / "large.csv")
    browser.wait(
        "document.getElementById('said').innerText.startsWith(\"'large.csv' has 60.0 MB\")"
    )
    (tmp_path / "good.csv").write_text(rabbits())
    browser.choose_file("#file", tmp_path / "good.csv")
    browser.wait(IDLE)
    assert browser.run("document.getElementById('said').hidden")


def test_quit_ends_it_and_the_page_says_so(browser):
    """Quit on the page ends the process with exit code 0."""
    page = Page()
    try:
        browser.open(page.url, DESK)
        browser.wait("document.getElementById('limit').textContent")
        click(browser, "#quit")
        browser.wait("document.getElementById('said').innerText.includes('can be closed')")
        assert page.process.wait(30) == 0
    finally:
        # A page that asked on would complain of its lost server while the next one is looked at.
        browser.open("about:blank", DESK)
        page.end()


def test_nothing_is_shown_without_the_token(browser, page):
    """A browser that comes without the token sees nothing of the page."""
    browser.open(page.url.replace(page.token, "x" * len(page.token)), DESK)
    assert "dynsr" not in browser.run("document.documentElement.innerText")


@pytest.mark.parametrize(("width", "dark"), [(DESK, False), (PHONE, True)])
def test_the_page_keeps_the_rules_of_accessibility(browser, page, width, dark):
    """Empty, with data, with options and a question, and with equations: axe-core finds nothing."""
    script = require_axe()
    browser.open(page.url, width, dark=dark)
    browser.wait("document.getElementById('limit').textContent && !!parts.choices")
    assert violations(browser, script) == []
    page.drop(rabbits(), "rabbits.csv")
    browser.wait(IDLE)
    browser.run("document.getElementById('more').open = true")
    assert violations(browser, script) == []
    page.post("search", options={"preset": "quick", "functions": []})
    browser.wait(FOUND)
    browser.run("for (const one of document.querySelectorAll('details')) one.open = true")
    assert violations(browser, script) == []
    click(browser, "#forget")
    assert browser.run("document.getElementById('sure').open")
    assert violations(browser, script) == []


def test_an_example_is_a_press_away(browser, page):
    """Without a file of one's own the page is tried: data, preview, search and a law."""
    browser.open(page.url, DESK)
    browser.wait("document.getElementById('limit').textContent")
    click(browser, "#example")
    browser.wait(IDLE)
    assert text(browser, "#guess").startswith("prey-and-predators.csv: time 'time (days)' in days")
    assert browser.run("document.querySelectorAll('#preview svg').length") == 1
    click(browser, "[name=preset][value=quick]")
    click(browser, "#search")
    browser.wait(FOUND)
    assert text(browser, "#verdict").startswith("Law: every equation reproduces")
    assert browser.complaints() == []


def test_what_was_found_is_not_lost_by_a_slip(browser, page, tmp_path):
    """Other data, a new search, another role and Quit ask first; after a download nobody asks."""
    page.drop(rabbits(), "rabbits.csv")
    page.post("search", options={"preset": "quick", "functions": []})
    browser.open(page.url, DESK)
    browser.wait(FOUND)
    question = "document.getElementById('sure').open"
    roles = "[...document.querySelectorAll('#columns select')].map(e => e.value)"
    for wish in ("#forget", "#search", "#quit", "#role-1"):
        if wish == "#role-1":
            change(browser, wish, "unused")
        else:
            click(browser, wish)
        assert browser.run(question)
        assert "will be lost" in text(browser, "#sure-words")
        # The safe answer has the focus, and Escape is one too.
        assert browser.run("document.activeElement.value") == "no"
        click(browser, "#sure button[value=no]")
        browser.wait(f"!{question}")
        assert browser.run("!!parts.found && !parts.busy")
        browser.wait(f"{roles}.join() === 'time,state,state'")
    browser.ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    click(browser, "a[href='discovery.json']")
    click(browser, "#forget")
    browser.wait("!parts.found && !parts.table")
    assert not browser.run(question)


def test_a_search_that_runs_is_not_ended_by_a_slip(browser, page):
    """Quit asks while a search runs; the safe answer leaves the page as it is."""
    rows = "\n".join(f"{k},{(k * 7919) % 101},{(k * 104729) % 97}" for k in range(300))
    page.drop("t,a,b\n" + rows)
    page.post("search", options={})
    browser.open(page.url, DESK)
    browser.wait("parts.busy === 'search'")
    click(browser, "#quit")
    assert "A search is running" in text(browser, "#sure-words")
    click(browser, "#sure button[value=no]")
    assert page.ask("")[0] == 200


def test_the_preview_says_which_trajectory_it_shows(browser, page):
    """Of several trajectories the first is named; the picture of equations offers all by name."""
    rows = [f"{name},{k},{(k + 1) * size}" for name, size in (("A", 1), ("B", 2)) for k in range(9)]
    page.drop("mouse,t,x\n" + "\n".join(rows), "mice.csv")
    browser.open(page.url, DESK)
    browser.wait(IDLE)
    assert text(browser, "#preview-said") == "Trajectory 'A', the first of 2."
    page.post("search", options={"preset": "quick", "functions": []})
    browser.wait(FOUND)
    names = "[...document.querySelectorAll('#run option')].map(e => e.textContent)"
    assert browser.run(names) == ["A", "B"]


def ready(browser, page, columns, name):
    """Drop columns, and give the page as it offers a quick search of them."""
    browser.open(page.url, DESK)
    browser.wait("!!parts.choices")
    rows = zip(*(map(str, own) for own in columns.values()), strict=True)
    page.drop("\n".join([",".join(columns), *map(",".join, rows)]), name)
    browser.wait(f"({IDLE}) && !parts.found && parts.table.guess.startsWith('{name}')")
    browser.run("document.getElementById('more').open = true")
    click(browser, "[name=preset][value=quick]")
    if not browser.run("document.getElementById('own').checked"):
        click(browser, "#own")


def refused(browser):
    """Ask for a search that is refused; gives the line."""
    click(browser, "#search")
    return browser.wait("!parts.busy && document.getElementById('said').innerText")


def check_looks(browser, page, shown, *screens):
    """Check that nothing is cut off and axe-core finds nothing, on screens of a width and look."""
    script = require_axe()
    for width, dark in screens:
        browser.open(page.url, width, dark=dark)
        browser.wait(shown)
        browser.run("document.getElementById('more').open = true")
        assert browser.run(OVERFLOWING) == []
        assert violations(browser, script) == []
        assert browser.complaints() == []


def test_constants_may_differ_from_run_to_run_and_not_with_a_delay(browser, page):
    """With several runs the choice is there, and gives a table; with a delay too it is refused."""
    t = np.linspace(0, 4, 40)
    runs = {"run": np.repeat([1, 2], 40), "t": np.tile(t, 2)}
    runs["x"] = np.concatenate([3 * np.exp(-k * t) for k in (0.4, 1.1)])
    ready(browser, page, runs, "runs.csv")
    change(browser, "[name=vary]", "*")
    assert browser.run("document.querySelector('[name=delay]').hidden")
    change(browser, "[name=delays]", "about")
    change(browser, "[name=delay]", "1.5")
    assert refused(browser).startswith("delays go with constants that all trajectories share")
    change(browser, "[name=delays]", "")
    click(browser, "#search")
    browser.wait(FOUND)
    cells = "[...document.querySelectorAll('#by-run tbody tr')].map(e => e.cells[1].innerText)"
    assert browser.run(cells) == ["0.4", "1.1"]
    assert text(browser, "#moving").startswith("No slider moves k1")
    assert browser.run("document.querySelectorAll('.constants input').length") == 0
    first = browser.run("document.getElementById('svg').innerHTML")
    change(browser, "#run", "1")
    browser.wait("parts.picture.run === 1 && !document.querySelector('.waiting')")
    assert browser.run("document.getElementById('svg').innerHTML") != first
    check_looks(browser, page, FOUND, (PHONE, True))


def test_noise_may_be_in_the_motion(browser, page):
    """Chosen, it gives drift, diffusion and a band of paths; with a hidden state it is refused."""
    rng, x = np.random.default_rng(0), [1.0]
    while len(x) < 400:
        x.append(x[-1] * math.exp(-0.1) + rng.normal(0, math.sqrt(0.1 * (1 - math.exp(-0.2)))))
    ready(browser, page, {"t": np.arange(400) / 10, "x": x}, "chance.csv")
    # One run has no other that could differ.
    assert browser.run("document.getElementById('vary').hidden")
    change(browser, "[name=stochastic]", "yes")
    change(browser, "[name=hidden]", "y")
    assert refused(browser).startswith("stochastic does not go with a hidden state")
    change(browser, "[name=hidden]", "")
    click(browser, "#search")
    browser.wait(FOUND)
    assert text(browser, "#noise-notes").startswith("Noise in the motion of x: variance")
    assert browser.run("document.querySelectorAll('#steps svg').length") == 1
    assert "band of 95 %" in text(browser, "#moving")
    check_looks(browser, page, FOUND, (PHONE, True))


def test_a_state_may_be_hidden(browser, page):
    """Its name gives its equation, its curve, and what cannot be known of it."""
    t = np.linspace(0, 6, 61)
    ready(browser, page, {"t": t, "x": np.exp(-t / 5) * np.cos(2 * t)}, "angle.csv")
    change(browser, "[name=hidden]", "y")
    click(browser, "#search")
    browser.wait(FOUND)
    assert "y, not measured" in text(browser, "#svg")
    assert "Nobody measured y. Its scale and sign are chosen" in text(browser, "#equations")
    # x'' + 0.4 x' + 4.04 x = 0 has two constants, and the factor of y was chosen: it has no slider.
    values = "[...document.querySelectorAll('#constants input[type=range]')].map(e => +e.value)"
    assert browser.run(values) == pytest.approx([-4.04, -0.4], abs=1e-3)
    check_looks(browser, page, FOUND, (PHONE, True))


def test_errors_limits_and_sums_are_said_at_their_columns(browser, page):
    """A limit is asked for where cells say BDL, errors at any state, and a sum for its states."""
    t = np.linspace(0, 6, 31)
    drug = [f"{x:.4f}" if x > 0.1 else "BDL" for x in np.exp(-0.7 * t)]
    columns = {"t": t, "S": 1 + np.cos(t), "S_sd": 0.1 + t / 100, "drug": drug, "total": 3 + t}
    ready(browser, page, columns, "cells.csv")
    roles = "[...document.querySelectorAll('#columns select:not(.way)')].map(e => e.value)"
    assert browser.run(roles) == ["time", "state", "error", "state", "state"]
    assert browser.run("document.getElementById('way-2').value") == "S*"
    limits = "[...document.querySelectorAll('#columns [id^=limit]')].map(e => e.id)"
    assert browser.run(limits) == ["limit-3"]
    errors = "[...document.querySelectorAll('#columns [id^=error]')].map(e => e.id)"
    assert browser.run(errors) == ["error-3", "error-4"]
    assert "cells without a number, such as BDL" in text(browser, "#help")
    change(browser, "#limit-3", "0.1")
    browser.wait("!parts.busy && document.getElementById('notes').innerText.includes('is beyond')")
    change(browser, "#error-3", "5 %")
    browser.wait("!parts.busy && parts.table.columns[3].error === '5 %'")
    change(browser, "#role-4", "sum")
    browser.wait("document.getElementById('guess').innerText.includes('type of which states')")
    change(browser, "#way-4", "S + I")
    browser.wait("!parts.busy && parts.table.states.includes('I')")
    assert browser.run("document.getElementById('error-3').value") == "5 %"
    change(browser, "#way-2", "S")
    browser.wait("!parts.busy && parts.table.columns[2].way === 'S' && !parts.table.error")
    check_looks(browser, page, IDLE, (DESK, False), (PHONE, True))
