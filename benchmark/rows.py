"""How soon and how well contacts are known that are followed from row to row.

    scripts/setup python3 benchmark/rows.py [--touches N] [--idle ROWS] [--cases "onset from nothing" ...]
        [--layout L] [--sensor exact | worn | aside | neighbours]

Rows of the simulator's finite elements, each of the sheet as it is at its own time, 1 mV, 12 bits, 1 ms
a row, 8 x 8 electrodes on 200 mm unless --layout says otherwise; the reconstruction has the closed form
where there is one. Discs of 5 mm radius, 1 N, at random places, that begin and end at random rows. What a
frame tells, where rows ask for it, is told 24 rows after its last one, as in the node, where frames
are estimated beside. --sensor: what is wrong with it, of which nothing was learned; another one for every
touch. `worn`: uneven by 10 %, gains 1 %, offsets 2 mV, electrodes 0.3 mm aside, 75 to 225 ohm to ground;
`aside`: the same, 1 mm; `neighbours`: two wires are exchanged. Seeds are fixed.

A result is a ghost's that shows a contact 10 mm or more from every true one (one that has ended counts
as true for 3 rows). Known: within 10 mm; row 1 is the first one taken after the touch has begun.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tomotactile_ros.bench.program import options, spread
from tomotactile_ros.bench.tables import Table
from tomotactile_ros.bench.trials import DRIVE, make_pipeline, make_scene
from tomotactile_ros.layouts import scan_order
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import SheetVariation
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

RADIUS, FORCE = 0.005, 1.0  # m, N
NEAR, APART, GRACE = 0.010, 0.045, 3  # m, m, rows
FROM_RIM = 0.015  # m: centres are at least so far from the rim
SPEEDS = (0.2, 0.5, 1.0)  # m/s
AFTER = (1, 12)  # rows
FIRST, LATER = 8, 24  # rows before the first touch, and from it to the next one
SETTLED = 30  # rows after which velocities are judged
PASSING, CROSSING = 0.02, 0.25  # m between two paths, m/s
RUN = 40  # frames in which nothing happens
LATE = 24  # rows until a frame is estimated
ASIDE = {"exact": 0.0, "worn": 0.0003, "aside": 0.001, "neighbours": 0.0}  # m, rms, by sensor

COUNTS = (
    *("touches", "results", "with a ghost", "touches with ghosts"),
    *("withheld", "missed", "renamed"),
)
SPREADS = {  # what has a median and a p95: unit, digits
    "known after rows": (1, 0),
    **{f"mm after {n}": (1e3, 1) for n in AFTER},
    "gone after rows": (1, 0),
    "mm moving": (1e3, 1),
    "velocity off %": (100, 0),
    "mm resting": (1e3, 2),
}
COSTS = "ms to follow a row: median / p99", "ms to say so"


class Tally:
    """Sums over the touches of a case: `COUNTS`, values of `SPREADS`, s that each row took."""

    def __init__(self):
        self.counts, self.values = Counter(), defaultdict(list)
        self.costs: list[tuple[float, float]] = []

    def line(self, name: str) -> list[str]:
        """Of the table."""
        cells = [name, *(str(self.counts[key]) for key in COUNTS)]
        for key, (unit, digits) in SPREADS.items():
            cells.append(spread(unit * np.array(self.values[key]), digits))
        costs = 1e3 * np.transpose(self.costs)
        return [*cells, *(spread(each, 2, (0.5, 0.99)) for each in costs)]


def defects(sensor: str, seed: int, electrodes: int) -> Defects:
    """What is wrong with the sheet and with readings."""
    if sensor == "exact":
        return Defects()
    if sensor == "neighbours":
        one, _ = np.random.default_rng(seed).choice(electrodes - 1, 2, replace=False).tolist()
        return Defects(swapped=((one, one + 1),))
    channels = Channels(Rms(0.01, seed), Rms(0.002, seed), Uniform(150.0, 75.0, seed))
    return Defects(sheet_variation=SheetVariation(0.1, 0.05, seed), channels=channels)


def moved(layout: Layout, aside: float, seed: int) -> Layout:
    """The layout as it is, not as it was meant."""
    way = aside * np.random.default_rng(seed).standard_normal(layout.positions.shape)
    there = layout.positions + way
    fits = layout.outline.holds(there, layout.radius)
    # what was put against the rim lies along it, or farther inside
    return replace(layout, positions=np.where(fits[:, None], there, layout.positions))


@dataclass
class Row:
    """What was said of one row, and what touched then."""

    time: float
    contacts: list
    withheld: bool
    true: list[Contact]


class Sensor:
    """Scenes in, what is said of every row out."""

    def __init__(self, layout: str, sensor: str):
        self.sensor, self.layout = sensor, load_layout(layout)
        self.electrodes = self.layout.electrodes
        self._order = np.array(scan_order.spread(self.layout.positions, range(self.electrodes)))
        self.pipeline = make_pipeline(self.layout)
        self._clock = 0.0  # s, at which a scene begins

    def anywhere(self, random, *others) -> np.ndarray:
        """(2,) a place, far from others."""
        half = np.array(self.layout.outline.size) / 2
        while True:
            place = (half - FROM_RIM) * (2 * random.random(2) - 1)
            far = all(np.hypot(*(place - other)) > APART for other in others)
            if far and self.layout.outline.holds(place[None], FROM_RIM)[0]:
                return place

    def rows(self, contacts: list[Contact], frames: int, seed: int, tally: Tally) -> list[Row]:
        """What is said of each row of a scene; ghosts, and what was withheld, are counted."""
        said = list(self._rows(contacts, frames, seed, tally.costs))
        judge(said, tally)
        return said

    def _rows(self, contacts, frames, seed, costs) -> Iterator[Row]:
        wrong = defects(self.sensor, seed, self.electrodes)
        scene = make_scene(contacts, seed, wrong)
        layout = moved(self.layout, ASIDE[self.sensor], seed)
        simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
        simulator.grounded = self._order
        state, due = self.pipeline.rows(waits=False), {}
        self.pipeline.untare()  # and forgets the frames of the scene before
        self._clock += 60.0  # scenes follow each other: no clock is set back
        for whole in range(frames):
            starts = whole * self.electrodes * ROW_PERIOD
            frame = simulator.frame(starts, whole)
            for i, readings in enumerate(frame):
                number = whole * self.electrodes + i
                now, ground = number * ROW_PERIOD, int(self._order[i])
                if number in due:
                    self._tell(state, *due.pop(number))
                start = time.thread_time()
                self.pipeline.follow_row(readings, ground, DRIVE, self._clock + now, state)
                followed = time.thread_time()
                result = self.pipeline.after_row(state)
                costs.append((followed - start, time.thread_time() - followed))
                true = [c.at(now) for c in contacts if c.start <= now < c.end]
                yield Row(now, result.contacts, bool(result.reason), true)
            due[number + 1 + LATE] = frame, self._clock + starts

    def _tell(self, state, frame, begun: float) -> None:
        if not state.asks:  # as in the node
            return
        self.pipeline.process(frame, self._order, DRIVE, ROW_PERIOD, begun, False)
        self.pipeline.correct(state, frame, self._order, DRIVE, ROW_PERIOD, begun)


def disc(place, start=-1.0, end=np.inf, velocity=(0.0, 0.0)) -> Contact:
    pressure = FORCE / (np.pi * RADIUS**2)
    return Contact(
        "disc", center=tuple(place), radius=RADIUS, pressure=pressure, start=start, end=end,
        velocity=tuple(velocity),
    )  # fmt: skip


def apart(said, place) -> float:
    return float(np.hypot(said.x - place[0], said.y - place[1]))


def judge(rows: list[Row], tally: Tally) -> None:
    ended, ghosts = [], 0
    for before, row in zip([rows[0], *rows], rows):
        ended += [
            (row.time, each.center)
            for each in before.true
            if all(np.hypot(*(each.center - true.center)) >= NEAR for true in row.true)
        ]
        ended = [(at, place) for at, place in ended if row.time - at < (GRACE - 0.5) * ROW_PERIOD]
        there = [*(true.center for true in row.true), *(place for _, place in ended)]
        ghosts += any(all(apart(c, place) >= NEAR for place in there) for c in row.contacts)
        tally.counts["withheld"] += row.withheld
    tally.counts["results"] += len(rows)
    tally.counts["with a ghost"] += ghosts
    tally.counts["touches with ghosts"] += ghosts > 0
    tally.counts["touches"] += 1


def onset(sensor: Sensor, touches: int, beside: bool) -> Tally:
    """Touches that begin and end at random rows, from nothing or beside a resting one."""
    random, tally = np.random.default_rng(16 + beside), Tally()
    frame = sensor.electrodes
    # a frame, and some rows until it is told, after which what rests is known
    known = frame * (1 + int(np.ceil((LATE + 1) / frame))) * beside
    for touch in range(touches):
        held = sensor.anywhere(random)
        place = sensor.anywhere(random, held)
        first = int(random.integers(8, frame)) + known
        last = first + int(random.integers(frame // 2, 3 * frame // 2))
        tap = disc(place, (first - 0.5) * ROW_PERIOD, (last - 0.5) * ROW_PERIOD)
        rows = sensor.rows([disc(held)] * beside + [tap], last // frame + 2, touch, tally)
        far = [min((apart(c, place) for c in row.contacts), default=np.inf) for row in rows]
        found = [i for i in range(first, last) if far[i] < NEAR]
        if not found:
            tally.counts["missed"] += 1
            continue
        tally.values["known after rows"].append(found[0] - first + 1)
        for count in AFTER:
            tally.values[f"mm after {count}"].append(far[first + count - 1])
        left = [i for i in range(last, len(rows)) if far[i] < NEAR]
        tally.values["gone after rows"].append((left[-1] if left else last - 1) - last + 1)
        if beside:
            own = [c for row in rows[12:] for c in row.contacts if apart(c, held) < NEAR]
            tally.values["mm resting"] += [apart(c, held) for c in own]
            tally.counts["renamed"] += len({c.id for c in own}) != 1
    return tally


def moving(sensor: Sensor, touches: int, speed: float) -> Tally:
    """Touches that slide through the sheet."""
    random, tally = np.random.default_rng(160), Tally()
    for touch in range(touches):
        way, across = directions(random)
        begin = across * 0.06 * (2 * random.random() - 1) - 0.075 * way
        start = (FIRST - 0.5) * ROW_PERIOD
        end = start + min(0.15 / speed, 3 * sensor.electrodes * ROW_PERIOD)
        frames = int(np.ceil(end / ROW_PERIOD / sensor.electrodes))
        slide = disc(begin, start, end, speed * way)
        for row in sensor.rows([slide], frames, touch, tally)[FIRST + SETTLED :]:
            for true in row.true:
                best = min(row.contacts, key=lambda c: apart(c, true.center), default=None)
                if best is None:
                    tally.counts["missed"] += 1
                    continue
                off = float(np.hypot(*(best.velocity - speed * way))) / speed
                tally.values["mm moving"].append(apart(best, true.center))
                tally.values["velocity off %"].append(off)
    return tally


def directions(random) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors, at right angles."""
    angle = 2 * np.pi * random.random()
    x, y = np.cos(angle), np.sin(angle)
    return np.array([x, y]), np.array([-y, x])


