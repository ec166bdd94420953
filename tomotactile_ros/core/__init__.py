"""The compiled part: forward model, derivatives and fits (`core/` at the top of the sources).

Two builds of the same sources are tried, the one for processors with AVX2 and FMA first where this
is one: it takes half the time.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

_WANTED = {"avx2", "bmi2", "fma"}


def _has_vectors() -> bool:
    """Whether the processor has what x86-64-v3 asks for, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return False
    return any(_WANTED <= set(line.split()) for line in lines if line.startswith("flags"))


def _compiled() -> Any:
    if _has_vectors():
        try:
            return import_module("tomotactile_ros._core_v3")
        except ModuleNotFoundError:  # it is not built for every processor
            pass
    return import_module("tomotactile_ros._core")


compiled = _compiled()
