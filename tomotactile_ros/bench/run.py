"""A whole benchmark: what `tomotactile bench` measures, in which order, with progress; stopped, it goes
on where it was."""

from __future__ import annotations

import hashlib
import resource
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tomotactile_ros.bench import deadlines, extremes, growth, machine, peers, trade
from tomotactile_ros.bench.cases import CASES, DEFAULT_LAYOUT
from tomotactile_ros.bench.sensor.parts import ON_DEMAND, PARTS
from tomotactile_ros.bench.sensor.parts import measure as measure_sensor
from tomotactile_ros.bench.sensor.trial import Methods, profiles
from tomotactile_ros.bench.trade import EFFORT
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.progress import Progress
from tomotactile_ros.support.yamlio import plain

FORMAT = "tomotactile-bench/10"
FORMAT_OF_PARTS = "tomotactile-bench-parts/1"
Tick = Callable[[float], None]
SENSOR = tuple(name for name in PARTS if name not in ON_DEMAND)
_EIGHTH, _THIRD = 8, 3  # of the presses of the sensor's parts, of the values of each extreme


def _code() -> str:
    """Digest of all modules of the package."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Part:
    """`measure` takes about `seconds`, and calls what it is given with the fraction that is done."""

    name: str
    seconds: float
    measure: Callable[[Tick], Any]


def measure(todo: Sequence[Part], path: Path, methods: Sequence[str] = ()) -> dict:
    """What the parts find as plain data, see docs/benchmarks.md.

    The file at `path` keeps each as soon as it is measured: stopped, the same goes on from there, unless
    machine, code, parts or the names of `methods` are others.
    """
    work, there = _begun(todo, path, methods), path.exists()
    if work.known:
        _say(f"{path}: continued, {work.known} of {len(todo)} parts are done")
    elif there:
        _say(f"{path}: was measured with other code or on another machine: starting over")
    left = sum(part.seconds for part in todo[work.known :])
    found, before = {}, 0.0
    try:
        with Progress("benchmark", round(left) or 1) as progress:
            for part in todo:

                def tick(fraction: float, before=before, part=part) -> None:
                    progress.update(round(before + fraction * part.seconds), part.name)

                known = work.known
                found[part.name] = work.do(_measured, part.measure, tick)
                before += 0.0 if known else part.seconds
    except KeyboardInterrupt:
        done = f"{len(found)} of {len(todo)} parts; the same command goes on from there"
        _say(f"{path}: keeps what is done, {done}")
        raise
    values = {name: each["found"] for name, each in found.items()}
    return {
        "machine": machine.describe(),
        "seconds": {name: each["seconds"] for name, each in found.items()},
        "peak_memory": max(each["peak_memory"] for each in found.values()),
        "sensor": {name: values.pop(name) for name in PARTS if name in values},
        **values,
    }


def _begun(todo, path, methods) -> Work:
    """What is known, or the beginning."""
    asked = {
        "machine": machine.describe() | {"date": None},
        "code": _code(),
        "parts": [part.name for part in todo],
        "methods": list(methods),
    }
    try:
        work = Work(path=path, resume=True)
        work.begin(**asked)
    except InputError:
        work = Work(path=path)
        work.begin(**asked)
    return work


def _measured(measure, tick):
    start = time.perf_counter()
    found = plain(measure(tick))
    seconds = time.perf_counter() - start
    tick(1.0)
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes
    return {"found": found, "seconds": seconds, "peak_memory": peak}


def _say(text: str) -> None:
    print(text, file=sys.stderr)


def parts(asked: Sequence[str] = (), methods: Sequence[Methods] = (profiles,)) -> list[Part]:
    """What is measured, in this order: everything, of the sensor's parts and of the extremes a part of
    the cases; or all cases of what is asked for."""
    if not asked:
        recorded = partial(trade.recorded, DEFAULT_LAYOUT, EFFORT.size)
        return [
            Part("trade", 110, partial(trade.measure, CASES, EFFORT)),
            *(Part(name, 8, partial(_sensor_part, name)) for name in SENSOR),
            Part("deadlines", 50, deadlines.measure),
            Part("peers", 15, lambda tick: peers.compare(recorded())),
            Part("growth", 15, growth.measure),
            Part("stability", 60, lambda tick: list(extremes.run(_THIRD, tick))),
        ]
    every = {name: Part(name, 64, partial(_whole_part, name, methods)) for name in PARTS}
    every["stability"] = Part("stability", 180, lambda tick: list(extremes.run(1, tick)))
    return [every[name] for name in dict.fromkeys(asked)]


def _whole_part(name, methods, tick):
    return measure_sensor(name, methods=methods)


def _sensor_part(name, tick):
    """Rows; where the presses are not at hand, the reason."""
    try:
        return measure_sensor(name, _EIGHTH)
    except InputError as error:
        return {"skipped": str(error)}
