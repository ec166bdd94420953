"""How sharp images of two contacts and of wide contacts are, with the derivative by G.

The image of a contact on a set of pixels is the sum of their point spreads, f = M c, with c = 1 on
these pixels: what the layout can tell apart. (How contacts draw current from each other is left
out. It biases the images of eq. 1 of Kojima et al. 2023, the more the smaller lambda^2 is, and
would hide what the layout does; the nonlinear profiles correct for it.)

An image is judged by its blur: the root mean square of the way from its square to the nearest
contact. That grows where two contacts run together and where a wide contact is drawn out, without
any threshold. With y the derivative by f, u = S y and z = S c, S = (J'J + lambda^2 I)^-1,

    y' dM c = lambda^2 u' d(J'J) z = lambda^2 [(J u)' dJ z + (J z)' dJ u]
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.point_spread import PointSpread
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.transfer import Transfer

_PAIRS, _DISCS = 16, 8
_SEED = 0


class Scenes:
    """Fixed scenes on the pixels of `grid`, in measures of the electrodes' mean pitch.

    16 pairs of pixels, 1 to 2 pitches apart, and 8 discs of half a pitch to a pitch in radius.

    contacts : (K, S) 1 on the pixels of each scene, 0 elsewhere
    away : (K, S) from every pixel to the nearest of them, m
    """

    def __init__(self, grid: Grid, electrodes: int):
        random = np.random.default_rng(_SEED)
        pitch = np.sqrt(grid.outline.area / electrodes)
        pixels = grid.pixels
        self.contacts = np.zeros((len(pixels), _PAIRS + _DISCS))
        self.away = np.empty_like(self.contacts)
        for i in range(_PAIRS + _DISCS):
            centre = random.integers(len(pixels))
            apart = np.linalg.norm(pixels - pixels[centre], axis=1)
            if i < _PAIRS:
                second = random.choice(np.argsort(np.abs(apart - random.uniform(1, 2) * pitch))[:8])
                chosen = np.array([centre, second])
            else:
                chosen = np.flatnonzero(apart <= random.uniform(0.5, 1) * pitch)
            self.contacts[chosen, i] = 1
            self.away[:, i] = np.linalg.norm(pixels[:, None] - pixels[chosen], axis=2).min(axis=1)


class SceneBlur:
    """Mean blur of `scenes`, m, in `value`, for one layout and one lambda^2."""

    def __init__(self, scenes: Scenes, transfer: Transfer, spread: PointSpread):
        self._scenes, self._transfer, self._spread = scenes, transfer, spread
        self._images = spread.apply(scenes.contacts)
        square = self._images**2
        self._energy = square.sum(axis=0)
        self._blurs = np.sqrt((square * scenes.away**2).sum(axis=0) / self._energy)
        self.value = float(self._blurs.mean())

    def gradient(self) -> tuple[np.ndarray, np.ndarray]:
        """(E, K) derivative of the value by `electrode_point`, (E, E) by `electrode_electrode`."""
        slope = self._images * (self._scenes.away**2 - self._blurs**2)
        slope /= self._energy * np.maximum(self._blurs, 1e-300) * len(self._blurs)
        answer = slope - self._spread.apply(slope)  # lambda^2 S y
        rest = (self._scenes.contacts - self._images) / self._spread.regularization
        by_point = np.zeros_like(self._transfer.electrode_point)
        by_between = np.zeros_like(self._transfer.electrode_electrode)
        operator = Sensitivity(self._transfer)
        for u, z in zip(answer.T, rest.T):
            self._add(operator.weight, operator.forward(u), z, by_point, by_between)
            self._add(operator.weight, operator.forward(z), u, by_point, by_between)
        return by_point, by_between

    def _add(self, weight, rows, image, by_point, by_between):
        """Add the derivatives of sum(rows * J image), `rows` (E, E) and `image` (K,) held."""
        point, between = self._transfer.electrode_point, self._transfer.electrode_electrode
        total = rows.sum(axis=1)
        offset = np.diagonal(between)[:, None] - between
        inner = rows @ point - total[:, None] * point + (rows * offset).sum(axis=1)[:, None]
        current = weight * image
        by_weight = weight**2 * image * inner
        by_point += rows.T @ current - total[:, None] * current + 2 * by_weight
        through = current.sum(axis=1)
        by_between -= rows * through[:, None]
        by_between[np.diag_indices_from(by_between)] += total * through - by_weight.sum(axis=1)
