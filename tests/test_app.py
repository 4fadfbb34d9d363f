"""The local page without a browser: who may ask, what is taken, what is answered, how it ends."""

import contextlib
import http.client
import inspect
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from command_line import run
from served_page import Page, PageHere, rabbits

import dynsr
from dynsr.app.work import FILES, Live, Work, read_options
from dynsr.data.reading import read_trajectories
from dynsr.errors import say_install
from dynsr.expression import parse
from dynsr.jobs import Step
from dynsr.jobs.progress import Running

pytest.importorskip("tornado", reason="the extra app is not installed")
# One worker runs them all, so that one page is served.
pytestmark = pytest.mark.xdist_group("app")

TABLE = "t,x,y\n" + "\n".join(f"{k / 10:g},{k**3},{k * k}" for k in range(30))
MEGABYTES = 0.25


@pytest.fixture(scope="module")
def page():
    """Serve one page for all tests that leave it as it is."""
    served = PageHere(megabytes=MEGABYTES)
    yield served
    served.end()


def test_nothing_answers_without_the_token(page):
    """Whoever does not know the token gets the same empty answer wherever he asks."""
    assert page.ask("")[0] == 200
    for token in ("", "x", page.token[:-1], page.token + "x", page.token.swapcase(), "%00", "é"):
        for path in ("", "page.js", "changes?after=0", "discovery.json", "nothing"):
            status, _, body = page.ask(path, token=quote(token))
            assert (status, body) == (404, b""), (token, path)
        for path in ("data?name=a.csv", "search", "quit"):
            assert page.ask(path, b"{}", token=quote(token))[::2] == (404, b"")
    assert len(page.token) >= 32
    assert page.ask("nothing")[0] == 404


@pytest.mark.slow
def test_two_pages_have_two_tokens(page):
    """A token is of chance: another page has another one, and does not know the first's."""
    other = Page()
    try:
        assert other.token != page.token
        assert other.ask("", token=page.token)[0] == 404
    finally:
        assert other.end() == (0, "")


def test_a_page_ends_without_a_word_while_its_worker_still_loads(tmp_path):
    """A worker that is to leave before it has loaded leaves at once, and interrupts no import."""
    # A compiled module says what interrupts the imports of its own as an ImportError.
    script = f"""
        import multiprocessing, sys, time
        from pathlib import Path
        from dynsr.app.worker import LEAVE, run

        class Compiled:
            def find_spec(self, name, *_):
                if name == "dynsr.app.work":
                    ours.send((0, LEAVE, {{}}))
                    try:
                        time.sleep(30)
                    except KeyboardInterrupt:
                        raise ImportError("could not import module") from None

        ours, theirs = multiprocessing.Pipe()
        sys.meta_path.insert(0, Compiled())
        run(theirs, Path({str(tmp_path)!r}), 1)
    """
    command = [sys.executable, "-c", inspect.cleandoc(script)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    assert tmp_path.exists()


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{}", "127.0.0.1", "[::1]:{}", ""])
def test_another_name_for_this_machine_is_refused(page, host):
    """A name that was made to point here (DNS rebinding) is answered with nothing."""
    status, _, body = page.ask("", Host=host.format(page.port))
    assert (status in (400, 403), body) == (True, b"")


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_other_pages_of_the_browser_are_refused(page, headers):
    """What a page of another origin sends is refused, with the token and without."""
    assert page.ask("forget", b"{}", **headers)[::2] == (403, b"")
    assert page.ask("", **headers)[::2] == (403, b"")


def test_it_listens_to_this_machine_alone(page):
    """It is bound to 127.0.0.1: at the machine's other addresses nobody answers."""
    with socket.create_connection(("127.0.0.1", page.port), 5):
        pass
    addresses = {"127.0.0.2"} if sys.platform == "linux" else set()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
        contextlib.suppress(OSError),
    ):
        probe.connect(("192.0.2.1", 9))  # sends nothing, but chooses an address
        addresses.add(probe.getsockname()[0])
    for address in addresses - {"127.0.0.1"}:
        with socket.socket() as line:
            line.settimeout(2)
            assert line.connect_ex((address, page.port)) != 0


def test_nothing_is_loaded_from_elsewhere(page):
    """Page, styles and scripts name no address, and the browser is forbidden to ask for one."""
    for name in ("", "page.css", "page.js"):
        status, headers, body = page.ask(name)
        assert status == 200
        assert not re.search(r"(https?:)?//[a-z]", body.decode().replace("http://www.w3.org", ""))
        policy = headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "script-src 'self';" in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert not any(name.startswith("Access-Control") for name in headers)
    assert "<script>" not in page.ask("")[2].decode()


