"""The compiled part: forward model, derivatives and fits (`core/` at the top of the sources).

Two builds of the same sources are tried, the one for processors with AVX2 and FMA first where this
is one: it takes half the time.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
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
    elsewhere = os.environ.get("TOMOTACTILE_CORE")  # a build under test: scripts/sanitize
    if elsewhere:
        spec = spec_from_file_location("tomotactile_ros._core", Path(elsewhere, "_core.so"))
        assert spec is not None and spec.loader is not None
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    if _has_vectors():
        try:
            return import_module("tomotactile_ros._core_v3")
        except ModuleNotFoundError:  # it is not built for every processor
            pass
    try:
        return import_module("tomotactile_ros._core")
    except ModuleNotFoundError:
        raise ImportError(
            f"no compiled core in {Path(__file__).parents[1]}: where that is the source tree, start Python in "
            "another folder, or by scripts/setup"
        ) from None


compiled = _compiled()
