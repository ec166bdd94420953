"""How sharp images of two contacts and of wide contacts are, with the derivative by J'J.

The image of a contact on a set of pixels is the sum of their point spreads, f = M c, with c = 1 on
these pixels: what the layout can tell apart. (How contacts draw current from each other is left
out. It biases the images of eq. 1 of Kojima et al. 2023, the more the smaller lambda^2 is, and
would hide what the layout does; the nonlinear profiles correct for it.)

An image is judged by its blur: the root mean square of the way from its square to the nearest
contact. That grows where two contacts run together and where a wide contact is drawn out, without
any threshold. With y the derivative by f, u = S y and z = S c, S = (J'J + lambda^2 I)^-1,

    y' dM c = lambda^2 u' d(J'J) z
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.point_spread import PointSpread
from tomotactile_ros.layouts.grid import Grid

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

    def __init__(self, scenes: Scenes, spread: PointSpread):
        self._scenes, self._spread = scenes, spread
        self._images = spread.apply(scenes.contacts)
        square = self._images**2
        self._energy = square.sum(axis=0)
        self._blurs = np.sqrt((square * scenes.away**2).sum(axis=0) / self._energy)
        self.value = float(self._blurs.mean())

    def by_rows(self) -> np.ndarray:
        """(n, K) derivative of the value by the rows `symmetry.first` of J'J, for changes that keep
        the symmetry: these rows stand for all others."""
        symmetry = self._spread.symmetry
        slope = self._images * (self._scenes.away**2 - self._blurs**2)
        slope /= self._energy * np.maximum(self._blurs, 1e-300) * len(self._blurs)
        answer = slope - self._spread.apply(slope)  # lambda^2 u
        rest = (self._scenes.contacts - self._images) / self._spread.regularization  # z
        rows = sum(answer[each[symmetry.first]] @ rest[each].T for each in symmetry.pixels)
        return rows * (symmetry.sizes / len(symmetry.pixels))[:, None]
