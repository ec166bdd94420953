"""How soon and how well contacts are known that are followed from row to row.

    scripts/setup python3 benchmark/rows.py [--touches N] [--idle ROWS] [--cases onset ...] [--late ROWS]
        [--layout L] [--sensor exact | worn | bad | aside | stuck | exchanged | neighbours | slow]

Rows of the simulator's finite elements, each of the sheet as it is at its own time, 1 mV, 12 bits, 1 ms
a row, 8 x 8 electrodes on 200 mm unless --layout says otherwise; the reconstruction has the closed form
where there is one. Discs of 5 mm radius, 1 N, at random places, that begin and end at random rows. What a
frame tells, where rows ask for it, is told --late rows after its last one, as in the node, where frames
are estimated beside. --sensor: what is wrong with it (`SENSORS`), of which nothing was learned; another
one for every touch. Seeds are fixed.

A result is a ghost's that shows a contact 10 mm or more from every true one (one that has ended counts
as true for 3 rows). Known: within 10 mm; row 1 is the first one taken after the touch has begun.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.layouts.scan_order import AdaptiveOrder, spread
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import SheetVariation
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

RADIUS, FORCE = 0.005, 1.0  # m, N
NEAR, APART, GRACE = 0.010, 0.045, 3  # m, m, rows
FROM_RIM = 0.015  # m: centres are at least so far from the rim
SPEEDS = (0.2, 0.5, 1.0)  # m/s
AFTER = (1, 2, 4, 12)  # rows
FIRST, LATER = 8, 24  # rows before the first touch, and from it to the next one
SETTLED = 30  # rows after which velocities are judged
PASSING, CROSSING = 0.02, 0.25  # m between two paths, m/s


@dataclass
class Row:
    """What was said of one row, and what was true: places (k, 2), m, and since or until when."""

    time: float
    contacts: list
    withheld: bool
    true: list[Contact]


COUNTS = (
    "touches",
    "results",
    "with a ghost",
    "touches with ghosts",
    "withheld",
    "missed",
    "renamed",
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
            values = unit * np.array(self.values[key])
            spread = np.quantile(values, (0.5, 0.95)) if len(values) else ()
            cells.append(" / ".join(f"{each:.{digits}f}" for each in spread) or "-")
        costs = np.quantile(1e3 * np.array(self.costs), (0.5, 0.99), axis=0).T
        return [*cells, *(f"{median:.2f} / {high:.2f}" for median, high in costs)]


@dataclass(frozen=True)
class Wrong:
    """What is wrong with a sensor, root mean square: the sheet, relative; gains; offsets, V; places of
    electrodes along x and y, m; with an uneven sheet, resistances to ground are 75 to 225 ohm. Or one
    channel is stuck at 0 V, two wires are exchanged, those of neighbours if not of any two, or
    readings keep 0.5 % of the row before: `broken`."""

    sheet: float = 0.0
    gains: float = 0.0
    offsets: float = 0.0
    aside: float = 0.0
    broken: str = ""

    def defects(self, seed: int, electrodes: int) -> Defects:
        one, other = np.random.default_rng(seed).choice(electrodes - 1, 2, replace=False).tolist()
        if self.broken:
            return {
                "stuck": Defects(channels=Channels(stuck={one: 0.0})),
                "exchanged": Defects(swapped=((one, other),)),
                "neighbours": Defects(swapped=((one, one + 1),)),
                "slow": Defects(channels=Channels(settling=0.005)),
            }[self.broken]
        if not self.sheet:
            return Defects()
        gain, offset = Rms(self.gains, seed), Rms(self.offsets, seed)
        channels = Channels(gain, offset, Uniform(150.0, 75.0, seed))
        variation = SheetVariation(self.sheet, 0.05, seed)
        return Defects(sheet_variation=variation, channels=channels)

    def moved(self, layout: Layout, seed: int) -> Layout:
        """The layout as it is, not as it was meant."""
        if not self.aside:
            return layout
        outline, radius = layout.outline, layout.radius
        way = np.random.default_rng(seed).normal(0, self.aside, layout.positions.shape)
        there = layout.positions + way
        fits = outline.contains(there) & (outline.rim_distance(there) > radius)
        # what was put against the rim lies along it, or farther inside
        there = np.where(fits[:, None], there, layout.positions)
        return replace(layout, positions=there)


SENSORS = {
    "exact": Wrong(),
    "worn": Wrong(0.1, 0.01, 0.002, 0.0003),
    "bad": Wrong(0.2, 0.02, 0.002, 0.0003),
    "aside": Wrong(0.1, 0.01, 0.002, 0.001),
    **{each: Wrong(broken=each) for each in ("stuck", "exchanged", "neighbours", "slow")},
}


class Sensor:
    """Scenes in, what is said of every row out."""

    def __init__(self, late: int, order: str = "jumping", layout: str = "equal-8x8", wrong="exact"):
        self.late, self.order, self.wrong = late, order, SENSORS[wrong]
        self.layout = load_layout(layout)
        self.electrodes = self.layout.electrodes
        self._jumping = spread(self.layout.positions, range(self.electrodes))
        self.pipeline = Pipeline(self.layout, Settings("accurate", noise=NOISE, contact_law=LAW))
        self._clock = 0.0  # s, at which a scene begins

    def anywhere(self, random, *others) -> np.ndarray:
        """(2,) a place, far from others."""
        outline = self.layout.outline
        half = np.array(outline.size) / 2
        while True:
            place = (half - FROM_RIM) * (2 * random.random(2) - 1)
            inside = outline.contains(place[None])[0]
            if not inside or outline.rim_distance(place[None])[0] < FROM_RIM:
                continue
            if all(np.hypot(*(place - other)) > APART for other in others):
                return place

    def rows(self, contacts: list[Contact], frames: int, seed: int, costs: list) -> Iterator[Row]:
        """What is said of each row of a scene."""
        noise, adc = Noise(NOISE, seed), Adc(12, DRIVE)
        scene = Scene(
            "rows", DRIVE, contacts, LAW, noise, adc, self.wrong.defects(seed, self.electrodes)
        )
        layout = self.wrong.moved(self.layout, seed)
        simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
        state, due, read = self.pipeline.rows(waits=False), {}, []
        self.pipeline.untare()  # and forgets the frames of the scene before
        adaptive, places = AdaptiveOrder(self.layout.positions), np.empty((0, 2))
        self._clock += (
            60.0  # scenes follow each other; a clock that is set back a little is not tried here
        )
        clock = self._clock
        number, whole, begun = 0, 0, clock
        while number < frames * self.electrodes:
            simulator.grounded = grounded = self._order(adaptive, places)
            for readings, ground in zip(simulator.frame(number * ROW_PERIOD, whole), grounded):
                now = number * ROW_PERIOD
                if number in due:
                    self._tell(state, *due.pop(number))
                start = time.thread_time()
                self.pipeline.follow_row(readings, int(ground), DRIVE, clock + now, state)
                followed = time.thread_time()
                result = self.pipeline.after_row(state)
                costs.append((followed - start, time.thread_time() - followed))
                true = [c.at(now) for c in contacts if c.start <= now < c.end]
                yield Row(now, result.contacts, bool(result.reason), true)
                read.append((readings, int(ground)))
                number += 1
            # the next order is told while this frame's last row is still on the way
            places = np.array([[c.x, c.y] for c in result.contacts]).reshape(-1, 2)
            due[number + self.late] = read, begun
            read, begun, whole = [], clock + number * ROW_PERIOD, whole + 1

    def _order(self, adaptive: AdaptiveOrder, contacts: np.ndarray) -> np.ndarray:
        if self.order == "adaptive":
            return np.array(adaptive.frame(contacts))
        return np.array(self._jumping) if self.order == "jumping" else np.arange(self.electrodes)

    def _tell(self, state, read, begun: float) -> None:
        if not state.asks:  # as in the node
            return
        frame, grounded = (np.array(each) for each in zip(*read))
        self.pipeline.process(frame, grounded, DRIVE, ROW_PERIOD, begun, False)
        self.pipeline.correct(state, frame, grounded, DRIVE, ROW_PERIOD, begun)


def disc(place, start=-1.0, end=np.inf, velocity=(0.0, 0.0)) -> Contact:
    pressure = FORCE / (np.pi * RADIUS**2)
    return Contact(
        "disc",
        center=tuple(place),
        radius=RADIUS,
        pressure=pressure,
        start=start,
        end=end,
        velocity=tuple(velocity),
    )


def apart(said, true) -> float:
    return float(np.hypot(said.x - true.center[0], said.y - true.center[1]))


def judge(rows: list[Row], tally: Tally) -> None:
    """Ghosts and what was withheld."""
    ended, ghosts = [], 0
    for before, row in zip([rows[0], *rows], rows):
        ended += [
            (row.time, each) for each in before.true if not any(same(each, t) for t in row.true)
        ]
        ended = [(at, each) for at, each in ended if row.time - at < (GRACE - 0.5) * ROW_PERIOD]
        there = [*row.true, *(each for _, each in ended)]
        ghosts += any(all(apart(c, t) >= NEAR for t in there) for c in row.contacts)
        tally.counts["withheld"] += row.withheld
    tally.counts["results"] += len(rows)
    tally.counts["with a ghost"] += ghosts
    tally.counts["touches with ghosts"] += ghosts > 0
    tally.counts["touches"] += 1


def same(one: Contact, other: Contact) -> bool:
    return bool(np.hypot(*(one.center - other.center)) < NEAR)


def nearest(row: Row, place) -> float:
    """m from the nearest contact to a place; infinite without one."""
    return min(
        (float(np.hypot(c.x - place[0], c.y - place[1])) for c in row.contacts), default=np.inf
    )


def onset(sensor: Sensor, touches: int, beside: bool, draw: int) -> Tally:
    """Touches that begin and end at random rows, from nothing or beside a resting one; others for each
    number of a `draw`."""
    seed = 16 + beside
    random, tally = np.random.default_rng([seed, draw] if draw else seed), Tally()
    frame = sensor.electrodes
    # a frame, and some rows until it is told, after which what rests is known
    known = frame * (1 + int(np.ceil((sensor.late + 1) / frame))) * beside
    for touch in range(touches):
        held = sensor.anywhere(random)
        place = sensor.anywhere(random, held)
        first = int(random.integers(8, frame)) + known
        last = first + int(random.integers(frame // 2, 3 * frame // 2))
        frames = last // frame + 2
        tap = disc(place, (first - 0.5) * ROW_PERIOD, (last - 0.5) * ROW_PERIOD)
        contacts = [disc(held)] * beside + [tap]
        rows = list(sensor.rows(contacts, frames, touch, tally.costs))
        judge(rows, tally)
        far = [nearest(row, place) for row in rows]
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
            numbers = set()
            for row in rows[12:]:
                own = [c for c in row.contacts if np.hypot(c.x - held[0], c.y - held[1]) < NEAR]
                numbers |= {c.id for c in own}
                tally.values["mm resting"] += [
                    float(np.hypot(c.x - held[0], c.y - held[1])) for c in own
                ]
            tally.counts["renamed"] += len(numbers) != 1
    return tally


def moving(sensor: Sensor, touches: int, speed: float) -> Tally:
    """Touches that slide through the sheet."""
    random, tally = np.random.default_rng(160), Tally()
    for touch in range(touches):
        angle = 2 * np.pi * random.random()
        way = np.array([np.cos(angle), np.sin(angle)])
        side = np.array([-way[1], way[0]]) * 0.06 * (2 * random.random() - 1)
        begin = side - 0.075 * way
        start = (FIRST - 0.5) * ROW_PERIOD
        end = start + min(0.15 / speed, 3 * sensor.electrodes * ROW_PERIOD)
        frames = int(np.ceil(end / ROW_PERIOD / sensor.electrodes))
        slide = disc(begin, start, end, speed * way)
        rows = list(sensor.rows([slide], frames, touch, tally.costs))
        judge(rows, tally)
        for row in rows[FIRST + SETTLED :]:
            if not row.true:
                continue
            (true,) = row.true
            best = min(row.contacts, key=lambda c: apart(c, true), default=None)
            if best is None:
                tally.counts["missed"] += 1
                continue
            tally.values["mm moving"].append(apart(best, true))
            tally.values["velocity off %"].append(
                float(np.hypot(*(best.velocity - speed * way))) / speed
            )
    return tally


def crossing(sensor: Sensor, pairs: int) -> Tally:
    """Two touches that pass each other; `renamed` counts pairs whose numbers are not what they were."""
    random, tally = np.random.default_rng(1600), Tally()
    for pair in range(pairs):
        angle = 2 * np.pi * random.random()
        way = np.array([np.cos(angle), np.sin(angle)])
        side = PASSING / 2 * np.array([-way[1], way[0]])
        middle = 0.02 * (2 * random.random(2) - 1)
        lasts = 0.15 / CROSSING
        contacts = []
        for i, sign in enumerate((1, -1)):
            start = (FIRST + i * LATER - 0.5) * ROW_PERIOD
            begin = side - (0.075 - start * CROSSING) * way
            contacts.append(disc(middle + sign * begin, start, lasts, sign * CROSSING * way))
        frames = int(lasts / ROW_PERIOD) // sensor.electrodes
        rows = list(sensor.rows(contacts, frames, pair, tally.costs))
        judge(rows, tally)
        numbers = [_numbers(rows[2 * sensor.electrodes - 1]), _numbers(rows[-1])]
        tally.counts["renamed"] += None in numbers or numbers[0] != numbers[1]
    return tally


def _numbers(row: Row):
    """Number of the contact that is nearest to each true one; None where two have the same."""
    if len(row.contacts) < len(row.true):
        return None
    found = [min(row.contacts, key=lambda c, t=t: apart(c, t)).id for t in row.true]
    return found if len(set(found)) == len(found) else None


def still(sensor: Sensor, rows: int, load: bool) -> Tally:
    """Nothing happens: on an untouched sheet, or under a resting contact."""
    random, tally = np.random.default_rng(1), Tally()
    run = 40  # frames
    for part in range(int(np.ceil(rows / run / sensor.electrodes))):
        contacts = [disc(sensor.anywhere(random))] * load
        said = list(sensor.rows(contacts, run, part, tally.costs))
        judge(said, tally)
        tally.counts["missed"] += sum(
            len(row.contacts) < load and not row.withheld for row in said[GRACE:]
        )
        tally.counts["renamed"] += (
            len({c.id for row in said[sensor.electrodes :] for c in row.contacts}) > load
        )
    return tally


def several(sensor: Sensor, rows: int, count: int) -> Tally:
    """What a row costs under some resting contacts."""
    random, tally = np.random.default_rng(3), Tally()
    places: list[np.ndarray] = []
    for _ in range(count):
        places.append(sensor.anywhere(random, *places))
    starts = [(FIRST + i * LATER - 0.5) * ROW_PERIOD for i in range(count)]
    discs = [disc(place, start) for place, start in zip(places, starts)]
    said = list(sensor.rows(discs, 2 + rows // sensor.electrodes, 0, tally.costs))
    judge(said, tally)
    tally.costs = tally.costs[2 * sensor.electrodes :]
    return tally


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--touches", type=int, default=50, help="of each case")
    parser.add_argument("--draw", type=int, default=0, help="which touches that begin and end")
    parser.add_argument("--idle", type=int, default=20_000, help="rows where nothing happens")
    parser.add_argument("--late", type=int, default=24, help="rows until a frame is estimated")
    parser.add_argument("--order", choices=("jumping", "turn", "adaptive"), default="jumping")
    parser.add_argument("--layout", default="equal-8x8", help="a name or a file")
    parser.add_argument("--sensor", choices=SENSORS, default="exact")
    cases = {
        "onset from nothing": lambda s, n: onset(s, n, False, args.draw),
        "onset beside one": lambda s, n: onset(s, n, True, args.draw),
        **{f"{v:g} m/s": lambda s, n, v=v: moving(s, n, v) for v in SPEEDS},
        "passing at 20 mm": lambda s, n: crossing(s, n),
        "three resting": lambda s, n: several(s, args.idle // 20, 3),
        "idle": lambda s, n: still(s, args.idle, False),
        "resting load": lambda s, n: still(s, args.idle // 4, True),
    }
    parser.add_argument("--cases", nargs="+", choices=cases, default=list(cases))
    args = parser.parse_args()
    sensor, table = Sensor(args.late, args.order, args.layout, args.sensor), []
    for name in args.cases:
        begun = time.monotonic()
        table.append(cases[name](sensor, args.touches).line(name))
        print(f"{name}: {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    print("\n".join(markdown(["case", *COUNTS, *SPREADS, *COSTS], table)))


if __name__ == "__main__":
    main()
