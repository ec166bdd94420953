"""A recorded bag, played by the driver, gives the images of the recording, byte by byte."""

import pytest

rclpy = pytest.importorskip("rclpy")
rosbags = pytest.importorskip("rosbags")

import itertools
from pathlib import Path

import ros_checks
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of

COUNT = 5
DEEP = 100


def record(messages, folder) -> None:
    """Write frames as a rosbag2."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = "tomotactile_ros/msg/VoltageFrame"
    text = (Path(__file__).resolve().parent.parent / "msg/VoltageFrame.msg").read_text("utf-8")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, name))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/voltage_frame", name, typestore=store)
        for message in messages:
            stamp = message.header.stamp
            nanoseconds = stamp.sec * 10**9 + stamp.nanosec
            writer.write(connection, nanoseconds, serialize_message(message))


def pictures(images):
    return [bytes(image.data) for image in images]


class Player:
    """Publishes a bag as `ros2 bag play --clock` does: the bytes as they are, and the time of
    each."""

    def __init__(self, probe, folder, namespace):
        from rosbags.rosbag2 import Reader

        with Reader(folder) as reader:
            self._messages = [(time, bytes(data)) for _, time, data in reader.messages()]
        self._clock = probe.node.create_publisher(Clock, "/clock", 1)
        self._frames = probe.node.create_publisher(VoltageFrame, f"{namespace}/voltage_frame", 10)
        self._turn = itertools.cycle(self._messages)
        probe.node.create_timer(0.2, self._play)

    def _play(self):
        time, data = next(self._turn)
        seconds, nanoseconds = divmod(time, 10**9)
        self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))
        self._frames.publish(data)


def test_a_bag_replays_to_identical_images(probe, start, scene, tmp_path):
    driver = start("driver", {"scene": scene, "rate": 5})
    reconstruction = start("reconstruction")
    frames = probe.listen(VoltageFrame, "/voltage_frame", DEEP)
    images = probe.listen(Image, "/pressure", DEEP)

    def complete():
        """Frames in a row whose images have come, too."""
        shown = {(i.header.stamp.sec, i.header.stamp.nanosec): i for i in images}
        both = [f for f in frames if (f.header.stamp.sec, f.header.stamp.nanosec) in shown]
        return [(f, shown[f.header.stamp.sec, f.header.stamp.nanosec]) for f in both]

    probe.until(lambda: len(complete()) >= COUNT, f"{COUNT} frames with images")
    recorded = complete()[:COUNT]
    assert driver.stop() == 0
    assert len(set(pictures(image for _, image in recorded))) == COUNT  # the noise differs
    (row_period,) = {frame.row_period for frame, _ in recorded}
    assert row_period == pytest.approx(0.2 / 64)
    record([frame for frame, _ in recorded], tmp_path / "bag")

    begin = probe.node.get_clock().now().nanoseconds  # what still comes has older stamps

    def replayed():
        return {bytes(i.data) for i in images if stamp_of(i.header) * 1e9 >= begin}

    parameters = {"device": "replay", "recording": tmp_path / "bag", "rate": 5, "loop": "true"}
    start("driver", parameters)
    expected = set(pictures(image for _, image in recorded))
    probe.until(lambda: expected <= replayed(), "replayed images")
    assert replayed() == expected

    def since():
        return {frame.row_period for frame in frames if stamp_of(frame.header) * 1e9 >= begin}

    probe.until(since, "replayed frames")  # the probe may find the driver later than the node does
    assert since() == {row_period}
    assert reconstruction.running()

    start("reconstruction", {"use_sim_time": True}, namespace="/played")
    Player(probe, tmp_path / "bag", "/played")
    played = probe.listen(Image, "/played/pressure", DEEP)

    def with_stamps(found):
        return {(i.header.stamp.sec, i.header.stamp.nanosec, bytes(i.data)) for i in found}

    wanted = with_stamps(image for _, image in recorded)
    probe.until(lambda: wanted <= with_stamps(played), "images of the bag that is played")
    assert with_stamps(played) == wanted
    ros_checks.check_diagnostics(
        probe, "played/reconstruction: reconstruction", DiagnosticStatus.OK, "images are made"
    )
