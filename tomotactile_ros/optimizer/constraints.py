"""Where electrodes may be: spacing, distance to the rim, places to keep free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError

_STEP = 1e-6  # of the outline's size, for the slope of distances
_ROUNDS = 200
_BEYOND = 1e-3  # of a violation: corrections go a little too far, so that they end


@dataclass(frozen=True, eq=False)
class Constraints:
    """What the positions of electrodes have to obey.

    outline   the sheet
    spacing   smallest distance between two centres, m
    margin    smallest distance of a centre from the rim, m
    keep_out  regions without electrode centres, for instance for screws or a connector
    fixed     numbers of electrodes that stay where they are
    """

    outline: Outline
    spacing: float
    margin: float = 0.0
    keep_out: tuple[Region, ...] = ()
    fixed: tuple[int, ...] = ()

    @property
    def tolerance(self) -> float:
        """Violation that counts as none, m."""
        return 1e-9 * max(self.outline.size)

    def violation(self, positions) -> float:
        """Largest violation by electrodes at `positions` (E, 2), m; 0 if all is kept."""
        short = np.maximum(self.spacing - _distances(positions), 0)
        return float(max(short.max(initial=0.0), self._trespass(positions).max(initial=0.0)))

    def kept_by(self, positions) -> bool:
        """Whether electrodes at `positions` (E, 2), m, obey, but for rounding."""
        return self.violation(positions) <= 2 * self.tolerance

    def project(self, positions) -> np.ndarray | None:
        """Positions (E, 2) nearby that obey, or None where none are found.

        All electrodes are corrected at once, so symmetries that positions and zones share are kept.
        Those that are fixed do not give way.
        """
        positions = np.array(positions, float)
        gives_way = np.ones(len(positions))
        gives_way[list(self.fixed)] = 0.0
        # of what two are short of: a half each, and a little more
        share = gives_way[:, None] * (1 - 0.5 * gives_way + _BEYOND)
        for _ in range(_ROUNDS):
            if self.violation(positions) <= self.tolerance:
                return positions
            trespass = self._trespass(positions)
            wrong = np.flatnonzero(trespass * gives_way)
            uphill = self._slope(positions[wrong])
            positions[wrong] -= (1 + _BEYOND) * trespass[wrong, None] * uphill
            distance = _distances(positions)
            short = np.maximum(self.spacing - distance, 0)
            push = (short / np.maximum(distance, 1e-12))[..., None] * (
                positions[:, None] - positions
            )
            positions += (share[..., None] * push).sum(axis=1)
        return None

    def _trespass(self, positions):
        """(E,) how far each centre is beyond the margin or inside a region to keep out of, m."""
        out = np.maximum(self.margin - self.outline.signed_distance(positions), 0)
        for region in self.keep_out:
            inside = region.contains(positions)
            out = np.maximum(out, np.where(inside, region.rim_distance(positions), 0))
        return out

    def _slope(self, positions):
        """(n, 2) unit vectors along which the trespass of each grows fastest."""
        step = _STEP * max(self.outline.size)
        slope = np.column_stack(
            [
                self._trespass(positions + step * axis) - self._trespass(positions - step * axis)
                for axis in np.eye(2)
            ]
        )
        return slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)[:, None]

    def insist(self, layout: Layout) -> None:
        """Raise InputError where a layout does not obey: nothing of that kind is written."""
        if self.kept_by(layout.positions):
            return
        short = self.spacing - _distances(layout.positions).min()
        trespass = self._trespass(layout.positions)
        worst = int(np.argmax(trespass))
        x, y = layout.positions[worst]
        what = (
            f"electrode {worst} at ({x:g}, {y:g}) m is {plain(1e3 * trespass[worst])} mm inside a zone to "
            "keep out of, or that much too near to the rim"
            if trespass[worst] > short
            else f"two electrodes are {plain(1e3 * short)} mm too near to each other"
        )
        raise InputError(f"constraints: {what}, and nothing was found that obeys")

    def check(self, electrodes: int, radius: float) -> None:
        """Raise InputError where no layout of so many electrodes of `radius` (m) can obey."""
        checks.not_negative(self.margin, "margin", "length in m")
        checks.length(self.spacing, "spacing")
        if self.spacing <= 2 * radius:
            raise InputError(
                f"spacing: {self.spacing:g} m lets electrodes of {radius:g} m radius overlap, "
                f"it must be above {2 * radius:g} m"
            )
        for i, region in enumerate(self.keep_out):
            if not self.outline.overlaps(region.shell[None])[0] > 0:
                x, y = region.shell.mean(axis=0).round(9) + 0.0  # no -0
                xmin, ymin, xmax, ymax = self.outline.bounds
                raise InputError(
                    f"keep_out[{i}]: the disc around ({x:g}, {y:g}) m is nowhere on the sheet, which "
                    f"goes from ({xmin:g}, {ymin:g}) to ({xmax:g}, {ymax:g}) m"
                    + (", with holes" if self.outline.holes else "; the origin is its middle")
                )
        a, b = self.outline.size
        if 2 * self.margin >= min(a, b):
            raise InputError(
                f"margin: {self.margin:g} leaves no room on a sheet of {a:g} m x {b:g} m"
            )
        # Groemer 1960: centres at least d apart in a convex body of area F and perimeter U number
        # at most 2 F / (sqrt(3) d^2) + U / (2 d) + 1
        a, b = a - 2 * self.margin, b - 2 * self.margin
        most = 2 / np.sqrt(3) * a * b / self.spacing**2 + (a + b) / self.spacing + 1
        if electrodes > most:
            raise InputError(
                f"spacing: {electrodes} electrodes do not fit {self.spacing:g} m apart, "
                f"at most {int(most)} could"
            )


def doubts_of(layout: Layout, spacing: float, method: str, mark: str) -> list[str]:
    """What who makes the layout should know: electrodes beyond the rim, and centres closer than `spacing` (m).

    method : that keeps margin and spacing, if that which has found the layout does not; else ""
    mark : before names of options
    """
    method, told = method and f"{mark}method {method} ", []
    over = Constraints(layout.outline, 0.0, layout.radius)._trespass(layout.positions)
    count = np.count_nonzero(over > 1e-3 * layout.radius)
    if count:
        told.append(
            f"{count} electrodes reach up to {plain(1e3 * over.max())} mm beyond the rim: "
            f"{method}{mark}margin {plain(layout.radius)} keeps them on the sheet"
        )
    distances = _distances(layout.positions)
    a, b = sorted(map(int, np.unravel_index(distances.argmin(), distances.shape)))
    if distances.min() < 0.999 * spacing:
        gap = 1e3 * (distances.min() - 2 * layout.radius)
        told.append(
            f"electrodes {a} and {b} are {plain(gap)} mm apart, rim to rim: "
            f"{method}{mark}spacing sets the least distance of centres"
        )
    return told


def _distances(positions):
    distance = np.linalg.norm(positions[:, None] - positions, axis=2)
    np.fill_diagonal(distance, np.inf)
    return distance
