"""Several faults of a sensor at once."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.estimation import screening
from tomotactile_ros.estimation.screening import clipped
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.course import Tap
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator
from tomotactile_ros.view.contact_lines import contact_lines

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


@pytest.mark.parametrize("profile, law", [("fast", None), ("accurate", ContactLaw(0.1, 1.0))])
def test_an_electrode_under_a_conductor_is_not_named(profile, law):
    """It reads the drive voltage in all rows, as the experiment of the paper has it."""
    eight = load_layout("equal-8x8")
    place = eight.positions[36]
    contact = Contact("disc", center=place.tolist(), radius=0.005, pressure=20000.0)
    noise, adc = Noise(0.001, 1), Adc(12, 3.3)
    scene = Scene("covered", 3.3, (contact,), law, noise, adc)
    frame = Simulator(eight, scene).measure(0.0)
    result = Pipeline(eight, Settings(profile, contact_law=law)).process(frame)
    (found,) = result.contacts
    assert np.hypot(found.x - place[0], found.y - place[1]) < 1e-3
    assert result.faults == {} and result.excluded == ()
    if law is not None:  # as good as bare: what it conducts is not told by readings
        assert found.force_std == np.inf and found.force < scene.truth(0.0)[0]["force"]
        assert "at least" in repr(found) and "at least" in contact_lines([found])[0]


@pytest.mark.parametrize(
    "profile, discs",
    [
        # the first was not reported: how well it conducts no reading told
        ("accurate", [(85.7, -28.6, 6.8), (14.7, -14.4, 9.5)]),
        ("balanced", [(27.5, 14.8, 5.0), (-85.7, 0.0, 7.3)]),
        # 7 and 42 were named
        ("balanced", [(98.6, -98.7, 10.5), (-42.1, 31.4, 10.3), (19.8, 76.0, 4.4)]),
    ],
)
def test_bare_conductors_on_electrodes_are_found_and_no_electrode_is_named(profile, discs):
    contacts = tuple(
        Contact("disc", center=(x / 1e3, y / 1e3), radius=radius / 1e3) for x, y, radius in discs
    )
    scene = Scene("bare", 3.3, contacts, ContactLaw(1e-4, 1.0), Noise(0.001, 1), Adc(12, 3.3))
    result = Pipeline(LAYOUT, Settings(profile)).process(Simulator(LAYOUT, scene).measure(0.0))
    assert result.faults == {} and len(result.contacts) == len(discs)
    for x, y, radius in discs:  # the corner is seen worst
        apart = [np.hypot(c.x - x / 1e3, c.y - y / 1e3) for c in result.contacts]
        assert min(apart) < radius / 1e3


def test_a_plate_over_two_electrodes_breaks_none_of_them():
    plate = Contact("rectangle", center=(0.0714, 0.0857), size=(0.0406, 0.012), angle=90.0)
    scene = Scene("plate", 3.3, (plate,), ContactLaw(1e-4, 1.0), Noise(0.001, 1), Adc(12, 3.3))
    result = Pipeline(LAYOUT, Settings("accurate")).process(Simulator(LAYOUT, scene).measure(0.0))
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
    eight = load_layout("equal-8x8")
    contact = Contact("disc", center=eight.positions[36].tolist(), radius=0.005, pressure=20000.0)
    scene = Scene("stuck", 3.3, (contact,), ContactLaw(1e-4, 1.0), Noise(0.001, 1), Adc(12, 3.3))
    frame = Simulator(eight, scene).measure(0.0)
    frame.voltages[:, stuck] = 1.0 if stuck == 36 else 3.3
    result = Pipeline(eight, Settings(profile)).process(frame)
    assert (
        len(result.contacts) == 1 and list(result.faults) == [stuck] and result.excluded == (stuck,)
    )


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
    four = load_layout("equal-4x4")
    period = 16 * ROW_PERIOD
    contact = Contact(
        "disc",
        center=[1e-3 * value for value in place],
        radius=1e-3 * radius,
        force=force,
        profile="hertz",
        start=begun * period,
        course=Tap(lasts, 10.0) if lasts else None,
    )
    scene = Scene("tap", 3.3, (contact,), LAW, Noise(0.001, 6), Adc(12, 3.3))
    simulator, pipeline = Simulator(four, scene), Pipeline(four, Settings(profile))
    for number in range(6):
        result = pipeline.process(simulator.measure(number * period, number))
        assert result.faults == {} and result.excluded == ()
        touched = (number + 1 - begun) * 16  # rows
        assert not result.reason or 0 < touched < 3
        if touched > 3:
            (found,) = result.contacts
            apart = 1e3 * np.hypot(found.x - contact.center[0], found.y - contact.center[1])
            assert apart < 10


@pytest.mark.parametrize(
    "layout, contacts, seed",
    [
        (  # 0 and 9 seemed to be exchanged: the first row was untouched
            "optimized-4x4",
            [("disc", (-83.53, -25.97), {"radius": 0.01664}, 3.488, 2.00186, 5.814)],
            71,
        ),
        (  # 14 and 15 contradicted all others: one of two had ended before they were grounded
            "touch-4x4",
            [
                ("disc", (57.68, 85.93), {"radius": 0.00811}, 3.284, 2.8549, np.inf),
                (
                    "rectangle",
                    (-58.03, -78.97),
                    {"size": (0.01628, 0.00814), "angle": 123.1},
                    2.635,
                    2.393,
                    4.815,
                ),
            ],
            2,
        ),
    ],
)
def test_what_begins_or_ends_within_a_frame_is_no_fault(layout, contacts, seed):
    layout, period = load_layout(layout), 16 * ROW_PERIOD
    presses = [
        Contact(
            shape,
            center=[1e-3 * value for value in place],
            force=force,
            start=begins * period,
            end=ends * period,
            **form,
        )
        for shape, place, form, force, begins, ends in contacts
    ]
    scene = Scene("taps", DRIVE, presses, LAW, Noise(1e-3, seed), Adc(12, DRIVE))
    simulator, pipeline = Simulator(layout, scene), Pipeline(layout, Settings("accurate"))
    for number in range(7):
        result = pipeline.process(simulator.measure(number * period, number))
        assert result.faults == {} and result.excluded == (), number


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_an_electrode_under_a_conductor_is_not_left_out(profile):
    """Of two bare contacts 32 mm apart, one upon an electrode and one at the rim of another, one was
    reported, between them: what both electrodes read was taken for that of broken channels."""
    discs = [
        Contact("disc", center=(x, 0.01429), radius=0.005, pressure=20000.0)
        for x in (0.01429, -0.01771)
    ]
    scene = Scene("bare", DRIVE, discs, noise=Noise(1e-3), adc=Adc(12, DRIVE))
    simulator = Simulator(LAYOUT, scene)
    pipeline = Pipeline(LAYOUT, Settings(profile, contact_law=None))
    for number in range(2):
        result = pipeline.process(simulator.measure(0.064 * number, number))
        assert not result.reason and result.faults == {} and result.excluded == ()
        found = sorted((c.x, c.y) for c in result.contacts)
        assert np.allclose(found, sorted(tuple(each.center) for each in discs), atol=1e-3)


def test_rows_follow_a_conductor_on_an_electrode():
    """Its row, in which all is at the drive voltage, kept frames from being whole, and readings that are as high as
    the drive were taken for the end of the converter's range."""
    discs = [
        Contact("disc", center=(x, 0.01429), radius=0.005, pressure=20000.0)
        for x in (0.01429, -0.01771)
    ]
    scene = Scene("bare", DRIVE, discs, noise=Noise(1e-3), adc=Adc(12, DRIVE))
    simulator, pipeline = Simulator(LAYOUT, scene), Pipeline(LAYOUT, Settings(contact_law=None))
    state = pipeline.rows()
    for number in range(3):
        frame = simulator.measure(0.064 * number, number)
        for i, (row, at) in enumerate(zip(frame.voltages, frame.grounded)):
            time = frame.stamp + i * frame.row_period
            result = pipeline.process_row(row, int(at), DRIVE, time, state)
            assert number == 0 or (not result.reason and result.faults == {}), (number, at)
    found = sorted((c.x, c.y) for c in result.contacts)
    assert np.allclose(found, sorted(tuple(each.center) for each in discs), atol=2e-3)


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
    layout = load_layout("equal-8x8")
    scene = Scene(
        "bare",
        DRIVE,
        (Contact("disc", place, radius=radius),),
        noise=Noise(1e-3),
        adc=Adc(12, DRIVE),
    )
    pipeline = Pipeline(layout, Settings("accurate"))
    (contact,) = pipeline.process(Simulator(layout, scene).measure(0.0)).contacts
    way = np.array([contact.x, contact.y]) - place
    spread = np.reshape(contact.position_covariance, (2, 2))
    assert way @ np.linalg.solve(spread, way) < 6.0


