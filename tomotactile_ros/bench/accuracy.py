"""How good the results of a pipeline are on recorded frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from types import SimpleNamespace

import numpy as np

from tomotactile_ros.bench.trials import DRIVE, Recording, Trials
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.scoring import REACH, score
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.contacts_in_image import Blob, find_blobs
from tomotactile_ros.view.contact_lines import pair

SENSORS = "textbook", "worn"
_MOST = 0.8  # of all pairs that must be told apart


def measure(pipeline: Pipeline, trials: Trials) -> dict:
    """Figures of merit; lengths in m.

    hwhm, position_error  of the image of one contact, as in Kojima et al. 2023
    blur                  of the same image, see evaluation/metrics.py
    scores                ghosts, missed contacts and more of `one` contact and of `two`, on each
                          of `SENSORS`, see `evaluation.scoring`
    ospa                  on each of `SENSORS`, see `ospa`
    contact_error         distance of the strongest reported contact from the true one
    worn                  position and contact error on the worn sensor
    two_contacts          smallest distance from which on 80 % of the pairs are told apart, None if
                          none
    force_error           |found - true| / true of one contact and of two, missed ones count as 1
    """
    singles = process(pipeline, trials.singles)
    pairs = process(pipeline, trials.pairs)
    worn = process(pipeline, trials.worn)
    worn_pairs = process(pipeline, trials.worn_pairs)
    resolved = told_apart(pairs, trials.pairs.positions)
    disturbed = merit(images(pipeline, worn), trials.worn, pipeline.grid)
    scores = {
        "textbook": {"one": _score(singles, trials.singles), "two": _score(pairs, trials.pairs)},
        "worn": {"one": _score(worn, trials.worn), "two": _score(worn_pairs, trials.worn_pairs)},
    }
    return merit(images(pipeline, singles), trials.singles, pipeline.grid) | {
        "contact_error": spread(distances(singles, trials.singles.positions)),
        "worn": {
            "position_error": disturbed["position_error"],
            "contact_error": spread(distances(worn, trials.worn.positions)),
        },
        "two_contacts": _distance(resolved, trials.separations),
        "force_error": {
            "one": spread(_force_error(singles, trials.singles)),
            "two": spread(_force_error(pairs, trials.pairs)[np.repeat(resolved, 2)]),
        },
        "scores": scores,
        "ospa": {sensor: ospa(each.values()) for sensor, each in scores.items()},
    }


def process(pipeline: Pipeline, recording: Recording) -> list:
    """Results of all frames."""
    everything = np.arange(pipeline.layout.electrodes)
    return [pipeline.process(frame, everything, DRIVE) for frame in recording.frames]


def images(pipeline: Pipeline, results: list) -> np.ndarray:
    """(N, K) potential of the pixels inside the outline, V."""
    return np.array([pipeline.grid.gather(result.potential) for result in results])


def merit(images: np.ndarray, recording: Recording, grid: Grid) -> dict:
    """`hwhm`, `position_error` and `blur` of `images` (N, K) of single contacts, m."""
    found = quality(images, np.concatenate(recording.positions), grid)
    return {key: spread(getattr(found, key)) for key in ("hwhm", "position_error", "blur")}


def spread(values) -> dict:
    """Mean, median and 95th percentile; None of no values."""
    values = np.asarray(values, float)
    if not len(values):
        return {"mean": None, "median": None, "p95": None}
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
    }


def ospa(scores: Iterable[dict]) -> float:
    """m, the mean of the frames of several summaries (`evaluation.scoring`): places, ghosts and
    missed contacts in one figure.

    A frame that is withheld says as little as one in which nothing is found, and counts as much.
    """
    total = number = 0.0
    for each in scores:
        total += (each["ospa"]["mean"] or 0.0) * each["frames"] + REACH * each["withheld"]
        number += each["frames"] + each["withheld"]
    return float(total / number)


def image_scores(found: np.ndarray, recording: Recording, grid: Grid) -> dict:
    """`evaluation.scoring.summary` of the peaks of images (N, K), for methods that end there; no
    forces."""
    results = [_Peaks(find_blobs(grid.fill(image, 0.0), grid)) for image in found]
    truths = [[{"x": x, "y": y, "force": None} for x, y in each] for each in recording.positions]
    return score(results, truths)


class _Peaks:
    """Blobs as contacts that all count."""

    def __init__(self, blobs: list[Blob]):
        self.contacts = [
            SimpleNamespace(x=each.position[0], y=each.position[1], force=np.inf) for each in blobs
        ]


def _score(results, recording):
    truths = [
        [{"x": x, "y": y, "force": force} for (x, y), force in zip(places, forces, strict=True)]
        for places, forces in zip(recording.positions, recording.forces, strict=True)
    ]
    return score(results, truths)


def distances(results: Sequence, positions: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) m, from the strongest reported contact to the true one at `positions` (N of (1, 2));
    as far as the middle of the sheet where nothing was reported."""
    out = []
    for result, true in zip(results, positions, strict=True):
        found = [(c.x, c.y) for c in result.contacts[:1]] or [(0.0, 0.0)]
        out.append(np.linalg.norm(np.subtract(found[0], true[0])))
    return np.array(out)


def force_errors(results: Sequence, forces: Sequence[float]) -> np.ndarray:
    """(N,) |found - true| / true of the strongest reported contact, where one of `forces` (N,), N,
    presses; 1 where nothing was reported."""
    found = [result.contacts[0].force if result.contacts else 0.0 for result in results]
    true = np.array(forces, float)
    return np.abs(np.array(found) - true) / true


def _matches(result, true):
    """For each true contact (n, 2) the reported one, None where there is none."""
    partner = pair(result.contacts, [{"x": x, "y": y} for x, y in true])
    found = {j: contact for j, contact in zip(partner, result.contacts) if j is not None}
    return [found.get(j) for j in range(len(true))]


def _force_error(results, recording):
    """(sum n,) relative error of every true contact's force."""
    out = []
    for result, true, forces in zip(results, recording.positions, recording.forces, strict=True):
        for contact, force in zip(_matches(result, true), forces, strict=True):
            out.append(1.0 if contact is None else abs(contact.force / force - 1))
    return np.array(out)


def told_apart(results: Sequence, positions: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) bool: exactly two contacts, each nearer to its true place of `positions` (N of (2, 2))
    than to the middle."""
    out = []
    for result, true in zip(results, positions, strict=True):
        limit = np.linalg.norm(true[0] - true[1]) / 2
        near = [
            contact is not None and np.hypot(contact.x - x, contact.y - y) < limit
            for contact, (x, y) in zip(_matches(result, true), true, strict=True)
        ]
        out.append(len(result.contacts) == 2 and all(near))
    return np.array(out)


def _distance(resolved, separations):
    rate = resolved.reshape(len(separations), -1).mean(axis=1)
    enough = np.minimum.accumulate((rate >= _MOST)[::-1])[::-1]
    return float(separations[enough][0]) if enough.any() else None
