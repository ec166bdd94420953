"""Charges induced on electrodes close by: against the circle theorem, and derivatives against differences."""

import numpy as np
import pytest

from tomotactile_ros.estimation.induced import CLOSE, InducedCharges
from tomotactile_ros.layouts.layout import load_layout

RESISTANCE = 1e4


def charges(name):
    layout = load_layout(name)
    pitch = float(np.median(layout.pitches))
    return InducedCharges(layout.positions, layout.radius, pitch, RESISTANCE)


def places_near(electrodes, count=60, seed=3):
    """(P, 2) m, off electrodes, some near rims, some amid them."""
    random = np.random.default_rng(seed)
    centres = electrodes.centres[random.integers(len(electrodes.centres), size=count)]
    angle, distance = random.uniform(0, 2 * np.pi, count), random.uniform(1.05, 12.0, count)
    way = np.stack([np.cos(angle), np.sin(angle)], -1) * (distance * electrodes.radius)[:, None]
    places = centres + way
    apart = np.hypot(*(places[:, None] - electrodes.centres).transpose(2, 0, 1)).min(axis=1)
    return places[apart > 1.05 * electrodes.radius]


def by_circle_theorem(electrodes, places):
    """(P, P) ohm: +1 in the centre, -1 in the inverse point, of each electrode by itself."""
    out = np.zeros((len(places), len(places)))
    for centre in electrodes.centres:
        apart = places - centre
        squared = (apart**2).sum(axis=1)
        inverse = apart * (electrodes.radius**2 / squared)[:, None]
        from_image = np.hypot(*(apart[:, None] - inverse).transpose(2, 0, 1))
        from_centre = np.sqrt(squared)[:, None]
        weight = electrodes.nearness(squared)
        out += weight[:, None] * weight * np.log(from_image / from_centre)
    return RESISTANCE / (2 * np.pi) * out


@pytest.mark.parametrize("name", ["equal-8x8", "equal-16x16", "hex-37"])
def test_they_are_those_of_the_circle_theorem(name):
    electrodes = charges(name)
    places = places_near(electrodes)
    found, expected = electrodes.by(places).among(), by_circle_theorem(electrodes, places)
    np.testing.assert_allclose(found, expected, atol=2e-6 * RESISTANCE)
    np.testing.assert_allclose(found.diagonal(), electrodes.own(places), atol=2e-6 * RESISTANCE)


def test_far_from_all_electrodes_there_are_none():
    electrodes = InducedCharges(np.zeros((1, 2)), 0.0025, 0.01, RESISTANCE)
    places = np.array([[1.01 * CLOSE[1] * 0.01, 0.0], [0.1, 0.1]])
    found = electrodes.by(places)
    assert not found.among().any()
