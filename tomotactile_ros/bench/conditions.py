"""Which electrodes to ground where a scan has no time for all of them."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layout import Layout


def spread_conditions(layout: Layout, count: int | None) -> np.ndarray:
    """(L,) electrodes as far from each other as they get: each the farthest from all before it.

    `count` None, or more than there are: all electrodes in turn.
    """
    positions = layout.positions
    if count is None or count >= len(positions):
        return np.arange(len(positions))
    centre = positions.mean(axis=0)
    chosen = [int(np.argmax(np.linalg.norm(positions - centre, axis=1)))]
    nearest = np.linalg.norm(positions - positions[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return np.sort(chosen)
