"""Python programs as forks of a process that has imported what they need: a start of 0.1 s, not 2 s.

A `Program` is a `Popen` whose process runs the same file with the same words, environment, folder, files and
session as if the file had been started. One process that forks is kept for each environment that the start of
the interpreter and imports read.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import importlib
import os
import pickle
import pkgutil
import runpy
import signal
import socket
import subprocess
import sys
from contextlib import suppress

import numpy

_PR_SET_CHILD_SUBREAPER = 36
_READ_AT_THE_START = ("PYTHON", "LD_", "LANG", "LC_", "OMP_", "MPL", "TOMOTACTILE_CORE", "ROS_PY")
_MESSAGES = """
    builtin_interfaces diagnostic_msgs geometry_msgs lifecycle_msgs rcl_interfaces rosgraph_msgs sensor_msgs
    shape_msgs std_msgs std_srvs tomotactile_ros type_description_interfaces visualization_msgs
"""
_NOT_BEFORE = ("tomotactile_ros.bench", "tomotactile_ros.nodes")  # rclpy has threads, of LTTng
_servers: dict[tuple, socket.socket] = {}


class Program(subprocess.Popen):
    """A process of `command`, which is Python's with a file or `-m` and a module, or a Python program's."""

    def _execute_child(self, args, *how):  # where Popen starts the process: all else of it holds
        env, cwd, pipes, session = how[5], how[4], how[9:15], how[20]
        env = {**os.environ} if env is None else {**env}
        server = _server({k: v for k, v in env.items() if k.startswith(_READ_AT_THE_START)})
        asked = args, env, os.fspath(cwd or os.getcwd()), session
        ends = [
            end if end != -1 else own for end, own in zip((pipes[0], pipes[3], pipes[5]), range(3))
        ]
        socket.send_fds(server, [pickle.dumps(asked)], ends)
        self.pid = int(server.recv(20))
        self._child_created = True
        self._close_pipe_fds(*pipes)


def begin(command, warm: bool = True, **how) -> subprocess.Popen:
    """A process of a command; `warm`: forked, where it is an installed program, a file or a module of Python."""
    words = [os.fspath(each) for each in command]
    if words[0] == sys.executable:
        warm = warm and (words[1] == "-m" or not words[1].startswith("-"))
    else:
        warm = warm and words[0].split("/")[-3:-1] == ["lib", "tomotactile_ros"]
    return (Program if warm else subprocess.Popen)(words, **how)


def _server(environment) -> socket.socket:
    key = tuple(sorted(environment.items()))
    if key not in _servers:
        # a program's parent ends before it has begun: its next one is this process
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        _servers[key], other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, __file__, str(other.fileno())]
        others = {k: v for k, v in os.environ.items() if not k.startswith(_READ_AT_THE_START)}
        with other:
            process = subprocess.Popen(
                command, env={**others, **environment}, pass_fds=[other.fileno()],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
        atexit.register(lambda: (_servers[key].close(), process.wait()))
    return _servers[key]


def _import_all() -> None:
    import tomotactile_ros

    modules = [
        each.name for each in pkgutil.walk_packages(tomotactile_ros.__path__, "tomotactile_ros.")
    ]
    modules = [name for name in modules if not name.startswith(_NOT_BEFORE)]
    modules += [f"{name}.{kind}" for name in _MESSAGES.split() for kind in ("msg", "srv")]
    modules += ["matplotlib.pyplot"]
    for name in modules:
        with suppress(ImportError):
            importlib.import_module(name)
    threads = os.listdir("/proc/self/task")
    assert len(threads) == 1, f"a process of {len(threads)} threads must not be forked"


def _serve(line: socket.socket) -> list[str]:
    """Fork whenever asked to; what a fork is to run."""
    _import_all()
    gc.collect()
    gc.freeze()
    while True:
        message, files, _, _ = socket.recv_fds(line, 2**20, 3)
        if not message:
            os._exit(0)
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            if os.fork():
                os._exit(0)
            line.close()
            os.close(reader)
            words = _become(files, *pickle.loads(message))
            os.write(writer, str(os.getpid()).encode())
            os.close(writer)
            return words
        os.waitpid(child, 0)
        for file in (*files, writer):
            os.close(file)
        line.send(os.read(reader, 20))
        os.close(reader)


def _become(files, words, environment, folder, session) -> list[str]:
    if session:
        os.setsid()
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    numpy.random.seed()
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        old = getattr(sys, name)
        how = "w" if number else "r", 1 if number == 2 else -1, old.encoding, old.errors
        new = open(number, *how, closefd=False)  # noqa: SIM115 - it is the process's own
        setattr(sys, name, new)
        setattr(sys, f"__{name}__", new)
    return words


def _run(words) -> None:
    if words[0] == sys.executable:
        words = words[1:]
    if words[0] == "-m":
        sys.argv[:] = words[1:]
        sys.modules.pop(words[1], None)
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv[:] = words
        if not os.environ.get("PYTHONSAFEPATH"):
            sys.path.insert(0, os.path.dirname(os.path.realpath(words[0])))
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # it is ignored under nohup
    if not os.environ.get("PYTHONSAFEPATH"):
        del sys.path[0]  # the tests
    _run(_serve(socket.socket(fileno=int(sys.argv[1]))))
