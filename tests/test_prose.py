"""The prose of pages, messages and docstrings is checked by rules that can be relied on."""

import importlib.util
import re
import runpy
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def prose():
    """Load the script as a module."""
    pytest.importorskip("tomllib")
    loader = SourceFileLoader("prose", str(ROOT / "scripts" / "prose"))
    spec = importlib.util.spec_from_loader("prose", loader)
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def faults(prose, text, name="page.md"):
    """Give the words that are found in a text."""
    pieces = prose.READERS[Path(name).suffix](text)
    return [fault for _, piece in pieces for _, fault in prose.find_words(piece, name)]


@pytest.mark.parametrize(
    "text",
    [
        "The held input keeps its value, and held-back rows test it.",
        "ODE stands for ordinary differential equation.",
        "A process hangs. The standard error of column `misses` is here.",
        "The trajectory misses no row.",
        "It downloads Julia if there is none, and reports what was left out.",
        "    what is left, told and held in a block of code",
        "```python\nrivals = held  # told\n```",
        "A formula \\(held + told\\) is not read.",
    ],
)
def test_plain_words_stay(prose, text):
    """Legitimate senses of a word, code and formulas are no fault."""
    assert faults(prose, text) == []


@pytest.mark.parametrize(
    "text",
    [
        "It was told.",
        "The file\nholds the data.",
        "The unit stands in the report.",
        "This mends it.",
        "What is left over\nis noise.",
        "A term *beside* another.",
        "Squared misses count.",
        "It cannot be told apart.",
        "| a | b |\n|---|---|\n| x | its rival |",
    ],
)
def test_private_words_are_found(prose, text):
    """Each is found once or more, across line ends and in tables too."""
    assert faults(prose, text)


def test_messages_and_docstrings_are_read(prose):
    """Texts of three words or more of Python are prose; names and code in them are not."""
    text = (
        'def f():\n    """Say what is left over of it."""\n    g("held", f"the {1} is told here")\n'
    )
    assert len(faults(prose, text, "a.py")) == 2
    assert faults(prose, 'def f():\n    """Give one of ``is told here`` things."""\n', "a.py") == []


def test_pages_and_templates_are_read_between_their_tags(prose):
    """What a reader sees is prose; tags, scripts, styles and the template's own words are not."""
    text = "<p title='held as'>It is told.</p>\n<script>told</script>{{ held_as }}<b>A rival</b>"
    assert len(faults(prose, text, "a.html")) == len(faults(prose, text, "a.j2")) == 2
    lines = [line for line, _ in prose.read_html("<p>one\n</p>\n<style>a\nb</style>\n<b>two</b>")]
    assert lines == [1, 5]


def test_the_subject_of_a_commit_is_checked(tmp_path, monkeypatch, capsys):
    """Its first line alone, before the commit is made or while it can still be changed."""
    pytest.importorskip("tomllib")
    message = tmp_path / "message"
    for text, code in (("It is told\n", 1), ("It is reported\n\nIt was told.\n", None)):
        message.write_text(text)
        monkeypatch.setattr(sys, "argv", ["prose", "--message", str(message)])
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(ROOT / "scripts" / "prose"), run_name="__main__")
        assert end.value.code == code
    assert "subject: 'told' -> reported" in capsys.readouterr().out


def test_long_sentences_and_paragraphs_are_found(prose):
    """A sentence and a paragraph have a number of words that they may have."""
    longest = prose.CONFIG["longest_sentence"]
    assert not list(prose.measure("word " * longest))
    assert len(list(prose.measure("word " * (longest + 1)))) == 1
    assert len(list(prose.measure("Four words are here. " * 100))) == 1


def test_a_find_has_its_line(prose, tmp_path, monkeypatch):
    """The line of the word itself is printed, not that where its paragraph begins."""
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("# Title\n\nOne line\nand it was told.\n")
    assert [line for line, _ in prose.check(page)] == [4]


def test_every_file_is_checked(prose):
    """A new page or module is checked from its first day; each pattern of the list matches one."""
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "dynsr").rglob("*.py")]
    listed = set(prose.listed())
    names = [file.relative_to(ROOT).as_posix() for file in files if file not in listed]
    assert names == []


def test_each_rule_is_in_the_list_of_words(prose):
    """CONTRIBUTING.md names the word of every rule and what to write in its place."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    table = text.partition("| term | meaning | not |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`([^`]+)`", table))
    words = {rule["word"] for rule in prose.CONFIG["rules"]}
    assert words - named - {"before and after"} == set()


def test_the_script_ends_with_1_where_something_is_found(tmp_path, monkeypatch, capsys):
    """It prints the fault with its remedy."""
    pytest.importorskip("tomllib")
    page = tmp_path / "page.md"
    page.write_text("It was told.\n")
    monkeypatch.setattr(sys, "argv", ["prose", str(page)])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "scripts" / "prose"), run_name="__main__")
    assert end.value.code == 1
    assert "page.md:1: 'told' -> reported" in capsys.readouterr().out
