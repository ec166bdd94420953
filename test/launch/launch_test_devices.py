"""launch/tactile.launch.py with a serial line and with a recording: what test_nodes_devices.py
checks."""

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

LOOP = "/**/driver: {ros__parameters: {loop: true}}\n"


@launch_testing.parametrize("device", ["serial", "replay"])
def generate_test_description(device):
    domain, folder = reserve_domain(), Path(tempfile.mkdtemp())
    layout, scene = ros_checks.write_curved_layout(folder), ros_checks.write_scene(folder)
    parameters = folder / "parameters.yaml"
    parameters.write_text(LOOP, encoding="utf-8")
    arguments = {
        "layout": layout,
        "params_file": str(parameters),
        **ros_checks.arguments_of(device, folder, layout, scene),
    }
    plug_in = ros_checks.plug_in if device == "serial" else None
    actions = [
        *include("tactile.launch.py", domain, arguments),
        launch_testing.actions.ReadyToTest(),
    ]
    context = {"domain": domain, "plug_in": plug_in, "files": (folder, layout, scene)}
    return launch.LaunchDescription(actions), context


class TestWhileRunning(unittest.TestCase):
    def test_topics_contact_surface_and_tare(self, domain, plug_in, files):
        if plug_in is not None:
            self.addCleanup(plug_in(*files, domain).kill)
        probe = Probe(domain)
        self.addCleanup(probe.close)
        ros_checks.check_topics(probe)
        ros_checks.check_contact(probe, bent=True)
        ros_checks.check_surface(probe)
        ros_checks.check_tare(probe)


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_exit_codes_are_clean(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, [0])
