"""What a saved discovery keeps of its data: where they begin, how they spread, the covariance."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run as command
from scipy.integrate import solve_ivp

from dynsr.data.reading import write_csv
from dynsr.data.trajectory import Trajectory
from dynsr.discovery.result import Discovery
from dynsr.discovery.summary import DataSummary
from dynsr.errors import InputError
from dynsr.export.source import Source
from dynsr.expression.parsing import parse
from dynsr.verdict.levels import StateVerdict, Verdict


@pytest.fixture
def found():
    """Give prey and hunters with noisy data from t = 2, judged."""
    t = np.linspace(2, 8, 61)

    def rhs(t, s):
        return [1.5 * s[0] - s[0] * s[1], s[0] * s[1] - 3 * s[1]]

    x = solve_ivp(rhs, (2, 8), [1.0, 2.0], t_eval=t, rtol=1e-9).y.T
    x += 0.01 * np.random.default_rng(4).normal(size=x.shape)
    own = {s: StateVerdict("law", "it follows", r2=1.0, noise=0.02) for s in ("prey", "hunters")}
    return Discovery(
        {"prey": parse("1.5*prey - prey*hunters"), "hunters": parse("prey*hunters - 3*hunters")},
        {"prey": ((1.5, 0.01), (-1.0, 0.02)), "hunters": ((-3.0, 0.03), (1.0, 0.01))},
        {},
        {},
        (Trajectory(t, x, ("prey", "hunters")),),
        settings={"engine": "embedded"},
        verdict=Verdict("law", "it follows", own),
    )


def test_a_loaded_discovery_has_its_covariance(found, tmp_path):
    """It is that of the parameters under their names, also after a new name and another save."""
    loaded = Discovery.load(found.save(tmp_path / "found.json"))
    assert not loaded.trajectories and np.all(np.isfinite(found.covariance()))
    assert loaded.covariance().equals(found.covariance())
    named = loaded.rename({"k1": "bite"})
    again = Discovery.load(named.save(tmp_path / "named.json"))
    assert next(iter(again.covariance())) == "bite"
    assert np.array_equal(again.covariance().to_numpy(), found.covariance().to_numpy())


def test_other_constants_have_no_covariance(found, tmp_path):
    """Numbers that somebody put in were not fitted, and one line says so."""
    loaded = Discovery.load(found.save(tmp_path / "found.json"))
    for changed in (loaded.with_parameters(k1=2.0), loaded.with_constants({"prey": [2.0, -1.0]})):
        with pytest.raises(InputError, match="the data are not here"):
            changed.covariance()
        assert changed.system.x0 == loaded.system.x0


def test_a_loaded_discovery_is_exported_as_the_one_that_was_found(found, tmp_path):
    """Start, times and noise are those of the data, in every format, also by the command."""
    saved = found.save(tmp_path / "found.json")
    loaded = Discovery.load(saved)
    assert loaded.system.x0 == found.system.x0 and loaded.system.span == (2.0, 8.0)
    assert Source.of(loaded).noise == Source.of(found).noise
    for form in ("python", "c", "modelica", "casadi"):
        assert loaded.export(form) == found.export(form)
    pytest.importorskip("libsbml", reason="python-libsbml is not installed")
    assert command("export", saved, "--to", "sbml").stdout == found.export("sbml")


def test_a_problem_with_data_is_that_of_the_discovery(found, tmp_path):
    """With the data again, the command writes the PEtab problem that the discovery would."""
    pytest.importorskip("libsbml", reason="python-libsbml is not installed")
    saved = found.save(tmp_path / "found.json")
    write_csv(found.trajectories[0], tmp_path / "data.csv")
    found.export("petab", tmp_path / "one")
    said = ("export", saved, "--to", "petab", "--data", tmp_path / "data.csv")
    command(*said, "-o", tmp_path / "other")
    for file in (tmp_path / "one").iterdir():
        assert file.read_text() == (tmp_path / "other" / file.name).read_text()


def test_an_older_file_has_none(found, tmp_path):
    """A file without a summary is read as before."""
    record = found.as_record()
    del record["summary"]
    (tmp_path / "old.json").write_text(json.dumps(record))
    old = Discovery.load(tmp_path / "old.json")
    assert old.summary is None and old.system.span == (0.0, 10.0)
    with pytest.raises(InputError, match="the data are not here"):
        old.covariance()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"step": 0.0}, "no data go from 2 to 8 by 0"),
        ({"step": 1e-320}, "no data go"),
        ({"span": [8.0, 2.0]}, "no data go"),
        ({"start": {"prey": None}}, "not finite"),
        ({"covariance": [[1.0], [2.0]]}, "no square"),
        ({"covariance": "all"}, "'summary' is damaged"),
    ],
)
def test_a_summary_that_is_none_is_refused(found, tmp_path, change, words):
    """What a file says of the data is checked, in one line."""
    record = found.as_record()
    record["summary"] = {**record["summary"], **change}
    (tmp_path / "odd.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=words):
        Discovery.load(tmp_path / "odd.json")


@pytest.mark.slow
def test_saving_never_fails_for_what_cannot_be_known(found, tmp_path):
    """Equations that leave the finite numbers are saved without a covariance."""
    wild = replace(found, equations={"prey": parse("exp(prey^9)"), "hunters": parse("hunters^9")})
    loaded = Discovery.load(wild.save(tmp_path / "wild.json"))
    assert isinstance(loaded.summary, DataSummary)
    untested = replace(found, verdict=Discovery({}, {}, {}, {}).verdict)
    assert untested.as_record()["summary"]["covariance"] == []
