"""Simulated contacts, and how far off is what was found of them."""

import numpy as np

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

DRIVE, NOISE, LAW = 3.3, 1e-3, ContactLaw(1e-4, 1.0)  # V, V, S/m^2 per Pa
CONVERTER, FLAWLESS = Adc(12, DRIVE), Defects()


def disc(x, y, radius=0.006, **pressed):
    """With its pressure or force, times and velocity; a bare conductor without."""
    return Contact("disc", center=(float(x), float(y)), radius=radius, **pressed)


def sensor(layout, *contacts, noise=NOISE, seed=1, law=LAW, defects=FLAWLESS, **how):
    """A `Simulator` of contacts, of the finite-element model where nothing else is said; without noise,
    readings are not converted either."""
    drive, adc = how.pop("drive", DRIVE), how.pop("adc", CONVERTER if noise else None)
    own = how.pop("own_reading", False)
    scene = Scene("test", drive, contacts, law, Noise(noise, seed), adc, defects, own_reading=own)
    return Simulator(layout, scene, **{"row_period": ROW_PERIOD, **how})


def pipeline_of(layout, profile="accurate", **settings):
    """A `Pipeline` of a layout, or its name, which expects NOISE and LAW if nothing else is said."""
    layout = load_layout(layout) if isinstance(layout, str) else layout
    return Pipeline(layout, Settings(profile, **settings))


def scene_on(layout, scene, profile="accurate", **settings):
    """A simulator of a scene on a layout, or their names, and a pipeline that knows its contact law."""
    scene = load_scene(scene) if isinstance(scene, str) else scene
    simulator = Simulator(load_layout(layout), scene)
    settings = Settings(profile, contact_law=scene.contact_law, **settings)
    return simulator, Pipeline(simulator.layout, settings)


def told_rightly(result, truth, place=np.inf, force=np.inf):
    """Whether a result has each contact that is there and no other, none farther off, m and relative."""
    score = score_frame(result.contacts, truth)
    alone = not (score.ghosts or score.doubled or score.missed) and score.true == len(truth)
    return alone and score.place.max() < place and score.force.max() < force


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
