"""Nothing that dynsr did not write is lost; what is read back is whole, or refused in one line."""

import copy
import json
import os
import signal
import stat
from contextlib import contextmanager

import numpy as np
import pytest
import sympy
from command_line import run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from known_systems import made
from scipy.integrate import solve_ivp

from dynsr.data.reading import read_trajectories, write_csv
from dynsr.data.trajectory import Trajectory
from dynsr.data.writing import write_bytes
from dynsr.discovery.result import Discovery
from dynsr.discovery.search import discover
from dynsr.errors import InputError
from dynsr.fit.candidates import Candidate, ParetoFront
from dynsr.methods.rational import RationalSearch
from dynsr.report.discovery import render_discovery

x, y = sympy.symbols("x y")
QUICK = RationalSearch(costs=(2,), max_terms=2, denominators=False, rounds=1)
SMALL = ("--preset", "quick", "--functions", "none", "-j", 1, "-q")


def decay(rows=60):
    """Give x = 2 exp(-t/2)."""
    t = np.linspace(0, 6, rows)
    return t, 2 * np.exp(-t / 2)[:, None]


@pytest.fixture
def found():
    """A discovery with everything in it."""
    front = ParetoFront([Candidate(-x, 1.0, 2.0, "a"), Candidate(-2 * x + y, 0.1, 9.0, "b: c")])
    return Discovery(
        {"x": -2.5 * x + y, "y": sympy.sin(x) - sympy.Symbol("F")},
        {"x": ((-2.5, 0.1),), "y": ()},
        {"x": front, "y": ParetoFront([Candidate(x, 0.5, 1.0)])},
        {"x": "it fits", "y": "it is short"},
        inputs={"F": sympy.cos(sympy.Symbol("t"))},
        settings={"method": "auto", "methods": ["rational"], "seed": 0, "engine": "embedded"},
        seconds=1.5,
    )


@pytest.fixture
def saved(found, tmp_path):
    """The same as a file."""
    return found.save(tmp_path / "kept" / "discovery.json")


@pytest.mark.parametrize("name", ["live/notes.txt", "run.json", "report.html", "a.csv", "records"])
def test_a_folder_with_anything_of_others_is_refused_and_left_alone(name, tmp_path):
    """Only new or empty folders, and those with the mark of dynsr, take results."""
    theirs = tmp_path / "out" / name
    theirs.parent.mkdir(parents=True)
    theirs.write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="and no results of dynsr; give a new or an empty folder"):
        discover(decay(), method=QUICK, jobs=1, out=tmp_path / "out")
    assert theirs.read_text() == "mine" and sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["report.html", "discovery.json"])
@pytest.mark.slow
def test_a_file_of_others_in_a_folder_of_ours_stays(name, tmp_path):
    """Results whose names are taken are refused before anything is searched."""
    data = tmp_path / "d.csv"
    t, states = decay()
    write_csv(Trajectory(t, states, ("x",)), data)
    command = ("discover", data, *SMALL, "-o", tmp_path / "out")
    run(*command)
    (tmp_path / "out" / name).write_text("mine")
    said = run(*command, code=2).stderr
    assert "is there and not of dynsr; give another name" in said
    assert (tmp_path / "out" / name).read_text() == "mine"


@pytest.mark.slow
def test_a_default_folder_that_others_use_is_passed_by(tmp_path, monkeypatch):
    """Without --out the next name is taken, as where another discovery is there."""
    monkeypatch.chdir(tmp_path)
    t, states = decay()
    write_csv(Trajectory(t, states, ("x",)), "d.csv")
    theirs = tmp_path / "d-dynsr" / "thesis.tex"
    theirs.parent.mkdir()
    theirs.write_text("mine")
    run("discover", "d.csv", *SMALL)
    assert [p.name for p in theirs.parent.iterdir()] == ["thesis.tex"]
    assert (tmp_path / "d-dynsr-2" / "discovery.json").exists()


def test_no_command_writes_over_what_it_reads(saved, tmp_path):
    """A report over its own result, and data over what is no table, leave the file as it was."""
    before = saved.read_bytes()
    assert "not of dynsr" in run("report", saved, "-o", saved, code=2).stderr
    assert saved.read_bytes() == before
    notes = tmp_path / "notes.csv"
    notes.write_text("name,grade\nEve,1\n")
    assert "is there already" in run("generate", "pendulum", "-o", notes, code=2).stderr
    assert notes.read_text() == "name,grade\nEve,1\n"
    model = tmp_path / "model.csv"
    model.write_bytes(before)
    run("simulate", model, "--x0", "1,1", "-o", model, code=2)
    assert model.read_bytes() == before
    page = tmp_path / "page.html"
    for _ in range(2):  # its own page may be made again
        run("report", saved, "-o", page)


