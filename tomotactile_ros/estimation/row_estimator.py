"""Rows in, contacts out, one estimate a row: the follower between frames, the estimator once a
frame.

Nothing about a scan needs to be complete or in order: rows are followed as they come, and whenever
as many have come as there are electrodes, they are a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.estimation.estimator import (
    FORCE_FLOOR,
    PLACE_FLOOR,
    Contact,
    Estimator,
    State,
)
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.frames_in_rows import corrected
from tomotactile_ros.estimation.row_model import Known
from tomotactile_ros.estimation.row_state import STATE, STRENGTH, RowState
from tomotactile_ros.estimation.search import CLOSE
from tomotactile_ros.estimation.solver import SIMILAR
from tomotactile_ros.estimation.touch import PARAMETERS, Touches, patches_for


@dataclass
class RowsState:
    """All that lasts from row to row of one sensor.

    rows : of the follower, None before the first row; frames : of the estimator
    read, grounded, times : rows since the last frame; used : electrodes in use
    confirmed : s, time of the last frame that was valid
    means : {number of a contact: where its mean D was taken, m and ln m, and `Touches`}
    """

    rows: RowState | None = None
    frames: State = field(default_factory=State)
    read: list = field(default_factory=list)
    grounded: list = field(default_factory=list)
    times: list = field(default_factory=list)
    used: tuple[int, ...] = ()
    drive: float = 0.0
    confirmed: float = -np.inf
    means: dict = field(default_factory=dict)
    left_out: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Followed:
    """What is known after a row: contacts, strongest first, each with its number and the time since
    it began, s."""

    contacts: list[tuple[int, float, Contact]]
    state: str = "valid"
    reason: str = ""


class RowEstimator:
    """Contacts from rows of one layout.

    Parameters
    ----------
    estimator : of whole frames
    frames : whether whole frames are estimated, too; without, there are no wide contacts
    """

    def __init__(self, estimator: Estimator, frames: bool = True):
        self.estimator, self._frames = estimator, frames
        self._followers: dict[tuple[int, ...], Follower] = {}

    def estimate(
        self, voltages, grounded: int, drive_voltage: float, time: float, state: RowsState
    ) -> Followed:
        """Contacts at the time of a row, s, with its readings `voltages` (E,), V, NaN: not read."""
        voltages = np.array(voltages, float)
        voltages[grounded] = np.nan
        if state.rows is None or drive_voltage != state.drive:
            self._begin(state, drive_voltage)
        follower = self._follower(state.used, drive_voltage)
        operator = follower.operator
        at = int(operator.position[grounded])
        valid = np.isfinite(voltages)[operator.used]
        if at >= 0 and valid.any():
            readings = voltages[operator.used] / drive_voltage
            follower.follow(state.rows, readings, valid, at, time)
        state.read.append(voltages)
        state.grounded.append(grounded)
        state.times.append(time)
        if len(state.read) >= self.estimator.layout.electrodes:
            if self._frames:
                self._frame(state)
            state.read, state.grounded, state.times = [], [], []
        return self._report(state)

    def _begin(self, state: RowsState, drive_voltage: float) -> None:
        excluded = self.estimator.excluded
        electrodes = range(self.estimator.layout.electrodes)
        used = tuple(e for e in electrodes if e not in excluded and e not in state.left_out)
        _, prior = self.estimator.sensor_of(used, drive_voltage)
        variance = (self.estimator.noise / drive_voltage) ** 2
        last = state.rows.last if state.rows is not None else 0
        state.used, state.drive = used, drive_voltage
        state.rows = self._follower(used, drive_voltage).begin(Known.before(prior, variance))
        state.rows.last = last

    def _follower(self, used, drive_voltage) -> Follower:
        if used not in self._followers:
            operator, prior = self.estimator.sensor_of(used, drive_voltage)
            self._followers = {used: Follower(operator, self.estimator.radius, prior.spread)}
        return self._followers[used]

    def _frame(self, state: RowsState) -> None:
        """A complete frame corrects what rows have told."""
        period = (state.times[-1] - state.times[0]) / max(len(state.times) - 1, 1)
        estimate = self.estimator.estimate(
            np.array(state.read),
            np.array(state.grounded),
            state.drive,
            state.frames,
            max(period, 0.0),
        )
        left_out = {e: why for e, why in estimate.left_out.items() if why != "excluded"}
        fit = state.frames.fit
        if set(left_out) != set(state.left_out):  # other electrodes: what rows told was of others
            state.left_out = left_out
            self._begin(state, state.drive)
            state.rows.time = state.times[-1]
        if estimate.state != "valid" or fit is None or not _same(fit, state.used):
            return
        follower = self._follower(state.used, state.drive)
        corrected(follower, state.rows, fit, estimate, state.times[0])
        state.confirmed = state.times[-1]

    def _report(self, state: RowsState) -> Followed:
        rows = state.rows
        if rows.unexplained:
            return Followed([], "withheld", "no contacts explain the last row")
        if self._frames and self._may_be_one(state):
            reason = "a wide contact or several near each other have begun: the next frame tells"
            return Followed([], "withheld", reason)
        found = [(number, rows.time - begun, contact) for number, begun, contact in rows.wide]
        belief, contacts = rows.belief, rows.belief.contacts()
        state.means = {n: each for n, each in state.means.items() if n in belief.numbers}
        for i, number in enumerate(belief.numbers):
            own = slice(STATE * i, STATE * (i + 1))
            mean, covariance = belief.mean[own], belief.covariance[own, own]
            touches = self._touches(state, number, contacts[i])
            reported = self._contact(touches, contacts[i], belief.sizes[i, 1], mean, covariance)
            found.append((number, rows.time - belief.begun[i], reported))
        return Followed(sorted(found, key=lambda each: -each[2].force))

    def _may_be_one(self, state: RowsState) -> bool:
        """Whether a contact that no frame has confirmed yet is near another one."""
        belief = state.rows.belief
        if belief.count < 2:
            return False
        places = belief.contacts()[:, :2]
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        near = apart < CLOSE * self._follower(state.used, state.drive).operator.pitch
        np.fill_diagonal(near, False)
        return bool(near[np.array(belief.begun) > state.confirmed].any())

    def _touches(self, state: RowsState, number: int, contact: np.ndarray) -> Touches:
        """The contact (4,) x, y, ln c, ln a on the sheet, taken anew only where it has moved."""
        follower = self._follower(state.used, state.drive)
        pitch = follower.operator.pitch
        here = contact[[0, 1, 3]] / [pitch, pitch, 10.0]
        kept = state.means.get(number)
        if kept is None or np.abs(kept[0] - here).max() > SIMILAR:
            full = np.zeros((1, PARAMETERS))
            full[0, :4] = contact
            across = (patches_for(float(np.exp(contact[3])), pitch),)
            sheet = state.rows.model.known.sheet
            kept = here, Touches(follower.operator, full, across, sheet)
            state.means[number] = kept
        return kept[1]

    def _contact(self, touches: Touches, contact, size_variance, mean, covariance) -> Contact:
        touches.contacts[0, 2] = contact[2]
        g, by_strength, by_mean = touches.conductance(0)
        operator, law = touches.operator, self.estimator.law
        area = np.pi * float(np.exp(2 * contact[3])) * float(touches.covered[0])
        g = g * float(touches.covered[0])
        pressure = float(law.pressure(g / area))
        force, m = pressure * area, law.exponent
        by_size = 2 * (1 - 1 / m) - by_mean * operator.resistance / (2 * np.pi) / m
        relative = (
            by_strength**2 * covariance[STRENGTH, STRENGTH] / m**2 + by_size**2 * size_variance
        )
        place = covariance[:2, :2] + np.eye(2) * (PLACE_FLOOR * operator.pitch) ** 2
        certainty = 1 / max(float(covariance[STRENGTH, STRENGTH]), 1e-12)
        radius = float(np.sqrt(area / np.pi))
        return Contact(
            float(mean[0]),
            float(mean[1]),
            force,
            pressure,
            area,
            radius,
            g,
            tuple(float(each) for each in place.ravel()),
            force * min(float(np.sqrt(relative + FORCE_FLOOR**2)), 10.0),
            radius * float(np.sqrt(size_variance)),
            float(1 - np.exp(-certainty / 2)),
            (float(mean[2]), float(mean[3])),
        )


def _same(fit, used) -> bool:
    return tuple(int(each) for each in fit.operator.used) == tuple(used)
