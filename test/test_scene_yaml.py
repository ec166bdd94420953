"""Scene files: round trip, one clear line for every mistake, the installed scenes."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.contact_law import Creep, Hysteresis
from tomotactile_ros.scenes.course import Ramp, Sine, Tap
from tomotactile_ros.scenes.defects import Adc, Defects, Drift, Hum, Noise, SheetVariation, by_key
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.scenes.sheet_field import (
    Anisotropy,
    Gradient,
    Patch,
    SheetField,
    Tear,
    Temperature,
)
from tomotactile_ros.support.errors import Doubt, InputError

SCENES = Path(__file__).parent.parent / "config" / "scenes"
NAMES = sorted(file.stem for file in SCENES.glob("*.yaml"))
GOOD = """\
format: tomotactile-scene/1
drive_voltage: 3.3
contacts:
  - {shape: disc, center: [0.03, -0.02], radius: 5e-3, from: 0.5, to: 4.0, velocity: [0.02, 0]}
  - {shape: polygon, points: [[0, 0], [0.02, 0], [0, 0.02]], pressure: 8000}
  - {shape: rectangle, center: [0, 0], size: [0.02, 0.01], angle: 30}
contact_law: {coefficient: 1e-4, exponent: 1.0}
noise: {rms: 0.001}
adc: {bits: 12, range: 3.3}
defects:
  dead: [5]
  swapped: [[1, 2]]
  outline: {rectangle: [0.21, 0.204]}
  holes: [[[0.01, 0.01], [0.05, 0.01], [0.01, 0.05]]]
  electrode_radius: 0.006
  sheet_variation: {relative: 0.2, length: 0.05}
  anisotropy: {ratio: 1.5, direction: 30}
  gradient: {relative: 0.3}
  tears: [{line: [[0, 0], [0.02, 0]], width: 0.001}]
  patches: [{factor: 2, center: [0.01, 0], radius: 0.01}, {factor: 2, points: [[0, 0], [1, 0], [0, 1]]}]
  temperature: {relative: 0.05, period: 600}
