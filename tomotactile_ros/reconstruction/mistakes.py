"""Frames that look right and are not what the layout says: transposed, or electrodes in another
order.

Reciprocity cannot tell: where f_l rho_ln is symmetric (see `admittance`), so is rho_nl / f_l. What
can are two signs. Current flows from the driving layer into the electrodes, never back; in a
transposed frame it seems to flow back from electrodes near a contact. And contacts only lower the
couplings between electrodes; where electrodes are numbered differently, distant ones seem to be
coupled. An order in which none are is what was meant. Mirrored and turned orders fit any sheet as
well as the right one: only a press at a known place tells.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded
from tomotactile_ros.reconstruction.frame_checks import ordered
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.transfer import Transfer
from tomotactile_ros.support.errors import InputError

_FRAMES = 5  # the strongest, which are looked at
_FEWEST = 9  # electrodes that were read, to tell an order
_BACK, _FORTH = 0.05, 0.01  # part of the current that flows back: clearly, and as good as none
# asymmetry of a frame, in parts of the noise: channels differ, and currents tell less
_UNEVEN = 5.0
_FAR, _NEAR = 0.3, 0.12  # coupling of distant electrodes, as in `channels`: clearly, and hardly any
_MOST = 0.75  # of the electrodes, that couple with distant ones: none is where the layout has it
EXCHANGED = (
    "voltages: rows and columns look exchanged: row l holds what all electrodes read while electrode l is "
    "grounded; was voltages.transpose(0, 2, 1) meant?"
)


def refuse_mistakes(
    layout: Layout, frames: Iterable, grounded: np.ndarray, drive_voltage: float, noise: float
) -> None:
    """Raise InputError where frames (L, E), V, are probably not what the layout says.

    `noise` of a reading, V rms. Only frames in which something presses tell anything.
    """
    square = _strongest(layout, frames, grounded)
    if square and (mistake := _doubts(layout, noise).mistake(square, drive_voltage)):
        raise InputError(mistake)


def are_exchanged(
    layout: Layout, frames: Iterable, grounded: np.ndarray, drive_voltage: float, noise: float
) -> bool:
    """Whether rows and columns of frames (E, E), V, in which all electrodes are grounded in turn, are
    exchanged; arguments as of `refuse_mistakes`."""
    if not np.array_equal(grounded, np.arange(layout.electrodes)):
        return False
    square = _strongest(layout, frames, grounded)
    return bool(square) and _doubts(layout, noise).mistake(square, drive_voltage) == EXCHANGED


def _strongest(layout: Layout, frames: Iterable, grounded: np.ndarray) -> list[np.ndarray]:
    """(E, E) V, the frames in which most is read."""
    strongest = heapq.nlargest(_FRAMES, frames, key=_mean)
    if not strongest or strongest[0].shape[-1] != layout.electrodes:
        return []
    return [ordered(layout, frame, np.asarray(grounded)) for frame in strongest]


def _doubts(layout: Layout, noise: float) -> Doubts:
    transfer = make_sheet(layout, "auto").transfer(layout.positions[:1], layout.radius)
    return Doubts(layout, transfer, noise)


def _mean(frame: np.ndarray) -> float:
    valid = np.isfinite(frame)
    return float(frame[valid].mean()) if valid.any() else -np.inf


class Doubts:
    """Looks whether frames are what their layout says; `noise` of a reading, V rms, `transfer` of
    the layout's electrodes to any points."""

    def __init__(self, layout: Layout, transfer: Transfer, noise: float):
        self._layout, self._transfer, self._noise = layout, transfer, noise
        self._meters: dict[bytes, AdmittanceMeter] = {}

    def mistake(self, frames: Iterable[np.ndarray], drive_voltage: float) -> str:
        """What was probably done wrong, one line; empty where nothing shows.

        frames : (E, E) V, in the order of electrodes, NaN where there is no reading. Those that lack
            more than some electrodes as a whole, or in which nothing presses, tell nothing.
        """
        as_listed = np.arange(self._layout.electrodes)
        clear, seen = [], []
        for frame in frames:
            good = _read_electrodes(frame)
            if len(good) < _FEWEST:
                continue
            meter, measured = self._look(frame, good, as_listed, drive_voltage)
            if measured.couplings is not None:
                clear.append((frame, good))
                seen.append((meter, measured))
        if not clear:
            return ""
        even = np.median([measured.asymmetry for _, measured in seen]) < _UNEVEN
        if even and np.median([_back(measured) for _, measured in seen]) > _BACK:
            turned = [self._look(frame.T, good, as_listed, drive_voltage) for frame, good in clear]
            if np.median([_back(measured) for _, measured in turned]) < _FORTH:
                return EXCHANGED
        if _excess(seen) < _FAR:
            return ""
        return self._other_order(clear, drive_voltage) or (self._no_order(seen) if even else "")

    def _other_order(self, clear, drive_voltage: float) -> str:
        """Which usual order the readings fit, if any."""
        for name, order in _orders(self._layout):
            seen = [self._look(frame, good, order, drive_voltage) for frame, good in clear]
            if _excess(seen) < _NEAR:
                return (
                    f"voltages: the readings fit {self._layout.name} only if its electrodes are "
                    f"numbered {name}; the layout must list them in the order of the readings"
                )
        return ""

    def _no_order(self, seen) -> str:
        """Whether nearly every electrode seems to be coupled with distant ones."""
        parts = []
        for meter, measured in seen:
            coupled = meter.far_couplings(measured) > _FAR
            parts.append((coupled | coupled.T).any(axis=0).mean())
        if np.median(parts) < _MOST:
            return ""
        return (
            f"voltages: electrodes that {self._layout.name} lists far apart read like neighbours: the "
            "readings are in another order than the layout, and in none of the usual ones (press "
            "near each electrode in turn: `tomotactile watch` names the one that reads most)"
        )

    def _look(
        self, frame: np.ndarray, good: np.ndarray, order: np.ndarray, drive_voltage: float
    ) -> tuple[AdmittanceMeter, Grounded]:
        """What a frame tells if reading k is of electrode order[k], from the readings `good`."""
        numbers = order[good]
        place = np.argsort(numbers)
        used, rows = numbers[place], good[place]
        key = used.tobytes()
        if key not in self._meters:
            self._meters[key] = AdmittanceMeter(GroundedSheet(self._transfer, used), self._noise)
        meter, block = self._meters[key], frame[np.ix_(rows, rows)]
        np.fill_diagonal(block, 0.0)
        return meter, meter.read(block, drive_voltage)


