"""Contacts that move while the rows of a frame are read: their velocity comes out of one frame."""

import numpy as np

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator


def test_the_velocity_of_a_contact_is_reported():
    layout, law = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4), ContactLaw(1e-4, 1.0)
    fast = Contact("disc", center=(-0.03, 0.02), radius=0.006, pressure=2e4, velocity=(0.5, -0.8))
    sensor = Simulator(layout, Scene("test", 3.3, (fast,), contact_law=law))
    pipeline = Pipeline(layout, Settings("accurate", contact_law=law))
    (contact,) = pipeline.process(sensor.frame(0.0), sensor.grounded, 3.3, ROW_PERIOD).contacts
    np.testing.assert_allclose(contact.velocity, fast.velocity, atol=0.05)
