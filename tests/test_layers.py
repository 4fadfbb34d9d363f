"""The order of the parts: a file imports only from smaller layers.

A new file or folder directly under ``dynsr`` gets its place in :data:`LAYERS`. Files of one folder
may import one another; two parts of one layer only where :data:`WITHIN` names the pair.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import dynsr

PACKAGE = Path(dynsr.__file__).parent

LAYERS = {
    **dict.fromkeys(("errors", "expression", "definitions", "writing"), 0),
    **dict.fromkeys(("system", "trajectory", "samples", "pareto", "catalogue"), 1),
    # Smoothers and derivative schemes of samples; tables of the user's read as trajectories.
    **dict.fromkeys(("smoothers", "derivatives"), 1),
    **dict.fromkeys(
        ("columns", "delimited", "roles", "sources", "table_checks", "tabular", "intake"), 1
    ),
    "engines": 2,
    # Bases and settings that the paper prints: data that methods take as a preset.
    "paper.bases": 3,
    **dict.fromkeys(("simulate", "methods", "scoring"), 3),
    **dict.fromkeys(("discovery", "paper", "audit", "replicate", "benchmarks"), 4),
    **dict.fromkeys(("tables", "plots", "report", "templates"), 4),
    **dict.fromkeys(("cells", "records", "results", "checkpoint"), 4),
    **dict.fromkeys(("interruption", "live", "parts", "watch", "workers"), 4),
    **dict.fromkeys(("found", "polishing", "portfolio", "selection", "exports"), 4),
    **dict.fromkeys(("structure", "judging", "changes"), 4),
    **dict.fromkeys(
        ("prediction", "ensemble", "fronts", "discovery_report", "trainable", "hybrid"), 4
    ),
    **dict.fromkeys(("crosscheck", "comparison", "trajectory_checks", "doctor"), 4),
    **dict.fromkeys(("cli", "commands", "estimator", "__init__", "__main__"), 5),
}

# Importer -> what it takes from its own layer.
WITHIN = {
    "catalogue": {"system"},
    "pareto": {"samples"},
    "samples": {"trajectory"},
    "derivatives": {"samples", "smoothers", "trajectory"},
    "smoothers": {"samples"},
    "delimited": {"columns"},
    "intake": {"sources", "tabular", "trajectory"},
    "roles": {"columns"},
    "sources": {"columns", "delimited", "trajectory"},
    "table_checks": {"roles"},
    "tabular": {"columns", "roles", "sources", "table_checks", "trajectory"},
    "expression": {"errors"},
    "definitions": {"errors"},
    "methods": {"paper.bases", "simulate"},
    "scoring": {"simulate"},
    "audit": {"paper"},
    "benchmarks": {"checkpoint", "discovery", "tables"},
    "cells": {"paper", "records"},
    "crosscheck": {"paper", "comparison", "trajectory_checks"},
    "trajectory_checks": {"comparison", "paper"},
    "checkpoint": {"live", "workers"},
    "discovery": {
        "checkpoint",
        "found",
        "interruption",
        "parts",
        "polishing",
        "portfolio",
        "selection",
        "structure",
        "watch",
    },
    "interruption": {"checkpoint", "found", "live", "selection"},
    "live": {"exports", "selection"},
    "parts": {"checkpoint", "selection"},
    "selection": {"exports"},
    "watch": {"checkpoint", "live"},
    "found": {
        "checkpoint",
        "discovery_report",
        "exports",
        "hybrid",
        "plots",
        "prediction",
        "trainable",
    },
    "hybrid": {"portfolio"},
    "discovery_report": {"exports", "found", "fronts", "plots", "prediction", "report", "tables"},
    "fronts": {"exports"},
    "ensemble": {"found"},
    "changes": {"judging"},
    "structure": {"changes", "judging"},
    "trainable": {"exports"},
    "replicate": {"cells", "records", "report", "results", "tables"},
    "report": {"exports", "plots", "records", "results", "tables"},
    "results": {"audit", "paper", "plots", "records", "tables"},
    "__main__": {"cli"},
    "cli": {"commands"},
}

# Foreign module -> the only files that may import it, by name.
HOMES = {
    "torch": {
        "methods/feynman/network.py",
        "methods/feynman/backend.py",
        "trainable.py",
        "hybrid.py",
    },
    "matplotlib": {"plots.py"},
    "juliacall": {"engines/julia_worker.py"},
    "juliapkg": {"engines/julia_setup.py"},
    "diffeqpy": {"engines/julia_worker.py"},
}

FILES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))


def imports_of(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Give every module that a file imports, wherever in it but for types alone, with the line."""
    nodes = [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            continue
        nodes.extend(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute here"
            if node.module in ("dynsr", "dynsr.paper"):
                # "from dynsr import x" names the part x, or what __init__ itself holds.
                for alias in node.names:
                    yield f"{node.module}.{alias.name}", node.lineno
            else:
                yield node.module or "", node.lineno


def part_of(module: str) -> str:
    """Give what LAYERS places: the longest beginning of a dotted name that stands there."""
    words = module.split(".")
    for count in range(len(words), 0, -1):
        if ".".join(words[:count]) in LAYERS:
            return ".".join(words[:count])
    return words[0]


def module_of(file: str) -> str:
    """Give the dotted name of a file below dynsr."""
    name = file.removesuffix(".py").replace("/", ".")
    return name.removesuffix(".__init__")


def faults_of(file: str, tree: ast.AST) -> list[str]:
    """Say which imports of a file break the order."""
    part, faults = part_of(module_of(file)), []
    for module, line in imports_of(tree):
        first, _, rest = module.partition(".")
        if first in HOMES and file not in HOMES[first]:
            faults.append(f"{file}:{line} imports {first}; its home is {sorted(HOMES[first])}")
        other = part_of(rest)
        if first != "dynsr" or not rest or other in ("__version__", part):
            continue
        if other not in LAYERS:
            faults.append(f"{file}:{line} imports {other}, which has no place in LAYERS")
        elif LAYERS[other] > LAYERS[part]:
            faults.append(f"{file}:{line} imports {other} of a larger layer")
        elif LAYERS[other] == LAYERS[part] and other not in WITHIN.get(part, ()):
            faults.append(f"{file}:{line} imports {other} of its own layer; see WITHIN")
    return faults


@pytest.mark.parametrize("file", FILES)
def test_a_file_imports_only_from_smaller_layers(file):
    """Every file has a layer, imports nothing from a larger one, and leaves foreigners at home."""
    part = part_of(module_of(file))
    assert part in LAYERS, f"give {part} its place in LAYERS"
    assert faults_of(file, ast.parse((PACKAGE / file).read_text())) == []


@pytest.mark.parametrize(
    ("file", "source", "words"),
    [
        ("errors.py", "from dynsr.cli import main", "imports cli of a larger layer"),
        ("system.py", "def f():\n    import dynsr.pareto", "imports pareto of its own layer"),
        ("report.py", "import matplotlib.pyplot", "its home is"),
        ("methods/sindy.py", "from torch import nn", "its home is"),
        ("scoring.py", "from dynsr import report", "imports report of a larger layer"),
        ("doctor.py", "import dynsr.helpers", "has no place in LAYERS"),
    ],
)
def test_what_breaks_the_order_is_found(file, source, words):
    """The check itself finds each kind of fault, at any depth of a file."""
    assert any(words in fault for fault in faults_of(file, ast.parse(source)))


def test_lawful_imports_are_no_faults():
    """Smaller layers, a file's own folder and the standard library are free."""
    source = "import json\nfrom dynsr.errors import InputError\nfrom dynsr.engines import base"
    assert faults_of("engines/embedded.py", ast.parse(source)) == []
