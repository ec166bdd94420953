"""Frames of finite elements in, contacts by the closed form out; broken channels and bad input on
the way."""

import warnings

import numpy as np
import pytest
from contacts_support import DRIVE, disc, off, pipeline_of, sensor, told_rightly
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tomotactile_ros.estimation.ground import rows_are_alike
from tomotactile_ros.estimation.touch import STRETCH
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.frame_checks import rows_of
from tomotactile_ros.reconstruction.pipeline import CONTRADICTS
from tomotactile_ros.reconstruction.settings import UNKNOWN
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects, SheetVariation
from tomotactile_ros.support.errors import Doubt, InputError

WEAK = ContactLaw(1e-6, 1.0)
TRUE = [(0.034, 0.051, 20e3), (-0.045, -0.022, 30e3)]
TRUTH = [{"x": x, "y": y, "force": p * np.pi * 0.005**2} for x, y, p in TRUE]
PROFILES = ("fast", "accurate")
SWAPPED = np.r_[:18, 19, 18, 20:64]  # wires 18 and 19


@pytest.fixture(scope="module")
def layout():
    return load_layout("equal-8x8")


def two_on(layout):
    """A frame of the two contacts of TRUE, V."""
    contacts = [disc(x, y, 0.005, pressure=p) for x, y, p in TRUE]
    return sensor(layout, *contacts, seed=0, h=0.0035).frame(0.0)


@pytest.fixture(scope="module")
def frame(layout):
    return two_on(layout)


@pytest.fixture(scope="module")
def pipelines(layout):
    first = Pipeline(layout, Settings("fast"))
    return {p: first.with_settings(Settings(p)) for p in (*PROFILES, "balanced")}


@pytest.fixture(scope="module")
def small():
    """`fast` on a 4 x 4 layout; tests start one of their own from it."""
    return Pipeline(load_layout("equal-4x4"), Settings("fast"))


GROUNDED = np.arange(64)


@pytest.mark.parametrize(
    "profile, distance, force",
    [("fast", 0.0055, 0.4), ("accurate", 0.001, 0.12)],
)
def test_two_contacts_are_found_with_position_and_force(pipelines, frame, profile, distance, force):
    """And the image shows them: what is at plus x, plus y in the upper right."""
    pipeline = pipelines[profile]
    result = pipeline.process(frame, GROUNDED, DRIVE)
    assert told_rightly(result, TRUTH, distance, force)
    assert not result.idle and result.excluded == ()
    image = result.pressure
    total = sum(contact.force for contact in result.contacts)
    assert total == pytest.approx(pipeline.grid.gather(image).sum() * pipeline.grid.cell_area)
    for contact in result.contacts:
        assert contact.force == pytest.approx(contact.pressure * contact.area, rel=0.02)
        assert contact.area == pytest.approx(np.pi * contact.radius**2, rel=0.02)
    upper_right = np.unravel_index(np.argmax(image[:20, 20:]), (20, 20))
    assert image[:20, 20:].max() > 5 * image[:20, :20].max()
    expected = (0.1 - 0.051) / 0.005 - 0.5, (0.034 + 0.1) / 0.005 - 0.5 - 20
    assert np.hypot(upper_right[0] - expected[0], upper_right[1] - expected[1]) < 1.5
    if profile == "accurate":  # `balanced` differs in what is wide alone
        assert pipelines["balanced"].process(frame, GROUNDED, DRIVE).contacts == result.contacts


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_dead_stuck_and_wrong_channels_are_left_out_and_reported(pipelines, frame, profile):
    readings = frame.copy()
    readings[:, 20] = np.nan
    readings[:, 43] = 1.25
    readings[:, 9] = np.random.default_rng(0).uniform(0, DRIVE, 64)
    readings[:, 54] *= 0.8
    pipeline = pipelines[profile].with_settings(Settings(profile, excluded=(60,)))
    result = pipeline.process(readings, GROUNDED, DRIVE)
    why = {
        9: CONTRADICTS,
        20: "no readings",
        43: "its reading never changes",
        60: "excluded by the settings",
    }
    assert result.faults == why and result.excluded == tuple(why)  # a gain that is off is estimated
    assert told_rightly(result, TRUTH, 0.001)


@pytest.fixture(scope="module")
def small_frame(small):
    return two_on(small.layout)


