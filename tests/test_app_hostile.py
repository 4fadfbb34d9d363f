"""The local page against odd requests, slow uploads and sudden ends: nothing told, nothing lost."""

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from served_page import PageHere, rabbits
from waiting import wait_for

import dynsr
from dynsr.data.temporary import own_folder

pytest.importorskip("tornado", reason="the extra app is not installed")
from dynsr.app import desk as desks
from dynsr.app import worker as workers
from dynsr.app.serving import _clean
from dynsr.app.work import Work

pytestmark = pytest.mark.xdist_group("app")

TABLE = "t,x,y\n" + "\n".join(f"{k / 10:g},{k**3},{k * k}" for k in range(30))
OTHER = "t,p,q\n" + "\n".join(f"{k / 10:g},{k**3 + 1},{k * k + 1}" for k in range(30))
posix = pytest.mark.skipif(os.name != "posix", reason="signals and locks of POSIX")


@pytest.fixture(scope="module")
def page():
    """Serve one page for all tests that leave it as it is."""
    served = PageHere()
    yield served
    served.end()


@pytest.fixture
def fresh():
    """Serve a page of a test's own."""
    served = PageHere()
    yield served
    served.end()


def say(page, *parts, patience=10):
    """Send bytes as they are; give the status and all that is answered."""
    with socket.create_connection(("127.0.0.1", page.port), timeout=patience) as line:
        for part in parts:
            line.sendall(part)
        line.settimeout(patience)
        answer = b""
        with contextlib.suppress(TimeoutError, ConnectionError):
            while b"\r\n\r\n" not in answer:
                piece = line.recv(65536)
                if not piece:
                    break
                answer += piece
            head, _, body = answer.partition(b"\r\n\r\n")
            lengths = [h for h in head.lower().split(b"\r\n") if h.startswith(b"content-length:")]
            wanted = int(lengths[0].partition(b":")[2]) if lengths else 0
            while len(body) < wanted:
                body += line.recv(65536)
            answer = head + b"\r\n\r\n" + body
    status = int(answer.split(b" ", 2)[1]) if answer.startswith(b"HTTP") else 0
    return status, answer


def request(page, line, *headers, body=b""):
    """Give the bytes of a request to this page."""
    host = f"Host: 127.0.0.1:{page.port}".encode()
    return b"\r\n".join([line, host, b"Connection: close", *headers, b"", body])


STRANGE = [
    *(b"OPTIONS * HTTP/1.1", b"GET * HTTP/1.1", b"GET foo HTTP/1.1", b"POST foo HTTP/1.1"),
    *(b"GET ? HTTP/1.1", b"GET # HTTP/1.1", b"GET // HTTP/1.1", b"GET http://a/b/ HTTP/1.1"),
    *(b"CONNECT a:1 HTTP/1.1", b"FOO / HTTP/1.1", b"TRACE /x/ HTTP/1.1", b"HEAD /x HTTP/1.1"),
    *(b"GET /%ff%fe/ HTTP/1.1", b"GET /\xff\xfe/ HTTP/1.1", b"PUT /x/data HTTP/1.1"),
    *(b"GET /x/changes?after=%ff HTTP/1.1", b"POST /x/data?name=%ff HTTP/1.1"),
    *(b"GET /" + b"a/" * 2000 + b" HTTP/1.1", b"GET /x/page.js;y HTTP/1.1"),
]


@pytest.mark.parametrize("line", STRANGE)
def test_who_does_not_know_the_token_learns_nothing_from_odd_requests(page, line):
    """Whatever the form of a request: 404 without a word, or 400 where it is no HTTP at all."""
    status, answer = say(page, request(page, line, b"Content-Length: 0"))
    assert status in (400, 404), answer
    assert answer.partition(b"\r\n\r\n")[2] == b"", answer


ODD_HEADERS = [
    *(b"Content-Length: -1", b"Content-Length: " + b"9" * 5000, b"Content-Length: 1e3"),
    *(b"Content-Length: \xb2", b"Content-Length: 5, 5", b"Transfer-Encoding: chunked"),
    *(b"Content-Type: multipart/form-data; boundary=", b"Cookie: \xff=\x01", b"X: " + b"a" * 9000),
    *(b"Content-Type: application/x-www-form-urlencoded", b"Accept-Encoding: \xff"),
    *(b"Origin: \xff", b"Sec-Fetch-Site: \xff", b"Range: bytes=a-b", b"If-None-Match: \xff"),
    *(b"Expect: 100-continue", b"Content-Encoding: gzip", b"X-Forwarded-For: ../../etc"),
]


