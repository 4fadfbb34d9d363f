"""Accessibility: the rules of axe-core, run in a page that a browser has open."""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest

# Packages that bring the script, and nothing else that is used here.
_PACKAGES = ("axe_core_python", "axe_playwright_python")


def require_axe():
    """Give the script of axe-core; without it the test is skipped."""
    for name in _PACKAGES:
        spec = find_spec(name)
        if spec is not None and spec.origin is not None:
            return Path(spec.origin).with_name("axe.min.js").read_text("utf-8")
    return pytest.skip("axe-core is not here (pip install axe-core-python)")


def violations(browser, script):
    """Give what a page that is open does against WCAG 2.2 at level AA: rule, and first element."""
    browser.run(f"{script}; 0")
    tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
    wish = json.dumps({"runOnly": tags, "resultTypes": ["violations"]})
    found = browser.run(f"axe.run(document, {wish}).then(all => all.violations)")
    return [
        (rule["id"], node["html"][:120], node.get("failureSummary", "")[:160])
        for rule in found
        for node in rule["nodes"][:3]
    ]