@pytest.mark.parametrize(
    "profile, pair",
    [
        *[("fast", pair) for pair in [(0, 15), (5, 6), (1, 11), (1, 2)]],
        ("balanced", (0, 15)),  # far apart
        ("balanced", (1, 2)),  # side by side at the rim
    ],
)
def test_swapped_wires_are_left_out_and_reported(small, small_frame, profile, pair):
    order = np.arange(16)
    order[list(pair)] = pair[::-1]
    swapped = small_frame[np.ix_(order, order)]
    result = small.with_settings(Settings(profile)).process(swapped, GROUNDED[:16], DRIVE)
    assert result.excluded == pair
    assert told_rightly(result, TRUTH, 0.0055)


def test_swapped_wires_are_known_from_one_touch_to_the_next(layout, frame):
    """Looked for among contacts with all channels, each frame took seconds, and 3 of 60 ended with
    what leaves 37 to 56 standard deviations squared a reading over."""
    touched = frame[np.ix_(SWAPPED, SWAPPED)]
    pipeline = pipeline_of(layout)
    for readings in (touched, np.where(np.isnan(frame), np.nan, 0.0), touched):
        result = pipeline.process(readings, GROUNDED, DRIVE)
        if not result.idle:
            assert result.faults == {18: CONTRADICTS, 19: CONTRADICTS} and result.misfit < 2


def test_no_contact_is_taken_for_swapped_wires(small):
    """One after the other, a second each."""
    sizes = [(0.001, 1e7), (0.005, 1e6), (0.03, 1e5), (0.08, 1e4)]
    discs = [
        disc(*at, min(radius, 0.1 - max(at)), pressure=p, start=2 * i + k, end=2 * i + k + 1)
        for i, (radius, p) in enumerate(sizes)
        for k, at in enumerate(((0.0, 0.0), (-0.085, 0.085)))
    ]
    uneven = Defects(sheet_variation=SheetVariation(0.2, 0.05, 1))
    how = {"seed": 0, "adc": None, "defects": uneven, "h": 0.005, "row_period": 0.0}
    simulator = sensor(small.layout, *discs, **how)
    for number in range(len(discs)):
        pipeline = small.with_settings(small.settings)
        result = pipeline.process(simulator.frame(number + 0.5, number), GROUNDED[:16], DRIVE)
        assert result.contacts and result.excluded == ()


def test_lost_readings_change_little(pipelines, frame):
    readings = frame.copy()
    readings[np.random.default_rng(1).random(frame.shape) < 0.1] = np.nan
    result = pipelines["balanced"].process(readings, GROUNDED, DRIVE)
    assert result.excluded == ()
    assert told_rightly(result, TRUTH, 0.001)


def test_tare_takes_an_offset_off(small, small_frame):
    random, grounded = np.random.default_rng(5), GROUNDED[:16]
    offset = 0.02 * random.standard_normal((16, 16))
    pipeline = small.with_settings(Settings("balanced"))
    noise = 1e-3 * random.standard_normal((20, 16, 16))
    pipeline.tare([(offset + n, grounded) for n in noise[:16]])
    assert pipeline.process(offset + noise[17], grounded, DRIVE).idle
    result = pipeline.process(small_frame + offset, grounded, DRIVE)
    assert result.excluded == ()
    assert told_rightly(result, TRUTH, 0.001)
    kept = pipeline.with_settings(Settings("fast"))
    assert kept.process(offset + noise[18], grounded, DRIVE).idle
    kept.untare()
    assert not kept.process(offset + noise[18], grounded, DRIVE).idle
    with pytest.raises(InputError, match="at least one frame"):
        pipeline.tare([])


def test_idle_frames_give_a_zero_image_and_no_contact(pipelines):
    random = np.random.default_rng(0)
    step = DRIVE / 4096
    for _ in range(100):
        noise = np.clip(np.round(1e-3 * random.standard_normal((64, 64)) / step), 0, None) * step
        result = pipelines["accurate"].process(noise, GROUNDED, DRIVE)
        assert result.idle
        assert result.contacts == []
        assert not result.pressure.any()


