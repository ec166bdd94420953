"""The sensor as it is: frames of every part, and any reconstruction scored on them."""

import json
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tomotactile_ros import cli
from tomotactile_ros.bench import report
from tomotactile_ros.bench.bound import Bounds
from tomotactile_ros.bench.reference import Admittance
from tomotactile_ros.bench.reference_slides import SlideData
from tomotactile_ros.bench.sensor import TITLES, changes, parts, trial
from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import States, states
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, make_pipeline
from tomotactile_ros.evaluation.scoring import PART
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels, Rms
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet import make_sheet, voltages
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support.errors import InputError

LAYOUT = load_layout("equal-4x4")
E = LAYOUT.electrodes


def admittance(seed=0):
    """A made up state: any symmetric conductances and a drive."""
    random = np.random.default_rng(seed)
    between = random.random((E, E)) * 1e-4
    between = between + between.T
    np.fill_diagonal(between, 0.0)
    return Admittance(between, random.random(E) * 1e-4)


def some_states(count=2):
    truths = [[{"x": 0.01 * i, "y": 0.0, "force": 1.0}] for i in range(count)]
    return States(LAYOUT, [admittance(i) for i in range(count)], truths, [""] * count)


@dataclass
class Recorder:
    """A reconstruction that remembers what it was given and says what it is told to."""

    answers: object
    seen: list = field(default_factory=list)

    def process(self, voltages, grounded, drive_voltage, row_period=None):
        self.seen.append((voltages, row_period))
        return self.answers(len(self.seen) - 1)


def says(*contacts, **more):
    return SimpleNamespace(contacts=[SimpleNamespace(**c) for c in contacts], **more)


def test_wires_that_are_swapped_or_open():
    """Rows and columns are exchanged; an open wire leaves the sheet at the drive voltage."""
    plain = potentials(admittance())
    swapped = potentials(admittance(), Wiring(swapped=((2, 9),)))
    assert swapped[2, 0] == plain[9, 0] and swapped[0, 2] == plain[0, 9]
    assert swapped[2, 9] == plain[9, 2] and np.isnan(swapped[2, 2])
    opened = potentials(admittance(), Wiring(Channels(open=(3,))))
    np.testing.assert_allclose(np.delete(opened[3], 3), 3.3)
    np.testing.assert_allclose(np.delete(opened, 3, 0), np.delete(plain, 3, 0))


def test_readings_have_gains_steps_and_noise_of_their_seed():
    ideal = potentials(admittance())
    read = readings(ideal, seed=(1, 2))
    off = (read - ideal)[~np.isnan(ideal)]
    assert 0.0008 < off.std() < 0.0012
    np.testing.assert_allclose(read / (3.3 / 4096), np.round(read / (3.3 / 4096)), atol=1e-6)
    np.testing.assert_array_equal(read, readings(ideal, seed=(1, 2)))
    assert not np.array_equal(read, readings(ideal, seed=(1, 3)), equal_nan=True)
    gains = readings(ideal, Wiring(Channels(gain=Rms(0.05, 1)))) / readings(ideal)
    assert np.nanstd(np.nanmedian(gains, axis=0)) == pytest.approx(0.05, rel=0.4)
    assert np.isnan(readings(ideal, Wiring(dead=(5,)))[:, 5]).all()


@pytest.mark.parametrize("end", [False, True])
@pytest.mark.parametrize("beside", [False, True])
def test_a_touch_changes_between_two_rows_of_the_frame_that_is_judged(beside, end):
    """From nothing, or beside a touch that lasts."""
    touched, without = some_states(6), None
    if beside:
        lasting, without = {"x": 0.05, "y": 0.0, "force": 2.0}, touched
        truths = [[lasting, *truth] for truth in touched.truths]
        touched = States(LAYOUT, touched.seen[::-1], truths, touched.cases)
    made = changes.changing("case", touched, end, without)
    assert made.row_period == ROW_PERIOD
    for i in range(6):
        first, within, last = made.frames[3 * i : 3 * i + 3]
        as_before = np.nanmax(np.abs(within - first), axis=1) < 0.01
        as_after = np.nanmax(np.abs(within - last), axis=1) < 0.01
        np.testing.assert_array_equal(as_before, ~as_after)
        assert as_before[0] and as_after[-1] and np.count_nonzero(np.diff(as_before)) == 1
        if not beside:
            assert (np.nanmax(first) > 0.1) == end and (np.nanmax(last) > 0.1) != end
        before, truth, after = made.truths[3 * i : 3 * i + 3]
        assert before is after is None
        assert [bool(each.get(PART)) for each in truth] == [False] * beside + [True]


