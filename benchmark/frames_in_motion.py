"""Taps and slides as one sees them who asks for a contact list of each frame.

    scripts/setup python3 benchmark/frames_in_motion.py [--layout L] [--profiles accurate ...]
        [--scenes N] [--every K] [--draw SEED] [--rows]

Frames of the simulator's finite elements, each row of the sheet as it is at its own time, 1 mV, 12
bits, 1 ms a row, one frame right after the other. A tap is a half sine of 40 to 300 ms and 0.3 to 8 N,
a slide goes 60 to 200 ms at 0.05 to 0.5 m/s; discs of 4 to 8 mm radius, pressed as a ball (Hertz) or
evenly, from 15 mm inside the rim on. Each scene is a tap or a slide alone, or beside a contact that
rests; it begins 128 to 256 ms after the first row. --every: frames that are looked at, each Kth. --rows:
not frames, but results after every row, which frames correct as soon as they are complete.

A result counts as of the time that it holds for. A ghost is 10 mm or more from every true contact,
of which one that has ended counts as true for 3 rows; missed is a true one of more than 0.1 N that
began 3 rows ago at least. Forces beside 0.1 N are not judged. "held": true places and forces within
what covers 95 % of the stated distribution.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.special import chdtri

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.course import Tap
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

DRIVE, NOISE, LAW = 3.3, 1e-3, ContactLaw(1e-4, 1.0)
NEAR, GRACE, FROM_RIM, APART = 0.010, 3, 0.015, 0.045  # m, rows, m, m
RESTED = 0.128  # s: nothing changes for so long, from the first row on
LEAST = 0.1  # N that is missed if it is not found, and whose force is judged
SURE, TWO_SIDED = float(chdtri(2, 0.05)), 1.96
KINDS = ("tap", "tap beside one", "slide", "slide beside one")


def scene_of(kind: str, layout: Layout, draw: np.random.Generator, lasts: float) -> Scene:
    """A scene whose frames last `lasts` s."""
    low, high = np.reshape(layout.outline.bounds, (2, 2)) + [[FROM_RIM], [-FROM_RIM]]
    moved, end = max(lasts, RESTED) * draw.uniform(1, 2), np.inf
    given = {"radius": draw.uniform(0.004, 0.008), "profile": draw.choice(["hertz", "even"])}
    while True:
        places = draw.uniform(low, high, (3, 2))
        way = places[1] - places[0]
        inside = layout.outline.contains(places).all()
        if inside and np.linalg.norm(way) > 0.1 and np.linalg.norm(places[2] - places[0]) > APART:
            break
    if kind.startswith("tap"):
        tap = Tap(draw.uniform(0.04, 0.3))
        moving = Contact(
            "disc", places[0], force=draw.uniform(0.3, 8.0), start=moved, course=tap, **given
        )
    else:
        speed = draw.uniform(0.05, 0.5)
        end = moved + min(draw.uniform(0.06, 0.2), 0.1 / speed)
        velocity = speed * way / np.linalg.norm(way)
        while np.linalg.norm(places[0] + velocity * (end - moved) / 2 - places[2]) < APART:
            places[2] = draw.uniform(low, high)
        moving = Contact(
            "disc", places[0], force=draw.uniform(0.5, 5.0), start=moved, end=end,
            velocity=velocity, **given,
        )  # fmt: skip
    resting = Contact("disc", places[2], force=draw.uniform(0.5, 5.0), radius=0.006)
    contacts = (moving, resting) if "beside" in kind else (moving,)
    return Scene(
        kind, DRIVE, contacts, LAW, Noise(NOISE, int(draw.integers(1 << 30))), Adc(12, DRIVE)
    )


class Scores:
    """What became of the results of one kind of scene and one profile."""

    def __init__(self):
        self.results = self.withheld = self.ghosts = self.missed = self.true = 0
        self.places, self.forces, self.times, self.held = [], [], [], []

    def judge(self, result, scene: Scene, at: float, took: float) -> None:
        self.results += 1
        self.times.append(1e3 * took)
        if result.reason:
            self.withheld += 1
            return
        there, before = scene.truth(at), scene.truth(at - GRACE * ROW_PERIOD)
        found = np.array([(c.x, c.y) for c in result.contacts]).reshape(-1, 2)
        self.ghosts += bool((_nearest(found, there + before) > NEAR).any())
        strong = [each for each in there if each["force"] > LEAST and _is_in(each, before)]
        self.true += len(strong)
        self.missed += int((_nearest(_places(strong), result.contacts) > NEAR).sum())
        for contact in result.contacts:
            apart = _nearest(_places(there), [contact])
            if not len(apart) or apart.min() > NEAR:
                continue
            true = there[int(apart.argmin())]
            self.places.append(1e3 * apart.min())
            way = np.array([contact.x - true["x"], contact.y - true["y"]])
            spread = np.reshape(contact.position_covariance, (2, 2))
            self.held.append(way @ np.linalg.solve(spread, way) < SURE)
            if true["force"] > LEAST:
                self.forces.append(100 * abs(contact.force / true["force"] - 1))
                off = true["force"] - contact.force
                lower = np.isinf(contact.force_std) and off > -0.05 * contact.force
                self.held.append(lower or abs(off) < TWO_SIDED * contact.force_std)

    def row(self) -> list[str]:
        """Cells of a table."""
        three = [_quantiles(each) for each in (self.places, self.forces)]
        times = (np.median(self.times), np.quantile(self.times, 0.95), max(self.times))
        return [
            str(self.results), str(self.ghosts), f"{self.missed} of {self.true}", str(self.withheld),
            *three, f"{100 * np.mean(self.held):.0f}", " / ".join(f"{t:.0f}" if t > 10 else f"{t:.2g}" for t in times),
        ]  # fmt: skip


def _places(contacts) -> np.ndarray:
    return np.array([(each["x"], each["y"]) for each in contacts]).reshape(-1, 2)


def _nearest(places: np.ndarray, contacts) -> np.ndarray:
    """(k,) m from each of `places` (k, 2) to the nearest of contacts, found or true."""
    others = np.array([(c["x"], c["y"]) if isinstance(c, dict) else (c.x, c.y) for c in contacts])
    if not len(others):
        return np.full(len(places), np.inf)
    return np.hypot(*(places[:, None] - others).transpose(2, 0, 1)).min(axis=1)


def _is_in(contact: dict, others) -> bool:
    return bool(_nearest(_places([contact]), others)[0] < NEAR)


def _quantiles(values) -> str:
    if not values:
        return "-"
    return " / ".join(
        f"{v:.0f}" if v > 10 else f"{v:.2g}" for v in np.quantile(values, (0.5, 0.95, 1.0))
    )


def _by_frames(pipeline: Pipeline, frames, grounded) -> Iterator[tuple]:
    """Results, the times that they hold for, s, and what they took, s."""
    for begun, frame in frames:
        start = time.process_time()
        result = pipeline.process(frame, grounded, DRIVE, ROW_PERIOD, begun)
        yield result, begun + result.holds, time.process_time() - start


def _by_rows(pipeline: Pipeline, frames, grounded) -> Iterator[tuple]:
    """The same after every row."""
    state = pipeline.rows()
    for begun, frame in frames:
        for i, (row, ground) in enumerate(zip(frame, grounded)):
            at, start = begun + i * ROW_PERIOD, time.process_time()
            result = pipeline.process_row(row, int(ground), DRIVE, at, state)
            yield result, at, time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=["accurate"])
    parser.add_argument("--scenes", type=int, default=20, help="of each kind (default: 20)")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--draw", type=int, default=1)
    parser.add_argument("--rows", action="store_true")
    given = parser.parse_args()
    layout = load_layout(given.layout)
    lasts, grounded = layout.electrodes * ROW_PERIOD, np.arange(layout.electrodes)
    settings = [Settings(each, noise=NOISE, contact_law=LAW) for each in given.profiles]
    lines = []
    for kind in KINDS:
        scores = {each: Scores() for each in given.profiles}
        for number in range(given.scenes):
            draw = np.random.default_rng([given.draw, KINDS.index(kind), number])
            scene = scene_of(kind, layout, draw, lasts)
            simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
            ends = scene.contacts[0].end
            ends = scene.contacts[0].start + 0.3 if np.isinf(ends) else ends
            count = int(np.ceil(ends / lasts)) + 2
            frames = [
                (i * lasts, simulator.frame(i * lasts, i)) for i in range(0, count, given.every)
            ]
            for each in settings:
                pipeline = Pipeline(layout, each)
                results = _by_rows if given.rows else _by_frames
                for result, at, took in results(pipeline, frames, grounded):
                    scores[each.profile].judge(result, scene, at, took)
            print(f"{kind} {number}", end="\r", file=sys.stderr, flush=True)
        lines += [[kind, name, *each.row()] for name, each in scores.items()]
    header = (
        "scene", "profile", "results", "with ghosts", "missed", "withheld", "place mm: median / p95 / worst",
        "force %", "held %", "ms of processor: median / p95 / worst",
    )  # fmt: skip
    print("\n".join(markdown(header, lines)))


if __name__ == "__main__":
    main()
