"""The firmware in emulators: builds an image, runs it, and knows what each reading has to be.

Needs `make`, `arm-none-eabi-gcc` and `qemu-system-arm`, for the RP2040 `node` with the package
rp2040js; `missing` says which are not there.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import select
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
NEEDED = ("make", "arm-none-eabi-gcc", "qemu-system-arm")
MACHINE = "mps2-an385"
BOOT_COUNTER = 0x203FFFF0  # of boards/qemu/main.c
SCALE = 3.3 / 2**16  # V per count of a random table
PATIENCE = 30.0


def missing(programs: tuple[str, ...] = NEEDED) -> str:
    """Which programs are not installed, in one line; empty where all are."""
    absent = [program for program in programs if not shutil.which(program)]
    return f"not installed: {', '.join(absent)}" if absent else ""


def node_modules() -> str:
    """Folder of the packages that `npm install -g` installs; empty without npm."""
    if not shutil.which("npm"):
        return ""
    told = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True, check=False)
    return told.stdout.strip()


def missing_rp2040() -> str:
    """What the RP2040 in its emulator lacks, in one line; empty where all is there."""
    if absent := missing((*NEEDED[:2], "node", "npm")):
        return absent
    there = Path(node_modules(), "rp2040js").exists()
    return "" if there else "not installed: rp2040js (npm install -g rp2040js)"


def build(folder: Path, target: str = "qemu.elf", **variables) -> Path:
    """Make `target` of firmware/Makefile in `folder`; return its path."""
    words = [f"{name}={value}" for name, value in variables.items()]
    command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={folder}", *words, f"{folder}/{target}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    return folder / target


def _maker():
    path = FIRMWARE / "boards" / "qemu" / "make_readings.py"
    spec = importlib.util.spec_from_file_location("make_readings", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_table(folder: Path, table: list, bits: int, zero: int = 0, address: int = 0) -> None:
    """Write readings.h, which the image is built with."""
    folder.mkdir(parents=True, exist_ok=True)
    text = _maker().header(table, bits, zero, address)
    (folder / "readings.h").write_text(text, encoding="utf-8")


def random_table(electrodes: int, frames: int) -> np.ndarray:
    """(frames, E, E) counts of 16 bits; that of frame `sequence` is [sequence % frames]."""
    return np.array(_maker().random_table(electrodes, frames))


def simulated_table(layout: str, scene: str) -> list:
    """(1, E, E) counts of 12 bits of a simulated frame."""
    return _maker().simulated_table(layout, scene, 1)


@contextlib.contextmanager
def running(image: Path, *options: str, machine: str = MACHINE, boot: int = 0) -> Iterator[str]:
    """The image in QEMU; gives the port of its UART, ``socket://...``."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    command = ["qemu-system-arm", "-M", machine, "-kernel", str(image), "-nodefaults"]
    command += ["-display", "none", "-monitor", "none"]
    command += [*options, "-serial", f"tcp:127.0.0.1:{number},server=on,wait=off,nodelay=on"]
    if machine == MACHINE:
        word = f"loader,addr=0x{BOOT_COUNTER:x},data=0x{boot:x},data-len=4"
        command += ["-device", word]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        _wait_until_open(process, number)
        yield f"socket://127.0.0.1:{number}"
    finally:
        process.kill()
        process.communicate()


def _wait_until_open(process: subprocess.Popen, number: int) -> None:
    """Wait for the server socket, without connecting: QEMU serves but one host at a time."""
    deadline = time.monotonic() + PATIENCE
    wanted = f":{number:04X}"
    while process.poll() is None and time.monotonic() < deadline:
        sockets = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        if any(s[1].endswith(wanted) and s[3] == "0A" for s in sockets):
            return
        time.sleep(0.02)
    raise RuntimeError(f"QEMU does not serve: {process.stderr.read1().decode()}")


@contextlib.contextmanager
def running_rp2040(image: Path) -> Iterator[dict]:
    """The .uf2 image in its emulator; gives what rp2040_board.cjs prints: the port, and answers."""
    script = Path(__file__).with_name("rp2040_board.cjs")
    process = subprocess.Popen(
        ["node", str(script), str(image)], env={**os.environ, "NODE_PATH": node_modules()},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        ready = select.select([process.stdout], [], [], PATIENCE)[0]
        told = process.stdout.readline() if ready else ""
        if not told:
            process.kill()
            raise RuntimeError(f"the emulator says nothing: {process.stderr.read()}")
        yield json.loads(told)
    finally:
        process.kill()
        process.communicate()
