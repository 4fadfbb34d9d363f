"""The command that adds an extra is true for the way in which dynsr was installed."""

import json
from importlib.metadata import PackageNotFoundError

import pytest

from dynsr import errors


@pytest.mark.parametrize(
    ("address", "command"),
    [
        (None, 'pip install "dynsr[torch]"'),
        (
            {"url": "file:///home/me/dynsr", "dir_info": {"editable": True}},
            'pip install ".[torch]" in the checkout of dynsr',
        ),
        (
            {"url": "https://example.org/dynsr", "vcs_info": {"vcs": "git", "commit_id": "1"}},
            'pip install "dynsr[torch] @ git+https://example.org/dynsr"',
        ),
        (
            {"url": "https://example.org/dynsr.whl", "archive_info": {}},
            'pip install "dynsr[torch] @ https://example.org/dynsr.whl"',
        ),
    ],
)
def test_the_command_names_where_dynsr_came_from(monkeypatch, address, command):
    """An index by its name, a checkout by its extra, a repository or an archive by its address."""

    class Installed:
        def read_text(self, _):
            return None if address is None else json.dumps(address)

    monkeypatch.setattr("importlib.metadata.distribution", lambda _: Installed())
    errors._installed_from.cache_clear()
    try:
        assert errors.say_install("torch") == command
    finally:
        errors._installed_from.cache_clear()


def test_what_nobody_installed_runs_from_its_checkout(monkeypatch):
    """Without metadata of a package there is no name that an index could know."""

    def absent(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.distribution", absent)
    errors._installed_from.cache_clear()
    try:
        assert errors.say_install("app") == 'pip install ".[app]" in the checkout of dynsr'
    finally:
        errors._installed_from.cache_clear()
