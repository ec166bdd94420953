"""Starts a program and stops it after a moment, over and over; what does not end well is shown.

    scripts/setup python3 benchmark/start_stop.py reconstruction --times 200
    python3 benchmark/start_stop.py tactile.launch.py composed:=true --times 40   # with a full ROS 2

The moment is drawn anew each time, from before the first import to well after the start, but not
before the program catches signals: until then the kernel ends it. The signal is SIGINT or SIGTERM,
once or twice as under a launch. Ends with status 1 if any run did not end with status 0, wrote an
error, or took longer than launch waits (5 s).

A launch gets one SIGINT, once the first of its nodes catch signals: as from a terminal, which sends
it to all that was started, or without a terminal and alone. Not two: launch of Jazzy then hangs now
and then, with any launch file. It may take as long as its nodes (20 s).
"""

import argparse
import collections
import os
import pty
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ament_index_python.packages import get_package_prefix

PATIENCE = 5.0  # s from SIGINT to launch's SIGTERM
PACKAGE = "tomotactile_ros"
OF_LAUNCH = 20.0  # s, as tactile.launch.py has it
BAD = ("Traceback", "ERROR", "Fatal", "terminate called", "Exception", "escalating")


def main() -> int:
    """Run, and print a table of exit statuses."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", help="of this package, or one of its launch files")
    parser.add_argument("arguments", nargs="*", help="of a launch file")
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--longest", type=float, default=5.0, help="s until the signal")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_intermixed_args()
    launched = options.program.endswith(".launch.py")
    command = [str(Path(get_package_prefix(PACKAGE), "lib", PACKAGE, options.program))]
    if launched:
        command = ["ros2", "launch", PACKAGE, options.program, *options.arguments]
    patience = OF_LAUNCH if launched else PATIENCE
    # in the background a shell lets it be ignored, and so would the program while it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng = random.Random(options.seed)
    statuses, durations, bad = collections.Counter(), [], 0
    _, terminal = pty.openpty()  # a launch with a terminal expects that it tells all
    written = tempfile.TemporaryFile()  # noqa: SIM115 - to the end
    for number in range(options.times):
        wait, kind, twice = (
            rng.uniform(0.0, options.longest), rng.choice(["INT", "INT", "TERM"]), rng.random() < 0.5
        )  # fmt: skip
        kind = "INT" if launched else kind
        twice = twice and not launched
        at_terminal = launched and rng.random() < 0.5
        send = os.killpg if at_terminal else os.kill
        written.seek(0)
        written.truncate()
        process = subprocess.Popen(
            command, stdin=terminal if at_terminal else subprocess.DEVNULL, stdout=written,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip

        def begun(launched=launched, process=process):
            pids = children_of(process.pid) if launched else [process.pid]
            return pids and all(catches(pid, signal.SIGTERM) for pid in pids)

        while process.poll() is None and not begun():
            time.sleep(0.002)
        time.sleep(wait)
        begin = time.monotonic()
        for _ in range(1 + twice):
            if process.poll() is None:
                send(process.pid, getattr(signal, f"SIG{kind}"))
            time.sleep(0.01)
        process.wait()
        output = os.pread(written.fileno(), size(written), 0).decode(errors="replace")
        durations.append(time.monotonic() - begin)
        statuses[process.returncode] += 1
        if process.returncode or any(word in output for word in BAD) or durations[-1] > patience:
            bad += 1
            print(
                f"{number}: SIG{kind}{' twice' if twice else ''} after {wait:.2f} s, status "
                f"{process.returncode} after {durations[-1]:.2f} s\n{output}",
                flush=True,
            )
    durations.sort()
    print(
        f"{options.times} starts and stops of {options.program}: statuses {dict(statuses)}, {bad} bad; "
        f"end after {durations[len(durations) // 2]:.2f} s (median), {durations[-1]:.2f} s (longest)"
    )
    return 1 if bad else 0


def size(file) -> int:
    """Bytes in a file that others write to."""
    return os.fstat(file.fileno()).st_size


def children_of(pid: int) -> list[int]:
    """What a process has started (proc(5))."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def catches(pid: int, number: int) -> bool:
    """Whether a process has a handler for a signal (proc(5): SigCgt)."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:  # it has ended
        return True
    return bool(int(text.split("SigCgt:")[1].split()[0], 16) >> (number - 1) & 1)


if __name__ == "__main__":
    sys.exit(main())
