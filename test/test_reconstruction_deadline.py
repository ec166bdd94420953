"""A deadline: results in time, that are right within what they say, and go on from where searches end."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, NOISE, disc, off, sensor
from process_support import python

from tomotactile_ros.cli import main
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.frame import Frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.deadline import Within, period_of
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.interrupt import Interrupted, Job, check

LIMIT = 60.0  # s, by when what does not come is missed
AT_ONCE = 1e-6  # s: no search ends by then


@pytest.fixture(scope="module")
def layout():
    return load_layout("equal-4x4")


@pytest.fixture(scope="module")
def frames(layout):
    """Of two discs that move slowly, one after the other."""
    simulator = Simulator(layout, load_scene("default"))
    lasts = simulator.row_period * layout.electrodes
    return [simulator.measure(i * lasts, i) for i in range(6)]


@pytest.fixture(scope="module")
def nine(layout):
    """A frame of nine fingertips of 2 N on 4 x 4, whose image has no discs that explain it."""
    places = 0.05 * (np.indices((3, 3)).reshape(2, -1).T - 1)
    touches = tuple(disc(*place, 0.012, force=2.0) for place in places)
    return Simulator(layout, replace(load_scene("default"), contacts=touches)).measure(0.0)


def gated(pipeline):
    """Searches of the pipeline wait for this to be set from now on."""
    gate, search = threading.Event(), pipeline._process
    pipeline._process = lambda given: (gate.wait(LIMIT), search(given))[1]
    return gate


class Gate:
    """A search that fails when it is told to."""

    def __init__(self, error):
        self.opened, self.error = threading.Event(), error

    def __call__(self):
        assert self.opened.wait(LIMIT)
        raise self.error


def anything(found):
    return True


def test_a_search_from_before_a_clock_was_set_back_is_nobodys(layout, frames):
    """It was told as what is there now, with a stamp of the time before."""
    pipeline = Pipeline(layout, Settings("accurate"))
    first, second = (replace(f, stamp=t) for f, t in zip(frames, (1000.0, 500.0)))
    results = [pipeline.process(first, deadline=AT_ONCE)]
    job = pipeline._within._job  # whoever waits for the interpreter may find it at its end
    assert job is None or job.wait(LIMIT)
    results.append(pipeline.process(second, deadline=AT_ONCE))
    pipeline.stop()
    assert [r.holds <= 0.016 for r in results] == [True, True]


def fails(why):
    def fail():
        raise InputError(why)

    return fail


def test_errors_are_those_of_the_frame_that_they_are_about():
    within, before = Within(), InputError("of a frame before")
    with pytest.raises(InputError, match="of the search"):
        within.result(fails("of the search"), lambda: "seen", LIMIT, anything)
    with pytest.raises(InputError, match="of the glance"):
        within.result(Gate(before), fails("of the glance"), AT_ONCE, anything)
    for error in (before, RuntimeError("a defect")):
        within, gate = Within(), Gate(error)
        within.result(gate, lambda: "seen", AT_ONCE, anything)
        gate.opened.set()
        if error is before:
            assert within.result(lambda: "found", lambda: "seen", LIMIT, anything) == "found"
        else:
            with pytest.raises(RuntimeError, match="a defect"):
                within.result(lambda: "found", lambda: "seen", LIMIT, anything)


def test_a_search_is_stopped_between_two_steps():
    begun, ended = threading.Event(), []

    def endless():
        try:
            while True:
                begun.set()
                check()
        except Interrupted:
            ended.append(True)
            raise

    job = Job(endless)
    assert begun.wait(LIMIT)
    job.stop()
    assert ended and job.outcome is None
    check()  # of who was not told to stop


def test_a_program_ends_while_a_search_goes_on():
    program = (
        "from tomotactile_ros.support.interrupt import Job, check\n"
        "import threading\n"
        "begun = threading.Event()\n"
        "def endless():\n"
        "    while True:\n"
        "        begun.set()\n"
        "        check()\n"
        "Job(endless)\n"
        "begun.wait()\n"
    )
    done = python("-c", program)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("profile", ["fast", "paper"])
def test_an_image_that_explains_a_frame_waits_for_nothing(layout, frames, profile):
    """A search of a frame before may go on meanwhile."""
    pipeline = Pipeline(layout, Settings(profile, deadline=AT_ONCE))
    gate = threading.Event()
    assert pipeline._within.result(lambda: gate.wait(LIMIT), bool, AT_ONCE, anything) is False
    result = pipeline.process(frames[0])
    gate.set()
    assert result.complete and len(result.contacts) == 2


@pytest.mark.parametrize("profile", ["accurate", "auto"])
def test_a_glance_is_right_within_its_deviations(layout, frames, profile):
    pipeline = Pipeline(layout, Settings(profile, deadline=AT_ONCE))
    # whoever waits for the interpreter may find the search at its end
    result = next(r for r in map(pipeline.process, frames * 20) if not r.complete)
    pipeline.stop()
    truth = load_scene("default").truth(frames[0].stamp)
    assert result.state == "valid"
    for contact in result.contacts:
        apart = min(off(contact, (t["x"], t["y"])) for t in truth)
        assert apart < 3 * np.sqrt(max(contact.position_covariance[::3])) + 1e-3
    assert np.isfinite(result.contacts[0].force_std)


def test_what_no_image_explains_is_told_as_one_contact_or_withheld(layout, nine):
    pipeline = Pipeline(layout, Settings("accurate", deadline=AT_ONCE))
    result = pipeline.process(nine)
    pipeline.stop()
    assert not result.complete and not result.idle
    (contact,) = result.contacts
    deviation = np.sqrt(max(contact.position_covariance[::3]))
    assert off(contact, (0, 0)) < deviation and deviation > 0.03
    assert abs(contact.force - 18.0) < 2 * contact.force_std
    assert contact.id == 0  # it is none that can be followed


def test_what_lies_on_an_electrode_names_none_while_there_is_no_time(layout):
    """A conductor at the drive voltage was "its reading never changes", and the contact that stood for all 0.004 N."""
    frame = sensor(layout, disc(*layout.positions[5], 0.006)).frame(0.0)
    pipeline = Pipeline(layout, Settings("auto", noise=NOISE, deadline=AT_ONCE))
    result = pipeline.process(frame, layout.grounded, DRIVE, row_period=ROW_PERIOD)
    assert not result.complete and not result.faults and not result.excluded
    assert result.state == "withheld" and not result.contacts


def test_what_stands_for_all_releases_no_contact_that_lasts(layout, frames, nine):
    """In the place of two that were known it was a release of both: the image is shown, contacts are withheld."""
    pipeline = Pipeline(layout, Settings("accurate"))
    known = pipeline.process(frames[0])
    cut = pipeline.process(replace(nine, stamp=frames[1].stamp), deadline=AT_ONCE)
    pipeline.stop()
    assert known.contacts and cut.contacts == [] and not cut.complete
    assert cut.state == "withheld" and "deadline" in cut.reason
    assert cut.pressure[np.isfinite(cut.pressure)].max() > 0


def test_a_search_that_ended_late_is_where_the_next_begins(layout, frames):
    """With its result, for the time of its own frame, and with the same ids all the way."""
    pipeline = Pipeline(layout, Settings("accurate"))
    first = pipeline.process(frames[0], deadline=AT_ONCE)
    pipeline._within._job and pipeline._within._job.wait(LIMIT)
    second = pipeline.process(frames[1], deadline=LIMIT)
    assert second.complete and second.holds > 0
    assert score_frame(second.contacts, load_scene("default").truth(frames[1].stamp)).missed == 0
    assert {c.id for c in first.contacts} <= {c.id for c in second.contacts}
    alone = Pipeline(layout, Settings("accurate"))
    alone.process(frames[0])
    whole = alone.process(frames[1])
    found = [[(c.x, c.y) for c in result.contacts] for result in (second, whole)]
    assert np.allclose(*found, atol=1e-6)


@pytest.mark.parametrize("rows", [False, True])
def test_a_late_result_says_for_when_it_holds_and_is_none_where_rows_have_told_since(
    layout, frames, rows
):
    """One of minutes ago, when rows had not been known yet, was told where they were lost for a moment: as the clock
    that frames and rows have was thought to be set back, all contacts got other numbers."""
    pipeline = Pipeline(layout, Settings("balanced"))
    gate = gated(pipeline)
    first = pipeline.process(frames[0], deadline=AT_ONCE)
    gate.set()
    pipeline._within._job.wait(LIMIT)
    state, count = pipeline.rows(), layout.electrodes
    for i in range(2 * count if rows else 0):
        frame, ground = frames[i // count], i % count
        time = frame.stamp + ground * frame.row_period
        said = pipeline.process_row(frame.voltages[ground], ground, 3.3, time, state)
    gate.clear()
    late = pipeline.process(frames[2 if rows else 1], deadline=0.2)
    gate.set()
    pipeline.stop()
    lasts = frames[0].row_period * (count - 1)
    assert not first.complete and first.holds == pytest.approx(lasts / 2)
    if rows:
        assert said.state == "valid" and late.holds >= 0
    else:
        assert not late.complete
        ends = frames[0].stamp + lasts
        assert frames[1].stamp + late.holds == pytest.approx(ends, abs=1e-9)


def test_deadlines_and_periods():
    assert Settings("auto").deadline == 0.05 and Settings("accurate").deadline is None
    assert Settings("auto", deadline=0.2).deadline == 0.2
    frame = Frame(np.zeros((16, 16)), np.arange(16), row_period=2e-3)
    assert period_of(frame) == pytest.approx(0.032)
    assert period_of(replace(frame, row_period=0.0)) == 0.05


def test_images_and_contacts_are_asked_for_one_by_one(layout, frames):
    first = Pipeline(layout, Settings("paper"))
    whole = first.process(frames[0])
    images = first.with_settings(Settings("paper", contacts=False)).process(frames[0])
    assert np.array_equal(images.potential, whole.potential, equal_nan=True)
    assert images.contacts == [] and not images.idle
    # the sheet holds currents back: two fingers of 3 and 5 N on 4 x 4 conduct as if they pressed a third
    force = np.nansum(images.pressure) * first.grid.cell_area
    assert 0.3 < force / sum(c.force for c in whole.contacts) <= 1.0
    for profile in ("fast", "accurate"):
        alone = Pipeline(layout, Settings(profile, image="none")).process(frames[0])
        both = Pipeline(layout, Settings(profile)).process(frames[0])
        assert alone.pressure.size == alone.potential.size == 0
        assert alone.contacts == both.contacts
    eq1 = first.with_settings(Settings("fast", image="paper")).process(frames[0])
    assert np.array_equal(eq1.potential, whole.potential, equal_nan=True)


def test_the_command_says_which_results_are_complete(tmp_path, capsys):
    recorded, out = tmp_path / "frames.npz", tmp_path / "result.npz"

    def run(*words):
        return main([*map(str, words), "--layout", "equal-4x4"])

    def kept(*words):
        assert run("reconstruct", recorded, "--out", out, *words) == 0
        with np.load(out) as file:
            return {name: file[name] for name in file}

    assert run("simulate", "--scene", "default", "--frames", "3", "--out", recorded) == 0
    accurate = kept("--profile", "accurate", "--deadline", "60")
    assert accurate["complete"].tolist() == [True, True, True]
    assert "within 6e+04 ms" in capsys.readouterr().out
    contacts = kept("--image", "none")
    assert "pressure" not in contacts and len(json.loads(str(contacts["contacts"]))[0]) == 2


def test_rows_are_told_once_what_a_search_found_late(layout, frames):
    """And then asked for anew: a profile that makes images looks at no frame otherwise."""
    pipeline = Pipeline(layout, Settings("fast"))
    state = pipeline.rows(waits=False)
    told, looks = [], []
    state.tell = told.append
    look = pipeline._rows.look
    pipeline._rows.look = lambda *given: (looks.append(given), look(*given))[1]
    for number in (0, 1, 2):
        frame = frames[number]
        words = frame.voltages, frame.grounded, frame.drive_voltage, frame.row_period, frame.stamp
        pipeline.process(frame, numbered=False, deadline=LIMIT)
        pipeline.correct(state, *words, clear=False, deadline=AT_ONCE if number == 0 else LIMIT)
        if number == 0:
            pipeline._within._job.wait(LIMIT)
    ended = [frames[n].stamp + frames[n].row_period * (layout.electrodes - 1) for n in (0, 2)]
    assert [seen.ended for seen in told] == pytest.approx(ended)
    assert len(looks) == 2


def test_neither_a_withheld_frame_nor_a_glance_ends_a_contact(layout, frames):
    """What was too soon to see, or could not be said, has not been let go."""
    pipeline = Pipeline(layout, Settings("accurate"))
    first = pipeline.process(frames[0])
    nonsense = replace(frames[1], voltages=np.ones((16, 16)) + np.arange(16))
    assert pipeline.process(nonsense).state == "withheld"
    glance, shows = pipeline._glance, frames[2]
    rest = replace(shows, voltages=np.zeros((16, 16)))
    pipeline._glance = lambda given: glance(given._replace(voltages=rest.voltages))
    gate = gated(pipeline)
    cut = pipeline.process(shows, deadline=AT_ONCE)
    gate.set()
    pipeline.stop()
    assert not cut.complete and cut.contacts == []
    last = pipeline.process(frames[3])
    assert {c.id for c in last.contacts} == {c.id for c in first.contacts} == {1, 2}
    # nothing is there, and all was tried
    assert pipeline.process(replace(rest, stamp=frames[4].stamp)).contacts == []
    assert {c.id for c in pipeline.process(frames[5]).contacts} == {3, 4}


def test_what_was_complete_stays_while_frames_repeat_it(layout, frames):
    """A press that rests is not another one because the machine has other things to do."""
    pipeline, random = Pipeline(layout, Settings("accurate")), np.random.default_rng(0)

    def cut(factor):
        noise = (random.normal(0, 1e-3, frames[0].voltages.shape) for _ in range(100))
        again = (replace(frames[0], voltages=factor * frames[0].voltages + each) for each in noise)
        results = (pipeline.process(each, deadline=AT_ONCE) for each in again)
        return next(result for result in results if not result.complete)

    def told(result):
        return [(c.x, c.y, c.force) for c in result.contacts]

    whole = pipeline.process(frames[0])
    assert whole.complete and told(cut(1.0)) == told(whole)
    assert told(cut(0.95)) != told(whole)
    pipeline.stop()