def test_a_file_that_is_too_large_is_refused_in_one_line(page):
    """A file above the limit is named with its size, and the page goes on as before."""
    body = b"t,x\n" + b"0,1\n" * 100_000
    status, _, answer = page.ask("data?name=large.csv", body)
    line = json.loads(answer)["error"]
    assert status == 413
    assert line.startswith("'large.csv' has 0.4 MB, more than the 0.25 MB that are taken;")
    assert page.ask("")[0] == 200


def test_a_body_without_end_is_cut(page):
    """What says to be far larger than the limit, or not how large, is not read to its end."""
    with socket.create_connection(("127.0.0.1", page.port), 10) as line:
        host = f"Host: 127.0.0.1:{page.port}\r\n"
        line.sendall(
            f"POST /{page.token}/data?name=a.csv HTTP/1.1\r\n{host}"
            "Content-Length: 99999999999\r\n\r\n".encode()
        )
        answer = b""
        with contextlib.suppress(ConnectionError):
            while piece := line.recv(1000):
                answer += piece
        assert answer.startswith(b"HTTP/1.1 4")
    assert page.ask("data?name=a.csv", method="POST")[0] == 411
    large = b'{"options": "' + b"x" * (1 << 19) + b'"}'
    with contextlib.suppress(ConnectionError, http.client.HTTPException):
        assert page.ask("search", large)[0] >= 400
    assert page.ask("")[0] == 200


@pytest.mark.parametrize("name", ["a.npz", "a.csv.gz", "a.mat", "a", "csv", "../../a.pkl"])
def test_only_text_and_spreadsheets_are_taken(page, name):
    """Whatever else may unfold to any size or is no table is refused by name."""
    status, _, answer = page.ask(f"data?name={quote(name, safe='')}", b"PK\x03\x04")
    assert status == 400
    assert (
        "is no table that the page takes (.csv, .tsv, .txt, .dat, .lvm, .xlsx"
        in json.loads(answer)["error"]
    )


