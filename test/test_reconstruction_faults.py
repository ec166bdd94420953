"""Several faults of a sensor at once."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import (
    DRIVE,
    LAW,
    deviations_off,
    disc,
    frames_of,
    off,
    pipeline_of,
    places,
    scene_on,
    sensor,
    told_rightly,
)

from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.estimation import screening
from tomotactile_ros.estimation.screening import clipped
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.course import Tap
from tomotactile_ros.simulation import ROW_PERIOD

LAYOUT = load_layout("equal-8x8")


def clipped_at_90_percent(frame):
    return np.minimum(frame, np.nanquantile(frame, 0.9))


def open_ground(frame):
    frame[12] = DRIVE
    return frame


@pytest.mark.parametrize(
    "true, pressures, wires, seed, spoil",
    [
        # what two last rows said by themselves, as if something had changed, was a contact 20 mm off, and valid
        (((10.3, 3.9), (36.9, 44.0)), (1.36e4, 1.1e4), [39, 41], 45, clipped_at_90_percent),
        # 6 standard deviations were left over of each reading
        (((-17.6, 38.1), (24.0, 29.3)), (1.268e4, 1.766e4), [32, 27], 61, open_ground),
    ],
    ids=["end of the range", "open ground"],
)
def test_ten_times_the_noise_swapped_wires_and_more(true, pressures, wires, seed, spoil):
    """Nothing is told, or every contact is where one is and none is missing."""
    true = 1e-3 * np.array(true)
    discs = [disc(*place, pressure=p) for place, p in zip(true, pressures)]
    pipeline = pipeline_of(LAYOUT)
    for frame in frames_of(sensor(LAYOUT, *discs, noise=1e-2, seed=seed), 2):
        frame = spoil(frame)
        frame[:, wires] = frame[:, wires[::-1]]
        frame[wires] = frame[wires[::-1]]
        np.fill_diagonal(frame, np.nan)
        result = pipeline.process(frame, np.arange(64), DRIVE, ROW_PERIOD)
        found = places(result.contacts)
        apart = np.hypot(*(true[:, None] - found).transpose(2, 0, 1))
        complete = found.size and max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 5e-3
        assert result.reason or complete


COVERED = [(*(1e3 * LAYOUT.positions[36]), 5.0)]
PAIR = [
    (14.29, 14.29, 5.0),
    (-17.71, 14.29, 5.0),
]  # one upon an electrode, one at the rim of another


@pytest.mark.parametrize(
    "profile, law, discs, within",
    [
        # reads the drive voltage in all rows, as the experiment of the paper has it
        ("fast", None, COVERED, 1.0),
        ("accurate", None, COVERED, 1.0),
        # one was reported, between them: what both electrodes read was taken for that of broken channels
        ("fast", None, PAIR, 1.0),
        ("accurate", None, PAIR, 1.0),
        # the first was not reported: how well it conducts no reading told
        ("accurate", LAW, [(85.7, -28.6, 6.8), (14.7, -14.4, 9.5)], None),
        ("balanced", LAW, [(27.5, 14.8, 5.0), (-85.7, 0.0, 7.3)], None),
        # 7 and 42 were named; the corner is seen worst
        ("balanced", LAW, [(98.6, -98.7, 10.5), (-42.1, 31.4, 10.3), (19.8, 76.0, 4.4)], None),
    ],
)
def test_bare_conductors_on_electrodes_are_found_and_no_electrode_is_named(
    profile, law, discs, within
):
    """To `within` mm, or their radius."""
    true = [disc(x / 1e3, y / 1e3, radius / 1e3) for x, y, radius in discs]
    pipeline = Pipeline(LAYOUT, Settings(profile, contact_law=law))
    for frame in frames_of(sensor(LAYOUT, *true, law=law), 2 if law is None else 1):
        result = pipeline.process(frame, np.arange(64), DRIVE, ROW_PERIOD)
        assert result.faults == {} and result.excluded == () and not result.reason
        assert len(result.contacts) == len(discs)
        for each in true:
            limit = 1e-3 * within if within else each.radius
            assert min(off(c, each.center) for c in result.contacts) < limit


def test_a_plate_over_two_electrodes_breaks_none_of_them():
    plate = Contact("rectangle", center=(0.0714, 0.0857), size=(0.0406, 0.012), angle=90.0)
    result = Pipeline(LAYOUT, Settings("accurate")).process(sensor(LAYOUT, plate).measure(0.0))
    assert result.contacts and result.faults == {} and result.excluded == ()


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_one_reading_at_the_end_of_the_converter_is_left_out(bits):
    """It shows neither gain nor settling: one of 4,032 kept half a percent of settling from being found, and
    contacts beside it were 28 mm off."""
    step = 3.3 / 2**bits
    read = np.round(np.random.default_rng(bits).uniform(0.0, 3.2, (4, 16)) / step) * step
    assert not clipped(read, 3.3).any()
    read[2, 5] = 3.3 - step
    for each in (read, read.astype(np.float32).astype(float)):
        assert np.argwhere(clipped(each, 3.3)).tolist() == [[2, 5]]
    assert not clipped(read, 5.0).any()


@pytest.mark.parametrize("profile", ["fast", "accurate"])
@pytest.mark.parametrize("stuck", [36, 12])
def test_a_channel_that_stands_still_is_named(profile, stuck):
    """Under a contact it does if it is not at the drive voltage; beside one also there."""
    press = disc(*LAYOUT.positions[36], 0.005, pressure=20000.0)
    frame = sensor(LAYOUT, press).measure(0.0)
    frame.voltages[:, stuck] = 1.0 if stuck == 36 else 3.3
    result = Pipeline(LAYOUT, Settings(profile)).process(frame)
    assert len(result.contacts) == 1
    assert list(result.faults) == [stuck] and result.excluded == (stuck,)


@pytest.mark.parametrize("profile", ["fast", "accurate"])
@pytest.mark.parametrize(
    "place, force, radius, begun, lasts",
    [
        ((6.5, -26.6), 1.39, 6.2, 3.99, 0.208),  # 0, 1, 9 and 10 contradicted all others
        ((-57.7, -84.9), 0.91, 6.2, 3.0, 0.098),
        ((33.6, -31.7), 0.70, 5.9, 3.93, 0.0),  # 15 never changed
        ((33.6, -31.7), 0.70, 5.9, 3.93, 0.247),
        ((41.1, 43.1), 1.82, 4.6, 3.97, 0.130),  # its electrodes had other numbers
        ((-40.5, -34.3), 4.78, 4.6, 3.6, 0.232),  # its readings scattered by 16 mV
    ],
)
def test_a_touch_that_begins_is_no_fault(profile, place, force, radius, begun, lasts):
    """Of a healthy sensor no channel is named, and contacts are withheld at most in a frame of which a
    row or two were touched."""
    four, period = load_layout("equal-4x4"), 16 * ROW_PERIOD
    place, course = 1e-3 * np.array(place), Tap(lasts, 10.0) if lasts else None
    more = {"profile": "hertz", "start": begun * period, "course": course}
    contact = disc(*place, 1e-3 * radius, force=force, **more)
    simulator, pipeline = sensor(four, contact, seed=6), Pipeline(four, Settings(profile))
    for number in range(6):
        result = pipeline.process(simulator.measure(number * period, number))
        assert result.faults == {} and result.excluded == ()
        touched = (number + 1 - begun) * 16  # rows
        assert not result.reason or 0 < touched < 3
        if touched > 3:
            (found,) = result.contacts
            assert off(found, place) < 0.01


PERIOD = 16 * ROW_PERIOD
BLOCK = {"size": (0.01628, 0.00814), "angle": 123.1, "force": 2.635}


@pytest.mark.parametrize(
    "layout, seed, presses",
    [
        # 0 and 9 seemed to be exchanged: the first row was untouched
        ("optimized-4x4", 71, [((-0.08353, -0.02597, 0.01664, 3.488), 2.00186, 5.814)]),
        # 14 and 15 contradicted all others: one of two had ended before they were grounded
        (
            "touch-4x4",
            2,
            [((0.05768, 0.08593, 0.00811, 3.284), 2.8549, np.inf), (BLOCK, 2.393, 4.815)],
        ),
    ],
)
def test_what_begins_or_ends_within_a_frame_is_no_fault(layout, seed, presses):
    layout, contacts = load_layout(layout), []
    for form, begins, ends in presses:
        times = {"start": begins * PERIOD, "end": ends * PERIOD}
        if form is BLOCK:
            contacts.append(Contact("rectangle", center=(-0.05803, -0.07897), **form, **times))
        else:
            contacts.append(disc(*form[:3], force=form[3], **times))
    simulator = sensor(layout, *contacts, seed=seed)
    pipeline = Pipeline(layout, Settings("accurate"))
    for number in range(7):
        result = pipeline.process(simulator.measure(number * PERIOD, number))
        assert result.faults == {} and result.excluded == (), number


def test_rows_follow_a_conductor_on_an_electrode():
    """Its row, in which all is at the drive voltage, kept frames from being whole, and readings that are as high as
    the drive were taken for the end of the converter's range."""
    true = sorted((x / 1e3, y / 1e3) for x, y, _ in PAIR)
    simulator = sensor(LAYOUT, *(disc(*each, 0.005) for each in true), seed=0)
    pipeline = Pipeline(LAYOUT, Settings(contact_law=None))
    state = pipeline.rows()
    for number in range(3):
        frame = simulator.measure(0.064 * number, number)
        for i, (row, at) in enumerate(zip(frame.voltages, frame.grounded)):
            time = frame.stamp + i * frame.row_period
            result = pipeline.process_row(row, int(at), DRIVE, time, state)
            assert number == 0 or (not result.reason and result.faults == {}), (number, at)
    assert np.allclose(sorted((c.x, c.y) for c in result.contacts), true, atol=2e-3)


