"""What is expected of gains, offsets, resistances to ground and places of electrodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.tolerance import Tolerance

if TYPE_CHECKING:
    from tomotactile_ros.estimation.operator import SheetOperator

# of the variance of resistances to ground, and of radii, is common to all: switches and a print of one kind;
# what radii have in common is a coefficient of the sheet (`as_cut`)
ALIKE = 0.5
_TOGETHER = 0.01  # of the deviation of each way aside: as good as nothing, and the covariance has an inverse
KINDS = 5  # gain, offset, resistance to ground, and how far the electrode lies aside in x and y
# what is unknown of a sensor, and which of these kinds it is; the coefficients of the sheet are none
SENSOR: dict[str, tuple[int, ...]] = {
    "gains": (0,),
    "offsets": (1,),
    "resistances": (2,),
    "sheet": (),
    "places": (3, 4),
}
# what is found with the contacts: of the sensor; what readings keep of the row before; contacts that are no
# discs; contacts that move while the rows of a frame are read
UNKNOWN = (*SENSOR, "settling", "shape", "motion")


@dataclass(frozen=True)
class ChannelPrior:
    """Standard deviations before anything is known, and what is expected.

    gain : relative; published electronics contradict reciprocity by 0.8 to 7 %
    offset : V; the input offset of common converters and amplifiers
    resistance : ohm; an analogue switch has some tens to hundreds
    aside : spacings, in x and in y; what electrodes lie beside their places in the layout: 0.1 mm at
        8 x 8 on 200 mm; twice as much makes places on exact sensors worse
    radius : of an electrode, relative; a smaller one acts as a resistance to ground, a larger one as a
        negative one

    Methods take an operator, and the electrodes `among` (n,) of its layout, without them those in use.
    """

    gain: float = 0.03
    offset: float = 0.003
    resistance: float = 200.0
    aside: float = 3e-3
    radius: float = Tolerance.radius

    def for_layout(self, layout: Layout) -> ChannelPrior:
        """The same with what the layout says of its places and radii."""
        places, radius = layout.tolerance.places, layout.tolerance.radius
        aside = self.aside if places is None else places / float(np.median(layout.pitches))
        return replace(self, aside=aside, radius=radius)

    def covariance_of_resistances(
        self, operator: SheetOperator, among: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, n) ohm², of what switches and wires have and of what radii of their own make of it."""
        by_radius = operator.by_radius[operator.used if among is None else among]
        own = np.diag(self.resistance**2 + (self.radius * by_radius) ** 2)
        return (1 - ALIKE) * own + ALIKE * self.resistance**2

    def covariance_of_places(
        self, operator: SheetOperator, among: np.ndarray | None = None
    ) -> np.ndarray:
        """(2 n, 2 n) m², of ways aside in x of all, then in y: all that electrodes may have but a common
        shift, turn and scale, since places are told relative to them."""
        return (self.aside * operator.pitch) ** 2 * _scaled_in_common(operator, among, _TOGETHER)

    def precision_of_places(self, operator: SheetOperator) -> np.ndarray:
        """(2 n, 2 n) 1/m², inverse of the covariance of electrodes in use."""
        return _scaled_in_common(operator, None, 1 / _TOGETHER) / (self.aside * operator.pitch) ** 2

    def deviations(
        self, operator: SheetOperator, drive: float, among: np.ndarray | None = None
    ) -> tuple[np.ndarray, ...]:
        """(n,) of each kind; offsets in parts of the `drive` voltage, ways aside in m."""
        aside = np.sqrt(self.covariance_of_places(operator, among).diagonal())
        resistance = np.sqrt(self.covariance_of_resistances(operator, among).diagonal())
        count = len(resistance)
        gain, offset = np.full(count, self.gain), np.full(count, self.offset / drive)
        return gain, offset, resistance, aside[:count], aside[count:]


def _scaled_in_common(
    operator: SheetOperator, among: np.ndarray | None, scale: float
) -> np.ndarray:
    """(2 n, 2 n) covariance of ways of variance 1 whose common shift, turn and scale have the deviation
    `scale`."""
    x, y = operator.layout.positions[operator.used if among is None else among].T
    one, none = np.ones(len(x)), np.zeros(len(x))
    common = np.array([[*one, *none], [*none, *one], [*x, *y], [*-y, *x]])
    ways, size, _ = np.linalg.svd(common.T / operator.pitch, full_matrices=False)
    ways = ways[:, size > 1e-6 * size[0]]
    return np.eye(2 * len(x)) + (scale**2 - 1) * ways @ ways.T