@pytest.mark.parametrize("header", ODD_HEADERS)
@pytest.mark.parametrize("path", ["", "changes?after=0", "data?name=a.csv", "columns", "stop"])
def test_odd_headers_are_no_fault(page, header, path):
    """Who knows the token is answered or refused; nothing ends in a fault or names a place."""
    verb = b"POST" if path in ("data?name=a.csv", "columns", "stop") else b"GET"
    line = verb + f" /{page.token}/{path} HTTP/1.1".encode()
    status, answer = say(page, request(page, line, header, body=b"0\r\n\r\n"), patience=3)
    assert status == 0 or status < 500, answer
    assert b"fault in dynsr" not in answer and b"/tmp" not in answer
    assert page.ask("changes?after=0")[0] == 200


@pytest.mark.slow
def test_random_requests_are_no_fault(page):
    """Three hundred requests with a byte put in or changed: never a fault, never a place."""
    draw = random.Random(3)
    host = f"Host: 127.0.0.1:{page.port}\r\n".encode()
    wishes = [b"", b"changes?after=0", b"data?name=a.csv", b"redraw", b"columns", b"report.html"]
    for _ in range(300):
        path = b"/" + page.token.encode() + b"/" + draw.choice(wishes)
        verb = draw.choice([b"GET", b"POST", b"OPTIONS", b"HEAD", b"DELETE"])
        body = draw.choice([b"", b"{}", b'{"values": {"x": [1]}}', b"t,x\n0,1\n"])
        whole = b"%s %s HTTP/1.1\r\n%sContent-Length: %d\r\n\r\n%s" % (
            verb,
            path,
            host,
            len(body),
            body,
        )
        at = draw.randrange(len(whole))
        piece = bytes([draw.randrange(256)])
        cut = draw.choice([whole[:at] + piece + whole[at + 1 :], whole[:at] + piece + whole[at:]])
        status, answer = say(page, cut, patience=0.3)
        assert status < 500 and b"fault in dynsr" not in answer, cut
        assert b"/tmp" not in answer and b"Error" not in answer, cut
    assert page.ask("changes?after=0")[0] == 200


LONG = ["a" * 500, "é" * 300, "測" * 200, "😀" * 100, "." + "x" * 300, "a.b" * 100]


@pytest.mark.parametrize("stem", LONG)
@pytest.mark.parametrize("suffix", [".csv", ".測測測測測測測測測測測測", ""])
@pytest.mark.slow
def test_long_names_are_cut_by_bytes(page, stem, suffix):
    """A name of any length and letters can be written; one that is no table's is refused by it."""
    assert len(_clean(stem + suffix).encode()) <= 100
    status, _, body = page.ask(f"data?name={quote(stem + suffix)}", TABLE.encode())
    assert status == (200 if suffix == ".csv" else 400), body
    assert b"/tmp" not in body
    page.wait(lambda parts: not parts["busy"])


def begin_upload(page, text, name):
    """Send the head and half of a file; give the line and the other half."""
    body = text.encode()
    line = socket.create_connection(("127.0.0.1", page.port), timeout=30)
    where = f"POST /{page.token}/data?name={name} HTTP/1.1".encode()
    head = request(page, where, f"Content-Length: {len(body)}".encode())
    half = len(body) // 2
    line.sendall(head + body[:half])
    return line, body[half:]


def end_upload(line, rest):
    """Send what is left; give the status."""
    with line:
        line.sendall(rest)
        return int(line.recv(65536).split(b" ", 2)[1])


@pytest.mark.slow
def test_a_slow_file_is_not_lost_to_a_quick_one(page):
    """Each file that comes in has a place of its own: the one that ends last is read last."""
    slow = begin_upload(page, OTHER, "slow.csv")
    assert page.drop(TABLE, "quick.csv")["table"]["states"] == ["x", "y"]
    assert end_upload(*slow) == 200
    parts = page.wait(lambda parts: not parts["busy"] and parts["table"]["guess"][:4] == "slow")
    assert parts["table"]["states"] == ["p", "q"] and parts["said"] == ""


def held(page):
    """Give the names of the files that the page keeps."""
    files = Path(tempfile.gettempdir()).glob("dynsr-app-*/data-*/*")
    return {p.name for p in files if p.name.startswith(page.token[:6])}


@pytest.mark.slow
def test_only_the_file_that_is_shown_is_kept(fresh):
    """Files that were read before, broken off or refused are gone, and all after Other data."""
    mark = fresh.token[:6]
    for k in range(3):
        fresh.drop(TABLE, f"{mark}{k}.csv")
    line, _ = begin_upload(fresh, OTHER, f"{mark}-half.csv")
    line.close()
    assert wait_for(lambda: held(fresh) == {f"{mark}2.csv"})
    fresh.post("forget")
    # The server may see only now that a file was broken off.
    assert wait_for(lambda: not held(fresh))


