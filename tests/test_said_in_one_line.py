"""What is too large, too deep, of another kind or for want of memory is said in one line."""

import errno
import json

import numpy as np
import pytest
from command_line import run

import dynsr
from dynsr.errors import DynsrError, InputError, in_words
from dynsr.jobs.store import FolderTaken, RecordError, RunFolder, read_json
from dynsr.methods import AbstractMethod, silent
from dynsr.verdict.levels import StateVerdict, Verdict

T = np.linspace(0, 3, 31)
SHORT = np.linspace(0, 2, 21)


@pytest.fixture(scope="module")
def record():
    """Give the record of a small discovery."""
    law = dynsr.discover((T, np.exp(-T)[:, None]), preset="quick", jobs=1, method="sindy")
    return json.loads(json.dumps(law.as_record()))


@pytest.mark.slow
@pytest.mark.parametrize("level", ["sure", "LAW", "", "law ", None, 3, ["law"], {"law": 1}])
@pytest.mark.parametrize("of", ["system", "state"])
def test_a_level_that_is_none_is_refused(tmp_path, record, level, of):
    """A saved verdict of another level is one line when it is read, not a fault of its page."""
    verdict = json.loads(json.dumps(record["verdict"]))
    (verdict if of == "system" else verdict["states"]["x"])["level"] = level
    path = tmp_path / "law.json"
    path.write_text(json.dumps({**record, "verdict": verdict}))
    with pytest.raises(InputError, match="verdict") as said:
        dynsr.Discovery.load(path)
    assert "\n" not in str(said.value)


def test_a_verdict_has_one_of_three_levels():
    """Who makes one himself hears of it as well."""
    for make in (lambda: Verdict("sure", ""), lambda: StateVerdict("sure", "", 1.0)):
        with pytest.raises(InputError, match="law, approximation, not found, not 'sure'"):
            make()


@pytest.mark.parametrize("opening", ["[", '{"a":'])
@pytest.mark.parametrize("depth", [65, 300, 900, 20_000, 200_000])
def test_a_record_that_is_nested_too_deeply_is_refused(tmp_path, record, opening, depth):
    """Settings of any depth are read or refused; nothing runs out of Python's own."""
    deep = (
        opening * depth + ("1" if "{" in opening else "") + {"[": "]", "{": "}"}[opening[0]] * depth
    )
    text = json.dumps(record).replace('"settings": {', f'"settings": {{"deep": {deep}, ', 1)
    path = tmp_path / "law.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"nested deeper than 64 levels|no whole JSON"):
        read_json(path)
    with pytest.raises(InputError) as said:
        dynsr.Discovery.load(path)
    assert len(str(said.value)) < 300


def test_a_record_of_usual_depth_is_read(tmp_path):
    """What nests as far as records do is."""
    path = tmp_path / "deep.json"
    path.write_text("[" * 60 + "]" * 60)
    assert read_json(path)


@pytest.mark.parametrize("command", ["generate", "simulate"])
@pytest.mark.parametrize("step", ["1e-6", "1e-9", "1e-300"])
def test_a_table_that_is_too_large_is_refused_before_it_is_made(command, step):
    """The number of its rows and columns is said, and what to do; nothing is computed."""
    said = run(command, "pendulum", "--dt", step, code=2).stderr
    assert "numbers; take a larger step" in said
    assert said.count("\n") == 1


def test_sizes_are_looked_at_first_in_python_too():
    """Times of a system and rows of a map have a bound, below which all are given."""
    pendulum = dynsr.find_system("pendulum")
    with pytest.raises(InputError, match=r"makes 1e\+07 rows of 3 columns"):
        pendulum.times((0.0, 10.0), 1e-6)
    for span, step in [((0.0, np.inf), 1.0), ((0.0, np.nan), 1.0), ((1.0, 0.0), 1.0), ((0, 1), 0)]:
        with pytest.raises(InputError, match="must be finite, forward in time and above 0"):
            pendulum.times(span, step)
    assert len(pendulum.times((0.0, 10.0), 1e-4)) == 100_001


class Hungry(AbstractMethod):
    """Wants more memory than there is."""

    name = "hungry"
    fault: BaseException = MemoryError()

    def search(self, samples, rng, report=silent):
        """Ask for it."""
        raise self.fault


@pytest.mark.parametrize(
    "fault",
    [
        MemoryError(),
        MemoryError("Unable to allocate 3.2 TiB for an array"),
        RuntimeError("[enforce fail at alloc_cpu.cpp:114] DefaultCPUAllocator: not enough memory"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_want_of_memory_is_no_fault_of_dynsr(fault, monkeypatch):
    """In the process itself and in a task of it: it is said, with what helps."""
    assert "not enough memory" in in_words(fault)
    assert "fewer rows" in in_words(fault)
    assert "fault in dynsr" not in in_words(fault)
    monkeypatch.setattr(Hungry, "fault", fault)
    wiggles = np.sin(7 * T)[:, None] + np.random.default_rng(1).random((31, 1))
    with pytest.raises(MemoryError) as said:
        dynsr.discover((T, wiggles), method=[Hungry()], jobs=1, scheme="central2")
    assert "fault in dynsr" not in in_words(said.value)


def test_a_folder_says_which_kind_it_is_of(tmp_path):
    """A setting that only one of the two has is said so; nobody is told to give None."""
    flows, maps = RunFolder(tmp_path / "flows"), RunFolder(tmp_path / "maps")
    flows.claim("discovery", {"seed": 0})
    maps.claim("discovery", {"kind": "map", "seed": 0})
    with pytest.raises(FolderTaken, match="results without kind, and kind map is asked for"):
        flows.claim("discovery", {"kind": "map", "seed": 0})
    with pytest.raises(FolderTaken, match="results with kind map, and none is asked for"):
        maps.claim("discovery", {"seed": 0})


PAIR, OTHER = (T, np.exp(-T)), (SHORT, np.exp(-SHORT))
TABLE, LESS = np.column_stack(PAIR), np.column_stack(OTHER)


@pytest.mark.parametrize(
    ("data", "runs"),
    [
        ((PAIR, OTHER), 2),
        ([PAIR, OTHER], 2),
        ((TABLE, LESS), 2),
        ([TABLE, LESS], 2),
        ((TABLE, LESS, TABLE), 3),
        ((TABLE,), 1),
        ((tuple(T), np.exp(-T)), 1),
        ((list(T), list(np.exp(-T))), 1),
    ],
    ids=range(8),
)
@pytest.mark.slow
def test_a_tuple_of_runs_is_a_list_of_them(data, runs):
    """Runs of unequal lengths are taken as they are meant; times and states stay one run."""
    found = dynsr.discover(data, preset="quick", method="sindy", jobs=1)
    assert len(found.trajectories) == runs
    assert found.equations == {"x": -found.equations["x"].free_symbols.pop()}


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (([T, SHORT], [np.exp(-T), np.exp(-SHORT)]), "t has parts of 21 and 31 values"),
        ((T, (np.exp(-T), np.exp(-SHORT))), "x has parts of 21 and 31 values"),
        ((T, [[1, 2], [3]] * 15 + [[1, 2]]), "x has parts of 1 and 2 values"),
    ],
    ids=["times", "states", "rows"],
)
def test_unequal_parts_are_said(data, words):
    """In words of the data, not in those of a library."""
    with pytest.raises(InputError, match=words) as said:
        dynsr.discover(data)
    assert "[(t1, x1), (t2, x2)]" in str(said.value)
    assert isinstance(said.value, DynsrError)
