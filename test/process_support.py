"""Programs in processes of their own: run, which they have started, and which are still there."""

import subprocess
import sys
from pathlib import Path

from warm_start import begin


def python(*words, warm=True, **how) -> subprocess.CompletedProcess:
    """Python with these words of the command line, to its end, see `begin`; what it writes is text."""
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **how}
    with begin([sys.executable, *map(str, words)], warm, **how) as process:
        try:
            said = process.communicate(timeout=600.0)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(process.args, process.returncode, *said)


def descendants(pid):
    """Process ids of all that a process has started."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found += [child, *descendants(child)]
    return found


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
