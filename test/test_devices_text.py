"""Lines of text as first prototypes print them: every form becomes the same frames, and what is lost,
cut or garbled costs frames but never makes one row another."""

import itertools
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from devices_support import opened, plugged
from hypothesis import example, given
from hypothesis import strategies as st

from tomotactile_ros import InputError
from tomotactile_ros.devices import DeviceSettings, emulator, make_device
from tomotactile_ros.devices.printer import PrintingDevice
from tomotactile_ros.devices.text import TextFrames, parse_row, volts_per_unit
from tomotactile_ros.devices.text_serial import TextSerialDevice
from tomotactile_ros.layouts.layout import equal_grid

E = 6
OWN = np.eye(E, dtype=bool)


def readings(frame: int) -> np.ndarray:
    """(E, E) counts that tell frame, row and column; the grounded electrode reads 0."""
    counts = 100 * (frame % 9 + 1) + 10 * np.arange(E)[:, None] + np.arange(E)
    return np.where(OWN, 0, counts)


FORMS = {  # what a row is of its number and its fields
    "numbered": lambda r, row: " ".join([str(r), *row]),
    "colons": lambda r, row: f"{r}: " + "\t".join(row),
    "tabs before": lambda r, row: f"{r}:" + "".join(f"\t{v}" for v in row),
    "dashes": lambda r, row: " ".join(row),
    "blanks": lambda r, row: ",".join(row),
    "comments": lambda r, row: "".join(f"{v}, " for v in row),  # a separator behind every reading
    "bars": lambda r, row: "\t" + "".join(f"{v}\t" for v in row),
    "empty lines": lambda r, row: "".join(f"{v}, " for v in row),
}
TELLING = list(FORMS)[:5]  # rows say themselves which they are


def lines(frame: int, form: str) -> list[str]:
    """The frame as a sketch prints it."""
    own = {"blanks": "", "dashes": "-"}.get(form, "0")
    rows = np.where(OWN, own, readings(frame).astype(str)).tolist()
    printed = [FORMS[form](r, row) for r, row in enumerate(rows)]
    before = ["# frame"] if form == "comments" else []
    return [*before, *printed, *([""] if form in ("bars", "empty lines") else [])]


def stream(form: str, frames: range) -> bytes:
    return "".join(f"{line}\r\n" for n in frames for line in lines(n, form)).encode()


def found(data: bytes, text: TextFrames | None = None, step: int = 7) -> list[np.ndarray]:
    """What comes of the bytes, a few at a time; the first line is lost, as always."""
    text = text or TextFrames(E, range(E))
    pieces = [data[i : i + step] for i in range(0, len(data), step)]
    return [f.readings for i, piece in enumerate(pieces) for f in text.feed(piece, float(i))]


