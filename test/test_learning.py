"""A sensor learned from touches of unknown place and force: against the truth and against its own
covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.estimation.disc import unit_patches
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.information import information
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.pressure_modes import pressure_modes
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.reciprocity import fit_gains
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.estimation.touch import conductance
from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.learning import findings, recorded
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.learner import Learner
from tomotactile_ros.learning.ledger import Ledger
from tomotactile_ros.learning.readings import is_untouched, offsets, rows_of
from tomotactile_ros.learning.recorded import WIDE, learn
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

DRIVE, NOISE = 3.3, 1e-3
LAW = ContactLaw(1e-4, 1.0)
WRONG = Channels(gain=Rms(0.05, 1), offset=Rms(0.003, 2), ground_resistance=Uniform(150, 100, 3))


@cache
def layout():
    return equal_grid(4, 4, (0.12, 0.12), 0.003, 1e4)


@cache
def operator():
    return SheetOperator(layout())


@cache
def simulator(touches=8, channels=WRONG, aside=0.0):
    """A second of each touch, the first half of it untouched; electrodes lie `aside` m, rms."""
    random = np.random.default_rng(5)
    contacts = [
        Contact(
            "disc", center=0.09 * (random.random(2) - 0.5), radius=random.uniform(0.004, 0.008),
            pressure=random.uniform(1e4, 3e4), start=i + 0.5, end=i + 1.0,
        )
        for i in range(touches)
    ]  # fmt: skip
    scene = Scene(
        "touches", DRIVE, contacts, LAW, Noise(NOISE), Adc(12, 4.0), Defects(channels=channels)
    )
    return Simulator(displaced(aside), scene, row_period=0.0)


def displaced(aside):
    """The layout with its outer electrodes a rim further in, as all are that lie elsewhere by
    `aside` m, rms."""
    if not aside:
        return layout()
    return replace(inner(), positions=inner().positions + aside * places())


def inner():
    return replace(layout(), positions=0.9 * layout().positions)


def places():
    return np.random.default_rng(9).standard_normal((16, 2))


@cache
def frames(aside=0.0):
    sensor = simulator(aside=aside)
    return np.array([sensor.frame(t, i) for i, t in enumerate(np.arange(0.25, 8.0, 0.5))])


@cache
def learned():
    return learn(layout(), frames(), np.arange(16), DRIVE, noise=NOISE)


def truth():
    return WRONG.of(16)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def learner(state=None):
    like = Prior.unknown(operator(), WIDE, 0.005, DRIVE)
    return Learner(Search(operator()), like, DRIVE, state or SensorState.unknown(operator(), WIDE))


# -- reciprocity --------------------------------------------------------------------------------


def reciprocal_frames(count=6, electrodes=12, seed=0):
    """Frames of any symmetric impedances, with gains of 5 %."""
    random = np.random.default_rng(seed)
    gain = 1 + 0.05 * random.standard_normal(electrodes)
    found = []
    for _ in range(count):
        root = random.random((electrodes, 3))
        impedance = 2 * np.eye(electrodes) + root @ root.T
        share = impedance / (impedance.diagonal() + random.random(electrodes))[:, None]
        volts = DRIVE * gain * (1 - share) + NOISE * random.standard_normal(share.shape)
        np.fill_diagonal(volts, np.nan)
        found.append(volts)
    return np.array(found), gain


def test_reciprocity_gives_gains_as_well_as_it_says():
    ratios, misfits = [], []
    for seed in range(20):
        volts, gain = reciprocal_frames(seed=seed)
        one = np.ones(12)
        found = fit_gains(volts, DRIVE, NOISE, (one, 0.05 * one), (0 * one, 1e-6 * one))
        error = (found.gain - gain) / np.sqrt(found.covariance.diagonal()[:12])
        ratios.append(rms(error))
        misfits += found.misfit.tolist()
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.1)
    assert rms(ratios) == pytest.approx(1.0, abs=0.25)  # neither biased nor sure of too much


# -- untouched frames ---------------------------------------------------------------------------


def test_untouched_frames_are_told_from_touched_ones():
    found = [is_untouched(frame, np.arange(16), NOISE) for frame in frames()]
    assert found == [True, False] * 8


def test_offsets_below_the_range_are_bounded_not_guessed():
    random = np.random.default_rng(1)
    true = np.array([0.004, 0.0005, -0.0005, -0.01])
    volts = np.maximum(true + NOISE * random.standard_normal((3, 4, 4)), 0.0)
    mean, deviation = np.zeros(4), np.full(4, 0.005)
    found = offsets(volts, np.arange(4), NOISE, mean, deviation)
    information = found.information + deviation**-2.0
    centre, spread = found.pull / information, information**-0.5
    assert np.abs(centre[:3] - true[:3]).max() < 4 * 4e-4
    assert spread[:3].max() < 6e-4 and spread[3] > 1e-3
    assert centre[3] < -2e-3 and found.ended.tolist() == [False, False, False, True]


# -- one frame ----------------------------------------------------------------------------------


def test_information_is_that_of_all_derivatives_with_contacts_eliminated():
    """And with what electrodes as modelled err in this frame, which acts as resistances do."""
    own = learner()
    rows = rows_of(operator(), frames()[1], np.arange(16), DRIVE, NOISE)
    fit = own.look(rows)
    found = information(fit.operator, fit.unknowns, rows, own.like, DRIVE)
    u = fit.unknowns

    def readings(unknowns):
        return Prediction(operator(), unknowns, rows.grounded).readings

    def slope(name, index, step, unit=1.0):
        sides = []
        for sign in (1, -1):
            values = np.array(getattr(u, name))
            values[index] += sign * step
            sides.append(readings(replace(u, **{name: values})))
        return ((sides[0] - sides[1]) / (2 * step) / unit).ravel()

    contacts = [slope("contacts", (0, k), s) for k, s in enumerate((1e-6, 1e-6, 1e-4, 1e-4))]
    sheet = [slope("sheet", j, 1e-4) for j in range(operator().modes)]
    gain = [slope("gain", j, 1e-4) for j in range(16)]
    offset = [slope("offset", j, 1e-4, DRIVE) for j in range(16)]
    resistance = [slope("resistance", j, 1.0) for j in range(16)]
    aside = [slope("aside", (i, j), 1e-6) for i in range(2) for j in range(16)]
    root = np.sqrt(rows.weights).ravel()
    first = np.array([*contacts, *resistance]) * root
    rest = np.array([*sheet, *gain, *offset, *resistance, *aside]) * root
    prior = np.diag([0.12**-2.0, 0.12**-2.0, 1e-2, 0.6**-2.0, *operator().inexact ** -2.0])
    mixed = first @ rest.T
    wanted = rest @ rest.T - mixed.T @ np.linalg.solve(first @ first.T + prior, mixed)
    scale = np.sqrt(wanted.diagonal())
    scale[scale < 1e-6] = 1.0  # across a rim on which an electrode lies, no field is
    assert np.abs((found.matrix - wanted) / scale / scale[:, None]).max() < 0.02


def test_a_resting_load_counts_as_one_touch_however_long_it_rests():
    sensor, own = simulator(), learner()
    deviations, fit = [], None
    for number in range(40):
        rows = rows_of(operator(), sensor.frame(0.75, number), np.arange(16), DRIVE, NOISE)
        fit = Fit(operator(), fit.unknowns, rows, fit.prior) if fit else own.look(rows)
        own.learn(fit)
        deviations.append(own.state.std("gain").mean())
    assert own.state.touches == 1 and own.state.frames == 40
    assert deviations[-1] > deviations[0] / 2.3  # not 1 / sqrt(40)
    assert deviations[-1] == pytest.approx(deviations[19], rel=0.1)


def test_a_wide_load_that_rests_bends_the_sensor_no_further_than_is_said():
    """Over an electrode: without `pressure_modes` the sheet went up to
    22 of its deviations, resistances 16."""
    load = Contact("disc", center=(0.01, -0.015), radius=0.025, pressure=1e4)
    scene = Scene("load", DRIVE, (load,), LAW, Noise(NOISE), Adc(12, 4.0))
    sensor, own = Simulator(layout(), scene, row_period=0.0), learner()
    for number in range(2):
        rows = rows_of(operator(), sensor.frame(0.5, number), np.arange(16), DRIVE, NOISE)
        own.learn(own.look(rows))
    assert own.state.touches == 1
    even = SensorState.unknown(operator(), WIDE)
    for part in ("sheet", "gain", "resistance"):
        moved = own.state[part] - even[part]
        assert (np.abs(moved) < 3.5 * own.state.std(part)).all()


def test_modes_of_pressure_are_orthonormal_and_what_they_say_of_the_readings_is_true():
    across = 24
    modes, (_, area, _) = pressure_modes(across), unit_patches(across)
    assert modes.shape[0] == 14
    assert np.abs((modes * area) @ modes.T - np.eye(14)).max() < 0.06
    on_rim = np.array([[0.021, 0.018, np.log(1e-4), np.log(0.008), 0.0, 0.0]])
    beside = np.array([[-0.04, 0.0, np.log(2e-4), np.log(0.012), 0.0, 0.0]])
    at_rest = Unknowns.at_rest(operator())
    u = at_rest.with_contacts(np.vstack([on_rim, beside]), (9, 12), np.ones((2, 6), bool))
    found = Prediction(operator(), u, np.arange(16))
    touches, step = found.touches, 1e-4
    columns = found.pressure_columns([pressure_modes(9), pressure_modes(12)])
    assert touches.direct[0].any() and not touches.direct[1].any()
    g = found.conductances[touches.owner]

    def readings(weight: np.ndarray) -> np.ndarray:
        """From H, D and the conductances of all patches, dense."""
        there = weight > 0
        own = np.diag(1 / (g * weight)[there]) + touches.impedance[np.ix_(there, there)]
        share = touches.share[:, there]
        added = share @ np.linalg.solve(own, share.T) + np.diag(found.conductances @ touches.direct)
        impedance = np.linalg.inv(operator().admittance + added)
        return 1 - impedance / impedance.diagonal()[:, None]

    assert np.allclose(readings(touches.weight), found.readings, atol=1e-12)
    for k, mode in enumerate(pressure_modes(12)):
        more = np.zeros(len(touches.weight))
        more[touches.parts[1]] = touches.weight[touches.parts[1]] * mode
        sides = [readings(touches.weight + sign * step * more) for sign in (1, -1)]
        slope = (sides[0] - sides[1]) / (2 * step)
        assert np.abs(slope - columns[14 + k]).max() < 1e-5 * np.abs(slope).max()
    # more of all pressure is more of the conductance, on the electrode as well
    ones = [np.ones((1, part.stop - part.start)) for part in touches.parts]
    strengths = np.zeros((2, 6), bool)
    strengths[:, 2] = True
    by_strength = [conductance(c, mean)[1] for c, mean in zip(u.contacts[:, 2], found.means)]
    together = found.pressure_columns(ones) * np.array(by_strength)[:, None, None]
    assert np.allclose(together, found.columns(strengths), atol=1e-12)


def test_ledger_lets_touches_fade_and_tells_them_apart():
    ledger, here = Ledger(0.03), np.array([[0.0, 0.0, -8.0, -5.0, 0.0, 0.0]])
    aside = here + [0.01, 0, 0, 0, 0, 0]
    first = ledger.weight(here, 1.0)
    assert first == pytest.approx(0.8)
    for _ in range(30):
        ledger.add(here)
    assert ledger.weight(here, 1.0) < 0.02
    assert ledger.weight(aside, 1.0) == first
    assert ledger.weight(np.vstack([here, aside]), 1.0) == first
    assert ledger.weight(here, 1.0, time=10 * 3600.0) > 0.9 * first


# -- a recording --------------------------------------------------------------------------------


def test_gains_offsets_and_resistances_from_eight_touches():
    state = learned().state
    assert (state.touches, learned().untouched, learned().unexplained) == (8, 8, 0)
    ratio = state["gain"] / truth().gain
    bound = findings.relative_gain_deviation(state)
    assert bound < 5e-4
    assert (ratio / ratio.mean()).std() < 2 * bound
    assert rms((state["offset"] - truth().offset) / state.std("offset")) < 2
    error = findings.resistance(state) - truth().ground_resistance
    known = findings.resistance_deviation(state, operator())
    assert rms(error / known) < 1.5 and (known > state.std("resistance")).all()
    uneven, spread = findings.field(state, operator())
    assert (np.abs(uneven) < np.maximum(0.05, 2 * spread)).all()


@pytest.mark.parametrize("ohms", [0.0, 40.0])
def test_resistances_are_not_negative_and_as_far_off_as_is_said(ohms):
    channels = Channels(ground_resistance=Uniform(ohms, ohms, 3))
    ideal = replace(simulator().scene, defects=Defects(channels=channels))
    sensor = Simulator(layout(), ideal, row_period=0.0)
    read = np.array([sensor.frame(t, i) for i, t in enumerate(np.arange(0.25, 4.0, 0.5))])
    state = learn(layout(), read, np.arange(16), DRIVE, noise=NOISE).state
    said, below = findings.resistance(state), state.mean.copy()
    below[state.slice("resistance")] -= (
        500.0  # what the model's electrodes err, which none has to ground
    )
    assert (said >= 0).all()
    assert (findings.resistance(state.learned(below, state.covariance)) == 0).all()
    error = said - channels.of(16).ground_resistance
    assert rms(error / findings.resistance_deviation(state, operator())) < 1.5


def test_the_evidence_is_for_what_is_wrong_and_against_what_is_not():
    found = findings.evidence(learned().state, learned().operator)
    assert min(found[wrong] for wrong in ("gains", "offsets")) > 10
    assert max(found[right] for right in ("places", "sheet")) < 3
    nothing = findings.evidence(SensorState.unknown(operator(), WIDE), operator())
    assert nothing == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-6)


def test_the_grounded_electrodes_own_reading_tells_its_resistance():
    """The drop over switch and wire, whatever the model errs in the electrode: far better known."""
    whole = simulator()
    sensor = Simulator(layout(), replace(whole.scene, own_reading=True), row_period=0.0)
    times = np.arange(0.25, 4.0, 0.5)
    found = []
    for each in (whole, sensor):
        read = np.array([each.frame(t, i) for i, t in enumerate(times)])
        state = learn(layout(), read, np.arange(16), DRIVE, noise=NOISE).state
        found.append((rms(state["resistance"] - truth().ground_resistance), state))
    assert found[1][0] < 10 and found[1][0] < found[0][0] / 2
    said = [findings.resistance_deviation(state, operator()) for _, state in found]
    assert rms(said[1]) < rms(said[0]) / 3
    for error, known in zip((each[0] for each in found), said):
        assert error < 2 * rms(known)


def test_frames_that_hold_no_touch_leave_everything_but_offsets_as_it_was():
    found = learn(layout(), frames()[::2], np.arange(16), DRIVE, noise=NOISE)
    state = found.state
    assert state.touches == 0 and found.untouched == 8
    for part in ("sheet", "gain", "resistance"):
        assert state.known(part).max() < 1e-9
    assert state.known("offset").min() > 0.2
    *said, last = findings.lines(found)
    assert "no frame holds a touch" in "\n".join(said) and last.startswith("nothing but offsets")


def test_the_sheet_as_drawn_is_where_learning_begins_and_is_not_known_for_it():
    """Where touches do not fit together, what each by itself has told is what is known."""
    known, ends = learner(), np.zeros((16, 16), bool)
    before = known.state.std("cut")
    rows = [
        rows_of(operator(), each, np.arange(16), DRIVE, NOISE, ends) for each in frames()[1:6:2]
    ]
    fits, _, as_drawn = recorded._first(known, rows, lambda items, doing: items, False)
    assert as_drawn and all(len(fit.unknowns.contacts) for fit in fits) and known.state.touches == 3
    assert (known.state.std("cut") > 0.9 * before).all()
    assert known.state.std("gain").max() < 0.1 * WIDE.gain


def test_touches_that_begin_and_end_within_a_frame_are_learned_from_between():
    """A touch has two frames that contradict reciprocity, and one that rests."""
    parts = []
    for i, rests in enumerate(frames()):
        row = 2 + i % 12
        idle = np.random.default_rng(i).normal(0, NOISE, rests.shape)
        begins = np.where(np.arange(16)[:, None] < row, idle, rests)
        ends = np.where(np.arange(16)[:, None] < row, rests, idle)
        parts += [
            idle,
            begins,
            rests,
            rests + np.random.default_rng(i + 99).normal(0, 1e-4, rests.shape),
            ends,
        ]
    found = learn(layout(), np.array(parts), np.arange(16), DRIVE, noise=NOISE)
    assert found.state.touches >= learned().state.touches and found.moved >= 12
    ratio = found.state["gain"] / truth().gain
    assert (ratio / ratio.mean()).std() < 2e-3  # of 5 %


def test_dead_channels_are_named_and_left_as_expected():
    broken = frames().copy()
    broken[:, :, 3] = np.nan
    found = learn(layout(), broken, np.arange(16), DRIVE, noise=NOISE, most=3)
    assert found.faults == {3: "no readings"}
    assert found.state.std("gain")[3] == pytest.approx(WIDE.gain)
    assert found.state.std("gain")[4] < 0.01
    assert "electrode 3: no readings" in "\n".join(findings.lines(found))


def test_what_too_few_touches_cannot_check_stays_as_drawn():
    """With 2.81 mm for 2.50, resistances that were 135 ohm too large explained three touches as well."""
    found = learn(layout(), frames()[1:6:2], np.arange(16), DRIVE, noise=NOISE)
    start = SensorState.unknown(found.operator, WIDE)
    assert found.state.touches == 3 and found.kept_out is None
    assert found.state.left_out == ("outline and radius",)
    np.testing.assert_array_equal(found.state["cut"], start["cut"])
    np.testing.assert_allclose(found.state.std("cut"), start.std("cut"))
    assert found.state.std("gain").max() < 0.1 * WIDE.gain
    assert "too few to tell" in (said := "\n".join(findings.lines(found)))
    assert "(outline and radius: as in the layout)" in said


def test_wires_swapped_before_the_first_touch_are_said_and_not_learned():
    """All touches of the recording show it; the same ones without the swap name nothing. They are soft:
    what leaves less over is searched in less time."""
    assert learned().exchanged is None
    whole = simulator()
    soft = [replace(each, pressure=0.03 * each.pressure) for each in whole.scene.contacts]
    swapped = replace(whole.scene.defects, swapped=((5, 6),))
    scene = replace(whole.scene, contacts=soft, defects=swapped)
    sensor = Simulator(layout(), scene, row_period=0.0)
    read = np.array([sensor.frame(t, i) for i, t in enumerate(np.arange(0.25, 2.0, 0.5))])
    found = learn(layout(), read, np.arange(16), DRIVE, noise=NOISE)
    assert found.exchanged.pair == (5, 6) and found.exchanged.sure > 10
    assert (found.state.touches, found.unexplained) == (0, 2)
    for part in ("sheet", "resistance"):
        assert found.state.known(part).max() < 1e-9
    assert "electrodes 5 and 6 are swapped" in "\n".join(findings.lines(found))


# -- time, files, commands ----------------------------------------------------------------------


def test_what_is_known_fades_but_never_below_nothing():
    state = learned().state
    later = state.walked(3600.0)
    assert (later.deviation >= state.deviation * 0.999).all()
    assert (state.walked(1e12).deviation <= state.expected * 1.001).all()
    assert np.linalg.eigvalsh(later.covariance / np.outer(later.deviation, later.deviation))[0] > 0


def test_what_is_told_of_some_numbers_moves_the_others_as_bayes_would():
    """Gains from reciprocity replaced a block of a covariance: with what an earlier session had
    learned, that was none any more, and `learn --sensor` ended in a traceback."""
    state = SensorState.unknown(operator(), WIDE)
    random = np.random.default_rng(1)
    number = len(state.mean)
    mixed = np.eye(number) + 0.3 * random.standard_normal((number, number))
    scale = state.deviation
    covariance = mixed @ mixed.T * scale[:, None] * scale
    before = state.learned(state.mean + state.deviation, covariance)
    where = random.permutation(number)[:5]
    noise = 0.01 * covariance[np.ix_(where, where)]
    gain = np.linalg.solve(covariance[np.ix_(where, where)] + noise, covariance[where]).T
    seen = before.mean[where] + random.standard_normal(5) * before.deviation[where]
    mean = before.mean + gain @ (seen - before.mean[where])
    after = covariance - gain @ covariance[where]
    told = before.told(where, mean[where], after[np.ix_(where, where)])
    assert np.abs((told.mean - mean) / scale).max() < 1e-6
    assert np.abs((told.covariance - after) / scale[:, None] / scale).max() < 1e-6


def test_sensor_file_keeps_all_of_it(tmp_path):
    state, path = learned().state, tmp_path / "sensor.yaml"
    save_sensor(path, layout(), operator(), state)
    back = load_sensor(path, layout())
    assert back.mean == pytest.approx(state.mean, rel=1e-5, abs=1e-8)  # modes are float32
    scale = np.outer(state.deviation, state.deviation)
    assert np.abs((back.covariance - state.covariance) / scale).max() < 1e-4
    assert (back.touches, back.frames, back.idle) == (8, 8, 8)


def test_electrodes_that_lie_aside_are_learned_and_kept(tmp_path):
    """0.5 mm in x and in y: as well as is said. A sheet that is uneven looks much the same."""
    found = learn(inner(), frames(5e-4), np.arange(16), DRIVE, noise=NOISE)
    ways = np.array([found.state["aside_x"], found.state["aside_y"]]).T
    x, y = inner().positions.T
    one, none = np.ones(16), np.zeros(16)
    together = np.array([[*one, *none], [*none, *one], [*x, *y], [*-y, *x]]).T
    error = (ways - 5e-4 * places()).T.ravel()  # what all have in common, nobody can tell
    error -= together @ np.linalg.lstsq(together, error)[0]
    error = error.reshape(2, 16).T
    assert rms(error) < 0.7 * 5e-4
    deviation = np.array([found.state.std("aside_x"), found.state.std("aside_y")]).T
    assert rms(error / deviation) < 2
    assert "mm rms from their places" in "\n".join(findings.lines(found))
    save_sensor(tmp_path / "sensor.yaml", inner(), found.operator, found.state)
    back = load_sensor(tmp_path / "sensor.yaml", inner())
    assert back["aside_x"] == pytest.approx(found.state["aside_x"], rel=1e-6)


def test_sensor_file_holds_for_other_signs_and_order_of_modes(tmp_path):
    """Eigenvectors differ between machines."""
    state, path = learned().state, tmp_path / "sensor.yaml"
    other = SheetOperator(layout())
    turn = np.diag(np.resize([1.0, -1.0], other.field.count))[::-1]
    other.field.modes = other.field.modes @ turn.T
    whole = np.eye(len(state.mean))
    whole[: len(turn), : len(turn)] = turn
    turned = state.learned(whole @ state.mean, whole @ state.covariance @ whole.T)
    save_sensor(path, layout(), other, turned)
    back = load_sensor(path, layout())
    assert back.mean == pytest.approx(state.mean, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda text: text.replace("geometry: ", "geometry: x"), "electrodes are not those of"),
        (
            lambda text: text.replace("gain_deviation: [", "gain_deviation: [-"),
            "not a positive number",
        ),
        (lambda text: text.replace("correlation: ", "correlation: A"), "correlation: is not"),
        (lambda text: text.replace("anisotropy: [", "anisotropie: ["), "anisotropy: is missing"),
        (
            lambda text: text.replace("coefficients: [", "coefficients: [" + "0," * 1000),
            "coefficients: .* more than 1000",
        ),
        (
            lambda text: text.replace("sensor/1", "layout/1"),
            "must say 'format: tomotactile-sensor/1'",
        ),
    ],
)
def test_bad_sensor_files_are_refused_in_one_line(tmp_path, change, complaint):
    path = tmp_path / "sensor.yaml"
    save_sensor(path, layout(), operator(), learned().state)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=complaint):
        load_sensor(path, layout())


def test_learn_then_reconstruct(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    layout().save("layout.yaml")
    read = frames()[:4]
    stamps = np.arange(len(read)) * 0.5 + 0.25
    save_frames("frames.npz", layout(), simulator().scene, read, np.arange(16), stamps)
    more = ["--layout", "layout.yaml", "--touches", "2"]
    assert main(["learn", "frames.npz", *more, "--out", "sensor.yaml"]) == 0
    out = capsys.readouterr().out
    assert "gains:" in out and "not determined:" in out
    assert (tmp_path / "sensor.png").read_bytes().startswith(b"\x89PNG")
    more += ["--sensor", "sensor.yaml"]
    assert main(["learn", "frames.npz", *more, "--out", "more.yaml"]) == 0
    arguments = ["--layout", "layout.yaml", "--profile", "balanced", "--out", "result.npz"]
    assert main(["reconstruct", "frames.npz", *arguments, "--sensor", "sensor.yaml"]) == 0
    assert main(["reconstruct", "frames.npz", *arguments, "--sensor", "layout.yaml"]) == 2
    assert "tomotactile-sensor/1" in capsys.readouterr().err


def test_numbers_that_are_no_readings_of_a_sheet_are_left_out():
    """They ended in a traceback, and 4 V in all of them were learned as offsets."""
    random = np.random.default_rng(0)
    noise = random.uniform(0, DRIVE, (2, 16, 16))
    found = learn(layout(), np.concatenate([noise, 1e6 * noise]), np.arange(16), DRIVE, noise=NOISE)
    text = "\n".join(findings.lines(found))
    assert (found.moved, found.state.touches) == (4, 0)
    assert "no readings of a sheet" in text and "no gains explain" in text
    read = frames()[:8].copy()
    read[1], read[3], read[4] = *noise, 4.0
    found = learn(layout(), read, np.arange(16), DRIVE, noise=NOISE)
    assert (found.moved, found.constant, found.untouched, found.state.frames) == (2, 1, 3, 2)
    ratio = found.state["gain"] / truth().gain
    assert (ratio / ratio.mean()).std() < 2 * findings.relative_gain_deviation(found.state)
    assert np.abs(found.state["offset"]).max() < 0.02
    assert "is anything grounded" in "\n".join(findings.lines(found))


def test_two_touches_at_once_are_not_one_on_a_sensor_that_nobody_would_believe():
    """Where electrodes lie, gains and the sheet bend far enough together to explain two discs by one
    in the middle, with gains that are half of what they should be and known to 0.04 %."""
    wide = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4)
    discs = (
        Contact("disc", center=(-0.07, 0.05), radius=0.008, pressure=2e4),
        Contact("disc", center=(0.07, -0.05), radius=0.005, pressure=3e4),
    )
    scene = Scene("two", DRIVE, discs, LAW, noise=Noise(NOISE), adc=Adc(12, DRIVE))
    simulator = Simulator(wide, scene, "closed_form")
    frames = np.array([simulator.frame(0.1 * i) for i in range(2)])
    found = learn(wide, frames, simulator.grounded, DRIVE, noise=NOISE)
    assert found.unexplained == 0
    assert rms(found.state["gain"] - 1) < 2e-3
    assert rms(found.state["offset"]) < 5e-3
