"""Layouts for touch: the search, what it keeps, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.evaluation.posterior import Conditions, expected
from tomotactile_ros.layouts.arrangements import spread_electrodes
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region, regular_polygon
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.request import Request
from tomotactile_ros.optimizer.step import best_of
from tomotactile_ros.optimizer.touch import TouchObjective, TouchSearch, touch
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces import Cylinder

SQUARE = (0.2, 0.2)
POOR = equal_grid(3, 3, SQUARE, 0.008, 1e4, 0.045)  # far from the rim, and large


def objective_of(layout, conditions, places):
    """Relative to the layout itself."""
    found = expected(layout, conditions, places, pairs=24)
    return TouchObjective(layout, conditions, found.lengths, places)


def test_a_poor_start_gets_better_at_places_that_the_search_did_not_see():
    """Nine electrodes gathered in the middle: where they should be is plain, further out."""
    poor = equal_grid(3, 3, SQUARE, 0.006, 1e4, 0.055)
    constraints = Constraints(poor.outline, 0.02, margin=0.01)
    conditions = Conditions(apart=0.06)
    how = {"conditions": conditions, "starts": 1, "places": 6, "rounds": 1, "resolution": 12}
    history, best = best_of(touch(poor, constraints=constraints, **how))
    assert [step.iteration for step in history] == [0, 1]
    assert history[0].score == 1.0 and best.score < 0.9
    before, after = (expected(s.layout, conditions, 7).place for s in (history[0], best))
    assert after.mean() < 0.9 * before.mean()
    assert np.abs(best.layout.positions).max() > 0.046


def test_a_start_in_the_middle_is_drawn_out_to_the_rim_and_gets_much_better():
    """Step by step it would not: pairs get a little worse before all gets better."""
    constraints = Constraints(POOR.outline, 0.0176, margin=0.004)
    search = TouchSearch(objective_of(POOR, Conditions(apart=0.04), 4), constraints, None, True)
    start, full = search.first(0), search.first(1)
    assert np.array_equal(start.positions, POOR.positions) and start.score == pytest.approx(1.0)
    assert np.abs(full.positions).max() == pytest.approx(0.096, abs=1e-6)
    assert constraints.kept_by(full.positions)
    assert full.score < 0.6
    unseen = objective_of(POOR, Conditions(apart=0.04), 7)
    assert unseen.score(unseen.posterior(full.positions, full.radius)) < 0.6


def test_what_was_given_is_kept():
    """An electrode that is fixed, a zone to keep out of on one side, a margin, the symmetries."""
    zone = Region(regular_polygon(0.012) + [0.05, 0.0])
    constraints = Constraints(POOR.outline, 0.018, 0.01, (zone,), (4,))
    objective = objective_of(POOR, Conditions(apart=0.06), 3)
    search = TouchSearch(objective, constraints, (0.003, 0.006), True)
    trial = search.improve(search.first(0), 3, 5)
    assert np.array_equal(trial.positions[4], POOR.positions[4])
    assert np.linalg.norm(trial.positions - [0.05, 0.0], axis=1).min() > 0.012 - 1e-4
    assert constraints.kept_by(trial.positions)
    mirrored = trial.positions.reshape(3, 3, 2)[::-1].reshape(-1, 2)
    assert np.abs(trial.positions * [1, -1] - mirrored).max() < 1e-9
    assert 0.003 <= trial.radius <= 0.006


def test_a_figure_that_gets_worse_is_not_paid_for_by_another():
    start = np.array([1e-4, 3e-4, 0.02])
    objective = TouchObjective(POOR, Conditions(), start, 4)

    class Found:
        lengths = start * [0.8, 1.05, 1.0]

    traded = objective.score(Found)
    Found.lengths = start * [0.95, 1.0, 1.0]
    assert objective.score(Found) < 1.0 < 1.2 * traded
    assert objective.score(Found) < traded * np.exp(0.05)


@pytest.mark.parametrize(
    "outline",
    [
        Outline.circle(0.08),
        Outline.polygon([[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]),
        Outline.rectangle(0.2, 0.1, holes=(np.array([[-0.02, -0.02], [0.02, -0.02], [0, 0.02]]),)),
    ],
)
def test_electrodes_are_spread_over_any_outline(outline):
    layout = spread_electrodes(12, outline, None, 1e4)
    assert layout.electrodes == 12
    spacing = np.sqrt(outline.area / 12)
    assert layout.pitches.min() > 0.6 * spacing
    assert outline.rim_distance(layout.positions).min() > 0.2 * spacing


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"fixed": (9,)}, "fixed"),
        ({"radius_range": (0.004, 0.002)}, "is no range"),
        ({"radius_range": (0.001, 0.06)}, "spacing"),
        ({"fixed": (0,), "keep_out": ((-0.055, -0.055, 0.01),)}, "fixed: these electrodes violate"),
        ({"spacing": 0.003}, "lets electrodes of 0.008 m radius overlap"),
        ({"spacing": 0.15}, "do not fit 0.15 m apart"),
        ({"margin": 0.1}, "leaves no room"),
        ({"margin": -0.1}, "margin: -0.1 is negative"),
        ({"noise": -1.0}, "noise"),
        ({"contact_radius": 0.11}, "no disc of 0.11 m has room on the sheet"),
        ({"apart": 0.28}, "apart: no pair of contacts that is tried has room"),
    ],
)
def test_impossible_requests_are_one_line(given, message):
    with pytest.raises(InputError, match=message):
        next(Request(POOR, "touch", steps=0, **given).steps_of())


def test_the_command_takes_touch_by_default_and_any_outline(tmp_path):
    out = tmp_path / "disc.yaml"
    words = ["optimize", "--electrodes", "5", "--circle", "0.05", "--starts", "1", "--steps", "0"]
    words += ["--fixed", "0", "--fixed", "0"]  # once said twice
    words += ["--workers", "1", "--resolution", "12", "--apart", "0.04", "--out", str(out)]
    assert main(words) == 0
    layout: Layout = load_layout(out)
    assert (layout.outline.kind, layout.electrodes) == ("circle", 5)
    provenance = layout.provenance
    assert provenance["algorithm"] == "touch"
    assert provenance["metrics"]["after"]["touch"]["place"]["mean"] > 0
    assert "--electrodes 5 --circle 0.05" in provenance["settings"]["command"]
    assert provenance["settings"]["fixed"] == [0]
    assert out.with_suffix(".png").exists()
    assert not out.with_suffix(".search.json").exists()  # it has ended


def test_a_sheet_narrower_than_a_fingertip_is_judged_by_smaller_contacts(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("tomotactile_ros.optimizer.touch_report.save_figure", lambda *_: None)
    path, out = str(tmp_path / "thin.yaml"), str(tmp_path / "out.yaml")
    equal_grid(2, 4, (0.03, 0.008), 0.0005, 1e4).save(path)
    evaluate = ["evaluate", "--layout", path, "--resolution", "12"]
    assert main(evaluate) == 0
    said = capsys.readouterr()
    assert "expected errors" not in said.out and "left out" in said.err
    assert main([*evaluate, "--touch-radius", "0.001", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["touch"]["contact_radius"] == 0.001
    words = ["optimize", "--layout", path, "--steps", "0", "--workers", "1", "--out", out]
    assert main(words) == 2
    assert main([*words, "--contact-radius", "0.001", "--resolution", "12"]) == 0
    assert load_layout(out).provenance["settings"]["contact_radius"] == 0.001


def test_more_rows_and_more_electrodes_are_never_expected_to_be_worse(tmp_path, capsys):
    out = tmp_path / "fast.yaml"
    sheet = replace(equal_grid(2, 2, (0.1, 0.1), 0.002, 1e4), surface=Cylinder(0.04))
    sheet.save(tmp_path / "sleeve.yaml")
    words = ["optimize", "--layout", str(tmp_path / "sleeve.yaml"), "--explore", "4", "9"]
    words += ["--place", "0.003", "--frame-time", "0.008", "--out", str(out)]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    table = np.array([line.split() for line in lines[1:-1]], float)
    assert table[:, :2].tolist() == [[4, 2], [4, 4], [9, 2], [9, 4], [9, 8], [9, 9]]
    four, nine = table[:2, 3], table[2:, 3]
    assert np.all(np.diff(four) < 0) and np.all(np.diff(nine) < 0)
    assert nine[-1] < four[-1]
    layout = load_layout(out)
    good = table[(table[:, 4] <= 3000) & (table[:, 2] <= 8)]
    assert layout.electrodes == good[:, 0].min()
    assert layout.surface == sheet.surface  # bent as the sheet that was given
    assert out.with_suffix(".png").exists()
    assert main([*words, "--place", "1e-7"]) == 2
    assert "none of these numbers" in capsys.readouterr().err
