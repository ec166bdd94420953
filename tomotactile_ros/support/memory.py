"""How much memory there is, and one line for work that needs more."""

from __future__ import annotations

import resource

from tomotactile_ros.support.checks import size
from tomotactile_ros.support.errors import InputError

_SHARE = 0.7  # of what is free that one piece of work may take


def free_bytes() -> float:
    """Memory that new work may take without driving others out; infinite where nobody says."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    free = float("inf") if limit == resource.RLIM_INFINITY else float(limit)
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            lines = dict(line.split(":") for line in file)
        free = min(free, 1024.0 * float(lines["MemAvailable"].split()[0]))
    except (OSError, ValueError, KeyError):
        pass
    return free


def check(needed: float, what: str) -> None:
    """Refuse work that needs more bytes than are free; `what` begins the complaint."""
    free = _SHARE * free_bytes()
    if needed > free:
        raise InputError(f"{what} would take about {size(needed)} of memory, {size(free)} are free")
