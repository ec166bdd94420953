"""Nodes with `use_sim_time`: a simulated sensor lives in the time of /clock, and ages are measured with it."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import ClockType, ROSClock
from rclpy.time import Time
from ros_support import ends_cleanly
from rosgraph_msgs.msg import Clock

from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of
from tomotactile_ros.nodes.node_time import NodeTime

RECONSTRUCTION = "reconstruction: reconstruction"
TIMELESS = DiagnosticStatus.ERROR, "nobody publishes /clock"


class SimulatedClock:
    """Publishes /clock, `pace` times as fast as time goes by, in steps of 20 ms of real time; 0: not at all."""

    def __init__(self, probe, now=1000.0, pace=0.0):
        self.now, self.pace = now, pace
        self._publisher = probe.node.create_publisher(Clock, "/clock", 10)
        probe.node.create_timer(0.02, self._tick)

    def _tick(self):
        if self.pace:
            self.now += 0.02 * self.pace
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(int(self.now * 1e9), 10**9)
            self._publisher.publish(message)


def test_time_is_set_by_a_step_out_of_turn_and_not_by_each_of_a_fast_simulation():
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    time_there = NodeTime(SimpleNamespace(get_clock=lambda: clock))
    for to, since in (
        (100, 100),
        (110, 100),
        (120.5, 100),
        (5000, 5000),
        (5000.01, 5000),
        (50, 50),
    ):
        clock.set_ros_time_override(Time(seconds=to, clock_type=ClockType.ROS_TIME))
        assert time_there.since() == since


def of_time(messages):
    return [stamp_of(message.header) for message in messages]


def test_a_simulated_sensor_lives_in_simulated_time(probe, start, scene):
    """Frames, rows and contacts follow each other as they do in real time, whatever its pace; before the
    first /clock there are none. At a tenth of it, fifteen frames came in a real second."""
    sensor = start("tactile", {"scene": scene, "use_sim_time": "true", "delivery": "rows"})
    clock = SimulatedClock(probe)
    frames, rows = (probe.listen(VoltageFrame, f"voltage_{w}", 200) for w in ("frame", "rows"))
    contacts = probe.listen(ContactArray, "contacts", 200)
    ros_checks.check_diagnostics(probe, "driver: device", *TIMELESS)
    assert max(line.count("/clock") for line in sensor.output.splitlines()) == 1
    assert not frames and not rows
    clock.pace = 0.1

    def known():
        return [message for message in contacts if message.contacts]

    probe.until(lambda: len(known()) > 8 and len(frames) > 4, "contacts")
    ros_checks.check_rate(frames)
    assert 1000.0 < of_time(frames)[0] and of_time(frames)[-1] <= clock.now
    assert np.all(np.diff(of_time(rows)) > 7.9e-3)
    seen = known()
    assert {c.id for m in seen for c in m.contacts} == {seen[0].contacts[0].id}
    lasted = of_time(seen)[-1] - of_time(seen)[0]
    aged = seen[-1].contacts[0].age - seen[0].contacts[0].age
    assert aged == pytest.approx(lasted, abs=1e-3)
    velocity = seen[-1].contacts[0].velocity
    assert np.hypot(velocity.x, velocity.y) < 0.02
    clock.now = 500.0  # a simulation that begins anew
    probe.until(lambda: 500.0 < of_time(frames)[-1] < 900.0, "a frame of the new simulation")
    probe.until(lambda: any(500.0 < t < 900.0 for t in of_time(known())), "contacts in it")
    clock.now, before = 5000.0, frames[-1].sequence  # nor is one that is set ahead a loss
    probe.until(lambda: of_time(frames)[-1] >= 5000.0, "a frame after that")
    assert frames[-1].sequence - before < 100
    ends_cleanly(sensor)


def test_nothing_grows_old_while_a_slow_simulation_goes_on(probe, start, scene):
    """At a hundredth of real time a frame lasts six seconds: nobody is late, nothing is taken back; where
    time stands still it is."""
    sensor = start("tactile", {"scene": scene, "use_sim_time": "true"})
    heard, clock = probe.listen(ContactArray, "contacts", 200), SimulatedClock(probe, pace=1.0)
    probe.until(lambda: any(m.contacts for m in heard), "contacts")
    clock.pace = 0.01
    del heard[:]
    begun = clock.now
    probe.until(lambda: clock.now > begun + 0.05 and heard, "five seconds")
    assert all(m.state == ContactArray.VALID for m in heard)
    clock.pace = 0.0
    probe.until(lambda: heard[-1].state == ContactArray.STALE, "contacts that are taken back")
    assert "no contacts for" in heard[-1].reason
    still = DiagnosticStatus.ERROR, "simulated time stands still"
    ros_checks.check_diagnostics(probe, RECONSTRUCTION, *still)
    ros_checks.check_diagnostics(probe, "driver: device", *still)
    ends_cleanly(sensor)


def test_a_recording_goes_on_as_fast_as_the_simulation(probe, start, scene, tmp_path):
    """At half of real time it kept the pace of that, with an error about row_period."""
    given = ros_checks.arguments_of("replay", tmp_path, "equal-8x8", scene)
    given |= {"use_sim_time": "true", "delivery": "rows", "loop": "true"}
    driver, reconstruction = start("driver", given), start("reconstruction", {"use_sim_time": True})
    clock = SimulatedClock(probe, pace=0.5)
    frames = probe.listen(VoltageFrame, "voltage_frame", 200)
    contacts = probe.listen(ContactArray, "contacts", 200)
    probe.until(lambda: len(frames) > 20 and any(m.contacts for m in contacts), "contacts")
    ros_checks.check_rate(frames)
    assert of_time(frames)[-1] <= clock.now < of_time(frames)[-1] + 1.0
    ros_checks.check_images(probe, RECONSTRUCTION)
    del frames[:]
    clock.now = 500.0
    probe.until(lambda: len([t for t in of_time(frames) if t < 900.0]) > 20, "frames")
    ros_checks.check_rate([m for m in frames if stamp_of(m.header) < 900.0])
    assert "row_period" not in driver.output + reconstruction.output
    ends_cleanly(driver)
    ends_cleanly(reconstruction)


def test_what_has_come_before_there_is_a_time_is_not_used(probe, start, scene):
    """How old it is nobody knows: contacts of it were valid."""
    start("driver", {"scene": scene, "delivery": "rows"})
    reconstruction = start("reconstruction", {"use_sim_time": True})
    clock = SimulatedClock(probe)
    frames = probe.listen(VoltageFrame, "voltage_frame", 200)
    contacts = probe.listen(ContactArray, "contacts", 200)
    probe.until(lambda: frames, "frames")
    ros_checks.check_diagnostics(probe, RECONSTRUCTION, *TIMELESS)
    assert not contacts
    clock.now, clock.pace = time.time(), 1.0
    probe.until(lambda: any(m.contacts for m in contacts), "contacts")
    ends_cleanly(reconstruction)
