"""What has to be true of running nodes, however they were started.

Used by the plain tests (processes of their own) and by the tests of the launch files.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from ros_support import Probe, Process, program

PRESSED = (0.057, 0.03)  # m: the only contact of these tests' scene, between electrodes
SCENE = """
format: tomotactile-scene/1
drive_voltage: 3.3
contacts:
  - {{shape: disc, center: [{}, {}], radius: 0.008, pressure: 20000.0}}
contact_law: {{coefficient: 1.0e-4, exponent: 1.0}}
noise: {{rms: 0.001}}
""".format(*PRESSED)
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
    from tomotactile_ros.layouts.layout import load_layout
    from tomotactile_ros.surfaces import Cylinder

    path = folder / "curved-8x8.yaml"
    replace(load_layout("equal-8x8"), name="curved-8x8", surface=Cylinder(BEND)).save(path)
    return str(path)


def arguments_of(device: str, folder, layout: str, scene: str) -> dict[str, str]:
    """What lets a driver have its frames from an emulator or from a recording of the scene."""
    from tomotactile_ros.frames_file import save_frames
    from tomotactile_ros.layouts.layout import load_layout
    from tomotactile_ros.scenes.scene import load_scene
    from tomotactile_ros.simulation import Simulator

    if device == "serial":
        return {"device": device, "port": str(folder / "port")}
    recording, sensor = (
        str(folder / "frames.npz"),
        Simulator(load_layout(layout), load_scene(scene)),
    )
    stamps = np.arange(20) * len(sensor.grounded) * sensor.row_period
    frames = np.array([sensor.frame(stamp, number) for number, stamp in enumerate(stamps)])
    known = sensor.layout, sensor.scene, frames, sensor.grounded, stamps, sensor.row_period
    save_frames(recording, *known)
    return {"device": device, "recording": recording}


def plug_in(folder, layout: str, scene: str, domain: int) -> Process:
    """The emulator, at the other end of the line of `arguments_of`."""
    words = ["--layout", layout, "--scene", scene, "--port", f"pty:{folder / 'port'}"]
    return Process([program("emulator"), *words], domain, warm=False)


def check_topics(probe: Probe, prefix: str = "", frame_id: str = "tactile_link") -> None:
    """All topics appear with type, frame and rate; an image has the stamp of the frame it shows, a
    marker that of the contacts."""
    from sensor_msgs.msg import Image
    from visualization_msgs.msg import MarkerArray

    from tomotactile_ros.msg import ContactArray, VoltageFrame

    topics = {
        "voltage_frame": VoltageFrame,
        "pressure": Image,
        "pressure_view": Image,
        "contacts": ContactArray,
        "contact_markers": MarkerArray,
    }
    heard = {name: probe.listen(kind, f"{prefix}/{name}") for name, kind in topics.items()}

    def stamps(name: str) -> set[tuple[int, int]]:
        headers = [
            m.markers[0].header if name == "contact_markers" else m.header
            for m in heard[name]
            if name != "contact_markers" or m.markers
        ]
        return {(h.stamp.sec, h.stamp.nanosec) for h in headers}

    def all_on(names: list[str]) -> bool:
        return bool(set.intersection(*(stamps(name) for name in names)))

    of_frames = list(topics)[:3]
    probe.until(lambda: all_on(of_frames), f"a stamp that is on all of {', '.join(of_frames)}")
    probe.until(lambda: all_on(list(topics)[3:]), "a marker of contacts")
    frame, image, view = (heard[n][-1] for n in ("voltage_frame", "pressure", "pressure_view"))
    assert {m.header.frame_id for m in (frame, image, view)} == {frame_id}
    assert (image.encoding, view.encoding) == ("32FC1", "rgb8")
    assert frame.electrodes == 64 and len(frame.voltages) == 64 * 64
    probe.until(lambda: len(heard["voltage_frame"]) > 8, "more frames")
    probe.listen_no_more()
    check_rate(heard["voltage_frame"])


def check_rate(frames: list) -> None:
    """Frames are numbered and stamped as they follow each other: the scan's period from one to the
    next."""
    numbers = np.array([m.sequence for m in frames])
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in frames])
    assert (np.diff(numbers) > 0).all()
    period = (stamps[-1] - stamps[0]) / float(numbers[-1] - numbers[0])
    assert abs(period * RATE - 1) < 0.1


def check_contact(
    probe: Probe, prefix: str = "", place: tuple[float, float] = PRESSED, bent: bool = False
) -> None:
    """The strongest contact is where the scene has it, in the list and in the image.

    Where the sheet is `bent` its place in space is that of `check_surface`.
    """
    from sensor_msgs.msg import Image

    from tomotactile_ros.msg import ContactArray

    message = probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) > 0)
    strongest = message.contacts[0]
    distance = np.hypot(strongest.position.x - place[0], strongest.position.y - place[1])
    assert bent or distance < NEAR
    assert strongest.force == max(c.force for c in message.contacts)
    image = probe.wait_for(Image, f"{prefix}/pressure", lambda m: peak_of(m) is not None)
    row, column = peak_of(image)
    x = -0.1 + (column + 0.5) * 0.2 / image.width
    y = 0.1 - (row + 0.5) * 0.2 / image.height
    assert np.hypot(x - place[0], y - place[1]) < 2 * NEAR


def peak_of(message) -> tuple[int, int] | None:
    """Row and column of the highest pressure of an image message, if there is any."""
    pressure = np.frombuffer(message.data, np.float32).reshape(message.height, message.width)
    if not np.nanmax(pressure) > 0:
        return None
    row, column = np.unravel_index(np.nanargmax(pressure), pressure.shape)
    return int(row), int(column)


def check_surface(probe: Probe, prefix: str = "") -> None:
    """Cloud, contacts and markers lie on the cylinder, where the scene presses, and so the
    wrench."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import PointCloud2
    from visualization_msgs.msg import MarkerArray

    from tomotactile_ros.msg import SensorLayout

    angle = PRESSED[0] / BEND
    pressed = (BEND * np.sin(angle), PRESSED[1], BEND * (np.cos(angle) - 1))
    cloud = probe.wait_for(PointCloud2, f"{prefix}/surface", lambda m: table_of(m)[:, 3].max() > 0)
    table = table_of(cloud)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "pressure"]
    assert np.isfinite(table).all() and len(table) == 40 * 40
    np.testing.assert_allclose(np.hypot(table[:, 0], table[:, 2] + BEND), BEND, rtol=1e-5)
    assert np.linalg.norm(table[table[:, 3].argmax(), :3] - pressed) < 2 * NEAR

    shown = probe.wait_for(MarkerArray, f"{prefix}/contact_markers", lambda m: len(m.markers) > 1)
    (disc,) = (m for m in shown.markers if m.ns == "contact" and m.action == m.ADD)
    assert distance_of(disc, pressed) < NEAR
    check_bent_contact(probe, prefix, pressed, disc)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    described = probe.wait_for(SensorLayout, f"{prefix}/layout", qos=latched)
    cells = np.array([(c.x, c.y, c.z) for c in described.cells])
    np.testing.assert_allclose(cells, table[:, :3], atol=1e-7)
    layout = probe.wait_for(MarkerArray, f"{prefix}/layout_markers", qos=latched)
    axis = [np.hypot(m.pose.position.x, m.pose.position.z + BEND)
            for m in layout.markers if m.ns == "electrode"]  # fmt: skip
    np.testing.assert_allclose(axis, np.full(64, BEND))