def tells(frame: np.ndarray) -> set[int]:
    """Which frames the readings are from; fails where a row is not at its place."""
    assert np.array_equal(np.isnan(frame), OWN)
    counts = frame[~OWN].astype(int)
    assert np.array_equal(counts % 100, readings(0)[~OWN] % 100)
    return set(counts // 100)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_becomes_the_same_frames(form):
    got = found(stream(form, range(6)))
    assert len(got) >= 4  # the first is cut, the last may wait for the line behind it
    numbers = [tells(frame) for frame in got]
    assert all(len(n) == 1 for n in numbers)
    assert all(b == {max(a) + 1} for a, b in itertools.pairwise(numbers))


@pytest.mark.parametrize("form", FORMS)
# a row without its last reading, whose blanks before and behind are two fields
@example(begin=281, length=159)
@given(begin=st.integers(20, 500), length=st.integers(1, 400))
def test_bytes_that_are_lost_never_make_a_row_another(form, begin, length):
    """The number at the cut may be missing, or joined to another, as there is no checksum: one at most."""
    data = stream(form, range(9))
    for frame in found(data[:begin] + data[begin + length :]):
        assert np.isnan(frame[OWN]).all()
        places = frame % 100 == readings(0) % 100
        assert np.count_nonzero(~places & ~OWN) <= 1


@pytest.mark.parametrize("form", TELLING)
@given(lost=st.sets(st.integers(0, 9 * E - 1)))
def test_lost_lines_cost_the_frames_that_they_are_of(form, lost):
    """Nothing is lost beside: each frame comes that is whole, with the line behind it, and none but whole ones; whether
    one comes without that line depends on the next that is left."""
    printed = [line for n in range(9) for line in lines(n, form)]
    kept = ["", *(line for i, line in enumerate(printed) if i not in lost), ""]
    text = TextFrames(E, range(E))
    got = found("".join(f"{line}\n" for line in kept).encode(), text)
    own = [{n + 1} for n in range(9) if not lost & set(range(n * E, (n + 1) * E))]
    whole = [{n} for (n,) in own if n * E not in lost]
    told = [n for n in map(tells, got) if len(n) == 1]
    assert [n for n in told if n in whole] == whole
    assert [n for n in own if n in told] == told
    assert text.frames == len(got)


@pytest.mark.parametrize("wrong", ["2614.4", "1024", "-2048"])
def test_counts_are_whole_and_within_their_converter(wrong):
    parse_row("1: 0 1023 5 - nan -1", E, counts=1024)
    with pytest.raises(
        ValueError, match=f"has '{wrong}' where a whole number below 1024 should be"
    ):
        parse_row(f"1: 0 {wrong} 5 7 8 9", E, counts=1024)


@pytest.mark.parametrize(
    ("print_row", "complaint"),
    [
        (lambda r, row: " ".join(map(str, row)), "nothing tells where a frame begins"),
        (lambda r, row: " ".join(map(str, [*row, 1, 2])), "has 8 fields, the layout has 6 electrodes: 6 fields, or 7 with the row's number"),
        (lambda r, row: f"{r + 1}: " + " ".join(map(str, row)), "of electrode 6, the last one is 5"),
        (lambda r, row: " ".join(map(str, [r, *np.delete(row, r)])) + "\n" * (r == 5), "rows have a number and 5 readings"),
        (lambda r, row: "".join(f"{v}," for v in np.delete(row, r)) + "\n" * (r == 5), "of electrode 5"),
        (lambda r, row: " ".join(map(str, row)) + "\n", "1 rows are together, a frame has 6"),
        (lambda r, row: " ".join([*map(str, row[:-1]), "4OO"]), "has '4OO' where a number should"),
    ],
)  # fmt: skip
def test_what_does_not_tell_rows_safely_is_no_frame_and_says_why(print_row, complaint):
    text = TextFrames(E, range(E))
    printed = [print_row(r, row) for n in range(5) for r, row in enumerate(readings(n))]
    assert found("".join(f"{line}\n" for line in printed).encode(), text) == []
    complaints = {text.complaint}
    for line in printed:
        text.feed(f"{line}\n".encode(), 0.0)
        complaints.add(text.complaint)
    assert any(complaint in each for each in complaints), complaints


def without(row: int, reading: int):
    return lambda r, row_: np.delete(row_, reading) if r == row else row_


@pytest.mark.parametrize("label", ["{}:\t", "{}: ", "{}\t"])
@pytest.mark.parametrize(
    ("rows", "spoil", "complaint"),
    [
        (E, lambda r, row: None if r == 2 else row, "the row of electrode 2 is missing"),
        (E, lambda r, row: None if r == 0 else row, "the row of electrode 0 is missing"),
        (E, lambda r, row: None if r in (2, 3) else row, "electrode 4 comes after one of electrode 1, where 2 is due"),
        (E - 1, lambda r, row: row[: E - 1], "a number and 5 readings, the layout has 6"),
        *((E, without(r, c), f"{r}.* 5 readings, the layout has 6") for r in (0, 2, 5) for c in (0, E - 1)),
        (E, lambda r, row: row[:4] if r == 2 else row, "2.* 4 readings, .* 6|has 5 fields, .* 6 fields, or 7 with"),
        (E, lambda r, row: [] if r in (0, 5) else row, "[05].* 0 readings, .* 6|[05].* has [12] fields"),
        (E, lambda r, row: [*row, 7], "a number and 7 readings, .* 6|has 8 fields, .* 6 fields, or 7 with"),
    ],
)  # fmt: skip
def test_numbered_rows_that_are_lost_or_cut_are_named(label, rows, spoil, complaint):
    """The complaint stands, whatever the lines behind the fault are."""
    text, separator = TextFrames(E, range(E)), label[-1]
    for n in range(5):
        for r in range(rows):
            row = spoil(r, readings(n)[r])
            if row is not None:
                line = label.format(r) + separator.join(map(str, row))
                assert text.feed(f"{line}\n".encode(), 0.0) == []
            assert n < 2 or re.search(complaint, text.complaint), text.complaint
        assert text.feed(b"\n", 0.0) == []


def test_rows_ground_what_the_layout_scans():
    order = [4, 0, 2]
    text = TextFrames(E, order)
    chosen = [line for n in range(4) for line in np.array(lines(n, "colons"))[order]]
    frames = text.feed("".join(f"{line}\n" for line in ["", *chosen, ""]).encode(), 0.0)
    assert len(frames) == 4
    for frame in frames:
        assert frame.grounded.tolist() == order
        assert np.array_equal(frame.readings % 100, np.where(OWN, np.nan, readings(0) % 100)[order],
                              equal_nan=True)  # fmt: skip


def printing(rate: float = 100.0) -> PrintingDevice:
    return PrintingDevice(lambda t, n, order: 1e-3 * readings(n), np.arange(E), 1e-3, rate)


def check(frames) -> None:
    for frame in frames:
        assert len(tells(np.round(1e3 * frame.voltages.astype(float)))) == 1
        assert frame.grounded.tolist() == list(range(E)) and frame.drive_voltage == 5.0
    stamps = [frame.stamp for frame in frames]
    assert stamps == sorted(set(stamps))
    numbers = [frame.sequence for frame in frames]
    assert numbers == sorted(set(numbers))


def test_a_sensor_that_prints_is_read_loses_lines_stops_and_comes_back(tmp_path):
    """On a pseudo-terminal: lost lines, garbage, a plug that is pulled, an emulator without host."""
    count = itertools.count()

    def spoil(data: bytes) -> bytes:
        number = next(count) if data else 0
        if number % 40 == 3:
            return data.partition(b"\n")[2]  # a line is lost
        return b"\xfe\x80 rubbish\r\n" + data if number % 40 == 20 else data

    port = str(tmp_path / "port")
    device = TextSerialDevice(port, E, "text-mV", 5.0)
    watch = opened(device)
    watch.wait_for(lambda status: "does not exist" in status.message)
    for _ in range(2):
        with plugged(printing(), lambda: emulator.PtyPort(port), mangle=spoil) as plug:
            watch.wait_for_frames(60)
            device.set_streaming(False)
            watch.wait_for(lambda status: status.state == "stopped")
            device.set_streaming(True)
            watch.wait_for(lambda status: status.state == "streaming")
            watch.wait_for_frames(3)
            plug._mangle = lambda data: b""
            watch.wait_for(lambda status: status.state == "silent")
        watch.wait_for(lambda status: status.state == "disconnected")
    device.close()
    figures = device.status().counters
    assert figures["reconnects"] >= 1 and figures["frames_incomplete"] > 0
    assert figures["lines"] > 100 * E > figures["lines_ignored"] > 0
    check(watch.frames)
    assert np.median([frame.row_period for frame in watch.frames]) < 0.02


ARDUINO = """
#include <cstdio>
enum { OUTPUT = 1, A0 = 14 };
static int pins[20];
void pinMode(int, int) {}
void digitalWrite(int pin, int level) { pins[pin] = level; }
void delayMicroseconds(int) {}
int address(int first) {
  return pins[first] + 2 * pins[first + 1] + 4 * pins[first + 2] + 8 * pins[first + 3];
}
int analogRead(int) { return address(2) == address(6) ? 0 : 20 * address(6) + address(2) + 1; }
struct {
  void begin(long) {}
  void print(int value) { std::printf("%d", value); }
  void print(const char *text) { std::printf("%s", text); }
  void println() { std::printf("\\r\\n"); }
} Serial;
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_the_sketch_of_the_documentation_prints_what_is_read(tmp_path):
    """As it stands there, on a computer: multiplexers and converter are stood in for."""
    page = (Path(__file__).parents[1] / "docs/hardware.md").read_text(encoding="utf-8")
    (sketch,) = re.findall(r"```cpp\n(.*?)```", page, re.DOTALL)
    source = ARDUINO + sketch + "int main() { setup(); for (int i = 0; i < 4; i++) loop(); }"
    (tmp_path / "sketch.cpp").write_text(source)
    subprocess.run(["g++", "sketch.cpp", "-o", "sketch"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "sketch"], capture_output=True, check=True).stdout
    frames = TextFrames(16, range(16)).feed(printed, 0.0)
    expected = np.add.outer(20 * np.arange(16), np.arange(16)) + 1.0
    np.fill_diagonal(expected, np.nan)
    assert len(frames) == 3  # the first one has lost its first line
    for frame in frames:
        np.testing.assert_array_equal(frame.readings, expected)


def test_units_and_settings():
    assert volts_per_unit("text-V", 5.0) == 1.0
    assert volts_per_unit("text-mV", 5.0) == 1e-3
    assert volts_per_unit("text-10bit", 5.0) == pytest.approx(5.0 / 1024)
    layout = equal_grid(2, 3, (0.2, 0.2), 0.004, 1e4, inset=0.02)
    wanted = {"device": "serial", "port": "/dev/null", "protocol": "text-V", "order": "jumping"}
    device = make_device(DeviceSettings(layout, **wanted))
    assert isinstance(device, TextSerialDevice) and device.usual_order == ()
    for wrong in ({"capture": "x"}, {"partial_frames": True}, {"address": 3}, {"protocol": "text"}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            make_device(DeviceSettings(layout, **{**wanted, **wrong}))