def test_electrodes_on_one_line_are_refused_where_the_sheet_is_on_both_sides_of_it():
    outline = Outline.rectangle(0.2, 0.2)
    line = np.column_stack([np.linspace(-0.08, 0.08, 6), np.full(6, 0.01)])
    amid = Layout("line", outline, 1e4, 0.004, line)
    with pytest.raises(InputError, match="all electrodes of line lie on one line: on which side"):
        Pipeline(amid, Settings())
    Pipeline(Layout("rim", outline, 1e4, 0.004, line - [0, 0.105]), Settings())
    bent = line + [0.0, 0.02] * np.array([[0]] * 5 + [[1]])
    Pipeline(Layout("bent", outline, 1e4, 0.004, bent), Settings())


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda v, g: (v[:, :60], g), r"voltages: .*\(rows, 64\)"),
        (lambda v, g: (v[0], g), "voltages"),
        (lambda v, g: (v, g[:10]), "grounded: .* each of the 64 rows"),
        (lambda v, g: (v, g + 5), "grounded: .* 0 to 63"),
        (lambda v, g: (v, g.astype(float)), "grounded"),
        (lambda v, g: (v.astype(str), g), "voltages"),
        (lambda v, g: (v, np.where(g == 3, 4, g)), "electrode 4 is named twice"),
        *((lambda v, g, d=d: (v, g, d), "drive_voltage") for d in (0.0, -1.0, np.nan, np.inf, "3")),
    ],
)
def test_frames_that_do_not_fit_are_refused(pipelines, frame, change, message):
    with pytest.raises(InputError, match=message) as error:
        pipelines["fast"].process(*[*change(frame, GROUNDED), DRIVE][:3])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "bad, key",
    [
        ({"profile": "quick"}, "profile"),
        ({"noise": 0}, "noise"),
        ({"regularization": -1}, "regularization"),
        ({"model": "bem"}, "model"),
        ({"excluded": (-1,)}, "excluded"),
        ({"contact_radius": 0}, "contact_radius"),
        ({"unknown": ("gain",)}, "unknown: 'gain' is none of auto, gains, offsets,"),
        ({"unknown": ("auto", "gains")}, "unknown: auto is all"),
        ({"image": "none", "contacts": False}, "nothing to do"),
        ({"image": "contacts", "contacts": False}, "draws the contacts"),
        ({"image": "wide"}, "is none of none, paper, contacts"),
        ({"deadline": 0.0}, "deadline"),
        ({"deadline": np.nan}, "deadline"),
    ],
)
def test_settings_are_checked(bad, key):
    with pytest.raises(InputError, match=key):
        Settings(**bad)


def without(layout, *known):
    """`accurate`, which finds all but what is `known`."""
    return Pipeline(layout, Settings("accurate", unknown=tuple(set(UNKNOWN) - set(known))))


@pytest.mark.parametrize(
    "name, known, channels",
    [
        ("equal-4x4", "gains", Channels(gain=Rms(0.04, 3))),
        ("equal-4x4", "offsets", Channels(offset=Rms(0.01, 3))),
        ("equal-8x8", "resistances", Channels(ground_resistance=Uniform(300.0, 150.0, 3))),
    ],
)
def test_what_is_said_to_be_known_is_believed(name, known, channels):
    layout = load_layout(name)
    grounded = GROUNDED[: layout.electrodes]
    contact, defects = disc(*TRUE[0][:2], 0.005, pressure=20e3), Defects(channels=channels)
    voltages = sensor(layout, contact, seed=0, adc=None, defects=defects).frame(0.0)
    found, believed = (
        pipeline.process(voltages, grounded, DRIVE)
        for pipeline in (without(layout), without(layout, known))
    )
    assert found.misfit < 1.2 and len(found.contacts) == 1
    assert off(found.contacts[0], contact.center) < 5e-4
    left = [each.misfit * each.noise**2 for each in (found, believed)]
    assert not believed.contacts or left[1] > 2 * left[0]


def test_contacts_that_do_not_move_are_those_of_rows_read_at_once(layout, frame):
    timed = without(layout, "motion").process(frame, GROUNDED, DRIVE, row_period=1e-3)
    at_once = without(layout).process(frame, GROUNDED, DRIVE)
    places = [[(c.x, c.y, c.force) for c in each.contacts] for each in (timed, at_once)]
    assert len(places[0]) == 2
    np.testing.assert_allclose(*places, rtol=1e-9)


def test_contacts_that_are_discs_have_no_shape(layout):
    bar = Contact("rectangle", center=(0.0, 0.0), size=(0.06, 0.008), angle=60.0, pressure=20e3)
    voltages = sensor(layout, bar, seed=0, adc=None).frame(0.0)
    fitted, misfits = [], []
    for pipeline in (without(layout), without(layout, "shape")):
        result = pipeline.process(voltages, GROUNDED, DRIVE)
        assert len(result.contacts) == 1
        misfits.append(result.misfit)
        fitted.append(pipeline._state.fit.unknowns.contacts[:, STRETCH:])
    assert len(fitted[0]) == 1 and np.hypot(*fitted[0].T) > 0.5 and misfits[0] < 1.2
    assert len(fitted[1]) == 3 and not fitted[1].any()  # discs that touch are reported as one


