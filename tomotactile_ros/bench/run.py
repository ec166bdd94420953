"""A whole benchmark: what `tomotactile bench` measures, in which order, with progress."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from tomotactile_ros.bench import deadlines, extremes, growth, machine, peers, trade
from tomotactile_ros.bench.cases import CASES, DEFAULT_LAYOUT
from tomotactile_ros.bench.sensor.parts import ON_DEMAND, PARTS
from tomotactile_ros.bench.sensor.parts import measure as measure_sensor
from tomotactile_ros.bench.store import Store
from tomotactile_ros.bench.trade import EFFORT
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.progress import Progress

FORMAT = "tomotactile-bench/9"
Tick = Callable[[float], None]
SENSOR = tuple(name for name in PARTS if name not in ON_DEMAND)
_EIGHTH, _THIRD = 8, 3  # of the presses of the sensor's parts, of the values of each extreme


@dataclass(frozen=True)
class Part:
    """`measure` takes about `seconds`, and calls what it is given with the fraction that is done."""

    name: str
    seconds: float
    measure: Callable[[Tick], Any]


def measure(store: Store) -> dict:
    """Everything as plain data, see docs/benchmarks.md; `store` keeps every part."""
    todo = list(parts())
    left = [part for part in todo if part.name not in store.parts]
    with Progress("benchmark", round(sum(part.seconds for part in left)) or 1) as progress:
        before = 0.0
        for part in left:

            def tick(fraction: float, before=before, part=part) -> None:
                progress.update(round(before + fraction * part.seconds), part.name)

            start = time.perf_counter()
            found = part.measure(tick)
            seconds = time.perf_counter() - start
            peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes
            store.add(part.name, {"found": found, "seconds": seconds, "peak_memory": peak})
            before += part.seconds
            tick(1.0)
    kept = {part.name: store.parts[part.name] for part in todo}
    found = {name: part["found"] for name, part in kept.items()}
    return {
        "format": FORMAT,
        "machine": machine.describe(),
        "seconds": {name: part["seconds"] for name, part in kept.items()},
        "peak_memory": max(part["peak_memory"] for part in kept.values()),
        "sensor": {name: found.pop(name) for name in SENSOR if name in found},
        **found,
    }


def parts() -> Iterator[Part]:
    """What is measured, in this order."""
    yield Part("trade", 110, partial(trade.measure, CASES, EFFORT))
    for name in SENSOR:
        yield Part(name, 8, partial(_sensor_part, name))
    yield Part("deadlines", 50, deadlines.measure)
    yield Part("peers", 15, lambda tick: peers.compare(trade.recorded(DEFAULT_LAYOUT, EFFORT.size)))
    yield Part("growth", 15, growth.measure)
    yield Part("stability", 60, lambda tick: list(extremes.run(_THIRD, tick)))


def _sensor_part(name, tick):
    """Rows; where the presses are not at hand, the reason."""
    try:
        return measure_sensor(name, _EIGHTH)
    except InputError as error:
        return {"skipped": str(error)}
