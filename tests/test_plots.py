import re
from xml.etree import ElementTree

import numpy as np
import pytest

from dynsr.data.samples import Samples
from dynsr.data.trajectory import Trajectory
from dynsr.expression import parse
from dynsr.parameters import Profile
from dynsr.report import plots

T = np.linspace(0.0, 5.0, 60)
TRUE = Trajectory(T, np.column_stack([np.sin(T), np.cos(T)]), ("a", "b"))
FOUND = Trajectory(T, np.column_stack([np.sin(T) * 1.1, np.cos(T)]), ("a", "b"))


def panel(**found):
    """Give a panel of a sine and what was found."""
    return plots.Panel("Title", "a", T, np.sin(T), found, "m")


def test_a_panel_shows_the_truth_and_every_run():
    """Each curve holds the values given; each label stands once in the legend; axes have units."""
    runs = np.array([np.cos(T), np.sin(2 * T)])
    figure = plots.draw_panels([panel(One=runs, Two=np.sin(T)), panel(One=runs)])
    first, second = figure.axes
    lines = [line.get_ydata() for line in first.lines]
    np.testing.assert_array_equal(lines, [np.sin(T), *runs, np.sin(T)])
    assert len(second.lines) == 3
    assert (first.get_xlabel(), first.get_ylabel()) == ("time t (s)", "a (m)")
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["truth", "One", "Two"]


def test_no_two_methods_look_alike():
    """Curves of different methods differ in colour and in line style."""
    figure = plots.draw_panels([panel(**{f"m{k}": np.cos(T) for k in range(6)})])
    found = figure.axes[0].lines[1:]
    assert len({line.get_color() for line in found}) == 6
    assert len({str(line._dash_pattern) for line in found}) == 6


def test_a_run_that_runs_away_does_not_flatten_the_truth():
    """The axis stays near the truth when a curve explodes, ends or is not there at all."""
    wild = np.where(T > 3, np.nan, np.exp(5 * T))
    figure = plots.draw_panels([panel(Wild=wild, Lost=np.full_like(T, np.nan))])
    low, high = figure.axes[0].get_ylim()
    assert -1.2 < low <= -1 and 1 <= high < 3
    assert len(plots.to_bytes(figure)) > 5000


def test_states_are_drawn_with_intervals():
    """One panel a state: the data as points, the found curve as a line, the interval as a band."""
    band = {"a": (FOUND.x[:, 0] - 0.1, FOUND.x[:, 0] + 0.1)}
    figure = plots.draw_states(TRUE, FOUND, band)
    assert [axis.get_ylabel() for axis in figure.axes] == ["a", "b"]
    assert [len(axis.collections) for axis in figure.axes] == [1, 0]
    data, found = figure.axes[0].lines
    assert (data.get_marker(), data.get_linestyle(), found.get_linestyle()) == ("o", "None", "-")
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["data", "found", "interval"]
    assert len(plots.draw_states(TRUE).axes) == 2


def test_residuals_are_the_samples_less_the_prediction():
    """The points are y - prediction; a prediction that is not a number leaves a gap."""
    samples = Samples(T[:, None], np.sin(T), ("x",), "x", "given", T)
    predicted = np.where(T < 1, np.nan, np.cos(T))
    figure = plots.draw_residuals(samples, predicted)
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), np.sin(T) - predicted)


def test_a_phase_portrait_sets_one_state_against_another():
    """Its curves are the two columns asked for."""
    figure = plots.draw_phase_portrait(TRUE, FOUND, "b", "a")
    path = figure.axes[0].lines[0]
    np.testing.assert_array_equal(path.get_xydata(), TRUE.x[:, ::-1])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("b", "a")
    assert len(plots.draw_phase_portrait(TRUE, None, "a", "b").axes[0].lines) == 2


@pytest.mark.slow
def test_a_legend_is_as_long_as_its_words_ask_for():
    """Long names take more lines below the picture; none of it leaves the picture."""
    long = "substrate_concentration"
    equations = {
        "biomass_concentration": parse(f"{long} - 1"),
        long: parse("biomass_concentration"),
    }
    box = dict.fromkeys(equations, (-1.0, 2.0))
    figure = plots.draw_flow(equations, box)
    plots.to_bytes(figure)
    inside = figure.legends[0].get_window_extent()
    assert inside.x0 >= 0 and inside.x1 <= figure.bbox.width
    assert inside.y1 <= figure.axes[0].get_tightbbox().y0


def test_names_inside_a_picture_are_its_own():
    """Two pictures of one page share no name, and each finds the marks that it refers to."""
    svgs = [plots.to_svg(plots.draw_states(TRUE, FOUND), label) for label in ("one", "two")]
    names = [set(re.findall(r' id="([^"]*)"', svg)) for svg in svgs]
    assert names[0] and not names[0] & names[1]
    for svg, own in zip(svgs, names, strict=True):
        assert set(re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', svg)) <= {
            pair for name in own for pair in ((name, ""), ("", name))
        }


