"""The order of the scan: from the layout file through devices to a contact."""

from dataclasses import replace

import numpy as np
import pytest
from devices_support import E, collect, plugged, sensor, watched

from tomotactile_ros.devices import DeviceSettings, make_device
from tomotactile_ros.devices.emulator import EmulatedDevice
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.scan_order import AdaptiveOrder, spread
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator

GRID = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4, name="grid")
SMALL = equal_grid(2, 3, (0.2, 0.2), 0.005, 1e4)


JUMPING = spread(SMALL.positions, range(E))


@pytest.mark.parametrize(
    ("scan", "settings", "versions", "wanted"),
    [
        ((4, 1, 4), {}, [1, 2], [4, 1, 4]),
        ((4, 1, 4), {"scan": (2,)}, [1, 2], [2]),
        ((), {"order": "jumping"}, [1], sorted(JUMPING)),
        ((), {"order": "jumping"}, [1, 2], JUMPING),
    ],
    ids=["of the layout", "parameter", "device that takes none", "usual order"],
)
def test_the_order_is_commanded_where_the_device_takes_one(scan, settings, versions, wanted):
    assert sorted(JUMPING) != JUMPING
    chosen = DeviceSettings(replace(SMALL, scan=scan), "serial", port="", **settings)
    with (
        plugged(sensor(versions=versions)) as port,
        watched(make_device(replace(chosen, port=port.path))) as watch,
    ):
        watch.wait_for_frames(2)
        assert not watch.device.status().troubles
    assert {tuple(frame.grounded.tolist()) for frame in watch.frames} == {tuple(wanted)}


def test_eight_of_64_rows_at_125_frames_a_second_through_driver_and_reconstruction():
    """The rows that `optimize --method scan` chose, told to a sensor at the end of a line."""
    whole = load_layout("equal-8x8")
    chosen = [36, 32, 13, 57, 47, 10, 24, 51]
    layout = replace(whole, scan=tuple(spread(whole.positions, chosen)))
    touch = Contact("disc", center=(0.021, -0.034), radius=0.006, pressure=2e4)
    law = ContactLaw(1e-4, 1.0)
    scene = Scene("touch", 3.3, (touch,), contact_law=law, noise=Noise(1e-3, seed=1))
    seen = Simulator(whole, scene, "closed_form")
    device = EmulatedDevice(lambda time, sequence, order: seen.frame(0.0)[order], 64, rate=125.0)
    with plugged(device) as port:
        settings = DeviceSettings(layout, "serial", port=port.path, rate=125.0)
        frames = collect(make_device(settings), 5)
    pipeline = Pipeline(layout, Settings("accurate", contact_law=law))
    for frame in frames[:5]:
        assert frame.grounded.tolist() == list(layout.scan)
        assert 8 * frame.row_period == pytest.approx(1 / 125)
        result = pipeline.process(frame.voltages, frame.grounded, 3.3, frame.row_period)
        (contact,) = result.contacts
        assert np.hypot(contact.x - 0.021, contact.y + 0.034) < 3e-4


def test_an_adaptive_frame_grounds_electrodes_near_contacts_and_all_others_in_turn():
    positions, grounded = load_layout("equal-8x8").positions, []
    order = AdaptiveOrder(positions)
    contacts = np.array([[0.03, 0.02], [-0.06, -0.05]])
    for _ in range(13):
        frame = order.frame(contacts)
        assert len(frame) == len(set(frame)) == 16
        for contact in contacts:
            nearest = np.argsort(np.hypot(*(positions - contact).T))[:6]
            assert set(nearest.tolist()) <= set(frame)
        grounded += frame
    assert set(grounded) == set(range(64))
    untouched = [e for _ in range(4) for e in order.frame(np.empty((0, 2)))]
    assert sorted(untouched) == list(range(64))
    few = AdaptiveOrder(positions[:5]).frame(contacts)
    assert sorted(few) == list(range(5))
