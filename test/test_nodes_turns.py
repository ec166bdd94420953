"""Threads that compute in turn, and do not wait for ever for one that takes long."""

import sys
import threading

import pytest

from tomotactile_ros.nodes.turns import FairLock, Turns

LONG = 60.0  # s


@pytest.fixture
def eager():
    """Threads change as often as Python can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_only_one_computes_at_a_time(eager):
    turns, inside, seen = Turns(LONG), [], []

    def work():
        for _ in range(200):
            with turns.mine():
                inside.append(1)
                sum(range(200))
                seen.append(len(inside))
                inside.pop()

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [1] * 800


def test_a_slow_one_does_not_stop_the_others():
    turns, slow_has_it, other_was_there = Turns(0.01), threading.Event(), threading.Event()
    ends = []

    def slow():
        with turns.mine():
            slow_has_it.set()
            ends.append(other_was_there.wait(LONG))

    thread = threading.Thread(target=slow)
    thread.start()
    assert slow_has_it.wait(LONG)
    with turns.mine():
        other_was_there.set()
    thread.join()
    assert ends == [True]
    with turns.mine():  # whoever had none has not given back what was another's
        assert turns._lock.locked()
    assert not turns._lock.locked()


def test_whoever_waits_for_a_lock_gets_it_before_it_is_taken_again():
    lock, order = FairLock(), []

    def wait():
        with lock:
            order.append("waited")

    with lock:
        waiting = threading.Thread(target=wait)
        waiting.start()
        while not lock._door.locked():
            pass
        assert lock.locked()
    with lock:
        order.append("again")
    waiting.join(LONG)
    assert order == ["waited", "again"]
    assert not lock.locked()
