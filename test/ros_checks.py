"""What has to be true of running nodes, however they were started.

Used by the plain tests (processes of their own) and by the tests of the launch files.
"""

from __future__ import annotations

import numpy as np
from ros_support import Probe

PRESSED = (0.05, 0.04)  # m: where the scene of these tests has its only contact
SCENE = """
format: tomotactile-scene/1
drive_voltage: 3.3
contacts:
  - {{shape: disc, center: [{}, {}], radius: 0.008, pressure: 20000.0}}
contact_law: {{coefficient: 1.0e-4, exponent: 1.0}}
noise: {{rms: 0.001}}
""".format(*PRESSED)
NEAR = 0.01  # m


def write_scene(folder) -> str:
    """File of a scene with one contact at +x +y."""
    path = folder / "pressed.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return str(path)


def check_topics(probe: Probe, prefix: str = "", frame_id: str = "tactile_link") -> None:
    """All topics appear with type and frame; an image has the stamp of the frame it shows."""
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

    probe.until(
        lambda: bool(set.intersection(*(stamps(name) for name in topics))),
        f"frame whose stamp is on all of {', '.join(topics)}",
    )
    frame, image, view = (heard[n][-1] for n in ("voltage_frame", "pressure", "pressure_view"))
    assert {m.header.frame_id for m in (frame, image, view)} == {frame_id}
    assert (image.encoding, view.encoding) == ("32FC1", "rgb8")
    assert frame.electrodes == 64 and len(frame.voltages) == 64 * 64
    numbers = [m.sequence for m in heard["voltage_frame"]]
    assert numbers == sorted(set(numbers))


def check_contact(probe: Probe, prefix: str = "", place: tuple[float, float] = PRESSED) -> None:
    """The strongest contact is where the scene has it, in the list and in the image."""
    from sensor_msgs.msg import Image

    from tomotactile_ros.msg import ContactArray

    message = probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) > 0)
    strongest = message.contacts[0]
    distance = np.hypot(strongest.position.x - place[0], strongest.position.y - place[1])
    assert distance < NEAR
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


def check_tare(probe: Probe, prefix: str = "") -> None:
    """After a tare the constant contact is gone."""
    from std_srvs.srv import Trigger

    from tomotactile_ros.msg import ContactArray

    answer = probe.call(Trigger, f"{prefix}/reconstruction/tare")
    assert answer.success and "mean of the last" in answer.message
    probe.wait_for(ContactArray, f"{prefix}/contacts", lambda m: len(m.contacts) == 0)


def check_diagnostics(probe: Probe, status: str, level: bytes, text: str) -> None:
    """A status of this name comes, with a level and a text."""
    from diagnostic_msgs.msg import DiagnosticArray

    def suits(message) -> bool:
        return any(
            s.name == status and s.level == level and text in s.message for s in message.status
        )

    probe.wait_for(DiagnosticArray, "/diagnostics", suits)
