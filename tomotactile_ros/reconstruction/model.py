"""Everything that depends on the layout alone, made once and shared by pipelines."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.estimate import PATCH
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.reconstruction.grounded_step import LocalImage
from tomotactile_ros.sheet import make_sheet

_KEPT = 8  # sets of electrodes


class Model:
    """The sheet and its image cells, with what was derived for each set of electrodes in use.

    Attributes
    ----------
    sheet, transfer : model of the sheet, and its transfer object to the pixels.
    """

    def __init__(self, layout: Layout, grid: Grid, model: str, noise: float):
        self.layout, self.grid, self.noise = layout, grid, noise
        self.sheet = make_sheet(layout, model)
        self.transfer = self.sheet.transfer(grid.pixels, PATCH * np.sqrt(grid.cell_area))
        self._electrodes: dict[bytes, LocalImage] = {}
        self._basis: FrameBasis | None = None

    def basis(self, regularization: float) -> FrameBasis:
        """For images by eq. 1 with a lambda_J^2 of at least `regularization`."""
        if self._basis is None or regularization < self._basis.regularization:
            self._basis = FrameBasis(self.transfer, regularization)
        return self._basis

    def local(self, used: np.ndarray) -> LocalImage:
        """Linear images from the electrodes `used` (n,)."""
        key = used.tobytes()
        if key not in self._electrodes:
            if len(self._electrodes) >= _KEPT:
                self._electrodes.pop(next(iter(self._electrodes)))
            meter = AdmittanceMeter(GroundedSheet(self.transfer, used), self.noise)
            positions = self.layout.positions
            resistance = self.layout.sheet_resistance
            self._electrodes[key] = LocalImage(meter, self.grid, positions, resistance)
        return self._electrodes[key]
