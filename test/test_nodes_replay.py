"""A recorded bag, played by the driver, gives the images of the recording, byte by byte."""

import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rosbags")

import itertools

import ros_checks
from builtin_interfaces.msg import Time
from devices_support import write_bag
from rclpy.serialization import serialize_message
from ros_checks import stamp
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from tomotactile_ros.devices.bag import MESSAGE
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of

COUNT = 5
DEEP = 100


def record(messages, folder) -> None:
    """Write frames as a rosbag2."""
    times = [seconds * 10**9 + nanoseconds for seconds, nanoseconds in map(stamp, messages)]
    written = [*zip(times, map(serialize_message, messages))]
    write_bag(folder, MESSAGE, lambda types: written, ["/voltage_frame"], "sqlite3")


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
        shown = {stamp(image): image for image in images}
        run = []
        for frame in frames:
            image = shown.get(stamp(frame))
            if image is None or (run and frame.sequence != run[-1][0].sequence + 1):
                run = []
            if image is not None:
                run.append((frame, image))
            if len(run) == COUNT:
                break
        return run

    probe.until(lambda: len(complete()) == COUNT, f"{COUNT} frames in a row with images")
    recorded, pictures = zip(*complete(), strict=True)
    assert driver.stop() == 0
    expected = {bytes(image.data) for image in pictures}
    assert len(expected) == COUNT  # the noise differs
    (row_period,) = {frame.row_period for frame in recorded}
    assert row_period == pytest.approx(0.2 / 16)
    record(recorded, tmp_path / "bag")
    begin = probe.node.get_clock().now().nanoseconds  # what still comes has older stamps

    def replayed(messages):
        return [m for m in messages if stamp_of(m.header) * 1e9 >= begin]

    parameters = {"device": "replay", "recording": tmp_path / "bag", "rate": 5, "loop": "true"}
    start("driver", parameters | small)

    def seen():
        return {bytes(image.data) for image in replayed(images)}

    probe.until(lambda: expected <= seen(), "replayed images")
    assert seen() == expected
    # the probe may find the driver later than the node does
    probe.until(lambda: replayed(frames), "replayed frames")
    assert {frame.row_period for frame in replayed(frames)} == {row_period}
    assert reconstruction.running()

    start("reconstruction", {"use_sim_time": True, **small}, namespace="/played")
    Player(probe, tmp_path / "bag", "/played")
    played = probe.listen(Image, "/played/pressure", DEEP)

    def with_stamps(found):
        return {(*stamp(image), bytes(image.data)) for image in found}

    wanted = with_stamps(pictures)
    probe.until(lambda: wanted <= with_stamps(played), "images of the bag that is played")
    assert with_stamps(played) == wanted
    ros_checks.check_images(probe, "played/reconstruction: reconstruction")
