"""Taps and slides as one sees them who asks for a contact list of each frame.

    scripts/setup python3 benchmark/frames_in_motion.py [--layout L] [--scenes N] [--rows]

Frames of the simulator's finite elements, each row of the sheet as it is at its own time, 1 mV, 12
bits, 1 ms a row, one frame right after the other. A tap is a half sine of 40 to 300 ms and 0.3 to 8 N,
a slide goes 60 to 200 ms at 0.05 to 0.5 m/s; discs of 4 to 8 mm radius, pressed as a ball (Hertz) or
evenly, from 15 mm inside the rim on. Each scene is a tap or a slide alone, or beside a contact that
rests; it begins 128 to 256 ms after the first row. --rows: not frames, but results after every row, which
frames correct as soon as they are complete.

A result counts as of the time that it holds for. What began or ended less than 3 rows before may be
reported or not, nor is one missed that presses with less than 0.1 N; forces of these are not judged.
"""

from __future__ import annotations

from time import process_time

import numpy as np

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.trials import make_pipeline, make_scene
from tomotactile_ros.commands.reconstruct import every_frame, every_row
from tomotactile_ros.evaluation import scoring
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.course import Tap
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

GRACE, FROM_RIM, APART = 3, 0.015, 0.045  # rows, m, m
RESTED = 0.128  # s: nothing changes for so long, from the first row on
LEAST = 0.1  # N that is missed if it is not found, and whose force is judged
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
        given["course"] = Tap(draw.uniform(0.04, 0.3))
        force = draw.uniform(0.3, 8.0)
    else:
        speed = draw.uniform(0.05, 0.5)
        end = moved + min(draw.uniform(0.06, 0.2), 0.1 / speed)
        velocity = speed * way / np.linalg.norm(way)
        while np.linalg.norm(places[0] + velocity * (end - moved) / 2 - places[2]) < APART:
            places[2] = draw.uniform(low, high)
        given["velocity"], force = velocity, draw.uniform(0.5, 5.0)
    moving = Contact("disc", places[0], force=force, start=moved, end=end, **given)
    resting = Contact("disc", places[2], force=draw.uniform(0.5, 5.0), radius=0.006)
    contacts = (moving, resting) if "beside" in kind else (moving,)
    return make_scene(contacts, int(draw.integers(1 << 30)))


def judged(result, scene: Scene, at: float) -> scoring.FrameScore:
    """Of a result that holds for the time `at`, s."""
    there, before = scene.truth(at), scene.truth(at - GRACE * ROW_PERIOD)
    truth = [
        each | {scoring.PART: each["force"] <= LEAST or not _is_in(each, before)} for each in there
    ]
    truth += [each | {scoring.PART: True} for each in before if not _is_in(each, there)]
    return scoring.score_frame(result.contacts, truth)


def _is_in(contact: dict, others: list[dict]) -> bool:
    apart = [np.hypot(contact["x"] - each["x"], contact["y"] - each["y"]) for each in others]
    return min(apart, default=np.inf) < scoring.REACH


def main() -> None:
    given = options(
        __doc__,
        layout="equal-8x8",
        scenes=(20, "of each kind (20)"),
        rows=(False, "results after every row"),
    )
    layout = load_layout(given.layout)
    lasts = layout.electrodes * ROW_PERIOD
    follow = every_row if given.rows else every_frame
    table = tables.Table(
        "scene", *tables.titles(tables.HELD), "ms of processor: median / p95 / worst"
    )
    for place, kind in enumerate(KINDS):
        scores, times = [], []
        for number in range(given.scenes):
            scene = scene_of(kind, layout, np.random.default_rng([1, place, number]), lasts)
            simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
            ends = scene.contacts[0].end
            ends = scene.contacts[0].start + 0.3 if np.isinf(ends) else ends
            count = int(np.ceil(ends / lasts)) + 2
            frames = [simulator.measure(i * lasts, i) for i in range(count)]
            for result, took, at in follow(make_pipeline(layout), frames, process_time):
                times.append(1e3 * took)
                if not result.reason:
                    scores.append(judged(result, scene, at))
        found = scoring.summary(scores, len(times) - len(scores))
        took = np.quantile(times, (0.5, 0.95, 1.0))
        table.add(
            kind, *tables.cells(tables.HELD, found), " / ".join(f"{each:.3g}" for each in took)
        )


if __name__ == "__main__":
    main()