HOSTILE = {
    "markup": "t,<img src=x onerror=alert(1)>\n" + "\n".join(f"{k},{k}" for k in range(20)),
    "formula": "t,=cmd|' /C calc'!A0\n" + "\n".join(f"{k},=1+{k}" for k in range(20)),
    "zip": b"PK\x03\x04" + bytes(100),
    "zeros": bytes(5000),
    "control": bytes(range(1, 9)) * 100,
    "quotes": 't,x\n0,"1\n1,2\n2,3\n' * 50,
    "wide": ",".join(f"c{k}" for k in range(2000)) + "\n" + ",".join(["1"] * 2000),
    "ragged": "t,x\n0,1\n1,2,3,4\n2\n",
    "no time": "x,y\n" + "\n".join(f"{k % 3},{k % 2}" for k in range(20)),
    "words": "a,b\nfoo,bar\nbaz,qux\n",
    "huge": "t,x\n" + "\n".join(f"{k},1e999" for k in range(20)),
    "empty": "",
    "not finite": "t,x\n" + "\n".join(f"{k},nan" for k in range(20)),
    "deep": "t," + "(" * 5000 + "\n0,1\n1,2\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_table_gives_one_line(page, kind):
    """Whatever the file holds, the page shows columns or the one line that the shell shows."""
    parts = page.drop(HOSTILE[kind], "bad.csv")
    line = parts["said"] or parts["table"]["error"] or parts["table"]["guess"]
    assert line and "\n" not in line
    assert "fault in dynsr" not in line and "Traceback" not in line and "/tmp" not in line
    table = parts["table"]
    if table is None or table["error"]:
        assert page.post("search", options={})[0] == 200
        assert page.wait(lambda parts: not parts["busy"])["said"]


@pytest.mark.slow
def test_the_line_is_that_of_the_shell(page, tmp_path, monkeypatch):
    """A table that cannot be read is refused in the very words of the command line."""
    bad = "t,x\n0,1\n1,2,3,4\n2\n"
    (tmp_path / "bad.csv").write_text(bad)
    monkeypatch.chdir(tmp_path)
    shell = run("discover", "bad.csv", code=2)
    parts = page.drop(bad, "bad.csv")
    assert f"error: {parts['said']}\n" == shell.stderr


@pytest.mark.parametrize(
    "name", ["../../etc/a.csv", "..\\a.csv", "/a.csv", ".a.csv", "a\n\x00b.csv"]
)
@pytest.mark.slow
def test_a_name_leads_nowhere(page, name):
    """The name of a file is a label: folders in it are left out."""
    parts = page.drop(TABLE, name)
    assert re.match(r"a(_ b)?\.csv: time 't', 30 rows", parts["table"]["guess"])


@pytest.mark.slow
def test_columns_are_guessed_and_corrected(page):
    """The page shows roles and units as read_trajectories guesses them, and takes others."""
    text = "t (days),well,x [mg],u,note\n" + "\n".join(
        f"{k},{well},{k + 1},{k % 2},hello" for well in "ab" for k in range(12)
    )
    table = page.drop(text)["table"]
    assert {c["name"]: c["role"] for c in table["columns"]} == {
        "t (days)": "time",
        "well": "trajectory",
        "x [mg]": "state",
        "u": "input",
        "note": "unused",
    }
    assert [c["unit"] for c in table["columns"]] == ["days", "", "mg", "", ""]
    assert [c["cells"][1] for c in table["columns"]] == ["1", "a", "2", "1", "hello"]
    roles = {c["name"]: c["role"] for c in table["columns"]} | {"u": "state", "x [mg]": "input"}
    assert page.post("columns", roles=roles, units={"u": "kg"}) == (200, "")
    parts = page.wait(lambda parts: not parts["busy"])
    assert parts["table"]["states"] == ["u"]
    assert "inputs x" in parts["table"]["guess"]
    assert [c["unit"] for c in parts["table"]["columns"]] == ["", "", "", "kg", ""]
    roles["u"] = "time"
    page.post("columns", roles=roles, units={})
    parts = page.wait(lambda parts: not parts["busy"])
    both = "columns 't (days)' and 'u' are both the time, and no date and clock; choose one"
    assert parts["table"]["error"] == both


@pytest.mark.slow
def test_how_an_input_goes_on_between_rows_is_chosen(page):
    """The page shows what an input does between rows, and takes another choice."""
    text = "t,x,u\n" + "\n".join(f"{k},{k**1.5:.4f},{k // 4 % 2}" for k in range(24))
    table = page.drop(text)["table"]
    assert {c["name"]: c["way"] for c in table["columns"]} == {"t": "", "x": "", "u": "previous"}
    roles = {c["name"]: c["role"] for c in table["columns"]}
    assert page.post("columns", roles=roles, units={}, ways={"u": "linear"}) == (200, "")
    table = page.wait(lambda parts: not parts["busy"])["table"]
    assert [c["way"] for c in table["columns"]] == ["", "", "linear"]
    assert "u (linear)" in table["guess"]


@pytest.mark.slow
def test_a_column_of_doses_is_chosen(page):
    """A column of amounts is given to a state, and the search follows no jump."""
    x = [8 * 0.8 ** (k % 12) for k in range(36)]
    lines = [f"{k},{x[k] if k % 12 else x[k - 1] * 0.8},{8 * (k % 12 == 0)}" for k in range(36)]
    table = page.drop("t,x,dose\n" + "\n".join(lines))["table"]
    roles = {c["name"]: c["role"] for c in table["columns"]} | {"dose": "dose"}
    page.post("columns", roles=roles, units={}, ways={"dose": "x"})
    table = page.wait(lambda parts: not parts["busy"])["table"]
    assert "x jumps by dose" in table["guess"] and table["error"] == ""
    assert table["columns"][2]["way"] == "x"
    page.post("columns", roles=roles, units={}, ways={"dose": "x/V"})
    table = page.wait(lambda parts: not parts["busy"])["table"]
    assert table["columns"][2]["way"] == "x/V" and table["error"] == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("head", "rows", "roles", "states", "runs"),
    [
        (
            "day,clock,x,valve",
            [f"12.03.2024,14:{k:02d},{0.9**k},{k // 10 % 2}" for k in range(40)],
            ["time", "time", "state", "input"],
            ["x"],
            1,
        ),
        (
            "kind,rep,t,x,valve",
            [f"{a},{b},{k},{0.9**k},{k // 5 % 2}" for a in "pq" for b in "12" for k in range(20)],
            ["trajectory", "trajectory", "time", "state", "input"],
            ["x"],
            4,
        ),
        (
            "variable,t,value,valve",
            [
                f"{a},{k},{b**k},{k // 5 % 2}"
                for a, b in (("S", 0.9), ("P", 1.1))
                for k in range(20)
            ],
            ["quantity", "time", "state", "input"],
            ["S", "P"],
            1,
        ),
        (
            "t,x_rep1,x_rep2,valve",
            [f"{k},{0.9**k},{1.1**k},{k // 5 % 2}" for k in range(20)],
            ["time", "state", "state", "input"],
            ["x"],
            2,
        ),
    ],
)
def test_roles_of_several_columns_are_kept_when_another_changes(
    page, head, rows, roles, states, runs
):
    """A date and a clock, two labels, quantities and runs side by side stay so when posted."""
    table = page.drop("\n".join([head, *rows]))["table"]
    assert [c["role"] for c in table["columns"]] == roles and table["states"] == states
    kept = {c["name"]: c["role"] for c in table["columns"]} | {"valve": "unused"}
    page.post("columns", roles=kept, units={})
    table = page.wait(lambda parts: not parts["busy"])["table"]
    assert (table["error"], table["states"]) == ("", states)
    assert f"{runs} trajectories" in table["guess"] or runs == 1


