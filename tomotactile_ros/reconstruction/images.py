"""The image of each profile, from what the grounded electrodes would measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.reconstruction.active_set import Memory
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.conductance import conductance_image
from tomotactile_ros.reconstruction.contacts import FLOOR, SHARP_FLOOR, Blob, find_blobs
from tomotactile_ros.reconstruction.estimate import (
    EVEN_DISC,
    WIDE,
    Strength,
    strengths,
)
from tomotactile_ros.reconstruction.grounded import RecentBlock
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import nonnegative_image, spread

# width of a point in the images of `balanced` and `nonlinear`, in spacings of the electrodes
SHARP = 0.2
_NOISY = 5  # level of lambda from which on noise breaks all images but the linear one into spots
_LEAST = 0.02  # conductance of a contact, in parts of the strongest


@dataclass
class Image:
    """values (K,), S; its blobs; how strongly each conducts; the image before it was smoothed, g of
    each pixel, if any."""

    values: np.ndarray
    blobs: list[Blob]
    strengths: list[Strength]
    exact: np.ndarray | None = None


class ImageMaker:
    """Images of one profile; `model` of the layout, `radius` of a small contact, m.

    `memories`: where the searches of `nonnegative` and `conductance` start, from frame to frame.
    """

    def __init__(self, profile: str, model, radius: float):
        self.profile, self.radius = profile, radius
        own = model.sheet.transfer(model.grid.pixels, EVEN_DISC * radius).point_self
        self.memories, self._recent = (Memory(), Memory()), RecentBlock()
        self._change = own - model.transfer.point_self  # of D from a pixel to a disc, ohm

    def forget(self) -> None:
        """Start the next frame from scratch."""
        self.memories = Memory(), Memory()

    def __call__(self, local: LocalImage, measured: Grounded) -> Image:
        linear = local.image(measured).astype(float)
        if self.profile == "fast" or local.level(measured) >= _NOISY:
            return self.described(local, measured, linear, local.point_area(measured))
        grid = local.grid
        width = SHARP * local.spacing
        even = self._is_wide(local, measured, linear)
        sparse = nonnegative_image(local, measured, linear, even, self.memories[0])
        sharp = spread(sparse, grid, width)
        point_area = 2 * np.pi * np.log(2) * max(width, 0.6 * grid.cell_size[0]) ** 2
        if self.profile == "balanced":
            return self.described(local, measured, sharp, point_area, sparse)
        exact = conductance_image(local, measured, sharp, self.memories[1], self._recent)
        values = spread(exact, grid, width)
        image = self.described(local, measured, values, point_area, exact, resolved=True)
        image.exact = exact
        for blob, strength in zip(image.blobs, image.strengths):
            if strength.is_disc:
                _draw(values, blob, strength, width, grid)
        return image

    def _is_wide(self, local, measured, linear) -> bool:
        """Whether a blob of the linear image is wider than the image of a point."""
        most = WIDE * local.point_area(measured)
        blobs = find_blobs(local.grid.fill(linear, outside=0.0), local.grid)
        return any(blob.area > most for blob in blobs)

    def described(
        self, local, measured, values, point_area=None, exact=None, resolved=False
    ) -> Image:
        """Blobs and strengths in the image `values` (K,); a point's upper half covers `point_area`,
        m^2."""
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
            resolved,
        )
        least = _LEAST * max(strength.conductance for strength in found)
        kept = [i for i, strength in enumerate(found) if strength.conductance >= least]
        return Image(values, [blobs[i] for i in kept], [found[i] for i in kept])


def _draw(values, blob, disc, width, grid):
    """Make a blob a Gaussian of at least the given width where its disc is; keeps the sum."""
    width = max(width, np.sqrt(disc.area / np.pi / 2), 0.6 * max(grid.cell_size))
    distance = ((grid.pixels[blob.pixels] - disc.position) ** 2).sum(axis=1)
    shape = np.exp(-distance / (2 * width**2))
    if shape.sum() > 0:
        values[blob.pixels] = values[blob.pixels].sum() * shape / shape.sum()
