"""Reciprocity of four-terminal recordings, on impedances that are known."""

from itertools import permutations

import numpy as np
import pytest

from tomotactile_ros.bench.four_terminal import Recording, contradiction, from_differences

PAIRS = [((a, b), (c, d)) for a, b, c, d in permutations(range(6), 4)]


def impedance(count):
    """(E, E) transfer impedances of some conductor, ohm."""
    random = np.random.default_rng(4)
    conductance = np.abs(random.standard_normal((count, count)))
    conductance = conductance + conductance.T
    return np.linalg.pinv(np.diag(conductance.sum(axis=1)) - conductance)


def reading(z, carries, read):
    return (
        z[carries[0], read[0]]
        - z[carries[0], read[1]]
        - z[carries[1], read[0]]
        + z[carries[1], read[1]]
    )


def recording(factor=lambda pair: 1.0, drift=0.0):
    z = impedance(6)
    one = np.array([abs(reading(z, p, q)) * factor(frozenset(p)) for p, q in PAIRS])
    return Recording("known", PAIRS, one * (1 + drift * np.linspace(0, 1, 40))[:, None])


def test_a_conductor_contradicts_nothing_and_drift_of_all_is_no_contradiction():
    found = contradiction(recording(drift=0.1))
    assert found["equations"] > 100 and found["rms"] < 1e-12
    assert found["drift"] == pytest.approx(np.log(1.095 / 1.005), abs=0.005)
    assert found["contradiction drift"] < 1e-12


def test_factors_of_pairs_are_found_and_those_of_single_readings_are_not():
    random = np.random.default_rng(0)
    factors = {frozenset(p): np.exp(0.1 * random.standard_normal()) for p, _ in PAIRS}
    found = contradiction(recording(factors.__getitem__))
    assert 0.05 < found["rms"] < 0.3 and found["left"] < 1e-9
    found = contradiction(recording(lambda pair: np.exp(0.1 * random.standard_normal())))
    assert found["left"] > 0.8 * found["rms"]


def test_differences_between_neighbours_give_the_same():
    z = impedance(5)
    patterns = [(0, 1), (2, 3), (3, 4), (1, 2), (0, 4), (0, 1)]
    currents = np.zeros((5, len(patterns)))
    for k, (source, sink) in enumerate(patterns):
        currents[[source, sink], k] = 0.5 + k, -0.5 - k
    sensed = np.eye(5)[:, :-1] - np.eye(5)[:, 1:]
    found = from_differences("known", currents, sensed, sensed.T @ z @ currents)
    wanted = [reading(z, p, q) for p, q in found.pairs]
    assert len(wanted) == 10 and found.values[0] == pytest.approx(wanted)
