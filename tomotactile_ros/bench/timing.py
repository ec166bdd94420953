"""Times and memory.

Things to compare are measured in turn, in many short rounds, so that a machine that slows down for
a while disturbs all of them alike. They are compared by the time that the processor worked on them:
where other programs wait for it too, the clock says how many these are.
"""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from tomotactile_ros.estimation.operator import made

Call = Callable[[], Any]
_FEWEST = 2  # rounds
Times = list[np.ndarray]  # of each round (passes, n, 2), s, of n calls: by the clock, of processor


def in_turn(
    calls: dict[Any, Sequence[Call]],
    *,
    least: int = 8,
    seconds: float = 1.0,
    most: float = np.inf,
    turn: float = 0.0,
    warm: bool = True,
) -> dict[Any, Times]:
    """How long the calls of each key take; in every round each key has its turn.

    Parameters
    ----------
    least : rounds at least; then until `seconds` are over
    most : s for one key; what takes longer has `_FEWEST` rounds
    turn : s; all calls of a key are made once in its turn, and again until this is over
    warm : the first call of a key is made once more before, and does not count: it finds the caches
        full of what others left
    """
    out: dict[Any, Times] = {key: [] for key in calls}
    spent = dict.fromkeys(calls, 0.0)
    with _no_collection():
        begin, done = time.perf_counter(), 0
        while done < least or time.perf_counter() - begin < seconds:
            done += 1
            for key, each in calls.items():
                if spent[key] > most and done > _FEWEST:
                    continue
                start = time.perf_counter()
                if warm:
                    each[0]()
                out[key].append(_one_turn(each, turn))
                spent[key] += time.perf_counter() - start
    return out


def _one_turn(calls, seconds):
    end = time.perf_counter() + seconds
    passes = [[_durations(call) for call in calls]]
    while time.perf_counter() < end:
        passes.append([_durations(call) for call in calls])
    return np.array(passes)


def _durations(call):
    begin, worked = time.perf_counter(), time.thread_time()
    call()
    worked = time.thread_time() - worked
    return time.perf_counter() - begin, worked


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


def summary(times: Times) -> dict[str, float]:
    """Median, 99th percentile and interquartile range by the clock, s."""
    every = np.concatenate(times)[..., 0]
    low, median, high, p99 = np.percentile(every, [25, 50, 75, 99])
    return {"median": median, "p99": p99, "spread": high - low}


def undisturbed(times: Times) -> float:
    """s of a typical call without what else the machine does: the median over the calls of their
    shortest processor times."""
    return float(np.median(np.min(np.concatenate(times)[..., 1], axis=0)))


def ratio(numerator: Times, denominator: Times) -> float:
    """Of undisturbed times that were measured in turn."""
    return undisturbed(numerator) / undisturbed(denominator)


def afresh(make: Call) -> Any:
    """What `make` returns without operators that were made before."""
    made.cache_clear()
    return make()


def timed(make: Call) -> tuple[Any, float]:
    """What `make` returns, and the seconds of processor time that it took."""
    start = time.thread_time()
    found = make()
    return found, time.thread_time() - start


def memory(make: Call) -> tuple[Any, int]:
    """What `make` returns, and the bytes that it holds.

    What numpy and Python allocate counts, what libraries allocate for themselves does not.
    """
    gc.collect()
    tracemalloc.start()
    try:
        found = afresh(make)
        gc.collect()
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return found, held
