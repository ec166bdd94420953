"""A sensor learned from touches of unknown place and force: against the truth and against its own
covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contacts_support import DRIVE, NOISE, disc, sensor

from tomotactile_ros.cli import main
from tomotactile_ros.estimation.information import Information
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.kept_out import GROUPS, Predicted
from tomotactile_ros.learning.learner import Learner
from tomotactile_ros.learning.ledger import Ledger
from tomotactile_ros.learning.readings import rows_of
from tomotactile_ros.learning.recorded import WIDE, Learned, learn
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.defects import Adc, Defects
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

ADC = Adc(12, 4.0)
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
    random, contacts = np.random.default_rng(5), []
    for i in range(touches):
        place, radius = 0.09 * (random.random(2) - 0.5), random.uniform(0.004, 0.008)
        pressure = random.uniform(1e4, 3e4)
        contacts.append(disc(*place, radius, pressure=pressure, start=i + 0.5, end=i + 1.0))
    how = {"seed": 0, "adc": ADC, "defects": Defects(channels=channels), "row_period": 0.0}
    return sensor(displaced(aside), *contacts, **how)


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


def read(made, end=8.0):
    """A frame of each half second: one of each touch, and one before it."""
    return np.array([made.frame(t, i) for i, t in enumerate(np.arange(0.25, end, 0.5))])


def learn_from(voltages, of=None, **more):
    return learn(of or layout(), voltages, np.arange(16), DRIVE, noise=NOISE, **more)


@cache
def frames(aside=0.0):
    return read(simulator(aside=aside))


@cache
def learned():
    return learn_from(frames())


def truth():
    return WRONG.of(16)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def learner(state=None):
    return Learner(operator(), 0.005, DRIVE, state)


def test_a_wide_load_that_rests_bends_the_sensor_no_further_than_is_said():
    """Over an electrode: without `pressure_modes` the sheet went up to
    22 of its deviations, resistances 16."""
    load, own = disc(0.01, -0.015, 0.025, pressure=1e4), learner()
    made = sensor(layout(), load, seed=0, adc=ADC, row_period=0.0)
    for number in range(2):
        rows = rows_of(operator(), made.frame(0.5, number), np.arange(16), DRIVE, NOISE)
        own.learn(own.look(rows))
    assert own.state.touches == 1
    even = SensorState.unknown(operator(), WIDE)
    for part in ("sheet", "gain", "resistance"):
        moved = own.state[part] - even[part]
        assert (np.abs(moved) < 3.5 * own.state.std(part)).all()


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
    state = learn_from(read(Simulator(layout(), ideal, row_period=0.0), 4.0)).state
    said, below = findings.resistance(state), state.mean.copy()
    below[state.slice("resistance")] -= 500.0  # what the model's electrodes err, and none to ground
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
    own = Simulator(layout(), replace(whole.scene, own_reading=True), row_period=0.0)
    found = []
    for each in (whole, own):
        state = learn_from(read(each, 4.0)).state
        found.append((rms(state["resistance"] - truth().ground_resistance), state))
    assert found[1][0] < 10 and found[1][0] < found[0][0] / 2
    said = [findings.resistance_deviation(state, operator()) for _, state in found]
    assert rms(said[1]) < rms(said[0]) / 3
    for error, known in zip((each[0] for each in found), said):
        assert error < 2 * rms(known)


def test_frames_that_hold_no_touch_leave_everything_but_offsets_as_it_was():
    found = learn_from(frames()[::2])
    state = found.state
    assert state.touches == 0 and found.untouched == 8
    for part in ("sheet", "gain", "resistance"):
        assert state.known(part).max() < 1e-9
    assert state.known("offset").min() > 0.2
    *said, last = findings.lines(found)
    assert "no frame holds a touch" in "\n".join(said) and last.startswith("nothing but offsets")


def test_touches_that_begin_and_end_within_a_frame_are_learned_from_between():
    """A touch has two frames that contradict reciprocity, and one that rests."""
    parts = []
    for i, rests in enumerate(frames()):
        row = 2 + i % 12
        idle = np.random.default_rng(i).normal(0, NOISE, rests.shape)
        begins = np.where(np.arange(16)[:, None] < row, idle, rests)
        ends = np.where(np.arange(16)[:, None] < row, rests, idle)
        again = rests + np.random.default_rng(i + 99).normal(0, 1e-4, rests.shape)
        parts += [idle, begins, rests, again, ends]
    found = learn_from(np.array(parts))
    assert found.state.touches >= learned().state.touches and found.moved >= 12
    ratio = found.state["gain"] / truth().gain
    assert (ratio / ratio.mean()).std() < 2e-3  # of 5 %


def test_dead_channels_are_named_and_left_as_expected():
    broken = frames().copy()
    broken[:, :, 3] = np.nan
    found = learn_from(broken, most=3)
    assert found.faults == {3: "no readings"}
    assert found.state.std("gain")[3] == pytest.approx(WIDE.gain)
    assert found.state.std("gain")[4] < 0.01
    assert "electrode 3: no readings" in "\n".join(findings.lines(found))


def test_what_too_few_touches_cannot_check_stays_as_drawn():
    """With 2.81 mm for 2.50, resistances that were 135 ohm too large explained three touches as well."""
    found = learn_from(frames()[1:6:2])
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
    found = learn_from(read(Simulator(layout(), scene, row_period=0.0), 2.0))
    assert found.exchanged.pair == (5, 6) and found.exchanged.sure > 10
    assert (found.state.touches, found.unexplained) == (0, 2)
    for part in ("sheet", "resistance"):
        assert found.state.known(part).max() < 1e-9
    assert "electrodes 5 and 6 are swapped" in "\n".join(findings.lines(found))


# -- touches that were kept out: a part that does not predict them is left out ----------------------

SMALL = SheetOperator(equal_grid(3, 3, (0.1, 0.1), 0.002, 1e4))
START = SensorState.unknown(SMALL)
WIDTH, SIZE = START.expected, len(START.mean)


def told_by_touches(random, count, varying=()):
    """Parts of `count` touches of one sensor, each of which tells all of it to a tenth of what was
    expected; but in each of them what is `varying` is another one."""
    told = 100 / WIDTH**2
    true = random.multivariate_normal(START.mean, START.covariance)
    parts = []
    for _ in range(count):
        seen = true + np.sqrt(1 / told) * random.normal(size=SIZE)
        for part in varying:
            where = START.slice(part)
            seen[where] = START.mean[where] + WIDTH[where] * random.normal(size=len(WIDTH[where]))
        apart = seen - START.mean  # chi-squared is 0 where the touch has the sensor
        parts.append((Information(np.diag(told), told * apart, told @ apart**2, SIZE), 1.0))
    return parts


def judged(parts, of=None):
    def learned(some):
        inverse = np.linalg.inv(START.covariance)
        matrix = inverse + sum(weight * each.matrix for each, weight in some)
        vector = sum(weight * each.vector for each, weight in some)
        covariance = np.linalg.inv(matrix)
        return START.learned(START.mean + covariance @ vector, covariance)

    where = np.arange(SIZE)
    of = range(len(parts)) if of is None else of
    return Predicted(parts, of, START.mean, where, learned, START, np.zeros(SIZE)).judged()


def test_what_all_touches_have_is_kept_and_predicts_the_others():
    found = judged(told_by_touches(np.random.default_rng(0), 20))
    assert found.left_out == () and found.gained > 0
    assert found.found == pytest.approx(found.predicted, rel=0.3)
    assert found.layout > 3 * found.found


@pytest.mark.parametrize("name", GROUPS)
def test_what_each_touch_has_of_its_own_is_left_out(name):
    found = judged(told_by_touches(np.random.default_rng(1), 20, GROUPS[name]))
    assert found.left_out == (name,)
    said = "\n".join(findings.lines(Learned(START, SMALL, kept_out=found)))
    assert "touches predicted from the others" in said
    assert f"not kept, as other touches are predicted better without: {name}" in said


def test_frames_of_one_touch_do_not_predict_each_other():
    """Each touch has gains of its own: those of one predict its own frames, and not the others."""
    parts = told_by_touches(np.random.default_rng(4), 5, GROUPS["gains"])
    repeated = [each for each in parts for _ in range(10)]
    found = judged(repeated, [touch for touch in range(5) for _ in range(10)])
    assert found.touches == 5 and found.left_out == ("gains",)
    assert judged(repeated[:10]).left_out == ()


def test_the_evidence_is_that_of_the_readings():
    """Of one number with one reading: a normal distribution of variance 1 + its own."""
    parts = told_by_touches(np.random.default_rng(3), 5)
    at = START.mean, np.arange(SIZE)
    whole = Predicted(parts, range(5), *at, lambda some: START, START, 0 * WIDTH)
    evidence = whole.without(())[0]
    direct = 0.0
    for found, _ in parts:
        told = found.matrix.diagonal()
        spread = np.diag(1 / told) + START.covariance
        seen = found.vector / told
        direct -= (seen @ np.linalg.solve(spread, seen) + np.linalg.slogdet(spread)[1]) / 2
        direct -= np.log(told).sum() / 2
    assert evidence == pytest.approx(direct)


def test_the_file_says_what_was_left_out(tmp_path):
    layout, path = SMALL.layout, tmp_path / "sensor.yaml"
    state = SensorState(
        START.modes, START.mean, START.covariance, WIDTH, 9, 9, 1, left_out=("gains",)
    )
    save_sensor(path, layout, SMALL, state)
    assert load_sensor(path, layout).left_out == ("gains",)
    path.write_text(path.read_text().replace("gains", "gain"))
    with pytest.raises(InputError, match="left_out.*gain.*is none of gains, offsets"):
        load_sensor(path, layout)


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


def test_electrodes_that_lie_aside_are_learned_and_kept(tmp_path):
    """0.5 mm in x and in y: as well as is said. A sheet that is uneven looks much the same."""
    found = learn_from(frames(5e-4), inner())
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


@pytest.mark.parametrize("turned", [False, True], ids=["as they are", "turned"])
def test_sensor_file_keeps_all_of_it_whatever_signs_and_order_modes_have(tmp_path, turned):
    """Eigenvectors differ between machines."""
    state, path, other = learned().state, tmp_path / "sensor.yaml", SheetOperator(layout())
    whole, kept = np.eye(len(state.mean)), state
    if turned:
        turn = np.diag(np.resize([1.0, -1.0], other.field.count))[::-1]
        other.field.modes = other.field.modes @ turn.T
        whole[: len(turn), : len(turn)] = turn
        kept = state.learned(whole @ state.mean, whole @ state.covariance @ whole.T)
    save_sensor(path, layout(), other, kept)
    back = load_sensor(path, layout())
    assert back.mean == pytest.approx(state.mean, rel=1e-4, abs=1e-5)
    assert turned or back.mean == pytest.approx(state.mean, rel=1e-5, abs=1e-8)  # float32
    scale = np.outer(state.deviation, state.deviation)
    assert np.abs((back.covariance - state.covariance) / scale).max() < 1e-4
    assert (back.touches, back.frames, back.idle) == (8, 8, 8)


@pytest.mark.parametrize(
    "old, new, complaint",
    [
        ("geometry: ", "geometry: x", "electrodes are not those of"),
        ("geometry: ", "tears: [[0.0, 0.0, 0.01]]\ngeometry: ", "tears"),
        ("gain_deviation: [", "gain_deviation: [-", "not a positive number"),
        ("correlation: ", "correlation: A", "correlation: is not"),
        ("anisotropy: [", "anisotropie: [", "anisotropy: is missing"),
        ("coefficients: [", "coefficients: [" + "0," * 1000, "coefficients: .* more than 1000"),
        ("sensor/1", "layout/1", "must say 'format: tomotactile-sensor/1'"),
    ],
)
def test_bad_sensor_files_are_refused_in_one_line(tmp_path, old, new, complaint):
    path = tmp_path / "sensor.yaml"
    save_sensor(path, layout(), operator(), learned().state)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=complaint):
        load_sensor(path, layout())


def test_learn_then_reconstruct(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    layout().save("layout.yaml")
    stamps = np.arange(4) * 0.5 + 0.25
    save_frames("frames.npz", layout(), simulator().scene, frames()[:4], np.arange(16), stamps)
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
    found = learn_from(np.concatenate([noise, 1e6 * noise]))
    text = "\n".join(findings.lines(found))
    assert (found.moved, found.state.touches) == (4, 0)
    assert "no readings of a sheet" in text and "no gains explain" in text
    spoilt = frames()[:8].copy()
    spoilt[1], spoilt[3], spoilt[4] = *noise, 4.0
    found = learn_from(spoilt)
    assert (found.moved, found.constant, found.untouched, found.state.frames) == (2, 1, 3, 2)
    ratio = found.state["gain"] / truth().gain
    assert (ratio / ratio.mean()).std() < 2 * findings.relative_gain_deviation(found.state)
    assert np.abs(found.state["offset"]).max() < 0.02
    assert "is anything grounded" in "\n".join(findings.lines(found))


def test_two_touches_at_once_are_not_one_on_a_sensor_that_nobody_would_believe():
    """Where electrodes lie, gains and the sheet bend far enough together to explain two discs by one
    in the middle, with gains that are half of what they should be and known to 0.04 %."""
    wide = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4)
    discs = disc(-0.07, 0.05, 0.008, pressure=2e4), disc(0.07, -0.05, 0.005, pressure=3e4)
    made = sensor(wide, *discs, seed=0, model="closed_form")
    pair = np.array([made.frame(0.1 * i) for i in range(2)])
    found = learn(wide, pair, made.grounded, DRIVE, noise=NOISE)
    assert found.unexplained == 0
    assert rms(found.state["gain"] - 1) < 2e-3
    assert rms(found.state["offset"]) < 5e-3
