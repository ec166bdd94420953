"""Driver and reconstruction as processes of their own over DDS, plain, composed and managed."""

import signal

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from process_support import python
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import ends_cleanly
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from tomotactile_ros.msg import ContactArray, VoltageFrame

SMALL = {"layout": "equal-4x4"}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_two_processes_make_images_where_the_scene_presses_and_outlive_each_other(
    probe, start, scene
):
    driver = start("driver", {"scene": scene}, warm=False)
    reconstruction = start("reconstruction", warm=False)
    ros_checks.check_topics(probe)
    ros_checks.check_contact(probe)
    ros_checks.check_stamps(probe, 0.5)
    ros_checks.check_diagnostics(
        probe, "driver: device", DiagnosticStatus.OK, "simulated, 15.625 frames/s"
    )
    ros_checks.check_images(probe, "reconstruction: reconstruction")
    ros_checks.check_tare(probe)
    driver.kill()
    ros_checks.check_diagnostics(
        probe, "reconstruction: reconstruction", DiagnosticStatus.ERROR, "no frames"
    )
    driver = start("driver", {"scene": scene})
    ros_checks.check_contact(probe)
    reconstruction.kill()
    last = probe.wait_for(VoltageFrame, "/voltage_frame").sequence
    probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: m.sequence > last + 3)
    reconstruction = start("reconstruction")
    ros_checks.check_contact(probe)
    ends_cleanly(reconstruction)
    ends_cleanly(driver, signal.SIGTERM)


def test_images_and_contacts_are_published_as_asked_for(probe, start, scene):
    common = {"scene": scene, **SMALL}
    for name, wanted in {"contacts": {"image": "none"}, "images": {"contacts": False}}.items():
        start("tactile", common | wanted, namespace=f"/{name}")
    contacts = probe.listen(ContactArray, "/images/contacts")
    images = probe.listen(Image, "/contacts/pressure")
    image = probe.wait_for(Image, "/images/pressure", lambda image: max(image.data) > 0)
    assert np.nanmax(np.frombuffer(image.data, np.float32)) > 0
    probe.wait_for(ContactArray, "/contacts/contacts", lambda m: m.complete and len(m.contacts) > 0)
    assert not contacts and not images


def test_contacts_come_within_the_deadline_and_say_so(probe, start, scene):
    """A tenth of a millisecond is none: what a glance tells, and what searches have found since."""
    start(
        "tactile",
        {
            "scene": scene,
            "layout": "equal-4x4",
            "profile": "accurate",
            "delivery": "frames",
            "deadline": 1e-4,
        },
    )
    probe.wait_for(ContactArray, "/contacts", lambda m: len(m.contacts) > 0 and not m.complete)
    cut = "too slow for it, or too much touches at once"
    ros_checks.check_diagnostics(
        probe, "reconstruction: reconstruction", DiagnosticStatus.WARN, cut
    )


def test_two_sensors_by_namespace_with_names_changed(probe, start, scene):
    start("tactile", {"scene": scene, "frame_id": "left_skin", **SMALL}, namespace="/left")
    start(
        "tactile",
        {"scene": "idle", **SMALL},
        namespace="/right",
        remaps={"contacts": "touches", "reconstruction:__node": "imaging"},
    )
    ros_checks.check_contact(probe, "/left")
    idle = probe.wait_for(ContactArray, "/right/touches")
    assert (idle.header.frame_id, list(idle.contacts)) == ("tactile_link", [])
    left = probe.wait_for(ContactArray, "/left/contacts")
    assert left.header.frame_id == "left_skin"
    assert probe.call(Trigger, "/right/imaging/tare").success
    for markers, suits in (
        ("/left/layout_markers", lambda m: m.markers[0].header.frame_id == "left_skin"),
        ("/right/layout_markers", lambda m: m.markers[0].header.frame_id == "tactile_link"),
    ):
        probe.wait_for(MarkerArray, markers, suits, LATCHED)


