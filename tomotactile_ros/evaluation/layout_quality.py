"""Quality of a layout: HWHM, position error and blur of single contacts, and noise gain.

The default is the set-up of Kojima et al. 2023: bare contacts of 1 mm radius at the pixels of a
40 x 40 image, one step of eq. 1 with lambda^2 = 1000.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.metrics import Quality, quality, statistics
from tomotactile_ros.evaluation.paper_model import default_contact_radius, paper_transfer
from tomotactile_ros.evaluation.point_nodes import point_nodes_transfer
from tomotactile_ros.evaluation.point_spread import (
    REGULARIZATION,
    RESOLUTION,
    PointSpread,
    gram_blocks,
)
from tomotactile_ros.evaluation.regions import Regions, layout_regions
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

MODELS = ("auto", "paper", "closed_form", "fem", "point_nodes")
_SLIVER = 0.01  # of a region: less of it on the sheet is none


@dataclass(frozen=True, eq=False)
class LayoutQuality:
    """What an evaluation found.

    noise_gain : noise of a pixel per noise of a reading, V per V, root mean square; None if not
        known
    settings : how it was evaluated: model or profile, lambda^2, contact radius, resolution
    contacts : how good the reported contacts are, see `scoring.summary`; None for images alone
    """

    layout: Layout
    grid: Grid
    quality: Quality
    regions: Regions
    noise_gain: float | None
    settings: dict
    contacts: dict | None = None

    @property
    def hwhm_map(self) -> np.ndarray:
        """(H, W) HWHM by contact position, m; NaN outside the outline."""
        return self.grid.fill(self.quality.hwhm)

    @property
    def position_error_map(self) -> np.ndarray:
        """(H, W) position error by contact position, m; NaN outside the outline."""
        return self.grid.fill(self.quality.position_error)

    @cached_property
    def region_of(self) -> np.ndarray:
        """(P,) region of each contact."""
        return self.regions.of(self.quality.positions)

    @cached_property
    def region_hwhm(self) -> np.ndarray:
        """(M,) mean HWHM of the contacts in each region, m."""
        return self.regions.means(self.region_of, self.quality.positions, self.quality.hwhm)

    @cached_property
    def areas(self) -> np.ndarray:
        """(M,) area of each region on the sheet, m²."""
        return self.layout.outline.overlaps(self.regions.corners)

    @property
    def on_sheet(self) -> np.ndarray:
        """(M,) bool: regions of which more than a hundredth lies on the sheet."""
        return self.areas > _SLIVER * self.regions.areas

    @cached_property
    def metrics(self) -> dict:
        """Figures in m, plain types: statistics of HWHM, position error and blur, noise gain."""
        quality = self.quality
        worst_region = float(self.region_hwhm[self.on_sheet].max())
        out: dict[str, object] = {
            "hwhm": {**statistics(quality.hwhm), "worst_region": worst_region},
            "position_error": statistics(quality.position_error),
            "blur": statistics(quality.blur),
        }
        if self.noise_gain is not None:
            out["noise_gain"] = self.noise_gain
        return out

    def by_region(self) -> list[dict]:
        """For every region on the sheet: place, contacts, area (m^2), mean HWHM and position error
        (m)."""
        quality, regions = self.quality, self.regions
        error = regions.means(self.region_of, quality.positions, quality.position_error)
        count = np.bincount(self.region_of, minlength=len(error))
        return [
            {
                "row": i // regions.cols,
                "col": i % regions.cols,
                "contacts": int(count[i]),
                "area": float(self.areas[i]),
                "hwhm": float(self.region_hwhm[i]),
                "position_error": float(error[i]),
            }
            for i in np.flatnonzero(self.on_sheet).tolist()
        ]


def evaluate_layout(
    layout: Layout,
    *,
    model: str = "auto",
    regularization: float = REGULARIZATION,
    contact_radius: float | None = None,
    resolution: int = RESOLUTION,
    grounded=None,
    contacts=None,
) -> LayoutQuality:
    """Evaluate a layout with one-step images (eq. 1 of the paper).

    Parameters
    ----------
    model : `paper` (electrodes are points with a radius), `closed_form` or `fem` (both with
        electrodes as equipotentials that shunt the sheet), `point_nodes` (electrodes and contacts
        are nodes of one mesh, which knows no contact radius); `auto` is `paper` for a uniform
        rectangle and `fem` otherwise
    regularization : lambda^2
    contact_radius : m; 1 mm without it, less for electrodes of less than 2 mm
    resolution : contact positions, and pixels, along the longer side
    grounded : (L,) ground conditions that are scanned; those of the layout's scan without it
    contacts : (K, 2) where the contact of each pixel is, m; at its centre without it. Not for
        `point_nodes`

    Raises InputError for a layout that the model cannot treat.
    """
    if model not in MODELS:
        raise InputError(f"model: {model!r} is none of {', '.join(MODELS)}")
    checks.positive(regularization, "regularization", "number")
    if contact_radius is None:
        contact_radius = default_contact_radius(layout)
    checks.length(contact_radius, "contact radius")
    if model == "auto":
        model = "paper" if layout.outline.is_uniform_rectangle else "fem"
    grid = Grid.for_outline(layout.outline, resolution)
    if grounded is None and layout.scan:
        grounded = layout.grounded
    points, symmetry = grid.pixels, None
    if contacts is not None:
        points = np.concatenate([points, contacts])
    if model == "paper":
        if contacts is None:
            symmetry = find_symmetry(grid, layout.positions)
        transfer = paper_transfer(layout, points, contact_radius, symmetry)
        symmetry = symmetry if grounded is None else None
    elif model == "point_nodes":
        if contacts is not None:
            raise InputError("contacts: are nodes at the pixels in model point_nodes")
        transfer = point_nodes_transfer(layout, grid)
    else:
        transfer = make_sheet(layout, model).transfer(points, contact_radius)
    if contacts is None:
        spread = PointSpread(gram_blocks(transfer, grid, symmetry, grounded), regularization)
        found, gain = spread.quality(), spread.noise_gain
    else:
        products = Gram(transfer, grounded).rows(np.arange(len(grid.pixels)))
        square, readings = np.hsplit(products, 2)  # J'J, and J' times the readings of each contact
        square[np.diag_indices_from(square)] += regularization
        found, gain = quality(np.linalg.solve(square, readings).T, contacts, grid), None
    settings = {
        "model": model,
        "regularization": float(regularization),
        "contact_radius": 0.0 if model == "point_nodes" else float(contact_radius),
        "positions": f"{grid.height} x {grid.width}",
    }
    return LayoutQuality(layout, grid, found, layout_regions(layout), gain, settings)
