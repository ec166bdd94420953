"""Large-area tactile sensing by electrical impedance tomography.

The names that a program usually needs, for ``import tomotactile_ros as tt``:

    layout, scene = tt.load_layout("equal-8x8"), tt.load_scene("default")
    simulator = tt.Simulator(layout, scene)
    pipeline = tt.Pipeline(layout, tt.Settings("balanced", contact_law=scene.contact_law))
    result = pipeline.process(simulator.measure(0.0))
    tt.plot(result, layout).savefig("pressure.png")

They are listed in ``__init__.pyi``. Each is imported when it is first used: this package also holds the
generated ROS messages, which must load without numpy's relatives.
"""

import re as _re
from importlib import import_module as _import_module
from pathlib import Path as _Path

__version__ = "0.1.0"

_MODULES = {
    name: module
    for module, name in _re.findall(
        r"^from ([\w.]+) import \w+ as (\w+)$",
        _Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"),
        _re.MULTILINE,
    )
}
__all__ = sorted(_MODULES)  # noqa: PLE0605 - read from the stub


def __getattr__(name: str) -> object:
    """Import what is asked for (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(_import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