def test_the_page_says_what_looks_odd(page):
    """What dynsr describe notes of a table stands below the guess on the page."""
    spiked = [0.9**k + 3.0 * (k == 20) for k in range(40)]
    text = "t,x\n" + "\n".join(f"{k},{x}" for k, x in enumerate(spiked))
    notes = page.drop(text)["table"]["notes"]
    assert any(note.startswith("x is 3.122 in row 21, between") for note in notes)
    sound = "t,x\n" + "\n".join(f"{k},{0.9**k}" for k in range(40))
    assert page.drop(sound)["table"]["notes"] == []


@pytest.mark.parametrize(
    ("wish", "content", "words"),
    [
        ("search", {"options": {"preset": "fast"}}, "unknown preset 'fast'"),
        ("search", {"options": {"time_budget": "soon"}}, "time budget 'soon' is not a number"),
        ("search", {"options": {"functions": ["gamma"]}}, "gamma"),
        ("search", {"options": {"out": "/tmp/x"}}, "unknown option 'out'"),
        ("search", {"options": {"units": True}}, "no column has a unit"),
        ("redraw", {"values": {"x": [1]}}, "there are no equations yet"),
    ],
)
def test_odd_wishes_are_told_in_one_line(page, wish, content, words):
    """What cannot be done is said on the page, by what does it, in one line."""
    page.drop(TABLE)
    assert page.post(wish, **content)[0] == 200
    said = page.wait(lambda parts: not parts["busy"] and parts["said"])["said"]
    assert words in said and "\n" not in said


@pytest.mark.parametrize(
    ("wish", "body"),
    [
        ("search", b"nonsense"),
        ("search", b"[" * 90_000),
        ("search", b'{"options": 3}'),
        ("columns", b'{"roles": []}'),
        ("redraw", b'{"values": {"x": ["1"]}}'),
        ("redraw", b'{"values": {"x": [1e999, true]}}'),
        ("redraw", b'{"run": "a"}'),
    ],
)
def test_what_no_page_sends_is_refused(page, wish, body):
    """Bodies that are not what a wish has are refused with a line."""
    status, _, answer = page.ask(wish, body)
    assert status == 400
    assert "load the page again" in json.loads(answer)["error"] or "numbers" in str(answer)


@pytest.mark.slow
def test_a_search_answers_while_it_runs_and_can_be_cancelled(page):
    """While a search runs the page answers at once; cancelled, it shows what it has or says so."""
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.standard_normal((100, 2)), axis=0)
    rows = "\n".join(f"{k},{a},{b}" for k, (a, b) in enumerate(walk))
    page.drop("t,a,b\n" + rows)
    assert page.post("search", options={}) == (200, "")
    page.wait(lambda parts: parts.get("progress"))
    took = []
    for _ in range(20):
        began = time.monotonic()
        assert page.ask("changes?after=0")[0] == 200
        took.append(time.monotonic() - began)
    assert sorted(took)[10] < 1.0
    status, _, answer = page.ask("data?name=a.csv", TABLE.encode())
    assert (status, json.loads(answer)["error"]) == (400, "a search is running; cancel it first")
    assert page.post("stop") == (200, "")
    parts = page.wait(lambda parts: not parts["busy"], 30)
    if parts["found"] is None:
        assert "stopped" in parts["said"]
    else:
        assert parts["found"]["complete"] is False
        assert [page.ask(name)[0] for name in ("report.html", "model.py", "discovery.json")] == [
            200
        ] * 3
    assert page.drop(TABLE)["table"]["states"] == ["x", "y"]


