"""How good the results of a pipeline are on recorded frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from types import SimpleNamespace

import numpy as np

from tomotactile_ros.bench.trials import DRIVE, Recording, Trials
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.scoring import REACH, figures, score
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.contacts_in_image import find_blobs
from tomotactile_ros.view.contact_lines import pair

SENSORS = "textbook", "worn"
Truths = Sequence[Sequence[dict]]  # of each frame x, y, m, and force, N, of all true contacts
_MOST = 0.8  # of all pairs that must be told apart


def measure(pipeline: Pipeline, trials: Trials) -> dict:
    """Figures of merit; lengths in m.

    hwhm, position_error  of the image of one contact, as in Kojima et al. 2023
    blur                  of the same image, see evaluation/metrics.py
    scores                ghosts, missed contacts and more of `one` contact and of `two`, on each
                          of `SENSORS`, see `evaluation.scoring`
    ospa                  on each of `SENSORS`, see `ospa`
    contact_error         distance of the strongest reported contact from the true one
    worn                  contact error on the worn sensor
    two_contacts          smallest distance from which on 80 % of the pairs are told apart, None if
                          none
    force_error           |found - true| / true of one contact and of two, missed ones count as 1
    """
    found = {
        sensor: [(process(pipeline, each), each.truths) for each in trials.of[sensor]]
        for sensor in SENSORS
    }
    one, two = found["textbook"]
    resolved = told_apart(*two)
    scores = {
        sensor: {name: score(*each) for name, each in zip(("one", "two"), both, strict=True)}
        for sensor, both in found.items()
    }
    images = np.array([pipeline.grid.gather(result.potential) for result in one[0]])
    return merit(images, one[1], pipeline.grid) | {
        "contact_error": figures(distances(*one)),
        "worn": {"contact_error": figures(distances(*found["worn"][0]))},
        "two_contacts": _distance(resolved, trials.separations),
        "force_error": {
            "one": figures(_all_force_errors(*one)),
            "two": figures(_all_force_errors(*two)[np.repeat(resolved, 2)]),
        },
        "scores": scores,
        "ospa": {sensor: ospa(each.values()) for sensor, each in scores.items()},
    }


def process(pipeline: Pipeline, recording: Recording) -> list:
    """Results of all frames."""
    everything = np.arange(pipeline.layout.electrodes)
    return [pipeline.process(frame, everything, DRIVE) for frame in recording.frames]


def merit(images: np.ndarray, truths: Truths, grid: Grid) -> dict:
    """`hwhm`, `position_error` and `blur` of `images` (N, K) of single contacts, m."""
    found = quality(images, [(true["x"], true["y"]) for (true,) in truths], grid)
    return {key: figures(getattr(found, key)) for key in ("hwhm", "position_error", "blur")}


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


def image_scores(found: np.ndarray, truths: Truths, grid: Grid) -> dict:
    """`evaluation.scoring.summary` of the peaks of images (N, K), for methods that end there; no
    forces, and all peaks count."""
    results = []
    for image in found:
        peaks = [each.position for each in find_blobs(grid.fill(image, 0.0), grid)]
        contacts = [SimpleNamespace(x=x, y=y, force=np.inf) for x, y in peaks]
        results.append(SimpleNamespace(contacts=contacts))
    return score(results, [[true | {"force": None} for true in each] for each in truths])


def distances(results: Sequence, truths: Truths) -> np.ndarray:
    """(N,) m, from the strongest reported contact to the only true one; as far as the middle of the
    sheet where nothing was reported."""
    out = []
    for result, (true,) in zip(results, truths, strict=True):
        (found,) = [(c.x, c.y) for c in result.contacts[:1]] or [(0.0, 0.0)]
        out.append(np.linalg.norm(np.subtract(found, (true["x"], true["y"]))))
    return np.array(out)


def force_errors(results: Sequence, truths: Truths) -> np.ndarray:
    """(N,) |found - true| / true of the strongest reported contact, where one presses; 1 where
    nothing was reported."""
    found = [result.contacts[0].force if result.contacts else 0.0 for result in results]
    return np.array(
        [abs(each - true["force"]) / true["force"] for each, (true,) in zip(found, truths)]
    )


def _matches(result, truth):
    """For each true contact the reported one, None where there is none."""
    found = {j: contact for j, contact in zip(pair(result.contacts, truth), result.contacts)}
    return [found.get(j) for j in range(len(truth))]


def _all_force_errors(results, truths):
    """(sum n,) relative error of every true contact's force."""
    return np.array(
        [
            1.0 if contact is None else abs(contact.force / true["force"] - 1)
            for result, truth in zip(results, truths, strict=True)
            for contact, true in zip(_matches(result, truth), truth, strict=True)
        ]
    )


def told_apart(results: Sequence, truths: Truths) -> np.ndarray:
    """(N,) bool: exactly two contacts, each nearer to its true one, of two, than to the middle."""
    out = []
    for result, (one, other) in zip(results, truths, strict=True):
        limit = np.hypot(one["x"] - other["x"], one["y"] - other["y"]) / 2
        near = [
            contact is not None and np.hypot(contact.x - true["x"], contact.y - true["y"]) < limit
            for contact, true in zip(_matches(result, (one, other)), (one, other), strict=True)
        ]
        out.append(len(result.contacts) == 2 and all(near))
    return np.array(out)


def _distance(resolved, separations):
    rate = resolved.reshape(len(separations), -1).mean(axis=1)
    enough = np.minimum.accumulate((rate >= _MOST)[::-1])[::-1]
    return float(separations[enough][0]) if enough.any() else None