def test_managed_nodes_follow_their_transitions(probe, start, scene):
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    def state(node):
        return probe.call(GetState, f"/{node}/get_state").current_state.id

    def change(node, transition, goal):
        request = ChangeState.Request(transition=Transition(id=transition))
        probe.call(ChangeState, f"/{node}/change_state", request)
        assert state(node) == goal

    nodes = {
        "driver": start("driver_lifecycle", {"scene": scene, "rate": 20.0, **SMALL}, warm=False),
        "reconstruction": start("reconstruction_lifecycle", SMALL, warm=False),
    }
    for node in nodes:
        assert state(node) == State.PRIMARY_STATE_UNCONFIGURED
        change(node, Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE)
    assert "not active" in probe.call(Trigger, "/driver/restart").message
    for node in nodes:
        change(node, Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
    ros_checks.check_contact(probe)
    change("driver", Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
    frames = probe.listen(VoltageFrame, "/voltage_frame")
    ros_checks.check_diagnostics(
        probe, "reconstruction: reconstruction", DiagnosticStatus.ERROR, "nothing arrives"
    )
    assert not frames
    change("driver", Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED)
    change("driver", Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE)
    change("driver", Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
    ros_checks.check_contact(probe)
    contacts = probe.listen(ContactArray, "/contacts")
    wrenches = probe.listen(WrenchStamped, "/wrench")
    probe.until(lambda: wrenches and wrenches[-1].wrench.force.z < 0, "wrench")
    change("reconstruction", Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
    probe.until(lambda: contacts and contacts[-1].state == ContactArray.STALE, "last word")
    assert contacts[-1].reason == "the reconstruction was stopped"
    probe.until(lambda: np.isnan(wrenches[-1].wrench.force.z), "unknown wrench")
    for process in nodes.values():
        ends_cleanly(process)


STOPS = """
import signal, sys
from tomotactile_ros.nodes.running import run

def make_nodes():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:  # as where an object is deleted: it goes no further
        signal.raise_signal(signal.SIGINT)
        print("cleaned")
    return []

sys.exit(run(make_nodes, [], "", {}))
"""


def test_a_stop_counts_once_and_is_not_lost():
    """The second of two signals leaves alone what the first one cleans up.

    In a process of its own: rclpy shuts down all contexts some time after a signal, those of the
    next test, too.
    """
    done = python("-c", STOPS)
    assert (done.returncode, done.stdout) == (0, "cleaned\n"), done


def test_a_context_that_is_shut_down_meanwhile_is_no_failure():
    """rclpy's thread of signals can shut it down after `try_shutdown` has asked whether it is."""
    twice = "import rclpy.context; rclpy.context.Context.try_shutdown = lambda c: (c.shutdown(), c.shutdown())"
    done = python("-c", twice + STOPS)
    assert (done.returncode, done.stdout) == (0, "cleaned\n"), done


def test_a_managed_node_says_why_a_transition_cannot_be(probe, start):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    driver = start("driver_lifecycle", {"scene": "no-such-scene"})
    for number, why in (
        (Transition.TRANSITION_ACTIVATE, "transition 3 is not possible in state unconfigured"),
        (200, "transition 200 is not possible in state unconfigured"),
        (Transition.TRANSITION_CONFIGURE, "no-such-scene"),
    ):
        request = ChangeState.Request(transition=Transition(id=number))
        assert not probe.call(ChangeState, "/driver/change_state", request).success
        assert why in driver.output
    ends_cleanly(driver)


def test_a_managed_node_can_start_by_itself(probe, start, scene):
    start("tactile_lifecycle", {"scene": scene, "autostart": "true", **SMALL}, warm=False)
    ros_checks.check_contact(probe)
    refused = start("driver_lifecycle", {"scene": "no-such-scene", "autostart": "true"})
    assert refused.wait() == 2
    (line,) = refused.output.splitlines()
    assert "no-such-scene" in line
