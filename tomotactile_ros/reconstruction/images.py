"""The image of each profile, from what the grounded electrodes would measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.reconstruction.active_set import Memory
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.conductance import conductance_image
from tomotactile_ros.reconstruction.contacts import FLOOR, SHARP_FLOOR, Blob, find_blobs
from tomotactile_ros.reconstruction.estimate import (
    DISC,
    EVEN_DISC,
    WIDE,
    Strength,
    seen_radius,
    strengths,
)
from tomotactile_ros.reconstruction.grounded import RecentBlock
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import nonnegative_image, spread
from tomotactile_ros.reconstruction.parametric import refine_discs

SHARP = 0.2  # width of a point in the images of `balanced` and `accurate`, in spacings of the electrodes
_LEAST = 0.02  # conductance of a contact, in parts of the strongest
_MOST_DISCS = 6  # that are refined together


@dataclass
class Image:
    """values (K,), S; its blobs; how strongly each conducts."""

    values: np.ndarray
    blobs: list[Blob]
    strengths: list[Strength]


class ImageMaker:
    """Images of one profile; `model` of the layout, `radius` of a small contact, m.

    `memories`: where the searches of `nonnegative` and `conductance` start, from frame to frame.
    """

    def __init__(self, profile: str, model, radius: float):
        self.profile, self.sheet, self.radius = profile, model.sheet, radius
        own = model.sheet.transfer(model.grid.pixels, EVEN_DISC * radius).point_self
        self.memories, self._recent = (Memory(), Memory()), RecentBlock()
        self._change = own - model.transfer.point_self  # of D from a pixel to a disc, ohm

    def forget(self) -> None:
        """Start the next frame from scratch."""
        self.memories = Memory(), Memory()

    def __call__(self, local: LocalImage, measured: Grounded) -> Image:
        linear = local.image(measured).astype(float)
        if self.profile == "fast":
            return self.described(local, measured, linear, local.point_area(measured))
        grid = local.grid
        width = SHARP * local.spacing
        even = self._is_wide(local, measured, linear)
        sparse = nonnegative_image(local, measured, linear, even, self.memories[0])
        sharp = spread(sparse, grid, width)
        point_area = 2 * np.pi * np.log(2) * max(width, 0.6 * grid.cell_size[0]) ** 2
        if self.profile == "balanced":
            return self.described(local, measured, sharp, point_area, sparse)
        values = conductance_image(local, measured, sharp, self.memories[1], self._recent)
        return self._refined(
            local, measured, spread(values, grid, width), values, point_area, width
        )

    def _is_wide(self, local, measured, linear) -> bool:
        """Whether a blob of the linear image is wider than the image of a point."""
        most = WIDE * local.point_area(measured)
        blobs = find_blobs(local.grid.fill(linear, outside=0.0), local.grid)
        return any(blob.area > most for blob in blobs)

    def described(self, local, measured, values, point_area=None, exact=None) -> Image:
        """Blobs and strengths in the image `values` (K,); a point's upper half covers `point_area`, m^2."""
        if point_area is None:
            point_area = local.point_area(measured)
        floor = FLOOR if values.min() < 0 else SHARP_FLOOR
        blobs = find_blobs(local.grid.fill(values, outside=0.0), local.grid, floor)
        if not blobs:
            return Image(values, [], [])
        found = strengths(
            blobs,
            values,
            measured,
            local,
            self._change,
            point_area,
            self.radius,
            exact,
        )
        least = _LEAST * max(strength.conductance for strength in found)
        kept = [i for i, strength in enumerate(found) if strength.conductance >= least]
        return Image(values, [blobs[i] for i in kept], [found[i] for i in kept])

    def _refined(self, local, measured, values, exact, point_area, width):
        """Small contacts as discs of the size that the image shows, wide ones as their pixels."""
        image = self.described(local, measured, values, point_area)
        blobs = image.blobs
        radius = [seen_radius(blob.pixels, exact, local, self.radius) for blob in blobs]
        sums = np.array([values[blob.pixels].sum() for blob in blobs])
        sums *= values.sum() / max(float(sums.sum()), 1e-300)
        small = [
            i for i, r in enumerate(radius) if r < max(DISC * local.spacing, 1.01 * self.radius)
        ]
        wide = [i for i in range(len(blobs)) if i not in small]
        for i in wide:
            position = image.strengths[i].position
            image.strengths[i] = Strength(position, float(sums[i]), np.pi * radius[i] ** 2)
        if not 0 < len(small) <= _MOST_DISCS:
            return image
        others = np.concatenate([np.empty(0, int), *(blobs[i].pixels for i in wide)])
        others = others[exact[others] > 0]
        radii = np.array([radius[i] for i in small])
        positions, conductances = refine_discs(
            local,
            measured,
            self.sheet,
            np.array([image.strengths[i].position for i in small]),
            np.maximum(sums[small], 1e-12),
            radii,
            others,
            exact[others],
        )
        for i, r, position, conductance in zip(small, radii, positions, conductances):
            image.strengths[i] = Strength(position, float(conductance), np.pi * r**2, is_disc=True)
            _draw(image.values, blobs[i], position, conductance, max(width, r / 2), local.grid)
        return image


def _draw(values, blob, position, total, width, grid):
    """Put a point of the given width in place of a blob."""
    width = max(width, 0.6 * max(grid.cell_size))
    distance = ((grid.pixels[blob.pixels] - position) ** 2).sum(axis=1)
    shape = np.exp(-distance / (2 * width**2))
    if shape.sum() > 0:
        values[blob.pixels] = total * shape / shape.sum()