SMALL = equal_grid(3, 3, (0.1, 0.1), 0.002, 1e4)  # on which a search takes little time
SMALL_PIPELINES = [
    Pipeline(SMALL, Settings(profile, resolution=12, regularization=regularization))
    for profile, regularization in [("fast", 0.0), ("balanced", 1e30), ("accurate", None)]
]


def all_finite(result):
    if result.state != "valid":
        return bool(result.reason) and not result.contacts and np.isnan(result.pressure).all()
    numbers = [[c.x, c.y, c.force, c.pressure, c.area, c.radius] for c in result.contacts]
    return all(np.isfinite(part).all() for part in (result.potential, result.pressure, numbers))


@settings(max_examples=8, deadline=None)
@given(
    hnp.arrays(
        np.float32,
        st.tuples(st.integers(0, 9), st.just(9)),
        elements=st.one_of(
            st.floats(width=32),
            # hypothesis of Ubuntu 24.04 wants them as float32 has them
            st.sampled_from(np.float32([0.0, 3.3, -3.3, 1e-3, np.nan, 1.65]).tolist()),
        ),
    ),
    st.randoms(use_true_random=False),
    st.sampled_from([0.005, 3.3, 1000.0]),
)
def test_whatever_comes_in_nothing_infinite_goes_out(voltages, random, drive):
    grounded = np.array(random.sample(range(9), len(voltages)), int)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings(
            "ignore", "row_period: 0 says", Doubt
        )  # some do contradict each other
        for pipeline in SMALL_PIPELINES:
            assert all_finite(pipeline.process(voltages, grounded, drive))


UNSEEN = "do not depend on which electrode is grounded"


def disturbed():
    """(name, readings of a 4 x 4 sensor, V, why they are withheld) of frames in which no electrode is grounded,
    and of an untouched sheet where all readings of a row have something in common."""
    random, row = np.random.default_rng(3), np.arange(16)[:, None]
    noise = 1e-3 * random.standard_normal((16, 16))
    for level in (0.02, 0.1, 0.3, 0.5, 0.8, 0.95, 1.0):
        yield f"all {level}", np.full((16, 16), level * DRIVE), UNSEEN
        yield f"all {level}, with noise", level * DRIVE + noise, UNSEEN
    yield "a level for each channel", random.uniform(0.0, DRIVE, 16) + noise, UNSEEN
    yield "hum of 1 V", np.sin(0.5 * row) + noise, ""
    yield "hum of 20 mV", 0.02 * np.sin(0.7 * row) + noise, ""
    yield "drift by 20 mV", 0.02 * row / 16 + noise, ""


@pytest.mark.parametrize("profile", PROFILES)
def test_what_all_readings_or_those_of_a_row_have_in_common_is_no_contact(small, profile):
    """A converter at its limit was a contact of 62 N, one that stood still one of up to 250 N, hum one of 0.15 N,
    a drift one of 0.002 N."""
    for name, voltages, why in disturbed():
        pipeline = small.with_settings(Settings(profile))
        result = pipeline.process(voltages, GROUNDED[:16], DRIVE)
        assert result.state == "withheld" and not result.contacts, name
        assert result.reason and why in result.reason, name


def test_rows_of_such_frames_are_withheld(small):
    """Rows of a converter that stood still were contacts of 0.2 to 130 N, from the first row on."""
    pipeline, random = small.with_settings(small.settings), np.random.default_rng(7)
    for name, voltages, _ in disturbed():
        if "drift" in name:
            continue
        rows, said = pipeline.rows(), []
        frames = [*(1e-3 * random.standard_normal((2, 16, 16))), voltages, voltages]
        for i, row in enumerate(np.concatenate(frames)):
            result = pipeline.process_row(row, i % 16, DRIVE, 1e-3 * i, rows)
            said.append((result.state, len(result.contacts)))
        assert said[31] == ("valid", 0)
        assert set(said[32 if name.startswith("all") else 47 :]) == {("withheld", 0)}, name


@pytest.mark.parametrize("profile", PROFILES)
def test_rows_that_are_not_read_now_and_then_do_not_hide_a_touch(pipelines, frame, profile):
    """The last row read 0 V: nothing touched, valid. A touch that ends is no such thing."""
    for seed in range(3):
        unread = np.random.default_rng(seed).permutation(63)[:13]
        rows = frame.copy()
        rows[[*unread, 63]] = 0.0
        result = pipelines[profile].process(rows, GROUNDED, DRIVE)
        assert result.state == "withheld" and "touched and untouched in turn" in result.reason
    rows = frame.copy()
    rows[40:] = 0.0
    result = pipelines[profile].process(rows, GROUNDED, DRIVE, 1e-3)
    assert result.state == "valid" and not result.contacts


