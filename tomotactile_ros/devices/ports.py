"""The device's end of a cable: a pseudo-terminal or a TCP port, for the emulator."""

from __future__ import annotations

import os
import pty
import select
import socket
import termios
import tty
from collections.abc import Callable

from tomotactile_ros.support.errors import InputError


class PtyPort:
    """A pseudo-terminal; `path` is what a host opens, `link` an optional symbolic link to it."""

    def __init__(self, link: str | None = None) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._link = link
        if link:
            _replace_link(self.path, link)
            self.path = link

    def wait(self, timeout: float, sending: bool = False) -> bool:
        """Wait until the host has sent something (then True) or, when `sending`, there is room."""
        out = [self._master] if sending else []
        return bool(select.select([self._master], out, [], timeout)[0])

    def receive(self) -> bytes:
        """What the host has sent."""
        try:
            return os.read(self._master, 65536)
        except BlockingIOError:
            return b""

    def send(self, data: bytes) -> int:
        """Send as much of `data` as fits, return how much that was."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Pull the plug: the host's end fails with an I/O error."""
        if self._link and _target(self._link) == os.ttyname(self._slave):
            os.unlink(self._link)
        os.close(self._master)
        os.close(self._slave)


class TcpPort:
    """A TCP server for one host at a time, others are turned away; `path` is the URL for it."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._server = socket.create_server((host, port))
        self._peer: socket.socket | None = None
        self.path = "socket://{}:{}".format(*self._server.getsockname()[:2])

    def wait(self, timeout: float, sending: bool = False) -> bool:
        """Wait until a host connects, sends or goes or, when `sending`, there is room."""
        peer = [self._peer] if self._peer else []
        readable = select.select([self._server, *peer], peer if sending else [], [], timeout)[0]
        if self._server in readable:
            self._meet(self._server.accept()[0])
        return self._peer in readable

    def receive(self) -> bytes:
        """What the host has sent."""
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(65536)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop_peer()
        return data

    def send(self, data: bytes) -> int:
        """Send as much of `data` as fits; without a host it goes nowhere."""
        if self._peer is None:
            return len(data)
        try:
            return self._peer.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop_peer()
            return len(data)

    def close(self) -> None:
        """End the connection and the server."""
        self._drop_peer()
        self._server.close()

    def _meet(self, host: socket.socket) -> None:
        if self._peer is not None:
            host.close()
            return
        self._peer = host
        host.setblocking(False)
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _drop_peer(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None


def _target(link: str) -> str | None:
    try:
        return os.readlink(link)
    except OSError:
        return None


def _replace_link(target: str, link: str) -> None:
    if os.path.lexists(link) and _target(link) is None:
        raise InputError(
            f"port: {link} exists and is no link that could be replaced; remove it, or name another"
        )
    temporary = f"{link}.{os.getpid()}"
    try:
        os.symlink(target, temporary)
        os.replace(temporary, link)
    except OSError as error:
        raise InputError(f"port: cannot make the link {link}: {error.strerror}") from None


def port_maker(port: str) -> Callable[[], PtyPort | TcpPort]:
    """Factory for what `--port` names: ``pty``, ``pty:LINK``, ``tcp:PORT`` or ``tcp:HOST:PORT``."""
    kind, _, rest = port.partition(":")
    if kind == "pty":
        return lambda: PtyPort(rest or None)
    host, _, number = rest.rpartition(":")
    if kind != "tcp" or not number.isdecimal() or int(number) > 65535:
        raise InputError(f"port: {port!r} is none of pty, pty:LINK, tcp:PORT, tcp:HOST:PORT")
    return lambda: TcpPort(host or "127.0.0.1", int(number))
