"""A byte line to a device: finds and opens the port, reads what is there, tells why it cannot.

Everything here is pyserial. Of what `serial_for_url` opens, only ttys, `socket://host:port` and
`rfc2217://host:port` are let through, without options: others write files, load modules or flood
the log, and the name of a port may come from the network.
"""

from __future__ import annotations

import errno
import glob
import os
import re
import select
import stat
import time
from queue import Queue

import serial
from serial.tools import list_ports

_ON_THE_NETWORK = re.compile(
    r"(socket|rfc2217)://([\w.-]+|\[[0-9a-f:.%]+\]):(\d{1,5})/?", re.IGNORECASE | re.ASCII
)


class LineFault(Exception):
    """The line or the device behind it is not usable now; `state` is that of `base.Status`."""

    def __init__(self, state: str, message: str) -> None:
        super().__init__(message)
        self.state = state


def complaint_about(port: str) -> str:
    """Why nothing of this name is ever opened, in one line; empty where it may be."""
    if "\0" in port or not port.isprintable():
        return f"port: {port[:80]!r} has characters that no port's name has"
    if port.lower().startswith("usb:"):
        if not re.fullmatch(r"usb:[0-9a-f]{1,4}:[0-9a-f]{1,4}(:.+)?", port, re.IGNORECASE):
            return f"port: {port[:80]!r} is not usb:VID:PID[:SERIAL] with hexadecimal ids"
    elif "://" in port:
        scheme = port.partition(":")[0].lower()
        if scheme not in ("socket", "rfc2217"):
            return f"port: {port[:80]!r} is none of /dev/..., usb:, socket://, rfc2217://"
        found = _ON_THE_NETWORK.fullmatch(port)
        if not found or int(found[3]) > 65535:
            return f"port: {port[:80]!r} is not {scheme}://HOST:PORT, without options"
    return ""


def find_port(port: str) -> str:
    """Turn what the user wrote into what pyserial opens.

    Parameters
    ----------
    port : str
        ``usb:VID:PID`` or ``usb:VID:PID:SERIAL`` (hexadecimal ids), ``socket://HOST:PORT``,
        ``rfc2217://HOST:PORT``, a path under /dev or of a link that leads there, a pattern such as
        ``/dev/serial/by-id/*skin*``, or a bare name such as ``ttyUSB0``.

    Raises
    ------
    LineFault
        Nothing or more than one thing fits, or it is no port.
    """
    complaint = complaint_about(port)
    if complaint:
        raise LineFault("refused", complaint)
    if port.lower().startswith("usb:"):
        return _the_only(_usb_ports(port), port)
    if "://" in port:
        return port
    path = port if os.sep in port else os.path.join("/dev", port)
    if any(c in path for c in "*?["):
        return _the_only([p for p in sorted(glob.glob(path)) if _is_device(p)], port)
    if os.path.exists(path) and not _is_device(path):
        raise LineFault("refused", f"port: {path} is no device under /dev")
    return path


def _is_device(path: str) -> bool:
    """Whether it is, or leads to, a character device under /dev."""
    target = os.path.realpath(path)
    try:
        return target.startswith("/dev/") and stat.S_ISCHR(os.stat(target).st_mode)
    except OSError:
        return False


def _usb_ports(port: str) -> list[str]:
    parts = port.split(":", 3)[1:]
    vendor, product = int(parts[0], 16), int(parts[1], 16)
    try:
        ports = list_ports.comports()
    except Exception as error:  # noqa: BLE001 - an adapter that goes while it is asked about
        raise LineFault("disconnected", f"port: cannot look for it ({_reason(error)})") from None
    return [
        found.device
        for found in ports
        if (found.vid, found.pid) == (vendor, product)
        and (len(parts) < 3 or found.serial_number == parts[2])
    ]


def _the_only(found: list[str], port: str) -> str:
    if not found:
        raise LineFault("disconnected", f"port: nothing that fits {port!r} is plugged in")
    if len(found) > 1:
        raise LineFault("refused", f"port: {port!r} fits {', '.join(found)}; name one of them")
    return found[0]


