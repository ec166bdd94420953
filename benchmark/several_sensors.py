"""How several sensors scale on one machine: processor time, memory, images/s and latency.

    scripts/setup python3 benchmark/several_sensors.py --sensors 1 2 4 8 --seconds 20

Each sensor plays a recording of a 4 x 4 sheet at its full rate (62.5 frames/s: 1000 ground
conditions a second) instead of simulating, which would cost more than what is measured. Latency is
what the reconstruction says in its diagnostics: from the last row of a frame to its contacts.
"""

import argparse
import os
import sys
import tempfile

import numpy as np

sys.path.insert(0, os.path.dirname(__file__))  # scripts/setup keeps Python from doing so

from nodes import Nodes, arguments, replayed

SYSTEMS = ("one process", "one each", "two each")
WARM_UP = 8.0  # s after the last sensor has begun


def main() -> None:
    """Measure every combination and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--system", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    parser.add_argument("--core", type=int, help="hold each program to this processor")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        given = replayed(folder, "equal-4x4", "two-points")
        print(
            "| sensors | system | processor, % of one core | memory, MB | images/s each | latency p50 / p99, ms |"
        )
        print("|---|---|---|---|---|---|", flush=True)
        for count in options.sensors:
            for system in options.system:
                row = measure(system, count, given, options)
                print(f"| {count} | {system} | " + " | ".join(row) + " |", flush=True)


def measure(system: str, count: int, given: dict, options: argparse.Namespace) -> list[str]:
    """One row of the table."""
    names = [f"sensor{k}" for k in range(count)]
    words = arguments(given)
    if system == "one process":
        commands = [["sensors", *words, "-p", f"sensors:=[{', '.join(names)}]"]]
    else:
        programs = ["tactile"] if system == "one each" else ["driver", "reconstruction"]
        commands = [[p, "-r", f"__ns:=/{n}", *words] for n in names for p in programs]
    held = [] if options.core is None else ["taskset", "-c", str(options.core)]
    with Nodes(commands, held) as nodes:

        def told() -> list[dict[str, str]]:
            every = (
                nodes.heard.get(f"{name}/reconstruction: reconstruction", {}) for name in names
            )
            return [values for values in every if "latency_p50_ms" in values]

        nodes.spin(lambda: len(told()) == count)
        nodes.spin_for(WARM_UP)
        used = nodes.usage(options.seconds)
        memory = nodes.megabytes()
    reached, p50, p99 = (
        np.array([float(values[key]) for values in told()])
        for key in ("rate_reached", "latency_p50_ms", "latency_p99_ms")
    )
    return [
        f"{100 * used:.0f}", f"{memory:.0f}", f"{reached.mean():.1f} (least {reached.min():.1f})",
        f"{np.median(p50):.1f} / {p99.max():.1f}",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
