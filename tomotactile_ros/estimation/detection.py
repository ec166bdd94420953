"""Where one more contact would explain most of what is left: a matched filter over the whole sheet.

A contact of conductance c at x adds c h h^T to Y, h = H(x). To first order in c, and exactly so for
the first contact if its row is taken as measured, the readings change by

    d v_ln = c (h . rho_l) [(Z h)_n - rho_ln (Z h)_l]

All rows share the one c: its best value, and the misfit that it removes, follow for every pixel
from three products of matrices. The place of the largest gain starts the fit of one more (the
conditional-gradient step of Denoyelle et al. 2019, "The sliding Frank-Wolfe algorithm", whose
sliding is the Gauss-Newton fit). A frame without a fit to start from is looked at as `first_look`
says.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.estimation.disc import PATCH
from tomotactile_ros.estimation.first_look import FirstLook
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.layouts.grid import Grid

_PER_PITCH = 4  # pixels to one spacing of the electrodes
_PIXELS = 24, 60  # along the longer side, at least and at most


class Detector:
    """Gain of one more contact at each pixel.

    pixels : (K, 2) places, m; share : (n, K) H; impedance : (K,) D of a disc as large as a pixel,
        ohm
    """

    def __init__(self, operator: SheetOperator):
        self.operator = operator
        outline = operator.layout.outline
        across = int(np.clip(np.ceil(max(outline.size) / operator.pitch * _PER_PITCH), *_PIXELS))
        grid = Grid.for_outline(outline, across)
        self.pixels = grid.pixels
        self.side = float(np.sqrt(grid.cell_area))
        radii = np.full(len(self.pixels), PATCH * self.side)
        self.share, self.impedance = operator.points(self.pixels, radii)

    def gains(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """(K,) what the sum of squares falls by, 0 where c would be negative, and (K,) c, S."""
        prediction, rows, misfit = fit.prediction, fit.rows, fit.misfit
        ratio, ground = prediction.ratio, rows.grounded
        weights = rows.weights
        read = rows.corrected(fit.unknowns).readings
        measured = np.where(weights > 0, 1 - read, ratio)
        seen = measured @ self.share
        spread = prediction.impedance @ self.share
        at_ground = spread[ground]
        weighted = weights * misfit
        along = seen * (weighted @ spread - at_ground * (weighted * ratio).sum(axis=1)[:, None])
        power = weights @ spread**2 - 2 * at_ground * ((weights * ratio) @ spread)
        power += at_ground**2 * (weights * ratio**2).sum(axis=1)[:, None]
        along, power = along.sum(axis=0), (seen**2 * power).sum(axis=0)
        power = np.maximum(power, 1e-300)
        best = along / power
        return np.where(best > 0, along * best, 0.0), best

    def first_look(self, rows: Rows, gain: np.ndarray, offset: np.ndarray) -> FirstLook:
        """A `FirstLook` at rows with the same pixels."""
        return FirstLook(self.operator, self.pixels, self.share, self.side, rows, gain, offset)
