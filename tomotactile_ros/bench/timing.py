"""Times and memory: medians with their spread, many things measured in turn so that a busy machine
disturbs all of them alike."""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Call = Callable[[], Any]
_PATIENCE = 10.0  # s


def summary(seconds: Sequence[float]) -> dict[str, float]:
    """Median, 99th percentile and interquartile range of durations, s."""
    low, median, high, p99 = np.percentile(seconds, [25, 50, 75, 99])
    return {"median": median, "p99": p99, "spread": high - low, "samples": len(seconds)}


def durations(calls: Sequence[Call], least: int, seconds: float) -> list[float]:
    """Seconds that each call took; `calls` in turn, `least` times and then until `seconds` are over.

    Fewer than `least`, but a fifth of it, where calls are so slow that it would take `_PATIENCE`.
    """
    out: list[float] = []
    begin = time.perf_counter()
    while True:
        elapsed = time.perf_counter() - begin
        enough = least if elapsed < _PATIENCE else least // 5
        if len(out) >= enough and elapsed >= seconds:
            return out
        call = calls[len(out) % len(calls)]
        start = time.perf_counter()
        call()
        out.append(time.perf_counter() - start)


def in_turn(calls: dict[str, Call], rounds: int, block: int = 5) -> dict[str, list[float]]:
    """Seconds of every call, the median of `block` in a row, in `rounds` rounds of all of them.

    A first call before each block does not count: it finds the caches full of what others left.
    """
    out: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            call()
            out[name].append(float(np.median(durations([call] * block, block, 0.0))))
    return out


def ratio(numerator: Sequence[float], denominator: Sequence[float]) -> dict[str, float]:
    """Ratio of two durations measured in turn: median and quartiles over the rounds."""
    low, median, high = np.percentile(np.divide(numerator, denominator), [25, 50, 75])
    return {"median": median, "low": low, "high": high}


def timed(make: Call) -> tuple[Any, float]:
    """What `make` returns, and the seconds that it took."""
    start = time.perf_counter()
    made = make()
    return made, time.perf_counter() - start


def memory(make: Call) -> dict[str, int]:
    """Bytes that what `make` returns holds, and the most that was in use while it was made.

    What numpy and Python allocate counts, what libraries allocate for themselves does not.
    """
    gc.collect()
    tracemalloc.start()
    try:
        made = make()
        gc.collect()
        held, peak = tracemalloc.get_traced_memory()
        del made
    finally:
        tracemalloc.stop()
    return {"held": held, "peak": peak}