@pytest.mark.parametrize("command", ["generate", "simulate"])
@pytest.mark.parametrize("name", ["m.csv", "m.tsv"])
def test_a_table_is_replaced_by_force_alone(command, name, tmp_path):
    """No table says who measured it: one that is there stays, whatever its columns are."""
    path = tmp_path / name
    mark = "\t" if name.endswith("tsv") else ","
    for text in ("t,x\n0,1.5\n", "trajectory,t,x\n1,0,1.5\n", "a note"):
        path.write_text(text.replace(",", mark))
        said = run(command, "pendulum", "-o", path, code=2).stderr
        assert said.count("\n") == 1 and "is there already" in said and "--force" in said
        assert path.read_text() == text.replace(",", mark)
    run(command, "pendulum", "-o", path, "--force")
    assert read_trajectories(path).trajectories[0].states == ("theta1", "theta2")
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_link_to_a_table_and_an_empty_file(tmp_path):
    """What a link leads to counts as it does itself; an empty file has nothing to lose."""
    link, table = tmp_path / "link.csv", tmp_path / "m.csv"
    link.symlink_to(table)
    table.write_text("t,x\n0,1\n")
    run("generate", "pendulum", "-o", link, code=2)
    assert table.read_text() == "t,x\n0,1\n"
    table.write_text("")
    run("generate", "pendulum", "-o", link)
    assert link.is_symlink() and table.read_text().startswith("t,theta1")


def test_the_interface_replaces_a_table_by_force_alone(tmp_path):
    """write_csv refuses a file that is there, and with force replaces it."""
    t, states = decay()
    path, made = tmp_path / "a.csv", Trajectory(t, states, ("x",))
    write_csv(made, path)
    with pytest.raises(InputError, match=r"is there already; .* force=True"):
        write_csv([made, made], path)
    write_csv([made, made], path, force=True)
    assert len(read_trajectories(path).trajectories) == 2
    with pytest.raises(InputError, match="cannot write"):
        write_csv(made, tmp_path, force=True)


@pytest.mark.parametrize("name", ["report.html", "discovery.json"])
@pytest.mark.slow
def test_what_a_user_changed_is_no_longer_of_dynsr(name, tmp_path, monkeypatch):
    """A page with notes of its reader, or an edited result, is not replaced."""
    monkeypatch.chdir(tmp_path)
    t, states = decay()
    write_csv(Trajectory(t, states, ("x",)), "d.csv")
    run("discover", "d.csv", *SMALL)
    run("discover", "d.csv", *SMALL)
    theirs = tmp_path / "d-dynsr" / name
    edited_text = theirs.read_text().replace("x", "x ", 1)
    theirs.write_text(edited_text)
    said = run("discover", "d.csv", *SMALL, "-o", "d-dynsr", code=2).stderr
    assert "is there and not of dynsr; give another name" in said
    run("discover", "d.csv", *SMALL)
    assert theirs.read_text() == edited_text
    assert (tmp_path / "d-dynsr-2" / "discovery.json").exists()


@pytest.mark.parametrize(
    "text",
    [
        '<meta name="generator" content="dynsr"> is what its pages hold',
        '{"format": "dynsr discovery 1", "checksum": "", "note": "mine"}',
        '{"format": "dynsr discovery 1"}',
        "<!-- dynsr sha256:00 -->\n",
    ],
)
def test_a_mark_of_dynsr_makes_no_file_its_own(text, saved, tmp_path):
    """Files of users that quote what dynsr writes are theirs."""
    path = tmp_path / "mine"
    path.write_text(text)
    with pytest.raises(InputError, match="not of dynsr"):
        Discovery.load(saved).save(path)
    assert "not of dynsr" in run("report", saved, "-o", path, code=2).stderr
    assert path.read_text() == text


def test_no_planted_link_is_written_through(tmp_path, monkeypatch):
    """Names of temporary files are drawn anew; a link or a file of such a name is not opened."""
    drawn = []

    def token(count):
        drawn.append(count)
        return "0123456789abcdef"

    monkeypatch.setattr("secrets.token_hex", token)
    theirs = tmp_path / "theirs"
    theirs.write_text("mine")
    planted = tmp_path / ".dynsr-0123456789abcdef.part"
    planted.symlink_to(theirs)
    with pytest.raises(FileExistsError):
        write_bytes(tmp_path / "a", b"ours")
    assert theirs.read_text() == "mine" and planted.is_symlink() and drawn == [8]
    monkeypatch.undo()
    write_bytes(tmp_path / "a", b"ours")
    assert (tmp_path / "a").read_bytes() == b"ours"


