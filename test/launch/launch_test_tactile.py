"""launch/tactile.launch.py, plain, managed, in one process: what test_nodes_chain.py checks, under
launch."""

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
from ros_support import Probe, processes_of

import launch


@launch_testing.parametrize(
    "kind", [{}, {"lifecycle": "true"}, {"composed": "true", "lifecycle": "true"}]
)
def generate_test_description(kind):
    domain = reserve_domain()
    scene = ros_checks.write_scene(Path(tempfile.mkdtemp()))
    arguments = {"scene": scene, "frame_id": "skin_frame", **kind}
    # as files of robots do: what is started again has to be in the group, too
    group = [PushRosNamespace("skin"), *include("tactile.launch.py", domain, arguments)]
    actions = [GroupAction(group), launch_testing.actions.ReadyToTest()]
    programs = ["tactile"] if "composed" in kind else ["driver", "reconstruction"]
    return launch.LaunchDescription(actions), {"domain": domain, "programs": programs}


class TestWhileRunning(unittest.TestCase):
    def test_topics_contact_recovery_and_tare(self, domain, programs):
        probe = Probe(domain)
        self.addCleanup(probe.close)
        ros_checks.check_topics(probe, "/skin", "skin_frame")
        ros_checks.check_contact(probe, "/skin")
        for name in programs:
            (victim,) = processes_of(name, domain)
            os.kill(victim, signal.SIGKILL)
            probe.until(
                lambda name=name, victim=victim: processes_of(name, domain) not in ([], [victim]),
                f"new {name}",
            )
            ros_checks.check_topics(probe, "/skin", "skin_frame")
            ros_checks.check_contact(probe, "/skin")
        ros_checks.check_tare(probe, "/skin")


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_exit_codes_are_clean(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, [0, -signal.SIGKILL])
