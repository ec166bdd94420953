"""What all programs with a command line do alike: mistakes, help, numbers, progress of long work."""

import io
import threading

import pytest

from tomotactile_ros.cli import COMMANDS, main
from tomotactile_ros.support import checks, progress

SMALL = "--layout equal-4x4"
GRID = "layout --rows 4 --cols 4 --out x.yaml"
RING = "layout --ring 16 --circle 0.1 --out x.yaml"
SEARCH = "optimize --rows 4 --cols 4 --out x.yaml"
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
    ("layout --out x.yaml", "--rows and --cols, or --ring and --circle, are needed"),
    (f"{GRID} --rows 1", "rows: 1 is not a whole number from 2 to 256"),
    (f"{GRID} --inset 0.1", "inset: 0.1 leaves no room, it must be below 0.1"),
    (f"{GRID} --inset -1", "inset: -1.0 is negative"),
    (f"{GRID} --inset nan", "inset: nan is not a finite"),
    (f"{GRID} --size 0 1", "rectangle[0]: 0.0 is not a positive length"),
    (f"{GRID} --radius 0.04", "overlap: 66.67 mm apart, they need more than 80 mm"),
    (f"{GRID} --rows 200 --hex --radius 0.002", "overlap"),
    (f"{GRID} --radius 5", "of 5 m is wider than the sheet"),
    (f"{GRID} --radius nan", "electrodes.radius: nan is not a finite length"),
    (f"{GRID} --circle 0.1", "--circle: only a ring has one"),
    ("layout --ring 16 --out x.yaml", "--circle: is missing"),
    (f"{RING} --ring 2", "ring: 2 is not a whole number from 3"),
    (f"{RING} --circle -0.1", "circle: -0.1 is not a positive length"),
    (f"{RING} --inset 0.2", "inset: 0.2 leaves no room"),
    (f"{RING} --rows 4", "--rows: is of a grid"),
    (f"{RING} --hex", "--hex: is of a grid"),
    (f"{RING} --radius 0.05", "overlap"),
    (f"{RING} --ring x", "invalid int value: 'x'"),
    (
        "optimize --method free --out x.yaml",
        "--rows and --cols, or --layout, or --electrodes, are needed",
    ),
    (f"{SEARCH} --method free --spacing 0.2", "do not fit"),
    (f"{SEARCH} --method equalize --margin 0.01", "is for method"),
    (f"{SEARCH} --method equalize --steps -1", "steps: -1"),
    (f"{SEARCH} --method scan --frame-time 1e-4", "one row takes"),
    (
        f"{SEARCH} --method scan --keep-out 0 0 0.02",
        "--keep-out: is for method touch and method free only",
    ),
    (f"{SEARCH} --seed 3", "seed: is for method free only"),
    (f"{SEARCH} --conditions 4", "--conditions: is for method scan"),
    ("optimize --explore 9 1 --out x.yaml", "--explore: 1 is not a whole number from 4"),
    (f"optimize {SMALL} --resume --out x.yaml", "x.search is not there"),
    ("bench --parts cellar", "cellar"),
    (
        "bench --parts crowd --methods nowhere:none --out x.json",
        "'nowhere:none' is no module:function",
    ),
    ("bench --parts crowd --methods json --out x.json", "'json' is no module:function"),
    ("bench --methods json:loads", "--methods: belongs to --parts"),
    ("bench --compare x.json y.json --parts crowd", "not allowed"),
    ("bench --readme README.md --parts crowd", "not those of --parts"),
    ("paper --out /dev/null", "/dev/null"),
    ("paper --workers 0", "workers"),
    ("paper --contacts 0 --out new", "contacts"),
    ("paper --layout ring-16x --out new", "ring-16x"),
    (
        f"simulate {SMALL} --scene idle --frames 1000000000 --out x.npz",
        "1000000000 frames would take about",
    ),
    ("conform spy:///dev/null?file=/x", "none of /dev"),
    ("conform /dev/ttyS0 --address 255", "address"),
    (f"record {SMALL} --raw x.raw", "--raw: needs --port"),
    ("emulate --port usb", "tcp:HOST:PORT"),
    ("emulate --layout no-such-layout", "no-such-layout"),
    ("emulate --port pty:/no/such/folder/port", "/no/such"),
    ("emulate --speed 9", "--speed"),
]


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
