"""Scene files: round trip, one clear line for every mistake, the installed scenes."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Drift, Hum, Noise, SheetVariation, by_key
from tomotactile_ros.scenes.scene import Scene, load_scene
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
defects: {dead: [5], swapped: [[1, 2]], sheet_variation: {relative: 0.2, length: 0.05}}
"""


def complaint(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_scene(path)
    line = str(error.value)
    assert "\n" not in line and line.startswith(f"{path}: ")
    return line.removeprefix(f"{tmp_path}/")


def test_good_file_is_read(tmp_path):
    (tmp_path / "mine.yaml").write_text(GOOD)
    scene = load_scene(tmp_path / "mine.yaml")
    assert (scene.name, scene.drive_voltage, scene.layout) == ("mine", 3.3, None)
    disc, triangle, rectangle = scene.contacts
    assert (disc.radius, disc.pressure, disc.start, disc.end) == (0.005, None, 0.5, 4.0)
    assert disc.velocity.tolist() == [0.02, 0.0] and disc.center.tolist() == [0.03, -0.02]
    assert (triangle.pressure, triangle.start, triangle.end) == (8000.0, 0.0, np.inf)
    assert rectangle.angle == 30 and rectangle.size == (0.02, 0.01)
    assert scene.contact_law == ContactLaw(1e-4, 1.0)
    assert (scene.noise, scene.adc) == (Noise(0.001, 0), Adc(12, 3.3))
    assert scene.defects == Defects((5,), ((1, 2),), sheet_variation=SheetVariation(0.2, 0.05))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("scene/1", "layout/1", "were a layout and a scene swapped?"),
        ("drive_voltage: 3.3\n", "", "drive_voltage: is missing"),
        ("drive_voltage: 3.3", "drive_voltage: -3.3", "drive_voltage: -3.3 is not a positive"),
        ("contacts:", "contact:", "contact: unknown key; did you mean 'contacts'?"),
        ("shape: disc", "shape: disk", "contacts[0].shape: 'disk' is none of disc, rectangle, po"),
        ("shape: disc, ", "", "contacts[0].shape: is missing"),
        ("radius: 5e-3", "radius: -0.1", "contacts[0].radius: -0.1 is not a positive length in m"),
        ("[0.03, -0.02]", "[1e7, 0]", "contacts[0].center[0]: [10000000.0, 0.0] is not a point"),
        ("radius: 5e-3", "size: 5e-3", "contacts[0].size: unknown key; allowed are shape, center"),
        ("to: 4.0", "to: 0.5", "contacts[0].to: 0.5 is not after 'from' (0.5 s)"),
        ("velocity: [0.02, 0]", "velocity: 2", "contacts[0].velocity: 2 is not a list of 2"),
        ("pressure: 8000", "pressure: -1", "contacts[1].pressure: -1.0 is negative"),
        ("[0, 0.02]]", "[0.04, 0]]", "contacts[1].points: the points enclose no area"),
        ("rms: 0.001", "rms: -1", "noise.rms: -1.0 is negative"),
        ("rms: 0.001", "rms: 0, seed: 1.5", "noise.seed: 1.5 is not a whole number"),
        ("bits: 12", "bits: 0", "adc.bits: 0 is not a whole number from 1 to 32"),
        ("dead: [5]", "dead: 5", "defects.dead: 5 is not a list"),
        ("dead: [5]", "dead: [-1]", "defects.dead: -1 is not an electrode, they count from 0"),
        ("dead: [5]", "dead: [5, 5]", "defects.dead: [5, 5] names an electrode twice"),
        ("[[1, 2]]", "[[1, 1]]", "defects.swapped: [1, 1] names an electrode twice"),
        ("[[1, 2]]", "[[1, 2, 3]]", "defects.swapped[0]: [1, 2, 3] is not a pair of electrodes"),
        ("relative: 0.2", "relative: 20", "defects.sheet_variation.relative: 20 is above 1"),
        ("dead", "deaf", "defects.deaf: unknown key; did you mean 'dead'?"),
        ("dead: [5]", "drift: {amplitude: 1, period: 0}", "defects.drift.period: 0.0 is not"),
        ("dead: [5]", "switch_resistance: -1", "defects.switch_resistance: -1.0 is negative"),
        ("3.3", "3.3: 4", "line 2: not valid YAML: mapping values are not allowed"),
    ],
)
def test_mistake_gets_one_line_with_file_and_key(tmp_path, old, new, expected):
    assert old in GOOD
    line = complaint(tmp_path, GOOD.replace(old, new, 1))
    assert line.startswith("scene.yaml: ") and expected in line