def test_what_was_private_is_so_while_it_is_written(tmp_path, monkeypatch):
    """The file that takes the place of a private one is private before anything is in it."""
    path = tmp_path / "private"
    path.write_text("old")
    path.chmod(0o600)
    seen = []
    real = os.fsync

    def look(number):
        seen.append(stat.S_IMODE(os.fstat(number).st_mode))
        real(number)

    monkeypatch.setattr(os, "fsync", look)
    write_bytes(path, b"new")
    assert seen == [0o600]


def test_a_loop_of_links_is_one_line(tmp_path):
    """A link that leads to itself is no file, and is told by its name."""
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    said = run("generate", "pendulum", "-o", loop, code=2).stderr
    assert said.count("\n") == 1 and "loop.csv" in said


def test_long_names_of_any_letters_are_written(tmp_path):
    """A name of 255 bytes, as long as they may be, is one that can be written."""
    for letter in ("n", "é", "測"):
        long = tmp_path / (letter * (255 // len(letter.encode())))
        write_bytes(long, b"x")
        assert long.read_bytes() == b"x"


@contextmanager
def full_disk():
    """Let no file of this process grow beyond 4096 bytes."""
    resource = pytest.importorskip("resource", reason="limits of POSIX")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    answer = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, answer)


@pytest.mark.parametrize("command", ["generate", "report"])
def test_a_full_disk_leaves_the_old_file_and_names_it(command, saved, tmp_path):
    """A file that cannot be written whole is as it was before; the line has its name."""
    target = tmp_path / ("out.csv" if command == "generate" else "out.html")
    words = ["generate", "pendulum"] if command == "generate" else ["report", str(saved)]
    run(*words, "-o", target)
    before = target.read_bytes()
    force = ["--force"] if command == "generate" else []
    with full_disk():
        again = run(*words, "-o", target, *force, code=2)
    assert str(target) in again.stderr and "too large" in again.stderr
    assert target.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["kept", target.name]


def test_writing_keeps_links_permissions_and_devices(tmp_path):
    """A link stays a link, a file its permissions, and a device a device."""
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    write_bytes(link, b"new")
    assert link.is_symlink() and real.read_bytes() == b"new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    sink = tmp_path / "sink"
    os.mkfifo(sink)
    reader = os.open(sink, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes(sink, b"through")
    assert os.read(reader, 99) == b"through" and stat.S_ISFIFO(sink.stat().st_mode)
    os.close(reader)


def test_what_is_saved_reads_back_the_same(found, saved):
    """Every part is there again, and a second save gives the same bytes."""
    again = Discovery.load(saved)
    assert again.as_record() == found.as_record()
    assert again.save(saved.with_name("b.json")).read_bytes() == saved.read_bytes()


def edited(saved, change, whole=True):
    """Change the record of a saved discovery; without its checksum unless it is to be found."""
    record = json.loads(saved.read_text())
    if whole:
        del record["checksum"]
    change(record)
    saved.write_text(json.dumps(record))
    return saved


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r.update(errors="none"), "'errors' is damaged"),
        (lambda r: r.update(errors={"x": [[1.0, 2.0, 3.0]]}), "'errors' is damaged"),
        (lambda r: r.update(errors={"q": []}), "without an equation, 'q'"),
        (lambda r: r["settings"].update(known=["y'=-3*y"]), "'settings' is damaged"),
        (lambda r: r["settings"].update(scheme="forward"), "'settings' is damaged"),
        (lambda r: r["settings"].update(methods="rational"), "'settings' is damaged"),
        (lambda r: r["settings"].update(seed="0"), "'settings' is damaged"),
        (lambda r: r.pop("front"), r"lacks parts of a discovery \('front'\)"),
        (lambda r: r.update(front=None), "'front' is damaged"),
        (lambda r: r["front"].update(x=[["-x", -1.0, 2.0, ""]]), "loss -1"),
        (lambda r: r["front"].update(x=[["-x", 1.0, 1e300, ""]]), "1e.300 bits"),
        (lambda r: r["front"].update(x=[["-x", "1.0", 2.0, ""]]), "'front' is damaged"),
        (lambda r: r["front"].update(q=[]), "without an equation, 'q'"),
        (lambda r: r["equations"].update(x="zoo"), "'zoo' in 'zoo' is no number"),
        (lambda r: r["equations"].update(x="10**10**8"), "beyond what float64 holds"),
        (lambda r: r["equations"].update(x=5), "'equations' is damaged"),
        (lambda r: r.update(equations={}), "there is no equation"),
        (lambda r: r["equations"].update({"print(1) or x": "-x"}), "cannot be used in a formula"),
        (lambda r: r["equations"].update({"x\n": "-x"}), "cannot be used in a formula"),
        (lambda r: r["equations"].update({"t": "-x"}), "named 't'"),
        (lambda r: r["inputs"].update(x="1"), "input 'x' is also a state"),
        (lambda r: r["inputs"].update(F="__import__('os')"), "unknown function|cannot read"),
        (lambda r: r["inputs"].update(F="x"), "unknown name 'x'"),
        (lambda r: r.update(explanation={"x": "half a pair: \ud800"}), "no whole JSON"),
        (lambda r: r.update(seconds=float("nan")), "no whole JSON"),
        (lambda r: r.update(seconds=10**400), "'seconds' is damaged"),
        (lambda r: r.update(complete="yes"), "'complete' is damaged"),
        (lambda r: r.update(format="dynsr discovery 9"), "not 'dynsr discovery 1'; discover again"),
    ],
)
def test_a_record_edited_by_hand_is_one_line(change, said, saved):
    """Wrong types, unknown states, numbers that are none, other versions: exit 2 everywhere."""
    edited(saved, change)
    with pytest.raises(InputError, match=said):
        Discovery.load(saved)
    for words in (("report", saved), ("simulate", saved, "--x0", "1,1"), ("score", saved, saved)):
        assert run(*words, code=2).stderr.count("\n") == 1