@pytest.mark.slow
def test_what_is_downloaded_is_what_was_found(page, tmp_path):
    """Report, code and result of a search are files that hold the true equations."""
    page.drop(rabbits(), "my rabbits.csv")
    page.post("search", options={"preset": "quick", "functions": [], "seed": "3"})
    found = page.wait(lambda parts: not parts["busy"] and parts["found"])["found"]
    assert [e["level"] for e in found["equations"]] == ["law", "law"]
    status, headers, body = page.ask("discovery.json")
    assert status == 200
    assert headers["Content-Disposition"] == 'attachment; filename="my_rabbits-discovery.json"'
    (tmp_path / "d.json").write_bytes(body)
    loaded = dynsr.Discovery.load(tmp_path / "d.json")
    assert loaded.settings["seed"] == 3
    slope = loaded.to_numpy()(0.0, np.array([2.0, 5.0]))
    assert slope == pytest.approx([1.5 * 2 - 2 * 5, 2 * 5 - 3 * 5], rel=1e-3)
    code: dict = {}
    exec(page.ask("model.py")[2].decode(), code)
    assert code["rhs"](0.0, [2.0, 5.0]) == pytest.approx(slope)
    report = page.ask("report.html")[2].decode()
    assert report.startswith("<!doctype html>") and "Equations found" in report
    assert found["points"] == ["x = 0, y = 0: saddle", "x = 3, y = 1.5: centre"]
    assert found["flow"].startswith("<svg")
    assert found["branches"]["svg"].startswith("<svg")
    assert "Their number and kinds stay the same" in found["branches"]["caption"]
    # Every format that can hold the equations is a file, that of several files an archive.
    named = loaded.system.parameters
    offered = {one["file"] for one in found["exports"]}
    assert {"found_c.c", "found_do_mpc.py", "found_catalyst.jl"} <= offered
    for file in offered:
        status, headers, held = page.ask(file)
        assert status == 200 and headers["Content-Disposition"].endswith(f'my_rabbits-{file}"')
        assert held and (file.endswith((".zip", ".bib", ".html", ".tex")) or "k1" in held.decode())
    code = {"__name__": "found"}
    exec(page.ask("found_python.py")[2].decode(), code)
    assert code["rhs"](0.0, [2.0, 5.0], **named.numbers) == pytest.approx(slope)
    assert page.ask("found_nothing.c")[0] == 400 and page.ask("found_../x.c")[0] == 404
    # Other constants move the curve, and no more than the curve.
    before = page.wait(lambda parts: parts.get("picture"))["picture"]["svg"]
    page.post("redraw", values={"x": [-1.0, 2.0]})
    after = page.wait(lambda parts: parts["picture"] and parts["picture"]["svg"] != before)
    assert after["picture"]["lines"][0] == "x' = -x*y + 2*x"
    assert json.loads(page.ask("discovery.json")[2])["equations"] == json.loads(body)["equations"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("name", "code", "line"),
    [
        ("SIGINT", 130, "error: interrupted\n"),
        ("SIGTERM", 143, "error: terminated\n"),
        ("SIGKILL", -9, ""),
    ],
)
def test_its_end_in_a_search_leaves_nothing_behind(tmp_path, name, code, line):
    """Ctrl-C, SIGTERM or a kill end the page, its search and all workers; no data are left."""
    rng = np.random.default_rng(1)
    walk = np.cumsum(rng.standard_normal((60, 2)), axis=0)
    (tmp_path / "w.csv").write_text(
        "t,a,b\n" + "\n".join(f"{k},{a},{b}" for k, (a, b) in enumerate(walk))
    )
    served = Page(str(tmp_path / "w.csv"), "-j", "2", folder=tmp_path)
    served.wait(lambda parts: parts.get("table") and not parts["busy"])
    served.post("search", options={"preset": "quick", "functions": []})
    served.wait(lambda parts: parts.get("progress") and parts["progress"]["running"])
    below = descendants(served.process.pid)
    assert len(below) >= 2
    ended, said = served.end(signal.Signals[name])
    assert ended == code
    assert said.startswith(line) and (said == line or name == "SIGKILL")
    end = time.monotonic() + 120
    while (any(map(alive, below)) or list(tmp_path.glob("d*"))) and time.monotonic() < end:
        time.sleep(0.1)
    assert [pid for pid in below if alive(pid)] == []
    assert list(tmp_path.glob("dynsr-app-*")) == []


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.slow
def test_a_signal_between_two_steps_of_the_server_ends_it(tmp_path):
    """SIGTERM that comes just as the loop calls something ends the page, whatever that was."""
    script = tmp_path / "ended.py"
    script.write_text(
        inspect.cleandoc(
            """
            import asyncio, signal, sys

            called, step = 0, asyncio.events.Handle._run.__code__

            def look(frame, event, argument):
                global called
                asked = frame.f_code.co_name == "get" and "serving" in frame.f_code.co_filename
                if event == "call" and (asked or called and frame.f_code is step):
                    called += 1
                    if called == which:
                        sys.setprofile(None)
                        signal.raise_signal(signal.SIGTERM)

            if __name__ == "__main__":
                which = int(sys.argv.pop(1))
                # Imports that are looked at take five times as long.
                import dynsr.app.serving
                from dynsr.cli import main
                sys.setprofile(look)
                main()
            """
        )
    )
    for k in range(2, 9):
        served = Page(folder=tmp_path, program=(str(script), str(k)))
        with contextlib.suppress(OSError, http.client.HTTPException):
            for _ in range(3):
                served.ask("changes?after=0")
        assert served.end(0) == (143, "error: terminated\n")


