import html
import re
import shlex
import time
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from urllib.parse import unquote
from zipfile import ZipFile

import numpy as np
import pytest
from test_profile_likelihood import noisy_rabbits

from dynsr.data.trajectory import Trajectory
from dynsr.discovery import DiscoverySettings
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.expression import shown
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.jobs import to_plain
from dynsr.methods import choose_methods
from dynsr.report import discovery as discovery_report
from dynsr.report.discovery import place_front, render_discovery, show_branches
from dynsr.verdict.levels import StateVerdict, summarise


@pytest.fixture(scope="module")
def found():
    """Give a discovery of a rotation with a front of three formulas."""
    t = np.linspace(0, 6, 120)
    run = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))
    front = ParetoFront(
        [
            Candidate(parse("0"), 0.7, 1.0, "a column"),
            Candidate(parse("y"), 1e-3, 2.0, "</script><b>rational"),
            Candidate(parse("1.0001*y"), 0.0, 30.0, "sindy"),
        ]
    )
    return Discovery(
        {"x": parse("y"), "y": parse("-1.0*x")},
        {"x": (), "y": ((-1.0, 0.01),)},
        {"x": front, "y": ParetoFront([Candidate(parse("-x"), 0.0, 3.0, "rational")])},
        {"x": "because <it> is shorter", "y": ""},
        (run,),
        settings={"seed": 0, "methods": ["rational"], "scheme": {"x": "central4"}},
    )


