"""Pictures: colours mean pressures, contacts and electrodes are where they belong."""

import io
import json
import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.commands.reconstruct import contact_entry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW, ContactEstimate, Result
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.view import display as display_module
from tomotactile_ros.view.colours import OUTSIDE, Overlay, SteadyScale, colour, palette, round_up
from tomotactile_ros.view.contact_lines import contact_lines, numbers_of, other_line, pair
from tomotactile_ros.view.display import Display, Shot
from tomotactile_ros.view.figure import plot, save_pressure
from tomotactile_ros.view.page_parts import table_of
from tomotactile_ros.view.terminal import picture
from tomotactile_ros.view.trails import Trails

LAYOUT = load_layout("equal-4x4")
GRID = Grid.for_outline(LAYOUT.outline, 40)
UPPER_RIGHT = ContactEstimate(0.05, 0.07, 2.0, 2e4, 1e-4, 0.01, force_std=0.1)
IN_THE_MIDDLE = replace(UPPER_RIGHT, x=0.0, y=0.0)


def true(x, y=0.07, force=1.0, pressure=1e4):
    return {"x": x, "y": y, "force": force, "pressure": pressure}


def pressed(contact) -> np.ndarray:
    near = np.linalg.norm(GRID.pixels - (contact.x, contact.y), axis=1) < contact.radius
    return GRID.fill(np.where(near, 1e4, 0.0))


PRESSED = pressed(UPPER_RIGHT)
RESULT = Result(PRESSED, PRESSED, [UPPER_RIGHT], (), False, 0.0)
BARE = ContactEstimate(0.01, 0.02, 2.3651, 2.5e4, 7.9e-5, 0.005, (1e-8, 0, 0, 4e-8), math.inf)


def test_colours_run_from_nothing_to_full_scale():
    rgb = colour(np.array([[0.0, 500.0, 1000.0, 5000.0, -3.0, np.nan]]), 1000.0)[0].tolist()
    first, middle, last = (palette()[i].tolist() for i in (0, 128, 255))
    assert rgb == [first, middle, last, last, first, list(OUTSIDE)]


def test_a_contact_is_drawn_in_the_upper_right_and_electrodes_at_their_places():
    overlay = Overlay(GRID, 4, LAYOUT.positions, LAYOUT.radius)
    drawn = overlay.draw(np.zeros((40, 40, 3), np.uint8), [UPPER_RIGHT])
    assert drawn.shape == (160, 160, 3)
    red = (drawn == (255, 64, 64)).all(axis=2)
    rows, columns = np.nonzero(red)
    assert (rows.mean(), columns.mean()) == pytest.approx(
        (0.15 * 160 - 0.5, 0.75 * 160 - 0.5), abs=1
    )
    assert np.hypot(rows - rows.mean(), columns - columns.mean()).max() <= 10 / 1.25 + 2
    white = (drawn == 255).all(axis=2)
    assert white[0, 0] and white[-1, -1] and not white[40, 30]
    assert not (overlay.draw(np.zeros((40, 40, 3), np.uint8), [], electrodes=False)).any()


def test_the_terminal_shows_a_contact_in_the_upper_right():
    lines = picture(PRESSED, LAYOUT.outline.bounds, 1e4, 100, 40)
    assert len(lines) == 21
    brightest = "{};{};{}".format(*palette()[255])
    cells = [re.findall(r"38;2;([\d;]+?);48;2", line)[:40] for line in lines[:-1]]
    found = np.argwhere(np.array(cells) == brightest)
    assert found[:, 0].max() < 10 and found[:, 1].min() >= 20
    assert lines[0].lstrip().startswith("+100") and lines[0].endswith("10 kPa")
    assert re.sub(r"\s+", " ", lines[-1]).strip() == "-100 0 +100 mm"


