"""An object in a process of its own, for what would take the interpreter from everything else here.

One thread of Python computes at a time. The process ends as soon as the pipe to it does: with whoever
started it, however that ends. Its modules are the same as here, whatever the working directory.
"""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
from dataclasses import is_dataclass
from importlib import import_module
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

_PATIENCE = 1.0  # s to end by itself
_PROGRAM = (
    "import sys; sys.path[:] = {path!r}; "
    "from tomotactile_ros.support.beside import serve; serve({pipe}, {module!r}, {name!r}, {nice})"
)


class Process:
    """One object of a class, made and asked through a pipe, by one thread at a time.

    A process that has ended is a ConnectionError of who asks it.

    Parameters
    ----------
    made : class of the object, with everything that it takes and answers to be pickled; where another is made of
        other words, its `stop` ends the one before
    nice : added to the niceness; ended : what the ConnectionError says
    """

    def __init__(self, made: type, nice: int = 0, ended: str = "the process has ended"):
        self._words = {"module": made.__module__, "name": made.__name__, "nice": nice}
        self._ended = ended
        self._process: subprocess.Popen | None = None
        self._pipe: Connection | None = None
        self._prepares = False  # the object is being made

    @property
    def pid(self) -> int | None:
        """Number of the process, if there is one."""
        return self._process.pid if self._process is not None and self.runs else None

    @property
    def runs(self) -> bool:
        """Whether there is one, and it has not ended."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start it."""
        self._pipe, other = Pipe()
        program = _PROGRAM.format(path=sys.path, pipe=other.fileno(), **self._words)
        self._process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.DEVNULL,
            pass_fds=(other.fileno(),),
            start_new_session=True,  # a Ctrl-C on the terminal is for whoever started it
        )
        other.close()
        self._prepares = False

    def make(self, *words) -> None:
        """Have the object made of `words`, and do not wait for it."""
        self._send("", *words)
        self._prepares = True

    def ready(self) -> bool:
        """Whether the object has been made; raises what its class did."""
        if self._prepares:
            if self._pipe is not None and not self._pipe.poll():
                return False
            self._prepares = False
            self._answer()
        return True

    def ask(self, what: str, *words) -> Any:
        """What the method `what` of the object returns or raises, once it has been made."""
        if self._prepares:
            self._prepares = False
            self._answer()
        self._send(what, *words)
        return self._answer()

    def stop(self) -> None:
        """End it."""
        process, pipe = self._process, self._pipe
        self._process = self._pipe = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _send(self, *words) -> None:
        if self._pipe is None:
            raise ConnectionError(self._ended)
        try:
            self._pipe.send_bytes(_packed(words))
        except OSError as error:
            raise ConnectionError(self._ended) from error

    def _answer(self) -> Any:
        if self._pipe is None:
            raise ConnectionError(self._ended)
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise ConnectionError(self._ended) from error
        if isinstance(answer, Exception):
            raise answer
        return answer


class _Pickler(pickle.Pickler):
    """Takes all attributes of an object at once: another thread may add to them what is worked out once."""

    def reducer_override(self, given: Any) -> Any:
        """What an object is made of again; NotImplemented: as always."""
        if not is_dataclass(given) or isinstance(given, type):
            return NotImplemented
        parts = given.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
        if isinstance(parts, str):  # the name of something that is there
            return NotImplemented
        return tuple(dict(each) if isinstance(each, dict) else each for each in parts)


def _packed(words: tuple) -> bytes:
    into = io.BytesIO()
    _Pickler(into, pickle.HIGHEST_PROTOCOL).dump(words)
    return into.getvalue()


def serve(pipe: int, module: str, name: str, nice: int) -> None:
    """Answer what is asked through the file descriptor `pipe` until that ends."""
    os.nice(nice)
    connection: Connection = Connection(pipe)
    make, made = getattr(import_module(module), name), None
    while True:
        try:
            what, *words = connection.recv()
        except (EOFError, OSError):
            return
        answer: Any = None
        try:
            if what:
                answer = getattr(made, what)(*words)
            else:
                if made is not None:
                    made.stop()
                made = make(*words)
        except Exception as error:  # noqa: BLE001 - whoever asked is told
            answer = error
        try:
            connection.send(answer)
        except OSError:
            return
