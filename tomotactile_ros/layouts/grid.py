"""The cells of an image: an H x W grid over the bounding box of the outline, row 0 at the +y edge.

Pixel (row, col) has its centre at x = xmin + (col + 1/2) a/W, y = ymax - (row + 1/2) b/H.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

MAX_RESOLUTION = 2000


@dataclass(frozen=True, eq=False)
class Grid:
    """Image cells over an outline.

    Parameters
    ----------
    outline : the sheet.
    height, width : number of rows H and columns W.
    """

    outline: Outline
    height: int
    width: int

    def __post_init__(self):
        checks.integer(self.height, "height", 1, MAX_RESOLUTION)
        checks.integer(self.width, "width", 1, MAX_RESOLUTION)
        if not self.inside.any():
            raise InputError(
                f"resolution: none of {self.height} x {self.width} cells has its centre on the "
                "sheet, a finer grid is needed"
            )

    @classmethod
    def for_outline(cls, outline: Outline, resolution: int) -> "Grid":
        """``resolution`` cells along the longer side, and as many on the other that look square."""
        resolution = checks.integer(resolution, "resolution", 1, MAX_RESOLUTION)
        a, b = outline.size
        longer = max(a, b)
        return cls(
            outline,
            height=max(1, round(resolution * b / longer)),
            width=max(1, round(resolution * a / longer)),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    @property
    def cell_size(self) -> tuple[float, float]:
        """Width and height of a cell, m."""
        a, b = self.outline.size
        return a / self.width, b / self.height

    @property
    def cell_area(self) -> float:
        """Area of a cell, m²."""
        dx, dy = self.cell_size
        return dx * dy

    @cached_property
    def centres(self) -> np.ndarray:
        """(H*W, 2) centres of all cells, m, row by row from the +y edge."""
        xmin, _, _, ymax = self.outline.bounds
        dx, dy = self.cell_size
        x = xmin + (np.arange(self.width) + 0.5) * dx
        y = ymax - (np.arange(self.height) + 0.5) * dy
        return _frozen(np.column_stack([np.tile(x, self.height), np.repeat(y, self.width)]))

    @cached_property
    def inside(self) -> np.ndarray:
        """(H, W) bool: cells whose centre lies on the sheet."""
        return _frozen(self.outline.contains(self.centres).reshape(self.shape))

    @cached_property
    def pixels(self) -> np.ndarray:
        """(K, 2) centres of the cells inside, m, in the order of `centres`."""
        return _frozen(self.centres[self.inside.ravel()])

    def fill(self, values: np.ndarray, outside: float = np.nan) -> np.ndarray:
        """(H, W) image of (K,) pixel values, in their floating type; ``outside`` elsewhere."""
        values = np.asarray(values)
        dtype = np.result_type(values.dtype, np.float32)
        image = np.full(self.shape, outside, dtype=dtype)
        image[self.inside] = values
        return image

    def gather(self, image: np.ndarray) -> np.ndarray:
        """(K,) pixel values of an (H, W) image."""
        return np.asarray(image)[self.inside]


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
