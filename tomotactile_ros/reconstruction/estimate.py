"""Contacts and pressure from an image of conductance.

A blob no wider than the image of a point is a disc (see `discs`). Others have the currents into the
grounded electrodes shared out over them, y = sum_b c_b h_b with h_b the mean of H over the core of
blob b, and the way to the grounded electrodes taken off, 1 / g = 1 / c - D, with the mean of D over
all pairs of places in the blob; where the image is that of g, they have its sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tomotactile_ros.outline import Outline
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.contacts import Blob
from tomotactile_ros.reconstruction.discs import fit_discs, shares_of
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import solve_nonnegative
from tomotactile_ros.reconstruction.settings import ContactEstimate

EVEN_DISC = float(np.exp(-0.25))  # mean log distance of a disc to itself, in radii
PATCH = 0.447  # the same of a square, in sides
WIDE = 1.6  # a blob is wider than a point from this part of the point's image on
_DISC = 0.4  # radius of a contact that still counts as a disc, in spacings of the electrodes,
_RESOLVED = 0.5  # and where the image is that of g, which does not break into spots
_SEEN = 0.23  # radius from which on the image tells the size of a contact, in spacings
_BARE = 0.9  # largest part of the way's conductance that c may reach: a bare conductor has 1
LARGEST = 100.0  # conductance of a contact, times the sheet resistance: as good as a bare conductor
_PLACES = 40  # in a wide blob
_POINTS = 400  # of a disc that is partly off the sheet


@dataclass(frozen=True)
class Strength:
    """Of one contact: position (2,) m, conductance g, S, and area, m^2; to be shown as a disc of
    that area or not."""

    position: np.ndarray
    conductance: float
    area: float
    is_disc: bool = False


def strengths(
    blobs: list[Blob],
    values: np.ndarray,
    measured: Grounded,
    local: LocalImage,
    disc_change: np.ndarray,
    point_area: float,
    radius: float,
    exact: np.ndarray | None = None,
    resolved: bool = False,
) -> list[Strength]:
    """How strongly each blob of the image `values` (K,) conducts.

    Parameters
    ----------
    measured : of the frame
    disc_change : (K,) what D of a disc of `radius` centred on each pixel has above that of the
        pixel, ohm
    point_area : area of the upper half of a point's image, m^2
    radius : of a contact that looks like a point, m
    exact : (K,) the image before it was smoothed, if it was: its moments tell the size of contacts
    resolved : the image is that of g, and discs are to be shown as such
    """
    largest = _RESOLVED if resolved else _DISC
    radii, wide = _sizes(blobs, exact, local, point_area, radius, largest * local.spacing)
    found, others, most = {}, [], LARGEST / local.resistance
    if any(wide):
        cores = [core_of(blob, values) for blob in blobs]
        shares = [local.meter.sheet.share[:, pixels] @ weights for pixels, weights in cores]
        effective = effective_conductances(np.array(shares).T, measured.currents)
        others = [shares[i] * effective[i] for i in range(len(blobs)) if wide[i]]
        for i in range(len(blobs)):
            if wide[i] and not resolved:
                found[i] = _wide(blobs[i], cores[i][0], effective[i], local, point_area, radii[i])
    small = [i for i in range(len(blobs)) if not wide[i]]
    if small:
        places = [tuple(blobs[i].position.tolist()) for i in small]
        expected = [radii[i] for i in small]
        discs = fit_discs(local, measured, places, others, disc_change, radius, expected)
        for i, disc in zip(small, discs):
            conductance = min(disc.conductance, most)
            found[i] = Strength(disc.place, conductance, np.pi * disc.radius**2, resolved)
    if resolved:
        sums = np.array([values[blob.pixels].sum() for blob in blobs])
        sums *= values.sum() / sums.sum()  # what is in no blob
        for i in set(range(len(blobs))).difference(small):
            found[i] = Strength(blobs[i].position, float(sums[i]), np.pi * radii[i] ** 2)
    return [found[i] for i in range(len(blobs))]


def _wide(blob, pixels, effective, local, point_area, radius):
    """`Strength` of a blob with the `pixels` in its upper half and the `effective` conductance,
    S."""
    area = max(np.pi * radius**2, blob.area - point_area)
    conductance = effective / (1 - min(effective * _mean_impedance(pixels, local, area), _BARE))
    conductance = min(float(conductance), LARGEST / local.resistance)
    return Strength(blob.position, conductance, float(area))


def _sizes(blobs, exact, local, point_area, radius, largest):
    """Radius of each blob, m, as far as the image tells it, and whether it is too wide for a
    disc."""
    if exact is None:
        radii = [radius] * len(blobs)
        wide = [blob.area > WIDE * point_area for blob in blobs]
    else:
        radii = [seen_radius(blob.pixels, exact, local, radius) for blob in blobs]
        wide = [seen > largest for seen in radii]
    return radii, wide if shares_of(local.grid).usable else [True] * len(blobs)


def core_of(blob: Blob, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n,) of the blob's upper half and their weights (n,), whose sum is 1."""
    weights = values[blob.pixels] - (0.5 - 1e-9) * blob.peak
    above = weights > 0
    weights = weights[above]
    return blob.pixels[above], weights / weights.sum()


