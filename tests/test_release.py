"""What a release rests on: one version, a changelog and a citation that can be read, templates."""

import re
from pathlib import Path

import pytest

import dynsr

ROOT = Path(dynsr.__file__).parents[1]
yaml = pytest.importorskip("yaml")


def test_the_version_stands_in_one_place():
    """pyproject reads it from the package, where it is a version of semantic versioning."""
    text = (ROOT / "pyproject.toml").read_text()
    project = text.partition("[project]")[2].partition("\n[")[0]
    assert 'dynamic = ["version",' in project and not re.search(
        r"^version\b", project, re.MULTILINE
    )
    assert 'path = "dynsr/__init__.py"' in text
    assert re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc|\.dev)\d+)?", dynsr.__version__)


def test_the_changelog_keeps_its_form():
    """Releases with dates, newest first, changes below headings of Keep a Changelog."""
    text = (ROOT / "CHANGELOG.md").read_text()
    releases = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert releases[0] == "[Unreleased]"
    for release in releases[1:]:
        assert re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", release)
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert set(re.findall(r"^### (.*)$", text, re.MULTILINE)) <= kinds
    for release in text.split("\n## ")[1:]:  # a release may begin with a sentence
        body = release.partition("### ")[2].splitlines()[1:]
        assert [line for line in body if line and not line.startswith(("- ", "  ", "#"))] == []


def test_a_release_is_read_in_a_minute():
    """A release has at most forty entries, by feature: no list of all that ever changed."""
    text = (ROOT / "CHANGELOG.md").read_text()
    for release in text.split("\n## ")[1:]:
        entries = re.findall(r"^- ", release, re.MULTILINE)
        assert len(entries) <= 40, f"{release[:20]} has {len(entries)} entries: cut it, by feature"


def test_the_citation_can_be_read():
    """CITATION.cff has what version 1.2.0 of the format requires, and names the paper."""
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert found["cff-version"] == "1.2.0" and found["type"] == "software"
    assert {"message", "title", "authors", "license"} <= set(found)
    assert found["version"] == dynsr.__version__
    assert str(found["date-released"]) in (ROOT / "CHANGELOG.md").read_text()
    assert found["references"][0]["title"].startswith("Inferring the Structure of Ordinary")


@pytest.mark.parametrize("address", ["", "https://example.org/me/dynsr"])
def test_links_of_the_page_of_a_package_hold_outside_the_repository(address, monkeypatch):
    """Each link and picture has a full address; without one for the repository there is none."""
    core = pytest.importorskip("hatchling.metadata.core", reason="hatchling builds the package")
    plugins = pytest.importorskip("hatchling.plugin.manager")
    monkeypatch.setenv("DYNSR_URL", address)
    made = core.ProjectMetadata(str(ROOT), plugins.PluginManager()).core
    links = re.findall(r"\]\(([^)]+)\)", made.readme)
    files = [link for link in links if link.startswith("https://example.org/me/dynsr/")]
    assert len(files) == len(links) > 5 if address else links == []
    for link in files:
        assert (ROOT / re.sub(r".*?/(blob|raw)/main/", "", link)).exists()
    assert set(made.urls) == ({"Repository", "Documentation", "Changelog"} if address else set())
    assert made.authors_data["name"] == ["dynsr contributors"]


@pytest.mark.parametrize("name", ["fault", "equation", "wish"])
def test_forms_for_issues_can_be_read(name):
    """Each has a name, a description, and fields with labels and ids of their own."""
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text())
    assert form["name"] and form["description"]
    ids = [field["id"] for field in form["body"]]
    assert len(set(ids)) == len(ids) and all(f["attributes"]["label"] for f in form["body"])


def test_scripts_that_a_template_names_are_there():
    """What the template of a pull request asks to run exists."""
    text = (ROOT / ".github" / "pull_request_template.md").read_text()
    for script in re.findall(r"`(scripts/\w+)`", text):
        assert (ROOT / script).is_file()