numbers = st.floats(-1, 1)
lengths = st.floats(1e-6, 1)
pairs = st.tuples(numbers, numbers)
times = st.tuples(numbers, st.one_of(st.just(np.inf), st.floats(2, 1e3)))
STAR = np.array([[3, 0], [1, 1], [0, 3], [-1, 1], [-3, 0], [-1, -1], [0, -3], [1, -1]])


@st.composite
def contacts(draw):
    start, end = draw(times)
    common = {
        "pressure": draw(st.one_of(st.none(), st.floats(0, 1e9))),
        "start": start,
        "end": end,
        "velocity": draw(pairs),
    }
    shape = draw(st.sampled_from(["disc", "rectangle", "polygon"]))
    if shape == "polygon":
        points = STAR * draw(lengths) + np.array(draw(pairs)).round(3)
        return Contact(shape, points=points, **common)
    if shape == "disc":
        return Contact(shape, draw(pairs), radius=draw(lengths), **common)
    size = draw(st.tuples(lengths, lengths))
    return Contact(shape, draw(pairs), size=size, angle=draw(st.floats(-360, 360)), **common)


seeds = st.integers(0, 2**32 - 1)
some = st.floats(1e-9, 1e9)


def maybe(kind, *parts):
    return st.one_of(st.none(), st.builds(kind, *parts))


scenes = st.builds(
    Scene,
    name=st.just("any"),
    drive_voltage=some,
    contacts=st.lists(contacts(), max_size=4),
    contact_law=maybe(ContactLaw, some, some),
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
    ),
    layout=st.sampled_from([None, "equal-8x8"]),
)


@settings(deadline=None)
@given(scene=scenes)
def test_every_scene_survives_its_file(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("scene") / "any.yaml"
    scene.save(path)
    again = load_scene(path)
    for key in ("name", "drive_voltage", "contact_law", "noise", "adc", "defects", "layout"):
        assert getattr(again, key) == getattr(scene, key), key
    assert len(again.contacts) == len(scene.contacts)
    for mine, theirs in zip(again.contacts, scene.contacts, strict=True):
        for key in ("shape", "radius", "size", "angle", "pressure", "start", "end"):
            assert getattr(mine, key) == getattr(theirs, key), key
        np.testing.assert_array_equal(mine.velocity, theirs.velocity)
        np.testing.assert_array_equal(mine.center, theirs.center)
        np.testing.assert_array_equal(mine.vertices, theirs.vertices)


@pytest.mark.parametrize("name", NAMES)
def test_installed_scene_fits_the_8x8_layout_and_says_what_it_shows(name):
    scene = load_scene(name)
    scene.check(load_layout("equal-8x8"))
    assert scene.name == name
    text = (SCENES / f"{name}.yaml").read_text()
    assert text.startswith("# ") and max(map(len, text.splitlines())) <= 110


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
        ({"layout": "other"}, "scene s: layout: the scene is for 'other', not for 'equal-4x4'"),
        (
            {"defects": Defects(dead=(3, 16))},
            "scene s: defects.dead: electrode 16 does not exist, equal-4x4 has 0 to 15",
        ),
        (
            {"defects": Defects(swapped=((0, 99),))},
            "scene s: defects.swapped: electrode 99 does not exist, equal-4x4 has 0 to 15",
        ),
        (
            {"contacts": [Contact("disc", (0, 0), radius=1), Contact("disc", (1, 0), radius=0.1)]},
            "scene s: contacts[1]: never touches the sheet of equal-4x4",
        ),
    ],
)
def test_scene_for_another_layout_is_refused(change, line):
    scene = Scene(**{"name": "s", "drive_voltage": 3.3, **change})
    with pytest.raises(InputError) as error:
        scene.check(equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4))
    assert str(error.value) == line


def test_a_file_name_is_shown_as_text_whatever_is_in_it(tmp_path):
    """Names of scenes are shown by the live display, and those of files may come from others."""
    path = tmp_path / "a\x1b[2Jb.yaml"
    path.write_text(GOOD)
    assert load_scene(path).name == "a\\x1b[2Jb"


def test_millivolts_of_the_drive_are_doubted():
    with pytest.warns(Doubt, match=r"was 3300 mV meant\? That is 3.3"):
        Scene("s", 3300.0)
