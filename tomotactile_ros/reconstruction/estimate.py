"""Contacts and pressure from an image of conductance.

A blob no wider than the image of a point is a disc (see `discs`). Others have the currents into the
grounded electrodes shared out over them, y = sum_b c_b h_b with h_b the mean of H over the core of
blob b, and the way to the grounded electrodes taken off, 1 / g = 1 / c - D, with the mean of D over
all pairs of places in the blob.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import nnls

from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.contacts_in_image import Blob, find_blobs
from tomotactile_ros.reconstruction.discs import fit_discs, shares_of
from tomotactile_ros.reconstruction.grounded_step import LocalImage
from tomotactile_ros.reconstruction.settings import ContactEstimate

EVEN_DISC = float(np.exp(-0.25))  # mean log distance of a disc to itself, in radii
PATCH = 0.447  # the same of a square, in sides
WIDE = 1.6  # a blob is wider than a point from this part of the point's image on
_LEAST = 0.02  # conductance of a contact, in parts of the strongest
_BARE = 0.9  # largest part of the way's conductance that c may reach: a bare conductor has 1
LARGEST = 100.0  # conductance of a contact, times the sheet resistance: as good as a bare conductor
_PLACES = 40  # in a wide blob
_POINTS = 400  # of a disc that is partly off the sheet


@dataclass(frozen=True)
class Strength:
    """Of one contact: position (2,) m, conductance g, S, and area, m^2.

    covariance (2, 2) of the position, m^2; spread (2, 2) the same of the logarithms of conductance and
    radius; certainty : conductance in standard deviations. NaN where they are not known.
    """

    position: np.ndarray
    conductance: float
    area: float
    covariance: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.nan))
    spread: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.nan))
    certainty: float = math.nan


@dataclass(frozen=True)
class Image:
    """values (K,), effective conductance of each pixel, S; its blobs; how strongly each conducts;
    `left_over` of the currents, in parts of them, that no strengths of these contacts explain."""

    values: np.ndarray
    blobs: list[Blob]
    strengths: list[Strength]
    left_over: float


def described(
    local: LocalImage, measured: Grounded, disc_change: np.ndarray, radius: float
) -> Image:
    """The linear image of a frame, and the contacts that it shows.

    Parameters
    ----------
    disc_change : (K,) what D of a disc of `radius` centred on each pixel has above that of the
        pixel, ohm
    radius : of a contact that looks like a point, m
    """
    values = local.image(measured).astype(float)
    blobs = find_blobs(local.grid.fill(values, outside=0.0), local.grid)
    if not blobs:
        return Image(values, [], [], 1.0)
    found = strengths(blobs, values, measured, local, disc_change, radius)
    least = _LEAST * max(strength.conductance for strength in found)
    kept = [i for i, strength in enumerate(found) if strength.conductance >= least]
    blobs, found = [blobs[i] for i in kept], [found[i] for i in kept]
    return Image(values, blobs, found, _left_over(blobs, values, found, measured, local))


def strengths(
    blobs: list[Blob],
    values: np.ndarray,
    measured: Grounded,
    local: LocalImage,
    disc_change: np.ndarray,
    radius: float,
) -> list[Strength]:
    """How strongly each blob of the linear image `values` (K,) conducts; the rest as for
    `described`."""
    point_area, wide = local.point_area(measured), _wide_ones(blobs, measured, local)
    found, others, most = {}, [], LARGEST / local.resistance
    if any(wide):
        cores = [core_of(blob, values) for blob in blobs]
        shares = [local.meter.sheet.share[:, pixels] @ weights for pixels, weights in cores]
        effective = effective_conductances(np.array(shares).T, measured.currents)
        others = [shares[i] * effective[i] for i in range(len(blobs)) if wide[i]]
        for i in np.flatnonzero(wide).tolist():
            found[i] = _wide(blobs[i], cores[i][0], effective[i], local, point_area, radius)
    small = [i for i in range(len(blobs)) if not wide[i]]
    if small:
        places = [tuple(blobs[i].position.tolist()) for i in small]
        discs = fit_discs(
            local, measured, places, others, disc_change, radius, [radius] * len(small)
        )
        for i, disc in zip(small, discs):
            conductance = min(disc.conductance, most)
            known = disc.covariance, disc.spread, disc.certainty
            found[i] = Strength(disc.place, conductance, np.pi * disc.radius**2, *known)
    return [found[i] for i in range(len(blobs))]


def _wide_ones(blobs, measured, local) -> list[bool]:
    """Which blobs are too wide for a disc, or on a grid too coarse for one."""
    usable, most = shares_of(local.grid).usable, WIDE * local.point_area(measured)
    return [not usable or blob.area > most for blob in blobs]


def _left_over(blobs, values, found, measured, local) -> float:
    """What contacts of any strengths at the places `found` leave of the currents, in parts of
    them."""
    shares = []
    for blob, strength, wide in zip(blobs, found, _wide_ones(blobs, measured, local)):
        if wide:
            pixels, weights = core_of(blob, values)
        else:
            pixels, weights = shares_of(local.grid).at(*strength.position.tolist())
            weights = weights[:, 0]
        shares.append(local.meter.sheet.share[:, pixels] @ weights)
    currents = measured.currents.astype(float)
    size = float(np.linalg.norm(currents))
    return float(nnls(np.array(shares).T, currents)[1]) / size if size > 0 else 1.0


def _wide(blob, pixels, effective, local, point_area, radius):
    """`Strength` of a blob with the `pixels` in its upper half and the `effective` conductance,
    S."""
    area = max(np.pi * radius**2, blob.area - point_area)
    conductance = effective / (1 - min(effective * _mean_impedance(pixels, local, area), _BARE))
    conductance = min(float(conductance), LARGEST / local.resistance)
    return Strength(blob.position, conductance, float(area))


def core_of(blob: Blob, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n,) of the blob's upper half and their weights (n,), whose sum is 1."""
    weights = values[blob.pixels] - (0.5 - 1e-9) * blob.peak
    above = weights > 0
    weights = weights[above]
    return blob.pixels[above], weights / weights.sum()


