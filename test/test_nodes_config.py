"""config/*.yaml and docs/parameters.md name every parameter of its node, and each of them does something."""

import json
import re
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")

import yaml

from tomotactile_ros.nodes import driver, optimizer, reconstruction
from tomotactile_ros.nodes.reconstruction_parameters import OF_THE_NODE, settings_of
from tomotactile_ros.support.errors import InputError

CONFIG = Path(__file__).resolve().parent.parent / "config"
DOCUMENT = CONFIG.parent / "docs" / "parameters.md"
SPECS = {
    "driver": driver.SPECS,
    "reconstruction": reconstruction.SPECS,
    "optimizer": optimizer.SPECS,
}


@pytest.mark.parametrize("name", SPECS)
def test_every_parameter_is_there_with_its_default_and_a_comment(name):
    text = (CONFIG / f"{name}.yaml").read_text("utf-8")
    given = yaml.safe_load(text)[f"/**/{name}"]["ros__parameters"]
    defaults = {spec.name: spec.default for spec in SPECS[name]}
    assert {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()} == defaults
    commented = re.findall(r"^ +(\w+):.*# ", text, re.MULTILINE)
    assert set(defaults) <= set(commented)


@pytest.mark.parametrize("name", ["driver", "reconstruction"])
def test_every_parameter_is_described_with_its_limits(name):
    for spec in SPECS[name]:
        told = spec.descriptor()
        assert told.description and told.read_only == spec.read_only
        limits = {
            int: told.integer_range,
            float: told.floating_point_range,
            (tuple, int): told.additional_constraints,
        }
        kind = type(spec.default)
        assert limits.get((tuple, spec.items) if kind is tuple else kind, "none"), spec.name


@pytest.mark.parametrize("name", ["driver", "reconstruction"])
def test_every_parameter_is_documented(name):
    section = DOCUMENT.read_text("utf-8").split(f"## `{name}`")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    expected = [_row(spec) for spec in SPECS[name]]
    wrong = [row for row in expected if row not in rows]
    assert not wrong, f"docs/parameters.md, {name}: expected these rows:\n" + "\n".join(wrong)
    left = sorted(set(rows) - set(expected))
    assert not left, f"docs/parameters.md, {name}: no such parameters:\n" + "\n".join(left)


def test_every_parameter_of_the_reconstruction_is_a_setting_or_of_the_node():
    defaults = {spec.name: spec.default for spec in reconstruction.SPECS}
    for spec in reconstruction.SPECS:
        if spec.read_only or spec.name in OF_THE_NODE:
            continue
        values = {**defaults, spec.name: _another(spec)}
        if spec.path:  # it is read
            with pytest.raises(InputError):
                settings_of(values)
            continue
        changes = settings_of(values) != settings_of(defaults)
        assert changes, f"{spec.name}: name a field of Settings like it, or add it to OF_THE_NODE"


def _row(spec) -> str:
    """The row of docs/parameters.md."""
    default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
    shown = default if default and isinstance(default, str) else json.dumps(default)
    at_run_time = "no" if spec.read_only else "(yes)" if spec.path else "yes"
    return f"| `{spec.name}` | `{shown}` | {_range(spec)} | {at_run_time} | {spec.description} |"


def _range(spec) -> str:
    if spec.choices:
        return ", ".join(f"`{choice or json.dumps(choice)}`" for choice in spec.choices)
    return "" if spec.low is None else f"{spec.low:g} to {spec.high:g}"


def _another(spec):
    """A value that is allowed and is not the default."""
    if spec.choices:
        return next(choice for choice in reversed(spec.choices) if choice != spec.default)
    if isinstance(spec.default, tuple):
        return ("gains",) if spec.items is str else (1,)
    if isinstance(spec.default, bool):
        return not spec.default
    return spec.default + type(spec.default)("1")
