"""Reported contacts against true ones in many frames: ghosts and misses beside places and forces.

In every frame reported contacts are paired with true ones so that the sum of min(distance, 10 mm) is
least; what is 10 mm apart or more is no pair. Then

weak      reported, but below 0.02 N: counted, and otherwise as if it had not been reported
ghost     reported, 10 mm or more from every true contact
doubled   reported, not paired, but within 10 mm of a true contact that has its pair
missed    true, without a pair
OSPA      the distance between the two sets, optimal sub-pattern assignment of order 1 with the
          cut-off c = 10 mm: (sum over pairs of distance + c (n - pairs)) / n, n the
          larger number of contacts. A frame with nothing on either side has 0, a frame with nothing
          on one side c: places, ghosts and misses in one figure. Schuhmacher, Vo and Vo: A
          consistent metric for performance evaluation of multi-object filters, IEEE Trans. Signal
          Process. 56(8), 2008, eq. 3.

A contact that is there for a part of a frame only, or with less than 0.02 N, may be reported or
not: it is never missed, and its force is not judged. A frame whose result is withheld is counted
and not judged.

Estimates that state their own uncertainty are held to it: the true place lies in the ellipse of 95
% of `position_covariance`, the true force within 1.96 `force_std`, 95 times in 100 where both are
right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

REACH = 0.010  # m, the cut-off
LEAST_FORCE = 0.02  # N, of what counts
PART = "part"  # key of a true contact that is there for a part of the frame
_ELLIPSE = 5.991  # 95 % of chi squared, two degrees of freedom
_INTERVAL = 1.960  # 95 % of a normal distribution, in standard deviations
_NONE = np.empty(0)
FIGURES: dict[str, Callable[..., Any]] = {
    "mean": np.mean,
    "median": partial(np.percentile, q=50),
    "p95": partial(np.percentile, q=95),
    "worst": np.max,
}


@dataclass(frozen=True, eq=False)
class FrameScore:
    """One frame.

    true : number of contacts that are there throughout; ghosts, doubled, missed, weak : numbers
    place : (n,) m, distance of each pair; force : (k,) relative error, of each with a known force
    ospa : m
    place_covered, force_covered : bool, of each pair whose estimate states an uncertainty
    """

    true: int
    ghosts: int
    doubled: int
    missed: int
    weak: int
    place: np.ndarray
    force: np.ndarray
    ospa: float
    place_covered: np.ndarray
    force_covered: np.ndarray


def score_frame(contacts: Sequence, truth: Sequence[dict], *, reach: float = REACH) -> FrameScore:
    """Score the contacts that were reported for one frame.

    Parameters
    ----------
    contacts : objects with x, y (m) and force (N); perhaps position_covariance (4,) (m²) and
        force_std (N).
    truth : x, y, force (None where it is not known) of each, as `Scene.truth` gives them;
        "part": True for what is there for a part of the frame only.
    reach : cut-off, m.
    """
    strong = [contact for contact in contacts if contact.force >= LEAST_FORCE]
    found = np.array([(c.x, c.y) for c in strong], float).reshape(-1, 2)
    true = np.array([(t["x"], t["y"]) for t in truth], float).reshape(-1, 2)
    distance = np.nan_to_num(np.linalg.norm(found[:, None] - true, axis=2), nan=np.inf)
    pairs = assign(distance, reach)
    alone = np.ones(len(strong), bool)
    alone[[i for i, _ in pairs]] = False
    far = (distance >= reach).all(axis=1)
    needed = {j for j, each in enumerate(truth) if _is_needed(each)}
    met = {j for _, j in pairs}
    place = np.array([distance[pair] for pair in pairs])
    kept = [(strong[i], truth[j]) for i, j in pairs]
    return FrameScore(
        true=len(needed),
        ghosts=int(np.count_nonzero(alone & far)),
        doubled=int(np.count_nonzero(alone & ~far)),
        missed=len(needed - met),
        weak=len(contacts) - len(strong),
        place=place,
        force=_force_errors(kept),
        ospa=_ospa(place, len(strong), len(met | needed), reach),
        place_covered=_places_covered(kept),
        force_covered=_forces_covered(kept),
    )


def assign(distance: np.ndarray, reach: float = REACH) -> list[tuple[int, int]]:
    """Pairs (row, column) with the least sum of min(distance, reach), those below `reach`."""
    pairs = zip(*linear_sum_assignment(np.minimum(distance, reach)), strict=True)
    return [(int(i), int(j)) for i, j in pairs if distance[i, j] < reach]


def score(results: Iterable, truths: Iterable[Sequence[dict]]) -> dict:
    """Score many frames.

    Parameters
    ----------
    results : with `contacts`, see `score_frame`; perhaps with `state`, judged where it is "valid".
    truths : of each frame, see `score_frame`.

    Returns
    -------
    As `summary`.
    """
    scores, withheld = [], 0
    for result, truth in zip(results, truths, strict=True):
        if getattr(result, "state", "valid") == "valid":
            scores.append(score_frame(result.contacts, truth))
        else:
            withheld += 1
    return summary(scores, withheld)


def summary(scores: Sequence[FrameScore], withheld: int = 0) -> dict:
    """Figures of many frames as plain data; lengths in m, errors of force in parts; None of
    nothing.

    frames, withheld            number judged, and not judged
    true, ghosts, doubled, missed, weak  numbers in all frames
    false_frames                frames with ghosts, doubled or missed contacts
    place, force                median, p95 and worst of the pairs
    ospa                        mean and p95 of the frames
    coverage                    parts of places and forces in their stated 95 % regions
    """
    totals = {
        key: sum(getattr(each, key) for each in scores)
        for key in ("true", "ghosts", "doubled", "missed", "weak")
    }
    return {
        "frames": len(scores),
        "withheld": withheld,
        **totals,
        "false_frames": sum(bool(s.ghosts or s.doubled or s.missed) for s in scores),
        "place": _of_pairs([each.place for each in scores]),
        "force": _of_pairs([each.force for each in scores]),
        "ospa": figures([each.ospa for each in scores]),
        "coverage": {
            "place": _part([each.place_covered for each in scores]),
            "force": _part([each.force_covered for each in scores]),
        },
    }


def _is_needed(true):
    """Whether a true contact is missed where it is not reported."""
    return not true.get(PART) and (true["force"] is None or true["force"] >= LEAST_FORCE)


def _ospa(place, reported, there, reach):
    larger = max(reported, there)
    return float(place.sum() + reach * (larger - len(place))) / larger if larger else 0.0


def _force_errors(pairs):
    known = [
        (contact.force, true["force"])
        for contact, true in pairs
        if true["force"] is not None and _is_needed(true)
    ]
    return np.array([abs(found - force) / force for found, force in known])


def _places_covered(pairs):
    """Whether the true place lies in the stated ellipse; one without area covers nothing."""
    out = []
    for contact, true in pairs:
        covariance = getattr(contact, "position_covariance", None)
        if covariance is None:
            continue
        matrix = np.reshape(np.asarray(covariance, float), (2, 2))
        off = np.array([contact.x - true["x"], contact.y - true["y"]])
        inside = False
        if np.isfinite(matrix).all() and np.linalg.det(matrix) > 0 and np.trace(matrix) > 0:
            inside = off @ np.linalg.solve(matrix, off) <= _ELLIPSE
        out.append(bool(inside))
    return np.array(out, bool)


def _forces_covered(pairs):
    out = []
    for contact, true in pairs:
        deviation = getattr(contact, "force_std", None)
        if deviation is not None and true["force"] is not None and _is_needed(true):
            out.append(abs(contact.force - true["force"]) <= _INTERVAL * deviation)
    return np.array(out, bool)


def figures(values, names: Sequence[str] = ("mean", "p95")) -> dict[str, float | None]:
    """`FIGURES` of values by their names; None of no values."""
    return {name: float(FIGURES[name](values)) if len(values) else None for name in names}


def _of_pairs(parts):
    return figures(np.concatenate([_NONE, *parts]), ("median", "p95", "worst"))


def _part(parts):
    values = np.concatenate([_NONE, *parts])
    return float(values.mean()) if len(values) else None