def effective_conductances(shares: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """(B,) c >= 0 in S from shares h (n, B) and currents y (n,), S; the total is that of the
    currents."""
    if shares.shape[1] == 1:
        return np.maximum(currents.sum(), 0.0).reshape(1)
    found = solve_nonnegative(shares, currents)
    total = found.sum()
    return found * (max(float(currents.sum()), 0.0) / total) if total > 0 else found


def seen_radius(
    pixels: np.ndarray, values: np.ndarray, local: LocalImage, expected: float
) -> float:
    """Radius of the disc with the second moment of the image `values` (K,) at `pixels` (n,), m.

    An even disc has r^2 / 2; a point that falls between pixels is spread over them by about half a
    cell. Below a fraction of the electrodes' spacing the image does not tell, and `expected` (m)
    stands.
    """
    weights, points = values[pixels], local.grid.pixels[pixels]
    total = weights.sum()
    if not total > 0:
        return expected
    centre = weights @ points / total
    moment = weights @ ((points - centre) ** 2).sum(axis=1) / total
    radius = float(np.sqrt(max(2 * moment - local.grid.cell_area / 2, 0.0)))
    return radius if radius > max(_SEEN * local.spacing, expected) else expected


def _mean_impedance(pixels, local, area) -> float:
    """Mean of D over all pairs of places in a blob of many `pixels`, ohm; a few pixels stand for
    all."""
    chosen = pixels[:: max(1, int(np.ceil(len(pixels) / _PLACES)))]
    sheet = local.meter.sheet
    block = sheet.among(chosen)
    coarser = area / len(chosen) / local.grid.cell_area  # each stands for so many pixels
    own = block.diagonal() - local.resistance / (4 * np.pi) * np.log(max(coarser, 1.0))
    total = block.sum() - block.diagonal().sum() + np.maximum(own, 0.0).sum()
    return max(float(total) / len(chosen) ** 2, 0.0)


def contacts_and_pressure(blobs, values, found, law, grid):
    """Contacts, strongest first, and (K,) pressure, Pa, that shows them: peak, area and force are
    the image's."""
    pressure = np.zeros(len(values))
    contacts = []
    for blob, strength in zip(blobs, found):
        area = strength.area * part_on_sheet(strength.position, strength.area, grid.outline)
        force = float(law.pressure(strength.conductance / area)) * area
        shown_area = strength.area if strength.is_disc else blob.area
        radius = float(np.sqrt(shown_area / np.pi))
        if strength.is_disc:
            pixels, shape = disc_cells(strength.position, radius, grid)
        else:
            pixels, shape = blob.pixels, np.maximum(values[blob.pixels], 0.0)
            area = np.count_nonzero(shape) * grid.cell_area
        shown = force * shape / (shape.sum() * grid.cell_area)
        pressure[pixels] += shown
        x, y = strength.position
        contacts.append(
            ContactEstimate(float(x), float(y), force, float(shown.max()), float(area), radius)
        )
    return sorted(contacts, key=lambda contact: -contact.force), pressure


def part_on_sheet(position: np.ndarray, area: float, outline: Outline) -> float:
    """How much of a disc of `area` (m^2) at `position` (2,), m, is on the sheet: nothing presses
    beside it."""
    radius = np.sqrt(area / np.pi)
    if (
        outline.is_uniform_rectangle
        and (np.abs(position) + radius <= np.divide(outline.size, 2)).all()
    ):
        return 1.0
    points = position + radius * _disc_points()
    return max(float(outline.contains(points).mean()), 1 / _POINTS)


@lru_cache(maxsize=1)
def _disc_points() -> np.ndarray:
    """(`_POINTS`, 2) points spread evenly over a disc of radius 1, on a sunflower's spiral."""
    number = np.arange(_POINTS) + 0.5
    angle = np.pi * (1 + np.sqrt(5)) * number
    return np.sqrt(number / _POINTS)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def disc_cells(position, radius, grid):
    """Pixels (n,) that a disc covers, and the part of each that it does: 1 within, falling over the
    rim's cell."""
    distance = np.hypot(*(grid.pixels - position).T)
    covered = np.clip((radius - distance) / np.sqrt(grid.cell_area) + 0.5, 0.0, 1.0)
    pixels = np.flatnonzero(covered)
    if not len(pixels):
        return np.array([distance.argmin()]), np.ones(1)
    return pixels, covered[pixels]