class Reader(HTMLParser):
    """Collects tags and checks that they are closed in order."""

    def __init__(self):
        """Start with nothing open."""
        super().__init__()
        self.open, self.seen, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        """Note a tag, and what it loads."""
        self.seen.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href") and v]
        if tag not in ("meta", "img", "br", "link", "input", "hr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        """Close the innermost tag, which must be this one."""
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(found):
    """Render the page once."""
    return render_discovery(found)


@pytest.mark.slow
def test_the_page_stands_alone(page):
    """Nothing is loaded from elsewhere: every source is inside the page."""
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert all(link.startswith(("data:", "#")) for link in reader.links)


def test_the_page_holds_equations_pictures_and_fronts(page):
    """Two equations; pictures of states, phases, flow, fixed points along a constant, slopes and
    residuals of each; two fronts.
    """
    reader = Reader()
    reader.feed(page)
    assert page.count('class="equation ') == reader.seen.count("math") == 2
    assert page.count('<svg class="picture"') == 8
    assert len(re.findall(r'class="front"', page)) == 2
    assert "1.0001*y" in page


@pytest.mark.parametrize("level", ["law", "approximation", "not found"])
@pytest.mark.slow
def test_a_reason_is_open_unless_it_is_at_the_top(found, level):
    """The reason of a law, or one that the top gives, is folded, so that pictures come soon.
    Equations that the data refuse have no fixed points, and a sentence says what their intervals
    are worth.
    """
    states = {s: StateVerdict(level, f"because of {s}.", 0.5) for s in found.equations}
    own = replace(
        found,
        verdict=summarise(states, 1.0),
        explanation=dict.fromkeys(found.equations, "It is so."),
    )
    page = render_discovery(own)
    folded = re.findall(r"<details><summary>Why it is (.*?)</summary><p>It is so", page)
    names = {"law": "a law", "approximation": "an approximation", "not found": "not found"}
    assert folded == [names[level]] * (2 if level == "law" else 1)
    assert page.count(f'class="equation {level.replace(" ", "-")}"') == 2
    assert ('id="fixed"' in page) is (level != "not found")
    assert ("these intervals mean little" in page) is (level == "not found")


@pytest.mark.slow
def test_the_page_of_a_map_speaks_of_next_values():
    """No slope and no derivative is on it: formulas, pictures and headings are of x[n+1]."""
    n = np.arange(40.0)
    x = [0.3]
    for _ in n[1:]:
        x.append(3.7 * x[-1] * (1 - x[-1]))
    expr = parse("3.7*x*(1 - x)")
    front = ParetoFront([Candidate(expr, 1e-9, 20.0), Candidate(parse("x"), 0.1, 1.0)])
    run = Trajectory(n, np.array(x)[:, None], ("x",))
    settings = {"seed": 0, "kind": "map"}
    errors = {"x": ((3.7, 1e-3), (-3.7, 1e-3))}
    found = Discovery({"x": expr}, errors, {"x": front}, {}, (run,), settings=settings)
    page = html.unescape(render_discovery(found))
    assert found.is_map and f"x[n+1] = {shown(expr)}" in page
    assert "Next values and their residuals" in page and "residual of next x" in page
    seen = page.partition('<h2 id="code">')[0]
    assert (
        "x' =" not in seen
        and "x'" not in seen.partition("<table")[2]
        and "dx/dt" not in seen
        and "slopes of x" not in seen.lower()
    )


def test_texts_are_escaped(page):
    """Words that look like HTML stay words, in the page and in the script's data."""
    assert "because &lt;it&gt; is shorter" in page
    assert "</script><b>rational" not in page


def test_a_loaded_discovery_has_a_report_without_pictures(found, tmp_path):
    """Without the data the page still has equations, reasons and fronts."""
    loaded = Discovery.load(found.save(tmp_path / "d.json"))
    page = loaded.report(tmp_path / "page.html").read_text("utf-8")
    assert "<math" in page
    assert 'class="picture"' not in page
    assert page.count("<circle") == 4 and "The data are not in this report" in page


def test_the_chosen_equation_is_on_its_front(found, page):
    """It is marked; one that fitting changed since is drawn too, where the front lacks it."""
    dots = re.findall(r"<circle[^>]*>", page)
    assert [("chosen" in dot, html.unescape(dot.split('aria-label="')[1])[:8]) for dot in dots] == [
        (False, "0, 1 bit"),
        (True, "y, 2 bit"),
        (False, "1.0001*y"),
        (True, "-1*x, 3 "),
        (False, "-x, 3 bi"),
    ]


@pytest.mark.slow
def test_the_page_says_how_it_was_made(found, page):
    """The command searches in the same way, and slopes are made as they were: by the recorded
    scheme, not by the one that the data would choose today.
    """
    schemes = {"x": "savgol(11,3)", "y": "given"}
    given = {"method": "sindy", "known": {"y": "-x"}, "preset": "quick", "scheme": schemes}
    told = html.unescape(render_discovery(replace(found, settings={**found.settings, **given})))
    command = shlex.split(re.search("dynsr discover DATA [^<]*", told)[0])
    assert command[3:] == [
        *("--method", "sindy", "--preset", "quick", "--known", "y'=-x", "--seed", "0"),
    ]
    assert "<dt>seed</dt><dd>0</dd>" in told and "120 rows in 1 trajectory" in told
    assert "slopes of x, taken from the data by savgol(11,3)" in told
    assert re.search(r"slopes of y, taken from the data by central\d", told)
    assert "slopes of x, taken from the data by central4" in page


def test_a_notebook_shows_equations_and_reasons(found):
    """As HTML: formula, text and reason of each state, escaped; as LaTeX: one display."""
    shown = found._repr_html_()
    assert "$\\displaystyle \\dot{x} = y$" in shown and "y' = -1*x" in html.unescape(shown)
    assert shown.count("<tr>") == 3
    assert "because &lt;it&gt; is shorter" in shown and "-k1 = -1 (-1.02 to -0.9804)" in shown
    assert found._repr_latex_().startswith("$$\n\\begin{aligned}\n\\dot{x} &= y")


def test_a_report_that_cannot_be_written_is_an_error_of_one_line(found, tmp_path):
    """A name that is a folder's, or lies below a file, is refused with the reason."""
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    bare = replace(found, trajectories=())
    for path in (tmp_path / "folder", tmp_path / "file" / "page.html"):
        with pytest.raises(InputError, match=r"cannot write .*; choose another file"):
            bare.report(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_pictures_come_before_constants_and_these_before_other_formulas(page):
    """The trajectories follow the equations; then the constants, each once, with its interval."""
    table = re.search(r'<table id="constants".*?</table>', page, re.DOTALL)
    assert table is not None
    order = [page.index('id="equations"'), page.index('<svg class="picture"'), table.start(),
             page.index('id="fronts"'), page.index('id="slopes"')]  # fmt: skip
    assert order == sorted(order)
    cells = dict(re.findall(r'data-label="([^"]*)">([^<]*)</td>', table[0]))
    assert (cells["Name"], cells["Value"]) == ("k1", "1")
    assert html.unescape(cells["Constant of"]) == "x of y'"
    low, high = map(float, cells["95 % interval"].split(" to "))
    assert low == pytest.approx(1 - 1.96 * 0.01, abs=1e-3)
    assert high == pytest.approx(1 + 1.96 * 0.01, abs=1e-3)
    assert "y&#39; = -k1*x" in page


@pytest.mark.slow
def test_a_rounded_constant_shows_what_was_fitted(found):
    """The fitted number has the sign of the parameter; one that was not rounded has none."""
    rounded = replace(found, fitted={"x": (), "y": (-1.0123,)})
    page = render_discovery(rounded)
    assert 'data-label="Fitted">1.0' in page and "before it was made a simple one" in page
    assert 'data-label="Fitted"' not in render_discovery(found)


@pytest.mark.slow
def test_only_settings_that_differ_are_listed_and_folded(found):
    """Of the numbers that decide, the usual ones are not listed; one that was changed is."""
    usual = to_plain(DiscoverySettings())
    other = to_plain(DiscoverySettings(rows=123))
    methods = {n: to_plain(m) for n, m in choose_methods("auto", "quick").items()}
    methods = {**methods, "sindy": {**methods["sindy"], "max_iterations": 77}}
    for details, listed in (
        ({**usual, "methods": to_plain(choose_methods("auto", "quick"))}, {}),
        ({**other, "methods": methods}, {"methods.sindy.max_iterations": "77", "rows": "123"}),
    ):
        record = {**found.settings, "method": "auto", "preset": "quick", "details": details}
        page = render_discovery(replace(found, settings=record))
        folded = page.partition('<details class="settings">')[2].partition("</details>")[0]
        facts = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd>", folded))
        assert {name: value for name, value in facts.items() if name not in record} == listed
        assert facts["preset"] == "quick"


@pytest.mark.slow
def test_the_command_repeats_what_was_asked(found):
    """Terms, functions, signs and limits of the call are in the command, ready for a shell."""
    record = {
        **found.settings,
        "terms": ["x*y/(x + 1)"],
        "constraints": ["x: x < 0"],
        "functions": ["exp", "/"],
        "max_complexity": 60.0,
        "hold": {"u": "previous"},
        "complexity": {"sin": 8.0},
        "time_budget": 20.0,
    }
    page = render_discovery(replace(found, settings=record))
    words = shlex.split(html.unescape(re.search("dynsr discover DATA [^<]*", page)[0]))
    for option, value in {
        "--terms": "x*y/(x + 1)",
        "--constraints": "x: x < 0",
        "--functions": "exp,/",
        "--max-complexity": "60",
        "--hold": "u=previous",
        "--complexity": "sin=8",
        "--time-budget": "20",
    }.items():
        assert words[words.index(option) + 1] == value


def test_a_choice_that_the_search_did_not_find_is_explained():
    """Above the front the formula is named that is no longer and misses less; otherwise the line
    goes through the choice, and the page says that constants were fitted later.
    """
    front = ParetoFront([Candidate(parse("x"), 0.5, 2.0), Candidate(parse("sin(x)"), 0.1, 4.0)])
    above = place_front(front, Candidate(parse("2*x"), 0.3, 5.0, "the fit to the states"))
    assert above.note.startswith("The chosen formula is above the front: sin(x) is no longer")
    assert "4 bits, RMSE 0.1" in above.note
    for loss, bits in ((0.3, 3.0), (0.05, 5.0), (0.1001, 4.0)):
        fitted = place_front(front, Candidate(parse("2*x"), loss, bits))
        assert fitted.note.startswith("The constants of the chosen formula were fitted")
        (dot,) = [dot for dot in fitted.dots if dot.chosen]
        on_line = any((dot.x, dot.y) in ((a, b), (c, d)) for a, b, c, d in fitted.steps)
        assert on_line is (loss != 0.1001)
    for on in ("sin(x)", Candidate(parse("sin(x)"), 0.1, 4.0)):
        assert place_front(front, on).note == ""


@pytest.mark.slow
def test_large_data_are_thinned_or_drawn_as_a_density_and_it_is_said():
    """Of 6,000 rows one in three is a point of a line, and slopes are pictures, a small page."""
    t = np.linspace(0, 300, 6_000)
    run = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "y"))
    equations = {"x": parse("y"), "y": parse("-x")}
    empty = {"x": ParetoFront([]), "y": ParetoFront([])}
    large = Discovery(equations, {}, empty, {}, (run,), settings={"scheme": {}})
    page = html.unescape(render_discovery(large))
    # Each caption stands below its picture and is what a screen reader says of it.
    assert page.count("One row in 3 of 6000 is drawn.") == 2 * 2
    assert len(re.findall(r"There are \d{4}: the stronger the colour", page)) == 4 * 2
    assert len(page) < 1_500_000
    few = replace(large, trajectories=(run.select(slice(0, 500)),))
    small = render_discovery(few)
    assert "is drawn" not in small and "stronger" not in small


