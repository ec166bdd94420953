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
FEW = 6  # points that may slide into each other, as parts of something wide do
_STEPS, _LAST = 3, 8  # of sliding after a pick, and where no pick explains more
_REACH = 0.3  # spacings that a place slides in one step at the most
_SETTLED = 0.01  # spacings: places that slide less stay
_DAMPING = 1e-3  # of the diagonal of the normal matrix of a slide
# of the sum of squares that a pick removes at least: what a point leaves of a small disc, within a spacing
_EXPLAINED = 1e-3
_FURTHER = 0.1  # of what is left, that one more point explains: parts of something wide explain less
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
class _Columns:
    """What m contacts of 1 S feed into electrodes, `driven` (L, m) times `share` (n, m), nothing into the
    grounded one: its share `local` (L, m), and `weighted` (n, m), the metric times `share`."""

    driven: np.ndarray
    share: np.ndarray
    local: np.ndarray
    weighted: np.ndarray

    def __getitem__(self, which) -> _Columns:
        parts = self.driven, self.share, self.local, self.weighted
        return _Columns(*(each[:, which] for each in parts))


@dataclass(frozen=True)
class _Points:
    """Points at `places` (k, 2), m, with conductances `strengths` (k,), S; what they leave of the square of
    the currents, `left`; `columns`, 5 k, of which derivatives by the former and x and y per S are sums;
    products of these with each other, `normal` (3 k, 3 k), and with what is left, `along` (3 k,)."""

    places: np.ndarray
    strengths: np.ndarray
    left: float
    columns: _Columns | None = None
    normal: np.ndarray | None = None
    along: np.ndarray | None = None


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
        currents = self._currents = _Currents(operator, rows, gain, offset)
        self._total, self._count = currents.total, currents.count
        self._columns = currents.of(share)
        self._along, self._power = currents.along(self._columns), currents.squares(self._columns)
        self._few: tuple[float, _Points] | None = None  # the last answer of `_slid_to`

    def points(self, radius: float) -> list[tuple[np.ndarray, float]] | None:
        """Place (2,), m, and conductance, S, of points that explain all but what these leave of small
        contacts of `radius`, m, strongest first; None where no few of them do."""
        found = self._slid_to(radius)
        few = len(found.places) <= FEW
        if not len(found.places) or (few and found.left > _LEFT * self._total):
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
        if len(strong) < FEW and _are_distinct(strong, least):
            return strong
        single = not any(_are_distinct([strong[0], each], least) for each in strong[1:])
        return strong[:1] if single else []

    def _slid_to(self, radius: float) -> _Points:
        """Points of `radius`, m, beside which no further one explains anything; worked out once."""
        if self._few is None or self._few[0] != radius:
            self._few = radius, self._few_points(radius)
        return self._few[1]

    def _few_points(self, radius: float) -> _Points:
        found = _Points(np.empty((0, 2)), np.empty(0), self._total)
        settled, most = False, len(self._operator.used)
        while len(found.places) < most and found.left > self._count:
            explained = self._gains(found, settled)
            explained[self._near(found.places)] = 0.0
            best = int(explained.argmax())
            enough = max(self._beside(found, best), _FURTHER * found.left)
            if not settled:
                enough = max(enough, _EXPLAINED * self._total)
            more = None
            if explained[best] > enough:
                more = self._slid(np.vstack([found.places, self._pixels[best]]), radius, _STEPS)
            if more is not None and self._are_contacts(more):
                found, settled = more, False
            elif settled or not len(found.places):
                break
            else:
                found, settled = self._slid(found.places, radius, _LAST), True
        return found

    def _gains(self, points: _Points, beside: bool) -> np.ndarray:
        """(K,) how far what `points` leave falls with a contact at each pixel; `beside` : that no change of
        theirs explains."""
        if points.columns is None:
            return np.where(self._along > 0, self._along**2 / self._power, 0.0)
        count = len(points.places)
        between = self._currents.between(self._columns, points.columns)
        mine, own = self._along - between[:, :count] @ points.strengths, self._power
        if beside:
            taken = _summed(between).T
            normal = points.normal.copy()
            normal[np.diag_indices(len(normal))] *= 1 + _DEPENDENT
            own = own - (taken * np.linalg.solve(normal, taken)).sum(axis=0)
            own = np.maximum(own, _DEPENDENT * self._power)
        return np.where(mine > 0, mine**2 / own, 0.0)

    def _beside(self, points: _Points, pixel: int) -> float:
        """What a further point at a pixel must explain to be none that stands for the size of one of
        `points` within a spacing of it."""
        if points.normal is None:
            return _EXPLAINED * self._total
        near = np.hypot(*(points.places - self._pixels[pixel]).T) < self._operator.pitch
        squares = points.strengths**2 * points.normal.diagonal()[: len(near)]
        return _EXPLAINED * float(squares[near].max(initial=0.0))

    def _are_contacts(self, points: _Points) -> bool:
        """Whether points may be a contact each: of many, those nearer to each other than a spacing are parts
        of something wide."""
        places = points.places[points.strengths > 0]
        return len(places) <= FEW or bool(pdist(places).min() > self._operator.pitch)

    def contacts(self) -> list[tuple[np.ndarray, float]]:
        """Place (2,), m, and conductance, S, of contacts of any form, which together explain most, in
        parts about a spacing wide, strongest first."""
        picked: list[int] = []
        between = np.empty((len(self._pixels), _PICKS))
        strengths, left = np.empty(0), self._along
        while len(picked) < _PICKS:
            explained = np.where(left > 0, left**2 / self._power, 0.0)
            explained[picked] = 0.0
            best = int(explained.argmax())
            if explained[best] <= _EXPLAINED * self._total:
                break
            picked.append(best)
            count = len(picked)
            between[:, [count - 1]] = self._currents.between(self._columns, self._columns[[best]])
            strengths = _not_negative(between[picked, :count], self._along[picked])
            left = self._along - between[:, :count] @ strengths
        return self._gathered(self._pixels[picked], strengths)

    def image(self, share: np.ndarray) -> np.ndarray:
        """(K,) conductances, S, none below 0, with which contacts of `share` (n, K) explain most
        together: a linear image."""
        columns = self._currents.of(share)
        normal = self._currents.between(columns, columns)
        normal[np.diag_indices(len(normal))] *= 1 + _RIDGE
        root = np.linalg.cholesky(normal)
        return not_negative(root, np.linalg.solve(root, self._currents.along(columns)))

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
            columns = currents.with_slopes(share, slopes)
            normal = _summed(_summed(currents.between(columns, columns)).T)
            goal = _summed(currents.along(columns)[None])[0]
            strengths = _not_negative(normal[:count, :count], goal[:count])
            along = goal - normal[:, :count] @ strengths
            if not steps:
                left = self._total - strengths @ (goal + along)[:count]
                return _Points(places, strengths, float(left), columns, normal, along)
            scale = 1 / np.maximum(np.sqrt(normal.diagonal()), 1e-300)
            scaled = normal * scale * scale[:, None]
            scaled[np.diag_indices(len(scaled))] += _DAMPING
            way = scale * np.linalg.solve(scaled, scale * along)
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

    total, count : sum of their squares as the rows have it, and what noise makes of that
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
        self._pulled = currents @ self._metric
        self.total, self.count = float((currents * self._pulled).sum()), currents.size

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

    def of(self, share: np.ndarray) -> _Columns:
        """Of contacts with `share` (n, m)."""
        return self._columns(self._ratio @ share, share)

    def with_slopes(self, share: np.ndarray, slopes: np.ndarray) -> _Columns:
        """Of contacts with `share` (n, k), and the parts of their derivatives by x and y, (2, n, k), see
        `_summed`."""
        driven, (along_x, along_y) = self._ratio @ share, self._ratio @ slopes
        return self._columns(
            np.hstack([driven, along_x, driven, along_y, driven]),
            np.hstack([share, share, slopes[0], share, slopes[1]]),
        )

    def _columns(self, driven: np.ndarray, share: np.ndarray) -> _Columns:
        return _Columns(driven, share, share[self._grounded], self._metric @ share)

    def between(self, these: _Columns, others: _Columns) -> np.ndarray:
        """(m, q) products of columns."""
        at_ground = self._metric.diagonal()[self._grounded][:, None]
        out = (these.driven.T @ others.driven) * (these.share.T @ others.weighted)
        own, other = these.driven * these.local, others.driven * others.local
        out -= own.T @ (others.driven * others.weighted[self._grounded] - at_ground * other)
        out -= (these.driven * these.weighted[self._grounded]).T @ other
        return out

    def squares(self, of: _Columns) -> np.ndarray:
        """(m,) products of columns with themselves."""
        power = (of.share * of.weighted).sum(axis=0) - 2 * of.local * of.weighted[self._grounded]
        power += of.local**2 * self._metric.diagonal()[self._grounded][:, None]
        return np.maximum((of.driven**2 * power).sum(axis=0), 1e-300)

    def along(self, of: _Columns) -> np.ndarray:
        """(m,) products of columns with the currents of the rows."""
        local = of.local * self._pulled[self._at_ground][:, None]
        return (of.driven * (self._pulled @ of.share - local)).sum(axis=0)


def _summed(columns: np.ndarray) -> np.ndarray:
    """(m, 3 k) of columns (m, 5 k) of k points those by conductance, x and y."""
    value, *parts = np.split(columns, 5, axis=1)
    return np.hstack([value, parts[0] + parts[1], parts[2] + parts[3]])


def _are_distinct(points: list[tuple[np.ndarray, float]], least: float) -> bool:
    """Whether places of `points` are `least`, m, or more from each other."""
    if len(points) < 2:
        return True
    return bool(pdist(np.array([place for place, _ in points])).min() > least)


def _not_negative(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """(k,) factors, none below 0, of columns with products `normal` (k, k) with each other and `along` (k,)
    with what they add up to best."""
    normal = normal + _ROUNDING * np.diag(normal.diagonal())
    root = np.linalg.cholesky(normal)
    return nnls(root.T, np.linalg.solve(root, along))[0]


def not_negative(root: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """(k,) x >= 0 with the least |root^T x - goal|; LinAlgError where no end is found."""
    try:
        return nnls(root.T, goal, maxiter=30 * len(root))[0]
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None