"""
FIELD = SheetField(
    Anisotropy(1.5, 30.0),
    Gradient(0.3, 0.0),
    (Tear(((0.0, 0.0), (0.02, 0.0)), 0.001),),
    (Patch(2.0, (0.01, 0.0), 0.01), Patch(2.0, points=((0, 0), (1, 0), (0, 1)))),
    Temperature(0.05, 600.0),
)


def test_good_file_is_read(tmp_path):
    """Names of scenes are shown by the live display, and those of files may come from others."""
    path = tmp_path / "a\x1b[2Jb.yaml"
    path.write_text(GOOD)
    scene = load_scene(path)
    assert (scene.name, scene.drive_voltage, scene.layout) == ("a\\x1b[2Jb", 3.3, None)
    disc, triangle, rectangle = scene.contacts
    assert (disc.radius, disc.pressure, disc.start, disc.end) == (0.005, None, 0.5, 4.0)
    assert disc.velocity.tolist() == [0.02, 0.0] and disc.center.tolist() == [0.03, -0.02]
    assert (triangle.pressure, triangle.start, triangle.end) == (8000.0, 0.0, np.inf)
    assert rectangle.angle == 30 and rectangle.size == (0.02, 0.01)
    assert scene.contact_law == ContactLaw(1e-4, 1.0)
    assert (scene.noise, scene.adc) == (Noise(0.001, 0), Adc(12, 3.3))
    scene.save(tmp_path / "again.yaml")
    for defects in (scene.defects, load_scene(tmp_path / "again.yaml").defects):
        assert defects.outline.kind == "rectangle" and defects.outline.size == (0.21, 0.204)
        np.testing.assert_array_equal(defects.holes, [[[0.01, 0.01], [0.05, 0.01], [0.01, 0.05]]])
        plain = dataclasses.replace(defects, outline=None, holes=(), electrode_radius=None)
        variation = SheetVariation(0.2, 0.05)
        assert plain == Defects((5,), ((1, 2),), sheet_variation=variation, sheet=FIELD)
        assert defects.electrode_radius == 0.006


WAY, LAW = "to: 4.0, velocity: [0.02, 0]", "exponent: 1.0"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("scene/1", "layout/1", "were a layout and a scene swapped?"),
        ("drive_voltage: 3.3\n", "", "drive_voltage: is missing"),
        ("shape: disc", "shape: disk", "contacts[0].shape: 'disk' is none of disc, rectangle, po"),
        ("shape: disc, ", "", "contacts[0].shape: is missing"),
        ("[0.03, -0.02]", "[1e7, 0]", "contacts[0].center[0]: [10000000.0, 0.0] is not a point"),
        ("radius: 5e-3", "size: 5e-3", "contacts[0].size: unknown key; allowed are shape, center"),
        ("to: 4.0", "to: 0.5", "contacts[0].to: 0.5 is not after 'from' (0.5 s)"),
        ("velocity: [0.02, 0]", "velocity: 2", "contacts[0].velocity: 2 is not a list of 2"),
        ("[0, 0.02]]", "[0.04, 0]]", "contacts[1].points: the points enclose no area"),
        (WAY, "profile: hertz", "contacts[0].force: is missing, profile hertz needs it"),
        (WAY, "profile: dome, force: 1", "contacts[0].profile: 'dome' is none of even, hertz,"),
        (WAY, "force: 1, pressure: 1", "contacts[0].force: is given, and so is pressure"),
        (WAY, "force: 1, course: {kind: hop}", "course.kind: 'hop' is none of ramp, tap, sine"),
        (WAY, "force: 1, course: {kind: tap, rise: 1}", "contacts[0].course.rise: unknown key"),
        (
            WAY,
            "force: 1, course: {kind: sine, amplitude: 2, frequency: 1}",
            "2 N is above the mean",
        ),
        (
            WAY,
            "force: 1, course: {kind: sine, amplitude: 1, frequency: 0}",
            "frequency: 0.0 is not",
        ),
        (WAY, "force: 1, course: {kind: ramp}", "course.rise: 0, and so is fall"),
        (WAY, "force: 1, course: {kind: ramp, rise: -1}", "course.rise: -1.0 is negative"),
        (WAY, "force: 1, course: {kind: ramp, fall: 1}", "contacts[0].course.fall: needs 'to'"),
        (WAY, "to: 2, force: 1, course: {kind: ramp, rise: 2, fall: 1}", "rise and fall take 3 s"),
        (WAY, "force: 1, course: {kind: tap, duration: 0}", "duration: 0.0 is not a positive time"),
        (WAY, "force: 1, course: {kind: tap, duration: 1, period: 0.5}", "shorter than the tap"),
        (WAY, "path: [[0, 1]]", "contacts[0].speed: is missing, a path needs it"),
        (WAY, "path: [[0.03, -0.02]], speed: 1", "contacts[0].path: leads nowhere"),
        (WAY, "path: [[0, 1]], speed: 1, velocity: [1, 0]", "path: is given, and so is velo"),
        (WAY, "speed: 1", "contacts[0].speed: is that of a path, and there is no path"),
        (LAW, LAW + ", creep: {relative: 0.1, times: []}", "contact_law.creep.times: is empty"),
        (LAW, LAW + ", creep: {relative: 0.1, times: [1, 0]}", "times[1]: 0.0 is not a positive"),
        ("rms: 0.001", "rms: 0, seed: 1.5", "noise.seed: 1.5 is not a whole number"),
        ("bits: 12", "bits: 0", "adc.bits: 0 is not a whole number from 1 to 32"),
        ("dead: [5]", "dead: [5, 5]", "defects.dead: [5, 5] names an electrode twice"),
        ("[[1, 2]]", "[[1, 1]]", "defects.swapped: [1, 1] names an electrode twice"),
        ("[[1, 2]]", "[[1, 2, 3]]", "defects.swapped[0]: [1, 2, 3] is not a pair of electrodes"),
        ("relative: 0.2", "relative: 20", "defects.sheet_variation.relative: 20 is above 1"),
        ("dead: [5]", "drift: {amplitude: 1, period: 0}", "defects.drift.period: 0.0 is not"),
        ("ratio: 1.5", "ratio: 0", "defects.anisotropy.ratio: 0.0 is not a positive number"),
        ("relative: 0.3", "relative: 1", "defects.gradient.relative: 1 is not between -1 and 1"),
        ("[0.02, 0]], width", "[0, 0]], width", "((0.0, 0.0), (0.0, 0.0)) is not two different"),
        (", radius: 0.01", "", "factor: its patch needs a center and a radius, or points"),
        (", period: 600", "", "defects.temperature.period: belongs together with relative"),
        ("period: 600", "period: 600, rate: 1", "temperature.rate: needed, or relative and period"),
        (
            "dead: [5]",
            "gain: 1.0",
            "defects.gain: 1.0 is neither a list of numbers nor {rms, seed}",
        ),
        ("dead: [5]", "gain: [1.0, 0.0]", "defects.gain[1]: 0.0 is not a positive factor"),
        ("dead: [5]", "gain: {rms: 0.5}", "defects.gain.rms: 0.5 is above 0.25"),
        ("dead: [5]", "ground_resistance: {mean: 1, spread: 2}", "spread: 2 is above the mean"),
        ("dead: [5]", "settling: 1.0", "defects.settling: 1 is not a part from 0 to below 1"),
        ("dead: [5]", "open: [1, 1]", "defects.open: [1, 1] names an electrode twice"),
        ("dead: [5]", "stuck: {a: 1.0}", "defects.stuck: 'a' is not the number of an electrode"),
        ("dead: [5]", "stuck: {1: .inf}", "defects.stuck.1: inf"),
        (
            "contacts:\n",
            "contacts:\n" + 2000 * "  - {}\n",
            "contacts: 2003 are named, at most 1000",
        ),
        ("3.3", "3.3: 4", "line 2: not valid YAML: mapping values are not allowed"),
    ],
)
def test_mistake_gets_one_line_with_file_and_key(tmp_path, old, new, expected):
    assert old in GOOD
    path = tmp_path / "scene.yaml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_scene(path)
    line = str(error.value)
    assert line.startswith(f"{path}: ") and expected in line and "\n" not in line


numbers = st.floats(-1, 1)
lengths = st.floats(1e-6, 1)
pairs = st.tuples(numbers, numbers)
times = st.tuples(numbers, st.one_of(st.just(np.inf), st.floats(2, 1e3)))
seeds = st.integers(0, 2**32 - 1)
some = st.floats(1e-9, 1e9)
COURSES = [None, Ramp(rise=0.7), Tap(0.3, 0.5), Tap(0.5, 0.5), Tap(0.8), Sine(2.0, 1.7)]
STAR = np.array([[3, 0], [1, 1], [0, 3], [-1, 1], [-3, 0], [-1, -1], [0, -3], [1, -1]])


@st.composite
def contacts(draw):
    shape = draw(st.sampled_from(["disc", "rectangle", "polygon"]))
    keys = dict(zip(("start", "end"), draw(times)))
    if draw(st.booleans()):
        keys["force"] = draw(st.floats(2, 1e3))
        course = draw(st.sampled_from(COURSES))
        keys["course"] = Ramp(0.2, 0.7) if course and np.isfinite(keys["end"]) else course
        keys["profile"] = draw(st.sampled_from(["hertz", "punch"])) if shape == "disc" else "even"
    else:
        keys["pressure"] = draw(st.one_of(st.none(), st.floats(0, 1e9)))
    if draw(st.booleans()):
        keys |= {
            "path": [[3.0, 0.0], [0.0, 4.0]],
            "speed": draw(lengths),
            "loop": draw(st.booleans()),
        }
    else:
        keys["velocity"] = draw(pairs)
    if shape == "polygon":
        return Contact(shape, points=STAR * draw(lengths) + np.array(draw(pairs)).round(3), **keys)
    if shape == "disc":
        return Contact(shape, draw(pairs), radius=draw(lengths), **keys)
    size = draw(st.tuples(lengths, lengths))
    return Contact(shape, draw(pairs), size=size, angle=draw(st.floats(-360, 360)), **keys)


def maybe(kind, *parts):
    return st.one_of(st.none(), st.builds(kind, *parts))


memory = maybe(Hysteresis, some), maybe(Creep, some, st.tuples(some, some))
scenes = st.builds(
    Scene,
    name=st.just("any"),
    drive_voltage=some,
    contacts=st.lists(contacts(), max_size=4),
    contact_law=maybe(ContactLaw, some, some, *memory),
    noise=maybe(Noise, some, seeds),
    adc=maybe(Adc, st.integers(1, 32), some),
    defects=st.builds(
        Defects,
        dead=st.lists(st.integers(0, 255), unique=True).map(tuple),
        swapped=st.sampled_from([(), ((3, 1),), ((0, 1), (7, 2))]),
        drift=maybe(Drift, some, some, seeds),
        hum=maybe(Hum, some, some),
        switch_resistance=some,
        sheet_variation=maybe(SheetVariation, st.floats(0, 1), lengths, seeds),
        sheet=st.sampled_from([SheetField(), FIELD]),
    ),
    layout=st.sampled_from([None, "equal-8x8"]),
)


@given(scene=scenes)
def test_every_scene_survives_its_file(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("scene") / "any.yaml"
    scene.save(path)
    again = load_scene(path)
    for key in ("name", "drive_voltage", "contact_law", "noise", "adc", "defects", "layout"):
        assert getattr(again, key) == getattr(scene, key), key
    for mine, theirs in zip(again.contacts, scene.contacts, strict=True):
        for field in dataclasses.fields(Contact):
            if field.init:
                np.testing.assert_equal(getattr(mine, field.name), getattr(theirs, field.name))


@pytest.mark.parametrize("name", NAMES)
def test_installed_scene_says_what_it_shows_and_never_leaves_the_sheet(name):
    """At 10,000 times of ten hours: every contact wholly on the sheet."""
    scene = load_scene(name)
    layout = load_layout(scene.layout or "equal-8x8")
    scene.check(layout)
    assert scene.name == name
    text = (SCENES / f"{name}.yaml").read_text()
    assert text.startswith("# ") and max(map(len, text.splitlines())) <= 110
    times = np.random.default_rng(0).uniform(0, 36000, 10_000)
    for contact in scene.contacts:
        centers = [contact.center]
        if contact.moves:
            centers = [now.center for t in times if (now := contact.at(t)) is not None]
            assert len(centers) > 1000
        form = contact.vertices - contact.center
        low, high = np.min(centers, axis=0) + form.min(0), np.max(centers, axis=0) + form.max(0)
        corners = np.array([low, high, [low[0], high[1]], [high[0], low[1]]])
        assert layout.outline.contains(corners).all()


@pytest.mark.parametrize("name", ["experiment-centre", "experiment-side", "experiment-corner"])
def test_experiment_is_a_bare_5_mm_contact_at_5_volt(name):
    scene = load_scene(name)
    assert (scene.drive_voltage, scene.contact_law) == (5.0, None)
    (contact,) = scene.contacts
    assert (contact.shape, contact.radius, contact.pressure) == ("disc", 0.0025, None)


def test_defects_scene_names_every_defect():
    missing = [key for key, each in by_key(load_scene("defects").defects).items() if not each]
    assert not missing, f"config/scenes/defects.yaml: missing under defects: {', '.join(missing)}"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"layout": "other"}, "layout: the scene is for 'other', not for 'equal-4x4'"),
        ({"defects": Defects(dead=(3, 16))}, "defects.dead: electrode 16 does not exist"),
        ({"defects": Defects(swapped=((0, 99),))}, "defects.swapped: electrode 99 does not exist"),
    ],
)
def test_scene_for_another_layout_is_refused(change, line):
    scene = Scene(**{"name": "s", "drive_voltage": 3.3, **change})
    with pytest.raises(InputError, match=f"scene s: {line}"):
        scene.check(equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4))


def test_millivolts_of_the_drive_are_doubted():
    with pytest.warns(Doubt, match=r"was 3300 mV meant\? That is 3.3"):
        Scene("s", 3300.0)
