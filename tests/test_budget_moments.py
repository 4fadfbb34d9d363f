"""Ends that come at any moment: as a block is entered, as it is left, and when nothing has one."""

import random
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

import pytest

from dynsr.jobs import TimeUp, finish_by, time_limit
from dynsr.jobs import budget as budgets

HAS_ALARM = hasattr(signal, "pthread_kill") and hasattr(signal, "SIGALRM")


@pytest.fixture
def often(monkeypatch) -> Iterator[None]:
    """Let ends come again at once, and threads take turns all the time."""
    monkeypatch.setattr(budgets, "_AGAIN", 1e-4)
    monkeypatch.setattr(budgets, "_LEAST_GRACE", 1e-4)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def regions(rounds: int, seed: int) -> tuple[int, list[BaseException]]:
    """Enter and leave tiny blocks; gives how many were cut, and what escaped."""
    moments, escaped, cut = random.Random(seed), [], 0

    def soon() -> float:
        return time.monotonic() + moments.choice([1e-5, 1e-4, 1e-3, 1e-2])

    def tiny() -> int:
        with budgets.uncut():
            pass
        return sum(range(moments.randrange(300)))

    def inner() -> bool:
        clock = time_limit(soon())
        try:
            with clock:
                tiny()
        except TimeUp:
            clock.leave()
            return True
        return clock.over

    for _ in range(rounds):
        try:
            cut += finish_by(soon(), lambda: finish_by(soon(), inner, tiny), lambda: None)[1]
            tiny()
            cut += inner()
            assert not budgets._BELL.clocks
            assert budgets._BELL.ringer is None
            assert not budgets._BELL.sheltered
        except BaseException as found:
            escaped.append(found)
    return cut, escaped


def alarmed(until: Callable[[], bool], seed: int) -> None:
    """Send alarms to the main thread at random moments."""
    moments, main = random.Random(seed), threading.main_thread().ident
    while not until():
        time.sleep(moments.random() * 2e-4)
        signal.pthread_kill(main, signal.SIGALRM)


@pytest.mark.skipif(not HAS_ALARM, reason="there are no alarms here")
@pytest.mark.parametrize("seed", range(3))
def test_an_alarm_at_any_moment_ends_its_own_block_only(often, seed):
    """Alarms, late and foreign ones too, leave no TimeUp outside and nothing in force."""
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    over = threading.Event()
    other = threading.Thread(target=alarmed, args=(over.is_set, seed))
    other.start()
    try:
        cut, escaped = regions(300, seed)
    finally:
        over.set()
        other.join()
        signal.signal(signal.SIGALRM, before)
    assert not escaped
    assert cut


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_an_exception_that_is_sent_at_any_moment_ends_its_own_block_only(often, seed):
    """In a thread nothing follows into what comes behind a block, and nothing stays in force."""
    found = []
    thread = threading.Thread(target=lambda: found.append(regions(300, seed)))
    thread.start()
    thread.join()
    [(cut, escaped)] = found
    assert not escaped
    assert cut


@pytest.mark.skipif(not HAS_ALARM, reason="there are no alarms here")
def test_an_alarm_while_a_block_is_left_waits_until_that_has_happened(monkeypatch):
    """What is around it is ended behind it, and then nothing is in force, not even an alarm."""
    before = signal.getsignal(signal.SIGALRM)
    drop = budgets._BELL.drop

    def slow(clock: budgets.Clock) -> None:
        for leave in (lambda: None, lambda: drop(clock)):
            leave()
            if budgets._BELL.clocks:
                signal.raise_signal(signal.SIGALRM)

    monkeypatch.setattr(budgets._BELL, "drop", slow)
    assert finish_by(time.monotonic() + 0.05, lambda: _outlive(0.06), lambda: 2) == (2, True)
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def _outlive(seconds: float) -> int:
    with budgets.uncut(), time_limit(time.monotonic() + 10):
        time.sleep(seconds)
    return 1


@pytest.mark.skipif(not HAS_ALARM, reason="there are no alarms here")
def test_an_end_that_could_not_be_entered_leaves_nothing_in_force(monkeypatch):
    """Whatever fails as a block is entered, the next one is entered like the first."""

    def fails(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGALRM)
    with monkeypatch.context() as broken:
        broken.setattr(budgets, "heard_again", fails)
        with pytest.raises(KeyboardInterrupt), time_limit(time.monotonic() + 10):
            pass
    assert not budgets._BELL.clocks
    assert signal.getsignal(signal.SIGALRM) is before
    assert finish_by(time.monotonic() + 10, lambda: 1, lambda: 2) == (1, False)


@pytest.mark.skipif(not HAS_ALARM, reason="there are no alarms here")
def test_an_alarm_at_the_first_moment_of_leaving_does_not_prevent_it():
    """The end has come and rings as the block is left, which happens all the same."""
    clock, before = time_limit(time.monotonic() + 10), sys.gettrace()

    def at_first(frame: FrameType, *_: object) -> None:
        if frame.f_code is budgets.Clock.__exit__.__code__:
            clock.next = 0.0
            signal.raise_signal(signal.SIGALRM)

    try:
        with clock:
            sys.settrace(at_first)
    finally:
        sys.settrace(before)
    assert not budgets._BELL.clocks
    assert budgets._BELL.ringer is None