def solve_nonnegative(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x >= 0 that minimises |matrix x - right|, from scratch; the best so far where the steps run
    out."""
    if not matrix.size:  # scipy frees memory twice there, which ends the process
        return np.zeros(matrix.shape[1])
    try:
        return nnls(matrix, right)[0]
    except RuntimeError:
        return np.maximum(np.linalg.lstsq(matrix, right, rcond=None)[0], 0.0)


def effective_conductances(shares: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """(B,) c >= 0 in S from shares h (n, B) and currents y (n,), S; the total is that of the
    currents."""
    if shares.shape[1] == 1:
        return np.maximum(currents.sum(), 0.0).reshape(1)
    found = solve_nonnegative(shares, currents)
    total = found.sum()
    return found * (max(float(currents.sum()), 0.0) / total) if total > 0 else found


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
    """Contacts, strongest first, each as an even disc; and (K,) pressure, Pa: the image's, with each
    contact's force."""
    pressure = np.zeros(len(values))
    contacts = []
    for blob, strength in zip(blobs, found):
        area = strength.area * part_on_sheet(strength.position, strength.area, grid.outline)
        pressed = float(law.pressure(strength.conductance / area))
        shape = np.maximum(values[blob.pixels], 0.0)
        pressure[blob.pixels] += pressed * area * shape / (shape.sum() * grid.cell_area)
        radius = float(np.sqrt(strength.area / np.pi))
        x, y = map(float, strength.position)
        # force = pressure times area, and g = c p^exponent
        slopes = np.array([1 / law.exponent, 2 - 2 / law.exponent])
        relative = math.sqrt(slopes @ strength.spread @ slopes)
        seen = ContactEstimate(
            x,
            y,
            pressed * area,
            pressed,
            float(area),
            radius,
            tuple(strength.covariance.ravel().tolist()),
            pressed * area * relative,
            -math.expm1(-(strength.certainty**2) / 2),
        )
        contacts.append(replace(seen, conductance=strength.conductance))
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
