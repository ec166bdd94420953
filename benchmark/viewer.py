"""What the page of the node `viewer` costs: its share of one processor with and without a browser.

    scripts/setup python3 benchmark/viewer.py

A recording of six contacts that move, played for ever, its images at full rate, and Chromium without a window;
what the browser takes is not counted, as it is another machine's.
"""

import contextlib
import os
import socket
import sys
import tempfile
from pathlib import Path

sys.path[:0] = [os.path.dirname(__file__), str(Path(__file__).parents[1] / "test")]

from browser_support import Tab
from nodes import Nodes, arguments, replayed

HEAD = "format: tomotactile-scene/1\ndrive_voltage: 3.3\nnoise: {rms: 0.001}\n"
PLACES = (-0.07, -0.07), (-0.07, 0.05), (0.0, 0.0), (0.02, -0.07), (0.07, -0.05), (0.06, 0.07)  # m
DISC = "  - {{shape: disc, center: [{0}, {1}], radius: 0.005, pressure: 3.0e4, path: [[{0}, {2}]], speed: 0.01, loop: true}}"
SECONDS, WARM_UP = 20.0, 10.0
IMAGES = "reconstruction: reconstruction"  # status


def main() -> None:
    """Measure both and print a line each."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "six.yaml")
        discs = "\n".join(DISC.format(x, y, y + 0.015) for x, y in PLACES)
        scene.write_text(f"{HEAD}contacts:\n{discs}\n")
        sensor = ["tactile", *arguments(replayed(folder, "equal-8x8", scene))]
        with Nodes([sensor, ["viewer", *arguments({"port": port})]]) as nodes:
            print(measure(nodes, "nobody looks"), flush=True)
            with contextlib.closing(Tab(f"http://127.0.0.1:{port}", 480, 360)) as tab:
                tab.until(lambda: len(tab.contacts()) == len(PLACES), "six contacts")
                print(measure(nodes, "a page is open"), flush=True)


def measure(nodes: Nodes, what: str) -> str:
    """Share of a processor, and the rate of images at its end."""
    nodes.spin(lambda: IMAGES in nodes.heard)
    nodes.spin_for(WARM_UP)
    share = nodes.usage(SECONDS, "viewer")
    return f"{what}: {share:.1%} of a core at {nodes.heard[IMAGES]['rate_reached']} images/s"


if __name__ == "__main__":
    main()
