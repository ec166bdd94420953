"""What floating electrodes close by add to G between two places: the charge that a current induces on a
conducting disc lies in its inverse point (circle theorem; Milne-Thomson 1940).

With a the way from the centre of an electrode of radius R to a place, as a complex number, and
z = R / conj(a), that is

    R_s / (2 pi) ln |1 - z_p conj(z_q)| = - R_s / (2 pi) sum_k Re(z_p^k conj(z_q)^k) / k

between places p and q. Some radii away the sum has few terms, and for all places and electrodes
together it is one product of matrices.
"""

from __future__ import annotations

import numpy as np

# radii from the centre of an electrode: patches on it are moved here and have no weight
RIM = 1.001
CLOSE = 0.8, 1.3  # spacings: induced charges of electrodes are told one by one up to here
# |z|^2: electrodes beyond 2.6 of their radii: eight terms of the series of the logarithm; nearer
# ones one by one
_SERIES = 0.15
_EXACT = 1e-6  # how much of the sum the terms left away are


class InducedCharges:
    """On electrodes at `centres` (E, 2) with `radius`, about `pitch` apart, m, on a sheet of `resistance`,
    ohm."""

    def __init__(self, centres: np.ndarray, radius: float, pitch: float, resistance: float):
        self.centres, self.radius, self.pitch = centres, radius, pitch
        self.scale = resistance / (4 * np.pi)

    def by(self, places: np.ndarray) -> Charges:
        """By currents at `places` (P, 2), m."""
        return Charges(self, places)

    def own(self, places: np.ndarray) -> np.ndarray:
        """(P,) what a current at each of `places` (P, 2), m, brings about there, ohm."""
        squared = self.squared(places[:, None] - self.centres)
        near = self.nearness(squared) ** 2 * np.log1p(-(self.radius**2) / squared)
        return 2 * self.scale * near.sum(axis=1)

    def squared(self, apart: np.ndarray) -> np.ndarray:
        """Squared distances `apart` (..., 2), m, that of the rim at least."""
        return np.maximum(np.einsum("...d,...d->...", apart, apart), (RIM * self.radius) ** 2)

    def nearness(self, squared: np.ndarray) -> np.ndarray:
        """1 near an electrode, 0 far away, smoothly, at `squared` distances, m²."""
        far = self._fading(squared)
        return 1 - far**2 * (3 - 2 * far)

    def _fading(self, squared: np.ndarray) -> np.ndarray:
        """How far `squared` distances, m², are between those where electrodes begin and end to fade."""
        return np.clip((np.sqrt(squared) / self.pitch - CLOSE[0]) / (CLOSE[1] - CLOSE[0]), 0, 1)


class Charges:
    """Those that currents at `places` (P, 2), m, induce on the electrodes near any of them."""

    def __init__(self, electrodes: InducedCharges, places: np.ndarray):
        self._electrodes = electrodes
        apart = (places[:, None] - electrodes.centres).transpose(1, 0, 2)
        squared = electrodes.squared(apart)
        least = squared.min(axis=1, initial=np.inf)
        near = least < (CLOSE[1] * electrodes.pitch) ** 2
        self._apart, self._squared = apart[near], squared[near]
        self._weight = electrodes.nearness(self._squared)
        largest = electrodes.radius**2 / least[near]
        self._few = largest > _SERIES
        rest = largest[~self._few].max(initial=_EXACT)
        self._terms = np.arange(1, max(int(np.ceil(np.log(_EXACT) / np.log(rest))), 1) + 1)

    def _columns(self) -> np.ndarray:
        """(P, 2 K m) B with B B^T what charges of m electrodes that are not close take away, ohm."""
        far = ~self._few
        ways = self._apart[far] * (self._electrodes.radius / self._squared[far])[..., None]
        powers = (ways[..., 0] + 1j * ways[..., 1])[..., None] ** self._terms
        rooted = np.sqrt(2 * self._electrodes.scale / self._terms)
        return _flat(self._weight[far, :, None] * powers * rooted)

    def among(self) -> np.ndarray:
        """(P, P) what they add to G between the places, ohm."""
        columns, radius = self._columns(), self._electrodes.radius
        out = -(columns @ columns.T)
        for electrode in map(int, np.flatnonzero(self._few)):
            on = np.flatnonzero(self._weight[electrode])
            weight, squared = self._weight[electrode, on], self._squared[electrode, on]
            share = radius**2 / squared
            image = share[:, None] * self._apart[electrode, on]  # inverse points
            part = np.multiply.outer(share, share) - (2 / radius**2) * (image @ image.T)
            np.log1p(np.maximum(part, RIM - 2, out=part), out=part)
            part *= np.multiply.outer(weight, self._electrodes.scale * weight)
            out[np.ix_(on, on)] += part
        return out


def _flat(columns: np.ndarray) -> np.ndarray:
    """(P, 2 K m) real ones for complex (m, P, K)."""
    together = np.ascontiguousarray(columns.transpose(1, 0, 2)).view(float)
    return together.reshape(len(together), -1)
