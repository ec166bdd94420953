"""The order of the scan: from the layout file through simulation, devices and files to a
contact."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from devices_support import PATIENCE, E, counted, plugged, sensor, watched

from tomotactile_ros.cli import main
from tomotactile_ros.devices import DeviceSettings, make_device, protocol
from tomotactile_ros.devices.emulator import EmulatedDevice
from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.evaluation.places import lattice
from tomotactile_ros.frames_file import load_frames
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.scan_order import AdaptiveOrder, spread
from tomotactile_ros.optimizer.scan import Chooser
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

ORDER = (5, 10, 3, 12, 0, 15, 6, 9)
GRID = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4, name="grid")
SMALL = equal_grid(2, 3, (0.2, 0.2), 0.005, 1e4)


def test_the_file_keeps_the_order_and_the_geometry_its_id(tmp_path):
    scanned = replace(GRID, scan=(3, 0, 3))
    scanned.save(tmp_path / "scanned.yaml")
    found = load_layout(tmp_path / "scanned.yaml")
    assert found.scan == (3, 0, 3) and found.grounded.tolist() == [3, 0, 3]
    assert found.id == GRID.id and GRID.grounded.tolist() == list(range(16))


@pytest.mark.parametrize(
    "order, complaint",
    [
        ("[]", "scan.order: [] names no electrode"),
        ("[16]", "scan.order: electrode 16 does not exist, there are 0 to 15"),
        ("[1.5]", "scan.order[0]: 1.5 is not a whole number"),
        (str([0] * 65536), "scan.order: 65536 rows, a frame has at most 65535"),
    ],
)
def test_impossible_orders_are_one_line(tmp_path, order, complaint):
    path = tmp_path / "layout.yaml"
    GRID.save(path)
    path.write_text(path.read_text() + f"scan: {{order: {order}}}\n")
    with pytest.raises(InputError) as error:
        load_layout(path)
    assert complaint in str(error.value) and "\n" not in str(error.value)


def test_rows_of_the_scan_are_each_of_their_own_time():
    """A touch that lands after the third row is in the later rows alone."""
    start = 2.5e-3
    touch = Contact("disc", center=(0.01, 0.02), radius=0.006, pressure=2e4, start=start)
    scene = Scene("touch", 3.3, (touch,), contact_law=ContactLaw(1e-4, 1.0))
    frame = Simulator(replace(GRID, scan=ORDER), scene, "closed_form").frame(0.0)
    every = Simulator(GRID, scene, "closed_form", row_period=0.0).frame(1.0)
    assert np.nanmax(np.abs(frame[:3])) < 1e-9
    np.testing.assert_allclose(frame[3:], every[list(ORDER[3:])], rtol=1e-9)


def test_half_of_the_rows_are_simulated_stored_and_reconstructed(tmp_path):
    layout, scene = tmp_path / "half.yaml", tmp_path / "scene.yaml"
    replace(GRID, scan=ORDER).save(layout)
    scene.write_text(
        "format: tomotactile-scene/1\ndrive_voltage: 3.3\n"
        "contacts: [{shape: disc, center: [0.02, -0.03], radius: 0.006, pressure: 2.0e+4}]\n"
        "contact_law: {coefficient: 1.0e-4, exponent: 1.0}\nnoise: {rms: 1.0e-3, seed: 1}\n"
    )
    frames, out = tmp_path / "frames.npz", tmp_path / "result.npz"
    command = ["simulate", "--layout", str(layout), "--scene", str(scene), "--frames", "1"]
    assert main([*command, "--out", str(frames)]) == 0
    stored = load_frames(frames)
    assert stored.voltages.shape == (1, 8, 16) and stored.grounded.tolist() == list(ORDER)
    command = ["reconstruct", str(frames), "--layout", str(layout), "--profile", "accurate"]
    assert main([*command, "--out", str(out)]) == 0
    with np.load(out) as result:
        ((contact,),) = json.loads(str(result["contacts"]))
    assert np.hypot(contact["x"] - 0.02, contact["y"] + 0.03) < 2e-3


def test_the_order_of_the_layout_is_commanded_and_a_parameter_comes_first():
    settings = DeviceSettings(replace(SMALL, scan=(4, 1, 4)), "serial", port="")
    with plugged(sensor()) as port:
        device = make_device(replace(settings, port=port.path))
        with watched(device) as watch:
            watch.wait_for(
                lambda s: watch.frames and watch.frames[-1].grounded.tolist() == [4, 1, 4]
            )
        device = make_device(replace(settings, port=port.path, scan=(2,)))
        with watched(device) as watch:
            watch.wait_for(lambda s: watch.frames and watch.frames[-1].grounded.tolist() == [2])


def test_eight_of_64_rows_at_125_frames_a_second_through_driver_and_reconstruction():
    """The rows that `optimize --method scan` chooses, told to a sensor at the end of a line."""
    whole = load_layout("equal-8x8")
    layout = replace(whole, scan=tuple(spread(whole.positions, Chooser(whole, places=3).best(8))))
    touch = Contact("disc", center=(0.021, -0.034), radius=0.006, pressure=2e4)
    law = ContactLaw(1e-4, 1.0)
    scene = Scene("touch", 3.3, (touch,), contact_law=law, noise=Noise(1e-3, seed=1))
    seen = Simulator(whole, scene, "closed_form")
    device = EmulatedDevice(lambda time, sequence, order: seen.frame(0.0)[order], 64, rate=125.0)
    frames, enough = [], threading.Event()

    def take(frame):
        if len(frame.grounded) == 8:
            frames.append(frame)
        if len(frames) == 5:
            enough.set()

    with plugged(device) as port:
        driver = make_device(DeviceSettings(layout, "serial", port=port.path, rate=125.0))
        driver.open(take)
        assert enough.wait(PATIENCE), driver.status()
        driver.close()
    pipeline = Pipeline(layout, Settings("accurate", contact_law=law))
    for frame in frames[:5]:
        assert frame.grounded.tolist() == list(layout.scan)
        assert 8 * frame.row_period == pytest.approx(1 / 125)
        result = pipeline.process(frame.voltages, frame.grounded, 3.3, frame.row_period)
        (contact,) = result.contacts
        assert np.hypot(contact.x - 0.021, contact.y + 0.034) < 3e-4


def test_a_device_of_version_1_keeps_its_order_and_says_so():
    settings = DeviceSettings(replace(SMALL, scan=(4, 1)), "serial", port="")
    with (
        plugged(sensor(versions=[1])) as port,
        watched(make_device(replace(settings, port=port.path))) as watch,
    ):
        watch.wait_for_frames(2)
        message = watch.device.status().message
    assert "scan: of 2 rows, the device takes its own order only" in message
    assert watch.frames[-1].grounded.tolist() == list(range(E))


def test_the_simulated_device_scans_as_the_layout_says():
    layout, scene = replace(SMALL, scan=(4, 1, 0)), Scene("idle", 3.3)
    device = make_device(DeviceSettings(layout, "fake", scene=scene))
    frames, news = [], threading.Event()
    device.open(lambda frame: (frames.append(frame), news.set()))
    assert news.wait(PATIENCE)
    device.close()
    assert frames[0].grounded.tolist() == [4, 1, 0]
    assert frames[0].row_period == pytest.approx(1e-3)


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


def test_rows_that_contacts_choose_tell_more_of_them_than_any_fixed_ones():
    """The bound on the place error from 8 rows of 16, known beforehand (`evaluation.posterior`)."""
    chooser = Chooser(GRID, places=4)
    places = lattice(GRID, 4)
    order = AdaptiveOrder(GRID.positions, 8)
    fixed = chooser.information.figures(chooser.best(8))[0]
    chosen = [chooser.information.figures(order.frame(p[None]))[0][i] for i, p in enumerate(places)]
    assert np.mean(chosen) < 0.9 * np.mean(fixed)


@pytest.mark.parametrize("versions", [[1], [1, 2]])
def test_the_usual_order_is_that_of_devices_that_take_one(versions):
    settings = DeviceSettings(SMALL, "serial", port="", order="jumping")
    with plugged(sensor(versions=versions)) as port:
        device = make_device(replace(settings, port=port.path))
        with watched(device) as watch:
            watch.wait_for_frames(2)
            assert not device.status().troubles
    jumping = spread(SMALL.positions, range(E))
    assert jumping != sorted(jumping)
    wanted = jumping if 2 in versions else sorted(jumping)
    assert {tuple(frame.grounded.tolist()) for frame in watch.frames} == {tuple(wanted)}


class Listening(EmulatedDevice):
    """Keeps the commands that it gets."""

    def receive(self, data, now):
        self.heard = [*getattr(self, "heard", []), *protocol.Parser().feed(data)]
        return super().receive(data, now)


def test_an_order_in_every_frame_costs_no_frame_and_tells_nothing_else():
    device, orders = Listening(counted, E, rate=100.0), [(0, 3, 1), (5, 2, 4), (1, 2, 3)]
    with plugged(device) as port:
        settings = DeviceSettings(SMALL, "serial", port=port.path, scan=orders[0])
        with watched(make_device(settings)) as watch:
            watch.wait_for_frames(3)
            told = len(device.heard)
            for i in range(30):
                watch.device.set_scan(orders[i % 3])
                watch.wait_for_frames(1)
            watch.wait_for_frames(2)
            counters = watch.device.status().counters
            heard = [protocol.type_of(packet) for packet in device.heard[told:]]
    assert counters["frames_lost"] == counters["rows_ignored"] == 0
    assert {tuple(frame.grounded.tolist()) for frame in watch.frames} == set(orders)
    assert len([kind for kind in heard if kind == protocol.SET_SCAN]) >= 30
    assert set(heard) <= {protocol.SET_SCAN, protocol.KEEP_ALIVE}


def test_a_simulated_scan_takes_a_new_order_up_with_the_frame_after_the_next():
    scene, frames = Scene("nothing", 3.3, ()), []
    simulator = Simulator(SMALL, scene)
    device, enough = FakeDevice(simulator, rate=100.0), threading.Event()
    orders = [(0, 3), (5, 2), (1, 4)]
    device.set_scan(orders[0])

    def take(frame):
        frames.append(frame)
        device.set_scan(orders[len(frames) % 3])
        if len(frames) >= 8:
            enough.set()

    device.open(take, lambda rows: None)
    assert enough.wait(PATIENCE)
    device.close()
    assert {tuple(frame.grounded.tolist()) for frame in frames[1:]} == set(orders)
