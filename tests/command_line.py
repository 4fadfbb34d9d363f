"""Running a command line of dynsr inside the tests' own process."""

from unittest.mock import patch

import typer
from typer.testing import CliRunner

from dynsr.cli.app import app

COMMAND = typer.main.get_command(app)


def run(*words, code=0):
    """Run a command line in this process; give its result after a check of the exit code."""
    # The runner would make all commands anew for every line.
    with patch("typer.testing._get_command", lambda app: COMMAND, create=True):
        result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result
