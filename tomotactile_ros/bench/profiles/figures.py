"""Figures of one profile: of its images, of its contacts, ghosts and misses, of noise and wide
shapes."""

from __future__ import annotations

import time

import numpy as np

from tomotactile_ros.bench.profiles.data import APART
from tomotactile_ros.bench.trials import DRIVE, NOISE
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.scoring import assign, score
from tomotactile_ros.scenes.contact import Contact


class Runner:
    """Processes frames and keeps the time each took."""

    def __init__(self, pipeline, grounded):
        self.pipeline, self.grounded, self.times = pipeline, grounded, []

    def __call__(self, frame):
        start = time.perf_counter()
        result = self.pipeline.process(frame, self.grounded, DRIVE)
        self.times.append(time.perf_counter() - start)
        return result


def figures(pipeline, data):
    """Figures of one profile on the frames of `data.collect`."""
    run = Runner(pipeline, np.arange(pipeline.layout.electrodes))
    for frame in data["singles"][1][:5]:
        run(frame)
    run.times.clear()
    out = _single_contacts(run, pipeline, *data["singles"])
    told = {}
    for distance in APART:
        groups, frames = data[distance]
        good = []
        for group, frame in zip(groups, frames):
            contacts = run(frame).contacts
            good.append(len(contacts) == 2 and (matched(contacts, group)[0] < distance / 2).all())
        told[distance] = np.mean(good)
    out["told apart at, mm"] = 1e3 * least_distance(told)
    out["pairs told apart"] = {f"{1e3 * d:.0f} mm": round(float(v), 3) for d, v in told.items()}
    groups, frames = data["two"]
    results = [run(frame) for frame in frames]
    errors = [matched(result.contacts, group)[1] for result, group in zip(results, groups)]
    out["force error two, %"] = 100 * np.mean(errors)
    out |= _false_ones("two", results, groups)
    out["time median, ms"] = 1e3 * np.median(run.times)
    out["time p99, ms"] = 1e3 * np.percentile(run.times, 99)
    out["noise gain"] = noise_gain(pipeline, data["repeats"][1])
    for name, (group, frame) in data["shapes"].items():
        image = run(frame).potential
        found = image >= 0.5 * np.nanmax(image)
        true = covered(group[0], pipeline.grid)
        out[f"IoU {name}"] = np.count_nonzero(found & true) / np.count_nonzero(found | true)
    return out


def _single_contacts(run, pipeline, groups, frames):
    results = [run(frame) for frame in frames]
    positions = np.array([group[0]["center"] for group in groups])
    images = np.array([pipeline.grid.gather(result.potential) for result in results])
    sharp = quality(images, positions, pipeline.grid)
    side = max(pipeline.layout.outline.size)
    near = [matched(result.contacts, group) for result, group in zip(results, groups)]
    first = np.array([d[0] for d, _ in near])
    return {
        "HWHM mean, %": 100 * sharp.hwhm.mean() / side,
        "PE mean, mm": 1e3 * sharp.position_error.mean(),
        "PE p95, mm": 1e3 * np.percentile(sharp.position_error, 95),
        "contact error mean, mm": 1e3 * first.mean(),
        "contact error p95, mm": 1e3 * np.percentile(first, 95),
        **_false_ones("one", results, groups),
        "one contact found, %": 100 * np.mean([len(result.contacts) == 1 for result in results]),
        "force error one, %": 100 * np.mean([e[0] for _, e in near]),
        "lambda, median": float(np.median([result.regularization for result in results])),
    }


def _false_ones(words, results, groups):
    """Ghosts and doubled contacts, and missed ones, in all frames."""
    found = score(results, [[_truth(shape) for shape in group] for group in groups])
    return {
        f"ghosts {words}": found["ghosts"] + found["doubled"],
        f"missed {words}": found["missed"],
    }


def _truth(shape):
    """Of a disc."""
    x, y = shape["center"]
    return {"x": x, "y": y, "force": shape["pressure"] * np.pi * shape["radius"] ** 2}


def matched(contacts, group):
    """(n,) distances, m, and relative force errors of the contacts that belong to the true ones, by
    the least sum of distances; infinite and 1 for one that is missed."""
    true = [_truth(shape) for shape in group]
    distances, errors = np.full(len(true), np.inf), np.ones(len(true))
    places = np.array([(t["x"], t["y"]) for t in true])
    found = np.array([(c.x, c.y) for c in contacts]).reshape(-1, 2)
    apart = np.linalg.norm(found[:, None] - places, axis=2)
    for i, j in assign(apart, np.inf):
        distances[j] = apart[i, j]
        errors[j] = abs(contacts[i].force - true[j]["force"]) / true[j]["force"]
    return distances, errors


def least_distance(told):
    """The smallest distance from which 9 of 10 pairs are told apart; nan if there is none."""
    best = np.nan
    for distance in sorted(told, reverse=True):
        if told[distance] < 0.9:
            break
        best = distance
    return best


def noise_gain(pipeline, frames):
    """Standard deviation of the image over its maximum, in parts of noise / drive voltage."""
    run = Runner(pipeline, np.arange(pipeline.layout.electrodes))
    images = np.array([pipeline.grid.gather(run(frame).potential) for frame in frames])
    spread = np.sqrt(images.var(axis=0).mean())
    return float(spread / images.mean(axis=0).max() / (NOISE / DRIVE))


def covered(shape, grid):
    """(H, W) cells whose centre the contact covers."""
    from shapely import Polygon, contains_xy

    polygon = Polygon(Contact(**shape).vertices)
    return contains_xy(polygon, *grid.centres.T).reshape(grid.shape)


def idle_alarms(pipeline, count, seed=1):
    """Contacts reported on `count` frames of noise alone, and the median time of one, s."""
    random = np.random.default_rng(seed)
    electrodes = pipeline.layout.electrodes
    run, alarms = Runner(pipeline, np.arange(electrodes)), 0
    step = DRIVE / 4096
    for _ in range(count):
        noise = NOISE * random.standard_normal((electrodes, electrodes))
        frame = np.clip(np.round(noise / step), 0, 4095) * step
        np.fill_diagonal(frame, np.nan)
        alarms += bool(run(frame).contacts)
    return alarms, float(np.median(run.times)) if count else 0.0