@pytest.mark.parametrize("columns, lines", [(30, 10), (80, 24), (10, 3), (300, 100)])
@pytest.mark.parametrize("shape", [(40, 40), (41, 7), (1, 1), (200, 150)])
def test_the_picture_fits_the_terminal(shape, columns, lines):
    image = np.full(shape, 10.0)
    image[0, 0] = 2000.0
    text = picture(image, (-0.1, -0.1, 0.1, 0.1), 2000.0, columns, lines)
    assert len(text) <= max(lines, 6)
    for line in text[:-1]:
        assert len(re.sub(r"\x1b\[[\d;]*m", "", line)) <= max(columns, 8 + 19)


def test_the_figure_is_written_with_holes_contacts_and_truth(tmp_path):
    from PIL import Image

    image = PRESSED.copy()
    image[0, 0] = np.nan
    truth = [true(0.05, force=None, pressure=None)]
    save_pressure(tmp_path / "new/p.png", image, LAYOUT, [UPPER_RIGHT], truth, "title")
    with Image.open(tmp_path / "new/p.png") as figure:
        pixels = np.asarray(figure.convert("RGB")).astype(int)
    yellow = np.argwhere((abs(pixels - palette()[255]) < 12).all(axis=2))
    plot = yellow[yellow[:, 1] < 0.75 * pixels.shape[1]]  # not the colour bar
    assert len(plot) > 100
    assert plot[:, 0].max() < 0.45 * pixels.shape[0] and plot[:, 1].min() > 0.4 * pixels.shape[1]


def test_contacts_are_paired_with_the_nearest_truth():
    here, there = (replace(UPPER_RIGHT, x=x) for x in (0.0, 0.08))
    truth = [true(0.09), true(0.01)]
    assert pair([here, there], truth) == [1, 0]
    assert pair([here, there], truth[:1]) == [None, 0]
    lines = contact_lines([here, there], truth[:1])
    assert "nothing is there" in lines[0]
    assert lines[1].endswith("  off by 10.0 mm, true 1.00 N 10.0 kPa")
    missed = "not found: ( +90.0,  +70.0) mm, true 1.00 N 10.0 kPa"
    assert contact_lines([here], truth)[-1] == missed
    bare = [true(0.0, force=None, pressure=None)]
    assert contact_lines([here], bare)[0].endswith("  off by  0.0 mm")
    assert contact_lines([], None) == contact_lines([], []) == ["no contact"]
    assert other_line(None) == [] and other_line([]) == ["or, nearly as likely: no contact"]
    assert other_line([here, there])[0].count(" mm") == 2


def test_the_force_of_a_bare_conductor_is_called_a_bound_wherever_it_stands(tmp_path, capsys):
    assert "at least 2.37 N" in repr(BARE)
    assert "  at least  2.37 N" in contact_lines([BARE])[0]
    assert ">at least 2.37<" in table_of([BARE], None, True)
    sure, image = replace(BARE, force_std=0.1), replace(BARE, position_covariance=(math.nan,) * 4)
    for contact, told in (
        (BARE, "at least 2.37 N\n"),
        (sure, ", 2.37 N ± 0.1 N\n"),
        (image, ", 2.37 N\n"),
    ):
        text = json.dumps([[contact_entry(contact)]])
        np.savez(tmp_path / "result.npz", pressure=np.zeros((1, 4, 4), np.float32), contacts=text)
        assert main(["inspect", str(tmp_path / "result.npz")]) == 0
        assert told in capsys.readouterr().out


def test_what_stands_for_all_of_a_frame_that_was_cut_has_no_number_and_is_off_by_nothing():
    truth = [true(0.09), true(0.01)]
    (line,) = contact_lines([UPPER_RIGHT], truth, complete=False)
    assert line == "something presses about ( +50.0,  +70.0) mm  about  2.00 N"
    assert line in table_of([UPPER_RIGHT], truth, True, complete=False)
    assert numbers_of([UPPER_RIGHT], complete=False) == [0]
    assert numbers_of([UPPER_RIGHT] * 2, complete=False) == [1, 2]  # each of them was found
    followed = replace(UPPER_RIGHT, id=7)
    assert contact_lines([followed], truth, complete=False)[0].startswith("contact 7: ")
    assert "something presses" in plot(replace(RESULT, complete=False), LAYOUT).get_supxlabel()
    overlay = Overlay(GRID, 4, LAYOUT.positions, LAYOUT.radius)
    nothing = np.zeros((40, 40, 3), np.uint8)
    whole, broken = (
        (overlay.draw(nothing, [UPPER_RIGHT], False, c) > 0).sum() for c in (True, False)
    )
    assert 0.3 < broken / whole < 0.7


