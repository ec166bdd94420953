"""Contacts and pressure from an image of conductance.

Each blob is a disc (see `discs`). One that is wider than the image of a point is none, and several
near each other may be parts of one contact: one linear step does not tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import nnls

from tomotactile_ros.estimation.arrangement import most_together
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.contacts_in_image import Blob, find_blobs
from tomotactile_ros.reconstruction.discs import Disc, fit_discs, shares_of
from tomotactile_ros.reconstruction.grounded_step import LocalImage
from tomotactile_ros.reconstruction.settings import ContactEstimate

EVEN_DISC = float(np.exp(-0.25))  # mean log distance of a disc to itself, in radii
PATCH = 0.447  # the same of a square, in sides
WIDE = 1.6  # a blob is wider than a point from this part of the point's image on
_LEAST = 0.02  # conductance of a contact, in parts of the strongest
LARGEST = 100.0  # conductance of a contact, times the sheet resistance: as good as a bare conductor
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
) -> Image | None:
    """The linear image of a frame and the discs that it shows; None where these would be a guess: a
    blob is wider than a disc, or three are so near each other that they may be one wide contact.

    Parameters
    ----------
    disc_change : (K,) what D of a disc of `radius` centred on each pixel has above that of the
        pixel, ohm
    radius : of a contact that looks like a point, m
    """
    values = local.image(measured).astype(float)
    blobs = find_blobs(local.grid.fill(values, outside=0.0), local.grid)
    shares, most = shares_of(local.grid), WIDE * local.point_area(measured)
    if not blobs or not shares.usable or any(blob.area > most for blob in blobs):
        return None
    places = [tuple(blob.position.tolist()) for blob in blobs]
    discs = fit_discs(local, measured, places, disc_change, radius)
    least = _LEAST * max(disc.conductance for disc in discs)
    kept = [i for i, disc in enumerate(discs) if disc.conductance >= least]
    found = [_strength(discs[i], LARGEST / local.resistance) for i in kept]
    if most_together(np.array([each.position for each in found]), local.spacing) > 2:
        return None
    left_over = _left_over(found, measured, local)
    return Image(values, [blobs[i] for i in kept], found, left_over)


def _strength(disc: Disc, most: float) -> Strength:
    known = disc.covariance, disc.spread, disc.certainty
    return Strength(disc.place, min(disc.conductance, most), np.pi * disc.radius**2, *known)


def _left_over(found: list[Strength], measured: Grounded, local: LocalImage) -> float:
    """What discs of any strengths at the places `found` leave of the currents, in parts of them."""
    columns = []
    for strength in found:
        pixels, weights = shares_of(local.grid).at(*strength.position.tolist())
        columns.append(local.meter.sheet.share[:, pixels] @ weights[:, 0])
    currents = measured.currents.astype(float)
    size = float(np.linalg.norm(currents))
    return float(nnls(np.array(columns).T, currents)[1]) / size if size > 0 else 1.0


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


def all_as_one(values, spacing, law, grid) -> tuple[ContactEstimate, np.ndarray]:
    """All that an image of conductance (K,), S, shows as one contact, where it shows no single ones; and
    (K,) its pressure, Pa.

    It is in the centre, with the deviation of what the image shows and half the `spacing` of electrodes,
    m, which an image resolves: each of several contacts is as far from there. Its force has a deviation of
    its own size.
    """
    shown = np.maximum(values, 0.0)
    pressure = law.pressure(shown / grid.cell_area)
    weights = shown / shown.sum()
    centre = weights @ grid.pixels
    apart = grid.pixels - centre
    covariance = (weights[:, None] * apart).T @ apart + (spacing / 2) ** 2 * np.eye(2)
    radius = 2.0 * float(np.linalg.det(covariance)) ** 0.25  # an even disc has half of it
    area, force = np.pi * radius**2, float(pressure.sum() * grid.cell_area)
    contact = ContactEstimate(
        float(centre[0]),
        float(centre[1]),
        force,
        force / area,
        area,
        radius,
        tuple(covariance.ravel().tolist()),
        force_std=force,
        probability=1.0,
    )
    return replace(contact, conductance=float(shown.sum())), pressure


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
