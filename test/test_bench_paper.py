"""`tomotactile paper`: numbers of a separate program, images of the experiment, contacts on layouts,
and the page."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.bench.paper import contacts, experiment, page, pictures, simulation
from tomotactile_ros.bench.paper.article import EXPERIMENT, REPORTED
from tomotactile_ros.bench.paper.contacts import EVEN, UNEVEN
from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout


@pytest.fixture(scope="module")
def run():
    return simulation.optimize(4, "closed-form")


@pytest.fixture(scope="module")
def nodes():
    return simulation.optimize(4, "point-nodes")


@pytest.fixture(scope="module")
def images():
    return experiment.images(load_layout("equal-8x8"))


def test_three_updates_of_the_closed_form_are_those_of_a_separate_program(run):
    assert len(run.steps) == 1 + REPORTED[4].updates
    assert run.ratios == pytest.approx((0.936, 0.817, 0.830), abs=0.002)


def test_contacts_of_inset_cells_are_near_those_of_a_separate_program():
    """Mean and worst region to 0.01; its position errors are another 0.03 off."""
    inset = simulation.optimize(4, "fem-inset")
    assert inset.ratios[:2] == pytest.approx((0.965, 0.862), abs=0.01)
    assert np.abs(inset.steps[0].quality.positions).max() == pytest.approx(0.095)


def test_contacts_at_the_pixels_are_those_that_are_not_given():
    layout = load_layout("equal-4x4")
    pixels = Grid.for_outline(layout.outline, 12).pixels
    for model in ("paper", "fem"):
        plain = evaluate_layout(layout, model=model, resolution=12).quality
        given = evaluate_layout(layout, model=model, resolution=12, contacts=pixels).quality
        assert given.hwhm == pytest.approx(plain.hwhm, rel=1e-6)
        assert given.position_error == pytest.approx(plain.position_error, abs=1e-9)


def test_a_point_spread_is_what_the_maps_say_of_its_contact(nodes):
    start = nodes.steps[0]
    for spread in simulation.spreads(start.layout, 4).values():
        (pixel,) = np.flatnonzero((start.quality.positions == spread.contact).all(axis=1))
        assert spread.hwhm == pytest.approx(start.quality.hwhm[pixel], rel=1e-6)
        assert spread.error == pytest.approx(start.quality.position_error[pixel], abs=1e-9)
        assert np.nanmax(spread.image) == 1


def test_images_show_conductors_where_they_are(images):
    """The middle of what is above half of the maximum is within two pixels of the conductor."""
    for place in experiment.CONDUCTORS:
        assert images[place].error < 0.01
    assert images["corner"].hwhm < images["centre"].hwhm
    assert images["two points"].hwhm is None


def test_two_points_are_told_apart_and_the_l_is_no_square(images):
    two = images["two points"].potential
    assert two[19:21, 19:21].mean() < 0.9 * min(two[19:21, 9:11].mean(), two[19:21, 29:31].mean())
    bent = images["L-shape"].potential
    assert bent[24:30, 10:16].mean() > 1.5 * bent[10:16, 24:30].mean()


def test_all_layouts_of_an_outline_get_the_same_contacts():
    one = load_layout("equal-4x4")
    other = replace(one, positions=0.8 * one.positions, radius=0.002)
    states = [contacts.touches(layout, 4).states for layout in (one, other)]
    cases = [*[EVEN] * 4, *[UNEVEN] * 4, *["32 mm apart"] * 2, *["40 mm apart"] * 2]
    assert [state.case for state in states[0]] == cases
    places = [[press.shape.center for state in each for press in state.contacts] for each in states]
    assert np.array_equal(*places)
    sheets = [state.sheet for state in states[0]]
    assert sheets[:4] == [0] * 4 and 0 not in sheets[4:8]


def test_contacts_are_found_on_frames_of_the_reference_model():
    found = contacts.found(load_layout("equal-4x4"), 1)
    assert found.place[EVEN][0] < 0.001 and found.force[EVEN][0] < 0.5
    assert list(found.told) == [0.032, 0.04]


def test_the_interval_of_a_ratio_is_of_the_same_contacts():
    """Twice as large, contact by contact: certainly two, however much they differ."""
    first = np.random.default_rng(1).exponential(1.0, 30)
    assert contacts.ratio(2 * first, first, "mean") == pytest.approx((2, 2, 2))
    among = contacts.ratio(first[::-1], first, "p95")
    assert among[1] < 1 < among[2]


def found(place):
    errors = {EVEN: np.array([place, 2 * place]), UNEVEN: np.array([place, place])}
    force = {EVEN: np.array([0.01, 0.01]), UNEVEN: np.array([0.02, 0.02])}
    return contacts.Found(errors, force, {0.032: 0.5, 0.04: 1.0})


def trial(words, first, second):
    optimized = np.array([first, second])
    return experiment.Trial(words, {each: (np.full(2, 0.02), optimized) for each in EXPERIMENT})


def test_the_page_has_each_number_beside_that_of_the_article(run, nodes, images, tmp_path):
    rows = [("equal", images), ("optimized", images)]
    trials = [trial("nothing", 0.01, 0.01), trial("joints", 0.017, 0.021)]
    both = [("equal", found(0.0001)), ("mine", found(0.0002))]
    eight = [replace(each, count=8) for each in (run, nodes)]
    text = page.page([run, nodes, *eight], rows, trials, [page.Group("4 × 4", "maps.png", both)])
    cells = re.split("<[^>]+>", text)
    assert simulation.nearest([run, nodes]) == "closed-form"
    for value in REPORTED[4].ratios:
        assert any(f"{value:.3f}" in cell for cell in cells)
    assert " / ".join(f"{each:.3f}" for each in run.ratios) in cells
    away = [f"{a - b:+.3f}" for a, b in zip(run.ratios, REPORTED[4].ratios)]
    assert " / ".join(away) in cells
    for equal, optimized in EXPERIMENT.values():
        assert f"{equal} → {optimized} (× {optimized / equal:.2f})" in cells
    assert "10.0, × 0.50 (0.50 to 0.50)" in cells
    assert "“joints” changed leaves the least" in text
    assert "within these limits at side × 0.86, corner × 1.02:" in text
    assert "outside at centre × 0.80:" in text
    assert "0.150, 0.195" in cells and "50 %" in cells
    assert any(cell.startswith("× 2.00 (2.00 to 2.00)") for cell in cells)
    spreads = [("equal", simulation.spreads(run.steps[0].layout, 4))]
    pictures.save_spreads(tmp_path / "spreads.png", spreads, "")
    pictures.save_steps(tmp_path / "steps.png", [run])
    pictures.save_images(tmp_path / "images.png", rows[:1])
    pictures.save_maps(tmp_path / "maps.png", [("equal", run.steps[0])], "")
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())
