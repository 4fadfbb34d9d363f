"""The documentation is whole: every public name, every option, every link, every example."""

import ast
import importlib
import importlib.util
import inspect
import io
import json
import re
import runpy
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
import typer

import dynsr
from dynsr.cli.app import app

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [*DOCS.rglob("*.md"), ROOT / "README.md"]
NOTEBOOKS = sorted((DOCS / "gallery").glob("*.ipynb"))
SLOW = ("noisy", "hybrid")
PROSE = [page for page in PAGES if page.parent.name != "api"]


def find(path):
    """Give what a dotted path names: the longest module of it, and attributes from there."""
    parts = path.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:k]))
        except ImportError:
            continue
        for name in parts[k:]:
            found = getattr(found, name)
        return found
    raise AssertionError(path)


def reference():
    """Give the paths that the reference shows."""
    text = "".join(page.read_text("utf-8") for page in (DOCS / "api").glob("*.md"))
    return re.findall(r"^::: (\S+)$", text, re.MULTILINE)


def is_shown(named):
    """Whether something, or the module that it is an error of, is in the reference."""
    shown = [find(path) for path in reference()]
    modules = {found.__name__ for found in shown if inspect.ismodule(found)}
    return any(named is found for found in shown) or getattr(named, "__module__", "") in modules


def test_every_public_name_is_in_the_reference():
    """What ``dynsr`` exports, its version aside, is on a page of the reference, once."""
    missing = [n for n in dynsr.__all__ if n != "__version__" and not is_shown(getattr(dynsr, n))]
    assert missing == []
    assert "dynsr.__version__" in (DOCS / "api" / "index.md").read_text("utf-8")
    assert len(reference()) == len(set(reference()))


def test_what_other_pages_name_is_in_the_reference():
    """Names of rooms that pages speak of or import are ones that a reader can look up."""
    named = set()
    for page in PROSE:
        text = page.read_text("utf-8")
        named |= set(re.findall(r"`(dynsr\.[a-z]+\.[A-Za-z]\w+)`", text))
        for block in re.findall(r"```python[^\n]*\n(.*?)```", text, re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dynsr."):
                    named |= {f"{node.module}.{alias.name}" for alias in node.names}
    assert len(named) > 15
    found = {path: find(path) for path in sorted(named)}
    assert [p for p, one in found.items() if not inspect.ismodule(one) and not is_shown(one)] == []


def test_the_table_of_options_is_complete():
    """Each parameter of the call and each option of its command is in the table, with a meaning."""
    text = (DOCS / "options.md").read_text("utf-8")
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    assert all(row[-1].strip(" |") for row in rows)
    said = " ".join(row[0] + " " + row[1] for row in rows)
    for name in inspect.signature(dynsr.discover).parameters:
        assert re.search(rf"`{name}[=`]", said), name
    command = typer.main.get_command(app).commands["discover"]
    options = [o for p in command.params if p.param_type_name == "option" for o in p.opts]
    assert len(options) > 25
    assert [option for option in options if f"`{option}`" not in said] == []


def test_the_table_of_options_is_what_the_code_says(monkeypatch):
    """Written again from signature, docstring and command, the page stays as it is."""
    monkeypatch.setattr(sys, "argv", ["options", "--check"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "scripts" / "options"), run_name="__main__")
    assert end.value.code is None


def test_the_gallery_is_whole():
    """At least twelve examples with a picture, three of them notebooks, all on its first page."""
    index = (DOCS / "gallery" / "index.md").read_text("utf-8")
    examples = {p.name for p in (DOCS / "gallery").iterdir() if p.suffix in (".md", ".ipynb")}
    examples.remove("index.md")
    assert len(examples) >= 12 and len(NOTEBOOKS) >= 3
    assert set(re.findall(r"\]\(([\w-]+\.(?:md|ipynb))\)", index)) == examples
    for name in examples:
        picture = (DOCS / "gallery" / name).with_suffix(".png")
        assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size < 100_000
        text = (DOCS / "gallery" / name).read_text("utf-8")
        begins = (*text.split("\n\n"), "")[1].replace("\n", " ")
        shown = begins.startswith("![") and begins.endswith(f"]({picture.name})")
        assert "discover(" in text and (name.endswith(".ipynb") or shown)


@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in SLOW))
        for path in NOTEBOOKS
    ],
)
def test_a_notebook_gives_what_it_holds(notebook):
    """Each cell ends well, prints what is kept but for last digits, and shows what it ends in."""
    scope = {"__name__": "__notebook__"}
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        kept = [out for out in cell["outputs"] if out["output_type"] != "stream"]
        printed = ["".join(out["text"]) for out in cell["outputs"] if "text" in out]
        tree, last = ast.parse("".join(cell["source"])), None
        if isinstance(tree.body[-1], ast.Expr):
            last = ast.Expression(tree.body.pop().value)
        said = io.StringIO()
        with redirect_stdout(said):
            exec(compile(tree, notebook, "exec"), scope)
            value = eval(compile(last, notebook, "eval"), scope) if last else None
        assert without_digits(said.getvalue()) == without_digits("".join(printed))
        for out in kept:
            assert out["output_type"] == "execute_result"
            form = "html" if "text/html" in out["data"] else "png"
            assert getattr(value, f"_repr_{form}_")()


def without_digits(text):
    """Give a text with its numbers as their sign and size alone."""
    return re.sub(r"\d+\.?\d*(e[+-]?\d+)?", lambda n: f"{float(n[0]):.1g}", text)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_of_the_repository_lead_somewhere(name):
    """A relative link outside the site, which its own check does not see, names a file."""
    text = (ROOT / name).read_text("utf-8")
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)[^)]*\)", text)
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_address_of_an_index_is_nowhere():
    """dynsr is on no index: pages install it from its repository."""
    for page in PAGES:
        assert not re.search(r"^pip install dynsr", page.read_text("utf-8"), re.MULTILINE), page


def rewrite(text, owner=""):
    """Load the extension of the reference, and rewrite a docstring with it."""
    pytest.importorskip("griffe")
    path = ROOT / "scripts" / "site" / "docstrings.py"
    spec = importlib.util.spec_from_file_location("docstrings", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.rewrite(text, "dynsr.data", owner)


def test_the_reference_reads_docstrings_as_numpydoc():
    """Text goes below its name, prose before the list, examples to their own section."""
    given = (
        "Sum.\n\n::\n\n    tree\n\nParameters\n----------\n"
        "a, b : numbers,\n    two of them.\n**more : others.\n\n"
        "Raises InputError.\n\n>>> add(1, 2)\n3\n"
    )
    wanted = (
        "Sum.\n\n    tree\n\nRaises InputError.\n\nParameters\n----------\na, b\n    numbers,\n"
        "    two of them.\n**more\n    others.\n\nExamples\n--------\n>>> add(1, 2)\n3"
    )
    assert rewrite(given).strip() == wanted


def test_references_of_docstrings_become_links():
    """A path is a link to it; a short name is one in its module, a method one in its class."""
    text = rewrite("See :func:`dynsr.discover`, :func:`smooth` and :meth:`fit`.", "dynsr.data.A")
    assert re.findall(r'identifier="([^"]*)"', text) == [
        "dynsr.discover",
        "dynsr.data.smooth",
        "dynsr.data.A.fit",
    ]
