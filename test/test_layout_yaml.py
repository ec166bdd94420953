"""Layout files: round trip, one clear line for every mistake, ids."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros.layouts import layout_ids
from tomotactile_ros.layouts.layout import Layout, Outline, equal_grid, load_layout
from tomotactile_ros.layouts.tolerance import Tolerance
from tomotactile_ros.support.errors import Doubt, InputError
from tomotactile_ros.surfaces import Cylinder, Flat

GOOD = """\
format: tomotactile-layout/1
name: square
outline: {rectangle: [0.2, 0.2]}
sheet_resistance: 1e4
electrodes:
  radius: 0.005
  positions: [[-0.1, -0.1], [0.1, -0.1], [-0.1, 0.1], [0.1, 0.1]]
"""


def write(tmp_path, text):
    path = tmp_path / "layout.yaml"
    path.write_text(text)
    return path


def test_good_file_is_read(tmp_path):
    layout = load_layout(write(tmp_path, GOOD))
    assert layout.name == "square"
    assert layout.sheet_resistance == 1e4  # YAML 1.1 alone would read a text
    assert layout.electrodes == 4
    assert layout.outline.is_uniform_rectangle
    assert layout.positions.dtype == np.float64 and not layout.positions.flags.writeable
    assert layout.provenance == {} and layout.surface == Flat()


OUTLINE, NAME = "rectangle: [0.2, 0.2]", "name: square"
PLACES = "positions: [[-0.1, -0.1], [0.1, -0.1], [-0.1, 0.1], [0.1, 0.1]]"
HOLE = "[[0, 0], [0.05, 0], [0, 0.05]]"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("/1", "/2", "format: 'tomotactile-layout/2' is not known here"),
        ("format: tomotactile-layout/1\n", "", "format: is missing"),
        (NAME, "name: [1]", "name: [1] is not a text"),
        (NAME, "name: a\nname: b", "line 3: not valid YAML: key 'name' appears twice"),
        ("1e4", "1e31", "sheet_resistance: 1e+31 is too large, at most 1e+30 works"),
        ("1e4", "0x" + "f" * 5000, "sheet_resistance: a huge number is not a finite number"),
        ("[0.1, 0.1]]", "[0.1, .inf]]", "electrodes.positions[3][1]: inf is not a finite number"),
        ("[0.1, 0.1]]", "[0.2, 0.1]]", "electrodes.positions[3]: [0.2, 0.1] lies outside"),
        ("[0.1, 0.1]]", "[-0.1, 0.0959]]", "electrodes 2 and 3 overlap: 4.1 mm apart, they need"),
        (", [0.1, -0.1], [-0.1, 0.1], [0.1, 0.1]", "", "at least 2 are needed"),
        (OUTLINE, "", "outline: exactly one of rectangle, circle, polygon"),
        (OUTLINE, "rectangle: [0.2, 1e-300]", "outline.rectangle[1]: 1e-300 is no length in m"),
        (OUTLINE, "polygon: [[0, 0], [1, 0], [0, 1]]", "(and electrodes) by [-0.5, -0.5] m"),
        (OUTLINE, "polygon: [[-1, -1], [1, 1], [1, -1], [-1, 2]]", "polygon: not a simple polygon"),
        (
            OUTLINE,
            OUTLINE + ", holes: [[[0, 0], [1, 0], [0, 1]]]",
            "outline.holes[0]: does not lie",
        ),
        (OUTLINE, OUTLINE + ", holes: [[[-50, -50], [50, -50], [0, 50]]]", "; is it in mm"),
        (OUTLINE, f"{OUTLINE}, holes: [{HOLE}, {HOLE}]", "holes[1]: touches or overlaps holes[0]"),
        (
            OUTLINE,
            OUTLINE + ", holes: [[[0, 0], [0.1, 0]]]",
            "holes[0]: 2 points given, at least 3",
        ),
        (NAME, "name: s\nsurface: {cylinder: {radius: 0.01}}", "must be at least 0.03183 m"),
        (NAME, "name: s\ntolerance: {outline: 1}", "was 1 mm meant? That is 0.001"),
        (
            NAME,
            "name: s\ntolerance: {radius: 10}",
            "tolerance.radius: 10 is relative to the radius",
        ),
        (NAME, "name: s\nscan: {order: []}", "scan.order: [] names no electrode"),
        (NAME, "name: s\nscan: {order: [4]}", "scan.order: electrode 4 does not exist, there are"),
        (NAME, "name: s\nscan: {order: [1.5]}", "scan.order[0]: 1.5 is not a whole number"),
        (
            NAME,
            f"name: s\nscan: {{order: {[0] * 65536}}}",
            "scan.order: 65536 rows, a frame has at",
        ),
        (OUTLINE, "rectangle: [200.0, 200.0]", "was 0.2 m x 0.2 m meant"),
        (OUTLINE, "circle: 0.001", "was another unit meant"),
        (PLACES, "positions: [[-100.0, 0.0], [100.0, 0.0]]", "are the positions in mm?"),
        (
            PLACES,
            "positions: [[0.01, 0.17], [0.19, 0.01]]",
            "was the origin a corner of the sheet?",
        ),
        (NAME, "name: &x [1]\nprovenance: *x", "aliases (*name) are not allowed"),
        (NAME, "name: !!python/name:os.system x", "line 2: not valid YAML: could not"),
        (NAME, "name: 2020-13-45", "not valid YAML: month must be in 1..12"),
        (GOOD, "", "the file is empty"),
        (GOOD, "[" * 100000, "nested too deeply"),
        (GOOD, "a" * 1_000_001, "the file is larger than 1 MB"),
    ],
)
def test_mistake_gets_one_line_with_file_and_key(tmp_path, old, new, expected):
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_layout(path)
    line = str(error.value)
    assert line.startswith(f"{path}: ") and "\n" not in line and expected in line


HOLES = st.sampled_from([(), ([[-0.1, -0.1], [0.1, -0.1], [0.0, 0.2]],)])
HEXAGON = np.array([[-2, -1], [0, -2], [2, -1], [2, 1], [0.5, 2], [-2, 1]])
KINDS = {
    "rectangle": lambda size, aspect, holes: Outline.rectangle(size / aspect, size, holes, True),
    "circle": lambda size, _, holes: Outline.circle(size, holes, True),
    "polygon": lambda size, _, holes: Outline.polygon(HEXAGON * size, holes, True),
}


@given(
    kind=st.sampled_from(list(KINDS)),
    size=st.floats(1e-3, 10.0),
    aspect=st.floats(0.01, 1.0),
    holes=HOLES,
    rho=st.lists(st.floats(0.3, 1.0), min_size=2, max_size=12),
    sheet_resistance=st.floats(1e-3, 1e9),
    bent=st.booleans(),
    tolerant=st.booleans(),
)
def test_every_layout_survives_its_file(
    tmp_path_factory, kind, size, aspect, holes, rho, sheet_resistance, bent, tolerant
):
    outline = KINDS[kind](size, aspect, [np.array(hole) * size / 2 for hole in holes])
    angle = 0.1 + 2 * np.pi * np.arange(len(rho)) / len(rho)
    half = min(outline.size) / 2
    positions = half * np.array(rho)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    positions = positions[outline.contains(positions)]
    if len(positions) < 2:
        positions = half * np.array([[-0.5, 0.0], [0.5, 0.0]])
    surface = Cylinder(outline.size[0]) if bent else Flat()
    provenance = {"algorithm": "équalize", "metrics": {"hwhm": [0.1, np.float64(0.2)]}, "n": 3}
    layout = Layout("any", outline, sheet_resistance, 1e-3 * half, positions, provenance, surface)
    if tolerant:
        tolerance = Tolerance(outline=2e-2 * half, places=5e-3 * half)
        layout = replace(layout, tolerance=tolerance, scan=(1, 0, 1))
    path = tmp_path_factory.mktemp("layout") / "any.yaml"
    layout.save(path)
    with warnings.catch_warnings():  # of a sheet resistance that may be in kohm/sq
        warnings.simplefilter("ignore", Doubt)
        again = load_layout(path)
    for key in ("name", "sheet_resistance", "radius", "surface", "tolerance", "id", "scan"):
        assert getattr(again, key) == getattr(layout, key), key
    assert again.grounded.tolist() == ([1, 0, 1] if tolerant else list(range(len(positions))))
    np.testing.assert_array_equal(again.positions, layout.positions)
    assert again.outline.kind == outline.kind
    np.testing.assert_array_equal(again.outline.shell, outline.shell)
    for mine, theirs in zip(again.outline.holes, outline.holes, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert again.provenance == {"algorithm": "équalize", "metrics": {"hwhm": [0.1, 0.2]}, "n": 3}
    first = path.read_bytes()
    again.save(path)
    assert path.read_bytes() == first


def test_the_id_tells_layouts_of_one_name_apart():
    layout = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4, name="optimized")
    assert re.fullmatch("optimized#[0-9a-f]{8}", layout.id)
    moved = np.array(layout.positions)
    moved[5, 0] += 1e-6
    others = [
        replace(layout, positions=moved),
        replace(layout, radius=0.003),
        replace(layout, outline=Outline.rectangle(0.31, 0.2)),
        replace(layout, outline=Outline.rectangle(0.3, 0.2, [HEXAGON / 100])),
    ]
    assert len({layout.id, *(other.id for other in others)}) == 5
    for same in (
        {"surface": Cylinder(1.0)},
        {"provenance": {"n": 1}},
        {"tolerance": Tolerance(1e-3)},
        {"scan": (3, 0, 3)},
    ):
        assert replace(layout, **same).id == layout.id


def test_a_bare_name_matches_every_layout_of_that_name_and_no_other():
    layout = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4, name="optimized")
    assert layout_ids.matches(layout.id, layout.id) and not layout_ids.is_bare(layout.id, layout.id)
    assert layout_ids.matches("optimized", layout.id) and layout_ids.is_bare("optimized", layout.id)
    for other in ("optimized#00000000", "optimized#", "", "optimize"):
        assert not layout_ids.matches(other, layout.id)
