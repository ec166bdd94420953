"""Large-area tactile sensing by electrical impedance tomography.

The names that a program usually needs, for ``import tomotactile_ros as tt``:

    layout, scene = tt.load_layout("equal-8x8"), tt.load_scene("default")
    simulator = tt.Simulator(layout, scene)
    pipeline = tt.Pipeline(layout, tt.Settings("balanced", contact_law=scene.contact_law))
    result = pipeline.process(simulator.frame(0.0), simulator.grounded, scene.drive_voltage)
    tt.plot(result, layout).savefig("pressure.png")

Each is imported when it is first used: this package also holds the generated ROS messages, which
must load without numpy's relatives.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_MODULES = {
    "InputError": "support.errors",
    "Layout": "layouts.layout",
    "Outline": "layouts.outline",
    "Pipeline": "reconstruction.pipeline",
    "Request": "optimizer.request",
    "Result": "reconstruction.settings",
    "Scene": "scenes.scene",
    "Settings": "reconstruction.settings",
    "Simulator": "simulation",
    "best_of": "optimizer.step",
    "equal_grid": "layouts.layout",
    "greit": "reconstruction.comparison",
    "jac": "reconstruction.comparison",
    "load_calibration": "reconstruction.calibration",
    "load_frames": "frames_file",
    "load_layout": "layouts.layout",
    "load_scene": "scenes.scene",
    "plot": "view.figure",
}

__all__ = [
    "InputError",
    "Layout",
    "Outline",
    "Pipeline",
    "Request",
    "Result",
    "Scene",
    "Settings",
    "Simulator",
    "best_of",
    "equal_grid",
    "greit",
    "jac",
    "load_calibration",
    "load_frames",
    "load_layout",
    "load_scene",
    "plot",
]

if TYPE_CHECKING:
    from tomotactile_ros.frames_file import load_frames
    from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
    from tomotactile_ros.layouts.outline import Outline
    from tomotactile_ros.optimizer.request import Request
    from tomotactile_ros.optimizer.step import best_of
    from tomotactile_ros.reconstruction.calibration import load_calibration
    from tomotactile_ros.reconstruction.comparison import greit, jac
    from tomotactile_ros.reconstruction.pipeline import Pipeline
    from tomotactile_ros.reconstruction.settings import Result, Settings
    from tomotactile_ros.scenes.scene import Scene, load_scene
    from tomotactile_ros.simulation import Simulator
    from tomotactile_ros.support.errors import InputError
    from tomotactile_ros.view.figure import plot


def __getattr__(name: str) -> Any:
    """Import what is asked for (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
