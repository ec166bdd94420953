"""What tests of the nodes share: programs as processes, and a probe that talks to them.

Everything waits for an event; the time limits only end a test that would wait for ever.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_prefix
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from warm_start import begin

LIMIT = 240.0  # s; a machine that is busy takes long to start a process, or to estimate a frame
ASK_AGAIN = 10.0  # s


def program(name: str) -> str:
    """Path of an installed program of this package."""
    return str(Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros", name))


def ros_arguments(
    parameters: dict, namespace: str = "", remaps: dict | None = None, files: Sequence = ()
) -> list[str]:
    """Command line of a node with parameters, also from files, in a namespace, with names
    changed."""
    words = [word for item in parameters.items() for word in ("-p", "{}:={}".format(*item))]
    words += [word for item in (remaps or {}).items() for word in ("-r", "{}:={}".format(*item))]
    words += [word for file in files for word in ("--params-file", str(file))]
    return ["--ros-args", *words, *(["-r", f"__ns:={namespace}"] if namespace else [])]


class Process:
    """A program in a ROS domain that runs until it is told to stop, with all that it writes; `warm`: it
    may be a fork, see warm_start."""

    def __init__(self, command: list[str], domain: int, warm: bool = True):
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = begin(
            command,
            warm,
            env=dict(os.environ, ROS_DOMAIN_ID=str(domain)),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def output(self) -> str:
        """All that it has written so far."""
        size = os.fstat(self._output.fileno()).st_size
        return os.pread(self._output.fileno(), size, 0).decode(errors="replace")

    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    def stop(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit status."""
        if self.running():
            self._process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Exit status, once it has ended."""
        return self._process.wait(LIMIT)

    def kill(self) -> None:
        """End it and all that it started."""
        if self.running():
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def processes_of(name: str, domain: int) -> list[int]:
    """Process ids of a program of this package, plain or managed, in a ROS domain."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_text().split("\0")
            environment = (folder / "environ").read_text().split("\0")
        except (OSError, UnicodeDecodeError):
            continue
        mine = f"ROS_DOMAIN_ID={domain}" in environment
        if mine and {program(name), program(f"{name}_lifecycle")} & set(words):
            found.append(int(folder.name))
    return found


class Probe:
    """A node of the test's own, in a domain of its own."""

    def __init__(self, domain: int):
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self.node = rclpy.create_node("probe", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._heard: list = []

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def until(self, happened: Callable[[], bool], what: str) -> None:
        """Serve callbacks until something has happened."""
        end = time.monotonic() + LIMIT
        while not happened():
            assert time.monotonic() < end, f"in {LIMIT:g} s: no {what}"
            self._executor.spin_once(timeout_sec=0.2)

    def listen(self, kind: type, topic: str, qos: object = 10) -> list:
        """A list that grows with every message on a topic."""
        messages: list = []
        self._heard.append(self.node.create_subscription(kind, topic, messages.append, qos))
        return messages

    def listen_no_more(self) -> None:
        """All lists of `listen` stay as they are: what nobody hears costs the nodes nothing."""
        while self._heard:
            self.node.destroy_subscription(self._heard.pop())

    def wait_for(
        self, kind: type, topic: str, suits: Callable = lambda message: True, qos: object = 10
    ):
        """The first message on a topic that suits."""
        found: list = []
        subscription = self.node.create_subscription(
            kind, topic, lambda message: suits(message) and found.append(message), qos
        )
        self.until(lambda: bool(found), f"suitable message on {topic}")
        self.node.destroy_subscription(subscription)
        return found[0]

    def call(self, kind: type, service: str, request: object = None):
        """Response of a service; the request must bear being sent again.

        A server that has not discovered the whole client yet does its work, but its response is
        lost (ros2/rmw_fastrtps#842). So a request without an answer is repeated.
        """
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f"service {service}")
        futures = []
        due = 0.0

        def answered() -> bool:
            nonlocal due
            if time.monotonic() >= due:
                futures.append(client.call_async(request or kind.Request()))
                due = time.monotonic() + ASK_AGAIN
            return any(future.done() for future in futures)

        self.until(answered, f"answer of {service}")
        self.node.destroy_client(client)
        return next(future.result() for future in futures if future.done())

    def set_parameter(self, node: str, name: str, value: object):
        """Set a parameter of another node; returns whether it was taken and the reason."""
        given = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[given])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def get_parameter(self, node: str, name: str):
        """Value of a parameter of another node."""
        request = GetParameters.Request(names=[name])
        (value,) = self.call(GetParameters, f"{node}/get_parameters", request).values
        return parameter_value_to_python(value)


def ends_cleanly(process: Process, number: int = signal.SIGINT) -> None:
    """Stop a process; it says goodbye with 0, without a traceback and without a red line."""
    before = process.output
    assert process.stop(number) == 0, process.output
    assert "Traceback" not in process.output
    said = process.output[len(before) :]
    assert "[ERROR]" not in said and "Failed to publish" not in said, said
