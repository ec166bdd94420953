"""Child processes that never outlive their parent, and whose last words are kept."""

import ctypes
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_PATIENCE = 5.0  # s to end after each, more and more insistent, signal


class Child:
    """A program in a session of its own, so that a Ctrl-C on the terminal does not reach it.

    To be started before there are threads, which do not survive the way to a new process.

    Parameters
    ----------
    name : for people.
    command : program and arguments.
    """

    def __init__(self, name: str, command: Sequence[str]):
        self.name = name
        self._parent = os.getpid()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=self._die_with_parent,  # noqa: PLW1509 - no threads yet
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status, negative for a signal; None while it runs."""
        return self._process.poll()

    @property
    def last_words(self) -> str:
        """The last line that it wrote."""
        log = self._log.fileno()
        start = max(0, os.fstat(log).st_size - 10_000)
        lines = os.pread(log, 10_000, start).decode(errors="replace").split("\n")
        said = [line.strip() for line in lines if line.strip()]
        return said[-1] if said else "it said nothing"

    def send(self, number: int) -> None:
        """Send it a signal, if it still runs."""
        if self.status is None:
            os.killpg(self._process.pid, number)

    def wait(self, seconds: float) -> None:
        """Wait until it ends, but not longer than this."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return

    def _die_with_parent(self) -> None:
        die_with_parent(self._parent)


def die_with_parent(parent: int) -> None:
    """Ask the system for a SIGTERM when the parent process, of this id, ends."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it has ended in the meantime
        os._exit(1)


def stop_all(children: Sequence[Child]) -> None:
    """Stop children together: by the signal of a Ctrl-C, then by stronger ones."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for child in children:
            child.send(number)
        deadline = time.monotonic() + _PATIENCE
        for child in children:
            child.wait(max(0.0, deadline - time.monotonic()))
