"""Node `driver`: hands every frame of a device on as a VoltageFrame, and keeps the device going."""

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Temperature
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from tomotactile_ros.devices import Device, DeviceSettings, Frame, make_device
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conditions import Conditions, Pace, log_at
from tomotactile_ros.nodes.conversions import frame_to_message, make_header
from tomotactile_ros.nodes.data_source import level_of, nature, outcome
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.node_time import (
    STANDS_STILL,
    NodeTime,
    PassingTime,
    clock_of,
    is_timeless,
    seconds_now,
    troubles_of_time,
)
from tomotactile_ros.nodes.parameters import HARDWARE_ID, PATH_CHANGES, Spec
from tomotactile_ros.nodes.running import Part, run
from tomotactile_ros.nodes.scan_order import ScanOrder
from tomotactile_ros.nodes.topics import publisher
from tomotactile_ros.nodes.touches import TouchListener
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import Touch
from tomotactile_ros.support.errors import InputError

_OF_A_NODE: dict[str, Any] = {
    "order": "jumping",
    "max_age": 1.0,
}  # what else is the default of a device's setting
SPECS = (
    Spec("layout", "equal-8x8", "Electrodes: a layout file or an installed name", read_only=True),
    Spec(
        "frame_id", "tactile_link", "Frame of the sensor in all headers", read_only=True, frame=True
    ),
    HARDWARE_ID,
    *(
        Spec(each.name, _OF_A_NODE.get(each.name, each.default), **each.metadata)
        for each in fields(DeviceSettings)
        if each.metadata
    ),
    Spec(
        "scene",
        "default",
        "For fake: what touches the sheet, a scene file or an installed name",
        path=True,
    ),
    Spec(
        "delivery",
        "frames",
        "What is published: whole frames, or also rows of them on voltage_rows at once",
        choices=("frames", "rows"),
    ),
    Spec("streaming", True, "false stops the device until it is true again"),
    PATH_CHANGES,
)

_SOURCES = {"port": "serial", "recording": "replay"}  # where readings are, and for which device
ROWS_DEPTH = 256  # messages of rows that may wait: a quarter of a second of single rows at 1 kHz