def slides():
    """One that goes 4 mm along y in a row, on made up rows."""
    rows = np.stack([potentials(admittance(i)) for i in range(2)]).reshape(1, 1, 2 * E, E) / 3.3
    contact = {"x": 0.01, "y": -0.02, "force": 1.0}
    slide = {"direction": [0.0, 1.0], "contact": contact}
    return SlideData(LAYOUT, rows, [slide], [4.0], {"row_period": ROW_PERIOD})


@pytest.mark.parametrize("row", [None, 0, E - 1])
def test_what_moves_is_judged_at_the_time_of_which_a_result_speaks(row):
    """Row 16 of the slide is the first of the second scan; in the middle where nobody says."""
    after = (E - 1) / 2 if row is None else row

    def follows(i):
        said = says({"x": 0.01, "y": -0.02 + 4e-3 * (E * (i - 1) + after), "force": 1.0})
        if row is not None:
            said.holds = row * ROW_PERIOD
        return said

    made = changes.sliding("case", slides(), 4.0)
    assert [truth is None for truth in made.truths] == [True, False, False]
    assert np.nanmax(made.frames[0]) < 0.01
    for seed, frame in enumerate(made.frames[1:]):
        assert np.nanmax(np.abs(frame - potentials(admittance(seed)))) < 0.01
    figures = trial.judge(Recorder(follows), made)
    assert (figures["frames"], figures["missed"]) == (2, 0)
    assert figures["place"]["worst"] == pytest.approx(0.0, abs=1e-12)


