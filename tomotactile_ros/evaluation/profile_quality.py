"""Quality of a layout with one of the reconstruction profiles, on frames from an independent model.

Frames come from finite elements with electrodes as equipotentials, one disc at a time at every
pixel, with the noise of the readings; the profile images them with its own model. Judged is the
pressure image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.point_spread import RESOLUTION
from tomotactile_ros.evaluation.regions import layout_regions
from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import Layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.frames import frame

DRIVE_VOLTAGE = 3.3  # V
RADIUS = 0.005  # of the contact, m
PRESSURE = 20e3  # of the contact, Pa


def evaluate_profile(
    layout: Layout,
    profile: str,
    *,
    radius: float = RADIUS,
    resolution: int = RESOLUTION,
    seed: int = 0,
    track: Callable[[Iterable], Iterable] = iter,
) -> LayoutQuality:
    """Evaluate a layout with a profile.

    Parameters
    ----------
    profile : `fast`, `balanced`, `accurate` or `auto`
    radius : of the contacts, m
    resolution : contact positions, and pixels, along the longer side
    seed : of the noise
    track : wraps the contacts, to show progress

    Raises InputError for an unknown profile.
    """
    settings = Settings(profile, resolution=resolution, contact_radius=radius)
    pipeline = Pipeline(layout, settings)
    grid = Grid.for_outline(layout.outline, resolution)
    transfer = make_sheet(layout, "fem").transfer(grid.pixels, radius)
    conductance = settings.contact_law.conductance(PRESSURE) * np.pi * radius**2
    random = np.random.default_rng(seed)
    grounded = np.arange(layout.electrodes)
    images = np.empty((len(grid.pixels), len(grid.pixels)))
    for k in track(range(len(grid.pixels))):
        voltages = frame(transfer.at([k]), [1 / conductance], DRIVE_VOLTAGE)
        voltages += settings.noise * random.standard_normal(voltages.shape)
        images[k] = grid.gather(pipeline.process(voltages, grounded, DRIVE_VOLTAGE).pressure)
    found = quality(images, grid.pixels, grid)
    how = {
        "profile": pipeline.profile,
        "noise": settings.noise,
        "contact_radius": float(radius),
        "positions": f"{grid.height} x {grid.width}",
    }
    return LayoutQuality(layout, grid, found, layout_regions(layout), None, how)
