"""A strip below the slider of a recording that shows where frames are withheld, late or missing."""

from __future__ import annotations

import numpy as np

WITHHELD, LATE = "#9a9a9a", "#d03a3a"
LATE_AFTER = 1.5  # of the usual time from frame to frame: the next one is nearly due by then
_COLUMNS = 400
_LEFT, _RIGHT = "36.5%", "20.5%"  # of the page's panel, beside the track of a slider


def late_frames(stamps: np.ndarray) -> np.ndarray:
    """(N,) bool: frames that began so much later than usual after the one before that one is missing,
    or nearly."""
    steps = np.diff(np.asarray(stamps, float))
    if not steps.size:
        return np.zeros(np.size(stamps), bool)
    return np.concatenate([[False], steps > LATE_AFTER * np.median(steps)])


def strip(times: np.ndarray, end: float, withheld: np.ndarray, late: np.ndarray) -> str:
    """HTML of the strip from 0 to `end` (s): grey where a frame (N,) is withheld, red where it is late."""
    columns = np.clip((_COLUMNS * np.asarray(times) / end).astype(int), 0, _COLUMNS - 1)
    last = np.append(columns[1:], columns[-1:] + 1)  # a frame is shown until the next one
    parts = [f'<rect width="{_COLUMNS}" height="10" fill="#9a9a9a22"/>']
    for marked, colour, height in ((withheld, WITHHELD, 10), (late, LATE, 6)):
        filled = np.zeros(_COLUMNS + 2, bool)
        for k in np.flatnonzero(marked):
            filled[columns[k] + 1 : max(last[k], columns[k] + 1) + 1] = True
        edges = np.flatnonzero(np.diff(filled)).reshape(-1, 2)
        parts += [
            f'<rect x="{a}" y="{10 - height}" width="{b - a}" height="{height}" fill="{colour}"/>'
            for a, b in edges.tolist()
        ]
    picture = (
        f'<svg viewBox="0 0 {_COLUMNS} 10" preserveAspectRatio="none" width="100%" height="8">'
    )
    words = (
        f'<span style="color:{WITHHELD}">■</span> withheld <span style="color:{LATE}">■</span> late'
    )
    return f'<div style="margin:-0.4em {_RIGHT} 0 {_LEFT};font-size:0.8em">{picture}{"".join(parts)}</svg><br>{words}</div>'
