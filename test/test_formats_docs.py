"""docs/formats.md and docs/scenes.md against the loaders: their examples load, every key that is allowed is
explained."""

import ast
import dataclasses
import json
import re
from copy import deepcopy
from dataclasses import replace
from functools import reduce
from operator import delitem, getitem, setitem
from pathlib import Path

import numpy as np
import pytest
import yaml

from tomotactile_ros import frames_file
from tomotactile_ros.cli import main
from tomotactile_ros.commands.reconstruct import contact_entry, results_writer
from tomotactile_ros.frames_file import load_frames, save_frames
from tomotactile_ros.layouts.layout import FORMAT, LOW_RESISTANCE, equal_grid, load_layout
from tomotactile_ros.layouts.outline import LARGEST, SMALLEST
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW, ContactEstimate, Result
from tomotactile_ros.reconstruction.tare_file import Tare
from tomotactile_ros.scenes import contact, course, defects, profile, sheet_field
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import HOLD, MOST
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import keys_of

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
LAYOUT, CALIBRATION = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
SCENES = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
(SCENE,) = re.findall(r"```yaml\n(.*?)```", SCENES, re.DOTALL)
(FRAMES,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


def rows(section):
    """Cells of each row in the table of a section, by the row's first code word."""
    text = TEXT.split(f"\n## {section}\n")[1].split("\n## ")[0]
    lines = re.findall(r"^\| `([\w.]+)` \|(.*)\|$", text, re.MULTILINE)
    return {key: [cell.strip() for cell in rest.split("|")] for key, rest in lines}


def test_the_layout_loads_and_names_every_part(tmp_path, capsys):
    (tmp_path / "example.yaml").write_text(LAYOUT)
    layout = load_layout(tmp_path / "example.yaml")
    assert layout.outline.holes and layout.surface and layout.provenance
    assert main(["inspect", str(tmp_path / "example.yaml")]) == 0
    assert "  hole " in capsys.readouterr().out
    assert rows("Layout")["format"][-1] == f"`{FORMAT}`"
    explained = rows("Layout")["unusual_size"][-1]
    assert f"{1e3 * SMALLEST:g} mm" in explained and f"{LARGEST:g} m" in explained
    assert f"below {LOW_RESISTANCE:g}" in rows("Layout")["sheet_resistance"][-1]


PLACES = {"angle", "center", "direction", "from", "holes", "line", "path", "points", "polygon"}
PLACES |= {"positions", "stuck"}  # numbers that may be negative


def parts_of(content, way=()):
    """The way to each part of a file, by keys and indices, and what stands there."""
    inner = content if isinstance(content, (list, dict)) else ()
    for key, part in inner.items() if isinstance(content, dict) else enumerate(inner):
        if key != "provenance":  # anything may stand there
            yield (*way, key), part
            yield from parts_of(part, (*way, key))


@pytest.mark.parametrize(
    ("text", "load"), [(LAYOUT, load_layout), (SCENE, load_scene)], ids=["layout", "scene"]
)
def test_no_part_of_a_file_is_what_it_cannot_be(tmp_path, text, load):
    """A line names each number that is none, or negative and no place, each key that is misspelt, and those
    that the page calls required where they are missing."""
    path, missed, right = tmp_path / "wrong.yaml", set(), yaml.safe_load(text)

    def refusal(way, change, *what):
        content = deepcopy(right)
        change(reduce(getitem, way[:-1], content), way[-1], *what)
        path.write_text(yaml.safe_dump(content))
        try:
            load(path)
        except InputError as error:
            line = str(error)
            assert "\n" not in line and [key for key in way if isinstance(key, str)][-1] in line
            return line
        return ""

    for way, part in parts_of(right):
        number = isinstance(part, (int, float)) and not isinstance(part, bool)
        wrong = (
            [np.nan, "many", {}, [1]] if number else [5] if isinstance(part, (list, dict)) else []
        )
        for each in wrong + [-1e3] * (number and not PLACES.intersection(way)):
            assert refusal(way, setitem, each), (way, each)
        if isinstance(way[-1], str):
            misspelt = refusal(way, lambda inside, key: setitem(inside, key + "s", inside.pop(key)))
            assert "unknown key" in misspelt or "is missing" in misspelt, way
            if "is missing" in refusal(way, delitem):
                missed.add(".".join(map(str, way)))
    if load is load_layout:
        assert {key for key, cells in rows("Layout").items() if cells[1] == "required"} <= missed


KEYS = set(re.findall(r"`([a-z_.]+)`", SCENES))


@pytest.mark.parametrize(
    ("prefix", "old", "new"),
    [
        ("", "name:", "label:"),
        ("outline.", "holes:", "holess:"),
        ("electrodes.", "radius: 0.0025", "radios: 0.0025"),
        ("surface.", "cylinder:", "zylinder:"),
        ("surface.cylinder.", "{radius: 0.15}", "{radios: 0.15}"),
        ("surface.grid.", "{cylinder: {radius: 0.15}}", "{grid: {pts: []}}"),
        ("surface.mesh.", "{cylinder: {radius: 0.15}}", "{mesh: {files: x}}"),
        (None, "drive_voltage", "drive_voltages"),
        (None, "radius: 0.006", "radios: 0.006"),
        (None, "duration:", "durations:"),
        (None, "exponent:", "exponents:"),
        (None, "swapped:", "swaped:"),
    ],
)
def test_every_key_that_layouts_and_scenes_allow_is_explained(tmp_path, prefix, old, new):
    """The loaders say which keys there are when they complain of one that is not; `prefix`: of a layout."""
    of_scene = prefix is None
    text, load = (SCENE, load_scene) if of_scene else (LAYOUT, load_layout)
    (tmp_path / "wrong.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load(tmp_path / "wrong.yaml")
    allowed = str(error.value).split("allowed are ")[1].split(", ")
    explained = KEYS if of_scene else set(rows("Layout"))
    explained = explained | {key.rsplit(".", 1)[0] for key in explained}
    assert {(prefix or "") + key for key in allowed} <= explained


def test_every_array_of_frames_is_explained_and_read(tmp_path):
    """Those that `simulate` writes, and those that the reader asks for by name."""
    layout = equal_grid(2, 2, (0.1, 0.1), 0.005, 1e4)
    path = tmp_path / "frames.npz"
    frames = np.zeros((1, 4, 4))
    save_frames(path, layout, load_scene("default"), frames, np.arange(4), np.zeros(1), 1e-3)
    with np.load(path) as written:
        assert set(written.files) == set(rows("Frames"))
    source = ast.walk(ast.parse(Path(frames_file.__file__).read_text(encoding="utf-8")))
    texts = {node.value for node in source if isinstance(node, ast.Constant)}
    assert set(rows("Frames")) <= texts
    assert rows("Frames")["drive_voltage"][2].startswith(f"{frames_file.DEFAULT_DRIVE:g},")
    assert f"up to {frames_file.MAX_BYTES / 1e9:g} GB" in TEXT


def test_the_shortest_file_of_frames_loads_with_the_defaults_of_the_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(FRAMES, {})  # noqa: S102 - the page's own lines
    path = tmp_path / "frames.npz"
    loaded = load_frames(path)
    assert loaded.voltages.shape == (1, 2, 4)
    assert loaded.drive_voltage is loaded.stamps is loaded.truth is loaded.contact_law is None
    assert loaded.row_period == 0
    arrays = dict(np.load(path))
    for name in arrays:
        np.savez(path, **{key: array for key, array in arrays.items() if key != name})
        with pytest.raises(InputError, match=f"{name}: is missing"):
            load_frames(path)
    assert set(arrays) == {key for key, cells in rows("Frames").items() if cells[2] == "required"}


def test_the_calibration_loads_and_needs_what_the_table_says(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_text(CALIBRATION)
    law = load_calibration(path)
    assert (law.coefficient, law.exponent) == (1.2e-4, 0.9)
    for key in rows("Calibration"):
        path.write_text(CALIBRATION.replace(key, "another"))
        with pytest.raises(InputError, match=f"{key}: is missing"):
            load_calibration(path)


def test_every_array_of_a_result_is_explained(tmp_path):
    known = ContactEstimate(0, 0, 1, 1, 1, 1, (1.0, 0.0, 0.0, 1.0), 0.1, 0.9, conductance=1e-6)
    image = np.zeros((2, 2))
    result = Result(image, image, [known], (), False, 0.0, state="withheld", reason="why")
    result = result.without_law(DEFAULT_LAW)
    with results_writer(tmp_path / "result.npz", law=None) as take:
        take(result, 0.1, 2.5)
    with np.load(tmp_path / "result.npz") as written:
        assert set(written.files) == set(rows("Result"))
        (contact,) = json.loads(str(written["contacts"]))[0]
    assert contact == contact_entry(result.contacts[0])
    assert contact["force"] is contact["pressure"] is contact["force_std"] is None
    assert set(contact) <= set(re.findall(r"`(\w+)`", rows("Result")["contacts"][-1]))


@pytest.fixture(scope="module")
def every_file(tmp_path_factory):
    """A file of each row of the page's first table, made by the commands that it names."""
    folder = tmp_path_factory.mktemp("files")
    made = {name: folder / f"{name}.npz" for name in ("frames", "tare", "result", "kept")}
    made |= {name: folder / f"{name}.yaml" for name in ("layout", "scene", "sensor", "calibration")}
    made["state"] = folder / "better.search"
    layout = ["--layout", made["layout"]]
    scene = load_scene("default")
    one = replace(scene.contacts[0], center=(0.02, -0.03), radius=0.008, force=2.0, pressure=None)
    replace(scene, contacts=(one,)).save(made["scene"])
    simulated = ["simulate", *layout, "--row-period", "0.000999999"]
    commands = {
        "layout": ["layout", "--rows", 4, "--cols", 4],
        "frames": [*simulated, "--scene", made["scene"], "--frames", 4],
        "idle": [*simulated, "--scene", "idle", "--frames", 4],
        "tare": ["tare", *layout, "--recording", folder / "idle.npz"],
        "sensor": ["learn", made["frames"], *layout, "--contact-radius", "0.008"],
        "calibration": ["calibrate", f"{made['frames']}=2", *layout, "--exponent", "1"],
        "result": ["reconstruct", made["frames"], *layout],
    }
    for name, command in commands.items():
        out = made.get(name, folder / f"{name}.npz")
        assert main([*map(str, command), "--out", str(out)]) == 0
    grid = load_layout(made["layout"])
    search = Work(path=made["state"])
    search.begin(method="free", start=grid.id, steps=20, spacing=2.2 * 0.0025)
    search.map(abs, [-1, -2, -3])
    Tare(grid.id, np.full((16, 16), 0.0021), 32, 1.8e9, "").save(made["kept"])
    return made


TOLD = {
    "layout": "16 electrodes, rectangle",
    "scene": "2 N",
    "frames": "4 frames of 16 ground conditions; at its stamp + i x 1 ms",
    "tare": "1 frame of 16 ground conditions; a tare",
    "sensor": "sensor learned with layout; learned from 1 distinct touch; offsets: ; "
    "in corners, most: electrode",
    "calibration": "contact law g = ; 10 N on a disc of 5 mm radius: 127 kPa",
    "result": "last image, peak; contacts of the last frame",
    "state": "search free, from layout#; 3 results are known; steps 20; spacing 5.5 mm",
    "kept": "mean of 32 frames, 2027-01-15 08:00 UTC; readings 2.1 to 2.1 mV",
}


@pytest.mark.parametrize("name", TOLD)
def test_inspect_shows_every_file_of_the_page(every_file, capsys, name):
    assert main(["inspect", str(every_file[name]), "--layout", str(every_file["layout"])]) == 0
    shown = " ".join(capsys.readouterr().out.split()).replace(";", ",")
    for part in TOLD[name].split("; "):
        assert part in shown
    assert not re.search(r"\.\d{8}|99999|e[-+]0\d", shown)  # numbers as people write them


def test_every_row_of_the_first_table_is_among_the_files_that_are_shown(every_file):
    table = TEXT.split("| file | written by")[1].split("\n\n")[0]
    first = {re.search(r"\w+", line).group() for line in table.splitlines()[2:]}
    assert first == set(every_file) - {"kept"}


# -- docs/scenes.md --------------------------------------------------------------------------------


def test_the_example_loads_and_names_every_part_of_a_scene(tmp_path):
    (tmp_path / "example.yaml").write_text(SCENE)
    scene = load_scene(tmp_path / "example.yaml")
    scene.check(load_layout("equal-8x8"))
    assert {c.shape for c in scene.contacts} == set(contact.SHAPES)
    assert all(vars(scene.contact_law).values())
    missing = [key for key, each in defects.by_key(scene.defects).items() if not each]
    assert not missing, f"docs/scenes.md: the example lacks, under defects: {', '.join(missing)}"


def test_words_and_numbers_of_the_page_are_those_of_the_code():
    names = set(re.findall(r"`([a-z_-]+)`", SCENES))
    assert {*contact.SHAPES, *profile.PROFILES, *course.KINDS} <= names
    assert {key for kind in course.KINDS.values() for key in keys_of(kind)} <= names
    assert {f.name for f in dataclasses.fields(ContactLaw)} - {"hysteresis", "creep"} <= names
    assert {f.name for f in dataclasses.fields(defects.Drift)} <= names
    for part in (
        sheet_field.Anisotropy,
        sheet_field.Gradient,
        sheet_field.Tear,
        sheet_field.Patch,
        sheet_field.Temperature,
    ):
        assert {f.name for f in dataclasses.fields(part)} <= names, part
    assert f"holds for {HOLD:g} s" in SCENES and f"At most {MOST} are taken" in SCENES


def test_every_shipped_scene_is_listed():
    shipped = {path.stem for path in (ROOT / "config" / "scenes").glob("*.yaml")}
    listed = SCENES.split("## Shipped scenes")[1].replace("`-", "`experiment-")
    listed = set(re.findall(r"`([a-z-]+)`", listed))
    assert shipped == listed, (
        f"docs/scenes.md, 'Shipped scenes': give each scene of config/scenes/ a row with what it is for "
        f"(missing: {sorted(shipped - listed)}), and no other (without a file: {sorted(listed - shipped)})"
    )
