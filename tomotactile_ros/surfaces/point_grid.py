"""Any smooth surface, by points of it: a grid over the sheet's bounding box, joined by splines."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces.base import Surface, check_stretch

_SAME = 1e-6  # of a side


@dataclass(frozen=True, eq=False)
class PointGrid(Surface):
    """A surface through points: bicubic splines, of a lower degree where there are fewer points.

    Parameters
    ----------
    points : (R, C, 3) positions in space, m, of an even grid over the sheet's bounding box: row by
        row from the lower left, along x first, as electrodes are numbered. R, C at least 2.
    size : width and height of the sheet, m.
    key : how complaints call it.
    """

    points: np.ndarray
    size: tuple[float, float]
    key: str = "grid"
    _splines: tuple[RectBivariateSpline, ...] = field(init=False, repr=False)

    kind = "grid"

    def __post_init__(self):
        points = np.array(self.points, dtype=float)
        rows, columns = points.shape[:2]
        if points.ndim != 3 or min(rows, columns) < 2 or points.shape[2] != 3:
            raise InputError(f"{self.key}: needs 2 x 2 points [x, y, z] or more")
        beyond = np.flatnonzero(~(np.abs(points) <= checks.LONGEST).all(axis=(1, 2)))
        if len(beyond):
            raise InputError(f"{self.key}.points[{beyond[0]}]: has no finite lengths in m")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        width, height = self.size
        points = _at_least_three(_at_least_three(points, 0), 1)  # splines of degree 2 have slopes
        rows, columns = points.shape[:2]
        x = np.linspace(-width / 2, width / 2, columns)
        y = np.linspace(-height / 2, height / 2, rows)
        degrees = {"kx": min(3, rows - 1), "ky": min(3, columns - 1)}
        splines = (RectBivariateSpline(y, x, points[:, :, k], **degrees) for k in range(3))
        object.__setattr__(self, "_splines", tuple(splines))
        check_stretch(self, self.size, self.key)

    def __eq__(self, other):
        return type(self) is type(other) and np.array_equal(self.points, other.points)

    def check(self, size: tuple[float, float]) -> None:
        """Refuse a sheet of another size than that which the points are of."""
        if not np.allclose(size, self.size, rtol=_SAME, atol=0):
            raise InputError(
                f"{self.key}: is of a sheet of {self.size[0]:g} m x {self.size[1]:g} m, this one "
                f"has {size[0]:g} m x {size[1]:g} m"
            )

    def to_3d(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) positions in space, m, of (P, 2) points of the sheet."""
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        return np.column_stack([spline.ev(y, x) for spline in self._splines])

    def jacobians(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 2) derivatives by x and y."""
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        return np.stack(
            [
                np.column_stack([s.ev(y, x, dy=1), s.ev(y, x, dx=1)])  # its x is our y
                for s in self._splines
            ],
            axis=1,
        )

    def to_dict(self, folder: Path) -> dict:
        """The surface as in a layout file."""
        return {"grid": {"points": self.points}}


def _at_least_three(points: np.ndarray, axis: int) -> np.ndarray:
    """Points with the middle between two, where there are only two along an axis."""
    if points.shape[axis] > 2:
        return points
    return np.insert(points, 1, points.mean(axis=axis), axis=axis)
