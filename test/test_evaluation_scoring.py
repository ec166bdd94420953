"""Scores of reported contacts: who is whose, ghosts, misses, and the OSPA distance."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pytest

from tomotactile_ros.evaluation.scoring import HEADER, cells, score, score_frame


@dataclass
class Found:
    x: float
    y: float
    force: float = 1.0


@dataclass
class Sure(Found):
    position_covariance: tuple = (1e-6, 0.0, 0.0, 1e-6)
    force_std: float = 0.1


@dataclass
class Reported:
    contacts: list
    state: str = "valid"


def true(x, y, force=1.0, **more):
    return {"x": x, "y": y, "force": force, **more}


def test_pairs_are_the_best_in_all_and_not_the_nearest_first():
    truth = [true(0.0, 0.0), true(0.006, 0.0)]
    found = score_frame([Found(0.004, 0.0, 2.0), Found(0.0105, 0.0, 0.5)], truth)
    assert sorted(found.place) == pytest.approx([0.004, 0.0045])
    assert sorted(found.force) == pytest.approx([0.5, 1.0])
    assert (found.ghosts, found.doubled, found.missed) == (0, 0, 0)


def test_far_ones_are_ghosts_and_leave_their_true_one_missed():
    found = score_frame([Found(0.0101, 0.0)], [true(0.0, 0.0)])
    assert (found.true, found.ghosts, found.missed, len(found.place)) == (1, 1, 1, 0)
    near = score_frame([Found(0.0099, 0.0)], [true(0.0, 0.0)])
    assert (near.ghosts, near.missed) == (0, 0) and near.place == pytest.approx(0.0099)


def test_a_second_contact_beside_a_paired_one_is_doubled_and_no_ghost():
    found = score_frame([Found(0.001, 0.0), Found(0.004, 0.0)], [true(0.0, 0.0)])
    assert (found.ghosts, found.doubled, found.missed) == (0, 1, 0)
    assert found.place == pytest.approx([0.001]) and found.ospa == pytest.approx(0.0055)


def test_what_is_too_weak_to_matter_is_neither_ghost_nor_pair():
    found = score_frame([Found(0.05, 0.0, 0.019), Found(0.0, 0.0, 1e-12)], [true(0.0, 0.0)])
    assert (found.weak, found.ghosts, found.missed, found.ospa) == (2, 0, 1, pytest.approx(0.01))
    assert score_frame([Found(0.05, 0.0, 0.02)], []).ghosts == 1
    light = [true(0.0, 0.0, 0.01)]
    assert (score_frame([], light).true, score_frame([], light).ospa) == (0, 0.0)
    assert score_frame([Found(0.001, 0.0, 0.02)], light).ghosts == 0


def test_what_is_there_for_a_part_of_the_frame_may_be_reported_or_not():
    truth = [true(0.0, 0.0, part=True)]
    silent = score_frame([], truth)
    assert (silent.true, silent.missed, silent.ospa) == (0, 0, 0.0)
    said = score_frame([Found(0.002, 0.0, 9.0)], truth)
    assert (said.ghosts, said.missed, len(said.force)) == (0, 0, 0)
    assert said.place == pytest.approx(0.002) and said.ospa == pytest.approx(0.002)


@pytest.mark.parametrize("order", [1, 2])
def test_ospa_is_the_least_over_all_assignments(order):
    """The definition, tried over all permutations (Schuhmacher et al. 2008, eq. 3)."""
    random = np.random.default_rng(order)
    for _ in range(60):
        m, n = random.integers(0, 5, 2)
        one, other = random.uniform(0, 0.025, (m, 2)), random.uniform(0, 0.025, (n, 2))
        found = score_frame([Found(*p) for p in one], [true(*p) for p in other], order=order)
        few, many = sorted((one, other), key=len)
        expected = 0.0
        if len(many):
            sums = [
                sum(min(np.linalg.norm(p - many[k]), 0.01) ** order for p, k in zip(few, chosen))
                for chosen in permutations(range(len(many)), len(few))
            ]
            rest = 0.01**order * (len(many) - len(few))
            expected = ((min(sums) + rest) / len(many)) ** (1 / order)
        assert found.ospa == pytest.approx(expected)
        assert found.missed == n - len(found.place)
        assert found.ghosts + found.doubled == m - len(found.place)


def test_many_frames_are_summed_and_withheld_ones_are_not_judged():
    results = [
        Reported([Found(0.001, 0.0, 1.1)]),
        Reported([Found(0.1, 0.0)], "withheld"),
        Reported([Found(0.05, 0.0), Found(0.0, 0.003, 0.8)]),
        Reported([]),
    ]
    found = score(results, [[true(0.0, 0.0)]] * 4)
    assert (found["frames"], found["withheld"]) == (3, 1)
    assert (found["true"], found["ghosts"], found["missed"]) == (3, 1, 1)
    assert found["false_frames"] == 2
    assert found["place"]["median"] == pytest.approx(0.002)
    assert found["place"]["worst"] == pytest.approx(0.003)
    assert found["force"]["median"] == pytest.approx(0.15)
    assert found["ospa"]["mean"] == pytest.approx((0.001 + 0.0065 + 0.01) / 3)
    assert found["coverage"] == {"place": None, "force": None}
    row = dict(zip(HEADER, cells(found)))
    assert row["frames"] == "3 + 1 withheld" and row["missed"] == "1 of 3"
    assert (row["ghosts"], row["doubled"], row["weak"]) == ("1", "0", "0")


def test_stated_uncertainties_cover_what_they_should():
    """Errors drawn from the stated covariance lie in the region of 95 % 95 times in 100."""
    random = np.random.default_rng(0)
    covariance = np.array([[4e-6, 1e-6], [1e-6, 1e-6]])
    errors = random.multivariate_normal([0, 0], covariance, 4000)
    forces = 1 + 0.1 * random.standard_normal(4000)
    results = [
        Reported([Sure(x, y, force, covariance.ravel())]) for (x, y), force in zip(errors, forces)
    ]
    found = score(results, [[true(0.0, 0.0)]] * 4000)["coverage"]
    assert found["place"] == pytest.approx(0.95, abs=0.015)
    assert found["force"] == pytest.approx(0.95, abs=0.015)
    smug = score([Reported([Sure(0.001, 0.0, 1.0, (0.0,) * 4)])], [[true(0.0, 0.0)]])
    assert smug["coverage"] == {"place": 0.0, "force": 1.0}
