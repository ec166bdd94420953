"""Reciprocity of recordings of other hardware: four-terminal measurements of electrical impedance
tomography, in which one pair of electrodes carries a current and another pair is read.

What reads pair q while pair p carries a current, and the same with p and q exchanged, is one and the
same transfer impedance (Geselowitz 1971). The logarithm of the ratio of the two is 0 but for the
electronics. Where these are a factor for each pair that carries the current,

    ln (v_pq / v_qp) = s_p - s_q

by least squares. What such factors are worth is judged by equations that they were not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

_PARTS = 5  # in each of which the equations are left out in turn
_WEAK = 0.5  # of the median reading: below, readings are left out
_TIMES = 10  # parts of a recording, whose first and last tell drift

Pair = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Recording:
    """Readings `values` (F, n), each of a pair of electrodes that is read while another one carries
    the current: `pairs`, n of (carries, is read). A pair is a pair whichever its direction."""

    name: str
    pairs: Sequence[tuple[Pair, Pair]]
    values: np.ndarray


def contradiction(recording: Recording) -> dict[str, float]:
    """How far a recording contradicts reciprocity; all figures are logarithms of ratios.

    Returns equations; median and rms of their absolute values; `left`, the rms with a factor for each
    pair that carries the current, of equations not fitted to; and, where there are frames enough,
    `drift` of readings and `contradiction drift` of the equations from the first tenth of the frames
    to the last, rms.
    """
    first, second, carries = _equations(recording)
    mean = recording.values.mean(axis=0)
    asked = _logarithm(mean, first, second)
    found = {
        "equations": len(asked),
        "median": float(np.median(np.abs(asked))),
        "rms": _rms(asked),
        "left": _rms(_left(asked, carries)),
    }
    count = len(recording.values) // _TIMES
    if count:
        begin, end = (
            recording.values[part].mean(axis=0) for part in (slice(count), slice(-count, None))
        )
        used = np.union1d(first, second)
        found["drift"] = _rms(np.log(end[used] / begin[used]))
        change = _logarithm(end, first, second) - _logarithm(begin, first, second)
        found["contradiction drift"] = _rms(change)
    return found


def _equations(recording):
    """Readings (m,) and (m,) that are one transfer impedance, and the numbers (m, 2) of the pairs that
    carry the current in them."""
    mean = np.abs(recording.values.mean(axis=0))
    strong = mean > _WEAK * np.median(mean)
    groups: dict[frozenset, dict[frozenset, list[int]]] = {}
    for number in np.flatnonzero(strong):
        carries, read = map(frozenset, recording.pairs[number])
        groups.setdefault(frozenset((carries, read)), {}).setdefault(carries, []).append(number)
    numbers = {
        pair: i
        for i, pair in enumerate(sorted({frozenset(p) for p, _ in recording.pairs}, key=sorted))
    }
    out = []
    for group in groups.values():
        if len(group) == 2:
            (p, some), (q, others) = group.items()
            out += [(i, j, numbers[p], numbers[q]) for i in some for j in others]
    table = np.array(out, int).reshape(-1, 4)
    return table[:, 0], table[:, 1], table[:, 2:]


def _logarithm(values, first, second):
    return np.log(np.abs(values[first]) / np.abs(values[second]))


def _left(asked, carries):
    """(m,) what is left of the equations when the others tell the factors."""
    design = np.zeros((len(asked), carries.max() + 1))
    every = np.arange(len(asked))
    design[every, carries[:, 0]] = 1.0
    design[every, carries[:, 1]] -= 1.0
    left = np.empty(len(asked))
    part = np.random.default_rng(0).integers(0, _PARTS, len(asked))
    for out in range(_PARTS):
        factors = np.linalg.lstsq(design[part != out], asked[part != out], rcond=None)[0]
        left[part == out] = asked[part == out] - design[part == out] @ factors
    return left


def from_differences(
    name: str, currents: np.ndarray, sensed: np.ndarray, volts: np.ndarray
) -> Recording:
    """A recording of which all differences between neighbours were read: `currents` (E, K) A of K
    patterns of two electrodes each, `sensed` (E, E - 1) which difference is read, `volts` (E - 1, K).

    Potentials follow from the differences, and so does each pair's reading. A pattern that was taken
    more than once counts once.
    """
    potentials = np.linalg.lstsq(sensed.T.astype(float), volts, rcond=None)[0]
    patterns: dict[tuple[int, ...], int] = {}
    for k in range(currents.shape[1]):
        patterns.setdefault(tuple(np.flatnonzero(currents[:, k]).tolist()), k)
    pairs, values = [], []
    for p, q in combinations(patterns, 2):
        if set(p).isdisjoint(q):
            for carries, read in ((p, q), (q, p)):
                k = patterns[carries]
                drop = potentials[read[0], k] - potentials[read[1], k]
                pairs.append((carries, read))
                values.append(drop / currents[carries[0], k])
    return Recording(name, pairs, np.array(values)[None])


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))
