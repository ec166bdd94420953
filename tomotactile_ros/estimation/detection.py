"""Where one more contact would explain most of what is left: a matched filter over the whole sheet.

A contact of conductance c at x adds c h h^T to Y, h = H(x). To first order in c, and exactly so for
the first contact if its row is taken as measured, the readings change by

    d v_ln = c (h . rho_l) [(Z h)_n - rho_ln (Z h)_l]

All rows share the one c: its best value, and the misfit that it removes, follow for every pixel
from three products of matrices. The place of the largest gain starts the fit of one more (the
conditional-gradient step of Denoyelle et al. 2019, "The sliding Frank-Wolfe algorithm", whose
sliding is the Gauss-Newton fit). The first look at a frame has no fit to start from. By Kirchhoff's
law a floating electrode draws no current: with rho as measured, (Y0 rho_l)_n is what contacts feed
into it, - sum_k c_k H_nk (h_k . rho_l), linear in all c at once and local, as electrodes held at
potentials screen contacts from each other. Pixels are picked in turn and all conductances, not
negative, solved for each time (orthogonal matching pursuit).
"""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import nnls

from tomotactile_ros.estimation.forward import Prediction
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import Rows
from tomotactile_ros.layouts.grid import Grid

_PER_PITCH = 4  # pixels to one spacing of the electrodes
_PIXELS = 24, 60  # along the longer side, at least and at most
_PICKS = 24  # pixels that a first look takes at the most
# of the sum of squares that a pick removes at least: what a place between pixels leaves
_EXPLAINED = 1e-3
_ADJACENT = 2.2  # pixels: those nearer are taken for one contact at first
_WEAK = 0.03  # of the strongest; weaker ones wait until the strong ones are fitted
_INEXACT = 0.02  # of a current: pixels stand for contacts that lie between them
_FILLING = 20  # steps that fill in missing readings from their neighbours
# radius of the disc that acts like a square, in sides: its mean log distance to itself
_PATCH = 0.447
_ROUNDING = 1e-10  # of the diagonal of a normal matrix


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
        radii = np.full(len(self.pixels), _PATCH * self.side)
        self.share, self.impedance = operator.points(self.pixels, radii)

    def gains(self, prediction: Prediction, rows: Rows, misfit: np.ndarray):
        """(K,) what the sum of squares falls by, 0 where c would be negative, and (K,) c, S."""
        ratio, ground = prediction.ratio, rows.grounded
        weights = rows.weights
        read = rows.corrected(prediction.unknowns).readings
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

    def first_look(
        self, rows: Rows, gain: np.ndarray, offset: np.ndarray
    ) -> list[tuple[np.ndarray, float]]:
        """Place (2,), m, and conductance, S, of contacts that together explain most, strongest
        first.

        `rows` without what is known of gains and offsets (`Rows.corrected`); gain (n,), offset (n,)
        in parts of V0: standard deviations of what is not.
        """
        currents, ratio = self._currents(rows)
        metric = self._metric(currents, ratio, rows, gain, offset)
        ground = np.arange(len(rows.grounded)), rows.grounded
        seen = ratio @ self.share
        local = self.share[rows.grounded]
        weighted_share = metric @ self.share
        power = (self.share * weighted_share).sum(axis=0) - 2 * local * weighted_share[
            rows.grounded
        ]
        power += local**2 * metric.diagonal()[rows.grounded][:, None]
        power = np.maximum((seen**2 * power).sum(axis=0), 1e-300)
        root = np.linalg.cholesky(metric).T
        picked: list[int] = []
        columns, strengths, left = [], np.empty(0), currents
        flat = np.empty((_PICKS, currents.size))
        wanted = (currents @ root.T).ravel()
        total = wanted @ wanted
        while len(picked) < _PICKS:
            pulled = left @ metric
            along = (seen * (pulled @ self.share - local * pulled[ground][:, None])).sum(axis=0)
            gains = np.where(along > 0, along**2 / power, 0.0)
            gains[picked] = 0.0
            best = int(gains.argmax())
            if gains[best] <= _EXPLAINED * total:
                break
            picked.append(best)
            column = np.outer(seen[:, best], self.share[:, best])
            column[ground] = 0.0
            flat[len(columns)] = (column @ root.T).ravel()
            columns.append(column)
            strengths = _not_negative(flat[: len(columns)], wanted)
            left = currents - np.tensordot(strengths, np.array(columns), 1)
        return self._gathered(np.array(picked, int), strengths)

    def _currents(self, rows: Rows):
        """(L, n) what contacts must feed into each electrode, S, 0 into the grounded one; and
        (L, n) rho as measured."""
        admittance = self.operator.expected
        ratio = np.where(rows.weights > 0, 1 - rows.readings, np.nan)
        ground = np.arange(len(ratio)), rows.grounded
        ratio[ground] = 1.0
        missing = np.isnan(ratio)
        if missing.any():
            ratio = np.where(missing, np.nanmean(ratio, axis=1)[:, None], ratio)
            for _ in range(_FILLING):
                balanced = ratio - (ratio @ admittance) / admittance.diagonal()
                ratio = np.where(missing, balanced, ratio)
        currents = -ratio @ admittance
        currents[ground] = 0.0
        currents[missing] = 0.0
        return currents, ratio

    def _metric(self, currents, ratio, rows, gain, offset):
        """(n, n) inverse covariance of the currents of a row: noise of the readings, what is not
        known of the channels, and a part of themselves.

        Rows have their channels in common: of L rows, what these err by looks like a contact the
        less, the more there are.
        """
        admittance = self.operator.expected
        noise = 1 / np.median(rows.weights[rows.weights > 0])
        channels = gain**2 * ((1 - ratio) ** 2).mean(axis=0) + offset**2
        unknown = _INEXACT**2 * (currents**2).mean()
        covariance = (admittance * (noise + channels / len(ratio))) @ admittance
        inverse = np.linalg.inv(covariance + unknown * np.eye(len(admittance)))
        return (inverse + inverse.T) / 2

    def _gathered(self, picked, strengths):
        kept = strengths > _WEAK * strengths.max(initial=0.0)
        picked, strengths = picked[kept], strengths[kept]
        if len(picked) > 1:
            tree = linkage(self.pixels[picked], "single")
            group = fcluster(tree, _ADJACENT * self.side, "distance") - 1
        else:
            group = np.zeros(len(picked), int)
        sums = np.bincount(group, strengths)
        found = []
        for each in np.argsort(-sums):
            of = group == each
            weights = strengths[of] / sums[each]
            found.append((weights @ self.pixels[picked[of]], float(sums[each])))
        return found


def _not_negative(columns: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(k,) factors, none below 0, with which `columns` (k, m) add up to `wanted` (m,) best."""
    normal = columns @ columns.T
    normal[np.diag_indices(len(normal))] *= 1 + _ROUNDING
    root = np.linalg.cholesky(normal)
    return nnls(root.T, np.linalg.solve(root, columns @ wanted))[0]