class Line:
    """An open port with non-blocking writes and reads that wait for the first byte only.

    Each read begins with a rest of `GATHER` seconds, so that a fast device costs some wake-ups a
    second and not one per packet.  The rest comes before the wait and not behind it: then a frame's
    last bytes wake the host once.  There is none after a read of `MUCH` bytes: then the host is
    behind, and a tty hands over 4095 bytes at a time however many are waiting.  Reads go to one
    buffer: `os.read` would take `CHUNK` bytes each time and give most of them back, and the
    holes grow into several MB within minutes.
    """

    GATHER = 0.0002
    MUCH = 2048
    CHUNK = 1 << 16

    def __init__(self, port: serial.SerialBase) -> None:
        self._port = port
        self.name, self.baud = port.port, port.baudrate
        self._behind = False
        self._buffer = memoryview(bytearray(self.CHUNK))
        try:
            self._fd: int | None = port.fileno()
        except OSError:
            self._fd = None
        self.low_latency = _ask_low_latency(port)

    def read(self, timeout: float) -> bytes:
        """Bytes that have arrived, waiting up to `timeout` s for the first; b"" if none came."""
        try:
            if self._fd is not None:
                return self._read_fd(self._fd, timeout)
            return self._read_port(timeout)
        except (OSError, ValueError, TypeError) as error:
            raise LineFault("disconnected", f"port: connection lost ({_reason(error)})") from None

    def write(self, data: bytes) -> None:
        """Send `data`; commands are short, a line that does not take them in time is lost."""
        try:
            self._port.write(data)
        except (OSError, ValueError, TypeError) as error:
            raise LineFault("disconnected", f"port: connection lost ({_reason(error)})") from None

    def close(self) -> None:
        """Close the port, whatever state it is in."""
        try:
            self._port.close()
        except (OSError, ValueError, TypeError):
            pass

    def _read_fd(self, fd: int, timeout: float) -> bytes:
        if not self._behind:
            time.sleep(self.GATHER)
        if not select.select([fd], [], [], timeout)[0]:
            return b""
        length = os.readv(fd, [self._buffer])
        if not length:
            raise OSError(errno.EIO, "the other end has closed it")
        self._behind = length >= self.MUCH
        return self._buffer[:length].tobytes()

    def _read_port(self, timeout: float) -> bytes:
        deadline = time.monotonic() + timeout
        while True:
            data = self._port.read(1)
            if data:
                return data + self._rest()
            if time.monotonic() >= deadline:
                return b""

    def _rest(self) -> bytes:
        """What has come meanwhile; from RFC 2217's queue of single bytes all at once.

        pyserial takes them out one by one, slower than a network brings them: the queue would grow.
        """
        waiting = getattr(self._port, "_read_buffer", None)
        if not isinstance(waiting, Queue):
            return self._port.read(self._port.in_waiting)
        with waiting.mutex:
            data = b"".join(filter(None, waiting.queue))
            waiting.queue.clear()
        return data


def open_line(port: str, baud: int) -> Line:
    """Open `port` (see `find_port`) at `baud` bit/s; `LineFault` says why it could not be."""
    name = find_port(port)
    of_a_tty = {} if "://" in name else {"exclusive": True, "write_timeout": 0.5}
    try:
        return Line(serial.serial_for_url(name, baudrate=baud, timeout=0.02, **of_a_tty))
    except Exception as error:  # noqa: BLE001 - pyserial lets termios.error and others through
        raise _why_not(port, name, error) from None


def _why_not(port: str, name: str, error: Exception) -> LineFault:
    code = getattr(error, "errno", None)
    if code == errno.ENOENT:
        here = f" (there is {port} here: write ./{port})" if os.path.exists(port) else ""
        return LineFault(
            "disconnected",
            f"port: {name} does not exist{here}; plug the sensor in or correct `port`",
        )
    if code in (errno.EACCES, errno.EPERM):
        return LineFault(
            "disconnected",
            f"port: no permission to open {name}; add the user to its group (often dialout)",
        )
    if code == errno.EBUSY or "exclusively lock" in str(error):
        return LineFault("disconnected", f"port: {name} is in use by another program")
    if isinstance(error, ValueError):
        return LineFault("refused", f"port: {name} cannot be opened: {error}")
    return LineFault("disconnected", f"port: {name} cannot be opened ({_reason(error)})")


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())


def _ask_low_latency(port: serial.SerialBase) -> bool:
    """Ask the system to hand bytes over at once (ASYNC_LOW_LATENCY); False where it cannot."""
    try:
        port.set_low_latency_mode(True)
    except (AttributeError, OSError, ValueError, NotImplementedError):
        return False
    return True