def test_a_flipped_bit_is_found(saved):
    """What still looks like a discovery is known to be damaged by its checksum."""
    edited(saved, lambda r: r["equations"].update(x="-2.4*x + y"), whole=False)
    with pytest.raises(InputError, match="changed or damaged: its checksum differs"):
        Discovery.load(saved)


@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "folder", "nothing", "picture"])
def test_what_is_no_file_is_refused_at_once(kind, tmp_path):
    """A pipe that nobody writes to, or a device without end, is never opened."""
    path = {"/dev/zero": "/dev/zero"}.get(kind, tmp_path / "in.json")
    if kind == "fifo":
        os.mkfifo(path)
    if kind == "folder":
        path.mkdir()
    if kind == "picture":
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    for words in (("report", path), ("score", path, path), ("discover", path, "-q")):
        assert run(*words, code=2).stderr.count("\n") == 1
    with pytest.raises(InputError):
        Discovery.load(path)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=4,
)


def places(value, path=()):
    """Give the way to every value inside nested lists and mappings."""
    yield path
    items = enumerate(value) if isinstance(value, list) else ()
    for key, item in value.items() if isinstance(value, dict) else items:
        yield from places(item, (*path, key))


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
@pytest.mark.slow
def test_whatever_a_record_holds_it_is_a_discovery_or_one_line(data, saved, found):
    """One value anywhere is replaced by another: what loads can be shown, the rest is refused."""
    record = json.loads(json.dumps(found.as_record()))
    *way, last = data.draw(st.sampled_from([p for p in places(record) if p]))
    inside = record
    for key in way:
        inside = inside[key]
    inside[last] = data.draw(VALUES)
    saved.write_text(json.dumps(copy.deepcopy(record)))
    try:
        loaded = Discovery.load(saved)
    except InputError as error:
        said = str(error)
        assert "\n" not in said
        return
    assert "<html" in render_discovery(loaded)
    assert loaded.to_python() and loaded.to_julia()


@pytest.mark.parametrize("names", [("math", "state"), ("u", "du"), ("end", "p")])
def test_code_that_is_written_keeps_its_own_names(names):
    """States named as what the code uses itself get an underscore, and the code is still right."""
    a, b = sympy.symbols(names)
    equations = {names[0]: sympy.sin(b), names[1]: -2 * a}
    space: dict = {}
    exec(made(equations).to_python(), space)
    solved = solve_ivp(space["rhs"], (0, 1), [1.0, 0.5])
    assert solved.success
    assert space["rhs"](0.0, [0.3, 0.2]) == pytest.approx([np.sin(0.2), -0.6])
    kept = {"u": "u_", "du": "du_", "end": "end_", "p": "p_"}
    assert f"{kept.get(names[0], names[0])} = u[1]" in made(equations).to_julia()


def test_code_is_never_written_from_a_name_that_is_none():
    """A state that is no name, made by hand, is refused where it would become code."""
    bad = "x = __import__('os').system('true')\n    x"
    for write in (Discovery.to_python, Discovery.to_julia):
        with pytest.raises(InputError, match="cannot be used in a formula"):
            write(made({bad: -x}))
