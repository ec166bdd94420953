"""Frames in a process of their own: the same answers, and no process that is left behind."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, disc, off, sensor
from process_support import python, running

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.beside import Beside
from tomotactile_ros.support.errors import InputError

LAYOUT = load_layout("equal-4x4")


@pytest.fixture
def beside():
    made = Beside()
    yield made
    made.stop()


def pipeline_of(profile="accurate", **settings):
    return Pipeline(LAYOUT, Settings(profile, **settings))


@pytest.fixture(scope="module")
def words():
    """What a pipeline is told of a frame."""
    voltages = sensor(LAYOUT, disc(0.02, -0.03, pressure=20e3), noise=0.0, adc=None).frame(0.0)
    return voltages, np.arange(16), DRIVE, 1e-3, 5.0


def until_it_takes(beside, pipeline):
    while not beside.takes(pipeline):
        time.sleep(0.02)


def said(pipeline, maker, words):
    """What a frame says, and what it tells rows that came with it."""
    state = pipeline.rows(waits=False)
    result = maker.process(*words)
    maker.correct(state, *words)
    return result, state.told()


def test_it_says_what_the_pipeline_says_and_another_one_does_after_it_was_killed(beside, words):
    here = pipeline_of()
    assert not beside.takes(here)  # it begins, and nobody waits for it
    until_it_takes(beside, here)
    for offset in (np.zeros(16), np.linspace(-0.02, 0.02, 16)):
        alone = pipeline_of()
        if offset.any():
            for each in (here, alone):
                each.use_baseline(np.tile(offset, (16, 1)))
        given = words[0] + offset, *words[1:]
        assert beside.takes(here)  # tares are told at once
        result, seen = said(here, beside, given)
        expected, expected_seen = said(here, alone, given)
        (one,), (other,) = result.contacts, expected.contacts
        assert off(one, (0.02, -0.03)) < 1e-3
        assert (one.x, one.y, one.force) == pytest.approx((other.x, other.y, other.force), rel=1e-3)
        np.testing.assert_allclose(result.pressure, expected.pressure, rtol=1e-2)
        assert (seen.begun, seen.ended) == (expected_seen.begun, expected_seen.ended)
        assert seen.fit.used == expected_seen.fit.used
    os.kill(beside.pid, signal.SIGKILL)
    with pytest.raises(ConnectionError, match="has ended"):
        beside.process(*words)
    here.untare()
    until_it_takes(beside, here)
    assert len(beside.process(*words).contacts) == 1


def test_other_settings_are_prepared_for_and_bad_frames_refused(beside, words):
    until_it_takes(beside, pipeline_of())
    coarse = pipeline_of(resolution=20)
    assert not beside.takes(coarse)
    until_it_takes(beside, coarse)
    assert beside.process(*words).pressure.shape == (20, 20)
    with pytest.raises(InputError, match="drive_voltage"):
        beside.process(*words[:2], -1.0, 1e-3, 5.0)
    assert beside.takes(coarse)  # and it goes on


def test_it_ends_with_whoever_started_it():
    """Even if that is killed, and so can end nothing."""
    program = (
        "import os, signal; from tomotactile_ros.reconstruction.beside import Beside; "
        "from tomotactile_ros.reconstruction import Pipeline, Settings; "
        "from tomotactile_ros.layouts.layout import load_layout; made = Beside(); "
        "made.takes(Pipeline(load_layout('equal-4x4'), Settings('fast'))); "
        "print(made.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    ended = python("-c", program, stderr=None)
    assert ended.returncode == -signal.SIGKILL
    while running(int(ended.stdout)):
        time.sleep(0.02)


class Grows:
    """Whoever takes it to pieces adds to what it belongs to, as another thread may."""

    def __init__(self, to):
        self.to = to

    def __reduce__(self):
        self.to.__dict__["worked_out"] = np.ones(3)
        return int, ()


def test_what_is_given_away_may_be_worked_at_meanwhile(beside):
    """Two nodes in a process have one layout, of which each works out what it needs: a driver failed, once,
    as it gave that to its process ("dictionary changed size during iteration")."""
    pipeline = pipeline_of()
    settings = replace(pipeline.settings)
    object.__setattr__(settings, "grows", Grows(settings))
    pipeline.settings = settings
    until_it_takes(beside, pipeline)
    assert "worked_out" in vars(settings)