@pytest.mark.parametrize("profile", ["fast", "accurate"])
@pytest.mark.parametrize("drift", [0.0, 0.02])  # V from row to row
def test_a_wire_that_is_loose_is_named_whatever_it_reads(profile, drift):
    """What a wire reads that hangs in the air says nothing; with its row left out and its readings used, frames were
    withheld as those of a torn sheet."""
    layout, scene = load_layout("equal-4x4"), load_scene("default")
    simulator, random = Simulator(layout, scene), np.random.default_rng(4)
    pipeline = Pipeline(layout, Settings(profile, contact_law=scene.contact_law))
    for number in range(3):
        frame = simulator.measure(1.0 + 0.256 * number, number)
        voltages, row = frame.voltages.copy(), frame.grounded.tolist().index(5)
        voltages[row] = scene.drive_voltage + random.normal(0, 1e-3, 16)
        air = random.normal(0, 1.2, 16) if not drift else np.cumsum(random.normal(0, drift, 16))
        voltages[:, 5] = np.clip(1.2 + air, 0.0, scene.drive_voltage)
        result = pipeline.process(replace(frame, voltages=voltages))
        assert result.state == "valid" and result.faults == {5: screening.OPEN}
        score = score_frame(result.contacts, scene.truth(frame.stamp + result.holds))
        assert score.ghosts == score.missed == 0 and max(score.place) < 1e-3
