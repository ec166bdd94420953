"""Simulated contacts, and how far off is what was found of them."""

import numpy as np

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

DRIVE, NOISE, LAW = 3.3, 1e-3, ContactLaw(1e-4, 1.0)  # V, V, S/m^2 per Pa
CONVERTER, FLAWLESS = Adc(12, DRIVE), Defects()


def disc(x, y, radius=0.006, **pressed):
    """With its pressure or force, times and velocity; a bare conductor without."""
    return Contact("disc", center=(float(x), float(y)), radius=radius, **pressed)


def sensor(layout, *contacts, noise=NOISE, seed=1, law=LAW, defects=FLAWLESS, **how):
    """A `Simulator` of contacts, of the finite-element model where nothing else is said."""
    drive, adc = how.pop("drive", DRIVE), how.pop("adc", CONVERTER)
    scene = Scene("test", drive, contacts, law, Noise(noise, seed), adc, defects)
    return Simulator(layout, scene, **{"row_period": ROW_PERIOD, **how})


def frames_of(simulator, count):
    """(count, L, E) V, one after the other without a pause."""
    lasts = len(simulator.grounded) * simulator.row_period
    return np.array([simulator.frame(i * lasts, i) for i in range(count)])


def rows_of(volts, noise=NOISE, grounded=None, times=None):
    """`Rows` of a frame, V, that leave out the grounded electrode and what was not read."""
    grounded = np.arange(len(volts)) if grounded is None else np.asarray(grounded)
    weights = np.where(np.isnan(volts), 0.0, (DRIVE / noise) ** 2)
    weights[np.arange(len(volts)), grounded] = 0.0
    return Rows(np.where(weights > 0, volts / DRIVE, 0.0), weights, grounded, times)


def unknown(operator, radius=0.005, **channels):
    """The `Prior` of a sensor of which nothing is known."""
    return Prior.unknown(operator, ChannelPrior(**channels), radius, DRIVE)


def places(contacts):
    """(n, 2) m."""
    return np.array([(each.x, each.y) for each in contacts]).reshape(-1, 2)


def off(found, place):
    """How far a contact is from a place, m."""
    return float(np.hypot(found.x - place[0], found.y - place[1]))


def deviations_off(found, place):
    """The same in standard deviations of the contact, squared: beyond 5.99 in one of twenty."""
    way = np.array([found.x - place[0], found.y - place[1]])
    covariance = getattr(found, "position_covariance", None)
    covariance = found.covariance if covariance is None else covariance
    return float(way @ np.linalg.solve(np.reshape(covariance, (2, 2)), way))
