"""Grids, hexagonal grids and rings: their electrodes, and the command that writes them."""

import re
import shlex

import numpy as np
import pytest

from tomotactile_ros import cli
from tomotactile_ros.layouts.arrangements import hexagonal_grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.files import find_config


def test_a_hexagonal_grid_gives_every_inner_electrode_six_neighbours_at_one_distance():
    pitch = 0.02
    size = 6 * pitch + 0.03, 4 * pitch * np.sqrt(3) / 2 + 0.03
    layout = hexagonal_grid(5, 7, size, 0.002, 1e4, inset=0.015)
    assert layout.electrodes == 6 + 7 + 6 + 7 + 6
    inner = layout.outline.rim_distance(layout.positions) > 0.015 + 0.75 * pitch
    assert inner.sum() == 5 + 4 + 5 and layout.pitches == pytest.approx(pitch)
    apart = np.linalg.norm(layout.positions[:, None] - layout.positions, axis=2)
    assert (np.count_nonzero(apart < 1.01 * pitch, axis=1)[inner] == 1 + 6).all()


@pytest.mark.parametrize(
    "name", ["equal-4x4", "equal-8x8", "equal-16x16", "small-4x4", "small-8x8", "hex-37", "ring-16"]
)
def test_shipped_layouts_come_from_the_command_that_they_name(name, tmp_path):
    """Byte for byte: places, their order, keys and how numbers are written."""
    shipped = find_config("layouts", name)
    words = shlex.split(load_layout(shipped).provenance["settings"]["command"])
    again = tmp_path / f"{name}.yaml"
    assert words[0] == "tomotactile"
    assert cli.main([*words[1:], "--out", str(again)]) == 0
    assert again.read_bytes() == shipped.read_bytes()


@pytest.mark.parametrize("words", ["--size 0.1 0.07", "--size 0.2 0.14 --hex", "--size 0.07 0.1"])
def test_numbers_of_a_file_read_well_and_keep_the_id(words, tmp_path):
    """0.035, and neither 0.0035000000000000005 nor -0.034999999999999996."""
    out = tmp_path / "out.yaml"
    words = f"layout --rows 5 --cols 5 {words} --inset 0.01 --out {out}"
    assert cli.main(words.split()) == 0
    layout = load_layout(out)
    assert max(map(len, re.findall(r"\d\.(\d+)", out.read_text()))) <= 12
    layout.save(out)
    assert load_layout(out).id == layout.id