@pytest.mark.parametrize(
    "profile, level, dead",
    [("fast", 0.0, 48), ("balanced", 1.0, 33), ("accurate", DRIVE, 60), ("accurate", 0.0, 33)],
)
def test_a_touch_that_few_channels_see_is_no_untouched_sheet(
    pipelines, frame, profile, level, dead
):
    """Three of four multiplexers without supply: `fast` said that nothing touches; at the drive
    voltage there were contacts 20 mm off."""
    rows = frame.copy()
    rows[:, np.random.default_rng(dead).permutation(64)[:dead]] = level
    result = pipelines[profile].process(rows, GROUNDED, DRIVE)
    assert result.state == "withheld" and not result.contacts
    assert result.reason.startswith(f"{dead} of 64 channels never change while others do")


@pytest.mark.parametrize(
    "profile, offset", [("fast", 0.02), ("balanced", 0.03), ("accurate", 0.03)]
)
def test_a_contact_that_may_be_anywhere_is_withheld(small, profile, offset):
    """An offset of all channels was a touch of 1 mN in a corner, give or take half a metre."""
    voltages = sensor(small.layout, seed=0).frame(0.0) + offset
    pipeline = small.with_settings(Settings(profile))
    result = pipeline.process(voltages, GROUNDED[:16], DRIVE)
    assert result.state == "withheld" and not result.contacts
    assert "too small to say where" in result.reason or "disturbs all readings" in result.reason


def test_rows_go_on_when_a_channel_is_left_out(small):
    """What is read changes its length then, which ended the node."""
    layout, pipeline = small.layout, small.with_settings(small.settings)
    made = sensor(layout, disc(0.02, 0.01, pressure=2e4), seed=0, adc=None)
    whole = rows_of(layout, made.frame(0.0), GROUNDED[:16])
    rows, broken = pipeline.rows(), whole.copy()
    broken[:, 5] = np.nan
    frames, used = [np.zeros((7, 16)), whole, *[broken] * 2, *[whole] * 3, *[broken] * 3], set()
    for i, row in enumerate(np.concatenate(frames), start=9):
        result = pipeline.process_row(row, i % 16, DRIVE, 1e-3 * i, rows)
        used.add(len(rows.used))
        assert i < 18 or result.state == "withheld" or len(result.contacts) == 1
    assert 5 not in rows.used and 16 in used
    assert result.state == "valid"


def test_a_disturbance_of_whole_rows_does_not_move_a_contact_unseen(small):
    """Hum of 0.2 V put a contact 40 to 70 mm beside its place, and it was valid."""
    pressed, how = disc(0.02, 0.03, 0.008, pressure=2e4), {"noise": 0.0, "adc": None, "law": WEAK}
    readings = sensor(small.layout, pressed, model="closed_form", **how).frame(0.0)
    readings += 1e-3 * np.random.default_rng(2).standard_normal((16, 16))
    hum = 0.2 * np.sin(0.7 * np.arange(16) + 4.0)
    quiet, humming = (
        small.with_settings(Settings("balanced")).process(each, GROUNDED[:16], DRIVE)
        for each in (readings, readings + hum[:, None])
    )
    (found,) = quiet.contacts
    assert off(found, pressed.center) < 2e-3
    assert humming.state == "withheld" and not humming.contacts


@pytest.mark.parametrize("name", ["equal-8x8", "ring-16", "hex-37"])
def test_contacts_show_what_is_grounded_also_when_they_begin_within_a_frame(name):
    """The nearest electrodes to the grounded one are lowered under any contact, weak or strong."""
    layout = load_layout(name)
    count = layout.electrodes
    random = np.random.default_rng(4)
    noise = 1e-3 * random.standard_normal((count, count))
    for pressure in (1e3, 1e5):
        for place in layout.positions[:: count // 4]:
            press = disc(*(0.9 * place), pressure=pressure)
            made = sensor(layout, press, noise=0.0, adc=None, law=WEAK, h=0.01)
            rows = rows_of(layout, made.frame(0.0), GROUNDED[:count])
            rows[GROUNDED[:count], GROUNDED[:count]] = np.nan
            for begun in (0, count // 2, count - 3):
                seen = np.where(np.arange(count)[:, None] < begun, 0.0 * rows, rows) + noise
                places = layout.positions
                assert not rows_are_alike(seen, places[GROUNDED[:count]], places, 1e-3)
