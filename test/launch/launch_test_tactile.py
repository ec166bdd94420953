"""launch/tactile.launch.py, plain, managed, in one process, with a serial line and with a recording:
what test_nodes_chain.py and test_nodes_serial.py check, under launch."""

import os
import signal
import sys
import tempfile
import unittest
from pathlib import Path

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[:2]]

import launch_testing.actions
import launch_testing.asserts
import ros_checks
from launch.actions import GroupAction
from launch_ros.actions import PushRosNamespace
from launch_support import include, reserve_domain
from ros_support import Probe, Process, processes_of

import launch

LOOP = "/**/driver: {ros__parameters: {loop: true}}\n"


@launch_testing.parametrize(
    "kind",
    [
        {},
        {"lifecycle": "true"},
        {"composed": "true", "lifecycle": "true"},
        {"device": "serial"},
        {"device": "replay"},
    ],
)
def generate_test_description(kind):
    domain, folder = reserve_domain(), Path(tempfile.mkdtemp())
    scene = ros_checks.write_scene(folder)
    files, device = None, kind.get("device")
    if device is None:
        kind = {"scene": scene, **kind}
    else:
        layout, parameters = ros_checks.write_curved_layout(folder), folder / "parameters.yaml"
        parameters.write_text(LOOP, encoding="utf-8")
        source = ros_checks.arguments_of(device, folder, layout, scene)
        kind = {"layout": layout, "params_file": str(parameters), **source}
        files = (folder, layout, scene)
    arguments = {"frame_id": "skin_frame", **kind}
    # as files of robots do: what is started again has to be in the group, too
    group = [PushRosNamespace("skin"), *include("tactile.launch.py", domain, arguments)]
    actions = [GroupAction(group), launch_testing.actions.ReadyToTest()]
    programs = ["tactile"] if "composed" in kind else ["driver", "reconstruction"]
    context = {"domain": domain, "programs": programs, "device": device, "files": files}
    return launch.LaunchDescription(actions), context


class TestWhileRunning(unittest.TestCase):
    def test_topics_contact_recovery_and_tare(self, domain, programs, device, files):
        if device == "serial":
            emulator = Process(ros_checks.emulator(*files), domain, warm=False)
            self.addCleanup(emulator.kill)
        probe = Probe(domain)
        self.addCleanup(probe.close)

        def check():
            ros_checks.check_topics(probe, "/skin", "skin_frame")
            ros_checks.check_contact(probe, "/skin", bent=device is not None)

        check()
        if device is not None:
            ros_checks.check_surface(probe, "/skin")
            programs = []
        for name in programs:
            (victim,) = processes_of(name, domain)
            os.kill(victim, signal.SIGKILL)
            probe.until(
                lambda name=name, victim=victim: processes_of(name, domain) not in ([], [victim]),
                f"new {name}",
            )
            check()
        ros_checks.check_tare(probe, "/skin")


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_exit_codes_are_clean(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, [0, -signal.SIGKILL])
