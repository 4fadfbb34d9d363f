import html
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest

from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.report.discovery import place_front, render_discovery


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


def test_the_page_stands_alone(page):
    """Nothing is loaded from elsewhere: every source is inside the page."""
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert all(link.startswith(("data:", "#")) for link in reader.links)


def test_the_page_holds_equations_pictures_and_fronts(page):
    """Two equations; pictures of states, phases, flow, slopes and residuals of each; two fronts."""
    reader = Reader()
    reader.feed(page)
    assert page.count('class="equation"') == reader.seen.count("math") == 2
    assert page.count('<svg class="picture"') == 7
    assert len(re.findall(r'class="front"', page)) == 2
    assert "1.0001*y" in page


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
    assert "because &lt;it&gt; is shorter" in shown
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


def test_constants_and_intervals_stand_below_each_equation(page):
    """The table of a state's constants comes before what the verdict rests on and all pictures."""
    table = re.search(r'<table id="constants-y".*?</table>', page, re.DOTALL)
    assert table is not None and table.start() < page.index('id="fronts"')
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", table[0])
    assert cells[:2] == ["x", "-1"]
    low, high = map(float, cells[2].split(" to "))
    assert low == pytest.approx(-1 - 1.96 * 0.01, abs=1e-3)
    assert high == pytest.approx(-1 + 1.96 * 0.01, abs=1e-3)
    assert 'id="constants-x"' not in page


def test_a_choice_off_its_front_is_told():
    """Above it the formula is named that is no longer and misses less, else that constants were
    fitted later; on the front there is no note.
    """
    front = ParetoFront([Candidate(parse("x"), 0.5, 2.0), Candidate(parse("sin(x)"), 0.1, 4.0)])
    above = place_front(front, Candidate(parse("2*x"), 0.3, 5.0, "polishing"))
    assert above.note.startswith("The chosen formula is above the front: sin(x) is no longer")
    assert "4 bits, RMSE 0.1" in above.note
    for loss, bits in ((0.3, 3.0), (0.1001, 4.0)):
        beside = place_front(front, Candidate(parse("2*x"), loss, bits))
        assert beside.note.startswith("The chosen formula is off the front")
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


def test_trajectories_that_are_not_drawn_are_counted(found):
    """Of five trajectories three are drawn, and the page says that two more are there."""
    page = render_discovery(replace(found, trajectories=found.trajectories * 5))
    assert "2 more are in the data" in page and "Trajectory 3" in page
    assert "Trajectory 4" not in page


def test_every_format_is_offered_as_a_file(found):
    """Each link holds the text that the export writes, under a name that hides no package."""
    page = render_discovery(found)
    links = re.findall(r'<a href="data:text/plain;charset=utf-8,([^"]*)" download="([^"]*)"', page)
    files = {file: unquote(html.unescape(text)) for text, file in links}
    assert {"found_python.py", "found_control.py", "found_c.c", "found_latex.tex"} <= {*files}
    assert files["found_control.py"] == found.export("control")
    assert files["found_julia.jl"] == found.export("julia")
    assert "found_petab.zip" not in files