def descendants(pid):
    """Give the processes below one, by their ids."""
    import psutil

    return [child.pid for child in psutil.Process(pid).children(recursive=True)]


def alive(pid):
    """Say whether a process runs; a zombie does not."""
    import psutil

    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.fixture
def own_page(page):
    """Serve a page of a test's own, and say which processes work for it."""
    psutil = pytest.importorskip("psutil", reason="psutil, which comes with dask, is not installed")

    def workers():
        found = psutil.Process().children()
        return {child.pid for child in found if "spawn_main" in " ".join(child.cmdline())}

    before = workers()
    served = PageHere()
    yield served, lambda: workers() - before
    served.end()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is a signal of POSIX")
def test_a_worker_that_dies_is_told_and_replaced(own_page):
    """Where the process behind the page is killed, the page says so and works on with the data."""
    served, workers = own_page
    served.drop("t,x\n" + "\n".join(f"{k / 10},{math.exp(-k / 10)!r}" for k in range(40)))
    served.post("search", options={})
    served.wait(lambda parts: parts.get("progress"))
    for pid in workers():
        os.kill(pid, signal.SIGKILL)
    parts = served.wait(lambda parts: parts["said"] and not parts["busy"])
    assert "died, perhaps for want of memory" in parts["said"]
    assert parts["table"]["states"] == ["x"]
    served.post("search", options={"preset": "quick", "functions": []})
    assert served.wait(lambda parts: not parts["busy"] and parts["found"])


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is a signal of POSIX")
def test_a_worker_that_does_not_start_is_tried_again_only_when_asked(own_page):
    """A worker that dies at its start is told of, and started once more for the next file."""
    served, workers = own_page
    for pid in workers():
        os.kill(pid, signal.SIGKILL)
    said = served.wait(lambda parts: parts.get("said"))["said"]
    assert "does not start" in said
    assert workers() == set()
    assert served.drop(TABLE)["table"]["states"] == ["x", "y"]


def test_a_spreadsheet_is_read_and_a_broken_one_named(page, tmp_path):
    """The first sheet with a table gives the columns; a file that only says to be one is named."""
    openpyxl = pytest.importorskip("openpyxl", reason="openpyxl is not installed")
    pytest.importorskip("python_calamine", reason="python-calamine is not installed")
    book = openpyxl.Workbook()
    for row in (["t", "x"], *([0.1 * k, 2.0 + k] for k in range(20))):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    parts = page.drop((tmp_path / "a.xlsx").read_bytes(), "a.xlsx")
    assert parts["table"]["states"] == ["x"] and parts["table"]["rows"] == 20
    said = page.drop(b"PK\x03\x04" + bytes(100), "b.xlsx")["said"]
    assert said.startswith("'b.xlsx' is damaged or not a spreadsheet")


def test_the_example_is_read_like_a_dropped_file(page):
    """One wish gives the data that come with the page."""
    assert page.post("example") == (200, "")
    parts = page.wait(lambda parts: not parts["busy"] and parts.get("table"))
    assert parts["table"]["states"] == ["prey", "predators"]
    assert "in days" in parts["table"]["guess"]


def test_other_data_begin_anew(page):
    """After Other data nothing of the earlier ones is there, nor can be asked for."""
    assert page.drop(TABLE)["preview"]["svg"].startswith("<svg")
    assert page.post("forget") == (200, "")
    parts = page.wait(lambda parts: not parts["busy"])
    assert (parts["table"], parts["preview"], parts["found"]) == (None, None, None)
    assert page.post("columns", roles={}, units={}) == (400, "there are no data; drop a file first")


