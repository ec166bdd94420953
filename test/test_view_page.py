"""The page for the browser: in a real one, without a window, and by its parts."""

import math
import re
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from warm_start import begin

from tomotactile_ros.cli import main
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction.estimate import ContactEstimate
from tomotactile_ros.surfaces.simple import Cylinder
from tomotactile_ros.view import timeline
from tomotactile_ros.view.page import LOCALHOST, Page
from tomotactile_ros.view.page_parts import frames_of, rings, roots_of, table_of


@pytest.mark.parametrize("command", ["view", "play"])
def test_where_viser_is_missing_one_line_says_how_to_get_it(command, mistake, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install" in mistake(f"{command} --layout equal-4x4")


@pytest.fixture
def page():
    pytest.importorskip("viser", reason="viser is not installed")
    with Page("a page", port=0) as page:
        yield page


@pytest.fixture
def open_tab():
    """Opens pages in a browser."""
    pytest.importorskip("viser", reason="viser is not installed")
    from browser_support import Tab, browser

    if browser() is None:
        pytest.skip("no Chromium is installed")
    tabs = []

    def open_one(url):
        tabs.append(Tab(url))
        return tabs[-1]

    yield open_one
    for tab in tabs:
        tab.close()


@pytest.fixture
def serve():
    """Starts `tomotactile` with a page; returns the page's address."""
    processes = []

    def serve_one(*words):
        command = [sys.executable, "-m", "tomotactile_ros.cli", *words, "--web-port", "0"]
        processes.append(begin(command, stdout=subprocess.PIPE, text=True))
        line = processes[-1].stdout.readline()
        assert "http://127.0.0.1:" in line
        return line.split()[-1]

    yield serve_one
    for process in processes:
        process.terminate()
        assert process.wait() in (0, 130)


def seconds(tab):
    """Time in the scene that the page shows; NaN where it shows none."""
    found = re.search(r"(\d+\.\d+) s, \d+ ms old", tab.text())
    return float(found[1]) if found else math.nan


BENT = replace(load_layout("equal-8x8"), surface=Cylinder(0.08))


def test_cells_are_turned_as_the_surface_is():
    grid = Grid.for_outline(BENT.outline, 40)
    cells = BENT.surface.to_3d(grid.centres).reshape(*grid.shape, 3)
    off = np.abs(frames_of(cells) - BENT.surface.frames(grid.centres).reshape(*grid.shape, 3, 3))
    # cells at the rim have a neighbour on one side only
    assert off[1:-1, 1:-1].max() < 1e-6 and off.max() < 0.05


def test_an_ellipse_has_the_axes_of_its_covariance():
    covariance = np.array([[[4.0, 1.5], [1.5, 1.0]]])
    points = rings(np.zeros((1, 3)), np.eye(3)[None], roots_of(covariance)).reshape(-1, 3)
    distances = np.einsum("ni,ij,nj->n", points[:, :2], np.linalg.inv(covariance[0]), points[:, :2])
    assert np.allclose(distances, 1.0) and np.allclose(points[:, 2], 0.0)


def test_columns_have_units_and_something_in_them():
    contact = ContactEstimate(0.01, 0.02, 2.0, 2.5e4, 7.9e-5, 0.005, (1e-8, 0.0, 0.0, 4e-8), 0.1)
    true = {"x": 0.01, "y": 0.02, "force": 2.0}
    heads = ["", "x, y / mm", "± / mm", "N"]
    for truth, more in (
        (None, []),
        ([true | {"force": None}], ["off / mm"]),  # of a bare conductor
        ([true], ["off / mm", "true N"]),
        ([true, true], ["off / mm", "true N"]),
    ):
        first, *rows = table_of([contact], truth, True).split("<tr>")[1:]
        assert re.findall("<th>(.*?)</th>", first) == [*heads, *more]
        assert len(rows) == len(truth or [0])
        assert all(row.count("<td>") == len(heads + more) for row in rows)


def test_the_pointer_presses_where_it_points(page):
    sheet = page.add_layout(BENT, Grid.for_outline(BENT.outline, 40))
    eye = np.array([0.02, -0.18, 0.3])
    for x, y in ((0.0, 0.0), (0.05, -0.03), (-0.07, 0.08), (0.099, -0.099)):
        (place,) = BENT.surface.to_3d(np.array([[x, y]]))
        assert math.dist(sheet.pick(eye, place - eye), (x, y)) < 1e-3  # of cells of 5 mm
    assert sheet.pick(eye, np.array([0.0, 0.0, 1.0])) is None


def test_nobody_elsewhere_is_listened_to(page):
    port = f":{page.server.get_port():04X}"
    with open("/proc/net/tcp") as file:
        listening = [line.split()[1] for line in file if line.split()[3] == "0A"]
    assert [each for each in listening if each.endswith(port)] == [f"0100007F{port}"]
    assert page.url.startswith(f"http://{LOCALHOST}:")


@pytest.mark.parametrize(
    "words, what", [("--host 192.0.2.1", "host: "), ("--web-port 70000", "port: ")]
)
def test_an_address_where_nobody_can_listen_is_refused_in_one_line(words, what, mistake):
    pytest.importorskip("viser", reason="viser is not installed")
    assert what in mistake(f"play --layout equal-4x4 {words}")


def test_a_sensor_is_seen_in_the_browser_without_the_internet(serve, open_tab):
    tab = open_tab(serve("view", "--scene", "press", "--layout", "equal-4x4"))
    tab.says("images/s")
    tab.says("kPa")
    tab.until(lambda: "no contact" not in tab.text(), "contact")
    own = ("http://127.0.0.1:", "data:", "blob:http://127.0.0.1:")
    assert tab.asked and all(each.startswith(own) for each in tab.asked)


def test_a_recording_is_scrubbed_and_withheld_and_late_frames_are_marked(serve, open_tab, tmp_path):
    """Ten frames of a sensor whose readings cannot be, five that are missing."""
    frames, spoilt = str(tmp_path / "frames.npz"), str(tmp_path / "spoilt.npz")
    words = ["--layout", "equal-4x4", "--scene", "press", "--frames", "40", "--out", frames]
    assert main(["simulate", *words]) == 0
    content = dict(np.load(frames))
    content["voltages"][10:20] = np.random.default_rng(0).uniform(0, 3, (10, 16, 16))
    kept = [k for k in range(40) if k not in range(30, 35)]
    content |= {name: content[name][kept] for name in ("voltages", "stamps")}
    np.savez(spoilt, **{name: content[name] for name in content if "truth" not in name})
    tab = open_tab(serve("view", "--layout", "equal-4x4", "--recording", spoilt))
    tab.until(
        lambda: re.search(r"35 of 35 frames, 1\d of them withheld, 1 late", tab.text()), "marks"
    )

    def marked(colour):
        """From where to where the strip has a colour, in 1/400 of its width."""
        bars = f"[...document.querySelectorAll('svg rect[fill=\"{colour}\"]')]"
        numbers = tab.script(f"{bars}.map(bar => [bar.x.baseVal.value, bar.width.baseVal.value])")
        return [(x / 10, (x + width) / 10) for x, width in numbers]

    tab.until(lambda: marked(timeline.LATE), "late frame")
    ((begin, end),) = marked(timeline.WITHHELD)
    assert begin == pytest.approx(11, abs=0.5) and 20.5 < end < 24  # a frame holds at its end
    ((begin, end),) = marked(timeline.LATE)
    assert begin == pytest.approx(36, abs=0.5) and end == pytest.approx(37, abs=0.5)
    tab.key_until(lambda: seconds(tab) < 0.03, "[role=slider]", "Home", 36)
    tab.key_until(lambda: seconds(tab) > 0.6, "[role=slider]", "End", 35)
    tab.until(lambda: tab.contacts(), "contact")


def test_the_sheet_is_pressed_by_a_click_and_the_touch_appears(page, open_tab):
    from tomotactile_ros.commands.play import Game

    game, over = Game(page, "equal-4x4", "fast"), threading.Event()
    playing = threading.Thread(target=game.play, args=(over,))
    playing.start()
    try:
        tab = open_tab(page.url)
        tab.says("tomotactile a page")
        tab.says("no contact")
        tab.click_until(lambda: game.touches(), 240, 330)
        (touch,) = game.touches()
        tab.until(lambda: tab.contacts(), "contact")
        (number, place, _, force, off, true), *others = tab.contacts()
        found = [float(each) for each in place.split(",")]
        assert math.dist(found, (1e3 * touch.x, 1e3 * touch.y)) < 1.0 and not others
        assert float(off) < 1.0 and abs(float(force) - 2.0) < 0.3 and true == "2.00" and int(number)
    finally:
        over.set()
        playing.join()
