"""launch/tactile.launch.py, plain and managed: what test_nodes_chain.py checks, under launch."""

import os
import signal
import sys
import tempfile
import unittest
from pathlib import Path

import pytest

for package in ("launch", "launch_ros", "launch_testing"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import launch_testing.actions
import launch_testing.asserts
import ros_checks
from launch_support import include, reserve_domain
from ros_support import Probe, processes_of

import launch


@pytest.mark.launch_test
@launch_testing.parametrize("lifecycle", ["false", "true"])
def generate_test_description(lifecycle):
    domain = reserve_domain()
    scene = ros_checks.write_scene(Path(tempfile.mkdtemp()))
    arguments = {"scene": scene, "namespace": "skin", "lifecycle": lifecycle}
    actions = [
        *include("tactile.launch.py", domain, arguments),
        launch_testing.actions.ReadyToTest(),
    ]
    return launch.LaunchDescription(actions), {"domain": domain}


class TestWhileRunning(unittest.TestCase):
    def test_topics_contact_recovery_and_tare(self, domain):
        probe = Probe(domain)
        self.addCleanup(probe.close)
        ros_checks.check_topics(probe, "/skin")
        ros_checks.check_contact(probe, "/skin")
        for name in ("driver", "reconstruction"):
            (victim,) = processes_of(name, domain)
            os.kill(victim, signal.SIGKILL)
            probe.until(
                lambda name=name, victim=victim: processes_of(name, domain) not in ([], [victim]),
                f"new {name}",
            )
            ros_checks.check_topics(probe, "/skin")
            ros_checks.check_contact(probe, "/skin")
        ros_checks.check_tare(probe, "/skin")


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_exit_codes_are_clean(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, [0, -signal.SIGKILL])
