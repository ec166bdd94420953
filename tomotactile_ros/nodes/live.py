"""`make run`: driver and reconstruction as two processes, and a live picture in the terminal."""

import argparse
import json
import os
import random
import socket
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction.settings import PROFILES, Settings
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.support.command_line import Parser, end_of_pipe, positive
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.processes import Child, stop_all
from tomotactile_ros.view.display import Display

if TYPE_CHECKING:
    from tomotactile_ros.nodes.listener import Listener

DEFAULT_RATE = 15.625  # frames/s
PATIENCE = 10.0  # s without the first contacts until it is said why
LEARNING = ("worn-sensor",)  # scenes that are there to be learned
LIMIT = 60.0  # s without the first contacts until it is given up


def main(args: list[str] | None = None) -> int:
    """Run the demonstration; 0 after its time or a stop, 1 if it fails, 2 for bad input."""
    options = _parse(args)
    children: list[Child] = []
    try:
        layout, scene = load_layout(options.layout), load_scene(options.scene)
        scene.check(layout)
        use_own_domain()
        children += _start(options)
        return _watch(children, layout, scene, options)
    except InputError as error:
        print(f"live: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return end_of_pipe()
    except KeyboardInterrupt:
        return 0
    finally:
        stop_all(children)


def _parse(args: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="live", description=__doc__)
    parser.add_argument(
        "--duration", type=positive, default=20.0, help="s after the first contacts (default: 20)"
    )
    parser.add_argument(
        "--layout",
        default="equal-8x8",
        help="layout file or name of an installed one (default: equal-8x8)",
    )
    parser.add_argument(
        "--scene", default="default", help="simulated sensor under this scene (default: default)"
    )
    parser.add_argument(
        "--profile", default=Settings.profile, choices=PROFILES, help=f"default: {Settings.profile}"
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=DEFAULT_RATE,
        help=f"frames/s (default: {DEFAULT_RATE:g})",
    )
    parser.add_argument(
        "--out",
        default="out/pressure.png",
        help="picture written at the end (default: out/pressure.png)",
    )
    return parser.parse_args(args)


def use_own_domain() -> None:
    """Stay on this machine, in a domain that nobody here uses, unless the user has chosen one."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DOMAIN_ID" not in os.environ:
        os.environ["ROS_DOMAIN_ID"] = str(_free_domain())


def _free_domain() -> int:
    """A domain whose first discovery port nobody holds (7400 + 250 n + 10, RTPS 9.6.1.1)."""
    numbers = random.sample(range(1, 101), 100)
    for number in numbers:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * number + 10))
            except OSError:
                continue
            return number
    return numbers[0]


def _start(options: argparse.Namespace) -> list[Child]:
    driver = {"layout": options.layout, "scene": options.scene, "rate": options.rate}
    driver["delivery"] = "rows"  # contacts do not wait for frames
    reconstruction = {"layout": options.layout, "profile": options.profile}
    if options.scene in LEARNING:
        reconstruction["learn"] = "all"
    return [_node("driver", driver), _node("reconstruction", reconstruction)]


def _node(name: str, parameters: dict[str, str | float]) -> Child:
    from ament_index_python.packages import get_package_prefix

    program = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros", name)
    given = [f"{key}:={json.dumps(value)}" for key, value in parameters.items()]
    settings = [word for item in given for word in ("-p", item)]
    return Child(name, [str(program), "--ros-args", *settings])


def _watch(children: list[Child], layout: Layout, scene: Scene, options: argparse.Namespace) -> int:
    """Show what is known until the time is over or somebody stops it; returns the exit status."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from tomotactile_ros.nodes.listener import Listener

    display = Display(layout, scene)
    display.say(
        f"layout {layout.name}, scene {scene.name}, profile {options.profile}: "
        "waiting for the first frame"
    )
    problem = ""
    try:
        rclpy.init(args=[])
        listener = Listener(options.rate, layout, scene.contact_law is not None)
        problem = _show(children, listener, display, options.duration)
    except (KeyboardInterrupt, ExternalShutdownException):
        display.say("stopped")
    except Exception:
        if rclpy.ok():
            raise
        display.say("stopped")  # while rclpy was making something
    finally:
        rclpy.try_shutdown()
        display.close()
    if display.last is not None:
        display.save(options.out)
    if problem:
        print(f"live: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _show(children: list[Child], listener: "Listener", display: Display, duration: float) -> str:
    """Show what is known until the time is over; returns what went wrong, or nothing."""
    import rclpy

    end = heard = None  # s, when the first contacts came, withheld or not
    known, start = False, time.monotonic()
    patience = PATIENCE
    while end is None or time.monotonic() < end:
        rclpy.spin_once(listener, timeout_sec=0.1)
        for child in children:
            if child.status is not None:
                return f"{child.name} ended with status {child.status}: {child.last_words}"
        shot = listener.take()
        if shot is not None:
            heard = heard or time.monotonic()
            known = known or not shot.reason
            display.show(shot)
        if end is None and heard and (known or time.monotonic() > heard + PATIENCE):
            end = time.monotonic() + duration
        if heard is None and time.monotonic() > start + patience:
            reason = f"no contacts after {patience:g} s: {listener.complaints()}"
            if patience >= LIMIT:
                return reason
            display.say(reason)
            patience += PATIENCE
    return ""