def test_what_cannot_be_served_is_one_line():
    """A file that is not there and a port that is taken end in one line and exit code 2."""
    done = run("app", "--no-browser", "nowhere.csv", code=2)
    line = "error: there is no file 'nowhere.csv'; check the name\n"
    assert (done.stderr, done.stdout) == (line, "")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        # In a process of its own: tornado leaves the socket that it could not bind to be collected.
        command = [sys.executable, "-m", "dynsr", "app", "--no-browser", "--port", str(port)]
        ended = subprocess.run(command, capture_output=True, text=True)
    line = f"error: port {port} of 127.0.0.1 cannot be used; give another, or 0\n"
    assert (ended.returncode, ended.stderr, ended.stdout) == (2, line, "")


def test_other_commands_do_not_load_the_page():
    """Neither dynsr nor its other commands import the page or what serves it."""
    code = (
        "import sys; from dynsr.cli.app import app; import typer; typer.main.get_command(app);"
        "print([m for m in sys.modules if m.startswith(('tornado', 'dynsr.app', 'asyncio'))])"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
        == "[]\n"
    )


def test_without_its_library_the_command_says_what_to_install():
    """Where tornado is absent, the line holds the command that installs it."""
    code = (
        "import sys; sys.modules['tornado'] = None; sys.argv = ['dynsr', 'app', '--no-browser'];"
        "from dynsr.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (
        2,
        f"error: the page needs tornado: {say_install('app')}\n",
    )


def test_options_of_the_page_are_arguments_of_discover():
    """Every option that the page sends is an argument of discover, with its kind of value."""
    given = {
        "preset": "quick",
        "scheme": "gp",
        "time_budget": "12.5",
        "max_complexity": "80",
        "terms": "x*y, x/(1+x)",
        "conserved": "x+y",
        "seed": "7",
        "snap": False,
        "nonnegative": True,
        "units": True,
        "second_order": True,
        "explicit_time": True,
        "discrete": False,
        "functions": [],
    }
    found = read_options(given, ["x", "y"])
    assert set(found) <= set(inspect.signature(dynsr.discover).parameters)
    assert found["terms"] == ["x*y", "x/(1+x)"]
    assert found["nonnegative"] == ("x", "y") and found["order"] == 2
    assert (found["time_budget"], found["seed"], found["functions"]) == (12.5, 7, [])
    script = (Path(dynsr.__file__).parent / "app/page/page.js").read_text()
    assert all(f'"{name}"' in script or f"options.{name}" in script for name in given)


@pytest.mark.slow
def test_units_of_the_page_reach_the_search(tmp_path):
    """Units that are typed are those in which equations must make sense, and coefficients have."""
    pytest.importorskip("pint", reason="the extra units is not installed")
    t = np.linspace(0, 4, 60)
    (tmp_path / "a.csv").write_text(
        "t,x\n" + "\n".join(f"{a!r},{math.exp(-a / 2)!r}" for a in t.tolist())
    )
    parts: dict = {}
    work = Work(tmp_path, parts.__setitem__, 1)
    work.read(str(tmp_path / "a.csv"), {"t": "time", "x": "state"}, {"t": "h", "x": "mg"})
    work.search({"preset": "quick", "functions": [], "units": True})
    [constant] = parts["found"]["constants"]
    assert (constant["of"], constant["unit"], constant["name"]) == ("x", "1/h", "k1")
    assert parts["found"]["points"] == ["x = 0: stable node"] and parts["found"]["flow"] == ""
    assert "of x while k1" in parts["found"]["branches"]["caption"]
    assert constant["value"] == pytest.approx(-0.5, rel=1e-6)
    assert "time t (h)" in parts["picture"]["svg"]


def read_columns(folder, columns):
    """Give the parts of the page after columns were read, and what works behind it."""
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    (folder / "a.csv").write_text("\n".join(lines))
    parts: dict = {}
    work = Work(folder, parts.__setitem__, 1)
    work.read(str(folder / "a.csv"))
    return parts, work


def search_columns(folder, columns, **options):
    """Give the same after a search of the columns."""
    parts, work = read_columns(folder, columns)
    work.search({"preset": "quick", "functions": [], **options})
    return parts, work


