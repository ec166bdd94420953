"""What is reported of a shape: one contact for each of its parts, with standard deviations.

Force is the sum over the cells, the place their centre of pressure, and pressure the mean over the
force, sum p dF / F: the pressure of an even contact. Deviations follow from the joint covariance of the
cells, as neighbours are known together far better than each is.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.reported import (
    BARE,
    FORCE_FLOOR,
    IMPEDANCE_FLOOR,
    MOST_RELATIVE,
    Contact,
    contacts_of,
    crowded,
    four,
    joined,
    place_floor,
    spread_within,
    told,
)
from tomotactile_ros.estimation.shape import certainty, columns
from tomotactile_ros.estimation.touch import RADIUS
from tomotactile_ros.scenes.contact import ContactLaw

# what cells err at the rim of a contact, in parts of side over radius: of a side in places, of a force;
# standard deviations
CELL_PLACE, CELL_FORCE = 0.1, 0.15
# the same of places of discs beside cells: fingertips beside a palm were off by 0.3 mm rms for cells of 6 mm
BESIDE = 0.03
# standard deviations of what it conducts: below, it is not known that something presses
_CERTAIN = 3.0
_MOSTLY_BARE = 0.1  # of the force: carried by bare conductors, it is known from below only
_PART = 1e-3  # of the force: cells that carry less are no part of what presses
# of the strongest: weaker parts may be an error in its shape: a line of 5 mm on cells of 7 mm left
# one of 4 % beside it (gains off by 2 %)
_WEAK = 0.05


def contacts_of_shape(
    fit: Fit, law: ContactLaw, group: np.ndarray
) -> tuple[list[Contact], list[Contact]]:
    """Contacts, strongest first, and the discs and cells that they consist of, as discs; `group` (k,) the contact that
    each disc and cell is part of."""
    cells, alone = _Cells(fit, law), fit.unknowns.alone
    aside = np.diag([(BESIDE * cells.side) ** 2] * 2 + [0.0])
    wide = [
        cells.ways[alone:][group[alone:] == each].sum(axis=0) for each in np.unique(group[alone:])
    ]
    ways = np.vstack([cells.ways[:alone], wide])
    discs, of = contacts_of(fit, group, law, lambda _: 0.0, lambda _: aside, alone, ways)
    shapes = [
        (each, *cells.together(np.flatnonzero(group[alone:] == each)))
        for each in np.unique(group[alone:])
    ]
    most = max(contact.force for _, contact, _ in shapes)
    kept = [each for each in shapes if each[1].force > _WEAK * most and each[1].probability > 0]
    contacts = joined(
        [*discs, *(contact for _, contact, _ in kept)], np.append(of, [each for each, _, _ in kept])
    )
    return contacts, [*discs, *(cells.alone(i) for _, _, which in kept for i in which)]


class _Cells:
    """Forces of cells with their covariance."""

    def __init__(self, fit: Fit, law: ContactLaw):
        self._fit, u, prediction = fit, fit.unknowns, fit.prediction
        cells = self._which = np.arange(u.alone, len(u.contacts))
        self._at = columns(fit)[cells]
        self.side = float(np.exp(u.contacts[-1, RADIUS]) * np.sqrt(np.pi))
        self._sheet, self._exponent = fit.operator.resistance, law.exponent
        covered = prediction.covered[cells]
        self._area = np.pi * np.exp(2 * u.contacts[cells, RADIUS]) * covered
        most = [told(prediction.conductances[i], prediction.means[i], self._sheet) for i in cells]
        self._conductances = np.array([g for g, _ in most]) * covered
        self._bare = np.array([bare for _, bare in most])
        self._pressures = np.asarray(law.pressure(self._conductances / self._area))
        self.forces = self._pressures * self._area
        self._places = np.array([prediction.touches.centre(i) for i in cells])
        self._slopes = self.forces * prediction.force_by_strength(law.exponent)[cells]
        by_ways = [prediction.force_by_impedance(i, law.exponent) for i in cells]
        self._by_ways = self.forces * np.array(by_ways)
        self._covariance = fit.covariance[np.ix_(self._at, self._at)] * fit.doubt
        self.ways = prediction.way_columns()
        self._uneven = fit.equations.unevenness(fit)

    def together(self, which: np.ndarray) -> tuple[Contact, np.ndarray]:
        """The contact that the cells `which` (m,) are, and those of them that press."""
        fit, forces = self._fit, self.forces[which]
        force = float(forces.sum())
        share = forces / force
        place = share @ self._places[which]
        area = float(self._area[which].sum())
        pressure = float(share @ self._pressures[which])
        area = min(area, force / max(pressure, 1e-300))
        slopes = np.zeros((3, len(self.forces)))  # of the force, and of the place
        slopes[0, which] = self._slopes[which]
        aside = (self._places[which] - place) / force
        slopes[1:, which] = (self._slopes[which][:, None] * aside).T
        # what is wrong with D of all its cells alike bends all that is fitted
        bent = fit.equations.response(self.ways[self._which[which]].sum(axis=0)[None])[:, 0]
        bent = IMPEDANCE_FLOOR * bent[self._at]
        covariance = self._covariance + np.outer(bent, bent)
        spread = slopes @ covariance @ slopes.T
        ways = slopes[0] @ bent - IMPEDANCE_FLOOR * self._by_ways[which].sum()
        noise = slopes[0] @ self._covariance @ slopes[0] + ways**2
        conductance = float(self._conductances[which].sum())
        side = self.side
        coarse = side / float(np.sqrt(area / np.pi))
        unknown = FORCE_FLOOR**2 + crowded(conductance, self._sheet) ** 2
        unknown += (CELL_FORCE * coarse) ** 2
        relative = float(np.sqrt(noise / force**2 + unknown))
        # by what its cells conduct: of nearly bare ones the force is hardly known
        certain = float(np.sqrt(certainty(self._covariance, which)))
        mean = self._mean(which)
        # no cell need be a bare one for all of them to be one together
        most = 1 / (BARE * max(mean, 1e-300))
        bare = conductance > most or share[self._bare[which]].sum() > _MOSTLY_BARE
        if bare:  # what all its cells together are known to conduct at the least
            least = min(told(conductance, mean, self._sheet)[0], most) / conductance
            conductance *= least
            force *= least ** (1 / self._exponent)
            area = float(self._area[which[share > _PART]].sum())
            pressure = force / area  # how it is spread is not known
        floor = place_floor(fit, self._uneven) ** 2
        floor += (CELL_PLACE * side * coarse) ** 2
        at = spread[1:, 1:] + floor * np.eye(2)
        if bare:
            at = at + spread_within(self._places[which], share)
        contact = Contact(
            float(place[0]),
            float(place[1]),
            force,
            pressure,
            area,
            float(np.sqrt(area / np.pi)),
            conductance,
            four(at),
            np.inf if bare else force * min(relative, MOST_RELATIVE),
            side / 2,
            float(1 - np.exp(-(certain**2) / 2)) if certain > _CERTAIN or bare else 0.0,
        )
        return contact, which[share > _PART]

    def _mean(self, which: np.ndarray) -> float:
        """Mean D of what the cells `which` conduct together, ohm."""
        touches = self._fit.prediction.touches
        conductances = np.zeros(len(self._fit.unknowns.contacts))
        conductances[self._which[which]] = self._conductances[which]
        share = conductances[touches.owner] * touches.weight
        share /= max(float(share.sum()), 1e-300)
        return float(share @ touches.impedance @ share)

    def alone(self, i: int) -> Contact:
        """One cell."""
        radius = float(np.sqrt(self._area[i] / np.pi))
        force, pressure = float(self.forces[i]), float(self._pressures[i])
        x, y = self._places[i].tolist()
        nothing = 0.0, 0.0, 0.0, 0.0
        conductance = float(self._conductances[i])
        return Contact(x, y, force, pressure, float(self._area[i]), radius, conductance, nothing, 0.0, 0.0, 1.0)  # fmt: skip
