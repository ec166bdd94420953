"""How the force of a contact varies in time: ramp, tap, sine; as in a scene file.

Each makes a `Signal` in parts of the contact's nominal force; its time begins with the contact's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tomotactile_ros.scenes.force_signal import Piece, Signal
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader, mapping_of

HOLD = Signal((Piece(math.inf, 1.0),))


@dataclass(frozen=True)
class Ramp:
    """From 0 to the force in ``rise`` s, and back to 0 in the last ``fall`` s of the contact."""

    rise: float = 0.0
    fall: float = 0.0

    def __post_init__(self):
        for key in ("rise", "fall"):
            checks.not_negative(getattr(self, key), key, "time in s")
        if not self.rise + self.fall > 0:
            raise InputError("rise: 0, and so is fall; a ramp takes some time")

    def signal(self, force: float, lasts: float) -> Signal:
        """The course of a contact of ``force`` (N) that lasts so long (s)."""
        if self.fall and math.isinf(lasts):
            raise InputError("fall: needs 'to', the time at which the contact ends")
        hold = lasts - self.rise - self.fall
        if hold < 0:
            raise InputError(
                f"rise: rise and fall take {self.rise + self.fall:g} s, the contact lasts {lasts:g} s"
            )
        pieces = [Piece(hold, 1.0)]
        if self.rise:
            pieces.insert(0, Piece(self.rise, 0.0, 1 / self.rise))
        if self.fall:
            pieces.append(Piece(self.fall, 1.0, -1 / self.fall))
        return Signal(tuple(pieces))


@dataclass(frozen=True)
class Tap:
    """A half sine up to the force and back, ``duration`` s long, again every ``period`` s.

    Its impulse is 2 / pi times force times duration. Without a period there is one tap only.
    """

    duration: float
    period: float | None = None

    def __post_init__(self):
        checks.positive(self.duration, "duration", "time in s")
        if self.period is not None:
            checks.positive(self.period, "period", "time in s")
            if self.period < self.duration:
                raise InputError(
                    f"period: {self.period:g} s is shorter than the tap ({self.duration:g} s)"
                )

    def signal(self, force: float, lasts: float) -> Signal:
        """The course of a contact of any force, however long it lasts."""
        tap = Piece(self.duration, amplitude=1.0, rate=math.pi / self.duration)
        if self.period is None:
            return Signal((tap, Piece(math.inf)))
        return Signal((tap, Piece(self.period - self.duration)), self.period)


@dataclass(frozen=True)
class Sine:
    """The force as mean, with a sine of ``amplitude`` N and ``frequency`` Hz about it."""

    amplitude: float
    frequency: float

    def __post_init__(self):
        checks.not_negative(self.amplitude, "amplitude", "force in N")
        checks.positive(self.frequency, "frequency", "number of Hz")

    def signal(self, force: float, lasts: float) -> Signal:
        """The course about a mean of ``force`` (N), however long it lasts."""
        if self.amplitude > force:
            raise InputError(
                f"amplitude: {self.amplitude:g} N is above the mean of {force:g} N, "
                "a contact does not pull"
            )
        rate = 2 * math.pi * self.frequency
        relative = self.amplitude / force if force else 0.0
        wave = Piece(1 / self.frequency, 1.0, amplitude=relative, rate=rate)
        return Signal((wave,), 1 / self.frequency)


Course = Ramp | Tap | Sine
KINDS = {"ramp": Ramp, "tap": Tap, "sine": Sine}


def read_course(reader: Reader) -> Course:
    """The course in a mapping of a scene file."""
    return reader.read(KINDS[reader.choice("kind", tuple(KINDS))], "kind")


def course_to_dict(course: Course) -> dict:
    """The course as in a scene file."""
    kind = next(name for name, made in KINDS.items() if isinstance(course, made))
    return {"kind": kind, **mapping_of(course)}