@pytest.mark.slow
def test_each_run_has_its_picture(tmp_path):
    """Of several trajectories the page draws the one that is chosen, from its own start.

    Constants that were moved, and the run, are said with the picture, for a page that reloads.
    """
    t = np.arange(0, 4, 0.1)
    columns = {"run": np.repeat([1, 2], len(t)), "t": np.tile(t, 2)}
    columns["x"] = np.concatenate([np.exp(-t), 5 * np.exp(-t)])
    parts, work = search_columns(tmp_path, columns)
    assert parts["found"]["runs"] == ["1", "2"]
    first = parts["picture"]["svg"]
    assert (parts["picture"]["values"], parts["picture"]["run"]) == ({}, 0)
    work.redraw({"x": [-0.7]}, 1)
    assert parts["picture"]["svg"] != first and parts["picture"]["said"] == ""
    assert (parts["picture"]["values"], parts["picture"]["run"]) == ({"x": [-0.7]}, 1)
    assert parts["picture"]["lines"] == ["x' = -0.7*x"]
    work.redraw({}, 0)
    assert parts["picture"]["svg"] == first
    for name in FILES:
        work.write(name)
        assert (tmp_path / name).stat().st_size > 50


@pytest.mark.slow
def test_forced_equations_are_drawn_with_their_input(tmp_path):
    """An input of the data drives the curve that is drawn."""
    t = np.arange(0, 12, 0.05)
    x = (2 * np.cos(t) + np.sin(t)) / 5 + np.exp(-2 * t)
    parts, _ = search_columns(tmp_path, {"t": t, "x": x, "u": np.sin(t + np.pi / 2)})
    assert [e["text"] for e in parts["found"]["equations"]] == ["x' = u - 2*x"]
    assert parts["picture"]["said"] == ""


@pytest.mark.slow
def test_second_order_and_maps_have_pictures_too(tmp_path):
    """Equations of second order and steps from row to row are shown, drawn and moved."""
    t = np.arange(0, 10, 0.05)
    parts, work = search_columns(tmp_path, {"t": t, "x": np.cos(2 * t)}, second_order=True)
    assert parts["found"]["equations"][-1]["text"].endswith("= -4*x")
    assert parts["picture"]["said"] == ""
    orbit = [0.3]
    while len(orbit) < 60:
        orbit.append(3.7 * orbit[-1] * (1 - orbit[-1]))
    columns = {"t": np.arange(60.0), "x": np.array(orbit)}
    parts, work = search_columns(tmp_path, columns, discrete=True)
    assert parts["found"]["equations"][0]["text"].startswith("x[n+1] = ")
    assert parts["picture"]["said"] == ""
    before = parts["picture"]["svg"]
    work.redraw({"x": [0.9 * c["value"] for c in parts["found"]["constants"]]}, 0)
    assert parts["picture"]["svg"] != before


@pytest.mark.slow
def test_constants_that_diverge_are_told(tmp_path):
    """Where the moved equations have no solution over the data, the page says when it ends."""
    t = np.arange(0, 4, 0.1)
    parts, work = read_columns(tmp_path, {"t": t, "x": 1 / (1 + t)})
    work.keep({"x": "-0.999*x**2"}, {"preset": "quick"})
    assert parts["found"]["equations"][0]["text"] == "x' = -0.999*x**2"
    work.redraw({}, 0)
    assert parts["picture"]["said"] == ""
    work.redraw({"x": [1.0]}, 0)
    assert "t = " in parts["picture"]["said"] and "\n" not in parts["picture"]["said"]


@pytest.mark.slow
def test_live_reports_name_each_states_best_equation():
    """As a search goes on, each state has the best equation that any search has for it."""
    said = []
    run = read_trajectories({"t": np.linspace(0, 3, 40), "x": np.exp(-np.linspace(0, 3, 40))})
    live = Live(["x"], lambda name, content: said.append(content))
    dynsr.discover(run.trajectories, preset="quick", functions=[], jobs=1, progress=live)
    assert said[-1]["best"]["x"]["text"] == "x' = -x"
    assert "<math" in said[-1]["best"]["x"]["mathml"]
    whole = {"x": parse("y - x"), "y": parse("-2*x")}
    live(Step("", 1, 4, running=(Running("a", "x' with y", equations=whole),)))
    assert [own["text"] for own in said[-1]["best"].values()] == ["x' = -x + y", "y' = -2*x"]
    live(Step("", 2, 0))
    assert (said[-1]["share"], said[-1]["left"]) == (
        None,
        "fitting constants and making the verdict",
    )
    live(Step("", 1, 4, seconds=65.0, seconds_left=30.0))
    assert (said[-1]["share"], said[-1]["tasks"]) == (0.25, "1 of 4 tasks")
    assert (said[-1]["time"], said[-1]["left"]) == ("1:05", "about 0:30 left")
