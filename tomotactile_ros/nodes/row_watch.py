"""Watches the rows that come in: how many, how late, and how many never came."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from tomotactile_ros.devices.health import Recent, Trouble, late_of
from tomotactile_ros.nodes.diagnostics import percentiles

_RESTART = 2**16  # frames: a number farther away is that of another start
_SOME = 0.01  # of the rows
LATE = 0.02  # s from a row to the contacts that hold for it
_WINDOW = 10  # s


class RowWatch:
    """Counts rows and times their way, by the time `now`, s.

    Rows are numbered by their frame alone: how many one has is learned from whole frames
    (`frame_has`), and what is missing is counted when the next one begins.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.rows = self.lost = self.skipped = 0
        self._length = self._count = 0
        self._begun = self._now()
        self._sequence: int | None = None
        self._whole = False  # whether the frame was seen from its beginning
        self._recent = Recent(_WINDOW, now)
        # of messages: when, s, how late, s of work for each row
        self._messages: deque[tuple[float, float, float]] = deque(maxlen=1000)

    def frame_has(self, rows: int) -> None:
        """Note how many rows a whole frame has."""
        self._length = rows

    def skip(self, sequence: int, rows: int) -> None:
        """Note rows that were left out as others waited behind them."""
        self.skipped += rows
        self._recent.add(skipped=rows)
        self._count_up(sequence, rows)

    def followed(self, sequence: int, rows: int, latency: float, duration: float) -> None:
        """Note rows that were followed: s from the last of them until now, s of work for them."""
        self.rows += rows
        self._recent.add(followed=rows, late=rows if latency > LATE else 0)
        self._messages.append((self._now(), latency, duration / rows))
        self._count_up(sequence, rows)

    def troubles(self, publishers: int = 1, max_age: float = 0.0) -> list[Trouble]:
        """What is wrong with the rows of the last 10 s, which so many publish.

        Contacts of rows beyond `max_age`, s, are not valid; 0 for those of any age.
        """
        recent, found = self._recent.sums(), []
        rows = recent["followed"] + recent["lost"] + recent["skipped"]
        if publishers > 1:
            text = f"{publishers} publishers of rows: those of several sensors are mixed"
            found.append(Trouble("rows publishers", True, text))
        if 0 < max_age and (old := self._older_than(max_age)) > _SOME:
            text = f"{100 * old:.0f} % of the rows are older than max_age, {max_age:g} s"
            found.append(Trouble("rows old", old > 0.5, text))
        for name, text in (
            ("lost", "never arrived"),
            ("skipped", "were skipped: the processor is too slow for all of them"),
            ("late", f"were evaluated later than {1e3 * LATE:g} ms after they were taken"),
        ):
            if recent[name] > _SOME * rows:
                share = 100 * recent[name] / rows
                found.append(Trouble(f"rows {name}", False, f"{share:.0f} % of the rows {text}"))
        return found

    def late(self) -> str:
        """How many rows of the last 10 s were known late, left out or lost, for people."""
        recent = self._recent.sums()
        untold = recent["lost"] + recent["skipped"]
        return late_of(untold + recent["late"], untold + recent["followed"], "rows")

    def figures(self) -> dict[str, float | int]:
        """Counts so far, rows/s over the last 10 s, times over the last 1000 messages."""
        return {
            "rows_followed": self.rows,
            "rows_lost": self.lost,
            "rows_skipped": self.skipped,
            "rows_per_second": self._recent.sums()["followed"] / self._span(),
            **percentiles(self._messages, "row_latency", "row_processing"),
        }

    def _count_up(self, sequence: int, rows: int) -> None:
        if sequence != self._sequence:
            if self._sequence is None:
                self._begun = self._now()
            else:
                self._end_frame((sequence - self._sequence - 1) % 2**32)
                self._whole = True
            self._sequence, self._count = sequence, 0
        self._count += rows

    def _end_frame(self, gap: int) -> None:
        if gap >= _RESTART or not self._length:
            return
        missing = max(self._length - self._count, 0) if self._whole else 0
        lost = gap * self._length + missing
        self.lost += lost
        self._recent.add(lost=lost)

    def _older_than(self, age: float) -> float:
        """Part of the messages of the last 10 s whose rows were older than `age`, s."""
        since = self._now() - _WINDOW
        recent = [late > age for when, late, _ in list(self._messages) if when >= since]
        return sum(recent) / len(recent) if recent else 0.0

    def _span(self) -> float:
        begun = self._now() if self._sequence is None else self._begun
        return min(max(self._now() - begun, 1.0), float(_WINDOW))
