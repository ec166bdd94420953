"""A whole benchmark: what `tomotactile bench` measures, in which order, with progress."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any

from tomotactile_ros.bench import deadlines, growth, machine, pace, peers, stability
from tomotactile_ros.bench.cases import (
    DEFAULT_LAYOUT,
    PROFILES,
    full_cases,
    left_out,
    quick_cases,
)
from tomotactile_ros.bench.sensor.parts import ON_DEMAND, PARTS
from tomotactile_ros.bench.sensor.run import run as run_sensor
from tomotactile_ros.bench.store import Store
from tomotactile_ros.bench.trade import FULL, QUICK, Trade
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.progress import Progress

FORMAT = "tomotactile-bench/7"
QUICK_GROWTH = (4, 8, 12), (20, 40, 80)
Tick = Callable[[float], None]
_TRADE = "trade"
SENSOR = tuple(name for name in PARTS if name not in ON_DEMAND)
# frames with contacts in each part of the sensor as it is, roughly
_SENSOR = {"time": 120, "channels": 220, "sheets": 150, "layouts": 120, "crowd": 40}


@dataclass(frozen=True)
class Part:
    """`measure` does about `work()` s of work and calls what it is given after some of it."""

    name: str
    work: Callable[[], float]
    measure: Callable[[Tick], Any]


def measure(mode: str, store: Store) -> dict:
    """Everything of `quick` or `full` mode as plain data, see docs/benchmarks.md; `store` keeps
    every part."""
    todo = parts(mode)
    left = [part for part in todo if part.name not in store.parts]
    works = [part.work() for part in left]
    with Progress(f"{mode} benchmark", max(round(sum(works)), 1)) as progress:
        before = 0.0
        for part, work in zip(left, works, strict=True):
            start = time.perf_counter()
            found = part.measure(_ticker(progress, before, work))
            before += work
            seconds = time.perf_counter() - start
            store.add(part.name, {"found": found, "seconds": seconds, "peak_memory": _peak()})
    kept = {part.name: store.parts[part.name] for part in todo}
    rows = [row for name, part in kept.items() if name.startswith(_TRADE) for row in part["found"]]
    return {
        "format": FORMAT,
        "mode": mode,
        "machine": machine.describe(),
        "seconds": {name: part["seconds"] for name, part in kept.items()},
        "peak_memory": max(part["peak_memory"] for part in kept.values()),
        "trade": rows,
        "left_out": left_out(full_cases()) if mode == "full" else [],
        "sensor": {name: kept[name]["found"] for name in SENSOR if name in kept},
        **{name: kept[name]["found"] for name in ("deadlines", "peers", "growth", "stability")},
    }


def parts(mode: str) -> list[Part]:
    """What is measured, in this order. Each part of the trade is measured in turn."""
    quick = mode == "quick"
    trade = Trade(QUICK if quick else FULL)
    cases = quick_cases() if quick else full_cases()
    sizes = QUICK_GROWTH if quick else (growth.ELECTRODES, growth.RESOLUTIONS)
    thinned = 3 if quick else 1
    groups = [cases] if quick else _groups(cases)
    return [
        *_trade_parts(trade, groups),
        *_sensor_parts(8 if quick else 1),
        Part("deadlines", deadlines.work, deadlines.measure),
        Part("peers", lambda: 15, lambda tick: peers.compare(trade.trials(DEFAULT_LAYOUT))),
        Part("growth", partial(growth.work, *sizes), partial(growth.measure, *sizes)),
        Part("stability", partial(_stability_work, thinned), partial(_stability_part, thinned)),
    ]


def _groups(cases):
    """Cases of one layout and resolution each."""
    return [list(group) for _, group in groupby(cases, lambda case: (case.layout, case.resolution))]


def _trade_parts(trade, groups):
    known = set()
    for cases in groups:
        new = {case.layout for case in cases} - known
        known |= new
        yield Part(
            f"{_TRADE} {cases[0].layout} {cases[0].resolution}²",
            partial(trade.work, cases, new),
            partial(trade.measure, cases),
        )


def _sensor_parts(step):
    """Of the sensor as it is, every `step`-th press."""
    for name in SENSOR:
        frames = _SENSOR[name] / step
        yield Part(name, partial(_frames_work, frames), partial(_sensor_part, name, step))


def _frames_work(frames):
    """s for so many frames by each profile."""
    return frames * sum(map(pace.frame_seconds, PROFILES))


def _sensor_part(name, step, tick):
    """Rows; where the presses are not at hand, the reason."""
    try:
        return run_sensor(name, step)
    except InputError as error:
        return {"skipped": str(error)}


def _stability_work(step):
    """s: simulators and pipelines take about one for each value."""
    values = stability.count(step)
    return values + _frames_work(values)


def _stability_part(step, tick):
    each = _stability_work(step) / stability.count(step)
    return list(stability.run(step, lambda: tick(each)))


def _ticker(progress, before, most):
    """Adds up work, s, but no more than `most`, to what was done `before`."""
    done = 0.0

    def tick(work):
        nonlocal done
        done = min(done + work, most)
        progress.update(round(before + done))

    return tick


def _peak():
    """Bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
