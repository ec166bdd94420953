"""The life of a node: plain or managed, one or several in a process, and its clean end.

What a node does is written once, as a part: it declares parameters and topics when it is made, and
is then configured, activated, deactivated and cleaned up - at once by a plain node, on request by a
managed one (rclpy.lifecycle).
"""

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import CORO_CREATED, getcoroutinestate, iscoroutine
from itertools import chain
from typing import Any, Generic, Protocol, TypeVar
from weakref import WeakSet

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.task import Task

from tomotactile_ros.nodes.parameters import Parameters, Spec
from tomotactile_ros.nodes.params_files import files_of, warn_of_keys
from tomotactile_ros.nodes.usage import (
    asks_for_help,
    not_understood,
    refuse_unknown,
    ros_words,
    usage,
)
from tomotactile_ros.support.command_line import end_of_pipe, say_doubts
from tomotactile_ros.support.errors import InputError

BAD_INPUT = 2
_SOON = 5e-5  # s in which a thread begins with what it was given
_THREADS = 4  # parameters and services, diagnostics and frames of a node; two nodes in a process
AUTOSTART = Spec("autostart", False, "Be active from the start", read_only=True)


class Part:
    """What a node does. `configure` may raise InputError; the others work in any state.

    specs : its parameters; what they are changed to goes to `_change`.
    """

    name: str
    specs: Sequence[Spec]

    def __init__(self, node: Node) -> None:
        self._node, self._log = node, node.get_logger()
        self.parameters = Parameters(node, self.specs, self._change)

    def configure(self) -> None:
        """Read files and prepare everything."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop working; nothing is published afterwards."""

    def cleanup(self) -> None:
        """Let go of what `configure` made."""

    def _change(self, changed: set[str], values: dict[str, Any]) -> None:
        """As `Parameters` takes it; where all are read-only nothing changes."""


P = TypeVar("P", bound=Part)


class PlainNode(Node, Generic[P]):
    """A node that works from its creation to its destruction."""

    def __init__(self, kind: type[P], namespace: str | None = None):
        self._works = False
        with _settings_of_ros():
            super().__init__(kind.name, namespace=namespace)
        try:
            with _settings_of_ros():
                self.part = kind(self)
            self._works = True
            self.part.configure()
            self.part.activate()
        except BaseException:
            self.destroy_node()
            raise

    def destroy_node(self) -> None:
        """Stop the work, then the node."""
        if self._works:
            self.part.deactivate()
            self.part.cleanup()
            self._works = False
        super().destroy_node()


