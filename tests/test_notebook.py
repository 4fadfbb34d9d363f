"""What a notebook shows: pictures and tables in the first cell, progress that goes when it ends."""

import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import dynsr
from dynsr.discovery.result import Discovery
from dynsr.expression.parsing import parse
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.jobs.display import NotebookProgress, in_notebook
from dynsr.jobs.progress import Running, Step
from dynsr.report.discovery import render_discovery

T = np.arange(0, 5, 0.05)
RUN = dynsr.Trajectory(T, np.exp(-T)[:, None], ("x",), origin={"time_unit": "days"})
FRONT = ParetoFront([Candidate(parse("-x"), 0.1, 8.0, "<b>"), Candidate(parse("-x/3"), 0.01, 9.0)])


@pytest.fixture
def found():
    """Give a discovery of daily data."""
    settings = {"time_unit": "days", "engine": "embedded", "seed": 0}
    equations = {"x": parse("-x")}
    return Discovery(equations, {"x": ()}, {"x": FRONT}, {}, (RUN,), settings=settings)


class Place:
    """A place in a cell: what was shown there, in order."""

    def __init__(self):
        self.shown = []

    def update(self, data, raw):
        """Take what is shown."""
        assert raw
        self.shown.append(data)


@pytest.fixture
def kernel(monkeypatch):
    """Let IPython say that this is a kernel; give the place that its display makes."""
    place = Place()
    module, display = ModuleType("IPython"), ModuleType("IPython.display")
    module.get_ipython = lambda: SimpleNamespace(kernel=object())
    display.display = lambda data, raw, display_id: place.update(data, raw) or place
    monkeypatch.setitem(sys.modules, "IPython", module)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return place


def test_a_plot_is_a_picture_without_pyplot(found):
    """The figure itself gives the PNG that a notebook asks for."""
    assert found.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_front_is_a_table_of_formulas(found):
    """Each formula is LaTeX in a row with its place, bits, error and escaped source."""
    shown = found.front["x"]._repr_html_()
    assert shown.count("<tr>") == 3 and r"$- \frac{x}{3}$" in shown
    assert "<td>0</td><td>8</td><td>0.1</td>" in shown and "&lt;b&gt;" in shown


def test_a_discovery_is_a_table_with_its_unit(found):
    """The equation is LaTeX and text, and the unit of the time stands below."""
    shown = found._repr_html_()
    assert r"$\displaystyle \dot{x} = - x$" in shown and "<code>x' = -x</code>" in shown
    assert "The time is in days." in shown
    assert "days" not in found._repr_latex_()


def test_report_and_exports_say_the_unit(found):
    """Axes, summary and code have days; seconds stand nowhere that they are not known."""
    page = render_discovery(found)
    assert page.count("time t (days)") >= 3 and "time t (s)" not in page
    assert "from t = 0 to 4.95 days" in page
    for code in (found.to_python(), found.to_julia()):
        assert "# The time t is in days." in code
    assert "% time in days" in found.latex()


def test_a_unit_from_a_foreign_file_is_no_code(found):
    """A unit of time that is none, as a file edited by hand may hold, stands in no export."""
    evil = replace(found, settings={**found.settings, "time_unit": "days\\nimport os"})
    assert evil.time_unit == ""
    assert "import os" not in evil.to_python() + evil.to_julia() + evil.latex()


def test_progress_in_a_notebook_goes_when_it_ends(kernel):
    """Lines of running tasks are drawn in place, escaped, and the place is empty afterwards."""
    assert in_notebook()
    running = (Running("a", "x' by <a>", "stage", 1.0, 4.0, "2*x"),)
    with NotebookProgress() as progress:
        progress(Step("", 1, 4, None, "", running, 75.0, 65.0))
        drawn = kernel.shown[-1]["text/html"]
        assert "1 of 4 tasks" in drawn and "1:15" in drawn and "x&#x27; by &lt;a&gt;" in drawn
        progress(Step("", 2, 4, None, "", (), 80.0, 60.0))
        assert "by &lt;a&gt;" not in kernel.shown[-1]["text/html"]
    assert kernel.shown[-1] == {"text/html": "", "text/plain": ""}


@pytest.mark.slow
def test_a_discovery_shows_progress_in_a_notebook_by_itself(kernel):
    """Without a word there are lines; False asks for none, a function takes their place."""
    data, quick = (T, np.exp(-T)), {"preset": "quick", "functions": (), "jobs": 1}
    dynsr.discover(data, **quick)
    assert any("tasks" in one["text/html"] for one in kernel.shown)
    assert kernel.shown[-1]["text/html"] == ""
    kernel.shown.clear()
    dynsr.discover(data, progress=False, **quick)
    dynsr.discover(data, progress=lambda step: None, **quick)
    assert kernel.shown == []


@pytest.mark.slow
def test_no_notebook_no_lines(capsys):
    """In a script nothing is shown unless it is asked for, and never where nobody watches."""
    assert not in_notebook()
    data, quick = (T, np.exp(-T)), {"preset": "quick", "functions": (), "jobs": 1}
    dynsr.discover(data, **quick)
    dynsr.discover(data, progress=True, **quick)
    assert capsys.readouterr() == ("", "")


CELL = """
import numpy as np, dynsr
t = np.arange(0, 5, 0.02)
x = np.column_stack([np.sin(t), np.cos(t)])
found = dynsr.discover((t, x), preset="quick", functions=(), jobs=2)
found.plot()
"""


@pytest.mark.slow
def test_a_kernel_runs_the_first_cell():
    """In a real kernel, with workers: a picture, a table, and an empty place where progress was."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    book = nbformat.v4.new_notebook()
    book.cells = [nbformat.v4.new_code_cell(code) for code in (CELL, "found", "found.front['x']")]
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3").execute()
    place, picture = book.cells[0].outputs
    assert place.data == {"text/html": "", "text/plain": ""}
    assert "image/png" in picture.data
    assert r"\dot{x} = y" in book.cells[1].outputs[0].data["text/html"]
    assert book.cells[2].outputs[0].data["text/html"].startswith("<table>")


def test_equations_with_named_parameters_are_shown(found):
    """The system of a discovery is formulas with names, above the table of their values."""
    shown = found.rename({"k1": "rate"}).system._repr_html_()
    assert r"$\displaystyle \dot{x} = - \mathrm{rate} \, x$" in shown
    assert shown.endswith("</table>") and "<td>rate</td><td>1</td>" in shown
