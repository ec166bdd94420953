"""Several faults of a sensor at once."""

import numpy as np

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT, DRIVE, LAW = load_layout("equal-8x8"), 3.3, ContactLaw(1e-4, 1.0)


def results(places, pressures, wires, seed, spoil):
    """Of two frames with ten times the noise that was said, and two wires swapped; `spoil` adds to
    that."""
    discs = [
        Contact("disc", center=tuple(place), radius=0.006, pressure=pressure)
        for place, pressure in zip(places, pressures)
    ]
    scene = Scene("two", DRIVE, discs, LAW, Noise(1e-2, seed), Adc(12, DRIVE))
    simulator = Simulator(LAYOUT, scene, row_period=ROW_PERIOD)
    pipeline = Pipeline(LAYOUT, Settings("accurate", noise=1e-3, contact_law=LAW))
    for number in range(2):
        frame = np.array(simulator.frame(64 * number * ROW_PERIOD, number))
        frame = spoil(frame)
        frame[:, wires] = frame[:, wires[::-1]]
        frame[wires] = frame[wires[::-1]]
        np.fill_diagonal(frame, np.nan)
        yield pipeline.process(frame, np.arange(64), DRIVE, ROW_PERIOD)


def right(result, places) -> bool:
    """Whether nothing is told, or every contact is where one is and none is missing."""
    found = np.array([(c.x, c.y) for c in result.contacts]).reshape(-1, 2)
    apart = np.hypot(*(np.array(places)[:, None] - found).transpose(2, 0, 1))
    complete = found.size > 0 and max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 5e-3
    return bool(result.reason) or complete


def test_two_last_rows_of_a_broken_sensor_are_no_change():
    """Swapped wires and ten times the noise contradicted reciprocity, as a change does; what two rows
    said by themselves was a contact 20 mm off, and valid."""
    places = (0.0103, 0.0039), (0.0369, 0.0440)

    def clipped(frame):
        return np.minimum(frame, np.nanquantile(frame, 0.9))

    for each in results(places, (1.36e4, 1.1e4), [39, 41], 45, clipped):
        assert right(each, places)


def test_more_noise_than_was_said_is_no_reason_for_more_that_is_left_over():
    """With a ground that is open besides, 6 standard deviations were left over of each reading."""
    places = (-0.0176, 0.0381), (0.024, 0.0293)

    def open_ground(frame):
        frame[12] = DRIVE
        return frame

    for each in results(places, (1.268e4, 1.766e4), [32, 27], 61, open_ground):
        assert right(each, places)