@pytest.mark.slow
def test_trajectories_that_are_not_drawn_are_counted(found):
    """Of five trajectories three are drawn, and the page says that two more are there."""
    page = render_discovery(replace(found, trajectories=found.trajectories * 5))
    assert "2 more are in the data" in page and "Trajectory 3" in page
    assert "Trajectory 4" not in page


@pytest.mark.slow
def test_every_format_is_offered_as_a_file(found):
    """Each link holds the text that the export writes, under a name that hides no package."""
    page = render_discovery(found)
    links = re.findall(r'<a href="data:text/plain;charset=utf-8,([^"]*)" download="([^"]*)"', page)
    files = {file: unquote(html.unescape(text)) for text, file in links}
    assert {"found_python.py", "found_control.py", "found_c.c", "found_latex.tex"} <= {*files}
    assert files["found_control.py"] == found.export("control")
    assert files["found_julia.jl"] == found.export("julia")
    assert "found_petab.zip" not in files


@pytest.mark.slow
def test_a_report_offers_the_petab_problem_of_its_data(found):
    """The archive has the model and the measurements; that of many rows is not in the page."""
    pytest.importorskip("libsbml", reason="python-libsbml is not installed")
    link = r'<a href="data:application/zip;base64,([^"]*)" download="found_petab.zip"'
    (packed,) = re.findall(link, html.unescape(render_discovery(found)))
    with ZipFile(BytesIO(b64decode(packed))) as archive:
        rows = archive.read("measurements.tsv").decode().splitlines()
        assert "model.xml" in archive.namelist() and len(rows) == 1 + 2 * 120
    (run,) = found.trajectories
    t = np.linspace(0, 1, 2001)
    many = replace(run, t=t, x=np.stack([np.cos(t), -np.sin(t)], axis=1))
    assert "found_petab.zip" not in render_discovery(replace(found, trajectories=(many,)))


