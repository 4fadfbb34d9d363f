"""Docstrings as the reference shows them.

The parameters of a docstring have one line each, ``name : what it is``, since types stand in the
signature. numpydoc, as griffe reads it, wants the text below the name; examples and references of
Sphinx have other forms there too. This extension of griffe writes a docstring in that way before
it is read.
"""

from __future__ import annotations

import re
from html import escape
from typing import Any

from griffe import Extension, Object

_SECTION = re.compile(r"^(Parameters|Attributes|Returns)\n-+\n", re.MULTILINE)
_ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.*(?:\n[ \t]+\S.*)*)", re.MULTILINE)
_ROLE = re.compile(r":(?:func|class|meth|attr|data|mod):`([\w.]+)`")


def rewrite(text: str, module: str, owner: str = "") -> str:
    """Give a docstring as numpydoc and autorefs have it.

    Parameters
    ----------
    text : the docstring, without indentation.
    module : the path of the module that it stands in, where its short references begin.
    owner : the path of the class that it belongs to, where its references to methods begin.
    """
    # What follows a double colon is indented, which is code in Markdown too.
    text = _ROLE.sub(lambda role: _refer(role, module, owner), text.replace("\n::\n\n", "\n"))
    prose, sections, examples = [], [], []
    parts = _SECTION.split(text)
    for name, body in zip(["", *parts[1::2]], parts[::2], strict=True):
        # A section ends at the first empty line; what follows is prose again.
        entries, _, rest = body.partition("\n\n") if name else ("", "", body)
        if name:
            entries = _ENTRY.sub(lambda entry: f"{entry[1]}\n    {entry[2]}", entries)
            sections.append(f"{name}\n{'-' * len(name)}\n{entries}")
        for paragraph in rest.strip("\n").split("\n\n"):
            (examples if paragraph.startswith(">>> ") else prose).append(paragraph)
    if examples:
        sections.append("Examples\n--------\n" + "\n\n".join(examples))
    return "\n\n".join([*filter(None, prose), *sections])


def _refer(role: re.Match[str], module: str, owner: str) -> str:
    name = role[1]
    if "." not in name:
        name = f"{owner or module}.{name}" if ":meth:" in role[0] else f"{module}.{name}"
    short = escape(role[1].rpartition(".")[2])
    return f'<autoref identifier="{escape(name)}" optional><code>{short}</code></autoref>'


class Numpydoc(Extension):
    """Rewrites every docstring of the package as it is loaded."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Rewrite the docstring of one module, class, function or attribute."""
        if obj.docstring is None or obj.is_alias:
            return
        owner = obj.path if obj.is_class else obj.parent.path if obj.parent else ""
        obj.docstring.value = rewrite(obj.docstring.value, obj.module.path, owner)
