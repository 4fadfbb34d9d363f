"""The local page, served in a process of its own, as tests and browsers ask it."""

import contextlib
import http.client
import itertools
import json
import os
import queue
import subprocess
import sys
import threading
import time
from urllib.parse import quote, urlsplit

import numpy as np

from dynsr.data import find_system
from dynsr.engines import simulate


def rabbits():
    """Give clean data of Lotka and Volterra's equations as the text of a table."""
    times = np.arange(0, 8, 0.05)
    made = simulate(find_system("lotka-volterra"), t=times, reltol=1e-9, abstol=1e-12)
    rows = np.column_stack([made.t, made.x]).tolist()
    return "t,x,y\n" + "\n".join(",".join(map(repr, row)) for row in rows)


class Asked:
    """A page at an address, and what a browser may ask it."""

    def __init__(self, url):
        self.url = url
        parts = urlsplit(url)
        self.port, self.token = parts.port, parts.path.strip("/")

    def ask(self, path, body=None, token=None, method=None, **headers):
        """Give the status, the headers and the body of an answer."""
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        with contextlib.closing(line):
            where = f"/{self.token if token is None else token}/{path}"
            method = method or ("GET" if body is None else "POST")
            line.putrequest(method, where, skip_host=True)
            given = {"Host": f"127.0.0.1:{self.port}", **headers}
            if body is not None:
                given.setdefault("Content-Length", str(len(body)))
            for name, value in given.items():
                line.putheader(name.replace("_", "-"), value)
            line.endheaders()
            if body is not None:
                line.send(body)
            answer = line.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()

    def post(self, wish, **content):
        """Give the status and the line of an answer to a wish."""
        status, _, body = self.ask(wish, json.dumps(content).encode())
        return status, json.loads(body or b"{}").get("error", "")

    def drop(self, text, name="a.csv"):
        """Drop a file; gives what the page shows when it is read."""
        body = text if isinstance(text, bytes) else text.encode()
        status, _, answer = self.ask(f"data?name={quote(name)}", body)
        assert status == 200, answer
        return self.wait(lambda parts: not parts["busy"])

    def wait(self, wanted, patience=60):
        """Give all parts of the page as soon as they are as wanted."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            parts = json.loads(self.ask("changes?after=0")[2])["parts"]
            if wanted(parts):
                return parts
            time.sleep(0.05)
        raise AssertionError(parts)


class Page(Asked):
    """A page that is served in a process of its own, as a shell would start it."""

    def __init__(self, *words, folder=None, program=("-m", "dynsr")):
        environment = {**os.environ, "TMPDIR": str(folder)} if folder else None
        self.process = subprocess.Popen(
            [sys.executable, *program, "app", "--no-browser", "--json", "-j", "1", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        lines = itertools.takewhile(lambda line: line != "}\n", self.process.stdout)
        super().__init__(json.loads("".join(lines) + "}")["address"])

    def end(self, number=None):
        """End it by its own Quit, or by a signal; gives the exit code and what it said.

        The signal 0 waits for the end that something else has caused.
        """
        if self.process.poll() is None:
            if number is None:
                self.post("quit")
            else:
                self.process.send_signal(number)
        _, said = self.process.communicate(timeout=180)
        return self.process.returncode, said


class PageHere(Asked):
    """A page that is served in a thread of this process, so that what it runs is measured."""

    def __init__(self, **settings):
        from dynsr.app import serve

        said = queue.Queue()
        settings |= {"jobs": 1, "browse": False, "say": said.put}
        self.thread = threading.Thread(target=serve, kwargs=settings)
        self.thread.start()
        super().__init__(said.get(timeout=30))

    def end(self):
        """End it by its own Quit."""
        self.post("quit")
        self.thread.join(30)
        assert not self.thread.is_alive()
