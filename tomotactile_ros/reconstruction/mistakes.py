"""Frames that look right and are not what the layout says: transposed, or electrodes in another
order.

Reciprocity cannot tell: where f_l rho_ln is symmetric (see `admittance`), so is rho_nl / f_l. What
can are two signs. Current flows from the driving layer into the electrodes, never back; in a
transposed frame it seems to flow back from electrodes near a contact. And contacts only lower the
couplings between electrodes; where electrodes are numbered differently, distant ones seem to be
coupled. Mirrored and turned orders fit any sheet as well as the right one: only a press at a known
place tells.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.support.errors import InputError

_FRAMES = 5  # the strongest, which are looked at
_BACK, _FORTH = 0.05, 0.01  # part of the current that flows back: clearly, and as good as none
# asymmetry of a frame, in parts of the noise: channels differ, and currents tell less
_UNEVEN = 5.0
_FAR, _NEAR = 0.3, 0.12  # coupling of distant electrodes, as in `channels`: clearly, and hardly any


def refuse_mistakes(
    layout: Layout, frames: Iterable, grounded: np.ndarray, drive_voltage: float, noise: float
) -> None:
    """Raise InputError where frames (L, E), V, are probably not what the layout says.

    `noise` of a reading, V rms. Only complete frames in which something presses tell anything.
    """
    count = layout.electrodes
    if sorted(np.asarray(grounded).tolist()) != list(range(count)):
        return
    strongest = heapq.nlargest(_FRAMES, _whole(frames, grounded, count), key=np.mean)
    transfer = make_sheet(layout, "auto").transfer(layout.positions[:1], layout.radius)
    meter = AdmittanceMeter(GroundedSheet(transfer), noise)
    clear, seen = [], []
    for frame in strongest:
        measured = meter.read(frame.copy(), drive_voltage)
        if measured.couplings is not None:
            clear.append(frame)
            seen.append(measured)
    if not clear:
        return
    even = np.median([each.asymmetry for each in seen]) < _UNEVEN
    if even and np.median([_back(each) for each in seen]) > _BACK:
        turned = [meter.read(frame.T.copy(), drive_voltage) for frame in clear]
        if np.median([_back(each) for each in turned]) < _FORTH:
            raise InputError(
                "voltages: rows and columns look exchanged: row l holds what all electrodes read "
                "while electrode l is grounded; was voltages.transpose(0, 2, 1) meant?"
            )
    if np.median([meter.excess(each) for each in seen]) > _FAR:
        for name, order in _orders(layout):
            place = np.argsort(order)  # reading k is of the electrode order[k]
            if _fits(meter, [frame[np.ix_(place, place)] for frame in clear], drive_voltage):
                raise InputError(
                    f"voltages: the readings fit {layout.name} only if its electrodes are numbered "
                    f"{name}; the layout must list them in the order of the readings"
                )


def _whole(frames, grounded, count) -> Iterator[np.ndarray]:
    """(E, E) of each frame in which nothing is missing, rows in the order of electrodes."""
    order = np.argsort(grounded)
    for each in frames:
        if each.shape[-1] != count:
            return
        frame = np.asarray(each, float)[order]
        np.fill_diagonal(frame, 0.0)
        if np.isfinite(frame).all():
            yield frame


def _back(measured: Grounded) -> float:
    """Part of the current that seems to flow back into the driving layer."""
    currents = measured.currents
    return float(-currents[currents < 0].sum() / np.abs(currents).sum())


def _fits(meter: AdmittanceMeter, frames: list[np.ndarray], drive_voltage: float) -> bool:
    seen = [meter.read(frame, drive_voltage) for frame in frames]
    return bool(np.median([meter.excess(each) for each in seen]) < _NEAR)


def _orders(layout: Layout) -> Iterator[tuple[str, np.ndarray]]:
    """Usual ways to number a grid, each as (E,) numbers of the layout in this order."""
    x, y = np.round(layout.positions / (1e-3 * max(layout.outline.size))).T
    columns, rows = len(np.unique(x)), len(np.unique(y))
    if rows * columns != layout.electrodes:
        return
    by_row = np.lexsort((x, y)).reshape(rows, columns)
    by_column = by_row.T
    yield "row by row", by_row.ravel()
    yield "column by column", by_column.ravel()
    yield "row by row, to and fro", _to_and_fro(by_row)
    yield "column by column, to and fro", _to_and_fro(by_column)


def _to_and_fro(grid: np.ndarray) -> np.ndarray:
    turned = grid.copy()
    turned[1::2] = turned[1::2, ::-1]
    return turned.ravel()
