"""What has to be true of running nodes, however they were started.

Used by the plain tests (processes of their own) and by the tests of the launch files.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import Probe, Process, program
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.msg import ContactArray, SensorLayout, VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.surfaces import Cylinder

PRESSED = (0.057, 0.03)  # m: the only contact of these tests' scene, between electrodes
SCENE = """
format: tomotactile-scene/1
drive_voltage: 3.3
contacts:
  - {{shape: disc, center: [{}, {}], radius: 0.008, pressure: 20000.0}}
contact_law: {{coefficient: 1.0e-4, exponent: 1.0}}
noise: {{rms: 0.001}}
""".format(*PRESSED)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NEAR = 0.01  # m
RATE = 15.625  # frames/s of 64 ground conditions
BEND = 0.05  # m, radius of the curved sheet


def write_scene(folder) -> str:
    """File of a scene with one contact at +x +y."""
    path = folder / "pressed.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return str(path)


def write_curved_layout(folder) -> str:
    """File of the 8 x 8 layout of these tests, wrapped around a cylinder."""
    path = folder / "curved-8x8.yaml"
    replace(load_layout("equal-8x8"), name="curved-8x8", surface=Cylinder(BEND)).save(path)
    return str(path)


def arguments_of(device: str, folder, layout: str, scene: str) -> dict[str, str]:
    """What lets a driver have its frames from an emulator or from a recording of the scene."""
    if device == "serial":
        return {"device": device, "port": str(folder / "port")}
    recording = str(folder / "frames.npz")
    sensor = Simulator(load_layout(layout), load_scene(scene))
    stamps = np.arange(20) * len(sensor.grounded) * sensor.row_period
    frames = np.array([sensor.frame(stamp, number) for number, stamp in enumerate(stamps)])
    known = sensor.layout, sensor.scene, frames, sensor.grounded, stamps, sensor.row_period
    save_frames(recording, *known)
    return {"device": device, "recording": recording}


def emulator(folder, layout: str, scene: str) -> list[str]:
    """Command of the emulator, at the other end of the line of `arguments_of`."""
    words = ["--layout", layout, "--scene", scene, "--port", f"pty:{folder / 'port'}"]
    return [program("tomotactile"), "emulate", *words]


def check_topics(probe: Probe, prefix: str = "", frame_id: str = "tactile_link") -> None:
    """All topics appear with type, frame and rate; an image has the stamp of the frame it shows, a
    marker that of the contacts."""
    of_frames = {"voltage_frame": VoltageFrame, "pressure": Image, "pressure_view": Image}
    of_contacts = {"contacts": ContactArray, "contact_markers": MarkerArray}
    heard = {
        name: probe.listen(kind, f"{prefix}/{name}")
        for name, kind in (of_frames | of_contacts).items()
    }

    def have_a_stamp_in_common(names) -> bool:
        found = ({stamp(m) for m in heard[name] if getattr(m, "markers", True)} for name in names)
        return bool(set.intersection(*found))

    for names in (of_frames, of_contacts):
        text = f"a stamp that is on all of {', '.join(names)}"
        probe.until(lambda names=names: have_a_stamp_in_common(names), text)
    frame, image, view = (heard[name][-1] for name in of_frames)
    assert {m.header.frame_id for m in (frame, image, view)} == {frame_id}
    assert (image.encoding, view.encoding) == ("32FC1", "rgb8")
    assert frame.electrodes == 64 and len(frame.voltages) == 64 * 64
    probe.until(lambda: len(heard["voltage_frame"]) > 8, "more frames")
    probe.listen_no_more()
    check_rate(heard["voltage_frame"])


def stamp(message) -> tuple[int, int]:
    """s and ns of a message; of markers, that of the first."""
    header = message.markers[0].header if hasattr(message, "markers") else message.header
    return header.stamp.sec, header.stamp.nanosec


def check_rate(frames: list) -> None:
    """Frames are numbered and stamped as they follow each other: the scan's period from one to the
    next."""
    numbers = np.array([m.sequence for m in frames])
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in frames])
    assert (np.diff(numbers) > 0).all()
    period = (stamps[-1] - stamps[0]) / float(numbers[-1] - numbers[0])
    assert abs(period * RATE - 1) < 0.1


def check_contact(probe: Probe, prefix: str = "", bent: bool = False) -> None:
    """The strongest contact is where the scene has it, in the list, unless the sheet is `bent`, and in
    the image."""
    message = probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) > 0)
    strongest = message.contacts[0]
    place = xyz(strongest.position)[:2]
    assert bent or np.linalg.norm(place - PRESSED) < NEAR
    assert strongest.force == max(c.force for c in message.contacts)
    image = probe.wait_for(Image, f"{prefix}/pressure", lambda m: np.nanmax(pixels(m)) > 0)
    pressure = pixels(image)
    row, column = np.unravel_index(np.nanargmax(pressure), pressure.shape)
    peak = -0.1 + (column + 0.5) * 0.2 / image.width, 0.1 - (row + 0.5) * 0.2 / image.height
    assert np.linalg.norm(np.subtract(peak, PRESSED)) < 2 * NEAR


def pixels(image) -> np.ndarray:
    """Pressures of an image message, Pa."""
    return np.frombuffer(image.data, np.float32).reshape(image.height, image.width)


def check_surface(probe: Probe, prefix: str = "") -> None:
    """Cloud, contacts and wrench lie on the cylinder, where the scene presses."""
    angle = PRESSED[0] / BEND
    pressed = (BEND * np.sin(angle), PRESSED[1], BEND * (np.cos(angle) - 1))
    cloud = probe.wait_for(PointCloud2, f"{prefix}/surface", lambda m: table_of(m)[:, 3].max() > 0)
    table = table_of(cloud)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "pressure"]
    assert np.isfinite(table).all() and len(table) == 40 * 40
    np.testing.assert_allclose(np.hypot(table[:, 0], table[:, 2] + BEND), BEND, rtol=1e-5)
    assert np.linalg.norm(table[table[:, 3].argmax(), :3] - pressed) < 2 * NEAR

    check_bent_contact(probe, prefix, pressed)
    described = probe.wait_for(SensorLayout, f"{prefix}/layout", qos=LATCHED)
    np.testing.assert_allclose([xyz(c) for c in described.cells], table[:, :3], atol=1e-7)


def check_bent_contact(probe: Probe, prefix: str, pressed) -> None:
    """The contact is on the cylinder, with its normal; the wrench is its force there."""
    wrenches = probe.listen(WrenchStamped, f"{prefix}/wrench")
    arrays = probe.listen(ContactArray, f"{prefix}/contacts")

    def both():
        of = {stamp(wrench): wrench.wrench for wrench in wrenches}
        known = [a for a in arrays if len(a.contacts) == 1 and stamp(a) in of]
        return known and (known[0].contacts[0], of[stamp(known[0])])

    probe.until(both, "wrench and contact of one frame")
    contact, wrench = both()
    place, normal, force, torque = map(
        xyz, (contact.position, contact.normal, wrench.force, wrench.torque)
    )
    assert np.linalg.norm(place - pressed) < NEAR
    np.testing.assert_allclose(np.hypot(place[0], place[2] + BEND), BEND, rtol=1e-6)
    np.testing.assert_allclose(normal, (place + [0, 0, BEND]) * [1, 0, 1] / BEND, atol=1e-6)
    np.testing.assert_allclose(force, -contact.force * normal, rtol=1e-5)
    np.testing.assert_allclose(torque, np.cross(place, force), atol=1e-6)


def xyz(vector) -> np.ndarray:
    """A point or a vector of a message as an array."""
    return np.array([vector.x, vector.y, vector.z])


def table_of(cloud) -> np.ndarray:
    """(P, 4) x, y, z (m) and pressure (Pa) of a point cloud."""
    return np.frombuffer(cloud.data, np.float32).reshape(cloud.width, 4)


def check_stamps(probe, part: float, prefix: str = "") -> None:
    """Images have the stamp of their frame; contacts that of the time for which they hold, `part` of
    the way from the first row to the last."""
    frames = probe.listen(VoltageFrame, f"{prefix}/voltage_frame", 100)
    images = probe.listen(Image, f"{prefix}/pressure", 100)
    arrays = probe.listen(ContactArray, f"{prefix}/contacts", 100)

    def all_there():
        made = {stamp_of(image.header) for image in images}
        held = {round(stamp_of(array.header), 6) for array in arrays}
        for frame in frames:
            lasts = frame.row_period * (len(frame.grounded) - 1)
            began = stamp_of(frame.header)
            if began in made and round(began + part * lasts, 6) in held:
                return lasts > 0
        return False

    probe.until(all_there, "an image of a frame, and contacts of its time")
    probe.listen_no_more()


def check_tare(probe: Probe, prefix: str = "") -> None:
    """A tare of the pressed sheet is refused: its contact would be taken off all that follows."""
    answer = probe.call(Trigger, f"{prefix}/reconstruction/tare")
    assert not answer.success and "something presses on the sheet" in answer.message
    probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) > 0)


def status_of(probe: Probe, name: str, suits=lambda status: True):
    """A status of this name in the diagnostics that suits, as soon as one comes."""
    found: list = []

    def is_there(message) -> bool:
        found.extend(each for each in message.status if each.name == name and suits(each))
        return bool(found)

    probe.wait_for(DiagnosticArray, "/diagnostics", is_there)
    return found[0]


def check_diagnostics(probe: Probe, status: str, level: bytes, text: str) -> None:
    """A status of this name comes, with a level and a text."""
    status_of(probe, status, lambda each: each.level == level and text in each.message)


def figures_of(probe: Probe, status: str) -> dict[str, str]:
    """The figures of a status of this name."""
    return {each.key: each.value for each in status_of(probe, status).values}


_BUSY = "% of the rows", "% of the frames were not used", "the deadline came", "s old: "


def check_images(probe: Probe, status: str) -> None:
    """Images are made, and nothing is wrong but what a machine with other work brings with it."""

    def well(s) -> bool:
        busy = all(any(text in part for text in _BUSY) for part in s.message.split("; "))
        return busy or (s.level == DiagnosticStatus.OK and s.message == "images are made")

    status_of(probe, status, well)


def has_logged(probe: Probe, process: Process, level: str, text: str) -> None:
    """A program's log has a line of this level (INFO, WARN, ERROR) with a text, soon at least."""

    def there() -> bool:
        lines = process.output.splitlines()
        return any(f"[{level}]" in line and text in line for line in lines)

    probe.until(there, f"line of level {level} with {text!r} in the log")
