import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from fake_records import PRINTED, record

from dynsr.paper.page import render_replication, write_results
from dynsr.paper.results import all_tables
from dynsr.report.page import Picture, render_page
from dynsr.report.tables import Formula, Table

SETTINGS = {
    "seed": 5,
    "engine": "embedded",
    "quick": False,
    "recorded_steps": False,
    "version": "0.1.0",
}
STAGES = (
    {"stage": "polynomial", "formulas": 1, "best_loss": 0.25},
    {"stage": "network", "formulas": 0, "best_loss": None},
    {"stage": "symmetry", "formulas": 0, "best_loss": 0.5},
)


@pytest.fixture(scope="module")
def records():
    """Give records of two systems."""
    runs = [record(s, text, r) for s, some in PRINTED.items() for r, text in enumerate(some[2:], 1)]
    return [*runs, record("pendulum", "-9.81*sin(theta1)", method="sindy")]


class Page(HTMLParser):
    """Collects what a page holds, and fails on a tag that is not closed."""

    EMPTY = ("meta", "img", "br")

    def __init__(self, text):
        """Read a page."""
        super().__init__()
        self.open, self.links, self.images, self.tables, self.text = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        """Keep what the page refers to."""
        attrs = dict(attrs)
        self.links += [v for k, v in attrs.items() if k in ("href", "src", "srcset", "action")]
        if tag == "svg":
            self.images.append(attrs)
        if tag == "table":
            self.tables.append(attrs.get("id"))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        """Close the tag that is open."""
        assert self.open.pop() == tag

    def handle_data(self, data):
        """Keep the text."""
        self.text.append(data)


@pytest.mark.slow
def test_the_report_needs_nothing_but_itself(records):
    """Pictures are drawn in the page; there is no script, no style sheet and no address outside."""
    text = render_replication(records, SETTINGS)
    page = Page(text)
    assert all(link.startswith("#") for link in page.links)
    assert not re.search(r"<script|<link|@import|url\((?!#)|https?:", text)
    assert "default-src 'none'" in text
    assert len(page.images) == 3 and all(len(i["aria-label"]) > 40 for i in page.images)
    anchors = {link[1:] for link in page.links if link.startswith("#")}
    assert anchors <= set(re.findall(r'id="([^"]+)"', text))


@pytest.mark.slow
def test_the_report_shows_every_formula_and_where_it_comes_from(records):
    """Tables 1 and 2, the appendix in the paper's order, every formula, seed, engine, failures."""
    failed = [*records, replace(records[0], run=9, status="failed", error="a < b & c")]
    page = Page(render_replication(failed, SETTINGS))
    assert page.tables == ["table1", "table2", "losses", "appendix_ga_lotka-volterra",
                           "appendix_ga_cart-pole", "appendix_sindy_pendulum",
                           "made_by"]  # fmt: skip
    words = " ".join(page.text)
    for entry in records:
        assert entry.expression in words
    assert "2.13 ± 1.11" in words and "a < b & c" in words and "seed" in words
    assert "dynsr replicate --systems lotka-volterra,cart-pole,pendulum --methods ga,sindy" in words
    assert "2 methods on 3 systems" in words and "8 cells, 7 with a formula" in words


@pytest.mark.slow
def test_the_report_fits_a_phone_and_a_printer(records):
    """The page sets its width by the device, scrolls wide tables, and has rules for print."""
    text = render_replication(records, SETTINGS)
    assert 'name="viewport" content="width=device-width' in text
    assert "@media print" in text and "overflow-x: auto" in text
    assert text.count('<div class="scroll"') == text.count("<table")


def test_what_users_name_is_escaped():
    """Text from outside cannot become a tag, in tables, pictures or facts."""
    evil = "<script>alert(1)</script>"
    table = Table("t", evil, (evil,), ((Formula(evil),), (evil,)), evil)
    text = render_page(
        "replication.html.j2",
        summary=evil,
        quick=False,
        failures=[evil],
        table1=table,
        table2=[table],
        losses=[table],
        formulas=[table],
        stages=[table],
        made=[table],
        recorded_steps=False,
        pictures=[Picture("<svg></svg>", '"' + evil)],
        facts=[(evil, evil)],
    )
    assert "<script" not in text and text.count("&lt;script") >= 8


@pytest.mark.slow
def test_results_are_written_as_files(records, tmp_path):
    """Every table in three formats, the figure, the report; a second time they are the same."""
    paths = write_results(tmp_path, records, SETTINGS)
    assert all(path.stat().st_size > 50 for path in paths)
    names = {str(path.relative_to(tmp_path)) for path in paths}
    assert {"report.html", "figure1.png", "figure1.pdf", "tables/table1.tex"} <= names
    assert len(names) == 3 + 3 * 7
    before = {path: path.read_bytes() for path in paths}
    assert write_results(tmp_path, records, SETTINGS) == paths
    assert {path: path.read_bytes() for path in paths} == before


def test_nothing_to_draw_is_still_a_report(tmp_path):
    """With no system of Figure 1, and with failures alone, a report is written without it."""
    failed = replace(record("pendulum", "theta1"), status="failed", error="no luck")
    paths = write_results(tmp_path, [failed], SETTINGS)
    assert not any("figure1" in path.name for path in paths)
    assert "no luck" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("recorded_steps", [False, True])
def test_the_report_says_what_the_replication_is(records, recorded_steps):
    """Coinciding runs, the reconstructed GA, the withheld force and the steps stand in words."""
    settings = {**SETTINGS, "recorded_steps": recorded_steps}
    text = " ".join(Page(render_replication(records, settings)).text)
    for words in ("one result", "our reconstruction", "withheld", "1642.3124"):
        assert words in text
    assert ("the solver's own steps" in text) is not recorded_steps
    command = text.partition("dynsr replicate --systems")[2].partition("--engine")[0]
    assert ("--recorded-steps" in command) is recorded_steps


@pytest.mark.slow
def test_the_report_names_the_stage_of_each_run_and_what_the_others_came_to(records):
    """The stage stands beside its formula; a stage that did not win has its best fit."""
    found = record("pendulum", "theta1", method="dynaifeynman", source="polynomial", stages=STAGES)
    runs = [*records, found, replace(found, run=2)]
    page = Page(render_replication(runs, SETTINGS))
    assert page.tables[-2] == "stages_dynaifeynman_pendulum"
    table = next(t for t in all_tables(runs) if t.name == page.tables[-2])
    assert [row[:3] for row in table.rows] == [
        ("polynomial", 2, "1, 1"),
        ("network", 2, "0, 0"),
        ("symmetry", 2, "0, 0"),
    ]
    assert [str(row[3]) for row in table.rows] == ["0.25 ± 0", "", "0.5 ± 0"]
    assert [row[4] for row in table.rows] == [2, 0, 0]
    assert "± 0 (deterministic)" in " ".join(page.text)
