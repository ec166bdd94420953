"""What rows say that cannot be: a touch that goes and comes within milliseconds, readings beyond the
range of the converter.

A frame shows either by itself (`frame_checks.alternates`, `screening.clipped`); rows show them only
beside each other.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.estimation.screening import is_end, is_top_code

IN_TURN = (
    "rows show the sheet touched and untouched in turn: some rows are not read (a contact "
    "that is loose, the supply, the electronics)"
)
OVERDRIVEN = (
    "most readings of some of the last rows are at the end of the converter's range: what presses is a "
    "conductor or very hard, or the range is too small"
)
# rows within which no contact goes and comes again: after a return, rows are withheld for as long
# as a frame lasts, and until a frame tells
_BACK = 3
# returns: so many are no bounce of a contact: some rows are not read; frames: within which they
# are: one row in a hundred that is not read is noticed at 4 x 4 and larger
_OFTEN, _REMEMBERED = 3, 20
# of the readings of a row: with more at the end of the range, the row is not followed: at 4 x 4
# fewer readings are left than two contacts have unknowns
_MOST_CLIPPED = 0.5
# of the drive voltage: below, untouched channels may all read the same; above, it is what is true under
# a conductor, or nearly
_ENDS = 0.02, 0.98


@dataclass
class Turns:
    """Touches that ended in one row and were there again within `_BACK` rows.

    A contact that bounces may do so once or twice. After each return, rows are doubtful until a
    whole frame has come without one; where returns are frequent, until they are not.

    latest : s, time of the row of the last return
    """

    latest: float = -np.inf
    _rows: int = 0
    _ended: int | None = None
    _returns: deque = field(default_factory=lambda: deque(maxlen=_OFTEN))

    def take(self, before: bool, after: bool, untouched: bool, time: float) -> bool:
        """Take in a row at `time`, s: whether something touched before and after it, and whether it
        is that of an untouched sheet. Says whether something is back."""
        self._rows += 1
        since, back = self._ended, False
        if untouched:
            self._ended = self._rows if before else since
        elif after and not before and since is not None:
            back = self._rows - since <= _BACK
            self._ended = None
        if back:
            self.latest = time
            self._returns.append(self._rows)
        return back

    def begin(self) -> None:
        """Note that the next row does not follow the last one."""
        self._ended = None

    def doubtful(self, frame: int) -> bool:
        """Whether rows are doubtful; `frame` : rows of one."""
        if not self._returns:
            return False
        often = len(self._returns) == _OFTEN
        often = often and self._rows - self._returns[0] < _REMEMBERED * frame
        return often or self._rows - self._returns[-1] < frame


@dataclass
class RangeEnd:
    """The highest value that a converter gives, where readings show it: at once where many of a row
    have it, and after as many rows as there are electrodes where those together do.

    Rows of which most is beyond it are not followed, and what the others say rests on too little:
    rows are doubtful until a whole frame has come without one.

    value : V, infinite where it is not known; most : whether more than half of the last row is there
    """

    value: float = np.inf
    most: bool = False
    _since: int | None = None  # rows since one of which most was there
    _rows: list[np.ndarray] = field(default_factory=list)

    def take(self, row: np.ndarray, drive_voltage: float) -> np.ndarray:
        """Which readings of a row (E,), V, NaN where there is none, are at the end."""
        self._rows.append(row)
        self._look(row, drive_voltage)
        if len(self._rows) >= len(row):
            self._look(np.array(self._rows), drive_voltage)
            self._rows = []
        out = row >= self.value
        ended = np.count_nonzero(out)
        most = ended > _MOST_CLIPPED * np.count_nonzero(np.isfinite(row))
        self.most = bool(ended and most and self.value < _ENDS[1] * drive_voltage)
        if self.most:
            self._since = 0
        elif self._since is not None:
            self._since += 1
        return out

    def doubtful(self, frame: int) -> bool:
        """Whether rows are doubtful; `frame` : rows of one."""
        return self._since is not None and self._since < frame

    def _look(self, rows: np.ndarray, drive_voltage: float) -> None:
        read = rows[np.isfinite(rows)]
        highest = float(np.maximum.reduce(read)) if read.size else 0.0
        if highest > self.value:  # what was taken for the end is none
            self.value = np.inf
        below, above = (part * drive_voltage for part in _ENDS)
        if is_top_code(highest, drive_voltage) or (
            below < highest < above and is_end(read, highest)
        ):
            self.value = highest