def crossing(sensor: Sensor, pairs: int) -> Tally:
    """Two touches that pass each other; `renamed` counts pairs whose numbers are not what they were."""
    random, tally = np.random.default_rng(1600), Tally()
    for pair in range(pairs):
        way, across = directions(random)
        middle = 0.02 * (2 * random.random(2) - 1)
        lasts = 0.15 / CROSSING
        contacts = []
        for i, sign in enumerate((1, -1)):
            start = (FIRST + i * LATER - 0.5) * ROW_PERIOD
            begin = PASSING / 2 * across - (0.075 - start * CROSSING) * way
            contacts.append(disc(middle + sign * begin, start, lasts, sign * CROSSING * way))
        frames = int(lasts / ROW_PERIOD) // sensor.electrodes
        rows = sensor.rows(contacts, frames, pair, tally)
        numbers = [_numbers(rows[2 * sensor.electrodes - 1]), _numbers(rows[-1])]
        tally.counts["renamed"] += None in numbers or numbers[0] != numbers[1]
    return tally


def _numbers(row: Row):
    """Number of the contact that is nearest to each true one; None where two have the same."""
    if len(row.contacts) < len(row.true):
        return None
    found = [min(row.contacts, key=lambda c, t=t: apart(c, t.center)).id for t in row.true]
    return found if len(set(found)) == len(found) else None


