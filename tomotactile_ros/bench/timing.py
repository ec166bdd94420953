"""Times and memory. Things to compare are measured in turn, in many short rounds, so that a machine that
slows down or is busy for a while disturbs all of them alike."""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Call = Callable[[], Any]


def in_turn(
    calls: dict[str, Call],
    *,
    block: int = 5,
    least: int = 8,
    seconds: float = 1.0,
    uncertainty: float = 0.01,
    warm: bool = True,
) -> dict[str, np.ndarray]:
    """Seconds (rounds, block) of every call, `block` in a row of each in every round.

    Parameters
    ----------
    least : rounds at least; then until every median is known to `uncertainty` of itself, relative to that
        of the first of `calls`, or until `seconds` are over
    warm : a call before each block does not count: it finds the caches full of what others left
    """
    out: dict[str, list[list[float]]] = {name: [] for name in calls}
    with _no_collection():
        begin = time.perf_counter()
        while True:
            for name, call in calls.items():
                if warm:
                    call()
                out[name].append([_seconds(call) for _ in range(block)])
            elapsed = time.perf_counter() - begin
            if len(out[name]) >= least and (elapsed >= seconds or _known(out, uncertainty)):
                return {name: np.array(times) for name, times in out.items()}


def _seconds(call):
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _known(times, uncertainty):
    first, *others = map(np.array, times.values())
    ratios = [ratio(other, first) for other in others]
    return all(_median_error(each) < uncertainty * each["median"] for each in ratios)


def _median_error(found):
    """Standard error of the median of normally distributed values with these quartiles."""
    return 0.93 * (found["high"] - found["low"]) / np.sqrt(found["rounds"])


@contextmanager
def _no_collection() -> Iterator[None]:
    """Python collects no garbage meanwhile."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def summary(times: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and interquartile range of durations, s."""
    low, median, high, p99 = np.percentile(times, [25, 50, 75, 99])
    return {"median": median, "p99": p99, "spread": high - low, "samples": times.size}


def ratio(numerator: np.ndarray, denominator: np.ndarray) -> dict[str, float]:
    """Ratio of durations (rounds, block) that were measured in turn: median and quartiles over the rounds."""
    each = np.median(numerator, axis=1) / np.median(denominator, axis=1)
    low, median, high = np.percentile(each, [25, 50, 75])
    return {"median": median, "low": low, "high": high, "rounds": len(each)}


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
