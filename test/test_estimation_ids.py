"""A second without readings ends no contact: whoever slides on meanwhile keeps its id."""

from functools import cache

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

DRIVE, NEAR = 3.3, 0.01
GAP = (1.6, 2.6)  # s: the finger turns round a corner meanwhile, the ball turns back


@cache
def frames(step):
    """(begin, s, readings (64, 64), V) of the scene `slide`, none within the gap; the next row grounds the
    electrode `step` further."""
    layout = load_layout("equal-8x8")
    simulator = Simulator(layout, load_scene("slide"), "closed_form", row_period=ROW_PERIOD)
    simulator.grounded = np.arange(64) * step % 64
    begins = [*np.arange(GAP[0] - 0.128, GAP[0], 0.064), *(GAP[1] + 0.064 * np.arange(3))]
    return [(begun, simulator.frame(begun, i)) for i, begun in enumerate(begins)]


def owners(contacts, now, ids):
    """Adds to {which contact of the scene: its ids} those of contacts at a time of the scene, s."""
    places = [each.at(now).centroid for each in load_scene("slide").contacts]
    for contact in contacts:
        apart = [np.hypot(contact.x - x, contact.y - y) for x, y in places]
        assert min(apart) < NEAR, (now, contact)
        ids.setdefault(int(np.argmin(apart)), set()).add(contact.id)


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_contacts_of_frames_keep_their_ids(profile):
    layout, ids = load_layout("equal-8x8"), {}
    pipeline, order = Pipeline(layout, Settings(profile)), np.arange(64)
    for begun, voltages in frames(1):
        result = pipeline.process(voltages, order, DRIVE, ROW_PERIOD, begun)
        assert len(result.contacts) == 2, result.reason
        owners(result.contacts, begun + result.holds, ids)
    assert sorted(map(len, ids.values())) == [1, 1], ids


def test_contacts_of_rows_keep_their_ids():
    """What a frame says comes eight rows late, that of the one before the gap behind it: rows had lost one
    of the contacts by then, and took the frame for one that had found it gone."""
    layout, ids, told = load_layout("equal-8x8"), {}, None
    pipeline, order = Pipeline(layout, Settings("accurate")), np.arange(64) * 27 % 64
    state = pipeline.rows(waits=False)
    for begun, voltages in frames(27):
        for i, ground in enumerate(order.tolist()):
            if i == 8 and told is not None and state.asks:
                pipeline.correct(state, *told)
            now = begun + i * ROW_PERIOD
            result = pipeline.process_row(voltages[i], ground, DRIVE, now, state)
            owners(result.contacts, now, ids)
        told = voltages, order, DRIVE, ROW_PERIOD, begun
    assert sorted(map(len, ids.values())) == [1, 1], ids
    assert len(result.contacts) == 2 and all(each.age > 1.0 for each in result.contacts)
