"""What a measurement was taken on: processor, libraries, threads. No host name, no paths."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import re
import sys
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "shapely", "matplotlib", "scikit-fem", "pyeit")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def describe() -> dict:
    """Date, processor, cores, versions and thread counts, in plain types."""
    return {
        "date": datetime.date.today().isoformat(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in LIBRARIES},
        "blas": _blas(),
        "threads": {name: os.environ.get(name) for name in THREADS},
    }


def version(distribution: str) -> str | None:
    """Version of an installed Python distribution, None where it is missing."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def use_one_thread() -> None:
    """Start this program again with libraries held to one thread, unless they are already.

    Libraries read their number of threads when they are loaded, which is before any command runs.
    """
    wanted = {"OMP_NUM_THREADS": "1"}
    wanted |= {name: "1" for name in THREADS if os.environ.get(name, "1") != "1"}
    if all(os.environ.get(name) == value for name, value in wanted.items()):
        return
    sys.stdout.flush()
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | wanted)


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found.group(1).strip() if found else platform.machine()


def _blas() -> str:
    import numpy as np

    try:
        build = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    except (TypeError, KeyError):
        return "unknown"
    return f"{build.get('name')} {build.get('version')}"
