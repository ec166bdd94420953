"""Nodes as processes of their own, measured from outside over DDS: for ros_latency.py, several_sensors.py,
ids.py and the soak of faults.py."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor

from tomotactile_ros.nodes.live import use_own_domain
from tomotactile_ros.support.processes import Child, stop_all

FOLDER = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros")


def arguments(parameters: dict) -> list[str]:
    """Parameters on a node's command line."""
    return [word for item in parameters.items() for word in ("-p", "{}:={}".format(*item))]


def replayed(folder: str, layout: str, scene: str | Path) -> dict:
    """Parameters with which a recording of 250 simulated frames is played for ever; it is made in `folder`."""
    recording = Path(folder, "frames.npz")
    words = ["--layout", layout, "--scene", scene, "--frames", "250", "--out", recording]
    subprocess.run([FOLDER / "tomotactile", "simulate", *words], check=True)
    with np.load(recording) as file:  # its truth, read in every round, is no work of a sensor
        arrays = {key: value for key, value in file.items() if key != "truth"}
    np.savez(recording, **arrays)
    device = {"device": "replay", "recording": recording, "loop": True}
    return {"layout": layout, "profile": "fast", **device}


class Nodes:
    """Running nodes, and a listener to them.

    Parameters
    ----------
    commands : a program of this package and its ROS arguments, each
    held : words before each, that hold it to a processor
    """

    def __init__(self, commands: Sequence[Sequence[str]], held: Sequence[str] = ()):
        use_own_domain()
        self.children = [
            Child(name, [*held, str(FOLDER / name), "--ros-args", *words])
            for name, *words in commands
        ]
        rclpy.init(args=[])
        self.node = rclpy.create_node("benchmark")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.heard: dict[str, dict[str, str]] = {}  # values by the name of the status
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 50)

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self.node.destroy_node()
        rclpy.shutdown()
        stop_all(self.children)

    def spin(self, until: Callable[[], bool]) -> None:
        """Serve callbacks; SystemExit where a node ends."""
        while not until():
            self._executor.spin_once(timeout_sec=0.2)
            for child in self.children:
                if child.status is not None:
                    raise SystemExit(f"{child.name} ended: {child.last_words}")

    def spin_for(self, seconds: float) -> None:
        """Serve callbacks for so long."""
        end = time.monotonic() + seconds
        self.spin(lambda: time.monotonic() >= end)

    def processor_seconds(self, name: str = "") -> float:
        """That all processes, or those of this name, have used so far."""
        ticks = 0
        for child in self.children:
            if name not in ("", child.name):
                continue
            words = Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += int(words[11]) + int(words[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def usage(self, seconds: float, name: str = "") -> float:
        """Serve callbacks for so long; what these processes took meanwhile, in parts of one processor."""
        begin, before = time.monotonic(), self.processor_seconds(name)
        self.spin_for(seconds)
        return (self.processor_seconds(name) - before) / (time.monotonic() - begin)

    def megabytes(self) -> float:
        """Memory of all processes, of what they have in common with others their share (PSS)."""
        lines = []
        for child in self.children:
            lines += Path(f"/proc/{child.pid}/smaps_rollup").read_text().splitlines()
        return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.heard.setdefault(status.name, {}).update({v.key: v.value for v in status.values})
