"""A recorded bag, played by the driver, gives the images of the recording, byte by byte; with ROS's
own reader and without."""

import sys

import pytest

rclpy = pytest.importorskip("rclpy")
rosbags = pytest.importorskip("rosbags")

import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import ros_checks
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from tomotactile_ros.devices import Frame, bag
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import frame_to_message, make_header, stamp_of
from tomotactile_ros.support.errors import InputError

COUNT = 5
DEEP = 100


def record(messages, folder, topics=("/voltage_frame",)) -> None:
    """Write frames as a rosbag2, in turn to its topics."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = "tomotactile_ros/msg/VoltageFrame"
    text = (Path(__file__).resolve().parent.parent / "msg/VoltageFrame.msg").read_text("utf-8")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, name))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = [writer.add_connection(t, name, typestore=store) for t in topics]
        for message, connection in zip(messages, itertools.cycle(connections), strict=False):
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
    small = {"layout": "equal-4x4"}
    driver = start("driver", {"scene": scene, "rate": 5, **small})
    reconstruction = start("reconstruction", small)
    frames = probe.listen(VoltageFrame, "/voltage_frame", DEEP)
    images = probe.listen(Image, "/pressure", DEEP)

    def complete():
        """Frames whose sequence numbers follow each other and whose images have come, too:
        what is recorded must not miss any, or those that play it would say so."""
        shown = {(i.header.stamp.sec, i.header.stamp.nanosec): i for i in images}
        run = []
        for frame in frames:
            image = shown.get((frame.header.stamp.sec, frame.header.stamp.nanosec))
            if image is None or (run and frame.sequence != run[-1][0].sequence + 1):
                run = []
            if image is not None:
                run.append((frame, image))
            if len(run) == COUNT:
                break
        return run

    probe.until(lambda: len(complete()) == COUNT, f"{COUNT} frames in a row with images")
    recorded = complete()
    assert driver.stop() == 0
    assert len(set(pictures(image for _, image in recorded))) == COUNT  # the noise differs
    (row_period,) = {frame.row_period for frame, _ in recorded}
    assert row_period == pytest.approx(0.2 / 16)
    record([frame for frame, _ in recorded], tmp_path / "bag")

    begin = probe.node.get_clock().now().nanoseconds  # what still comes has older stamps

    def replayed():
        return {bytes(i.data) for i in images if stamp_of(i.header) * 1e9 >= begin}

    parameters = {"device": "replay", "recording": tmp_path / "bag", "rate": 5, "loop": "true"}
    parameters |= small
    start("driver", parameters)
    expected = set(pictures(image for _, image in recorded))
    probe.until(lambda: expected <= replayed(), "replayed images")
    assert replayed() == expected

    def since():
        return {frame.row_period for frame in frames if stamp_of(frame.header) * 1e9 >= begin}

    probe.until(since, "replayed frames")  # the probe may find the driver later than the node does
    assert since() == {row_period}
    assert reconstruction.running()

    start("reconstruction", {"use_sim_time": True, **small}, namespace="/played")
    Player(probe, tmp_path / "bag", "/played")
    played = probe.listen(Image, "/played/pressure", DEEP)

    def with_stamps(found):
        return {(i.header.stamp.sec, i.header.stamp.nanosec, bytes(i.data)) for i in found}

    wanted = with_stamps(image for _, image in recorded)
    probe.until(lambda: wanted <= with_stamps(played), "images of the bag that is played")
    assert with_stamps(played) == wanted
    ros_checks.check_images(probe, "played/reconstruction: reconstruction")


def stand_in_for_rosbag2_py() -> SimpleNamespace:
    """The part of rosbag2_py that is used, where it is not installed."""
    from rosbags.rosbag2 import Reader

    class SequentialReader:
        def open(self, storage, converter):
            with Reader(storage.uri) as reader:
                self._topics = [
                    SimpleNamespace(name=c.topic, type=c.msgtype) for c in reader.connections
                ]
                self._left = [(c.topic, bytes(data), time) for c, time, data in reader.messages()]

        def get_all_topics_and_types(self):
            return self._topics

        def set_filter(self, wanted):
            self._left = [entry for entry in self._left if entry[0] in wanted.topics]

        def has_next(self):
            return bool(self._left)

        def read_next(self):
            return self._left.pop(0)

    return SimpleNamespace(
        SequentialReader=SequentialReader,
        StorageOptions=lambda uri, storage_id: SimpleNamespace(uri=uri),
        ConverterOptions=lambda given, wanted: None,
        StorageFilter=lambda topics: SimpleNamespace(topics=topics),
    )


def test_a_bag_of_two_sensors_is_the_same_to_the_reader_of_ros_and_without(tmp_path, monkeypatch):
    frames = []
    for k in range(6):
        frame = Frame(
            np.full((2, 2), k, np.float32), np.arange(2, dtype=np.uint16), k, k + 1.0, 3.3
        )
        frames.append(frame_to_message(frame, "a layout", make_header(k + 1.0, "palm")))
    record(frames, tmp_path / "bag", ["/left/voltage_frame", "/right/voltage_frame"])
    try:
        import rosbag2_py  # noqa: F401
    except ImportError:
        monkeypatch.setitem(sys.modules, "rosbag2_py", stand_in_for_rosbag2_py())
    for has_ros in (True, False):
        monkeypatch.setattr(bag, "_has_ros", lambda has_ros=has_ros: has_ros)
        right = list(bag.read_bag(tmp_path / "bag", "/right/voltage_frame"))
        assert [m.sequence for m in right] == [1, 3, 5]
        assert [stamp_of(m.header) for m in right] == [2.0, 4.0, 6.0]
        assert [list(m.voltages) for m in right] == [[k] * 4 for k in (1, 3, 5)]
        with pytest.raises(InputError, match="/left/voltage_frame, /right/voltage_frame"):
            list(bag.read_bag(tmp_path / "bag"))
        with pytest.raises(InputError, match="/up/voltage_frame"):
            list(bag.read_bag(tmp_path / "bag", "/up/voltage_frame"))
