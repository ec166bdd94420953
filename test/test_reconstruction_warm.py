"""Searches that start from the last frame: the same result, in fewer steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from tomotactile_ros.contact import Contact, ContactLaw
from tomotactile_ros.defects import Noise
from tomotactile_ros.layout import equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.active_set import Memory, descend, exchange, minimise
from tomotactile_ros.reconstruction.grounded import GroundedSheet, RecentBlock
from tomotactile_ros.scene import Scene
from tomotactile_ros.simulation import Simulator

DRIVE, LAW = 3.3, ContactLaw(1e-4, 1.0)
GROUNDED = np.arange(36)
LAYOUT = equal_grid(6, 6, (0.15, 0.15), 0.0025, 1e4, margin=0.005)


def recording(radius, count=8, step=0.0005):
    """(count, 36, 36) V of a disc that moves by `step` (m) from frame to frame, with 1 mV of
    noise."""
    contacts = [
        Contact("disc", center=(-0.02 + step * k, 0.013), radius=radius, pressure=20e3,
                start=float(k), end=float(k + 1))
        for k in range(count)
    ]  # fmt: skip
    simulator = Simulator(LAYOUT, Scene("moving", DRIVE, contacts, LAW, Noise(1e-3)), "closed_form")
    return [simulator.frame(k + 0.5, k) for k in range(count)]


SMALL, WIDE = recording(0.004), recording(0.025)


@pytest.fixture(scope="module", params=["balanced", "nonlinear"])
def pipeline(request):
    return Pipeline(LAYOUT, Settings(request.param, resolution=30))


def run(pipeline, frame):
    return pipeline.process(frame, GROUNDED, DRIVE).pressure


def steps(pipeline):
    return sum(memory.steps for memory in pipeline._make_image.memories)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 25), st.floats(0.0, 1.0), st.booleans())
def test_the_minimum_does_not_depend_on_the_start(seed, count, filled, blocks):
    random = np.random.default_rng(seed)
    matrix, right = random.standard_normal((30, count)), random.standard_normal(30)
    start = random.random(count) * (random.random(count) < filled)
    found, _ = minimise(matrix.T @ matrix, matrix.T @ right, start, blocks)
    assert found.min() >= 0
    assert found == pytest.approx(nnls(matrix, right)[0], abs=1e-7)


@pytest.mark.parametrize("search", [exchange, descend])
def test_from_the_solution_one_step_is_enough(search):
    random = np.random.default_rng(3)
    matrix, right = random.standard_normal((60, 40)), random.standard_normal(60)
    solution = nnls(matrix, right)[0]
    start = solution > 0 if search is exchange else solution
    found, count = search(matrix.T @ matrix, matrix.T @ right, start)
    assert count == 1
    assert found == pytest.approx(solution, abs=1e-12)


def test_singular_systems_end():
    for blocks in (True, False):
        found, _ = minimise(np.zeros((3, 3)), np.array([1.0, -1.0, 0.0]), np.zeros(3), blocks)
        assert np.isfinite(found).all()
        found, _ = minimise(np.ones((4, 4)), np.ones(4), np.ones(4), blocks)
        assert found.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("frames", [SMALL, WIDE], ids=["small", "wide"])
def test_images_do_not_depend_on_the_frames_before(pipeline, frames):
    warm = [run(pipeline, frame) for frame in frames]
    for frame, image in zip(frames, warm):
        run(pipeline, SMALL[0][::-1, ::-1])  # a contact elsewhere
        jumped = run(pipeline, frame)
        pipeline._make_image.forget()
        assert np.abs(run(pipeline, frame) - image).max() < 1e-4 * image.max()
        assert np.abs(jumped - image).max() < 1e-4 * image.max()


@pytest.mark.parametrize("frames", [SMALL, WIDE], ids=["small", "wide"])
def test_fewer_steps_while_contacts_move_slowly(pipeline, frames):
    cold, warm = 0, 0
    for frame in frames:
        pipeline._make_image.memories = Memory(np.zeros(900)), Memory(np.zeros(900))
        run(pipeline, frame)
        cold += steps(pipeline)
    for frame in frames:
        run(pipeline, frame)
        warm += steps(pipeline)
    assert warm < 0.75 * cold


def test_what_was_kept_is_dropped_when_something_else_changes(pipeline):
    def memory():
        return pipeline._make_image.memories[0].values

    run(pipeline, SMALL[0])
    assert memory() is not None
    run(pipeline, np.zeros((36, 36)))  # idle
    assert memory() is None
    run(pipeline, SMALL[0])
    pipeline.tare([(np.zeros((36, 36)), GROUNDED)])
    assert memory() is None
    run(pipeline, SMALL[0])
    pipeline.untare()
    assert memory() is None
    run(pipeline, SMALL[0])
    kept = memory()
    dead = SMALL[1].copy()
    dead[:, 17] = np.nan
    run(pipeline, dead)
    assert memory() is not kept
    assert (
        pipeline.with_settings(Settings("balanced", resolution=30))._make_image.memories[0].values
        is None
    )


def test_blocks_of_impedances_are_those_computed_anew():
    model = Pipeline(LAYOUT, Settings(resolution=20))._model
    sheet, recent = GroundedSheet(model.transfer), RecentBlock()
    for chosen in ([3, 40, 41, 300], [40, 41, 42, 299, 300], [5, 6], [5, 6]):
        expected = sheet.among(np.array(chosen))
        assert recent.among(sheet, np.array(chosen)) == pytest.approx(
            expected, abs=1e-9 * expected.max()
        )
    other = GroundedSheet(model.transfer, np.arange(35))
    assert recent.among(other, np.array([5, 6])) == pytest.approx(other.among([5, 6]))