def test_a_long_title_is_in_lines_and_all_of_it_is_on_a_page():
    """The title of a profile is broken to the width of its picture; no word of it is lost."""
    grid = np.linspace(0.0, 2.0, 9)
    of = "biomass*substrate/(substrate + 1)"
    parts = ("", "biomass", 0, of, 1.0, grid, 4 * (grid - 1) ** 2, 0.5, 1.5, (0.5, 1.5), 1.0)
    own = Profile(*parts)
    root = ElementTree.fromstring(
        plots.to_svg(plots.draw_profiles([own, own]), "profiles").replace("xlink:href", "href")
    )
    lines = [text.text for text in root.iter("text")]
    title = " ".join(lines[lines.index("constant of") :][:3])
    assert title == f"constant of {of} in biomass'"
    assert "font-family" not in ElementTree.tostring(root, encoding="unicode")


def test_recovery_over_noise():
    """Rates from 0 to 1 over noise in percent, with a band where intervals are given."""
    figure = plots.draw_recovery(
        [0.0, 0.01, 0.1],
        {"SINDy": [1.0, 0.5, 0.0], "GA": [0.2, 0.1, 0.0]},
        {"SINDy": ([0.9, 0.3, 0.0], [1.0, 0.7, 0.1])},
    )
    axis = figure.axes[0]
    assert [t.get_text() for t in axis.get_xticklabels()] == ["0", "1", "10"]
    assert len(axis.lines) == 2 and len(axis.collections) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "head"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")]
)
def test_equal_figures_are_equal_files(kind, head):
    """The same picture drawn twice gives the same bytes, without date or version."""
    one, two = (plots.to_bytes(plots.draw_panels([panel(One=np.cos(T))]), kind) for _ in range(2))
    assert one == two and one.startswith(head)


def test_a_picture_of_a_page_is_one_element():
    """It is SVG of the page's own colour and letters, says what it shows, and repeats itself."""
    label = "A & B"
    one, two = (plots.to_svg(plots.draw_panels([panel(One=np.cos(T))]), label) for _ in range(2))
    assert one == two
    # Inside a page the name of the link's language needs no declaration.
    root = ElementTree.fromstring(one.replace("xlink:href", "href"))
    assert root.tag == "svg" and root.get("aria-label") == label
    assert "#000000" not in one and "currentColor" in one and "font-family" not in one
    assert "time t (s)" in [text.text for text in root.iter("text")]
    names = [node.get("id") for node in root.iter() if node.get("id")]
    assert names and all(f"#{name}" in one for name in names)


def test_a_method_has_one_colour_in_all_pictures():
    """A panel that lacks a method, and a picture of another panel, do not shift the colours."""
    first = plots.draw_panels([panel(One=np.cos(T), Two=np.sin(T)), panel(Two=np.cos(T))])
    alone = plots.draw_panels([panel(Two=np.cos(T))], ["One", "Two"])
    looks = [
        [(line.get_color(), str(line._dash_pattern)) for line in axis.lines[1:]]
        for axis in (*first.axes, *alone.axes)
    ]
    assert looks[1] == looks[2] == looks[0][1:]


def test_slopes_are_drawn_beside_what_the_equation_gives():
    """Dots are the samples' slopes; the line is the prediction, broken between trajectories."""
    t = np.concatenate([T, T])
    samples = Samples(t[:, None], np.sin(t), ("x",), "x", "given", t)
    dots, line = plots.draw_slopes(samples, np.cos(t)).axes[0].lines
    np.testing.assert_array_equal(dots.get_ydata(), np.sin(t))
    expected = np.cos(t)
    expected[len(T)] = np.nan
    np.testing.assert_array_equal(line.get_ydata(), expected)


def test_many_dots_become_a_density():
    """Beyond a number of dots their counts are drawn, all of them, and the line stays a line."""
    t = np.linspace(0, 50, 20_000)
    samples = Samples(t[:, None], np.sin(t), ("x",), "x", "given", t)
    figure = plots.draw_slopes(samples, np.cos(t))
    (density,) = figure.axes[0].collections
    assert np.ma.sum(density.get_array()) == 20_000
    assert [len(line.get_xdata()) for line in figure.axes[0].lines] == [0, plots.MOST_DOTS]
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["data", "equation"]
    few = plots.draw_slopes(Samples(T[:, None], T, ("x",), "x", "given", T), T)
    assert len(few.axes[0].collections) == 0 and len(few.axes[0].lines) == 2
