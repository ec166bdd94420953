"""Latency, CPU time and memory of the nodes, measured from outside over DDS.

    scripts/setup python3 benchmark/ros_latency.py --rate 15.625 200 --seconds 30

The simulated device hands a frame over one period after its stamp, as a real scan does. Latency is
what comes on top: from there until the pressure image has arrived in this process. With --rows N the
driver hands on rows, N in a message, and contacts are published after every N of them: latency is then
from the end of a row until the contacts that hold for it have arrived.
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_prefix

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.processes import Child, stop_all

WARM_UP = 8.0  # s: a process of their own prepares for frames where rows are followed
SYSTEMS = {"two processes": ("driver", "reconstruction"), "composed": ("tactile",)}


def main() -> None:
    """Measure every combination and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, nargs="+", default=[15.625, 200.0], help="frames/s")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement")
    parser.add_argument("--system", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--profile", default="fast")
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--scene", default="two-points")
    parser.add_argument("--rows", type=int, default=0, help="in a message; 0: whole frames")
    parser.add_argument("--publish-every", type=int, help="rows between contacts; N of --rows")
    parser.add_argument("--out", help="JSON file for the figures")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    figures = []
    head = (
        "system",
        "frames/s",
        "contacts/s" if options.rows else "images/s",
        "p50 ms",
        "p99 ms",
        "max ms",
        "CPU %",
        "MB",
        "MB grown",
        *(("followed/s", "lost", "skipped") if options.rows else ()),
    )
    print(f"{head[0]:>14}", *(f"{word:>9}" for word in head[1:]), flush=True)
    for rate in options.rate:
        for system in options.system:
            figures.append(measure(system, rate, options))
            print(f"{system:>14}", *(f"{value:9.2f}" for value in figures[-1][1:]), flush=True)
    if options.out:
        Path(options.out).write_text(
            json.dumps([dict(zip(head, row, strict=True)) for row in figures], indent=2)
        )


def measure(system: str, rate: float, options: argparse.Namespace) -> list:
    """One row of the table."""
    parameters = {
        "layout": options.layout, "scene": options.scene, "rate": rate, "profile": options.profile,
    }  # fmt: skip
    if options.rows:
        parameters |= {"delivery": "rows", "rows_per_message": options.rows}
        parameters |= {"publish_every": options.publish_every or options.rows}
    words = [w for item in parameters.items() for w in ("-p", "{}:={}".format(*item))]
    folder = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros")
    children = [Child(name, [str(folder / name), "--ros-args", *words]) for name in SYSTEMS[system]]
    try:
        return [system, rate, *watch(children, rate, options)]
    finally:
        stop_all(children)


def watch(children: list[Child], rate: float, options: argparse.Namespace) -> list[float]:
    """Messages/s, latency p50, p99 and largest (ms), CPU (% of a core), MB, MB grown; of rows also
    how many are followed a second, and how many were lost and left out in all."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Image

    from tomotactile_ros.msg import ContactArray

    latencies: list[float] = []
    lasts = 1.0 / rate  # s until what carries the stamp has ended
    if options.rows:
        lasts /= load_layout(options.layout).electrodes
    figures: dict[str, str] = {}

    def on_message(message: Image | ContactArray) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        latencies.append(time.time() - stamp - lasts)

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            figures.update({each.key: each.value for each in status.values})

    context = Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("latency", context=context)
    if options.rows:
        node.create_subscription(ContactArray, "contacts", on_message, 100)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    else:
        node.create_subscription(Image, "pressure", on_message, 2)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin(until) -> None:
        while not until():
            executor.spin_once(timeout_sec=0.5)
            for child in children:
                if child.status is not None:
                    raise SystemExit(f"{child.name} ended: {child.last_words}")

    spin(lambda: len(latencies) >= 2 * rate)
    warm = time.monotonic() + WARM_UP
    spin(lambda: time.monotonic() > warm)
    latencies.clear()
    start, used, memory = time.monotonic(), cpu_seconds(children), megabytes(children)
    spin(lambda: time.monotonic() > start + options.seconds)
    elapsed = time.monotonic() - start
    cpu = 100 * (cpu_seconds(children) - used) / elapsed
    now = megabytes(children)
    node.destroy_node()
    context.try_shutdown()
    p50, p99, most = 1e3 * np.quantile(latencies, (0.5, 0.99, 1.0))
    counted = ("rows_per_second", "rows_lost", "rows_skipped") if options.rows else ()
    numbers = [float(figures.get(key, "nan")) for key in counted]
    return [len(latencies) / elapsed, p50, p99, most, cpu, now, now - memory, *numbers]


def cpu_seconds(children: list[Child]) -> float:
    """CPU time of processes so far, s."""
    ticks = 0
    for child in children:
        fields = Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def megabytes(children: list[Child]) -> float:
    """Resident memory of processes, MB."""
    pages = sum(int(Path(f"/proc/{child.pid}/statm").read_text().split()[1]) for child in children)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
