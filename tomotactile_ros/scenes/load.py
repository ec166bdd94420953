"""How a contact presses: its pressure or force, its profile, and its course in time."""

from __future__ import annotations

from dataclasses import dataclass, field

from tomotactile_ros.scenes.course import HOLD, Course
from tomotactile_ros.scenes.force_signal import Signal
from tomotactile_ros.scenes.profile import PEAK, PROFILES
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, complaints_at


@dataclass(frozen=True)
class Load:
    """What presses on a contact of ``area`` m² that lasts ``lasts`` s.

    Parameters
    ----------
    pressure : mean, Pa, or None.
    force : N, instead of the pressure; or None. Neither: a bare conductor.
    profile : of `tomotactile_ros.scenes.profile`.
    course : of the force in time; None: constant.
    """

    area: float
    lasts: float
    pressure: float | None = None
    force: float | None = None
    profile: str = "even"
    course: Course | None = None
    _signal: Signal = field(init=False, repr=False, default=HOLD)

    def __post_init__(self):
        if self.profile not in PROFILES:
            raise InputError(
                f"profile: {checks.show(self.profile)} is none of {', '.join(PROFILES)}"
            )
        if self.pressure is not None:
            checks.not_negative(self.pressure, "pressure", "pressure in Pa")
            if self.force is not None:
                raise InputError("force: is given, and so is pressure; one of them says it all")
        if self.force is not None:
            checks.not_negative(self.force, "force", "force in N")
        if self.profile != "even" and self.force is None:
            raise InputError(f"force: is missing, profile {self.profile} needs it")
        if self.course is not None and self.mean_pressure is None:
            raise InputError("course: needs a force or a pressure")
        if self.course is not None:
            with complaints_at("course."):
                signal = self.course.signal(self.mean_pressure * self.area, self.lasts)
            object.__setattr__(self, "_signal", signal)

    @property
    def mean_pressure(self) -> float | None:
        """Nominal mean over the contact, Pa; None for a bare conductor."""
        if self.force is not None:
            return float(self.force) / self.area
        return None if self.pressure is None else float(self.pressure)

    @property
    def peak(self) -> float:
        """Peak in parts of the mean; that of a punch, which has no finite one, counts as mean."""
        return PEAK[self.profile] or 1.0

    @property
    def signal(self) -> Signal:
        """The force in time, in parts of its nominal value."""
        return self._signal
