"""Times of a frame, of the image alone, and what a start from the last image saves."""

from __future__ import annotations

import time

import numpy as np

from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.profiles.data import pairs_at
from tomotactile_ros.bench.profiles.figures import Runner
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator


def image_time(pipeline, frames):
    """Median and p99 of the linear image alone, float32 frame in V to image, s."""
    frames = frames.astype(np.float32)
    local = pipeline._model.local(np.arange(pipeline.layout.electrodes))
    times = []
    for _ in range(20):
        for frame in frames:
            start = time.perf_counter()
            local.image(local.meter.read(frame, DRIVE))
            times.append(time.perf_counter() - start)
    return np.median(times), np.percentile(times, 99)


def dense_time(layout, resolution=40):
    """Median time of a dense float32 product (K, L E) by (L E,), s: the same image without
    structure."""
    size = layout.electrodes**2
    matrix = np.ones((resolution**2, size), np.float32)
    vector = np.ones(size, np.float32)
    times = []
    for _ in range(100):
        start = time.perf_counter()
        matrix @ vector
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def warm_starts(pipeline, frames):
    """Median time, s, of a frame that starts from the last one, and of one from scratch."""
    grounded, found = np.arange(pipeline.layout.electrodes), []
    for kept in (True, False):
        run = Runner(pipeline.with_settings(pipeline.settings), grounded)
        for frame in frames:
            if not kept:
                run.pipeline.untare()  # forgets the last frame, too
            run(frame)
        found.append(float(np.median(run.times[1:])))
    return np.array(found)


def frame_times(side, resolution, frames=20, rounds=10):
    """Prints the time of a whole frame of each profile and of reading it: closed form, `side` x
    `side` electrodes."""
    layout = equal_grid(side, side, (0.2, 0.2), 0.02 / side, 1e4)
    pairs = pairs_at((0.05, 0.12), frames, np.random.default_rng(1), (10e3, 30e3))
    contacts = [
        Contact(**shape, start=float(i), end=i + 1.0)
        for i, pair in enumerate(pairs)
        for shape in pair
    ]
    scene = Scene("times", DRIVE, contacts, LAW, Noise(NOISE))
    simulator = Simulator(layout, scene, "closed_form")
    voltages = [simulator.frame(i + 0.5, i).astype(np.float32) for i in range(frames)]
    for profile in PROFILES:
        run = Runner(Pipeline(layout, Settings(profile, resolution=resolution)), simulator.grounded)
        for _ in range(rounds if profile == "fast" else 1):
            for frame in voltages:
                run(frame)
        median, p99 = 1e3 * np.percentile(run.times[frames // 2 :], [50, 99])
        print(f"{profile}: {median:.2f} ms a frame, p99 {p99:.2f} ms")
    meter = run.pipeline._model.local(simulator.grounded).meter
    reading = [timed(lambda frame=frame: meter.read(frame, DRIVE)) for frame in voltages * rounds]
    print(f"reading it, single precision: {1e3 * np.median(reading):.2f} ms")


def timed(work):
    """Time of `work`, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
