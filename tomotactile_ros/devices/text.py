"""Frames from the lines that first prototypes print: docs/hardware.md.

Lines have neither checksum nor frame number.  So a frame is taken only where something beside the
readings says which row is which: a number or a blank in each row, or the empty lines before and
behind rows that are as many as they should be.  A line that is lost, cut or joined to the next one
costs the frames that it touches, and never shifts a row.  That the last row is what it says shows
the line behind it: the first row of the next frame, an empty line or a comment.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.devices.doubts import rows_are_mistaken

UNITS = {"text-V": 1.0, "text-mV": 1e-3}
COUNTS = {f"text-{bits}bit": bits for bits in (8, 10, 12, 14, 16)}
FORMATS = (*UNITS, *COUNTS)
LONGEST = 1 << 16  # bytes of a line
# for who asks such a device for packets
READ_AS = "'tomotactile watch --protocol text-V' (or -mV, -10bit ...) reads what it prints"

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE | re.ASCII)
_LINES = re.compile(rb"([\t -~]*\r?\n)+[\t -~]*")  # noise has other bytes, too
_NUMBERED = re.compile(r"\s*(\d{1,5})\s*:", re.ASCII)
# no reading; print() of Arduino writes ovf
_BLANKS = frozenset(("", "-", "x", "na", "nan", "inf", "-inf", "ovf", "-ovf"))


def is_text(data: bytes | bytearray) -> bool:
    """Whether a device prints lines."""
    return _LINES.fullmatch(data) is not None


def volts_per_unit(text_format: str, drive_voltage: float) -> float:
    """V of a printed 1; the counts of a converter end at the drive voltage."""
    if text_format in UNITS:
        return UNITS[text_format]
    return drive_voltage / 2 ** COUNTS[text_format]


def counts_of(text_format: str) -> int:
    """How many values its readings have, which are whole numbers below; 0: they are no counts."""
    return 2 ** COUNTS[text_format] if text_format in COUNTS else 0


@dataclass(frozen=True, eq=False)
class TextRow:
    """A line that is a row: readings (E,), which electrode it says that it grounds, and its form."""

    readings: np.ndarray
    grounded: int | None
    # whether it begins with its number; how many fields it has; which of them is none: "first", "last", "" or both
    form: tuple[bool, int, str]
    arrival: float


@dataclass(frozen=True, eq=False)
class TextFrame:
    """Rows that are a frame: readings (L, E) as printed, NaN at the grounded electrode, electrodes (L,),
    arrivals of the lines (s), number among whole and incomplete frames."""

    readings: np.ndarray
    grounded: np.ndarray
    arrivals: list[float]
    sequence: int


def parse_row(line: str, electrodes: int, arrival: float = 0.0, counts: int = 0) -> TextRow:
    """The row that a line is; ValueError, with what is wrong, where it is none. Readings are whole numbers
    below `counts`, 0: any."""
    label = _NUMBERED.match(line)
    rest = line[label.end() :] if label else line
    parted = re.search(r"[,;\t]", rest)
    fields = [f.strip() for f in re.split(r"[,;\t]", rest)] if parted else rest.split()
    number = int(label[1]) if label else None
    length, none = len(fields), ""
    # blank ends of a row with a colon: separators, or the own reading of electrode 0 or the last one
    blank_first, blank_last = length > 1 and not fields[0], length > 1 and not fields[-1]
    own = (number == 0 and blank_first) or (number == electrodes - 1 and blank_last)
    readings_there = length - blank_first - blank_last
    if length == electrodes + 2 and not fields[0] and not fields[-1]:
        fields, none = fields[1:-1], "both"  # a separator before and behind every reading
    elif length == electrodes + 1:
        # where both are blank, one may be the electrode's own, or the last of a line that was cut: rows beside tell
        if not fields[-1] and (fields[0] or number != electrodes - 1):  # behind
            fields.pop()
            none = "last"
        elif not fields[0]:  # before
            fields.pop(0)
            none = "first"
        elif number is None and fields[0].isdecimal():
            number = int(fields.pop(0))
            if number >= electrodes:
                raise ValueError(
                    f"has {length} fields, the layout has {electrodes} electrodes, and {number} is no row's number"
                )
    if label and (len(fields) != electrodes or readings_there + own < electrodes):
        raise ValueError(
            f"has a number and {readings_there} readings, the layout has {electrodes} electrodes"
        )
    if len(fields) != electrodes:
        raise ValueError(
            f"has {length} fields, the layout has {electrodes} electrodes: {electrodes} fields, or "
            f"{electrodes + 1} with the row's number"
        )
    if number is not None and number >= electrodes:
        raise ValueError(f"is of electrode {number}, the last one is {electrodes - 1}")
    wrong = [f for f in fields if f.lower() not in _BLANKS and not _NUMBER.fullmatch(f)]
    if wrong:
        raise ValueError(f"has {wrong[0][:20]!r} where a number should be")
    readings = np.array([np.nan if f.lower() in _BLANKS else float(f) for f in fields])
    if counts:
        good = np.isnan(readings) | ((readings == np.floor(readings)) & (np.abs(readings) < counts))
        if not good.all():
            odd = fields[int(good.argmin())][:20]
            raise ValueError(f"has {odd!r} where a whole number below {counts} should be")
    blank = np.flatnonzero(np.isnan(readings))
    grounded = int(blank[0]) if number is None and blank.size == 1 else number
    return TextRow(readings, grounded, (number is not None, length, none), arrival)


class TextFrames:
    """Finds the frames in a stream of lines.

    Parameters
    ----------
    electrodes : int
    order : sequence of int
        Electrodes that the rows of a frame ground, row after row.
    counts : int
        Readings are whole numbers below it; 0: any.

    Attributes
    ----------
    lines, lines_ignored, frames, frames_incomplete : int
        All lines, those that are neither a row nor empty or a comment, and frames.
    since : int
        Lines since the last frame.
    complaint : str
        Why the last lines are no frame.
    """

    def __init__(self, electrodes: int, order: Sequence[int], counts: int = 0) -> None:
        self.lines = self.lines_ignored = self.frames = self.frames_incomplete = self.since = 0
        self.complaint = ""
        self._electrodes, self.order, self._counts = electrodes, list(order), counts
        self.restart()

    def restart(self) -> None:
        """Forget what is under way: another line begins."""
        self._rest = b""
        self._cut = True  # the first line may have begun before
        self._rows: list[TextRow] = []
        self._begun = False  # whether something has told where the frame begins
        self._parted = False  # whether an empty line has
        self._before: int | None = None  # which electrode the row before grounds, if it says so

    def feed(self, data: bytes, arrival: float) -> list[TextFrame]:
        """Take in bytes that came at a time (s); return the frames that they complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        frames = []
        for line in lines:
            if self._cut:
                self._cut = False
                continue
            frame = self._line(line.decode("ascii", "replace").rstrip("\r "), arrival)
            self.lines += 1
            self.since += 1
            if frame is not None:
                self.frames += 1
                self.since = 0
                frames.append(frame)
        if len(self._rest) > LONGEST:
            self._rest, self._cut = b"", True
            self._garbage("has no end")
        return frames

    def _line(self, line: str, arrival: float) -> TextFrame | None:
        if not line.strip() or line.lstrip().startswith("#"):
            return self._part()
        try:
            row = parse_row(line, self._electrodes, arrival, self._counts)
        except ValueError as error:
            self._garbage(f"{line.strip()[:40]!r} {error}")
            return None
        return self._row(row)

    def _row(self, row: TextRow) -> TextFrame | None:
        told, frame = row.grounded, None
        if len(self._rows) == len(self.order):
            if self._told() and told == self.order[0]:
                frame = self._finish()
            else:
                self._lose(self._uneven() or f"more than {len(self.order)} rows are together")
        if told is not None and not (self._begun and told == self.order[len(self._rows)]):
            self._lose(self._skipped(told))
            self._begun = told == self.order[0]
        self._before = told
        if self._begun:
            self._rows.append(row)
        elif told is None and not self.complaint:
            self.complaint = "nothing tells where a frame begins: print an empty line behind it"
        return frame

    def _part(self) -> TextFrame | None:
        """An empty line or a comment: between frames, or between rows that tell what they are."""
        frame = None
        if len(self._rows) == len(self.order) and (self._parted or self._told()):
            frame = self._finish()
        elif self._told():
            return None
        elif self._rows:
            together = f"{len(self._rows)} rows are together, a frame has {len(self.order)}"
            self._lose(self._numbers_read() or together)
        self._rows, self._begun, self._parted = [], True, True
        return frame

    def _garbage(self, complaint: str) -> None:
        """A line that may have been a row, of which nobody knows which one."""
        self.lines_ignored += 1
        if not self._told():  # else the row that it was will be missing
            self._lose("")
        self.complaint, self._before = f"a line {complaint}", None

    def _skipped(self, told: int) -> str:
        """What is wrong with a row of an electrode behind the row before; "": nothing is, or nobody knows."""
        if told not in self.order:
            return f"a row is of electrode {told}, which 'scan' does not name"
        if self._before not in self.order:
            return ""
        place = self.order.index(self._before) + 1
        due, then = (self.order[(place + i) % len(self.order)] for i in range(2))
        if told == due:
            return ""
        if told == then:
            return f"the row of electrode {due} is missing"
        return f"a row of electrode {told} comes after one of electrode {self._before}, where {due} is due"

    def _uneven(self) -> str:
        """Which row has another form than most; "": none has."""
        forms = [row.form for row in self._rows]
        usual = max(forms, key=forms.count)
        odd = next((i for i, form in enumerate(forms) if form != usual), None)
        if odd is None:
            return ""
        readings = self._electrodes + forms[odd][1] - usual[1]
        if readings == self._electrodes:
            has = "its number or its separators elsewhere than the others"
        else:
            has = f"{readings} readings, the layout has {self._electrodes} electrodes"
        return f"the row of electrode {self.order[odd]} has {has}"

    def _numbers_read(self) -> str:
        """Whether numbers of rows pass as readings, as each row has one too few; "": no."""
        first = [row.readings[0] for row in self._rows]
        if len(first) < 3 or self._rows[0].form[0] or first != self.order[: len(first)]:
            return ""
        return f"rows have a number and {self._electrodes - 1} readings, the layout has {self._electrodes} electrodes"

    def _told(self) -> bool:
        """Whether there are rows, and each says which electrode it grounds."""
        return bool(self._rows) and all(row.grounded is not None for row in self._rows)

    def _lose(self, complaint: str) -> None:
        self.frames_incomplete += bool(self._rows and self.frames)
        self.complaint = complaint or self.complaint
        self._rows, self._begun, self._parted = [], False, False

    def _finish(self) -> TextFrame | None:
        """The frame of the rows, if they do not contradict each other."""
        rows, order = self._rows, np.array(self.order)
        readings = np.array([row.readings for row in rows])
        last = readings[:, -1].copy()
        readings[np.arange(len(rows)), order] = np.nan
        numbered, fields, _ = rows[0].form
        objection = self._uneven() or self._numbers_read()
        if not (objection or numbered) and fields == self._electrodes and np.isnan(last).all():
            objection = "the last field of every row is blank"
        elif not objection and rows_are_mistaken(readings, order):
            objection = "in each row another reading is blank than that of the electrode it grounds"
        if objection:
            self._lose(objection)
            return None
        self._rows, self._begun, self._parted = [], False, False
        number = self.frames + self.frames_incomplete
        return TextFrame(readings, order, [row.arrival for row in rows], number)
