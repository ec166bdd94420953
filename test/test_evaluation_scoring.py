"""Scores of reported contacts: who is whose, ghosts, misses, and the OSPA distance."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pytest

from tomotactile_ros.bench import tables
from tomotactile_ros.evaluation.scoring import score, score_frame


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


ONE, HALF = [true(0.0, 0.0)], [true(0.0, 0.0, part=True)]


@pytest.mark.parametrize(
    "reported, truth, expected, places",
    [
        # the best pairs in all, and not the nearest first
        ([(0.004, 0.0, 2.0), (0.0105, 0.0, 0.5)], [*ONE, true(0.006, 0.0)],
         {"true": 2, "force": [0.5, 1.0]}, [0.004, 0.0045]),
        ([(0.0101, 0.0)], ONE, {"true": 1, "ghosts": 1, "missed": 1}, []),
        ([(0.0099, 0.0)], ONE, {"true": 1}, [0.0099]),
        ([(0.001, 0.0), (0.004, 0.0)], ONE, {"true": 1, "doubled": 1, "ospa": 0.0055}, [0.001]),
        ([(0.05, 0.0, 0.019), (0.0, 0.0, 1e-12)], ONE,
         {"true": 1, "weak": 2, "missed": 1, "ospa": 0.01}, []),
        ([(0.05, 0.0, 0.02)], [], {"ghosts": 1}, []),
        ([], [true(0.0, 0.0, 0.01)], {"ospa": 0.0}, []),
        ([(0.001, 0.0, 0.02)], [true(0.0, 0.0, 0.01)], {}, None),
        # there for a part of the frame: it may be reported or not
        ([], HALF, {"ospa": 0.0}, []),
        ([(0.002, 0.0, 9.0)], HALF, {"force": [], "ospa": 0.002}, [0.002]),
    ],
)  # fmt: skip
def test_who_is_whose(reported, truth, expected, places):
    found = score_frame([Found(*each) for each in reported], truth)
    counts = dict.fromkeys(("true", "ghosts", "doubled", "weak", "missed"), 0)
    for name, value in (counts | expected).items():
        got = getattr(found, name)
        assert (sorted(got) if name == "force" else got) == pytest.approx(value), name
    assert places is None or sorted(found.place) == pytest.approx(places)


def test_ospa_is_the_least_over_all_assignments():
    """The definition, tried over all permutations (Schuhmacher et al. 2008, eq. 3)."""
    random = np.random.default_rng(1)
    for _ in range(60):
        m, n = random.integers(0, 5, 2)
        one, other = random.uniform(0, 0.025, (m, 2)), random.uniform(0, 0.025, (n, 2))
        found = score_frame([Found(*p) for p in one], [true(*p) for p in other])
        few, many = sorted((one, other), key=len)
        expected = 0.0
        if len(many):
            sums = [
                sum(min(np.linalg.norm(p - many[k]), 0.01) for p, k in zip(few, chosen))
                for chosen in permutations(range(len(many)), len(few))
            ]
            rest = 0.01 * (len(many) - len(few))
            expected = (min(sums) + rest) / len(many)
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
    row = dict(zip(tables.titles(tables.SCORES), tables.cells(tables.SCORES, found)))
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