def test_without_a_contact_law_no_force_is_invented(capsys, tmp_path):
    display, image = Display(LAYOUT, load_scene("experiment-centre")), pressed(IN_THE_MIDDLE)
    display.show(Shot(image, [IN_THE_MIDDLE], scene_time=1.0, rate=15.0, age=0.01))
    display.save(str(tmp_path / "bare.svg"))
    line = capsys.readouterr().out.splitlines()[0]
    assert line.endswith("contact 1: (  +0.0,   +0.0) mm  off by  0.0 mm")
    lines = picture(image, LAYOUT.outline.bounds, 0.5, 80, 20, calibrated=False)
    assert lines[0].endswith("0.5 S/m²") and not any("Pa" in line for line in lines)


def test_a_plot_of_a_result_without_a_contact_law_shows_its_conductance():
    axes = plot(RESULT.without_law(DEFAULT_LAW), LAYOUT).axes[0]
    shown = axes.images[0].get_array()
    np.testing.assert_allclose(np.nanmax(shown), 1e-4 * np.nanmax(PRESSED))
    assert axes.child_axes[0].get_ylabel() == "conductance / (S/m²)"
    assert np.nanargmax(shown) == np.nanargmax(PRESSED)


@pytest.mark.parametrize(
    "result, truth, newtons",
    [
        (RESULT.without_law(DEFAULT_LAW), None, False),
        (RESULT, [true(0.05, force=None, pressure=2e4)], False),  # beside bare conductors
        (RESULT, [true(0.05, force=2.0, pressure=2e4)], True),
    ],
)
def test_a_plot_has_newtons_only_where_there_is_a_contact_law(result, truth, newtons):
    below = plot(result, LAYOUT, truth).get_supxlabel()
    assert (" N" in below) == newtons and ("no contact law" in below) != newtons


def test_a_withheld_result_says_why_and_not_that_there_is_no_contact():
    reason = "voltages: the readings fit wide only if its electrodes are numbered column by column"
    nothing = np.full_like(PRESSED, np.nan)
    figure = plot(Result(nothing, nothing, [], (), False, 0.0, "withheld", reason), LAYOUT)
    assert reason in " ".join(figure.get_suptitle().split())
    assert max(map(len, figure.get_suptitle().splitlines())) < 70
    assert figure.get_supxlabel() == "contacts are not known"


def test_a_trail_is_where_a_contact_was_within_a_second_and_outlasts_it():
    trails = Trails()
    contact, unnamed, nowhere = SimpleNamespace(id=3), SimpleNamespace(id=0), np.empty((0, 2))
    for k in range(21):
        trails.add([contact, unnamed], np.array([[0.01 * k, 0.0], [0.0, 0.0]]), 5.0 + 0.1 * k)
    ((number, places),) = trails.items()
    assert number == 3
    np.testing.assert_allclose(places[:, 0], 0.01 * np.arange(10, 21), atol=1e-12)
    trails.add([], nowhere, 7.85)
    np.testing.assert_allclose(trails.items()[0][1][:, 0], [0.19, 0.2])
    trails.add([], nowhere, 8.05)
    assert trails.items() == []
    for k in range(1000):  # that of a contact at rest stays short, and a clock set back ends it
        trails.add([contact], np.array([[0.01, 1e-5 * (k % 7)]]), 9.0 + 1e-3 * k)
    assert len(trails.items()[0][1]) < 4
    trails.add([contact], np.array([[0.05, 0.0]]), 9.2)
    np.testing.assert_array_equal(trails.items()[0][1], [[0.05, 0.0]])


