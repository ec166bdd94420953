"""launch/two_sensors.launch.py: each side has its own scene and frame, and the skin has both."""

import sys
import tempfile
import unittest
from pathlib import Path

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[:2]]

import launch_testing.actions
import launch_testing.asserts
import ros_checks
from launch_support import include, reserve_domain
from ros_support import Probe

import launch


def generate_test_description():
    domain = reserve_domain()
    scene = ros_checks.write_scene(Path(tempfile.mkdtemp()))
    arguments = {"left_scene": scene, "robot": "false"}  # nothing is said of the right one
    actions = [
        *include("two_sensors.launch.py", domain, arguments),
        launch_testing.actions.ReadyToTest(),
    ]
    return launch.LaunchDescription(actions), {"domain": domain}


class TestWhileRunning(unittest.TestCase):
    def test_sides_do_not_share_arguments_and_make_one_skin(self, domain):
        from tomotactile_ros.msg import ContactArray

        probe = Probe(domain)
        self.addCleanup(probe.close)
        ros_checks.check_contact(probe, "/left")
        for side in ("left", "right"):
            heard = probe.wait_for(ContactArray, f"/{side}/contacts")
            self.assertEqual(heard.header.frame_id, f"{side}_link")
        self.assertEqual(probe.get_parameter("/right/driver", "scene"), "default")
        skin = probe.wait_for(
            ContactArray, "/skin/contacts", lambda m: m.state == ContactArray.VALID and m.contacts
        )
        self.assertEqual(skin.header.frame_id, "base_link")


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_exit_codes_are_clean(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, [0])
