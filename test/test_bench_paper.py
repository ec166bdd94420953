"""`tomotactile paper`: numbers of a separate program, images of the experiment, and the page."""

from html.parser import HTMLParser

import pytest

from tomotactile_ros import cli
from tomotactile_ros.bench.paper import experiment, page, pictures, simulation
from tomotactile_ros.bench.paper.article import EXPERIMENT, INDEPENDENT, REPORTED
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
    assert run.ratios == pytest.approx(INDEPENDENT[4]["closed-form"], abs=0.002)


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


class Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.cells, self.pictures = [], []

    def handle_starttag(self, tag, attrs):
        self.pictures += [dict(attrs)["src"]] if tag == "img" else []

    def handle_data(self, data):
        self.cells.append(data)


def test_the_page_has_each_number_beside_that_of_the_article(run, nodes, images, tmp_path):
    found = {"place": (0.0001, 0.0002), "force": (0.01, 0.02), "pairs": 0.5}
    rows = [("equal", images), ("optimized", images)]
    reader = Reader()
    reader.feed(page.page([run, nodes], rows, {4: [("equal", found)]}))
    assert any("closed form" in cell for cell in reader.cells)
    assert simulation.nearest([run, nodes]) == "closed-form"
    for value in REPORTED[4].ratios:
        assert any(f"{value:.3f}" in cell for cell in reader.cells)
    assert any(" / ".join(f"{each:.3f}" for each in run.ratios) == cell for cell in reader.cells)
    for equal, optimized in EXPERIMENT.values():
        assert f"{equal} → {optimized}" in reader.cells
    assert "0.100, 0.200" in reader.cells and "50 %" in reader.cells
    pictures.save_steps(tmp_path / "steps.png", [run])
    pictures.save_images(tmp_path / "images.png", rows)
    pictures.save_maps(tmp_path / "maps.png", [("equal", run.steps[0])], "")
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())


def test_what_cannot_be_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for words in (["--out", str(tmp_path / "file")], ["--workers", "0"]):
        assert cli.main(["paper", *words]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert cli.main(["paper", "--out", str(tmp_path / "new"), "--layout", "ring-16x"]) == 2
    assert not (tmp_path / "new").exists()