def check_bent_contact(probe: Probe, prefix: str, pressed, disc) -> None:
    """The contact is on the cylinder, with its normal; the wrench is its force there."""
    from geometry_msgs.msg import WrenchStamped

    from tomotactile_ros.msg import ContactArray

    wrenches = probe.listen(WrenchStamped, f"{prefix}/wrench")
    arrays = probe.listen(ContactArray, f"{prefix}/contacts")

    def both():
        stamps = {(w.header.stamp.sec, w.header.stamp.nanosec): w for w in wrenches}
        return [
            (a, stamps[a.header.stamp.sec, a.header.stamp.nanosec])
            for a in arrays
            if len(a.contacts) == 1 and (a.header.stamp.sec, a.header.stamp.nanosec) in stamps
        ]

    probe.until(lambda: bool(both()), "wrench and contact of one frame")
    (contact,), wrench = both()[0][0].contacts, both()[0][1].wrench
    place = np.array([contact.position.x, contact.position.y, contact.position.z])
    assert np.linalg.norm(place - pressed) < NEAR
    assert distance_of(disc, place) < NEAR
    np.testing.assert_allclose(np.hypot(place[0], place[2] + BEND), BEND, rtol=1e-6)
    normal = np.array([contact.normal.x, contact.normal.y, contact.normal.z])
    np.testing.assert_allclose(normal, (place + [0, 0, BEND]) * [1, 0, 1] / BEND, atol=1e-6)
    force = np.array([wrench.force.x, wrench.force.y, wrench.force.z])
    np.testing.assert_allclose(force, -contact.force * normal, rtol=1e-5)
    torque = np.array([wrench.torque.x, wrench.torque.y, wrench.torque.z])
    np.testing.assert_allclose(torque, np.cross(place, force), atol=1e-6)


