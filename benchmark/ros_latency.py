"""Latency, processor time and memory of the nodes, measured from outside over DDS.

    scripts/setup python3 benchmark/ros_latency.py --rate 15.625 200 --seconds 30

The simulated device hands a frame over one period after its stamp, as a real scan does. Latency is
what comes on top: from there until the pressure image has arrived in this process. With --rows N the
driver hands on rows, N in a message, and contacts are published after every N of them: latency is then
from the end of a row until the contacts that hold for it have arrived.
"""

import argparse
import os
import sys
import time

import numpy as np
from sensor_msgs.msg import Image

from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.conversions import stamp_of

sys.path.insert(0, os.path.dirname(__file__))  # scripts/setup keeps Python from doing so

from nodes import Nodes, arguments

SENSOR, ELECTRODES = {"layout": "equal-8x8", "scene": "two-points", "profile": "fast"}, 64
WARM_UP = 8.0  # s: a process of their own prepares for frames where rows are followed
SYSTEMS = {"two processes": ("driver", "reconstruction"), "composed": ("tactile",)}
OF_ROWS = {"followed/s": "rows_per_second", "lost": "rows_lost", "skipped": "rows_skipped"}


def main() -> None:
    """Measure every combination and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, nargs="+", default=[15.625, 200.0], help="frames/s")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement")
    parser.add_argument("--system", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--rows", type=int, default=0, help="in a message; 0: whole frames")
    parser.add_argument("--publish-every", type=int, help="rows between contacts; N of --rows")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    what = "contacts/s" if options.rows else "images/s"
    head = ("frames/s", what, "p50 ms", "p99 ms", "max ms", "CPU %", "MB", "MB grown")
    head += tuple(OF_ROWS) if options.rows else ()
    print(f"{'system':>14}", *(f"{word:>10}" for word in head), flush=True)
    for rate in options.rate:
        for system in options.system:
            figures = measure(system, rate, options)
            print(f"{system:>14}", *(f"{value:10.2f}" for value in (rate, *figures)), flush=True)


def measure(system: str, rate: float, options: argparse.Namespace) -> list[float]:
    """Messages/s, latency p50, p99 and largest (ms), processor (% of a core), MB, MB grown; of rows also
    how many are followed a second, and how many were lost and left out in all."""
    given: dict = SENSOR | {"rate": rate}
    if options.rows:
        given |= {"delivery": "rows", "rows_per_message": options.rows}
        given |= {"publish_every": options.publish_every or options.rows}
    lasts = 1.0 / rate  # s until what carries the stamp has ended
    if options.rows:
        lasts /= ELECTRODES
    latencies: list[float] = []

    def on_message(message) -> None:
        latencies.append(time.time() - stamp_of(message.header) - lasts)

    with Nodes([(name, *arguments(given)) for name in SYSTEMS[system]]) as nodes:
        kind, topic, depth = (
            (ContactArray, "contacts", 100) if options.rows else (Image, "pressure", 2)
        )
        nodes.node.create_subscription(kind, topic, on_message, depth)
        nodes.spin(lambda: len(latencies) >= 2 * rate)
        nodes.spin_for(WARM_UP)
        latencies.clear()
        memory = nodes.megabytes()
        cpu = 100 * nodes.usage(options.seconds)
        now = nodes.megabytes()
    said = {key: value for values in nodes.heard.values() for key, value in values.items()}
    rows = [float(said.get(key, "nan")) for key in OF_ROWS.values()] if options.rows else []
    quantiles = 1e3 * np.quantile(latencies, (0.5, 0.99, 1.0))
    return [len(latencies) / options.seconds, *quantiles, cpu, now, now - memory, *rows]


if __name__ == "__main__":
    main()
