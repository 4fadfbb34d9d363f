"""Running a command line of dynsr inside the tests' own process."""

from typer.testing import CliRunner

from dynsr.cli.app import app


def run(*words, code=0):
    """Run a command line in this process; give its result after a check of the exit code."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result
