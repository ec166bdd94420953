"""Where electrodes may not be they never are, on outlines of any shape.

Distances are those of shapely, and not those that the search uses.
"""

import numpy as np
import pytest
import shapely

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region, regular_polygon
from tomotactile_ros.optimizer.constraints import Constraints, doubts_of

ROUNDING = 3e-9 * 0.25  # m; three billionths of the largest sheet
SPACING, MARGIN = 0.018, 0.004


def odd_sheet(random):
    """(ring, hole): a star of 5 to 11 corners with notches, and a triangle cut out of it."""
    corners = random.integers(5, 12)
    angle = 2 * np.pi * (np.arange(corners) + random.uniform(0, 0.6, corners)) / corners
    reach = random.uniform(0.06, 0.1, corners)
    ring = reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    ring -= (ring.min(axis=0) + ring.max(axis=0)) / 2
    hole = 0.012 * np.array([[1, 0], [-0.5, 0.8], [-0.5, -0.8]]) + random.uniform(-0.01, 0.01, 2)
    return ring, hole


@pytest.mark.parametrize("seed", range(12))
def test_odd_outlines_holes_zones_margin_spacing_and_fixed_electrodes_are_kept(seed):
    random = np.random.default_rng(seed)
    ring, hole = odd_sheet(random)
    outline = Outline.polygon(ring, holes=(hole,))
    zone = regular_polygon(0.012) + random.uniform(-0.05, 0.05, 2)
    free = Constraints(outline, SPACING, MARGIN, (Region(zone),))
    # electrodes that stay: two places that are allowed
    wild = random.uniform(-0.09, 0.09, (400, 2))
    allowed = [each for each in wild if free.kept_by(each[None])]
    held = np.array([allowed[0], max(allowed, key=lambda p: np.linalg.norm(p - allowed[0]))])
    start = np.vstack([held, random.uniform(-0.09, 0.09, (8, 2))])
    constraints = Constraints(outline, SPACING, MARGIN, (Region(zone),), fixed=(0, 1))
    found = constraints.project(start)
    assert found is not None  # ten electrodes have room on each of these sheets
    assert np.array_equal(found[:2], held)
    points, sheet = shapely.points(found), shapely.Polygon(ring, [hole])
    assert shapely.contains(sheet, points).all()
    assert shapely.distance(sheet.boundary, points).min() > MARGIN - ROUNDING
    kept_out = shapely.Polygon(zone)
    within = shapely.contains(kept_out, points)
    assert np.where(within, shapely.distance(kept_out.boundary, points), 0).max() < ROUNDING
    apart = np.linalg.norm(found[:, None] - found, axis=2) + np.eye(len(found))
    assert apart.min() > SPACING - ROUNDING


@pytest.mark.parametrize(
    ("inset", "spacing", "method", "told"),
    [
        (0.004, 0.0088, "", []),
        (0.0, 0.0, "", ["6 electrodes reach up to 4 mm beyond the rim: --margin 0.004 keeps"]),
        (0.003, 0.0, "touch", ["1 mm beyond the rim: --method touch --margin 0.004 keeps"]),
        (0.004, 0.02, "touch", ["2 mm apart, rim to rim: --method touch --spacing sets"]),
    ],
)
def test_electrodes_beyond_the_rim_and_close_ones_are_told(inset, spacing, method, told):
    """Columns 0.01 m apart: gaps of 2 mm."""
    layout = equal_grid(3, 2, (0.01 + 2 * inset, 0.2), 0.004, 1e4, inset=inset)
    found = doubts_of(layout, spacing, method, "--")
    assert len(found) == len(told)
    assert all(part in line for part, line in zip(told, found, strict=True))
