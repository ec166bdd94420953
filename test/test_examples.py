"""The examples, and the names of `import tomotactile_ros as tt`."""

import inspect
import json
import math
import re
import rlcompleter
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from process_support import python

import tomotactile_ros as tt

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
HEAVY = ("numpy", "scipy", "shapely", "matplotlib", "yaml")


@pytest.fixture
def run(tmp_path):
    """Lines that an example writes, run in a folder of its own, with a picture."""

    def run_one(name, *words, picture=None):
        done = python(EXAMPLES / name, *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        if picture is not None:
            content = (tmp_path / picture).read_bytes()
            assert content.startswith(b"\x89PNG") and len(content) > 10_000
        return done.stdout.splitlines()

    return run_one


def numbers(line):
    """The numbers with a unit in a line."""
    return [float(number) for number in re.findall(r"(-?[\d.]+) (?:mm|N)", line)]


def test_what_is_shown_is_what_is_public():
    """Also after everything was used, and in tab completion, which goes by `dir`."""
    assert [name for name in tt.__all__ if getattr(tt, name, None) is None] == []
    assert dir(tt) == sorted([*tt.__all__, "__version__"])
    completer = rlcompleter.Completer({"tt": tt})
    completed = {completer.complete("tt.", i) for i in range(100)}
    assert {name.strip("(). ").removeprefix("tt.") for name in completed if name} == set(tt.__all__)
    helpers = {name for name in vars(tt) if not name.startswith("_")} - set(tt.__all__)
    assert {name for name in helpers if not inspect.ismodule(getattr(tt, name))} == set()
    for name in ("Contact", "ContactLaw", "Noise", "learn", "fit_contact_law", "import_frames"):
        assert name in tt.__all__


def parts(thing):
    """A public class with its public methods and properties, or a function."""
    yield thing
    for name, member in vars(thing).items() if inspect.isclass(thing) else ():
        inner = getattr(member, "fget", None) or getattr(member, "func", None)
        inner = inner or getattr(member, "__func__", member)
        if inspect.isfunction(inner) and not name.startswith("_"):
            yield inner


@pytest.mark.parametrize("name", tt.__all__)
def test_what_is_public_is_documented_and_typed(name):
    for part in parts(getattr(tt, name)):
        assert inspect.getdoc(part), part
        if inspect.isclass(part) and issubclass(part, Warning):
            continue  # takes what every warning does
        signature = inspect.signature(part)
        if not inspect.isclass(part):
            assert signature.return_annotation is not signature.empty, part
        for parameter in list(signature.parameters.values()):
            typed = parameter.annotation is not parameter.empty
            assert typed or parameter.name in ("self", "cls"), f"{part}: {parameter}"


def test_contacts_print_readably():
    contact = tt.ContactEstimate(
        *np.array([0.0301, -0.0202, 2.0, 2.5e4, 7.9e-5, 0.005]),
        (1e-8, 0.0, 0.0, 4e-8),
        np.float64(0.03),
        id=3,
    )
    assert str([contact]) == (
        "[<contact at (30.1, -20.2) mm ± 0.2 mm, 2 N ± 0.03 N, radius 5.0 mm, id 3, 0.00 s old>]"
    )
    assert type(contact.x) is float and repr([contact.force]) == "[2.0]"
    bare = tt.ContactEstimate(0, 0, np.nan, np.nan, 1e-4, 0.005, conductance=np.float64(1.5e-4))
    assert str(bare) == "<contact at (0.0, 0.0) mm, 150 µS, radius 5.0 mm>"


def test_no_name_loads_anything_before_it_is_used():
    with pytest.raises(AttributeError, match="no attribute 'pipeline_'"):
        tt.pipeline_  # noqa: B018
    code = f"import tomotactile_ros, sys; sys.exit(any(m in sys.modules for m in {HEAVY}))"
    # without the site folder's start-up files, which may load what they like
    assert python("-S", "-c", code).returncode == 0


def test_simulated_contacts_are_found_where_they_are(run):
    lines = run("simulate_and_plot.py", picture="pressure.png")
    found, true = (
        np.array([numbers(line) for line in lines if line.startswith(word)])
        for word in ("found", "true")
    )
    assert len(found) == len(true) == 2
    np.testing.assert_allclose(found[:, :2], true[:, :2], atol=1.0)
    np.testing.assert_allclose(found[:, 2], true[:, 2], rtol=0.2)


def test_own_frames_with_an_offset_show_the_finger_and_nothing_else(run):
    _, first, last = run("own_frames.py", picture="contacts.png")
    assert np.hypot(*(np.array(numbers(first)) - [80, -30])) < 1.5
    assert "contacts.png" in last


def test_every_method_shows_the_two_discs_of_the_sample(run):
    said = dict(line.split(": ", 1) for line in run("gallery.py", picture="gallery.png")[:-1])
    assert list(said) == ["fast", "balanced", "accurate", "paper", "greit", "jac"]
    assert all(said[name].endswith("2 contacts") for name in list(said)[:3])


def test_the_frame_that_is_worked_step_by_step_ends_at_its_contact(run):
    """Its numbers stand in docs/estimation.md."""
    said = "\n".join(run("one_frame.py", picture="one_frame.png"))
    page = (ROOT / "docs" / "estimation.md").read_text(encoding="utf-8")
    x, y = (float(each) for each in re.search(r"6\. report: x (\S+) .*? y (\S+) ", said).groups())
    assert np.hypot(x - 30, y - 20) < 0.15 and f"({x:.2f} ± 0.02, {y:.2f} ± 0.01) mm" in page
    step = r"step (\d): x +(\S+) mm  y +(\S+) mm  c +(\S+) uS  radius +(\S+) mm  chi\^2 +(\S+)"
    for number, x, y, c, radius, chi_squared in re.findall(step, said):
        assert f"| {number} | {x}, {y} | {c} | {radius} | {chi_squared} |" in page


def test_learned_gains_and_two_known_forces_give_the_force_of_another_place(run):
    _, gains, law, seen = run("learn_and_calibrate.py")
    low, high = (float(word) for word in re.findall(r"\d\.\d+", gains))
    assert 0.9 < low < 0.97 and 1.03 < high < 1.1  # 3 % rms over 16 channels
    coefficient, exponent = (float(word) for word in re.findall(r"\d\.?\d*e-\d+|\d\.\d+", law))
    assert coefficient == pytest.approx(1e-4, rel=0.15) and exponent == pytest.approx(1, abs=0.05)
    force, x, y = numbers(seen)[-3:]
    assert np.hypot(x + 50, y - 40) < 0.5 and force == pytest.approx(2.5, rel=0.05)


def test_the_search_on_an_odd_outline_gains_and_writes_a_layout(run, tmp_path):
    lines = run("odd_outline.py", "--steps", 1, "--resolution", 12)
    assert sum(line.startswith("step ") for line in lines) == 2  # the start is one
    start, best = (numbers(line) for line in lines[-3:-1])
    assert best[0] < start[0]
    layout = tt.load_layout(tmp_path / "l-shaped.yaml")
    assert layout.name == "l-shaped" and layout.electrodes == 12 and len(layout.outline.holes) == 1


def test_the_cells_of_the_notebook_run_in_order():
    book = json.loads((EXAMPLES / "first_image.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    names: dict = {}
    for cell in cells:
        exec(compile(cell, "first_image.ipynb", "exec"), names)  # noqa: S102 - that is the test
    assert len(cells) == 5 and len(names["few"].grounded) == 16
    assert names["result"].state == "valid" and len(names["result"].contacts) == 2


def test_without_mujoco_the_example_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    said = "press_from_mujoco: MuJoCo is missing, install it with: python3 -m pip install mujoco"
    with pytest.raises(SystemExit, match=said):
        runpy.run_path(str(EXAMPLES / "press_from_mujoco.py"))


def test_the_image_follows_a_finger_in_mujoco(request):
    for package in ("rclpy", "mujoco"):
        pytest.importorskip(package)
    from ros_support import ends_cleanly

    from tomotactile_ros.msg import ContactArray

    probe, start, spawn = map(request.getfixturevalue, ("probe", "start", "spawn"))
    driver = start("driver", {"scene": "live"})
    reconstruction = start("reconstruction", {"profile": "accurate"})
    touches = probe.listen(ContactArray, "touches", 100)
    contacts = probe.listen(ContactArray, "contacts", 100)
    finger = spawn(sys.executable, EXAMPLES / "press_from_mujoco.py")
    probe.until(lambda: span(follows(touches, contacts)) > 0.06, "contacts that follow")
    assert "finger (" in finger.output and "sensor (" in finger.output
    ends_cleanly(finger)
    seen = len(contacts)
    probe.until(lambda: any(not c.contacts for c in contacts[seen:]), "release after its end")
    ends_cleanly(driver)
    ends_cleanly(reconstruction)


def follows(touches, contacts):
    """(N, 2) places of contacts that are where the finger was at their stamp, with its force."""
    from tomotactile_ros.nodes.conversions import stamp_of

    pressed = [(stamp_of(m.header), m.contacts[0]) for m in touches if m.contacts]
    times, places = [t for t, _ in pressed], []
    for message in contacts:
        number = np.searchsorted(times, stamp_of(message.header))
        if len(message.contacts) != 1 or not 0 < number < len(times):
            continue
        found, true = message.contacts[0], pressed[number - 1][1]
        place = found.position.x, found.position.y
        off = math.dist(place, (true.position.x, true.position.y))
        if off < 0.006 and abs(found.force / true.force - 1) < 0.4:
            places.append(place)
    return np.array(places).reshape(-1, 2)


def span(places):
    """Longest way between two of them along x or y, m."""
    return np.ptp(places, axis=0).max() if len(places) else 0.0
