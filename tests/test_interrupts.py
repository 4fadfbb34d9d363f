"""Interrupts that arrive while a finaliser runs, where Python prints exceptions and goes on."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from dynsr.cli.group import _noted_interrupts, _orderly_end
from dynsr.jobs import TimeUp, Watch, heard_again, time_limit

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm on this system")


class Slow:
    """An object whose finaliser takes as long as it is told, and may interrupt its own process."""

    def __init__(self, seconds: float, number: int | None = None) -> None:
        """Take the seconds, and the signal that is sent at their beginning, and arrives in them."""
        self.seconds, self.number = seconds, number

    def __del__(self) -> None:
        """Take the time."""
        if self.number is not None:
            os.kill(os.getpid(), self.number)
        until = time.monotonic() + self.seconds
        while time.monotonic() < until:
            pass


def work(thing: Slow, act: Callable[[float], None] | None = None) -> None:
    """Remove the thing, then work for ten seconds, or have something else take them."""
    del thing
    if act:
        act(10)
    until = time.monotonic() + 10
    while time.monotonic() < until:
        pass


def test_a_budget_that_ends_in_a_finaliser_ends_the_work() -> None:
    """The time is over while an object is being removed; the loop behind it is ended all the same.

    A loop that runs for ten seconds more would be left with 'over' said but no TimeUp raised.
    """
    with pytest.raises(TimeUp), time_limit(time.monotonic() + 0.05):
        work(Slow(0.2))


def test_ctrl_c_in_a_finaliser_ends_the_run() -> None:
    """Ctrl-C while an object is being removed is raised when that has ended."""
    watch = Watch(None, {}, 1)
    with pytest.raises(KeyboardInterrupt), watch:
        work(Slow(0.1, signal.SIGINT))
    assert watch.messages.stopped


def test_a_command_hears_ctrl_c_once_where_it_was_lost() -> None:
    """Outside a search too it is raised when the finaliser has ended, and is no second Ctrl-C."""
    with pytest.raises(KeyboardInterrupt), _noted_interrupts() as noted:
        work(Slow(0.1, signal.SIGINT))
    assert noted == [signal.SIGINT]


def test_what_was_lost_is_heard_by_who_waits() -> None:
    """Repeated in the midst of a wait, it ends the wait too."""
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), _noted_interrupts():
        work(Slow(0.0, signal.SIGINT), time.sleep)
    assert time.monotonic() - began < 5


def test_a_command_hears_sigterm_where_it_was_lost(capfd) -> None:
    """It ends with its code, and says so once."""
    with pytest.raises(SystemExit, match="143"), _orderly_end():
        work(Slow(0.1, signal.SIGTERM))
    assert capfd.readouterr().err == "error: terminated\n"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_others_lose_is_left_to_them() -> None:
    """Another exception in a finaliser is printed as ever, and the hook before is back."""

    class Faulty:
        def __del__(self) -> None:
            raise ValueError("of a finaliser")

    again: list[int] = []
    with heard_again(KeyboardInterrupt, lambda: again.append(1)):
        Faulty()
    assert again == []


@pytest.mark.slow
def test_ctrl_c_after_the_command_ends_it_without_a_word() -> None:
    """Python waits for threads of workers when all is done; who does not wait sees no traceback."""
    code = (
        "import sys, threading, time\n"
        "from dynsr.cli import main\n"
        "sys.argv = ['dynsr', '--version']\n"
        "threading.Thread(target=time.sleep, args=(60,)).start()\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    print('waiting', flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline() != "waiting\n":
            pass
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30)[1] == ""
    assert process.returncode == 130
