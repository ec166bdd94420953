"""config/*.yaml names every parameter of its node, with the default and a comment."""

from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")

import yaml
from diagnostic_msgs.msg import DiagnosticArray

from tomotactile_ros.nodes import driver, optimizer, reconstruction

CONFIG = Path(__file__).resolve().parent.parent / "config"
DOCUMENT = CONFIG.parent / "docs" / "parameters.md"
SPECS = {
    "driver": driver.SPECS,
    "reconstruction": reconstruction.SPECS,
    "optimizer": optimizer.SPECS,
}


@pytest.mark.parametrize("name", SPECS)
def test_every_parameter_is_there_with_its_default(name):
    content = yaml.safe_load((CONFIG / f"{name}.yaml").read_text("utf-8"))
    given = content[f"/**/{name}"]["ros__parameters"]
    defaults = {spec.name: spec.default for spec in SPECS[name]}
    assert {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()} == defaults


@pytest.mark.parametrize("name", SPECS)
def test_every_parameter_has_a_comment(name):
    lines = (CONFIG / f"{name}.yaml").read_text("utf-8").splitlines()
    for spec in SPECS[name]:
        (line,) = (line for line in lines if line.strip().startswith(f"{spec.name}:"))
        assert "# " in line


@pytest.mark.parametrize("name", ["driver", "reconstruction"])
def test_every_parameter_is_documented(name):
    text = DOCUMENT.read_text("utf-8")
    section = text.split(f"## `{name}`")[1].split("\n## ")[0]
    for spec in SPECS[name]:
        (row,) = (line for line in section.splitlines() if line.startswith(f"| `{spec.name}` |"))
        assert row.split("|")[3].strip() == _range(spec)


def test_the_aggregator_finds_each_status_in_one_group(probe, start):
    content = yaml.safe_load((CONFIG / "diagnostics.yaml").read_text("utf-8"))
    groups = [g for g in content["/**/analyzers"]["ros__parameters"].values() if g != "Tactile"]
    start("tactile", {"scene": "idle"}, namespace="/skin")
    start("skin", {"sensors": "[skin]", "poses": CONFIG / "poses" / "two_sensors.yaml"})
    reports = probe.listen(DiagnosticArray, "/diagnostics")

    def names():
        return {status.name for report in reports for status in report.status}

    probe.until(lambda: len(names()) >= len(groups), "report of each node")
    for name in names():
        assert sum(any(part in name for part in group["contains"]) for group in groups) == 1


def _range(spec) -> str:
    if spec.choices:
        return ", ".join(f"`{choice}`" for choice in spec.choices)
    return "" if spec.low is None else f"{spec.low:g} to {spec.high:g}"
