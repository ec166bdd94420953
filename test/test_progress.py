"""Progress of long work: what a terminal of any width and a plain stream show of it."""

import io
import threading

import pytest

from tomotactile_ros.support import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("columns", [200, 60, 20])
def test_the_bar_stays_within_one_line(monkeypatch, columns):
    monkeypatch.setattr(progress, "_QUIET", 0.0)
    monkeypatch.setenv("COLUMNS", str(columns))
    stream = Terminal()
    with progress.Progress("full benchmark", 1000, stream) as bar:
        bar.update(500, "half of it")
    shown = stream.getvalue().split("\x1b[K")[1].rstrip("\r")
    assert len(shown) < columns
    assert shown.endswith("half of it") or columns == 20
    assert "#" * 15 + "." * 15 in shown or columns < 200


def test_a_plain_stream_gets_lines(monkeypatch):
    monkeypatch.setattr(progress, "_QUIET", 0.0)
    stream = io.StringIO()
    assert list(progress.track("abc", "letters", stream=stream)) == list("abc")
    line, *_ = stream.getvalue().splitlines()
    assert line.startswith("letters: 1 of 3, ") and line.endswith(" s left")


class Told(io.StringIO):
    """A stream that says when something was written."""

    def __init__(self):
        super().__init__()
        self.written = threading.Event()

    def write(self, text):
        super().write(text)
        self.written.set()


def test_a_first_step_that_takes_long_is_spoken_of(monkeypatch):
    monkeypatch.setattr(progress, "_FIRST", 0.01)
    stream = Told()
    with progress.Progress("search", 8, stream):
        assert stream.written.wait(30)
    assert stream.getvalue() == "search: 0 of 8, the first is under way\n"
