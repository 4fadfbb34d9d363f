import re
from html.parser import HTMLParser

import numpy as np
import pytest

from dynsr.discovery_report import render_discovery, to_mathml
from dynsr.expression import parse
from dynsr.found import Discovery
from dynsr.pareto import Candidate, ParetoFront
from dynsr.trajectory import Trajectory


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
    """Two equations, one picture each of states, phases and both residuals, and both fronts."""
    reader = Reader()
    reader.feed(page)
    assert reader.seen.count("math") == 2
    assert reader.seen.count("img") == 4
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
    assert "<img" not in page


def test_equations_are_mathml():
    """A quotient becomes a fraction, a power a superscript, and floats are short."""
    text = to_mathml("x", parse("9.810000001*x^2/(1 + y)"))
    assert "<mfrac>" in text and "<msup>" in text and "<mn>9.81</mn>" in text
