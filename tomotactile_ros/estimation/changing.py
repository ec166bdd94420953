"""Frames within which something begins, ends or moves, row by row.

Such a frame shows no one state of the sheet. Who asks for frames gets the estimate of those who
follow rows (`row_estimator`), at the time of the last row. Rows go on from what the frame before
said, or, if that was one like this, from where its rows ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from tomotactile_ros.estimation.estimator import FollowedRows
from tomotactile_ros.estimation.frames_in_rows import FrameSeen, sliding
from tomotactile_ros.estimation.reported import Estimate
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.row_state import SPEED, STATE
from tomotactile_ros.estimation.settling import Settling

# of a force: deviation from which on rows are not enough: a disc of 30 mm that lands was 12 +- 25 N
# of 12 mm in place of 5 N
_UNSURE = 0.5


class Changing:
    """What rows say of frames of one sensor in which something changes.

    Parameters
    ----------
    rows : makes the estimator of rows, when it is needed first
    """

    def __init__(self, rows: Callable[[], RowEstimator]):
        self._rows = rows
        self._settling: Settling | None = None
        self.forget()

    def forget(self) -> None:
        """Nothing is known of what was there before, but for how it was read."""
        self._seen: FrameSeen | None = None
        self._state: RowsState | None = None

    def saw(self, seen: FrameSeen) -> None:
        """A frame that was of one state, and when."""
        self._seen, self._state = seen, None
        self._settling = seen.settling

    def estimate(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        begun: float,
        period: float,
        left_out: Mapping[int, str],
    ) -> FollowedRows | None:
        """Contacts at the time of the last of rows (L, E), V, the first of which is of the time
        `begun`, s; None where rows cannot tell.

        left_out : {electrode: why its channel is not used}
        """
        if not len(grounded):
            return None
        rows, state = self._rows(), self._state
        if state is None or not state.begun or begun <= state.rows.time:
            state = RowsState(waits=False, left_out=dict(left_out), settling=self._settling)
            if self._seen is not None:
                rows.go_on(state, self._seen, drive_voltage)
        misfits = []
        for i, (row, ground) in enumerate(zip(voltages, grounded)):
            rows.follow(row, int(ground), drive_voltage, begun + i * period, state)
            misfits.append(state.rows.misfit)
            if state.rows.touched_at_once:
                return None
        ended = begun + (len(grounded) - 1) * period
        followed, last = rows.report(state), state.rows
        if last is None or last.belief is None or followed.state != "valid" or last.wide:
            return None
        contacts = [contact for _, _, contact in followed.contacts]
        unsure = any(not each.force_std < _UNSURE * each.force for each in contacts)
        if unsure or state.larger:  # it may be wide, which the search tells
            return None
        self._state, belief = state, last.belief
        since = state.rows_since_change(begun, ended)
        first = 0 if since is None else len(grounded) - since
        misfit = float(np.mean(misfits[first:]))
        estimate = Estimate(contacts, contacts, "valid", "", dict(left_out), misfit, first)
        each = belief.mean[: STATE * belief.count].reshape(-1, STATE)
        lasts = (len(grounded) - 1 - first) * period
        slides = bool(sliding(belief))
        return FollowedRows(estimate, belief.contacts, each[:, SPEED], lasts, slides)