def table_of(cloud) -> np.ndarray:
    """(P, 4) x, y, z (m) and pressure (Pa) of a point cloud."""
    return np.frombuffer(cloud.data, np.float32).reshape(cloud.width, 4)


def distance_of(marker, place) -> float:
    """Distance of a marker from a place in space, m."""
    at = marker.pose.position
    return float(np.linalg.norm(np.subtract((at.x, at.y, at.z), place)))


def check_stamps(probe, part: float, prefix: str = "") -> None:
    """Images have the stamp of their frame; contacts that of the time for which they hold, `part` of
    the way from the first row to the last."""
    from sensor_msgs.msg import Image

    from tomotactile_ros.msg import ContactArray, VoltageFrame
    from tomotactile_ros.nodes.conversions import stamp_of

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
    from std_srvs.srv import Trigger

    from tomotactile_ros.msg import ContactArray

    answer = probe.call(Trigger, f"{prefix}/reconstruction/tare")
    assert not answer.success and "something presses on the sheet" in answer.message
    probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) > 0)


def check_diagnostics(probe: Probe, status: str, level: bytes, text: str) -> None:
    """A status of this name comes, with a level and a text."""
    from diagnostic_msgs.msg import DiagnosticArray

    def suits(message) -> bool:
        return any(
            s.name == status and s.level == level and text in s.message for s in message.status
        )

    probe.wait_for(DiagnosticArray, "/diagnostics", suits)


_OF_A_BUSY_MACHINE = (
    "% of the rows",
    "% of the frames were not used",
    "the deadline came",
    "s old: ",
)


def check_images(probe: Probe, status: str) -> None:
    """Images are made, and nothing is wrong but what a machine with other work brings with it."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    def well(s) -> bool:
        parts = s.message.split("; ")
        busy = all(any(text in part for text in _OF_A_BUSY_MACHINE) for part in parts)
        return busy or (s.level == DiagnosticStatus.OK and s.message == "images are made")

    def suits(message) -> bool:
        return any(s.name == status and well(s) for s in message.status)

    probe.wait_for(DiagnosticArray, "/diagnostics", suits)


def has_logged(probe: Probe, process: Process, level: str, text: str) -> None:
    """A program's log has a line of this level (INFO, WARN, ERROR) with a text, soon at least."""

    def there() -> bool:
        lines = process.output.splitlines()
        return any(f"[{level}]" in line and text in line for line in lines)

    probe.until(there, f"line of level {level} with {text!r} in the log")


def figures_of(probe: Probe, status: str) -> dict[str, str]:
    """The figures of a status of this name."""
    from diagnostic_msgs.msg import DiagnosticArray

    message = probe.wait_for(
        DiagnosticArray, "/diagnostics", lambda m: any(s.name == status for s in m.status)
    )
    (found,) = (s for s in message.status if s.name == status)
    return {each.key: each.value for each in found.values}