def _read_electrodes(frame: np.ndarray) -> np.ndarray:
    """(n,) electrodes whose readings are complete among each other; none where that is not so
    but for some that are missing as a whole."""
    valid = np.isfinite(frame)
    np.fill_diagonal(valid, False)
    good = np.flatnonzero(valid.any(axis=0) & valid.any(axis=1))
    block = valid[np.ix_(good, good)]
    np.fill_diagonal(block, True)
    return good if block.all() else good[:0]


def _excess(seen: list[tuple[AdmittanceMeter, Grounded]]) -> float:
    return float(np.median([meter.excess(measured) for meter, measured in seen]))


def _back(measured: Grounded) -> float:
    """Part of the current that seems to flow back into the driving layer."""
    currents = measured.currents
    return float(-currents[currents < 0].sum() / np.abs(currents).sum())


def _orders(layout: Layout) -> Iterator[tuple[str, np.ndarray]]:
    """Usual ways to number electrodes, each as (E,) numbers of the layout in this order."""
    listed = np.arange(layout.electrodes)
    yield "from the second one on, its first one last", np.roll(listed, -1)
    yield "from its last one on, its first one second", np.roll(listed, 1)
    x, y = np.round(layout.positions / (1e-3 * max(layout.outline.size))).T
    columns, rows = len(np.unique(x)), len(np.unique(y))
    if rows * columns == layout.electrodes:
        by_row = np.lexsort((x, y)).reshape(rows, columns)
        by_column = by_row.T
        yield "row by row", by_row.ravel()
        yield "column by column", by_column.ravel()
        yield "row by row, to and fro", _to_and_fro(by_row)
        yield "column by column, to and fro", _to_and_fro(by_column)
    yield "backwards", listed[::-1]


def _to_and_fro(grid: np.ndarray) -> np.ndarray:
    turned = grid.copy()
    turned[1::2] = turned[1::2, ::-1]
    return turned.ravel()
