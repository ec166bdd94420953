"""Damage, from what was learned: wires and electrodes, gains that walk, tears of the sheet, wires that
are swapped.

A finding is a number of the learned state that is off by far more than its deviation and by more
than use makes of it. Resistances are compared with those of the other electrodes, gains and the
sheet with how they were when the sensor was first known (`_FIRST` touches, or its file): a sensor
that was uneven from the beginning is not damaged. It is told once it was so after `_TIMES` things
learned, and gone after as many without it. Touches are free in every fit: however hard, they are
in none of these numbers. The common factor of gains does not show in touches of unknown force. Nor
does the mean conductance of the sheet, which heat and moisture change, by itself; but resistances to
ground are known in parts of the sheet's, and all of them change by one factor then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.estimation import tears
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.state import SensorState

_FIRST = 6  # touches until what is known is what all later is compared with
_TIMES = 2  # things learned in turn that show it
_SURE = 5.0  # standard deviations
_OHM = 400.0  # more than the other electrodes: a switch has some tens to hundreds, all alike
_OHM_FLOOR = 30.0  # ohm, deviation: what the models of electrodes differ by
_GAIN = 3e-3  # relative change: resistors of 100 ppm / K make it in 30 K
_WHOLE = 0.1  # change of all resistances by one factor, logarithm
_EXPLAINED = 1.5  # chi-squared a reading of the last touches: with more, it is not channels alone
_LAST = 5  # touches
# ln conductance: deviation: what the modes of the field cannot show. There is no other limit to the
# loss at a place, which so is 10 % at the least
_SHEET_FLOOR = 0.02


@dataclass(frozen=True)
class Finding:
    """Something that is broken, or about to be.

    name : stays while it lasts; text : what and where, for people
    since : stamp of the frame that showed it first, s; sure : standard deviations, infinite of what is
        no number that is off
    """

    name: str
    text: str
    since: float
    sure: float


class Health:
    """Watches what is known about one sensor; `operator` of all its electrodes."""

    def __init__(self, operator: SheetOperator):
        self._operator = operator
        self._reference: SensorState | None = None
        self._seen: dict[str, list] = {}  # name: text, since, deviations, times, times without
        self._misfits: deque[float] = deque(maxlen=_LAST)
        self._learned: list[Finding] = []
        self._exchanged: Finding | None = None

    @property
    def findings(self) -> list[Finding]:
        """All that is broken, as far as is known."""
        return [*self._learned, *([self._exchanged] if self._exchanged else ())]

    def exchanged(
        self, pair: tuple[int, int] | None, since: float = 0.0, sure: float = 0.0
    ) -> None:
        """Touches in turn show since `since`, s, that the wires of a `pair` of electrodes are
        exchanged, by `sure` standard deviations; None: touches are explained as they are."""
        if pair is None:
            self._exchanged = None
            return
        name, before = f"swapped {pair[0]} {pair[1]}", self._exchanged
        begun = before.since if before is not None and before.name == name else since
        text = f"the wires of electrodes {pair[0]} and {pair[1]} are swapped"
        self._exchanged = Finding(name, text, begun, sure)

    def update(
        self, state: SensorState, since: float | None = None, misfits: tuple[float, ...] = ()
    ) -> None:
        """Look at what is known after one thing more was learned.

        since : when it began, s, where touches in turn showed together that something has changed
        misfits : chi-squared a reading of what was learned from
        """
        self._misfits.extend(misfits)
        if self._reference is None and state.touches >= _FIRST:
            self._reference = state
        found = {name: (text, sure) for name, text, sure in self._found(state)}
        for name, (text, sure) in found.items():
            old = self._seen.get(name)
            begun = (state.time if since is None else since) if old is None else old[1]
            times = (0 if old is None else old[3]) + (1 if since is None else _TIMES)
            self._seen[name] = [text, begun, sure, times, 0]
        for name in set(self._seen) - set(found):
            self._seen[name][4] += 1
            if self._seen[name][4] >= _TIMES or self._seen[name][3] < _TIMES:
                del self._seen[name]
        self._learned = [
            Finding(name, text, begun, sure)
            for name, (text, begun, sure, times, _) in sorted(self._seen.items())
            if times >= _TIMES
        ]

    def _found(self, state) -> Iterator[tuple[str, str, float]]:
        """Name, text and deviations of all that looks broken."""
        compared = self._reference is not None and self._reference is not state
        channels = [*self._wires(state), *(self._gains(state) if compared else ())]
        odd = bool(self._misfits) and np.median(self._misfits) > _EXPLAINED
        for number, text in enumerate(tears.lines(state.tears)):
            yield f"tear {number}" if number else "tear", text, np.inf
        torn = list(self._tear(state)) if compared and not state.tears else []
        yield from torn
        if compared:
            yield from self._whole(state)
        if odd and torn:
            return  # what channels seem to have is the tear's
        if odd and channels:
            names = ", ".join(sorted({name.split()[1] for name, _, _ in channels}, key=int))
            yield (
                "sheet",
                (
                    f"channels alone do not explain what electrodes {names} read: "
                    "the sheet is torn or loose near them"
                ),
                max(sure for _, _, sure in channels),
            )
        else:
            yield from channels

    def _wires(self, state):
        more = state["resistance"] - np.median(state["resistance"])
        sure = more / np.hypot(state.std("resistance"), _OHM_FLOOR)
        for n in np.flatnonzero((more > _OHM) & (sure > _SURE)):
            yield (
                f"wire {n}",
                (
                    f"electrode {n}: {more[n]:.0f} ohm more to ground than the others, "
                    "a bad wire or contact"
                ),
                float(sure[n]),
            )

    def _before(self, state) -> SensorState:
        """What all is compared with, as uncertain as it has become since by use alone."""
        reference = self._reference or state
        return reference.walked(state.time - reference.time)

    def _gains(self, state):
        reference = self._before(state)
        change = np.log(np.maximum(state["gain"], 1e-6) / reference["gain"])
        change -= np.median(change)  # the common factor is that of the touches' forces
        now, before = (each.std_of_differences("gain") for each in (state, reference))
        sure = np.abs(change) / np.hypot(now, before)
        for n in np.flatnonzero((np.abs(change) > _GAIN) & (sure > _SURE)):
            yield (
                f"gain {n}",
                f"electrode {n}: its gain has changed by {100 * np.expm1(change[n]):+.1f} %",
                float(sure[n]),
            )

    def _tear(self, state):
        """The place where the sheet surely conducts less than it did."""
        now, deviation = findings.field(state, self._operator)
        before, uncertain = findings.field(self._before(state), self._operator)
        loss = before - now
        sure = loss / np.sqrt(deviation**2 + uncertain**2 + _SHEET_FLOOR**2)
        worst = int(sure.argmax())
        if sure[worst] > _SURE:
            x, y = 1e3 * self._operator.field.centres[worst]
            yield (
                "tear",
                (
                    f"the sheet conducts {-100 * np.expm1(-loss[worst]):.0f} % less "
                    f"about ({x:+.0f}, {y:+.0f}) mm, a tear"
                ),
                float(sure[worst]),
            )

    def _whole(self, state):
        """One factor of all resistances, by least squares; those that it does not fit are left out."""
        before, now = self._reference["resistance"], state["resistance"]
        spread = np.sqrt(
            state.std("resistance") ** 2 + self._reference.std("resistance") ** 2 + _OHM_FLOOR**2
        )
        fits = before > spread
        if not fits.any():
            return
        fits &= np.abs(now - np.median(now[fits] / before[fits]) * before) < _SURE * spread
        weight = np.where(fits, before / spread**2, 0.0)
        ratio = (weight @ now) / max(weight @ before, 1e-300)
        if np.count_nonzero(fits) < len(fits) / 2 or ratio <= 0:
            return
        sure = np.abs(np.log(ratio)) * ratio * np.sqrt(weight @ before)
        if abs(np.log(ratio)) > _WHOLE and sure > _SURE:
            yield (
                "whole",
                (
                    f"all resistances to ground are {ratio:.2f} times what they were in parts of the "
                    f"sheet's: it resists {100 * (1 / ratio - 1):+.0f} % as a whole (dry, warm, worn), "
                    "or the switches have changed"
                ),
                float(sure),
            )
