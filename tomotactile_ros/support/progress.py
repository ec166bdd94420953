"""Progress of long work: a bar with the time left on a terminal, a few plain lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TextIO, TypeVar

Item = TypeVar("Item")

_WIDTH = 30  # characters of the bar
_QUIET = 2.0  # s before anything is shown
_PLAIN = 10.0  # s between two plain lines
_FIRST = 5.0  # s after which a first step that is not done is spoken of


def track(
    items: Iterable[Item], label: str, total: int | None = None, stream: TextIO | None = None
) -> Iterator[Item]:
    """Hand `items` through, with progress on `stream` (standard error) once it takes long."""
    total = len(items) if total is None else total  # type: ignore[arg-type] # or it is given
    with Progress(label, total, stream) as progress:
        for done, item in enumerate(items, 1):
            yield item
            progress.update(done)


class Progress:
    """Progress of `total` steps; a context manager that leaves its line in order."""

    def __init__(self, label: str, total: int, stream: TextIO | None = None):
        self.label, self.total = label, total
        self._stream = stream or sys.stderr
        self._bar = self._stream.isatty()
        self._start = time.monotonic()
        self._next = self._start + _QUIET
        self._shown = self._updated = False
        self._first = threading.Timer(_FIRST, self._begun)
        self._first.daemon = True

    def update(self, done: int, note: str = "") -> None:
        """`done` steps are done; `note` says how it stands."""
        self._updated = True
        self._first.cancel()
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + (0.1 if self._bar else _PLAIN)
        left = (now - self._start) / max(done, 1) * (self.total - done)
        text = f"{self.label}: {done} of {self.total}, {left:.0f} s left"
        text += f", {note}" if note else ""
        self._write(self._beside_bar(text, done) if self._bar else f"{text}\n")
        self._shown = True

    def _beside_bar(self, text, done):
        """One line of the terminal, in place of the one before."""
        columns = shutil.get_terminal_size().columns - 1
        width = max(min(_WIDTH, columns - len(text) - 3), 0)
        filled = round(width * done / max(self.total, 1))
        return f"\r\x1b[K[{'#' * filled}{'.' * (width - filled)}] {text}"[: columns + 4]

    def _begun(self):
        """Says that work has begun, where the first step takes long."""
        if not self._updated:
            text = f"{self.label}: 0 of {self.total}, the first is under way"
            self._write(self._beside_bar(text, 0) if self._bar else f"{text}\n")
            self._shown = True

    def __enter__(self):
        self._first.start()
        return self

    def __exit__(self, *error):
        self._updated = True
        self._first.cancel()
        if self._bar and self._shown:
            self._write("\r\x1b[K")

    def _write(self, text):
        with suppress(OSError):  # a terminal that has gone is no reason to lose the work
            self._stream.write(text)
            self._stream.flush()