@pytest.mark.parametrize(
    "place, radius",
    [
        ((-0.03944, -0.03568), 0.00562),
        ((-0.02134, -0.07539), 0.00539),
        ((0.00784, -0.01103), 0.00478),
        ((-0.0722, 0.04906), 0.00634),
    ],
)
def test_a_bare_conductor_that_touches_the_rim_of_an_electrode_is_as_unsure_as_it_is_wrong(
    place, radius
):
    """0.4 to 0.9 mm off, known to 0.07."""
    frame = sensor(LAYOUT, disc(*place, radius), law=None, seed=0).measure(0.0)
    (contact,) = Pipeline(LAYOUT, Settings("accurate")).process(frame).contacts
    assert deviations_off(contact, place) < 6.0


@pytest.mark.parametrize(
    "place, radius",
    [((0.01357, 0.01017), 0.00347), ((-0.07545, 0.01968), 0.00439), ((0.06291, 0.06702), 0.00772)],
    ids=["withheld", "three discs, 3.7 mm off", "cells, 3.5 mm off"],
)
def test_what_flows_between_a_bare_conductor_and_an_electrode_beside_it_is_not_believed(
    place, radius
):
    """What became of them while the row of that electrode was; readings by the reference model."""
    solved = ReferenceSheet(LAYOUT).solve([(disc(*place, radius), 1e4)])
    frame = reference_frame(solved, DRIVE) + np.random.default_rng(0).normal(0, 1e-3, (64, 64))
    pipeline = Pipeline(LAYOUT, Settings("accurate", contact_law=None))
    (contact,) = pipeline.process(frame, LAYOUT.grounded, DRIVE).contacts
    assert deviations_off(contact, place) < 6.0 and off(contact, place) < 2e-3


@pytest.mark.parametrize("profile", ["fast", "accurate"])
@pytest.mark.parametrize("drift", [0.0, 0.02])  # V from row to row
def test_a_wire_that_is_loose_is_named_whatever_it_reads(profile, drift):
    """What a wire reads that hangs in the air says nothing; with its row left out and its readings used, frames were
    withheld as those of a torn sheet."""
    simulator, pipeline = scene_on("equal-4x4", "default", profile)
    scene, random = simulator.scene, np.random.default_rng(4)
    for number in range(2):
        frame = simulator.measure(1.0 + 0.256 * number, number)
        voltages, row = frame.voltages.copy(), frame.grounded.tolist().index(5)
        voltages[row] = scene.drive_voltage + random.normal(0, 1e-3, 16)
        air = random.normal(0, 1.2, 16) if not drift else np.cumsum(random.normal(0, drift, 16))
        voltages[:, 5] = np.clip(1.2 + air, 0.0, scene.drive_voltage)
        result = pipeline.process(replace(frame, voltages=voltages))
        assert result.state == "valid" and result.faults == {5: screening.OPEN}
        assert told_rightly(result, scene.truth(frame.stamp + result.holds), 1e-3)
