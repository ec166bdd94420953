"""A whole benchmark: what `tomotactile bench` measures, in which order, with progress."""

from __future__ import annotations

import resource
import time
from dataclasses import replace

import numpy as np

from tomotactile_ros.bench import growth, machine, peers, stability, trade, trials
from tomotactile_ros.progress import Progress
from tomotactile_ros.reconstruction import Pipeline

FORMAT = "tomotactile-bench/1"
QUICK_GROWTH = (4, 8, 12), (20, 40, 80)


def measure(mode: str) -> dict:
    """Everything of `quick` or `full` mode as plain data, see docs/benchmarks.md."""
    quick = mode == "quick"
    start = time.perf_counter()
    cases = trade.quick_cases() if quick else trade.full_cases()
    size = trials.QUICK if quick else trials.FULL
    sizes = QUICK_GROWTH if quick else (growth.ELECTRODES, growth.RESOLUTIONS)
    thinned = 3 if quick else 1
    total = len(cases) + 1 + stability.count(thinned) + sum(map(len, sizes))
    with Progress(f"{mode} benchmark", total) as progress:
        done = iter(range(1, total + 1))

        def tick(note=""):
            progress.update(next(done), note)

        rows, frames = _trade(cases, size, 0.2 if quick else 2.0, tick)
        compared = peers.compare(frames)
        tick()
        grown = growth.measure(*sizes, tick)
        stable = list(stability.run(thinned, tick))
    return {
        "format": FORMAT,
        "mode": mode,
        "machine": machine.describe(),
        "seconds": time.perf_counter() - start,
        "peak_memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "trade": rows,
        "auto": auto_choices(rows),
        "peers": compared,
        "growth": grown,
        "stability": stable,
    }


def _trade(cases, size, seconds, tick):
    """Rows of all cases, and the trials of the default layout."""
    rows, made, default = [], None, None
    for case in cases:
        if made is None or made.layout.name != case.layout:
            made = trials.make_trials(trade.find_layout(case.layout), size)
        if case.layout == trade.DEFAULT_LAYOUT:
            default = made
        rows.append(trade.measure(case, made, seconds))
        tick(f"{case.layout}, {case.profile}")
    return rows, default


def auto_choices(rows: list[dict]) -> list[dict]:
    """What `profile: auto` takes, and the most accurate measured profile that is in time.

    Deadlines (s) lie between the measured times of the profiles, where a busy machine does not decide.
    """
    default = {row["profile"]: row for row in rows if trade.is_default(row)}
    layout = trade.find_layout(trade.DEFAULT_LAYOUT)
    times = np.sort([row["frame"]["median"] for row in default.values()])
    out = []
    for deadline in [times[0] / 3, *np.sqrt(times[1:] * times[:-1]), 3 * times[-1]]:
        in_time = [p for p, row in default.items() if row["frame"]["median"] <= deadline]
        fastest = min(default, key=lambda p: default[p]["frame"]["median"])
        best = min(in_time, key=lambda p: default[p]["contact_error"]["mean"], default=fastest)
        settings = replace(trade.settings_of(trade.Case("", "auto", 40, None)), deadline=deadline)
        out.append(
            {
                "deadline": float(deadline),
                "auto": Pipeline(layout, settings).profile,
                "measured": best,
            }
        )
    return out
