"""The order of the rooms: a room takes only from those before it, and only what they offer.

A file may import files of its own room by their full names; of another room, what its
``__init__`` exports.
"""

import ast
import inspect
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import dynsr

PACKAGE = Path(dynsr.__file__).parent

# The order in which `ls dynsr` reads as the theory; a room imports only from rooms before it.
ROOMS = (
    "errors",
    "arguments",
    "expression",
    "data",
    "engines",
    "fit",
    "methods",
    "library",
    "selection",
    "jobs",
    "verdict",
    "parameters",
    "discovery",
    "export",
    "report",
    "paper",
    "checks",
    "benchmarks",
    "app",
    "cli",
)

# Rooms that are one file, and have no door.
FILES_ALONE = ("errors", "arguments")

# (file, room it takes from against the order) -> why. A line that nothing needs fails.
EXCEPTIONS = {
    ("discovery/result.py", "report"): "Discovery.plot and .report are the result's own verbs",
    ("parameters/profile.py", "report"): "Profile.plot is the profile's own verb",
    ("parameters/by_run.py", "report"): "RunParameters.plot is the table's own verb",
    ("parameters/free_parts.py", "report"): "FreePart.plot is the function's own verb",
    ("parameters/suggesting.py", "report"): "Suggestion.plot is the suggestion's own verb",
    ("engines/equilibria.py", "report"): "Branches.plot is the branches' own verb",
    ("discovery/batch.py", "report"): "a batch leaves a page of its files",
    ("discovery/result.py", "export"): "Discovery.export is the result's own verb",
}

# Room -> names that were exported by discovery.
MOVED = {
    "parameters": [
        *("Alternative", "Cells", "Constant", "Delay", "DelaySettings", "Diffusion"),
        *("DiffusionTerm", "Experiment", "FreePart", "FreeParts", "FreeSettings"),
        *("Identifiability", "IdentifiabilitySettings", "Parameter", "Parameters"),
        *("ParametricSystem", "Profile", "RunParameters", "Suggestion", "SuggestionSettings"),
        *("VarySettings", "cells_of", "identifiability", "write_interval"),
    ],
    "verdict": [
        *("OtherFormula", "Score", "StateVerdict", "TermCertainty", "Verdict", "VerdictSettings"),
        *("equation_rmse", "iterate", "pair_rows", "predict", "score_expressions"),
        *("trajectory_loss", "trajectory_losses", "write_map_latex", "write_map_mathml"),
    ],
}

# Foreign module -> the only files that may import it, by name.
HOMES = {
    "torch": {
        "methods/feynman/network.py",
        "methods/feynman/enumeration/backend.py",
        "discovery/hybrid.py",
    },
    "matplotlib": {"report/plots.py"},
    "tornado": {"app/serving.py"},
    "libsbml": {"export/sbml.py", "export/sbml_units.py", "export/from_sbml.py"},
    "casadi": {"export/objects.py"},
    "control": {"export/objects.py"},
    "do_mpc": {"export/objects.py"},
    "juliacall": {"engines/julia/worker.py"},
    "juliapkg": {"engines/julia/setup.py"},
    "diffeqpy": {"engines/julia/worker.py"},
}

FILES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))


