"""docs/scenes.md against the loader: its example loads, and every key that loads is explained."""

import dataclasses
import re
from pathlib import Path

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes import contact, course, defects, profile, sheet_field
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import HOLD, MOST

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)


def test_the_example_loads_and_names_every_part_of_a_scene(tmp_path):
    (tmp_path / "example.yaml").write_text(EXAMPLE)
    scene = load_scene(tmp_path / "example.yaml")
    scene.check(load_layout("equal-8x8"))
    assert {c.shape for c in scene.contacts} == set(contact.SHAPES)
    assert all(vars(scene.contact_law).values())
    missing = [key for key, each in defects.by_key(scene.defects).items() if not each]
    assert not missing, f"docs/scenes.md: the example lacks, under defects: {', '.join(missing)}"


def test_words_and_numbers_of_the_page_are_those_of_the_code():
    names = set(re.findall(r"`([a-z_-]+)`", TEXT))
    assert {*contact.SHAPES, *profile.PROFILES, *course.KINDS} <= names
    assert {key for _, keys in course.KINDS.values() for key in keys} <= names
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
    assert f"holds for {HOLD:g} s" in TEXT and f"At most {MOST} are taken" in TEXT


def test_every_shipped_scene_is_listed():
    shipped = {path.stem for path in (ROOT / "config" / "scenes").glob("*.yaml")}
    listed = TEXT.split("## Shipped scenes")[1].replace("`-", "`experiment-")
    listed = set(re.findall(r"`([a-z-]+)`", listed))
    assert shipped == listed, (
        f"docs/scenes.md, 'Shipped scenes': give each scene of config/scenes/ a row with what it is for "
        f"(missing: {sorted(shipped - listed)}), and no other (without a file: {sorted(listed - shipped)})"
    )
