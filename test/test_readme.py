"""README.md: its headline figures are those of its table, its files exist, its commands are
known."""

import importlib
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from process_support import python

import tomotactile_ros as tt
from tomotactile_ros.cli import COMMANDS
from tomotactile_ros.support.command_line import Parser

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
LEFT_OUT = ("benchmarks.md", "estimation.md")
PAGES = sorted(page for page in (ROOT / "docs").glob("*.md") if page.name not in LEFT_OUT)


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_headline_figures_are_those_of_the_table():
    profile = re.search(r"## How good is it\?\s+Profile `(\w+)`", TEXT).group(1)
    named = re.findall(r"^\| (?:place|contacts|two|distance).*\|$", TEXT, re.MULTILINE)
    headline = [cells(line) for line in named]
    header, row = (
        cells(re.search(rf"^\| {word} .*\|$", TEXT, re.MULTILINE).group(0))
        for word in ("profile", f"`{profile}`")
    )
    both = [value for name, value in zip(header, row, strict=True) if name == "OSPA"]
    measured = dict(zip(header, row, strict=True))
    place, ghosts = measured["one contact: error, p95; ghosts, missed"].split("; ")
    spoilt, more = measured["worn sensor: error; ghosts, missed"].split("; ")
    assert headline[0][1:] == [place.split(", ")[0], spoilt]
    assert headline[1][1:] == [ghosts, more]
    assert headline[2][1].split(" (")[0] == measured["two contacts from"]
    assert headline[3][1:] == both


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name)
def test_every_file_and_heading_that_is_linked_is_there(page):
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text(encoding="utf-8")):
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}
            assert anchor in slugs, target


def test_every_file_that_a_recipe_names_is_there():
    recipes = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Recipes")[1]
    named = set(re.findall(r"`((?:\w+/)[\w./]*|\w+\.(?:txt|md))`", recipes.split("## Types")[0]))
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_command_that_is_printed_has_the_options_that_it_names():
    """Parsed, not run: `scripts/run_documented` runs them."""
    listed = python(ROOT / "scripts/run_documented", "--list", ROOT / "README.md", *PAGES).stdout
    printed = re.findall(r"\.md: (tomotactile .*?)(?:   -- .*)?$", listed, re.MULTILINE)
    assert len(printed) > 15
    for command in printed:
        _, name, *words = shlex.split(command)
        assert name in COMMANDS, command
        parser = Parser(prog=command)
        importlib.import_module(f"tomotactile_ros.commands.{name}").add_arguments(parser)
        parser.parse_args([word for word in words if word != "..."])  # SystemExit for a wrong one


@pytest.mark.parametrize(
    "layout, scene", [("equal-4x4", "wire"), ("equal-8x8", "wire"), ("equal-8x8", "press")]
)
def test_the_voltages_of_a_sensor_that_is_built_are_those_of_the_simulator(layout, scene):
    page = (ROOT / "docs" / "build.md").read_text(encoding="utf-8")
    voltages = tt.Simulator(tt.load_layout(layout), tt.load_scene(scene)).frame(0.0)
    written = np.array(re.findall(r"(\d\.\d\d) to (\d\.\d\d) V", page), float)
    span = np.round([np.nanmin(voltages), np.nanmax(voltages)], 2)
    assert np.abs(written - span).max(axis=1).min() <= 0.015


def test_only_commands_that_say_that_they_take_minutes_are_left_out_for_it(tmp_path):
    page = tmp_path / "page.md"
    long, short = "bench   # takes minutes: all of it", "inspect a  # a file"
    page.write_text(f"Text:\n\n    tomotactile {long}\n    tomotactile {short}\n\nEnd.\n")
    listed = python(ROOT / "scripts/run_documented", "--list", page).stdout
    assert listed.splitlines() == [
        f"{page}: tomotactile bench   -- left out, takes minutes",
        f"{page}: tomotactile inspect a",
    ]
