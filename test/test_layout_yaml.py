"""Layout files: round trip, one clear line for every mistake, atomic saving, installed names."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
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


def write(tmp_path, text, name="layout.yaml"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def complaint(path, load=load_layout):
    """The one line that a bad file gets, without the folder."""
    with pytest.raises(InputError) as error:
        load(path)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path.parent}/")


def test_good_file_is_read(tmp_path):
    layout = load_layout(write(tmp_path, GOOD))
    assert layout.name == "square"
    assert layout.sheet_resistance == 1e4  # YAML 1.1 alone would read a text
    assert layout.electrodes == 4
    assert layout.outline.is_uniform_rectangle
    assert layout.positions.dtype == np.float64 and not layout.positions.flags.writeable
    assert layout.provenance == {} and layout.surface == Flat()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("/1", "/2", "format: 'tomotactile-layout/2' is not known here"),
        ("format: tomotactile-layout/1\n", "", "format: is missing"),
        ("name: square", "name: [1]", "name: [1] is not a text"),
        (
            "name:",
            "tolerance: 5\nname:",
            "tolerance: 5 is not a mapping of keys to values, such as {outl",
        ),
        ("name:", "nam:", "nam: unknown key; did you mean 'name'? allowed are format, name,"),
        ("name: square", "name: a\nname: b", "line 3: not valid YAML: key 'name' appears twice"),
        ("1e4", "1e31", "sheet_resistance: 1e+31 is too large, at most 1e+30 works"),
        ("1e4", "-5.0", "sheet_resistance: -5.0 is not a positive number in ohm/sq"),
        ("1e4", "many", "sheet_resistance: 'many' is not a number"),
        ("1e4", ".nan", "sheet_resistance: nan is not a finite number"),
        ("1e4", "0x" + "f" * 5000, "sheet_resistance: a huge number is not a finite number"),
        ("radius", "radus", "electrodes.radus: unknown key; did you mean 'radius'?"),
        ("[0.1, 0.1]]", "[0.1, .inf]]", "electrodes.positions[3][1]: inf is not a finite number"),
        ("[0.1, 0.1]]", "[0.2, 0.1]]", "electrodes.positions[3]: [0.2, 0.1] lies outside"),
        (
            "[0.1, 0.1]]",
            "[-0.1, 0.0959]]",
            "electrodes 2 and 3 overlap: 4.1 mm apart, they need more than 10 mm",
        ),
        (", [0.1, -0.1], [-0.1, 0.1], [0.1, 0.1]", "", "at least 2 are needed"),
        ("{rectangle: [0.2, 0.2]}", "{}", "outline: exactly one of rectangle, circle, polygon"),
        (
            "[0.2, 0.2]}",
            "[0.2, 1e-300]}",
            "outline.rectangle[1]: 1e-300 is no length in m from 1e-09 to 1e+06",
        ),
        (
            "rectangle: [0.2, 0.2]",
            "polygon: [[0, 0], [1, 0], [0, 1]]",
            (
                "outline.polygon: its bounding box is not centred on the origin; "
                "move all points (and electrodes) by [-0.5, -0.5] m"
            ),
        ),
        (
            "rectangle: [0.2, 0.2]",
            "polygon: [[-1, -1], [1, 1], [1, -1], [-1, 2]]",
            "outline.polygon: not a simple polygon: Self-intersection",
        ),
        (
            "[0.2, 0.2]}",
            "[0.2, 0.2], holes: [[[0, 0], [1, 0], [0, 1]]]}",
            "outline.holes[0]: does not lie wholly inside",
        ),
        (
            "name: square",
            "name: s\nsurface: {cylinder: {radius: 0.01}}",
            (
                "layout.yaml: surface.cylinder.radius: 0.01 is too small for a sheet 0.2 m wide, "
                "it must be at least 0.03183 m"
            ),
        ),
        ("name: square", "name: s\ntolerance: {rim: 1}", "tolerance.rim: unknown key"),
        (
            "name: square",
            "name: s\ntolerance: {outline: 1}",
            "tolerance.outline: 1 m on a sheet of 0.2 m: lengths are in m, was 1 mm meant? That is 0.001",
        ),
        (
            "name: square",
            "name: s\ntolerance: {radius: 10}",
            "tolerance.radius: 10 is relative to the radius: 0.1 is 10 %",
        ),
        ("name: square", "name: &x [1]\nprovenance: *x", "aliases (*name) are not allowed"),
        ("name: square", "name: !!python/name:os.system x", "line 2: not valid YAML: could not"),
        ("name: square", "name: 2020-13-45", "not valid YAML: month must be in 1..12"),
        (GOOD, "", "the file is empty"),
        (GOOD, "[" * 100000, "nested too deeply"),
        (GOOD, "a" * 1_000_001, "the file is larger than 1 MB"),
    ],
)
def test_mistake_gets_one_line_with_file_and_key(tmp_path, old, new, expected):
    assert old in GOOD
    line = complaint(write(tmp_path, GOOD.replace(old, new, 1)))
    assert line.startswith("layout.yaml: ")
    assert expected in line


def outlines():
    size = st.floats(1e-3, 10.0)
    holes = st.sampled_from([(), ([[-0.1, -0.1], [0.1, -0.1], [0.0, 0.2]],)])

    def scaled(pair):
        a, holes = pair
        return [np.array(hole) * a / 2 for hole in holes]

    rectangles = st.tuples(size, st.floats(0.01, 1.0), holes).map(
        lambda v: Outline.rectangle(v[0], v[0] * v[1], scaled((v[0] * v[1], v[2])), True)
    )
    circles = st.tuples(size, holes).map(lambda v: Outline.circle(v[0], scaled(v), True))
    hexagon = np.array([[-2, -1], [0, -2], [2, -1], [2, 1], [0.5, 2], [-2, 1]])
    polygons = st.tuples(size, holes).map(
        lambda v: Outline.polygon(hexagon * v[0], scaled(v), True)
    )
    return st.one_of(rectangles, circles, polygons)


@settings(deadline=None)
@given(
    outline=outlines(),
    rho=st.lists(st.floats(0.3, 1.0), min_size=2, max_size=12),
    sheet_resistance=st.floats(1e-3, 1e9),
    bent=st.booleans(),
)
def test_every_layout_survives_its_file(tmp_path_factory, outline, rho, sheet_resistance, bent):
    angle = 0.1 + 2 * np.pi * np.arange(len(rho)) / len(rho)
    half = min(outline.size) / 2
    positions = half * np.array(rho)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    positions = positions[outline.contains(positions)]
    if len(positions) < 2:
        positions = half * np.array([[-0.5, 0.0], [0.5, 0.0]])
    surface = Cylinder(outline.size[0]) if bent else Flat()
    provenance = {"algorithm": "équalize", "metrics": {"hwhm": [0.1, np.float64(0.2)]}, "n": 3}
    layout = Layout("any", outline, sheet_resistance, 1e-3 * half, positions, provenance, surface)
    path = tmp_path_factory.mktemp("layout") / "any.yaml"
    layout.save(path)
    with warnings.catch_warnings():  # of a sheet resistance that may be in kohm/sq
        warnings.simplefilter("ignore", Doubt)
        again = load_layout(path)
    assert (again.name, again.sheet_resistance, again.radius) == (
        layout.name,
        layout.sheet_resistance,
        layout.radius,
    )
    np.testing.assert_array_equal(again.positions, layout.positions)
    assert again.outline.kind == outline.kind
    np.testing.assert_array_equal(again.outline.shell, outline.shell)
    for mine, theirs in zip(again.outline.holes, outline.holes, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert again.surface == surface
    assert again.provenance == {"algorithm": "équalize", "metrics": {"hwhm": [0.1, 0.2]}, "n": 3}


def test_saving_twice_gives_the_same_bytes_and_the_contract_keys(tmp_path):
    layout = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4)
    layout.save(tmp_path / "a.yaml")
    load_layout(tmp_path / "a.yaml").save(tmp_path / "b.yaml")
    assert (tmp_path / "a.yaml").read_bytes() == (tmp_path / "b.yaml").read_bytes()
    content = yaml.safe_load((tmp_path / "a.yaml").read_text())
    assert list(content) == ["format", "name", "outline", "sheet_resistance", "electrodes"]
    assert content["outline"] == {"rectangle": [0.3, 0.2]}
    assert list(content["electrodes"]) == ["radius", "positions"]


def test_how_well_a_sheet_is_made_stands_in_its_file_and_not_in_its_id(tmp_path):
    usual = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4)
    made = replace(usual, tolerance=Tolerance(outline=5e-3, places=1e-3))
    made.save(tmp_path / "made.yaml")
    text = (tmp_path / "made.yaml").read_text()
    assert yaml.safe_load(text)["tolerance"] == {"outline": 5e-3, "places": 1e-3}
    assert load_layout(tmp_path / "made.yaml").tolerance == made.tolerance != usual.tolerance
    assert made.id == usual.id


def test_the_id_tells_layouts_of_one_name_apart_and_survives_the_file(tmp_path):
    layout = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4, name="optimized")
    assert re.fullmatch("optimized#[0-9a-f]{8}", layout.id)
    layout.save(tmp_path / "a.yaml")
    assert load_layout(tmp_path / "a.yaml").id == layout.id
    moved = np.array(layout.positions)
    moved[5, 0] += 1e-6
    others = [
        replace(layout, positions=moved),
        replace(layout, radius=0.003),
        replace(layout, outline=Outline.rectangle(0.31, 0.2)),
        replace(
            layout,
            outline=Outline.rectangle(0.3, 0.2, [[[0.04, 0.01], [0.06, 0.01], [0.06, 0.02]]]),
        ),
    ]
    assert len({layout.id, *(other.id for other in others)}) == 5
    same = [replace(layout, surface=Cylinder(1.0)), replace(layout, provenance={"n": 1})]
    assert {other.id for other in same} == {layout.id}


def test_a_bare_name_matches_every_layout_of_that_name_and_no_other():
    layout = equal_grid(3, 4, (0.3, 0.2), 0.002, 1e4, name="optimized")
    assert layout_ids.matches(layout.id, layout.id) and not layout_ids.is_bare(layout.id, layout.id)
    assert layout_ids.matches("optimized", layout.id) and layout_ids.is_bare("optimized", layout.id)
    for other in ("optimized#00000000", "optimized#", "", "optimize"):
        assert not layout_ids.matches(other, layout.id)
