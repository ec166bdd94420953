"""A deadline: results in time, that are right within what they say, and go on from where searches end."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from process_support import python

from tomotactile_ros.cli import main
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.frame import Frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.deadline import Within, period_of
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
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


class Gate:
    """A search that ends when it is told to."""

    def __init__(self, outcome="found"):
        self.opened, self.outcome = threading.Event(), outcome

    def __call__(self):
        assert self.opened.wait(LIMIT)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


def anything(found):
    return True


def test_a_search_that_ends_in_time_is_the_result():
    within = Within()
    assert within.result(lambda: "found", lambda: "seen", LIMIT, anything) == "found"
    assert not within.busy and within.taken_late() is None


def test_a_search_that_takes_longer_is_the_result_of_the_call_in_which_it_ends():
    within, first, second = Within(), Gate("first"), Gate("second")
    assert within.result(first, lambda: "seen", AT_ONCE, anything) == "seen"
    assert within.busy
    assert within.result(second, lambda: "seen", AT_ONCE, anything) == "seen"
    first.opened.set()
    # the time until then is what a glance takes: it has to be the shorter one
    while within.result(second, lambda: "seen", 0.05, anything) != "first":
        pass
    second.opened.set()
    within._job.wait(LIMIT)
    assert within.result(lambda: "third", lambda: "seen", LIMIT, anything) == "third"
    assert within.taken_late() == "second"
    assert within.taken_late() is None  # it is told once


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


def test_errors_are_those_of_the_frame_that_they_are_about():
    within = Within()
    with pytest.raises(InputError, match="of the search"):
        within.result(_fails("of the search"), lambda: "seen", LIMIT, anything)
    gate = Gate(InputError("of a frame before"))
    with pytest.raises(InputError, match="of the glance"):
        within.result(gate, _fails("of the glance"), AT_ONCE, anything)
    within, gate = Within(), Gate(InputError("of a frame before"))
    within.result(gate, lambda: "seen", AT_ONCE, anything)
    gate.opened.set()
    assert within.result(lambda: "found", lambda: "seen", LIMIT, anything) == "found"
    within, gate = Within(), Gate(RuntimeError("a defect"))
    within.result(gate, lambda: "seen", AT_ONCE, anything)
    gate.opened.set()
    with pytest.raises(RuntimeError, match="a defect"):
        within.result(lambda: "found", lambda: "seen", LIMIT, anything)


def _fails(why):
    def fail():
        raise InputError(why)

    return fail


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


@pytest.mark.parametrize("profile", ["balanced", "accurate", "auto"])
def test_a_glance_is_right_within_its_deviations(layout, frames, profile):
    pipeline = Pipeline(layout, Settings(profile, deadline=AT_ONCE))
    # whoever waits for the interpreter may find the search at its end
    result = next(r for r in map(pipeline.process, frames * 20) if not r.complete)
    pipeline.stop()
    truth = load_scene("default").truth(frames[0].stamp)
    assert result.state == "valid"
    for contact in result.contacts:
        apart = min(np.hypot(contact.x - t["x"], contact.y - t["y"]) for t in truth)
        assert apart < 3 * np.sqrt(max(contact.position_covariance[::3])) + 1e-3
    assert np.isfinite(result.contacts[0].force_std)


def test_what_no_image_explains_is_told_as_one_contact_or_withheld(layout):
    """Nine fingertips on 4 x 4: their image has no discs that explain it."""
    places = 0.05 * (np.indices((3, 3)).reshape(2, -1).T - 1)
    scene = load_scene("default")
    touches = [
        {"shape": "disc", "center": place.tolist(), "radius": 0.012, "force": 2.0}
        for place in places
    ]
    simulator = Simulator(layout, _with_contacts(scene, touches))
    frame = simulator.measure(0.0)
    pipeline = Pipeline(layout, Settings("accurate", deadline=AT_ONCE))
    result = pipeline.process(frame)
    pipeline.stop()
    assert not result.complete and not result.idle
    (contact,) = result.contacts
    deviation = np.sqrt(max(contact.position_covariance[::3]))
    assert np.hypot(contact.x, contact.y) < deviation and deviation > 0.03
    assert abs(contact.force - 18.0) < 2 * contact.force_std
    assert contact.id == 0  # it is none that can be followed


def test_what_stands_for_all_releases_no_contact_that_lasts(layout, frames):
    """In the place of two that were known it was a release of both: the image is shown, contacts are withheld."""
    pipeline = Pipeline(layout, Settings("accurate"))
    known = pipeline.process(frames[0])
    touches = [
        {"shape": "disc", "center": [x, y], "radius": 0.012, "force": 2.0}
        for x in (-0.05, 0.0, 0.05)
        for y in (-0.05, 0.0, 0.05)
    ]
    many = Simulator(layout, _with_contacts(load_scene("default"), touches)).measure(0.0)
    cut = pipeline.process(replace(many, stamp=frames[1].stamp), deadline=AT_ONCE)
    pipeline.stop()
    assert known.contacts and cut.contacts == [] and not cut.complete
    assert cut.state == "withheld" and "deadline" in cut.reason
    assert cut.pressure[np.isfinite(cut.pressure)].max() > 0


def _with_contacts(scene, touches):
    return replace(scene, contacts=tuple(Contact(**each) for each in touches), noise=scene.noise)


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


def test_what_rows_have_told_since_makes_a_late_result_none(layout, frames):
    """One of minutes ago, when rows had not been known yet, was told where they were lost for a moment: as the clock
    that frames and rows have was thought to be set back, all contacts got other numbers."""
    pipeline = Pipeline(layout, Settings("balanced"))
    gate, search = threading.Event(), pipeline._process
    pipeline._process = lambda given: (gate.wait(LIMIT), search(given))[1]
    pipeline.process(frames[0], deadline=AT_ONCE)
    gate.set()
    pipeline._within._job.wait(LIMIT)
    state = pipeline.rows()
    for i in range(2 * layout.electrodes):
        frame, ground = frames[i // layout.electrodes], i % layout.electrodes
        row, time = frame.voltages[ground], frame.stamp + ground * frame.row_period
        said = pipeline.process_row(
            row, int(frame.grounded[ground]), frame.drive_voltage, time, state
        )
    gate.clear()
    told = pipeline.process(frames[2], deadline=0.2)
    gate.set()
    pipeline.stop()
    assert said.state == "valid" and told.holds >= 0


def test_a_late_result_says_for_when_it_holds(layout, frames):
    pipeline = Pipeline(layout, Settings("balanced"))
    gate, search = threading.Event(), pipeline._process
    pipeline._process = lambda given: (gate.wait(LIMIT), search(given))[1]
    told = [pipeline.process(frames[0], deadline=AT_ONCE)]
    gate.set()
    pipeline._within._job.wait(LIMIT)
    gate.clear()
    told.append(pipeline.process(frames[1], deadline=0.2))
    gate.set()
    pipeline.stop()
    assert [result.complete for result in told] == [False, False]
    lasts = frames[0].row_period * (layout.electrodes - 1)
    assert frames[1].stamp + told[1].holds == pytest.approx(frames[0].stamp + lasts, abs=1e-9)
    assert told[0].holds == pytest.approx(lasts / 2)


def test_profile_auto_is_accurate_in_time():
    assert Settings("auto").deadline == 0.05 and Settings("accurate").deadline is None
    assert Settings("auto", deadline=0.2).deadline == 0.2


def test_the_time_of_a_frame_is_that_until_the_next():
    frame = Frame(np.zeros((16, 16)), np.arange(16), row_period=2e-3)
    assert period_of(frame) == pytest.approx(0.032)
    assert period_of(Frame(np.zeros((16, 16)), np.arange(16))) == 0.05


def test_images_and_contacts_are_asked_for_one_by_one(layout, frames):
    whole = Pipeline(layout, Settings("paper")).process(frames[0])
    images = Pipeline(layout, Settings("paper", contacts=False)).process(frames[0])
    assert np.array_equal(images.potential, whole.potential, equal_nan=True)
    assert images.contacts == [] and not images.idle
    # the sheet holds currents back: two fingers of 3 and 5 N on 4 x 4 conduct as if they pressed a third
    force = np.nansum(images.pressure) * Pipeline(layout, Settings()).grid.cell_area
    assert 0.3 < force / sum(c.force for c in whole.contacts) <= 1.0
    for profile in ("fast", "accurate"):
        alone = Pipeline(layout, Settings(profile, image="none")).process(frames[0])
        both = Pipeline(layout, Settings(profile)).process(frames[0])
        assert alone.pressure.size == alone.potential.size == 0
        assert alone.contacts == both.contacts
    eq1 = Pipeline(layout, Settings("fast", image="paper")).process(frames[0])
    assert np.array_equal(eq1.potential, whole.potential, equal_nan=True)


@pytest.mark.parametrize(
    "given, why",
    [
        ({"image": "none", "contacts": False}, "nothing to do"),
        ({"image": "contacts", "contacts": False}, "draws the contacts"),
        ({"image": "wide"}, "is none of none, paper, contacts"),
        ({"deadline": 0.0}, "deadline"),
        ({"deadline": float("nan")}, "deadline"),
    ],
)
def test_what_cannot_be_done_is_refused(given, why):
    with pytest.raises(InputError, match=why):
        Settings(**given)


def test_the_command_says_which_results_are_complete(tmp_path, capsys):
    recorded, out = tmp_path / "frames.npz", tmp_path / "result.npz"
    common = ["--layout", "equal-4x4", "--out"]
    scene = ["simulate", "--scene", "default", "--frames", "3", *common, recorded]
    assert main(list(map(str, scene))) == 0
    asked = ["reconstruct", recorded, *common, out]
    assert main(list(map(str, [*asked, "--profile", "accurate", "--deadline", "60"]))) == 0
    with np.load(out) as kept:
        assert kept["complete"].tolist() == [True, True, True]
    assert "within 6e+04 ms" in capsys.readouterr().out
    assert main(list(map(str, [*asked, "--image", "none"]))) == 0
    with np.load(out) as kept:
        assert "pressure" not in kept and len(json.loads(str(kept["contacts"]))[0]) == 2
    assert main(list(map(str, [*asked, "--no-contacts"]))) == 0
    with np.load(out) as kept:
        assert json.loads(str(kept["contacts"])) == [[], [], []]
        assert np.nanmax(kept["potential"]) > 0
    assert main(list(map(str, [*asked, "--no-contacts", "--image", "none"]))) == 2
    assert "nothing to do" in capsys.readouterr().err


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
    gate, search = threading.Event(), pipeline._process
    pipeline._process = lambda given: (gate.wait(LIMIT), search(given))[1]
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
