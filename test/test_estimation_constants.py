"""The constants of estimation and learning in docs/estimation.md: all of them, with the values of the code."""

import importlib
import pkgutil
import re
from fractions import Fraction
from pathlib import Path

import pytest

from tomotactile_ros import estimation, learning

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "estimation.md").read_text(
    encoding="utf-8"
)
SECTION = TEXT.split("\n## Constants\n")[1]
ROWS = re.findall(r"^\| `([\w.]+)` \| ([^|]+?) \|", SECTION, re.MULTILINE)
# block sizes, guards against rounding, keys of files, resolutions of pictures
INTERNAL = {
    *(
        "shape._ROUNDING",
        "uneven._ISOTROPIC",
        "tables._TINY",
        "tables._BLOCK",
    ),
    *(
        "estimator._SAME_TIME",
        "follow._COST",
        "scatter._OF_NORMAL",
        "search.CUT_OFF",
        "state._HOUR",
        "picture._CELLS",
    ),
    *("readings._GRID", "readings._WIDTH", "file.MAX_BYTES", "file._DIGITS", "file._NEARLY"),
    *("channels.KINDS", "displacement._RING"),
    *("file._MOST_MODES", "file._MOST_PLACES", "disc.MOST_PATCHES"),
    *("row_state.STATE", "row_state.STRENGTH", "touch.PARAMETERS", "forward.RATED"),
    *(f"touch.{name}" for name in ("X", "Y", "CONDUCTANCE", "RADIUS", "STRETCH", "SHEAR")),
}


def modules():
    """Modules of both packages by their names."""
    return {
        each.name: importlib.import_module(f"{package.__name__}.{each.name}")
        for package in (learning, estimation)
        for each in pkgutil.iter_modules(package.__path__)
    }


def numbers(value):
    """Tuple of floats of a number or a tuple of numbers; None of anything else."""
    values = value if isinstance(value, tuple) else (value,)
    good = values and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    return tuple(float(v) for v in values) if good else None


def own_constants():
    """Name, with its module, and value of each number that a module itself assigns."""
    for name, module in modules().items():
        source = Path(module.__file__).read_text(encoding="utf-8")
        for line in re.findall(r"^([A-Z_][A-Z_, ]*?) = ", source, re.MULTILINE):
            for constant in line.split(", "):
                value = numbers(getattr(module, constant))
                if value is not None:
                    yield f"{name}.{constant}", value


def field_default(name):
    """Default of a field of a data class, `module.Class.field`."""
    module, kind, field = name.split(".")
    return numbers(getattr(getattr(modules()[module], kind), field))


def test_every_constant_is_listed_once():
    listed = [name for name, _ in ROWS]
    assert len(listed) == len(set(listed))
    existing = {name for name, _ in own_constants()}
    assert existing - INTERNAL - set(listed) == set()
    assert INTERNAL - existing == set()


def test_the_values_are_those_of_the_code():
    existing = dict(own_constants())
    wrong = {}
    for name, value in ROWS:
        written = tuple(float(Fraction(number)) for number in value.split(", "))
        found = existing.get(name) or field_default(name)
        if found != pytest.approx(written, rel=1e-3):
            wrong[name] = (value, found)
    assert wrong == {}
