import email
import json
import re
import sys
from importlib import metadata

import numpy as np
import pytest

from dynsr.checks import doctor
from dynsr.engines.base import AbstractEngine, Integration, SparseSolution
from dynsr.engines.embedded import EmbeddedEngine
from dynsr.errors import EngineError, EngineUnavailable, say_install
from dynsr.jobs import to_plain


class Broken(EmbeddedEngine):
    """An engine whose integrations are slightly wrong and whose regressions fail."""

    name = "broken"

    def integrate(self, problem) -> Integration:
        """Be off by a thousandth."""
        return Integration(super().integrate(problem).x + 1e-3, True, 1, 0)

    def regress(self, problem) -> SparseSolution:
        """Fail."""
        raise EngineError("UndefVarError: foo")


def by_name(checks):
    """Give the checks by their names."""
    return {check.name: check for check in checks}


def use_engine(monkeypatch, engine: AbstractEngine | Exception) -> None:
    """Let every name give this engine."""

    def find(name):
        if isinstance(engine, Exception):
            raise engine
        return engine

    monkeypatch.setattr(doctor, "find_engine", find)


def describe(monkeypatch, *lines: str) -> None:
    """Let dynsr's metadata say these lines."""
    message = email.message_from_string("\n".join(["Name: dynsr", *lines]))
    monkeypatch.setattr(doctor.metadata, "metadata", lambda name: message)


def test_what_is_installed_is_named_with_its_version():
    """Every package that the metadata requires without an extra has a row with its version."""
    found = by_name(doctor.examine([]))
    required = [line for line in metadata.requires("dynsr") if "extra ==" not in line]
    names = {re.match(r"[\w-]+", line)[0] for line in required}
    assert "numpy" in names
    for name in names:
        assert found[name].state == "ok" and found[name].detail == metadata.version(name)
        assert found[name].required


def test_packages_of_extras_may_be_missing_and_tools_are_not_looked_for():
    """What an extra adds has a row of its own that nothing depends on; pytest has none."""
    found = by_name(doctor.examine([]))
    assert not found["juliacall"].required and not found["polars"].required
    assert "pytest" not in found and "dynsr" in found


def test_the_embedded_engine_works():
    """Its integration and regression are tried and found right."""
    found = by_name(doctor.examine(["embedded"]))
    assert found["embedded: integration"].state == "ok"
    assert found["embedded: regression"].state == "ok"
    assert doctor.is_healthy(found.values())


def test_what_is_missing_comes_with_its_remedy(monkeypatch):
    """Without Julia, a row says so and how to mend it, and all is well nevertheless."""
    missing = EngineUnavailable("Julia is not set up yet; run dynsr doctor --install")
    use_engine(monkeypatch, missing)
    monkeypatch.setattr(doctor, "is_configured", lambda: False)
    checks = doctor.examine(["julia"])
    row = by_name(checks)["julia: engine"]
    assert (row.state, row.remedy) == ("missing", "dynsr doctor --install")
    assert row.detail == "Julia is not set up yet" and not row.required
    assert doctor.is_healthy(checks)


@pytest.mark.parametrize("starts", [True, False])
def test_a_julia_that_is_set_up_and_does_not_start_fails(monkeypatch, starts):
    """A program that is not there and a start that breaks off are failures, and dynsr is ill."""
    engine = EmbeddedEngine()
    problem = EngineUnavailable("Julia does not start: SystemError; give another project")

    def refuse(*_):
        raise problem

    monkeypatch.setattr(engine, "integrate", refuse)
    monkeypatch.setattr(engine, "regress", refuse)
    monkeypatch.setattr(engine, "versions", refuse)
    monkeypatch.setattr(doctor, "is_configured", lambda: True)
    use_engine(monkeypatch, engine if starts else problem)
    rows = [c for c in doctor.examine(["julia"]) if c.name.startswith("julia: ")]
    wanted = ["julia: integration", "julia: regression"] if starts else ["julia: engine"]
    assert [row.name for row in rows[: len(wanted)]] == wanted
    assert {row.state for row in rows[: len(wanted)]} == {"fails"}
    assert rows[0].remedy == "give another project"
    assert not doctor.is_healthy(rows)


def test_a_missing_package_is_named_with_the_line_that_installs_it(monkeypatch):
    """Required packages make dynsr ill when they are missing, optional ones do not."""
    describe(
        monkeypatch,
        "Provides-Extra: all",
        "Provides-Extra: some",
        "Requires-Dist: no-such-package>=2",
        "Requires-Dist: dynsr[some]; extra == 'all'",
        "Requires-Dist: no-such-extra; extra == 'all'",
        "Requires-Dist: another; extra == 'all'",
        "Requires-Dist: no-such-extra; extra == 'some'",
        "Requires-Dist: of-another-system; sys_platform == 'none'",
    )
    checks = doctor.examine([])
    found = by_name(checks)
    assert found["no-such-package"].remedy == 'pip install "no-such-package>=2"'
    assert found["no-such-extra"].remedy == say_install("some")
    assert "of-another-system" not in found and "another" in found
    assert len(found) == len(checks)
    assert not doctor.is_healthy(checks)
    assert doctor.is_healthy([c for c in checks if c.name != "no-such-package"])


def test_a_package_that_is_too_old_fails(monkeypatch):
    """A version outside the required range is named beside the range."""
    describe(monkeypatch, "Requires-Dist: numpy>=999")
    row = by_name(doctor.examine([]))["numpy"]
    assert row.state == "fails" and row.remedy == 'pip install "numpy>=999"'
    assert row.detail == f"{np.__version__} where >=999 is needed"


def test_an_engine_that_is_there_but_wrong_is_found_out(monkeypatch):
    """A wrong answer and an error are failures, each with what was seen."""
    use_engine(monkeypatch, Broken())
    checks = doctor.examine(["broken"])
    found = by_name(checks)
    assert found["broken: integration"].state == "fails"
    assert "off by 1.0e-03" in found["broken: integration"].detail
    assert found["broken: regression"].detail == "UndefVarError: foo"
    assert found["broken: numpy"].detail == np.__version__
    assert not doctor.is_healthy(checks)


def test_checks_are_plain_data():
    """A check can be written as JSON."""
    row = doctor.Check("julia", "missing", "not set up", "dynsr doctor --install", False)
    assert json.loads(json.dumps(to_plain(row)))["remedy"] == "dynsr doctor --install"


def test_installing_without_juliacall_says_what_to_install_first(monkeypatch):
    """The remedy is pip's line, in an error of one line."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(EngineUnavailable, match=re.escape(say_install("julia"))):
        doctor.install()


def test_nothing_is_installed_into_a_project_of_the_users_own(monkeypatch, tmp_path):
    """With a Julia and a project given by the environment, there is nothing to install."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setenv("PYTHON_JULIACALL_EXE", sys.executable)
    monkeypatch.setenv("PYTHON_JULIACALL_PROJECT", str(tmp_path))
    assert doctor.install() == f"nothing to install: PYTHON_JULIACALL_PROJECT names {tmp_path}"