def imports_of(tree: ast.AST, types: bool = False) -> Iterator[tuple[str, str, int]]:
    """Give (module, name or "", line) of every import anywhere in a file; of types if asked."""
    nodes = [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and not types and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        nodes.extend(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, "", node.lineno
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute here"
            for alias in node.names:
                yield node.module or "", alias.name, node.lineno


def doors() -> dict[str, dict[str, str]]:
    """Give room -> name that it exports -> the module that holds it, from the rooms' stubs."""
    found = {}
    for room in ROOMS:
        if room not in FILES_ALONE:
            stub = ast.parse((PACKAGE / room / "__init__.pyi").read_text())
            lines = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
            found[room] = {a.name: f"dynsr.{room}.{n.module}" for n in lines for a in n.names}
    return found


def room_of(file: str) -> str:
    """Give the room of a file below dynsr."""
    return file.partition("/")[0].removesuffix(".py")


def faults_of(file: str, tree: ast.AST) -> list[str]:
    """Say which imports of a file break the order."""
    room, faults = room_of(file), []
    place = ROOMS.index(room)
    for module, name, line in imports_of(tree):
        first, *rest = module.split(".")
        if first in HOMES and file not in HOMES[first]:
            faults.append(f"{file}:{line} imports {first}; its home is {sorted(HOMES[first])}")
        if first != "dynsr" or (not rest and name == "__version__"):
            continue
        other = rest[0] if rest else name
        if other not in ROOMS:
            faults.append(f"{file}:{line} imports {other}, which is no room")
        elif other != room and len(rest) > 1:
            faults.append(f"{file}:{line} reaches into {module}; take it from dynsr.{other}")
        elif ROOMS.index(other) > place and (file, other) not in EXCEPTIONS:
            faults.append(f"{file}:{line} imports {other}, a later room")
        elif other == room and len(rest) == 1 and f"{room}/{name}.py" not in FILES:
            faults.append(f"{file}:{line} takes {name} of its own room through its __init__")
    return faults


@pytest.mark.parametrize("file", [f for f in FILES if not f.startswith("__")])
def test_a_file_imports_only_from_rooms_before_its_own(file):
    """Every file has a room, takes from earlier ones at their doors, and leaves foreigners home."""
    assert faults_of(file, ast.parse((PACKAGE / file).read_text())) == []


@pytest.mark.parametrize(
    ("file", "source", "words"),
    [
        ("errors.py", "from dynsr.cli import main", "imports cli, a later room"),
        ("data/system.py", "def f():\n    import dynsr.fit", "imports fit, a later room"),
        ("fit/flow.py", "from dynsr.data.system import System", "reaches into dynsr.data.system"),
        ("report/page.py", "import matplotlib.pyplot", "its home is"),
        ("methods/sindy.py", "from torch import nn", "its home is"),
        ("data/samples.py", "from dynsr import report", "imports report, a later room"),
        ("data/samples.py", "from dynsr.data import System", "through its __init__"),
        ("checks/doctor.py", "import dynsr.helpers", "which is no room"),
    ],
)
def test_what_breaks_the_order_is_found(file, source, words):
    """The check itself finds each kind of fault, at any depth of a file."""
    assert any(words in fault for fault in faults_of(file, ast.parse(source)))


def test_every_exception_is_needed():
    """An exception to the order stands only as long as the import that needs it."""
    for file, other in EXCEPTIONS:
        taken = imports_of(ast.parse((PACKAGE / file).read_text()))
        assert any(module == f"dynsr.{other}" for module, _, _ in taken), (file, other)


def test_a_foreign_module_is_used_where_it_is_at_home():
    """Every file that HOMES names imports what it is the home of."""
    for foreign, files in HOMES.items():
        for file in files:
            taken = imports_of(ast.parse((PACKAGE / file).read_text()))
            assert any(m.split(".")[0] == foreign for m, _, _ in taken), (file, foreign)


@pytest.mark.slow
def test_no_import_is_circular():
    """Files import one another in no circle, wherever the import stands, for types too."""
    graph: dict[str, set[str]] = {}
    homes = doors()
    for file in FILES:
        name = ("dynsr." + file.removesuffix(".py").replace("/", ".")).removesuffix(".__init__")
        mine = graph.setdefault(name, set())
        for module, taken, _ in imports_of(ast.parse((PACKAGE / file).read_text()), types=True):
            room = module.removeprefix("dynsr.")
            if module.startswith("dynsr.") and (file, room) not in EXCEPTIONS:
                inner = f"{room}.{taken}".replace(".", "/") + ".py"
                mine.add(
                    f"{module}.{taken}"
                    if inner in FILES
                    else homes.get(room, {}).get(taken, module)
                )
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


@pytest.mark.slow
def test_a_room_exports_what_others_take():
    """Every name at a room's door is taken by another room, is public, or is said in the docs."""
    taken = {
        (module.removeprefix("dynsr."), name)
        for file in FILES
        for module, name, _ in imports_of(ast.parse((PACKAGE / file).read_text()), types=True)
    }
    docs = "".join(p.read_text() for p in (PACKAGE.parent / "docs").rglob("*.md"))
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    public = {a.name for n in stub.body if isinstance(n, ast.ImportFrom) for a in n.names}
    idle = [
        (room, name)
        for room, names in doors().items()
        for name in names
        if (room, name) not in taken and name not in public and name not in docs
    ]
    assert idle == []


@pytest.mark.parametrize(("name", "room"), [(name, room) for room in MOVED for name in MOVED[room]])
def test_what_moved_is_given_where_it_was(name, room):
    """What users import from ``dynsr.discovery`` is there, though another room has it."""
    moved = getattr(import_module(f"dynsr.{room}"), name)
    assert getattr(import_module("dynsr.discovery"), name) is moved


def test_what_never_was_in_a_room_is_no_name_of_it():
    """A name that no room has is an AttributeError that names the room that was asked."""
    with pytest.raises(AttributeError, match=r"dynsr\.discovery.*verdicts"):
        _ = import_module("dynsr.discovery").verdicts


def test_the_rooms_are_what_the_folder_holds():
    """Beside the rooms, ``dynsr`` holds a start and what packaging needs."""
    found = {p.name.removesuffix(".py") for p in PACKAGE.iterdir()} - {"__pycache__"}
    others = {"__init__", "__init__.pyi", "__main__", "py.typed"}
    assert found == {*ROOMS, *others}


def test_contributing_maps_the_rooms_in_their_order():
    """The table of CONTRIBUTING.md names every room, in the order that imports follow."""
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
    rows = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")]
    assert tuple(row.removesuffix(".py").rstrip("/") for row in rows[: len(ROOMS)]) == ROOMS


def test_the_tour_follows_one_csv_through_files_that_are_there():
    """The tour of CONTRIBUTING.md has at most 15 files, and each holds what the tour says."""
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
    tour = text.partition("### Follow one CSV")[2]
    rows = [line.split("`") for line in tour.splitlines() if line.startswith("| `")]
    assert 10 <= len(rows) <= 15
    for row in rows:
        source = (PACKAGE / row[1]).read_text()
        if len(row) > 3:
            assert f"def {row[3]}(" in source or f"class {row[3]}" in source, row


@pytest.mark.parametrize("room", [r for r in ROOMS if r not in FILES_ALONE])
def test_no_module_shares_a_name_with_what_its_room_exports(room):
    """What a room exports is what the attribute of that name is: no module hides behind it."""
    door = import_module(f"dynsr.{room}")
    files = {p.stem for p in (PACKAGE / room).iterdir()}
    assert files.isdisjoint(getattr(door, "__all__", ()))
    for name in getattr(door, "__all__", ()):
        assert not isinstance(getattr(door, name), ModuleType)
    assert files.isdisjoint(dynsr.__all__) or room == "cli"


def described(name: str, function: object, text: str) -> list[str]:
    """Give the parameters of a callable that its text does not name."""
    parameters = inspect.signature(function).parameters.values()
    named = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD and p.name != "self"]
    return [f"{name}: {n}" for n in named if not re.search(rf"\b{re.escape(n)}\b", text)]


@pytest.mark.parametrize("name", [n for n in dynsr.__all__ if callable(getattr(dynsr, n))])
def test_every_parameter_of_what_is_public_is_described(name):
    """Docstrings of public functions, classes and their methods name each parameter."""
    public = getattr(dynsr, name)
    missing = []
    if not (inspect.isclass(public) and issubclass(public, Exception)):
        missing += described(name, public, public.__doc__ or "")
    for own, method in vars(public).items() if inspect.isclass(public) else ():
        function = getattr(method, "__func__", method)
        if not own.startswith("_") and inspect.isfunction(function):
            # What a method of the base says holds for those that do the same.
            said = [getattr(base, own, None) for base in public.__mro__]
            text = " ".join(inspect.getdoc(f) or "" for f in said if f is not None)
            missing += described(f"{name}.{own}", getattr(public, own), text)
    assert missing == []