class Driver(Part):
    """What the driver does, in whichever node it is put.

    `listeners` are called with each frame, its layout's id and its header, in the device's thread,
    before it is published; so are `row_listeners` with rows of frames, where delivery is `rows`.
    """

    name, specs = "driver", SPECS
    alone = True  # in its process

    def __init__(self, node: Node):
        super().__init__(node)
        self.listeners: list[Callable[[Frame, str, Header], None]] = []
        self.row_listeners: list[Callable[[Frame, str, Header], None]] = []
        self._time, self._passing = NodeTime(node), PassingTime(node)
        self._device: Device | None = None
        self._layout: Layout  # of `configure`
        self._active = False
        self._said = ""  # the state that the log has told last
        self._conditions = Conditions(self._log)
        self._paces: dict[str, Pace] = defaultdict(Pace)  # of lines about each state
        self._simulated: dict[str, SimulatedTime] = {}
        self._temperature_stamp = 0.0
        self._publisher = publisher(node, VoltageFrame, "voltage_frame", 2)
        self._rows_publisher = publisher(node, VoltageFrame, "voltage_rows", ROWS_DEPTH)
        self._temperature_publisher = publisher(node, Temperature, "temperature", 2)
        self._touches = TouchListener(node, self.parameters["frame_id"], self._press)
        self._order = ScanOrder(node, self._set_scan)
        node.create_service(Trigger, "~/restart", self._restart)
        hardware_id = self.parameters["hardware_id"] or self.parameters["frame_id"]
        self._diagnostics = Diagnostics(node, "device", lambda: hardware_id, self.report)
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Read the layout and make the device; InputError where it would be simulated unasked."""
        for name, needed in _SOURCES.items():
            if self.parameters[name] and "device" not in self.parameters.given:
                raise InputError(
                    f"{name}: {self.parameters[name]} needs device:={needed}, it is "
                    f"{self.parameters['device']}: data would be simulated"
                )
        self._layout = load_layout(self.parameters["layout"])
        self._device = self._make_device(self.parameters.values)
        self._choose_order(self.parameters.values)

    def activate(self) -> None:
        """Open the device."""
        assert self._device is not None  # it was configured
        self._active = True
        self._open(self._device, self.parameters.values)
        self._log.info(
            f"{self.parameters['device']} device, layout {self._layout.id} with "
            f"{self._layout.electrodes} electrodes"
        )
        if nature(self.parameters.values):
            self._log.warning(f"{nature(self.parameters.values)}, no sensor is read")

    def deactivate(self) -> None:
        """Close the device; no frame comes afterwards."""
        self._active = False
        if self._device is not None:
            self._device.close()

    def cleanup(self) -> None:
        """Forget the device."""
        self._touches.listen(None)
        self._order.follow(None)
        self._device = None

    def report(self) -> Report:
        """State of the device for /diagnostics; a change is also logged."""
        device = self._device  # another thread may take it away
        if device is None:
            return Report(diagnostics.WARN, "not configured")
        status = device.status()
        self._publish_temperature(device)
        level = level_of(status)
        own = self._own_troubles(status.dead)
        kind = nature(self.parameters.values)
        texts = [trouble.text for trouble in own]
        said = any(text.startswith(status.message) for text in texts)  # both tell of the time
        message = "; ".join(filter(None, [kind, "" if said else status.message, *texts]))
        troubles = (*status.troubles, *own)
        for trouble in troubles:
            level = max(level, diagnostics.level_of(trouble))
        if status.state not in ("closed", self._said) and self._paces[status.state].allows():
            self._said = status.state
            log_at(self._log, level, f"{status.state}: {message}")
            self._conditions.have_been_said(troubles)
        elif status.state != "closed":
            self._conditions.say(troubles)
        figures = diagnostics.in_milliseconds(status.counters)
        return Report(
            level,
            message,
            {"state": status.state, "device": self.parameters["device"], **figures},
        )

    def _own_troubles(self, dead: tuple[int, ...]) -> list[Trouble]:
        found = troubles_of_time(self._node)
        if self._passing.stands_still():
            found.append(Trouble("still", True, STANDS_STILL))
        if dead:
            electrodes = ", ".join(map(str, dead))
            text = f"electrodes that look dead: {electrodes}"
            found.append(Trouble("dead", False, text, which=electrodes))
        others = self._node.count_publishers(self._publisher.topic_name) - 1
        if others > 0:
            text = (
                f"{others} other publishers of {self._publisher.topic_name}: frames are mixed, unless "
                "they rest or have just died"
            )
            found.append(Trouble("publishers", True, text))
        return found

    def _make_device(self, values: dict[str, Any]) -> Device:
        fake = values["device"] == "fake"
        named = {f.name: values[f.name] for f in fields(DeviceSettings) if f.name in values}
        named["scene"] = load_scene(values["scene"]) if fake else None
        named["layout"], named["time"] = self._layout, self._time
        named["beside"] = not self.alone
        device = make_device(DeviceSettings(**named))
        device.set_streaming(values["streaming"])
        self._touches.listen(self._layout if fake and named["scene"].live else None)
        return device

    def _choose_order(self, values: dict[str, Any]) -> None:
        """Let contacts choose the order of the scan where they are to, and nothing else does."""
        fixed = values["device"] == "replay" or values["protocol"] != "binary"
        chosen = values["scan"] or self._layout.scan or fixed
        adaptive = values["order"] == "adaptive" and not chosen
        self._order.follow(self._layout if adaptive else None)

    def _change(self, changed: set[str], values: dict[str, Any]) -> None:
        if self._device is None:
            return
        if changed <= {"rate", "streaming", "scan"}:
            if "scan" in changed:
                self._device.set_scan(values["scan"] or self._layout.scan)
                self._choose_order(values)
            if "rate" in changed:
                self._device.set_rate(values["rate"])
            if "streaming" in changed:
                self._device.set_streaming(values["streaming"])
            return
        device = self._make_device(values)
        self._device.close()
        self._device = device
        self._choose_order(values)
        if self._active:
            self._open(device, values)

    def _open(self, device: Device, values: dict[str, Any]) -> None:
        """Open the device, for frames or rows of them, too."""
        device.open(self._on_frame, self._on_rows if values["delivery"] == "rows" else None)

    def _press(self, touches: list[Touch]) -> list[str]:
        press = getattr(self._device, "press", None)  # simulated ones have it
        return [] if press is None else press(touches)

    def _set_scan(self, order: tuple[int, ...]) -> None:
        if self._device is not None:
            self._device.set_scan(order)

    def _restart(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        device, values = self._device, self.parameters.values
        if not self._active or device is None:
            response.message = "the driver is not active"
            return response
        device.close()
        try:
            device = self._device = self._make_device(values)
        except InputError as error:
            response.message = str(error)
            self._open(device, values)
            return response
        self._choose_order(values)
        self._open(device, values)
        response.success, response.message = outcome(device, lambda: not self._active)
        return response

    def _on_frame(self, frame: Frame) -> None:
        self._order.next()
        self._hand_on(frame, self.listeners, self._publisher)

    def _on_rows(self, rows: Frame) -> None:
        self._hand_on(rows, self.row_listeners, self._rows_publisher)

    def _hand_on(self, frame: Frame, listeners: list[Callable], publisher: Publisher) -> None:
        if is_timeless(self._node):  # no stamp would be right
            return
        if self.parameters["device"] == "serial":
            frame = replace(frame, stamp=self._stamp_of(frame.stamp, publisher))
        header = make_header(frame.stamp, self.parameters["frame_id"])
        for listener in listeners:
            listener(frame, self._layout.id, header)
        if publisher.get_subscription_count() > 0:
            publisher.publish(frame_to_message(frame, self._layout.id, header))

    def _stamp_of(self, when: float, publisher: Publisher) -> float:
        """The stamp, s, of what hardware has read at a Unix time, s."""
        if not clock_of(self._node).ros_time_is_active:
            return when
        simulated = self._simulated.setdefault(publisher.topic_name, SimulatedTime())
        return simulated.of(when, seconds_now(self._node))

    def _publish_temperature(self, device: Device) -> None:
        """Publish what a device with a thermometer has told since the last time."""
        told = getattr(device, "temperature", None)
        if told is None or is_timeless(self._node):
            return
        if told[1] != self._temperature_stamp:
            self._temperature_stamp = told[1]
            stamp = self._stamp_of(told[1], self._temperature_publisher)
            header = make_header(stamp, self.parameters["frame_id"])
            self._temperature_publisher.publish(Temperature(header=header, temperature=told[0]))


class SimulatedTime:
    """Stamps in simulated time of what hardware has read, of one topic: as long ago there as in real time.

    None before the one before, though simulated time goes on in steps, unless it was set back.
    """

    def __init__(self) -> None:
        self._now = self._stamp = 0.0

    def of(self, stamp: float, now: float) -> float:
        """What a Unix time, s, is in simulated time, in which it is `now`."""
        earliest = self._stamp if now >= self._now else 0.0
        self._now = now
        self._stamp = max(earliest, now - (time.time() - stamp))
        return self._stamp


def main(args: list[str] | None = None, managed: bool = False) -> int:
    """Run the node."""
    specs = {Driver.name: SPECS}
    return run(lambda make: [make(Driver)], args, __doc__, specs, managed=managed)
