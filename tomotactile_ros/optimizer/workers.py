"""Processes that search side by side, and stop at once without one of them being killed in its
work.

A process that is killed while it writes a result leaves half a message, for the rest of which its
reader waits for ever. So workers are not killed: a signal makes the function that a worker runs end
with an exception, as does every function after it, and the worker then ends in the ordinary way.
"""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import active_children, get_context

from tomotactile_ros.support.errors import Doubt
from tomotactile_ros.support.processes import die_with_parent

_ENVIRONMENT = {  # of processes that search
    "OMP_NUM_THREADS": "1",  # matrices are small
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(2**25),  # glibc keeps the memory of large temporaries:
    "MALLOC_TRIM_THRESHOLD_": str(2**30),  # a fifth of the time went into page faults
}
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_STOP = signal.SIGUSR1
_AGAIN = 0.5  # s after which a worker that goes on is stopped again: an exception can be swallowed


class Workers(ProcessPoolExecutor):
    """A pool of processes, which end with this process, whatever ends it.

    Used as a context, it is stopped at the end: work that has not ended is dropped. `stop` does the
    same from another thread: who waits for a result gets a `Stopped`.

    Parameters
    ----------
    count : number of processes.
    """

    def __init__(self, count: int):
        for variable, value in _ENVIRONMENT.items():
            os.environ.setdefault(variable, value)  # read by new processes when they start
        self._others = active_children()
        self._stopped = False
        super().__init__(
            count, mp_context=get_context("spawn"), initializer=_prepare, initargs=(os.getpid(),)
        )

    def submit(self, function, /, *args, **kwargs):
        """Run function(*args, **kwargs) in a worker, which may be started for it."""
        if self._stopped:
            raise Stopped
        with _interrupts_held_back():
            future = super().submit(_work, function, args, kwargs)
        if self._stopped:  # meanwhile: the worker that was being started does not know
            self.stop()
        return future

    def stop(self) -> None:
        """End what is at work."""
        self._stopped = True
        for child in active_children():
            if child not in self._others and child.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(child.pid, _STOP)

    def __exit__(self, *_):
        self.stop()
        self.shutdown(cancel_futures=True)
        return False


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Signals are held back until the end: from this process, and from those that it starts for
    good.

    An exception in the midst of starting a process would leave one that nobody knows of; a signal
    to one that is not prepared for it would kill it. Handlers run in the main thread: another one
    gets no exception from them.
    """
    came: list[int] = []
    mine = threading.current_thread() is threading.main_thread()
    handlers = {n: signal.getsignal(n) for n in _INTERRUPTS if mine}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in handlers:
        signal.signal(number, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {_STOP, signal.SIGINT})  # goes to new processes
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for late in came:
        signal.raise_signal(late)


class Stopped(Exception):
    """What a worker did is not wanted any more."""


class _State:
    """Of a worker: whether it runs what it was given, and whether it was told to stop."""

    working = False
    stopped = False


def _prepare(parent: int) -> None:
    """In a worker: end when the parent does, and not by a Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, _stop)
    signal.signal(_STOP, _stop)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {_STOP, signal.SIGINT})
    warnings.simplefilter("ignore", Doubt)  # the parent has said it
    die_with_parent(parent)


def _work(function, args, kwargs):
    _State.working = True
    try:
        if _State.stopped:
            raise Stopped
        return function(*args, **kwargs)
    finally:
        _State.working = False


def _stop(*_) -> None:
    if not _State.stopped:
        _State.stopped = True
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    if _State.working:
        raise Stopped
