"""The first look at frames of finite elements: points where contacts are, and none where no points are."""

import numpy as np
import pytest
from test_estimation_search import DRIVE, LAYOUTS, NOISE, search, simulate

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.prior import Prior

RADIUS = 0.005
NEAR = 0.08  # spacings: contacts of 4 to 6 mm are no points


def look(name, discs, noise=NOISE, **wrong):
    operator = search(name).operator
    readings = simulate(name, discs, noise, **wrong) / DRIVE
    weights = np.full(readings.shape, (DRIVE / noise) ** 2)
    np.fill_diagonal(weights, 0.0)
    rows = Rows(np.nan_to_num(readings), weights, np.arange(operator.count))
    prior = Prior.unknown(operator, ChannelPrior(), RADIUS, DRIVE)
    return search(name).detector.first_look(rows, *prior.deviations[:2])


def apart(layout, count, seed):
    """Places (count, 2) of contacts off electrodes and the rim, a spacing or more from each other."""
    random, pitch = np.random.default_rng(seed), float(np.median(layout.pitches))
    found = []
    while len(found) < count:
        place = random.uniform(-0.45, 0.45, 2) * layout.outline.size
        clear = np.hypot(*(layout.positions - place).T).min() > layout.radius + 1.5 * RADIUS
        inside = layout.outline.depth(place[None])[0][0] > 2 * RADIUS
        if clear and inside and all(np.hypot(*(place - f)) > 1.1 * pitch for f in found):
            found.append(place)
    return np.array(found)


@pytest.mark.parametrize("name", ["4x4", "8x8", "ring"])
@pytest.mark.parametrize("count", [1, 2])
def test_points_are_where_small_contacts_are(name, count):
    layout = LAYOUTS[name]()
    pitch = float(np.median(layout.pitches))
    for seed in range(2):
        places = apart(layout, count, seed)
        if name == "ring":
            places = 0.5 * places  # amid a ring nothing tells contacts from each other
        if name == "ring" and count == 2:
            continue
        discs = [(x, y, RADIUS, 1e4) for x, y in places]
        points = look(name, discs).points(RADIUS)
        assert points is not None and len(points) == count
        found = np.array([place for place, _ in points])
        nearest = np.hypot(*(found[:, None] - places).transpose(2, 0, 1)).min(axis=0)
        assert nearest.max() < NEAR * pitch


def test_of_a_conductor_on_an_electrode_no_points_are_picked_that_conduct_nothing():
    """64 were, in a second: what a conductor lets flow, small contacts do not explain."""
    x, y = LAYOUTS["8x8"]().positions[36]
    places, strengths, _ = look("8x8", [(x, y, RADIUS, 1e11)])._points(RADIUS)
    assert 0 < len(places) < 10 and strengths.max() > 0


def test_slopes_of_shares_are_their_derivatives():
    operator = search("8x8").operator
    places, step = np.array([[0.013, 0.007], [-0.051, 0.09]]), 1e-6
    _, slopes = operator.shares(places, RADIUS)
    for axis in range(2):
        way = step * np.eye(2)[axis]
        plus, minus = (operator.shares(places + sign * way, RADIUS)[0] for sign in (1, -1))
        assert np.allclose(slopes[axis], (plus - minus) / (2 * step), rtol=1e-3, atol=1e-3)
