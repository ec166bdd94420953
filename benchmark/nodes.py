"""Nodes as processes of their own, measured from outside over DDS: latency, processor time, memory.

    scripts/setup python3 benchmark/nodes.py latency --rate 15.625 200 --seconds 30
    scripts/setup python3 benchmark/nodes.py sensors --sensors 1 2 4 8 --seconds 20
    scripts/setup python3 benchmark/nodes.py viewer

latency  The simulated device hands a frame over one period after its stamp, as a real scan does.
         Latency is what comes on top: from there until the pressure image has arrived in this
         process. With --rows N the driver hands on rows, N in a message, and contacts are published
         after every N of them: latency is then from the end of a row until its contacts have arrived.
sensors  Each sensor plays a recording of a 4 x 4 sheet at its full rate (62.5 frames/s: 1000 ground
         conditions a second) instead of simulating, which would cost more than what is measured.
         Latency is what the diagnostics say: from the last row of a frame to its contacts.
viewer   The share of one processor that the page takes with and without a browser: a recording of
         six contacts that move, its images at full rate, and Chromium without a window, not counted.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Image

from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.tables import Table
from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.conversions import stamp_of
from tomotactile_ros.nodes.live import use_own_domain
from tomotactile_ros.support.processes import Child, stop_all

FOLDER = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros")
SYSTEMS = {
    "latency": {"two processes": ("driver", "reconstruction"), "composed": ("tactile",)},
    "sensors": dict.fromkeys(("one process", "one each", "two each")),
}
SENSOR, ELECTRODES = {"layout": "equal-8x8", "scene": "two-points", "profile": "fast"}, 64
WARM_UP = 8.0  # s: a process of their own prepares for frames where rows are followed
OF_ROWS = {"followed/s": "rows_per_second", "lost": "rows_lost", "skipped": "rows_skipped"}
STATUS = "reconstruction: reconstruction"
HEAD = "format: tomotactile-scene/1\ndrive_voltage: 3.3\nnoise: {rms: 0.001}\n"
PLACES = (-0.07, -0.07), (-0.07, 0.05), (0.0, 0.0), (0.02, -0.07), (0.07, -0.05), (0.06, 0.07)  # m
DISC = "  - {{shape: disc, center: [{0}, {1}], radius: 0.005, pressure: 3.0e4, path: [[{0}, {2}]], speed: 0.01, loop: true}}"


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


def systems(part: str, asked: Namespace) -> list[str]:
    """Those that were asked for, of a part."""
    return [each for each in SYSTEMS[part] if asked.system in (None, each)]


def latency(asked: Namespace) -> None:
    """A table of every rate and system."""
    given: dict = dict(SENSOR)
    if asked.rows:
        given |= {"delivery": "rows", "rows_per_message": asked.rows}
        given |= {"publish_every": asked.publish_every or asked.rows}
    what = "contacts/s" if asked.rows else "images/s"
    head = ("frames/s", what, "p50 ms", "p99 ms", "max ms", "CPU %", "MB", "MB grown")
    table = Table("system", *head, *(OF_ROWS if asked.rows else ()))
    for rate in asked.rate:
        for system in systems("latency", asked):
            programs = SYSTEMS["latency"][system]
            figures = one_latency(programs, given | {"rate": rate}, asked.seconds)
            table.add(system, *(f"{value:.2f}" for value in (rate, *figures)))


def one_latency(programs: Sequence[str], given: dict, seconds: float) -> list[float]:
    """Messages/s, latency p50, p99 and largest (ms), processor (% of a core), MB, MB grown; of rows
    also how many are followed a second, and how many were lost and left out in all."""
    rows, rate, latencies = "delivery" in given, given["rate"], []
    lasts = 1 / rate / (ELECTRODES if rows else 1)  # s until what carries the stamp has ended

    def on_message(message) -> None:
        latencies.append(time.time() - stamp_of(message.header) - lasts)

    with Nodes([(name, *arguments(given)) for name in programs]) as nodes:
        kind, topic, depth = (ContactArray, "contacts", 100) if rows else (Image, "pressure", 2)
        nodes.node.create_subscription(kind, topic, on_message, depth)
        nodes.spin(lambda: len(latencies) >= 2 * rate)
        nodes.spin_for(WARM_UP)
        latencies.clear()
        memory = nodes.megabytes()
        cpu = 100 * nodes.usage(seconds)
        now = nodes.megabytes()
    said = {key: value for values in nodes.heard.values() for key, value in values.items()}
    of_rows = [float(said.get(key, "nan")) for key in OF_ROWS.values()] if rows else []
    quantiles = 1e3 * np.quantile(latencies, (0.5, 0.99, 1.0))
    return [len(latencies) / seconds, *quantiles, cpu, now, now - memory, *of_rows]


def sensors(asked: Namespace) -> None:
    """A table of every number of sensors and system."""
    held = [] if asked.core is None else ["taskset", "-c", str(asked.core)]
    with tempfile.TemporaryDirectory() as folder:
        words = arguments(replayed(folder, "equal-4x4", "two-points"))
        table = Table(
            *("sensors", "system", "processor, % of one core", "memory, MB"),
            *("images/s each", "latency p50 / p99, ms"),
        )
        for count in asked.sensors:
            names = [f"sensor{k}" for k in range(count)]
            for system in systems("sensors", asked):
                if system == "one process":
                    commands = [["sensors", *words, "-p", f"sensors:=[{', '.join(names)}]"]]
                else:
                    both = ["tactile"] if system == "one each" else ["driver", "reconstruction"]
                    commands = [[p, "-r", f"__ns:=/{n}", *words] for n in names for p in both]
                table.add(str(count), system, *several(names, commands, held, asked.seconds))


def several(names: list[str], commands: list, held: list[str], seconds: float) -> list[str]:
    """Cells of running sensors."""
    with Nodes(commands, held) as nodes:

        def told() -> list[dict[str, str]]:
            every = (nodes.heard.get(f"{name}/{STATUS}", {}) for name in names)
            return [values for values in every if "latency_p50_ms" in values]

        nodes.spin(lambda: len(told()) == len(names))
        nodes.spin_for(WARM_UP)
        used = nodes.usage(seconds)
        memory = nodes.megabytes()
    reached, p50, p99 = (
        np.array([float(values[key]) for values in told()])
        for key in ("rate_reached", "latency_p50_ms", "latency_p99_ms")
    )
    rate = f"{reached.mean():.1f} (least {reached.min():.1f})"
    return [f"{100 * used:.0f}", f"{memory:.0f}", rate, f"{np.median(p50):.1f} / {p99.max():.1f}"]


def viewer(asked: Namespace) -> None:
    """A line without a browser, and one with a page open."""
    sys.path.append(str(Path(__file__).parents[1] / "test"))
    from browser_support import Tab

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "six.yaml")
        discs = "\n".join(DISC.format(x, y, y + 0.015) for x, y in PLACES)
        scene.write_text(f"{HEAD}contacts:\n{discs}\n")
        sensor = ["tactile", *arguments(replayed(folder, "equal-8x8", scene))]
        with Nodes([sensor, ["viewer", *arguments({"port": port})]]) as nodes:

            def tell(what: str) -> None:
                nodes.spin(lambda: STATUS in nodes.heard)
                nodes.spin_for(WARM_UP)
                share = nodes.usage(asked.seconds, "viewer")
                reached = nodes.heard[STATUS]["rate_reached"]
                print(f"{what}: {share:.1%} of a core at {reached} images/s", flush=True)

            tell("nobody looks")
            with contextlib.closing(Tab(f"http://127.0.0.1:{port}", 480, 360)) as tab:
                tab.until(lambda: len(tab.contacts()) == len(PLACES), "six contacts")
                tell("a page is open")


PARTS = {"latency": latency, "sensors": sensors, "viewer": viewer}


def main() -> None:
    """Measure what is asked for."""
    asked = options(
        __doc__,
        *PARTS,
        seconds=(20.0, "of each measurement"),
        system=(str, "only this one of a part's systems"),
        rate=([15.625, 200.0], "of latency: frames/s"),
        rows=(0, "of latency: in a message; 0: whole frames"),
        publish_every=(int, "of latency: rows between contacts; N of --rows"),
        sensors=([1, 2, 4, 8], "of sensors: how many"),
        core=(int, "of sensors: hold each program to this processor"),
    )
    for part in asked.cases or PARTS:
        PARTS[part](asked)


if __name__ == "__main__":
    main()
