"""Driver and reconstruction as processes of their own over DDS, plain, composed and managed."""

import signal

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from process_support import python
from ros_checks import LATCHED
from ros_support import ends_cleanly
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from tomotactile_ros.msg import ContactArray, VoltageFrame

SMALL = {"layout": "equal-4x4"}


STATUS = "reconstruction: reconstruction"


def test_two_processes_make_images_where_the_scene_presses_and_outlive_each_other(
    probe, start, scene
):
    driver = start("driver", {"scene": scene}, warm=False)
    reconstruction = start("reconstruction", warm=False)
    ros_checks.check_topics(probe)
    ros_checks.check_contact(probe)
    ros_checks.check_stamps(probe, 0.5)
    well = DiagnosticStatus.OK, "simulated, 15.625 frames/s"
    ros_checks.check_diagnostics(probe, "driver: device", *well)
    ros_checks.check_images(probe, STATUS)
    ros_checks.check_tare(probe)
    driver.kill()
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, "no frames")
    driver = start("driver", {"scene": scene})
    ros_checks.check_contact(probe)
    reconstruction.kill()
    last = probe.wait_for(VoltageFrame, "/voltage_frame").sequence
    probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: m.sequence > last + 3)
    reconstruction = start("reconstruction")
    ros_checks.check_contact(probe)
    ends_cleanly(reconstruction)
    ends_cleanly(driver, signal.SIGTERM)


def test_sensors_by_namespace_publish_what_is_asked_for_with_names_changed(probe, start, scene):
    """The deadline of a tenth of a millisecond is none: what a glance tells, and what searches have
    found since."""
    given = {
        "left": {"scene": scene, "frame_id": "left_skin", "image": "none"},
        "right": {"scene": "idle", "contacts": False},
        "hasty": {
            "scene": scene, "profile": "accurate", "delivery": "frames", "deadline": 1e-4,
        },
    }  # fmt: skip
    renamed = {"contacts": "touches", "reconstruction:__node": "imaging"}
    for name, wanted in given.items():
        changed = renamed if name == "left" else {}
        start("tactile", {**SMALL, **wanted}, namespace=f"/{name}", remaps=changed)
    contacts = probe.listen(ContactArray, "/right/contacts")
    images = probe.listen(Image, "/left/pressure")
    found = probe.wait_for(ContactArray, "/left/touches", lambda m: m.complete and m.contacts)
    image = probe.wait_for(Image, "/right/pressure")
    assert np.nanmax(np.frombuffer(image.data, np.float32)) == 0.0
    for header in (
        found.header,
        probe.wait_for(MarkerArray, "/left/layout_markers", qos=LATCHED).markers[0].header,
    ):
        assert header.frame_id == "left_skin"
    assert image.header.frame_id == "tactile_link"
    assert probe.call(Trigger, "/right/reconstruction/tare").success
    assert "something presses" in probe.call(Trigger, "/left/imaging/tare").message
    probe.wait_for(ContactArray, "/hasty/contacts", lambda m: m.contacts and not m.complete)
    cut = DiagnosticStatus.WARN, "too slow for it, or too much touches at once"
    ros_checks.check_diagnostics(probe, f"hasty/{STATUS}", *cut)
    assert not contacts and not images


def test_managed_nodes_follow_their_transitions(probe, start, scene):
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    inactive, active = State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE
    unconfigured = State.PRIMARY_STATE_UNCONFIGURED
    goals = {
        Transition.TRANSITION_CONFIGURE: inactive,
        Transition.TRANSITION_ACTIVATE: active,
        Transition.TRANSITION_DEACTIVATE: inactive,
        Transition.TRANSITION_CLEANUP: unconfigured,
    }
    configure, activate, deactivate, clean_up = goals

    def state(node):
        return probe.call(GetState, f"/{node}/get_state").current_state.id

    def change(node, *transitions):
        for each in transitions:
            request = ChangeState.Request(transition=Transition(id=each))
            probe.call(ChangeState, f"/{node}/change_state", request)
            assert state(node) == goals[each]

    nodes = {
        "driver": start("driver_lifecycle", {"scene": scene, "rate": 20.0, **SMALL}, warm=False),
        "reconstruction": start("reconstruction_lifecycle", SMALL, warm=False),
    }
    for node in nodes:
        assert state(node) == unconfigured
        change(node, configure)
    assert "not active" in probe.call(Trigger, "/driver/restart").message
    for node in nodes:
        change(node, activate)
    ros_checks.check_contact(probe)
    change("driver", deactivate)
    frames = probe.listen(VoltageFrame, "/voltage_frame")
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, "nothing arrives")
    assert not frames
    change("driver", clean_up, configure, activate)
    ros_checks.check_contact(probe)
    contacts = probe.listen(ContactArray, "/contacts")
    wrenches = probe.listen(WrenchStamped, "/wrench")
    probe.until(lambda: wrenches and wrenches[-1].wrench.force.z < 0, "wrench")
    change("reconstruction", deactivate)
    probe.until(lambda: contacts and contacts[-1].state == ContactArray.STALE, "last word")
    assert contacts[-1].reason == "the reconstruction was stopped"
    probe.until(lambda: np.isnan(wrenches[-1].wrench.force.z), "unknown wrench")
    for process in nodes.values():
        ends_cleanly(process)


STOPS = """
import signal, sys
from tomotactile_ros.nodes.running import run

def make_nodes(make):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:  # as where an object is deleted: it goes no further
        signal.raise_signal(signal.SIGINT)
        print("cleaned")
    return []

sys.exit(run(make_nodes, [], "", {}))
"""


# rclpy's thread of signals can shut a context down after `try_shutdown` has asked whether it is
TWICE = """
import rclpy.context
rclpy.context.Context.try_shutdown = lambda context: (context.shutdown(), context.shutdown())
"""


@pytest.mark.parametrize("before", ["", TWICE], ids=["", "shut down meanwhile"])
def test_a_stop_counts_once_and_is_not_lost(before):
    """The second of two signals leaves alone what the first one cleans up.

    In a process of its own: rclpy shuts down all contexts some time after a signal, those of the
    next test, too.
    """
    done = python("-c", before + STOPS)
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
