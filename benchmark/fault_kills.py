"""Kills of faults.py: every program ended at random moments, and what it leaves behind.

A program runs in an empty folder, with a mark in its environment by which all its descendants are
found. After its end there must be none of them, every file must be whole, and no half-written one
be left over - but for SIGKILL, which leaves nobody to tidy up: then whole files are all that is
asked.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from argparse import Namespace
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from nodes import FOLDER, arguments

from tomotactile_ros.bench.tables import Table
from tomotactile_ros.optimizer.work import Work

MARK = "TOMOTACTILE_FAULTS"
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL)
PATIENCE = 20.0  # s from the signal to the end
GRACE = 10.0  # s more for descendants: a worker that still starts notices when it has started


@dataclass
class Program:
    """A program to be ended: its words, and how long it would take, s."""

    words: list[str]
    span: float
    prepare: list[list[str]] = field(default_factory=list)


def programs() -> dict[str, Program]:
    """All programs, with arguments that make them write files where they do."""
    command, small = [str(FOLDER / "tomotactile")], ["--layout", "equal-4x4"]
    recorded = [*command, "simulate", *small, "--scene", "default", "--frames", "60", "--out"]
    rebuilt = ["reconstruct", "in.npz", *small, "--profile", "balanced", "--out", "out.npz"]
    optimized = ["optimize", "--rows", "3", "--cols", "3", "--method", "free", "--workers", "2"]
    given: dict = {"layout": "equal-4x4"}
    nodes = {name: given for name in ("driver", "reconstruction", "tactile", "driver_lifecycle")}
    nodes["optimizer"] = {"rows": 3, "cols": 3, "workers": 2, "out": "out.yaml", "steps": 2}
    found = {}
    for name, parameters in nodes.items():
        words = arguments(parameters)
        found[name] = Program([str(FOLDER / name), "--ros-args", *words], 6.0)
    return found | {
        "live": Program([str(FOLDER / "live"), "--duration", "8", *small], 8.0),
        "emulator": Program([*command, "emulate", *small, "--port", "pty:port"], 3.0),
        "simulate": Program([*recorded, "out.npz"], 3.0),
        "reconstruct": Program([*command, *rebuilt], 3.0, [[*recorded, "in.npz"]]),
        "optimize": Program([*command, *optimized, "--out", "out.yaml"], 6.0),
        "evaluate": Program([*command, "evaluate", *small], 3.0),
        "record": Program([*command, "record", *small, "--duration", "8", "--out", "out.npz"], 5.0),
        "watch": Program([*command, "watch", *small, "--duration", "8"], 5.0),
        "bench": Program([*command, "bench", "--parts", "stability", "--out", "out.json"], 6.0),
    }


def marked(mark: str) -> list[int]:
    """Processes that carry the mark, zombies left out."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                    found.append(int(folder.name))
    return found


def complaint_about(path: Path) -> str:
    """What is wrong with a file that was left behind; empty where it is whole."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            sizes = {name: archive[name].shape for name in archive.files}
        return "" if sizes else f"{path.name} is empty"
    if path.suffix in (".yaml", ".yml"):
        content = yaml.safe_load(path.read_text())
        return "" if isinstance(content, dict) and content.get("format") else f"{path.name} is cut"
    if path.suffix == ".json":
        json.loads(path.read_text())
        return ""
    if path.suffix in (".search", ".part"):
        Work(path=path, resume=True)  # or it complains
        return ""
    return "" if path.is_symlink() else f"{path.name} is left over"


def broken_files(folder: Path, known: set[str]) -> list[str]:
    """Complaints about all new files of a folder."""
    found = []
    for path in folder.rglob("*"):
        if path.name in known or path.is_dir():
            continue
        try:
            complaint = complaint_about(path)
        except Exception as error:  # noqa: BLE001 - whatever a reader thinks of a broken file
            complaint = f"{path.name}: {type(error).__name__}"
        if complaint:
            found.append(complaint)
    return found


def kill_once(program: Program, moment: float, how: signal.Signals) -> Counter:
    """End the program at that moment (s) in that way; count and tell what is wrong behind it."""
    seen, mark = Counter(), uuid.uuid4().hex

    def tell(what: str, words: str, number: int = 1) -> None:
        seen[what] += number
        print(f"    {how.name} after {moment:.2f} s: {words}", file=sys.stderr)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        home, work, errors = folder / "home", folder / "work", folder / "errors"
        home.mkdir()
        work.mkdir()
        environment = {**os.environ, MARK: mark, "TMPDIR": str(home), "ROS_LOG_DIR": str(home)}
        for words in program.prepare:
            subprocess.run(words, cwd=work, check=True, stdout=subprocess.DEVNULL)
        known = {path.name for path in work.iterdir()}
        with errors.open("wb") as file:
            process = subprocess.Popen(
                program.words, cwd=work, env=environment, stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, stderr=file, start_new_session=True,
            )  # fmt: skip
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moment)
            seen["over before"] += 1
        process.send_signal(how)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            tell("did not end", "still there")
            process.kill()
            process.wait()
        strays = end_strays(mark)
        if strays:
            tell("strays", f"left {', '.join(strays)}", len(strays))
        said = errors.read_text(errors="replace")
        if how != signal.SIGKILL and "Traceback" in said:
            tell("tracebacks", said.strip().splitlines()[-1])
        complaints = broken_files(work, known)
        if how == signal.SIGKILL:
            complaints = [c for c in complaints if not c.endswith("is left over")]
        if complaints:
            tell("broken files", "; ".join(complaints))
    return seen


def end_strays(mark: str) -> list[str]:
    """Give descendants some seconds to end, then end them; the words of each."""
    deadline = time.monotonic() + GRACE
    while (left := marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.05)
    words = dict.fromkeys(left, "?")
    for pid in left:
        with contextlib.suppress(OSError):
            words[pid] = repr(Path(f"/proc/{pid}/cmdline").read_bytes()[:120])
            os.kill(pid, signal.SIGKILL)
    return list(words.values())


def kills(asked: Namespace) -> None:
    """Every program so many times; prints a table."""
    # what a shell has set for a program in the background would be inherited
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    chance = random.Random(1)
    columns = ("over before", "did not end", "strays", "broken files", "tracebacks")
    table = Table("program", "kills", *columns)
    for name, program in programs().items():
        seen = Counter()
        for k in range(asked.times):
            moment = chance.uniform(0.0, program.span)
            seen.update(kill_once(program, moment, SIGNALS[k % len(SIGNALS)]))
        table.add(f"`{name}`", f"{asked.times}", *(f"{seen[column]}" for column in columns))
