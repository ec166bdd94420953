"""How several sensors scale on one machine: processor time, memory, images/s and latency.

    scripts/setup python3 benchmark/several_sensors.py --sensors 1 2 4 8 --seconds 20

Each sensor plays a recording of a 4 x 4 sheet at its full rate (62.5 frames/s: 1000 ground
conditions a second) instead of simulating, which would cost more than what is measured. Latency is
what the reconstruction says in its diagnostics: from the last row of a frame to its contacts.
"""

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray

from tomotactile_ros.support.processes import Child, stop_all

SYSTEMS = ("one process", "one each", "two each")
WARM_UP = 8.0  # s after the last sensor has begun
FOLDER = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros")


def main() -> None:
    """Measure every combination and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--system", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--layout", default="equal-4x4")
    parser.add_argument("--scene", default="two-points")
    parser.add_argument("--profile", default="fast")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    parser.add_argument("--core", type=int, help="hold each program to this processor")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder, "frames.npz")
        words = ["--layout", options.layout, "--scene", options.scene, "--frames", "250"]
        subprocess.run([FOLDER / "tomotactile", "simulate", *words, "--out", recording], check=True)
        with np.load(recording) as file:  # its truth, read in every round, is no work of a sensor
            arrays = {key: value for key, value in file.items() if key != "truth"}
        np.savez(recording, **arrays)
        print(
            "| sensors | system | processor, % of one core | memory, MB | images/s each | latency p50 / p99, ms |"
        )
        print("|---|---|---|---|---|---|", flush=True)
        for count in options.sensors:
            for system in options.system:
                row = measure(system, count, recording, options)
                print(f"| {count} | {system} | " + " | ".join(row) + " |", flush=True)


def measure(system: str, count: int, recording: Path, options: argparse.Namespace) -> list[str]:
    """One row of the table."""
    names = [f"sensor{k}" for k in range(count)]
    given = {
        "layout": options.layout, "device": "replay", "recording": recording, "loop": True,
        "profile": options.profile,
    }  # fmt: skip
    words = [w for item in given.items() for w in ("-p", "{}:={}".format(*item))]
    if system == "one process":
        words += ["-p", f"sensors:=[{', '.join(names)}]"]
        commands = [["sensors", "--ros-args", *words]]
    else:
        programs = ["tactile"] if system == "one each" else ["driver", "reconstruction"]
        commands = [[p, "--ros-args", "-r", f"__ns:=/{n}", *words] for n in names for p in programs]
    held = [] if options.core is None else ["taskset", "-c", str(options.core)]
    children = [Child(c[0], [*held, str(FOLDER / c[0]), *c[1:]]) for c in commands]
    rclpy.init(args=[])
    node = rclpy.create_node("several_sensors")
    mine = {f"{name}/reconstruction: reconstruction" for name in names}
    heard: dict[str, dict[str, str]] = {}

    def on_message(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name in mine:  # another program may run on this machine
                heard[status.name] = {v.key: v.value for v in status.values}

    node.create_subscription(DiagnosticArray, "/diagnostics", on_message, 50)
    try:
        while sum("latency_p50_ms" in values for values in heard.values()) < count:
            rclpy.spin_once(node, timeout_sec=0.2)
            assert all(child.status is None for child in children), "a node has ended"
        spin(node, WARM_UP)
        before = sum(map(processor_time, children))
        begin = time.monotonic()
        spin(node, options.seconds)
        used = (sum(map(processor_time, children)) - before) / (time.monotonic() - begin)
        memory = sum(map(own_memory, children))
        figures = [
            [float(values[key]) for values in heard.values()]
            for key in ("rate_reached", "latency_p50_ms", "latency_p99_ms")
        ]
    finally:
        node.destroy_node()
        rclpy.shutdown()
        stop_all(children)
    reached, p50, p99 = (np.array(values) for values in figures)
    return [
        f"{100 * used:.0f}", f"{memory:.0f}", f"{reached.mean():.1f} (least {reached.min():.1f})",
        f"{np.median(p50):.1f} / {p99.max():.1f}",
    ]  # fmt: skip


def spin(node, seconds: float) -> None:
    """Serve callbacks for a time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.2)


def processor_time(child: Child) -> float:
    """s of processor that a process has used."""
    words = Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def own_memory(child: Child) -> float:
    """MB of a process, its share of what it has in common with others (PSS)."""
    lines = Path(f"/proc/{child.pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


if __name__ == "__main__":
    main()