def still(sensor: Sensor, rows: int, load: bool) -> Tally:
    """Nothing happens: on an untouched sheet, or under a resting contact."""
    random, tally = np.random.default_rng(1), Tally()
    for part in range(int(np.ceil(rows / RUN / sensor.electrodes))):
        said = sensor.rows([disc(sensor.anywhere(random))] * load, RUN, part, tally)
        less = (len(row.contacts) < load and not row.withheld for row in said[GRACE:])
        tally.counts["missed"] += sum(less)
        numbers = {c.id for row in said[sensor.electrodes :] for c in row.contacts}
        tally.counts["renamed"] += len(numbers) > load
    return tally


CASES = {
    "onset from nothing": partial(onset, beside=False),
    "onset beside one": partial(onset, beside=True),
    **{f"{speed:g} m/s": partial(moving, speed=speed) for speed in SPEEDS},
    "passing at 20 mm": crossing,
    "idle": partial(still, load=False),
    "resting load": partial(still, load=True),
}


def main() -> None:
    args = options(
        __doc__,
        touches=(50, "of each case"),
        idle=(20_000, "rows where nothing happens"),
        layout=("equal-8x8", "a name or a file"),
        sensor=("exact", None, ASIDE),
        cases=(list(CASES), None, CASES),
    )
    sensor, table = Sensor(args.layout, args.sensor), Table("case", *COUNTS, *SPREADS, *COSTS)
    counts = {"idle": args.idle, "resting load": args.idle // 4}
    for name in args.cases:
        table.add(*CASES[name](sensor, counts.get(name, args.touches)).line(name))


if __name__ == "__main__":
    main()
