"""A whole benchmark: what `tomotactile bench` measures, in which order, with progress; and what of it
has been measured, on disk: stopped, it goes on where it was."""

from __future__ import annotations

import hashlib
import json
import resource
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
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic
from tomotactile_ros.support.progress import Progress
from tomotactile_ros.support.yamlio import plain

FORMAT = "tomotactile-bench/10"
FORMAT_OF_PARTS = "tomotactile-bench-parts/1"
Tick = Callable[[float], None]
SENSOR = tuple(name for name in PARTS if name not in ON_DEMAND)
_EIGHTH, _THIRD = 8, 3  # of the presses of the sensor's parts, of the values of each extreme


class Store:
    """Parts of a benchmark by their names, kept in the file at `path`.

    Parts of another machine or version of the code, or of other `methods`, are forgotten.
    """

    def __init__(self, path: str | Path, methods: Sequence[str] = ()):
        self.path = Path(path)
        made_on = machine.describe() | {"date": None}
        self._made_by = {"machine": made_on, "code": _code(), "methods": list(methods)}
        self.parts: dict[str, Any] = self._load()

    def add(self, name: str, found: Any) -> None:
        """Keep a part, on disk too."""
        self.parts[name] = plain(found)
        self.save()

    def save(self) -> None:
        """Write the file; InputError where that is not possible."""
        content = {"made by": self._made_by, "parts": self.parts}
        write_atomic(self.path, json.dumps(content, allow_nan=False).encode())

    def remove(self) -> None:
        """Nothing is left on disk."""
        self.path.unlink(missing_ok=True)

    def _load(self):
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            return content["parts"] if content["made by"] == self._made_by else {}
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return {}


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


def measure(store: Store, todo: Sequence[Part]) -> dict:
    """What the parts find as plain data, see docs/benchmarks.md; `store` keeps every part."""
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
    found = {name: each["found"] for name, each in kept.items()}
    return {
        "machine": machine.describe(),
        "seconds": {name: each["seconds"] for name, each in kept.items()},
        "peak_memory": max(each["peak_memory"] for each in kept.values()),
        "sensor": {name: found.pop(name) for name in PARTS if name in found},
        **found,
    }


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