def test_a_full_disk_is_told_without_a_place(page, monkeypatch):
    """Where a file cannot be kept, the page says so by the file's own name."""

    def refuse(*_, **__):
        raise OSError(28, "No space left on device", "/tmp/secret")

    monkeypatch.setattr(desks.Desk, "place_for", refuse)
    status, _, body = page.ask("data?name=a.csv", TABLE.encode())
    assert (status, json.loads(body)["error"]) == (
        507,
        "'a.csv' cannot be kept: No space left on device",
    )


def test_nothing_is_downloaded_after_other_data(page):
    """What was found in data that are gone is not given any more."""
    page.drop(TABLE)
    page.post("forget")
    for name in ("report.html", "model.py", "discovery.json"):
        status, _, body = page.ask(name)
        assert (status, json.loads(body)["error"]) == (
            400,
            "there are no equations; find them first",
        )


HOLD = """
import os, signal, sys, time
from dynsr.data.temporary import own_folder
with own_folder("dynsr-app-") as folder:
    (folder / "data.csv").write_text("private")
    print(folder, flush=True)
    time.sleep(60)
"""


@posix
def test_folders_of_the_killed_go_at_the_next_start(tmp_path, monkeypatch):
    """A folder goes when its owner was killed; one whose owner lives, or of others, stays."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    children = [
        subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    killed, living = (Path(child.stdout.readline().strip()) for child in children)
    children[0].kill()
    children[0].wait()
    foreign, thesis = tmp_path / "dynsr-app-mine", tmp_path / "thesis"
    foreign.mkdir()
    (foreign / "notes").write_text("mine")
    thesis.mkdir()
    (thesis / "owner").write_text("mine")
    (tmp_path / "dynsr-app-link").symlink_to(thesis)
    (tmp_path / "dynsr-app-file").write_text("mine")
    fifo = tmp_path / "dynsr-app-fifo"
    fifo.mkdir()
    os.mkfifo(fifo / "owner-to-be")
    assert killed.exists() and living.exists()
    with own_folder("dynsr-app-") as folder:
        assert not killed.exists()
        assert (living / "data.csv").read_text() == "private" and folder.exists()
        assert (foreign / "notes").exists() and (thesis / "owner").exists() and fifo.exists()
    assert not folder.exists()
    for child in children:
        child.kill()
        child.communicate()
    with own_folder("dynsr-app-"):
        assert not living.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("dynsr-app-fifo", "dynsr-app-file", "dynsr-app-link", "dynsr-app-mine", "thesis")
    ]


@pytest.mark.slow
def test_the_folder_goes_before_the_work_is_stopped(tmp_path, monkeypatch):
    """Where the page was killed its data are removed first: the worker may end at once then."""
    folder, seen = tmp_path / "dynsr-app-x", []
    folder.mkdir()
    (folder / "data.csv").write_text("private")

    class Gone:
        def recv(self):
            raise EOFError

    monkeypatch.setattr(workers, "signal_main", lambda number: seen.append(folder.exists()))
    monkeypatch.setattr(workers, "_SECONDS_TO_LEAVE", 0.0)
    monkeypatch.setattr(os, "_exit", seen.append)
    worker = workers._Worker(Gone(), folder)
    worker._loaded = True
    worker.listen()
    assert seen == [False, 1]
    # What a job wrote later goes at the end.
    folder.mkdir()
    worker.clear()
    assert not folder.exists()


def walk():
    """Give data without a law, in which a search has formulas soon and no end."""
    rows = np.cumsum(np.random.default_rng(0).standard_normal((100, 2)), axis=0).tolist()
    return "t,a,b\n" + "\n".join(f"{k},{a!r},{b!r}" for k, (a, b) in enumerate(rows))


def best_of(parts):
    """Give the formulas that the page shows of a search that runs."""
    return {s: one["formula"] for s, one in ((parts.get("progress") or {}).get("best", {})).items()}


@pytest.mark.slow
@posix
@pytest.mark.parametrize("end", ["cancel", "kill"])
def test_the_equations_on_the_screen_are_kept(fresh, monkeypatch, end):
    """Cancelled by force, or where the process dies: the best so far is kept, judged by nobody."""
    psutil = pytest.importorskip("psutil", reason="psutil is not installed")
    monkeypatch.setattr(desks, "_SECONDS_TO_STOP", 0.0)
    fresh.drop(walk())
    fresh.post("search", options={"seed": "5"})
    shown = best_of(fresh.wait(lambda parts: len(best_of(parts)) == 2))
    if end == "cancel":
        fresh.post("stop")
    else:
        for child in psutil.Process().children():
            if "spawn_main" in " ".join(child.cmdline()):
                child.kill()
    parts = fresh.wait(lambda parts: not parts["busy"] and parts["picture"])
    found = parts["found"]
    assert found["complete"] is False and found["heading"].endswith("No verdict.")
    assert {e["state"] for e in found["equations"]} == {"a", "b"}
    assert [e["level"] for e in found["equations"]] == ["", ""]
    assert ("died" in parts["said"]) == (end == "kill")
    saved = json.loads(fresh.ask("discovery.json")[2])
    assert saved["complete"] is False and saved["settings"]["seed"] == 5
    assert set(saved["equations"]) == set(shown)
    for name in ("report.html", "model.py"):
        assert fresh.ask(name)[0] == 200
    # The page goes on with the same data.
    assert parts["table"]["states"] == ["a", "b"]
    fresh.post("redraw", values={}, run=0)
    assert fresh.wait(lambda parts: not parts["busy"])["picture"]["values"] == {}


@pytest.mark.slow
@posix
def test_what_was_found_outlives_the_process_that_draws(fresh):
    """A worker that dies when the search is over takes nothing with it."""
    psutil = pytest.importorskip("psutil", reason="psutil is not installed")
    fresh.drop(rabbits())
    fresh.post("search", options={"preset": "quick", "functions": []})
    before = fresh.wait(lambda parts: not parts["busy"] and parts["picture"])
    saved = json.loads(fresh.ask("discovery.json")[2])
    fresh.post("redraw", values={"x": [-1.0, 2.0]}, run=0)
    fresh.wait(lambda parts: parts["picture"]["values"])
    for child in psutil.Process().children():
        if "spawn_main" in " ".join(child.cmdline()):
            child.kill()
    after = fresh.wait(lambda parts: "died" in parts["said"] and parts["picture"])
    assert after["found"]["equations"] == before["found"]["equations"]
    assert after["found"]["heading"] == before["found"]["heading"]
    assert after["picture"]["values"] == {}
    assert json.loads(fresh.ask("discovery.json")[2]) == saved


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "x' = -0.5*x"),
        ({"discrete": True}, "x[n+1] = -0.5*x"),
        ({"second_order": True}, "x_dot' = -0.5*x"),
        ({"explicit_time": True}, "x' = -0.5*x"),
    ],
)
@pytest.mark.slow
def test_formulas_are_kept_in_their_form(options, text, tmp_path):
    """Maps, second order and the time are kept as they were asked for, and can all be written."""
    t = np.arange(0, 6, 0.1)
    rows = "\n".join(
        f"{a!r},{b!r}" for a, b in zip(t.tolist(), np.exp(-t / 2).tolist(), strict=True)
    )
    (tmp_path / "a.csv").write_text(f"t,x\n{rows}")
    parts: dict = {}
    work = Work(tmp_path, parts.__setitem__, 1)
    work.read(str(tmp_path / "a.csv"))
    state = "x_dot" if "second_order" in options else "x"
    work.keep({state: "-0.5*x", "a task": "x"}, {"preset": "quick", **options})
    assert text in [e["text"] for e in parts["found"]["equations"]]
    assert "No verdict." in parts["found"]["heading"] and not parts["found"]["complete"]
    again = Work(tmp_path, parts.__setitem__, 1)
    again.read(str(tmp_path / "a.csv"))
    kept = parts.pop("found")
    again.restore()
    assert parts["found"] == kept
    for one in (work, again):
        one.redraw({}, 0)
        assert parts["picture"]["values"] == {}
        for name in ("report.html", "model.py", "discovery.json"):
            one.write(name)
    assert dynsr.Discovery.load(tmp_path / "discovery.json").complete is False


@posix
@pytest.mark.slow
def test_no_folder_is_left_where_all_are_killed(tmp_path):
    """Page and worker killed at once in a search: the next start removes what they left."""
    from served_page import Page

    psutil = pytest.importorskip("psutil", reason="psutil is not installed")
    (tmp_path / "w.csv").write_text(walk())
    first = Page(str(tmp_path / "w.csv"), folder=tmp_path)
    first.wait(lambda parts: parts.get("table") and not parts["busy"])
    first.post("search", options={})
    first.wait(lambda parts: parts.get("progress"))
    below = psutil.Process(first.process.pid).children(recursive=True)
    for process in (*below, first.process):
        os.kill(process.pid, signal.SIGKILL)
    first.process.communicate()
    assert list(tmp_path.glob("dynsr-app-*"))
    second = Page(folder=tmp_path)
    assert len(list(tmp_path.glob("dynsr-app-*"))) == 1
    second.end()
    assert list(tmp_path.glob("dynsr-app-*")) == []
