"""The first look at a frame, which has no fit to start from: contacts from the currents of electrodes.

By Kirchhoff's law a floating electrode draws no current: with rho as measured, (Y0 rho_l)_n is what
contacts feed into it, - sum_k c_k H_nk (h_k . rho_l), linear in all c at once and local, as
electrodes held at potentials screen contacts from each other.

Pixels are picked in turn, the one that explains most of what is left first; after each pick all
conductances are solved for, none negative (orthogonal matching pursuit; Pati et al. 1993). Small
contacts lie between pixels, and the best pixel for two of them lies between them: as points they
slide by Gauss-Newton steps, after each pick, to where they explain most (sliding Frank-Wolfe,
Denoyelle et al. 2019), which is within a millimetre of where they are. Where no pick explains
more, one is tried for what it explains that no change of the others does (orthogonal least
squares; Chen et al. 1989).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import nnls
from scipy.spatial.distance import cdist, pdist

from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator

_PICKS = 24  # pixels that are picked at the most
_SLIDING = 6  # points at the most; more are parts of something wide
_STEPS, _LAST = 3, 8  # of sliding after a pick, and where no pick explains more
_REACH = 0.3  # spacings that a place slides in one step at the most
_SETTLED = 0.01  # spacings: places that slide less stay
_DAMPING = 1e-3  # of the diagonal of the normal matrix of a slide
# of the sum of squares that a pick removes at least: what a point leaves of a small disc
_EXPLAINED = 1e-3
_LEFT = 3e-3  # of the sum of squares: what points leave of small contacts, all together
_DISTINCT = 0.7  # spacings between points that are contacts each, not parts of one
_ADJACENT = 2.2  # pixels: those nearer are taken for one contact at first
_WEAK = 0.03  # of the strongest; weaker ones wait until the strong ones are fitted
_STRONG = 0.3  # of the strongest: what an uneven sheet looks like beside a contact is weaker
_INEXACT = 0.02  # of a current: points stand for contacts of any size
_FILLING = 20  # steps that fill in missing readings from their neighbours
_DEPENDENT = 1e-2  # of a column's square: what is less beside the others is rounding and errors
_RIDGE = 1e-3  # of the diagonal of the normal matrix of a linear image
_ROUNDING = 1e-10  # of the diagonal of a normal matrix


@dataclass(frozen=True)
class _Points:
    """Points at `places` (k, 2), m, with conductances `strengths` (k,), S; what they leave of the
    currents, `left` (L n,), and derivatives of these by the former and x and y per S, `tangents`
    (3 k, L n), None of no points."""

    places: np.ndarray
    strengths: np.ndarray
    left: np.ndarray
    tangents: np.ndarray | None = None


class FirstLook:
    """Contacts of one frame.

    Parameters
    ----------
    pixels (K, 2) : places, m, about `side` m apart; share (n, K) : H there
    rows : without what is known of gains and offsets (`Rows.corrected`)
    gain (n,), offset (n,) : standard deviations of what is not; offsets in parts of V0
    """

    def __init__(
        self,
        operator: SheetOperator,
        pixels: np.ndarray,
        share: np.ndarray,
        side: float,
        rows: Rows,
        gain: np.ndarray,
        offset: np.ndarray,
    ):
        self._operator, self._pixels, self._share, self._side = operator, pixels, share, side
        self._currents = _Currents(operator, rows, gain, offset)
        self._gains = self._currents.gains_of(share)
        self._total = self._currents.wanted @ self._currents.wanted
        self._few: tuple[float, _Points] | None = None  # the last answer of `_slid_to`

    def points(self, radius: float) -> list[tuple[np.ndarray, float]] | None:
        """Place (2,), m, and conductance, S, of points that explain all but what these leave of small
        contacts of `radius`, m, strongest first; None where no few of them do."""
        found = self._slid_to(radius)
        if not len(found.places) or found.left @ found.left > _LEFT * self._total:
            return None
        points = self._gathered(found.places, found.strengths)
        return points if _are_distinct(points, _DISTINCT * self._operator.pitch) else None

    def strongest(self, radius: float) -> list[tuple[np.ndarray, float]]:
        """The same of the strongest points that explain most, whatever they leave: an uneven sheet
        leaves more than small contacts do, and looks like weak ones or like a second one beside a
        single strong one. Empty where many are strong, or some of several near each other."""
        found = self._slid_to(radius)
        points = self._gathered(found.places, found.strengths)
        strong = [each for each in points if each[1] > _STRONG * points[0][1]]
        least = _DISTINCT * self._operator.pitch
        if len(strong) < _SLIDING and _are_distinct(strong, least):
            return strong
        single = not any(_are_distinct([strong[0], each], least) for each in strong[1:])
        return strong[:1] if single else []

    def _slid_to(self, radius: float) -> _Points:
        """Few points of `radius`, m, beside which no further one explains anything; worked out once."""
        if self._few is None or self._few[0] != radius:
            self._few = radius, self._few_points(radius)
        return self._few[1]

    def _few_points(self, radius: float) -> _Points:
        found = _Points(np.empty((0, 2)), np.empty(0), self._currents.wanted)
        enough = _EXPLAINED * self._total
        settled = False
        while len(found.places) < _SLIDING:
            explained = self._gains(found.left, found.tangents if settled else None)
            explained[self._near(found.places)] = 0.0
            best = int(explained.argmax())
            if explained[best] > enough:
                places, settled = np.vstack([found.places, self._pixels[best]]), False
                found = self._slid(places, radius, _STEPS)
            elif settled or not len(found.places):
                break
            else:
                found, settled = self._slid(found.places, radius, _LAST), True
                if found.left @ found.left < enough:
                    break
        return found

    def contacts(self) -> list[tuple[np.ndarray, float]]:
        """Place (2,), m, and conductance, S, of contacts of any form, which together explain most, in
        parts about a spacing wide, strongest first."""
        picked: list[int] = []
        columns = np.empty((_PICKS, len(self._currents.wanted)))
        strengths, left = np.empty(0), self._currents.wanted
        while len(picked) < _PICKS:
            explained = self._gains(left)
            explained[picked] = 0.0
            best = int(explained.argmax())
            if explained[best] <= _EXPLAINED * self._total:
                break
            columns[len(picked)] = self._currents.of(self._share[:, [best]])[0]
            picked.append(best)
            strengths = _not_negative(columns[: len(picked)], self._currents.wanted)
            left = self._currents.wanted - strengths @ columns[: len(picked)]
        return self._gathered(self._pixels[picked], strengths)

    def image(self, share: np.ndarray) -> np.ndarray:
        """(K,) conductances, S, none below 0, with which contacts of `share` (n, K) explain most
        together: a linear image."""
        return self._currents.image_of(share)

    def _near(self, places: np.ndarray) -> np.ndarray:
        """(K,) which pixels lie at one of `places` (k, 2)."""
        if not len(places):
            return np.zeros(len(self._pixels), bool)
        return cdist(self._pixels, places).min(axis=1) < self._side / 2

    def _slid(self, places: np.ndarray, radius: float, steps: int) -> _Points:
        """Where points of `radius`, m, slide to from `places` (k, 2) in `steps` at the most."""
        reach, settled = (part * self._operator.pitch for part in (_REACH, _SETTLED))
        half = np.array(self._operator.layout.outline.size, float) / 2
        currents, count = self._currents, len(places)
        while True:
            share, slopes = self._operator.shares(places, radius)
            columns = currents.of(share)
            strengths = _not_negative(columns, currents.wanted)
            left = currents.wanted - strengths @ columns
            tangents = np.vstack([columns, *(currents.of(share, slope) for slope in slopes)])
            if not steps:
                return _Points(places, strengths, left, tangents)
            scale = 1 / np.maximum(np.sqrt((tangents**2).sum(axis=1)), 1e-300)
            normal = tangents @ tangents.T * scale * scale[:, None]
            normal[np.diag_indices(len(normal))] += _DAMPING
            way = scale * np.linalg.solve(normal, scale * (tangents @ left))
            there = strengths > 0
            step = way[count:].reshape(2, count).T / np.where(there, strengths, np.inf)[:, None]
            length = np.hypot(*step.T)
            step *= np.minimum(1.0, reach / np.maximum(length, 1e-300))[:, None]
            places = np.clip(places + step, -half, half)
            steps = steps - 1 if length.max() > settled else 0

    def _gathered(self, places, strengths):
        kept = strengths > _WEAK * strengths.max(initial=0.0)
        places, strengths = places[kept], strengths[kept]
        if len(places) > 1:
            tree = linkage(places, "single")
            group = fcluster(tree, _ADJACENT * self._side, "distance") - 1
        else:
            group = np.zeros(len(places), int)
        sums = np.bincount(group, strengths)
        found = []
        for each in np.argsort(-sums):
            of = group == each
            weights = strengths[of] / sums[each]
            found.append((weights @ places[of], float(sums[each])))
        return found


class _Currents:
    """What contacts must feed into electrodes, in units of what is not known of it.

    wanted : (L n,) as the rows have it
    """

    def __init__(self, operator: SheetOperator, rows: Rows, gain: np.ndarray, offset: np.ndarray):
        admittance = operator.expected
        ratio = np.where(rows.weights > 0, 1 - rows.readings, np.nan)
        self._grounded = rows.grounded
        self._at_ground = ground = np.arange(len(ratio)), rows.grounded
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
        self._ratio = ratio
        self._metric = self._precision(admittance, currents, rows, gain, offset)
        self._root = np.linalg.cholesky(self._metric)
        self.wanted = (currents @ self._root).ravel()

    def _precision(self, admittance, currents, rows, gain, offset):
        """(n, n) inverse covariance of the currents of a row: noise of the readings, what is not
        known of the channels, and a part of themselves.

        Rows have their channels in common: of L rows, what these err by looks like a contact the
        less, the more there are.
        """
        ratio = self._ratio
        noise = 1 / np.median(rows.weights[rows.weights > 0])
        channels = gain**2 * ((1 - ratio) ** 2).mean(axis=0) + offset**2
        unknown = _INEXACT**2 * (currents**2).mean()
        covariance = (admittance * (noise + channels / len(ratio))) @ admittance
        inverse = np.linalg.inv(covariance + unknown * np.eye(len(admittance)))
        return (inverse + inverse.T) / 2

    def of(self, share: np.ndarray, slope: np.ndarray | None = None) -> np.ndarray:
        """(k, L n) what contacts of 1 S with `share` (n, k) feed into electrodes; its derivative
        where the `slope` (n, k) of the share is given."""
        driven = (self._ratio @ share).T[..., None]
        fed = share.T[:, None]
        if slope is None:
            out = driven * fed
        else:
            out = (self._ratio @ slope).T[..., None] * fed + driven * slope.T[:, None]
        out[:, self._at_ground[0], self._at_ground[1]] = 0.0
        return (out @ self._root).reshape(len(out), -1)

    def image_of(self, share: np.ndarray) -> np.ndarray:
        """(K,) see `FirstLook.image`."""
        seen, local = self._ratio @ share, share[self._grounded]
        weighted = self._metric @ share
        own, fed = seen * local, seen * weighted[self._grounded]
        normal = (seen.T @ seen) * (share.T @ weighted) - own.T @ fed - fed.T @ own
        normal += (own.T * self._metric.diagonal()[self._grounded]) @ own
        normal[np.diag_indices(len(normal))] *= 1 + _RIDGE
        pulled = self.wanted.reshape(self._ratio.shape) @ self._root.T
        along = seen * (pulled @ share - local * pulled[self._at_ground][:, None])
        root = np.linalg.cholesky(normal)
        return not_negative(root, np.linalg.solve(root, along.sum(axis=0)))

    def gains_of(self, share: np.ndarray):
        """How far the square of what is left of `wanted` falls with a contact at each pixel of `share`
        (n, K), as a function of what is left, (L n,), and of what may change `beside`, (m, L n) or
        None: -> (K,)."""
        ratio, grounded, at_ground = self._ratio, self._grounded, self._at_ground
        seen, local = ratio @ share, share[grounded]
        weighted = self._metric @ share
        power = (share * weighted).sum(axis=0) - 2 * local * weighted[grounded]
        power += local**2 * self._metric.diagonal()[grounded][:, None]
        power = np.maximum((seen**2 * power).sum(axis=0), 1e-300)

        def along(of: np.ndarray) -> np.ndarray:
            pulled = of.reshape(ratio.shape) @ self._root.T
            return (seen * (pulled @ share - local * pulled[at_ground][:, None])).sum(axis=0)

        def gains(left: np.ndarray, beside: np.ndarray | None = None) -> np.ndarray:
            mine, own = along(left), power
            if beside is not None:
                taken = np.array([along(each) for each in beside])
                normal = beside @ beside.T
                normal[np.diag_indices(len(normal))] *= 1 + _DEPENDENT
                own = power - (taken * np.linalg.solve(normal, taken)).sum(axis=0)
                own = np.maximum(own, _DEPENDENT * power)
            return np.where(mine > 0, mine**2 / own, 0.0)

        return gains


def _are_distinct(points: list[tuple[np.ndarray, float]], least: float) -> bool:
    """Whether places of `points` are `least`, m, or more from each other."""
    if len(points) < 2:
        return True
    return bool(pdist(np.array([place for place, _ in points])).min() > least)


def _not_negative(columns: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(k,) factors, none below 0, with which `columns` (k, m) add up to `wanted` (m,) best."""
    normal = columns @ columns.T
    normal[np.diag_indices(len(normal))] *= 1 + _ROUNDING
    root = np.linalg.cholesky(normal)
    return nnls(root.T, np.linalg.solve(root, columns @ wanted))[0]


def not_negative(root: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """(k,) x >= 0 with the least |root^T x - goal|; LinAlgError where no end is found."""
    try:
        return nnls(root.T, goal, maxiter=30 * len(root))[0]
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None
