"""Quality of a layout with one of the reconstruction profiles, on frames from another model.

One disc at a time, in every cell of the image but not at its centre, of sizes that differ from the
one that the reconstruction assumes, with the noise of the readings. Where the profile images with
the closed form, the frames come from finite elements; where it images with finite elements, from a
mesh twice as fine. Judged are the pressure image (HWHM, position error) and the reported contacts
(`scoring`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.evaluation.point_spread import RESOLUTION
from tomotactile_ros.evaluation.regions import layout_regions
from tomotactile_ros.evaluation.scoring import score_frame, summary
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

DRIVE_VOLTAGE = 3.3  # V
PRESSURE = 20e3  # of the contact, Pa
SIZES = (0.6, 0.8, 1.2, 1.6)  # of contacts, in parts of the size that the reconstruction assumes
_ELEMENTS = 80  # along the longer side
_PATCHES = 6  # to the width of a contact
_TRIES = 16  # to find a place in a cell


def evaluate_profile(
    layout: Layout,
    profile: str,
    *,
    radius: float | None = None,
    resolution: int = RESOLUTION,
    track: Callable[[Iterable], Iterable] = iter,
) -> LayoutQuality:
    """Evaluate a layout with a profile.

    Parameters
    ----------
    profile : `fast`, `balanced`, `accurate` or `auto`
    radius : of all contacts, m; without it 0.6, 0.8, 1.2 and 1.6 times the one that is assumed
    resolution : cells, one contact in each, and pixels, along the longer side
    track : wraps the contacts, to show progress

    Images that are withheld are left out of the figures of images, and counted in the settings.

    Raises InputError for an unknown profile, where no contact of that radius fits on the sheet, and where
    all images are withheld.
    """
    settings = Settings(profile, resolution=resolution)
    radii = settings.contact_radius * np.array(SIZES)
    if radius is not None:
        radii = np.array([checks.length(radius, "contact radius")])
    pipeline = Pipeline(layout, settings)
    random = np.random.default_rng(0)
    places, sizes = off_lattice(pipeline.grid, radii, random)
    h = max(layout.outline.size) / _ELEMENTS
    sheet = make_sheet(layout, "fem", h=h)
    conductance = float(settings.law.conductance(PRESSURE))
    grounded = layout.grounded
    images, scores = np.empty((len(places), len(pipeline.grid.pixels))), []
    for i in track(range(len(places))):
        disc = Contact("disc", center=places[i], radius=sizes[i], pressure=PRESSURE)
        touch = contact_points(sheet, [(disc.patches(_PATCHES), conductance)])
        voltages = frame(*touch, DRIVE_VOLTAGE)[grounded]
        voltages += settings.noise * random.standard_normal(voltages.shape)
        result = pipeline.process(voltages, grounded, DRIVE_VOLTAGE)
        images[i] = pipeline.grid.gather(result.pressure)
        scores.append(score_frame(result.contacts, [_truth(disc)]))
    how = {
        "profile": pipeline.profile,
        "frames": f"finite elements of {1e3 * h:.3g} mm",
        "noise": settings.noise,
        "contact_radius": sorted(set(sizes.tolist())),
        "positions": f"{len(places)}, one to a cell of {pipeline.grid.height} x "
        f"{pipeline.grid.width}",
    }
    shown = np.isfinite(images).all(axis=1)
    if not shown.any():
        raise InputError(f"{layout.name}: all images are withheld, the last one: {result.reason}")
    if not shown.all():
        how["withheld"] = f"{np.count_nonzero(~shown)}, left out"
    found = quality(images[shown], places[shown], pipeline.grid)
    return LayoutQuality(
        layout, pipeline.grid, found, layout_regions(layout), None, how, summary(scores)
    )


def off_lattice(
    grid: Grid, radii: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A place anywhere in each cell, and a size, so that a disc there lies on the sheet.

    Parameters
    ----------
    grid : gives the cells with their centre on the sheet.
    radii : to choose from, m; where the chosen one fits nowhere in the cell, the smallest.

    Returns
    -------
    (P, 2) places, m, and (P,) radii, m; cells where even the smallest does not fit are left out.
    """
    count = len(grid.pixels)
    sizes = random.choice(radii, count)
    places = grid.pixels.copy()
    left = np.ones(count, bool)
    for attempt in range(2 * _TRIES):
        if attempt == _TRIES:
            sizes[left] = np.min(radii)
        tried = grid.pixels + grid.cell_size * (random.random((count, 2)) - 0.5)
        fits = left & grid.outline.holds(tried, sizes)
        places[fits] = tried[fits]
        left &= ~fits
    if left.all():
        raise InputError(
            f"contact radius: discs of {np.min(radii):g} m fit nowhere on the sheet, smaller ones "
            "are needed"
        )
    return places[~left], sizes[~left]


def _truth(disc: Contact) -> dict:
    x, y = disc.centroid
    return {"x": float(x), "y": float(y), "force": disc.total_force}
