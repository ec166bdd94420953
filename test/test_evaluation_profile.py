"""`evaluate --profile`: contacts off the lattice, of other sizes than assumed, on the sheet
only."""

import json

import numpy as np
import pytest

from tomotactile_ros import cli
from tomotactile_ros.evaluation import profile_quality
from tomotactile_ros.evaluation.profile_quality import evaluate_profile, off_lattice
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction import Settings

CORNERS = [[-0.1, -0.1], [0.1, -0.1], [0.1, -0.03], [-0.03, -0.03], [-0.03, 0.1], [-0.1, 0.1]]


@pytest.fixture(scope="module")
def ell():
    outline = Outline.polygon(CORNERS)
    every = equal_grid(6, 6, (0.2, 0.2), 0.0025, 1e4, inset=0.01).positions
    return Layout("ell", outline, 1e4, 0.0025, every[outline.contains(every)])


def test_places_lie_in_their_cells_and_nowhere_on_the_lattice(ell):
    grid = Grid.for_outline(ell.outline, 40)
    radii = np.array([0.002, 0.012])
    places, sizes = off_lattice(grid, radii, np.random.default_rng(0))
    pixel = np.abs(places[:, None] - grid.pixels).max(axis=2).argmin(axis=1)
    away = np.abs(places - grid.pixels[pixel])
    assert len(np.unique(pixel)) == len(places) and away.max() <= 0.0025
    assert 0.0010 < away.mean() < 0.0014  # evenly over the cell: a quarter of it
    assert ell.outline.contains(places).all()
    assert (ell.outline.rim_distance(places) >= sizes).all()
    near = ell.outline.rim_distance(places) < 0.0115
    assert (sizes[near] == 0.002).all() and set(sizes[~near]) == {0.002, 0.012}


def test_the_error_of_places_is_not_that_of_the_lattice():
    """Where contact, pixel and assumed size coincided it was 0.00 mm."""
    found = evaluate_profile(equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4), "balanced", resolution=8)
    assert Settings().contact_radius not in found.settings["contact_radius"]
    assert found.contacts["frames"] == len(found.quality.positions) > 55
    assert found.contacts["place"]["median"] > 5e-5
    assert found.contacts["force"]["median"] > 0.01
    assert (found.quality.position_error > 1e-4).mean() > 0.95


def test_regions_outside_the_outline_are_left_out(ell):
    found = evaluate_profile(ell, "fast", resolution=8)
    regions = found.by_region()
    places = {(region["row"], region["col"]) for region in regions}
    assert len(regions) == 8 and (2, 2) not in places
    assert sum(region["area"] for region in regions) == pytest.approx(ell.outline.area)
    assert sum(region["contacts"] for region in regions) == len(found.quality.positions)
    worst = max(region["hwhm"] for region in regions)
    assert found.metrics["hwhm"]["worst_region"] == worst


@pytest.mark.parametrize("every", [2, 1])
def test_withheld_images_are_in_no_figure(monkeypatch, capsys, every):
    class Withholding(profile_quality.Pipeline):
        count = 0

        def process(self, *frame):
            self.count += 1
            result = super().process(*frame)
            if self.count % every == 0:
                result.pressure, result.reason = np.full_like(result.pressure, np.nan), "torn"
            return result

    monkeypatch.setattr(profile_quality, "Pipeline", Withholding)
    words = ["evaluate", "--layout", "equal-4x4", "--profile", "fast", "--resolution", "4"]
    assert cli.main(words) == (0 if every == 2 else 2)
    said = capsys.readouterr()
    assert "nan" not in said.out and ("withheld 8, left out" in said.out) == (every == 2)
    assert every == 2 or "all images are withheld, the last one: torn" in said.err


def test_the_command_states_ghosts_and_misses_beside_places(capsys):
    words = ["evaluate", "--layout", "equal-4x4", "--profile", "fast", "--resolution", "5"]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert "ghosts" in said and "missed" in said and "OSPA" in said
    assert cli.main([*words, "--contact-radius", "0.004", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["settings"]["contact_radius"] == [0.004]
    assert {"ghosts", "missed", "place", "force", "ospa"} <= set(content["contacts"])
