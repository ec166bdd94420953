"""Fig. 4 of the article: conductors on a sheet of 8 x 8 electrodes, and their images by eq. 1.

Frames come from finite elements with noise and converter, images from the closed form with
electrodes as points: no image is made with the model of its data. A computed sheet has no wrinkles
and no bad joints, which the article names for its own images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.paper_model import paper_transfer
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.scene import FORMAT, Scene, load_scene
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.simulation import Simulator

CONDUCTORS = {place: f"experiment-{place}" for place in ("centre", "side", "corner")}
SHAPES: dict[str, list[dict]] = {  # bare conductors, too; the article shows its own in a figure only, m
    "wide": [{"shape": "rectangle", "center": [0.0, 0.0], "size": [0.06, 0.04], "angle": 20.0}],
    "L-shape": [
        {
            "shape": "polygon",
            "points": [
                [-0.06, -0.06], [0.06, -0.06], [0.06, -0.03], [-0.03, -0.03], [-0.03, 0.06], [-0.06, 0.06]
            ],
        }
    ],
    "two points": [
        {"shape": "disc", "center": [x, 0.0], "radius": 0.0025} for x in (-0.05, 0.05)
    ],
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Image:
    """One image: `potential` (H, W), V; hwhm and error, m, of a single conductor, else None."""

    layout: Layout
    scene: Scene
    potential: np.ndarray
    hwhm: float | None
    error: float | None


def images(layout: Layout) -> dict[str, Image]:
    """Of `CONDUCTORS` and `SHAPES` on `layout`."""
    grid = Grid.for_outline(layout.outline, RESOLUTION)
    transfer = paper_transfer(layout, grid.pixels)
    sensitivity = Sensitivity(transfer)
    square = Gram(transfer).rows(np.arange(len(grid.pixels)))
    square[np.diag_indices_from(square)] += REGULARIZATION
    out = {}
    scenes = {name: load_scene(file) for name, file in CONDUCTORS.items()}
    scenes |= {name: _bare(contacts) for name, contacts in SHAPES.items()}
    for name, scene in scenes.items():
        # all rows at once: nothing moves
        frame = Simulator(layout, scene, row_period=0.0).frame(0.0)
        potential = np.linalg.solve(square, sensitivity.adjoint(frame))
        hwhm = error = None
        if name in CONDUCTORS:
            (contact,) = scene.truth(0.0)
            found = quality(potential[None], [[contact["x"], contact["y"]]], grid)
            hwhm, error = float(found.hwhm[0]), float(found.position_error[0])
        out[name] = Image(layout, scene, grid.fill(potential), hwhm, error)
    return out


def _bare(contacts: list[dict]) -> Scene:
    """`contacts` under the conditions of the experiment."""
    conductor = load_scene(CONDUCTORS["centre"])
    content = {"format": FORMAT, "drive_voltage": conductor.drive_voltage, "contacts": contacts}
    shaped = load_scene(CONDUCTORS["centre"], content)
    return replace(conductor, contacts=shaped.contacts)