def test_the_scale_of_a_live_picture_is_steady():
    assert [round_up(x) for x in (0.0, 1.0, 1.01, 4.9, 5.0, 5.1, 2e3)] == [0, 1, 2, 5, 5, 10, 2e3]
    scale = SteadyScale(1e3, hold=5.0)
    assert scale(0.0, 0.0) == 1e3
    assert scale(3.2e3, 1.0) == 5e3  # grows at once
    assert [scale(p, t) for p, t in ((4e3, 2.0), (1.2e3, 3.0), (4.9e3, 4.0))] == [5e3] * 3
    assert [scale(1.2e3, t) for t in (5.0, 6.5, 12.0)] == [5e3, 5e3, 2e3]  # and falls later


def test_contacts_are_shown_without_an_image_and_never_over_an_old_one(monkeypatch, capsys):
    """One of ten seconds ago stood beside what had moved on, as if something pressed there."""
    saved = []
    monkeypatch.setattr(
        display_module, "save_pressure", lambda path, image, *_, **__: saved.append(image)
    )
    display, shot = Display(LAYOUT, load_scene("idle")), Shot(None, [UPPER_RIGHT], 1.0, 0.1, 0.01)
    for image, age in ((None, 0.0), (PRESSED, 0.3), (PRESSED, 9.0)):
        display.show(replace(shot, pressure=image, image_age=age, late="3 of 100 rows"))
        display.save("p.png")
    empty, recent, none = map(np.nanmax, saved)
    assert empty == none == 0.0 and recent == 1e4
    lines = [line for line in capsys.readouterr().out.splitlines() if "written" not in line]
    assert len(lines) == 1  # now and then, not with every shot
    assert "contact 1:" in lines[0] and lines[0].endswith("; late 3 of 100 rows")


@pytest.mark.parametrize(
    "reason", ["", "nothing explains the readings: " + 60 * "too long, " + "for a line"]
)
def test_lines_name_electrodes_that_are_left_out_and_break_no_sentence(capsys, reason):
    faults = {5: "its readings contradict all others", 3: "it gives no reading"}
    contacts = [] if reason else [UPPER_RIGHT]
    shot = Shot(None, contacts, 1.0, rate=0.1, age=0.01, reason=reason, faults=faults)
    Display(LAYOUT, load_scene("idle")).show(shot)
    (line,) = capsys.readouterr().out.splitlines()
    first, *rest = line.split("; ")
    assert rest == [f"electrode {e} left out: {faults[e]}" for e in (3, 5)]
    assert first.endswith(reason) and ("contact 1" in first) == (reason == "")


class Terminal(io.TextIOWrapper):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("environment", "encoding", "pictures"),
    [
        ({"TERM": "xterm"}, "utf-8", True),
        ({"TERM": "dumb"}, "utf-8", False),
        ({"TERM": "xterm", "NO_COLOR": "1"}, "utf-8", False),
        ({"TERM": "xterm"}, "ascii", False),
    ],
)
def test_pictures_are_shown_where_they_are_wanted_and_possible(
    monkeypatch, environment, encoding, pictures
):
    monkeypatch.delenv("NO_COLOR", raising=False)
    for key, value in environment.items():
        monkeypatch.setenv(key, value)
    terminal = Terminal(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr("sys.stdout", terminal)
    display = Display(LAYOUT, load_scene("default"))
    display.show(Shot(np.zeros((8, 8)), [], scene_time=1.0, rate=15.0, age=0.01))
    display.close()
    terminal.flush()
    assert (b"\x1b" in terminal.buffer.getvalue()) == pictures


@pytest.mark.parametrize(("scene", "said"), [("idle", True), ("live", False)])
def test_what_presses_from_outside_is_not_called_nothing(capsys, scene, said):
    """A live scene does not know what touches; an idle one does."""
    display = Display(LAYOUT, load_scene(scene))
    display.show(Shot(np.zeros((8, 8)), [UPPER_RIGHT], scene_time=1.0, rate=15.0, age=0.01))
    shown = capsys.readouterr().out
    assert "contact 1" in shown and ("nothing is there" in shown) == said
