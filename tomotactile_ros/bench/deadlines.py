"""What time buys: contacts by the deadline of a frame, where frames follow one another in real time.

A sensor is scanned without a pause; every frame is given to the reconstruction when its last row is
there. Each result is compared with what touched at the time for which it says that it holds; contacts
whose stated deviation is 10 mm and more name no place: they are neither found nor ghosts.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tomotactile_ros.bench.reference_cases import apart
from tomotactile_ros.bench.trials import make_scene
from tomotactile_ros.evaluation.scoring import REACH, score_frame, summary
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import ContactEstimate, Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import Simulator

DEADLINES = 0.3e-3, 1e-3, 3e-3, 10e-3, 30e-3, 100e-3  # s
FRAMES = 16
SENSORS = {  # layout and scene; None: `_crowd`
    "textbook": ("equal-8x8", "default"),
    "worn": ("equal-8x8", "worn-sensor"),
    "hand": ("equal-8x8", "hand"),
    "ten": ("equal-8x8", None),
    "4 x 4": ("equal-4x4", "default"),
}


def measure(tick: Callable[[float], None] = lambda fraction: None) -> list[dict]:
    """A row for each sensor and deadline of profile `auto`: mean OSPA distance, m, ghosts, missed,
    median relative error of forces (None without any), withheld, complete, of so many frames; median and
    worst time, s."""
    rows = []
    for name, (layout_name, scene_name) in SENSORS.items():
        layout = load_layout(layout_name)
        scene = load_scene(scene_name) if scene_name else _crowd(layout, 10)
        simulator = Simulator(layout, scene)
        lasts = simulator.row_period * len(simulator.grounded)
        frames = [simulator.measure(i * lasts, i) for i in range(FRAMES)]
        pipeline = Pipeline(layout, Settings("auto", contact_law=scene.contact_law))
        for deadline in DEADLINES:
            pipeline.untare()  # from the beginning
            judged = _judge(pipeline, scene, frames, deadline)
            rows.append({"sensor": name, "deadline": deadline} | judged)
            tick(len(rows) / len(SENSORS) / len(DEADLINES))
        pipeline.stop()
    return rows


def _judge(pipeline, scene, frames, deadline) -> dict:
    times, scores, withheld, complete = [], [], 0, 0
    begun = time.monotonic()
    for number, frame in enumerate(frames):
        lasts = frame.row_period * len(frame.grounded)
        time.sleep(max(begun + (number + 1) * lasts - time.monotonic(), 0.0))
        start = time.perf_counter()
        result = pipeline.process(frame, deadline=deadline)
        times.append(time.perf_counter() - start)
        withheld += bool(result.reason)
        complete += result.complete
        truth = scene.truth(frame.stamp + result.holds)
        scores.append(score_frame(list(filter(_names_a_place, result.contacts)), truth))
    found = summary(scores)
    return {
        "frames": len(frames),
        "ospa": found["ospa"]["mean"],
        "ghosts": found["ghosts"] + found["doubled"],
        "missed": found["missed"],
        "force": found["force"]["median"],
        "withheld": withheld,
        "complete": complete,
        "median": float(np.median(times)),
        "worst": max(times),
    }


def _names_a_place(contact: ContactEstimate) -> bool:
    """Whether the deviation that is stated does not reach beyond the distance at which a contact is a
    ghost."""
    return bool(np.sqrt(contact.position_covariance[0] + contact.position_covariance[3]) < REACH)


def _crowd(layout: Layout, number: int) -> Scene:
    """So many fingertips at rest, 20 % of the side and more from each other, of 1 to 5 N."""
    random, size = np.random.default_rng(3), np.array(layout.outline.size)
    places = apart(lambda: (0.8 * size) * (random.random(2) - 0.5), number, 0.2 * size.max())
    contacts = (
        Contact("disc", center=place.tolist(), radius=0.006, force=force)
        for place, force in zip(places, np.linspace(1.0, 5.0, number), strict=True)
    )
    return make_scene(contacts)