def test_methods_are_told_the_row_period_and_judged_on_judged_frames_only():
    made = trial.presses("case", some_states())
    assert np.nanmax(made.frames[::2]) < 0.01 < np.nanmax(made.frames[1])  # each after nothing
    good = Recorder(lambda i: says({"x": 0.01 * (i // 2), "y": 0.001, "force": 1.1}))
    (row,) = trial.measure([made], lambda layout: {"mine": good})
    assert [period for _, period in good.seen] == [0.0] * 4
    assert (row["case"], row["method"], row["frames"]) == ("case", "mine", 2)
    assert (row["ghosts"], row["missed"], row["true"]) == (0, 0, 2)
    assert row["place"]["worst"] == pytest.approx(0.001)
    assert row["force"]["median"] == pytest.approx(0.1)


def test_refused_and_withheld_frames_are_counted_and_not_judged():
    def answer(i):
        if i == 1:
            raise InputError("no")
        return says({"x": 1.0, "y": 1.0, "force": 1.0}, state="withheld")

    made = trial.presses("case", some_states())
    (row,) = trial.measure([made], lambda layout: {"mine": Recorder(answer)})
    assert (row["frames"], row["withheld"], row["ghosts"], row["missed"]) == (0, 2, 0, 0)


def test_the_cases_of_every_part_are_there():
    """All that the reference data hold of the default layout."""
    assert list(TITLES) == list(parts.PARTS)
    made = {part: list(parts.PARTS[part](12)) for part in parts.PARTS}
    assert {"onset", "release", "0.2 m/s", "1 m/s"} <= {each.case for each in made["time"]}
    assert {each.case for each in made["channels"]} == set(parts.WIRINGS)
    assert len(made["layouts"]) == 7 and len(made["crowd"]) == 4
    for part in made.values():
        for each in part:
            count = each.layout.electrodes
            assert each.frames.shape == (len(each.truths), count, count)
            assert any(each.truths) and len({len(t) for t in each.truths if t}) == 1
    crowd = [truth for each in made["crowd"] for truth in each.truths if truth]
    forces = [[contact["force"] for contact in truth] for truth in crowd]
    assert [len(each) for each in forces] == [3, 4, 5, 6]
    assert [max(each) / min(each) for each in forces] == pytest.approx([10.0] * 4, rel=1e-3)


def test_tables_show_ghosts_and_misses_beside_places_and_bounds_where_there_are_any():
    contact = {"x": 0.0, "y": 0.0, "force": 1.0}
    sure = contact | {"position_covariance": np.eye(2).ravel() * 1e-6, "force_std": 0.1}
    row = {"case": "a", "method": "m", "bound": None}
    row |= trial.judge(Recorder(lambda i: says(sure)), _one([contact]))
    shown = "\n".join(report.sensor_lines({"channels": [row]}))
    assert "ghosts" in shown and "missed" in shown and "bound mm" not in shown
    assert "95 % regions: place %" in shown and shown.split().count("100") == 2
    off = row | {"place": row["place"] | {"median": 5e-5}, "bound": 2.5e-5}
    shown = "\n".join(report.sensor_lines({"channels": [off]}))
    assert "place / bound" in shown and " 0.025     2.0\n" in shown


@pytest.mark.parametrize("name", ["equal-8x8", "ring-16"])
def test_no_estimate_of_the_same_model_is_better_than_its_bound(name):
    """Readings of the bound's own model with nothing but noise: its deviations are those of estimates."""
    layout, noise = load_layout(name), np.random.default_rng(5)
    pipeline, bounds, sheet = make_pipeline(layout), Bounds(layout), make_sheet(layout)
    parts_of_bound = []
    for x, y in 0.06 * (noise.random((16, 2)) - 0.5) * [[1.3, 1.3]]:
        disc = Contact("disc", center=(x, y), radius=0.005, pressure=2e4)
        touch = contact_points(sheet, [(disc.patches(10), LAW.conductance(2e4))])
        volts = voltages.frame(*touch, DRIVE)
        volts += NOISE * noise.standard_normal(volts.shape)
        (found,) = pipeline.process(volts, layout.grounded, DRIVE).contacts
        truth = {"x": x, "y": y, "radius": 0.005, "conductance": LAW.conductance(2e4)}
        (bound,) = bounds.places([truth])
        parts_of_bound.append(np.hypot(found.x - x, found.y - y) / bound)
    assert 0.5 < np.median(parts_of_bound) < 1.3  # 0.83 of a normal distribution


def test_bounds_are_those_of_discs_at_rest():
    pressed = states("crowd-8x8", "3 contacts", most=2)
    one = trial.presses("crowd", pressed)
    bounds = Bounds(one.layout)
    together = trial.least_error(one, bounds)
    assert together.shape == (6,) and (together > 0).all()
    one_place = pressed.truths[0][0]
    beside = one_place | {"x": one_place["x"] + 0.012}
    (alone,) = bounds.places([one_place])
    assert bounds.places([one_place, beside])[0] > 1.5 * alone  # hardly told apart
    ring = trial.presses("ring", states("wide-8x8", "ring"))
    for without in (replace(one, row_period=1e-3), ring):
        assert not len(trial.least_error(without, bounds))


def _one(truth):
    return trial.Trial("one", LAYOUT, untouched(E)[None], [truth])


def silent(layout):
    """A method for the command."""
    return {"silent": Recorder(lambda i: says())}


def test_the_command_measures_parts_with_other_methods_beside_the_profiles(
    tmp_path, monkeypatch, capsys
):
    """The frame shows nothing, so that the profiles have nothing to look for."""
    two = _one([{"x": x, "y": 0.0, "force": 1.0} for x in (0.0, 0.05)])
    monkeypatch.setitem(parts.PARTS, "crowd", lambda step: iter([two]))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    out = tmp_path / "parts.json"
    words = ["bench", "--parts", "crowd", "--methods", f"{__name__}:silent", "--out", str(out)]
    assert cli.main(words) == 0
    rows = json.loads(out.read_text())["sensor"]["crowd"]
    assert [row["method"] for row in rows] == ["fast", "balanced", "accurate", "silent"]
    assert all(row["missed"] == row["true"] == 2 for row in rows)
    assert "silent" in capsys.readouterr().out