@pytest.mark.slow
def test_the_fixed_points_are_drawn_along_the_constant_that_changes_them():
    """Of a pitchfork it is the growth whose sign decides; what t drives has none."""
    t = np.linspace(0, 4, 30)
    run = Trajectory(t, np.stack([np.cos(t), np.exp(-t)], axis=1), ("x", "y"))
    pitchfork = {"x": parse("-0.3*x - x^3 + 0.4*x*y"), "y": parse("0.9 - 0.9*y")}
    picture = show_branches(Discovery(pitchfork, {}, {}, {}, (run,)))
    assert picture is not None and picture.svg.startswith("<svg")
    assert "1 stable -> 1 saddle, 2 stable" in picture.caption
    driven = Discovery({"x": parse("cos(t) - x")}, {}, {}, {}, (run.of_states(["x"]),))
    assert show_branches(driven) is None


@pytest.mark.slow
def test_a_report_does_not_wait_for_an_experiment_that_takes_long(monkeypatch):
    """What takes longer is named as a command of its own."""
    found = noisy_rabbits(0.05)
    doubtful = replace(found, verdict=replace(found.verdict, level="approximation"))

    def endless(*_, **__):
        until = time.monotonic() + 20
        while time.monotonic() < until:
            pass
        pytest.fail("nobody ended it")

    monkeypatch.setattr(Discovery, "suggest", endless)
    monkeypatch.setattr(discovery_report, "_SECONDS_TO_SUGGEST", 0.1)
    assert "dynsr suggest with the folder" in render_discovery(doubtful)