class ManagedNode(LifecycleNode, Generic[P]):
    """A node whose life is managed by services: configure, activate, deactivate, cleanup.

    With the parameter `autostart` it configures and activates itself at the start, and so does not
    depend on a manager to come back after a crash.
    """

    def __init__(self, kind: type[P]):
        with _settings_of_ros():
            super().__init__(kind.name)
            self.part = kind(self)
        if Parameters(self, (AUTOSTART,))["autostart"]:
            self._start()

    def _start(self) -> None:
        for transition in (self.trigger_configure, self.trigger_activate):
            result = transition()
            if result != TransitionCallbackReturn.SUCCESS:  # the reason is in the log
                self.destroy_node()
                if not rclpy.ok():
                    raise ExternalShutdownException()
                raise SystemExit(BAD_INPUT if result == TransitionCallbackReturn.FAILURE else 1)

    def _LifecycleNodeMixin__change_state(self, transition: int) -> TransitionCallbackReturn:
        """Refuse a transition that the state does not have, where rclpy would end the node.

        The private method that this replaces has been mended since Jazzy (ros2/rclpy#1209).
        """
        possible = {
            number: label for number, label, *_ in self._state_machine.available_transitions
        }
        if transition not in possible:
            self.get_logger().error(
                f"transition {transition} is not possible in state "
                f"{self._state_machine.current_state[1]}, only "
                + (", ".join(f"{label} ({k})" for k, label in possible.items()) or "none")
            )
            return TransitionCallbackReturn.FAILURE
        return super()._LifecycleNodeMixin__change_state(transition)  # type: ignore[misc] # private

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare; back to unconfigured, with the reason in the log, if that is not possible."""
        return self._do(self.part.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        return self._do(self.part.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        return self._do(self.part.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything."""
        return self._do(self.part.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and let go."""
        return self._do(self._stop)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured after an error in a transition."""
        return self._do(self._stop)

    def destroy_node(self) -> None:
        """Stop the work, then the node."""
        self._stop()
        super().destroy_node()

    def _stop(self) -> None:
        self.part.deactivate()
        self.part.cleanup()

    def _do(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Whether it worked; if not, the log says why, which rclpy would keep to itself."""
        try:
            work()
        except InputError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception:  # noqa: BLE001 - a defect, which must not be taken for bad input
            if rclpy.ok():  # otherwise a stop came in between
                self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS


class Making(Protocol):
    """Makes a node of what it does."""

    def __call__(self, kind: type[P]) -> PlainNode[P] | ManagedNode[P]: ...


class _Executor(MultiThreadedExecutor):
    """Gives each callback out once.

    rclpy gives one out again and again, as fast as it can, until a thread has begun with it, and keeps that
    thread from the interpreter meanwhile: two thirds of the time of a node that gets rows.
    """

    def __init__(self, threads: int) -> None:
        super().__init__(threads)
        self._given: WeakSet[Task] = WeakSet()

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> tuple[Task, Any, Node]:
        """The next callback, what it is of, and the node of that."""
        while True:
            found: tuple[Task, Any, Node] = super().wait_for_ready_callbacks(*args, **kwargs)
            if found[0] not in self._given or not _has_not_begun(found[0]):
                self._given.add(found[0])
                return found
            time.sleep(_SOON)


def _has_not_begun(task: Task) -> bool:
    """Whether no thread has begun with a task; one that waits for something is given out again."""
    work = getattr(task, "_handler", None)
    return iscoroutine(work) and getcoroutinestate(work) == CORO_CREATED


def run(
    make_nodes: Callable[[Making], Iterable[Node]],
    args: list[str] | None,
    about: str,
    specs: Mapping[str, Sequence[Spec]],
    threads: bool = True,
    also: Iterable[Spec] = (),
    managed: bool = False,
) -> int:
    """Run nodes until they are asked to stop (Ctrl-C, SIGTERM, shutdown).

    Parameters
    ----------
    make_nodes : makes the nodes, one by one, once ROS is there, each by what it is given for that.
    args : command line; None for this process's own.
    about, specs : for `--help`: what the program is, and the parameters of its nodes.
    threads : whether several things are done at a time. Without, a message awakes the executor once
        and not three times, which is a third of the work of a node that does little else.
    also : parameters of nodes that are not known before the first is there.
    managed : whether they are managed nodes: configure, activate, deactivate, cleanup by services.

    Returns
    -------
    Exit status: 0 after a stop, 2 after bad input, which is said in one line.
    """
    nodes: list[Node] = []
    interrupt, started = _Interrupt(), False
    make: Making = ManagedNode if managed else PlainNode
    if managed:
        about = f"{about.strip()}\n\nManaged: configure, activate, deactivate, cleanup by services."
        specs = {name: (AUTOSTART, *found) for name, found in specs.items()}
    given = sys.argv[1:] if args is None else args
    words = ros_words(given)
    say_doubts(_program())
    try:
        for number in (signal.SIGINT, signal.SIGTERM):  # before rclpy's own, which call these
            signal.signal(number, interrupt)
        files = files_of(words)
        if asks_for_help(words):
            print(usage(_program(), about, specs), flush=True)
            return 0
        refuse_unknown(given, _program(), (*chain(*specs.values()), *also))
        _init(words)
        started = True
        if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
            signal.signal(signal.SIGHUP, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
        executor = _Executor(_THREADS) if threads else SingleThreadedExecutor()
        for node in make_nodes(make):
            nodes.append(node)
            executor.add_node(node)
            warn_of_keys(node, files)
        for timer in [timer for node in nodes for timer in node.timers]:
            timer.reset()  # all at once, from now: each awakening of the executor costs ms
        interrupt.wanted = False
        if not interrupt.came:  # otherwise it got lost in what it interrupted
            executor.spin()
    except BrokenPipeError:
        return end_of_pipe()
    except InputError as error:
        print(f"{_program()}: {error}", file=sys.stderr)
        return BAD_INPUT
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception:
        if rclpy.ok() or not started:
            raise
        return 0  # stopped while the nodes were being made
    finally:
        # a launch file's Ctrl-C comes twice: from the terminal and from the launch process
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        for node in nodes:
            node.destroy_node()
        _shut_down()
    return 0


class _Interrupt:
    """A signal ends what is computed at once while it is `wanted`: while nodes are made.

    Later rclpy ends the spinning. An exception there can come between the start of a thread of the
    executor's pool and its entry in the pool's list: it would be waited for, and never told to end.
    Only the first one raises: a second one would disturb what the first one cleans up.
    """

    def __init__(self) -> None:
        self.wanted = True
        self.came = False

    def __call__(self, number: int, frame: object) -> None:
        if self.wanted and not self.came:
            self.came = True
            raise KeyboardInterrupt


def _program() -> str:
    return sys.argv[0].rsplit("/", 1)[-1]


def _init(words: list[str]) -> None:
    try:
        rclpy.init(args=words)
    except RuntimeError as error:
        raise InputError(not_understood(error)) from None


def _shut_down() -> None:
    try:
        rclpy.try_shutdown()
    except RuntimeError:
        if (
            rclpy.ok()
        ):  # otherwise rclpy's thread of signals did so between its question and its deed
            raise


@contextmanager
def _settings_of_ros() -> Iterator[None]:
    """Bad input, too: use_sim_time, qos_overrides and others that ROS itself reads."""
    try:
        yield
    except (ParameterException, RuntimeError) as error:
        if not rclpy.ok():
            raise
        raise InputError(_one_line(error)) from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
