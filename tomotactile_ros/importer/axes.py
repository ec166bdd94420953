"""Which number of an array is the reading of which electrode, in which row of which frame.

An array is N frames x L rows x E electrodes in some order of these three, which is told from its
shape and from where the grounded electrodes' own readings lie: missing, or the lowest of their rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from tomotactile_ros.support.errors import InputError

USUAL = "NLE"  # frames x rows x electrodes, from the slowest index to the fastest
_AXES = {"N": "frames", "L": "rows", "E": "electrodes"}
_BETTER = 0.2  # of the rows: so much better another order of axes must fit than a more usual one


@dataclass(frozen=True, eq=False)
class Arranged:
    """voltages (N, L, E), the order of the axes that they had, others that fit as well, but for
    rows and electrodes exchanged, and a line about all this where there is one."""

    voltages: np.ndarray
    axes: str = USUAL
    others: tuple[str, ...] = ()
    told: str = ""


def exchange(axes: str) -> str:
    """The order with rows and electrodes exchanged."""
    return axes.translate(str.maketrans("LE", "EL"))


def named(axes: str) -> str:
    """`NLE` in words."""
    return " x ".join(_AXES[letter] for letter in axes)


def arrange(
    values: np.ndarray, grounded: np.ndarray, electrodes: int, axes: str | None = None
) -> Arranged:
    """Frames from an array of any shape.

    Parameters
    ----------
    grounded : (L,) electrode of each row; electrodes : E
    axes : `N`, `L` and `E` in the order of the indices, slowest first; None: guessed
    """
    if axes is not None and sorted(axes) != sorted(USUAL):
        raise InputError(
            f"axes: {axes!r} is not N (frames), L (rows) and E (electrodes) in some order"
        )
    rows = len(grounded)
    if values.size % (rows * electrodes):
        raise InputError(_wrong_size(values, rows, electrodes))
    sizes = {"N": values.size // (rows * electrodes), "L": rows, "E": electrodes}
    orders = ["".join(each) for each in permutations(USUAL)] if axes is None else [axes]
    found: dict[str, np.ndarray] = {}
    for order in orders:
        wanted = tuple(sizes[letter] for letter in order)
        if _agree(values.shape, wanted):
            turned = values.reshape(wanted).transpose([order.index(letter) for letter in USUAL])
            if not any(np.array_equal(turned, each, equal_nan=True) for each in found.values()):
                found[order] = turned
    if not found:
        shape = " x ".join(map(str, values.shape))
        raise InputError(
            f"axes: {shape} numbers are not {named(axes or USUAL)} of {rows} rows and {electrodes} electrodes"
            + ("" if axes else ", in no order of these")
        )
    scores = {order: _own_lowest(each, grounded) for order, each in found.items()}
    best = next(iter(found))
    for order, score in scores.items():
        if score > scores[best] + _BETTER:
            best = order
    others = [
        order
        for order in found
        if order not in (best, exchange(best)) and scores[order] >= scores[best] - _BETTER
    ]
    return Arranged(found[best], best, tuple(others))


def _agree(given: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether each index of one shape is whole indices of the other, as far as both go."""
    ends, inner = np.cumprod(given), set(np.cumprod(wanted).tolist())
    return set(ends.tolist()) <= inner | {1}


def _own_lowest(voltages: np.ndarray, grounded: np.ndarray) -> float:
    """Share of the rows in which the grounded electrode's reading is missing, or the lowest."""
    count = np.isfinite(voltages).sum(axis=0)
    means = np.where(count, np.nansum(voltages, axis=0) / np.maximum(count, 1), np.nan)
    own = means[np.arange(len(grounded)), grounded]
    lowest = np.where(np.isnan(means), np.inf, means).min(axis=1)
    return float((np.isnan(own) | (own <= lowest)).mean())


def grounded_where_missing(lines: np.ndarray) -> np.ndarray | None:
    """(R,) the one electrode whose reading is missing in each line (R, E), None where that is not
    one; electrodes without any reading are not counted."""
    missing = np.isnan(lines)
    missing[:, missing.all(axis=0)] = False
    if not (missing.sum(axis=1) == 1).all():
        return None
    return missing.argmax(axis=1)


def rows_of_a_frame(grounded: np.ndarray) -> np.ndarray:
    """(L,) what (R,) grounded electrodes of one row after another repeat; InputError where they do not."""
    again = np.flatnonzero(grounded == grounded[0])
    length = int(again[1]) if len(again) > 1 else len(grounded)
    order = grounded[:length]
    other = np.flatnonzero(grounded != np.resize(order, len(grounded)))
    if len(other):
        row = int(other[0])
        raise InputError(
            f"grounded: row {row + 1} of the readings has electrode {grounded[row]} where {order[row % length]} is due "
            f"(the first {length} rows are a frame): are rows left out?"
        )
    if left := len(grounded) % length:
        raise InputError(
            f"grounded: the last frame has {left} of {length} rows: leave these out, or add the missing ones"
        )
    return order


def _wrong_size(values: np.ndarray, rows: int, electrodes: int) -> str:
    shape = " x ".join(map(str, values.shape))
    text = (
        f"{shape} numbers are no whole frames of {rows} rows x {electrodes} electrodes ({rows * electrodes} "
        "numbers each)"
    )
    if values.size % (rows * (electrodes - 1)) == 0:
        return (
            f"{text}, but of {rows} x {electrodes - 1}, without the grounded electrode: in which order are the "
            "others, --order pyeit or --order eidors?"
        )
    if values.size < rows * electrodes:
        return (
            f"{values.size} numbers are too few: a frame of this layout is {rows} lines, one for each grounded "
            f"electrode, of {electrodes} readings; are fewer electrodes grounded (--grounded)?"
        )
    if values.shape[-1] == electrodes:
        left = values.size // electrodes % rows
        return f"{text}: {left} rows are left over; are fewer electrodes grounded (--grounded)?"
    return f"{text}: is it the right layout, and are there other columns?"
