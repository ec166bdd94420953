"""Layouts measured by contacts: the same contacts for all, and what counts as told apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tomotactile_ros.bench.accuracy import force_errors
from tomotactile_ros.bench.layouts import EVEN, UNEVEN, Amount, Measured, touches
from tomotactile_ros.layouts.layout import load_layout

AMOUNT = Amount(3, 2, (0.02, 0.04))


def test_all_layouts_of_an_outline_get_the_same_contacts():
    one = load_layout("equal-4x4")
    other = replace(one, positions=0.8 * one.positions, radius=0.002)
    states = [touches(layout, AMOUNT).states for layout in (one, other)]
    assert [state.case for state in states[0]] == [
        *[EVEN] * 3,
        *[UNEVEN] * 3,
        *["20 mm apart"] * 2,
        *["40 mm apart"] * 2,
    ]
    places = [[press.shape.center for state in each for press in state.contacts] for each in states]
    assert np.array_equal(*places)
    sheets = [state.sheet for state in states[0]]
    assert sheets[:3] == [0, 0, 0] and 0 not in sheets[3:6]


@pytest.mark.parametrize(
    ("told", "closest"),
    [
        ([0.0, 0.4, 0.9, 1.0], 0.028),
        ([0.9, 0.8, 1.0, 1.0], 0.01),
        ([0.9, 0.9, 0.9, 0.7], np.inf),
        ([1.0, 0.6, 1.0, 1.0], 0.025),
    ],
)
def test_pairs_are_told_apart_from_where_four_of_five_are(told, closest):
    apart = np.array([0.01, 0.02, 0.03, 0.04])
    measured = Measured(load_layout("equal-4x4"), "fast", {}, {}, apart, np.array(told))
    assert measured.closest == pytest.approx(closest)


def test_force_errors_are_relative_and_one_where_nothing_is_reported():
    contacts = [[SimpleNamespace(force=3.0), SimpleNamespace(force=1.0)], []]
    results = [SimpleNamespace(contacts=each) for each in contacts]
    assert force_errors(results, [2.0, 5.0]) == pytest.approx([0.5, 1.0])
