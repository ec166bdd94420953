"""What all programs with a command line do alike: mistakes, help, numbers, progress of long work."""

import io
import os
import threading

import pytest

from tomotactile_ros.cli import COMMANDS, main
from tomotactile_ros.support import checks, progress

SMALL = "--layout equal-4x4"
MISTAKES = [
    ("", "COMMAND"),
    ("dance", "dance"),
    ("simulat", "did you mean simulate?"),
    ("optimize --method papr", "did you mean paper?"),
    ("run --profle fast", "did you mean --profile?"),
    ("layout --out x.yaml --columns 4", "did you mean --cols?"),
    ("simulate --layout nowhere --scene default --frames 1 --out x.npz", "nowhere"),
    (f"simulate {SMALL} --scene defects --frames 1 --out x.npz", "equal-4x4"),
    (f"simulate {SMALL} --scene idle --frames 0 --out x.npz", "--frames"),
    (f"simulate {SMALL} --scene idle --frames 1 --rate 0 --out x.npz", "--rate"),
    (f"simulate {SMALL} --scene idle --frames 1 --out x.csv", "call it x.npz"),
    (f"evaluate {SMALL} --profile fast --model fem", "--model"),
    (f"optimize {SMALL} --rows 4 --method free --out x", "--rows"),
    (f"record {SMALL} --port /etc/passwd --out x.npz", "/etc/passwd is no device"),
    (f"record {SMALL} --frames 0 --out x.npz", "0 is not a whole number above 0"),
    (f"record {SMALL} --scene idle --port x --out x.npz", "not allowed with"),
    (f"record {SMALL} --out x.csv", "call it x.npz"),
    (f"watch {SMALL} --port=", "argument --port: is empty; leave it out"),
    (f"watch {SMALL} --recording nowhere.npz", "nowhere.npz: no such recording"),
    (f"tare {SMALL} --scene idle --out=", "argument --out: is empty"),
    (f"tare {SMALL} --out tare", "tare: this file is written as .npz; call it tare.npz"),
    (f"run {SMALL} --out x.txt", "x.txt: this file is written as .png"),
    ("layout --rows 3 --cols 3 --out x.json", "x.yaml"),
    (f"calibrate {SMALL} x=1 --out x.npz", "call it x.yaml"),
]


@pytest.fixture
def mistake(capsys, tmp_path, monkeypatch):
    """What a command says in its only line; it ends with 2 and has written nothing."""
    monkeypatch.chdir(tmp_path)

    def say(words):
        try:
            status = main(words.split())
        except SystemExit as end:
            status = end.code
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert status == 2 and not list(tmp_path.iterdir())
        return line

    return say


@pytest.mark.parametrize(("words", "said"), MISTAKES)
def test_a_mistake_is_one_line_and_exit_2(words, said, mistake):
    assert said in mistake(words)


@pytest.mark.parametrize("words", ["xyz", "layout --out x.yaml --margin 0.01"])
def test_what_nobody_can_have_meant_is_not_guessed(words, mistake):
    assert "did you mean" not in mistake(words)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: tomotactile {name} ")


def test_nodes_are_listed_where_they_can_be_started(monkeypatch, capsys):
    monkeypatch.setenv("TOMOTACTILE_NODES", "driver skin")
    for words in (["--help"], ["driv"]):
        with pytest.raises(SystemExit):
            main(words)
        assert "driver skin" in "".join(capsys.readouterr())


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"]])
def test_a_reader_of_the_help_may_have_had_enough(words, monkeypatch, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8") as out:
        monkeypatch.setattr("sys.stdout", out)
        with pytest.raises(SystemExit) as ended:
            main(words)
    assert ended.value.code == 141


@pytest.mark.parametrize(
    "value, said",
    [(412.3, "412"), (1e4, "10000"), (5630.0, "5630"), (2.5e-5, "0.000025"), (1e13, "1e+13")],
)
def test_numbers_are_written_as_people_do(value, said):
    assert checks.plain(value) == said
    assert checks.size(4.1e14) == "410 TB" and checks.size(1e6 - 1) == "1000 kB"


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


def test_a_first_step_that_takes_long_is_spoken_of(monkeypatch):
    monkeypatch.setattr(progress, "_FIRST", 0.01)
    stream, written = io.StringIO(), threading.Event()
    stream.flush = written.set
    with progress.Progress("search", 8, stream):
        assert written.wait(30)
    assert stream.getvalue() == "search: 0 of 8, the first is under way\n"
