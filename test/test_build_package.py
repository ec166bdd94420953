"""The package itself: its manifest, its version and the messages it generates."""

import json
import os
import pty
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import tomotactile_ros

ROOT = Path(__file__).resolve().parent.parent

CONTRACT = {
    "VoltageFrame": {
        "header": "std_msgs/Header",
        "sequence": "uint32",
        "layout_id": "string",
        "drive_voltage": "float",
        "row_period": "float",
        "electrodes": "uint16",
        "grounded": "sequence<uint16>",
        "voltages": "sequence<float>",
    },
    "Contact": {
        "position": "geometry_msgs/Point",
        "force": "float",
        "pressure": "float",
        "area": "float",
        "radius": "float",
        "position_covariance": "double[4]",
        "force_std": "float",
        "probability": "float",
        "id": "uint32",
        "age": "float",
        "velocity": "geometry_msgs/Vector3",
        "normal": "geometry_msgs/Vector3",
        "tangent": "geometry_msgs/Vector3",
    },
    "SensorState": {
        "header": "std_msgs/Header",
        "layout_id": "string",
        "touches": "uint32",
        "frames": "uint32",
        "untouched": "uint32",
        "gain": "sequence<double>",
        "gain_deviation": "sequence<double>",
        "offset": "sequence<double>",
        "offset_deviation": "sequence<double>",
        "resistance": "sequence<double>",
        "resistance_deviation": "sequence<double>",
        "aside_x": "sequence<double>",
        "aside_x_deviation": "sequence<double>",
        "aside_y": "sequence<double>",
        "aside_y_deviation": "sequence<double>",
        "unknown": "sequence<string>",
        "evidence": "sequence<double>",
        "outline": "double[4]",
        "outline_deviation": "double[4]",
        "radius": "double",
        "radius_deviation": "double",
        "tears": "sequence<double>",
        "places": "sequence<geometry_msgs/Point32>",
        "logarithm": "sequence<double>",
        "logarithm_deviation": "sequence<double>",
        "anisotropy": "double",
        "anisotropy_deviation": "double",
        "anisotropy_direction": "double",
    },
    "SensorLayout": {
        "header": "std_msgs/Header",
        "layout_id": "string",
        "surface": "string",
        "height": "uint32",
        "width": "uint32",
        "cell_width": "double",
        "cell_height": "double",
        "first_x": "double",
        "first_y": "double",
        "cells": "sequence<geometry_msgs/Point32>",
        "electrodes": "sequence<geometry_msgs/Point32>",
        "electrode_radius": "float",
    },
    "ContactArray": {
        "header": "std_msgs/Header",
        "contacts": "sequence<tomotactile_ros/Contact>",
        "state": "uint8",
        "complete": "boolean",
        "reason": "string",
    },
}


@pytest.mark.parametrize("name", CONTRACT)
def test_messages_have_the_fields_of_the_contract(name):
    pytest.importorskip("rclpy")
    messages = pytest.importorskip("tomotactile_ros.msg")
    assert getattr(messages, name).get_fields_and_field_types() == CONTRACT[name]


def test_manifest_names_package_licence_and_message_group():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.attrib["format"] == "3"
    assert package.findtext("name") == "tomotactile_ros"
    assert package.findtext("license") == "Apache-2.0"
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    assert package.findtext("export/build_type") == "ament_cmake"


def test_manifest_names_every_message_package_in_use():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    named = {element.text for element in package if element.tag.endswith("depend")}
    imports = re.compile(r"^\s*(?:from|import) (\w+(?:_msgs|_interfaces|_srvs))\b", re.MULTILINE)
    used = set()
    for source in (ROOT / "tomotactile_ros").rglob("*.py"):
        used.update(imports.findall(source.read_text(encoding="utf-8")))
    assert used <= named


def test_dependencies_are_the_same_everywhere():
    """package.xml for rosdep, pyproject.toml for pip, scripts/requirements.txt for scripts/setup."""
    manifest = ElementTree.parse(ROOT / "package.xml")
    names = {
        e.text.removeprefix("python3-") for e in manifest.iter("exec_depend") if "3-" in e.text
    }
    by_rosdep = {{"serial": "pyserial", "yaml": "pyyaml"}.get(name, name) for name in names}
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    needed = set(json.loads(re.search(r"^dependencies = (.*)$", project, re.MULTILINE)[1]))
    optional = project.split("[project.optional-dependencies]")[1].split("\n[")[0]
    groups = {name: set(json.loads(each)) for name, each in re.findall(r"(\w+) = (.*)", optional)}
    chosen = needed.union(
        *(each for name, each in groups.items() if name not in ("completion", "dask"))
    )
    parts = (ROOT / "scripts" / "requirements.txt").read_text("utf-8").split("\n# ")
    own, tests = ({*part.splitlines()[1:]} for part in parts[-2:])
    assert by_rosdep == {re.split("[<>=~]", each)[0] for each in needed}, (
        "package.xml, pyproject.toml"
    )
    assert own == chosen - tests, "scripts/requirements.txt, pyproject.toml"


def test_version_is_the_same_everywhere():
    manifest = ElementTree.parse(ROOT / "package.xml").findtext("version")

    def named(file, line):
        return re.search(line, (ROOT / file).read_text("utf-8"), re.MULTILINE)[1]

    project = named("pyproject.toml", r'^version = "([^"]+)"')
    changelog = named("CHANGELOG.rst", r"^(\d+\.\d+\.\d+)\b")
    citation = named("CITATION.cff", r"^version: (\S+)$")
    assert manifest == project == changelog == citation == tomotactile_ros.__version__


def test_installed_programs_start_with_the_python_that_they_were_built_with():
    """Whatever comes first in the PATH, as under pyenv and conda."""
    pytest.importorskip("rclpy")
    from ament_index_python.packages import get_package_prefix

    for program in Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros").iterdir():
        first = program.read_text(encoding="utf-8").split("\n", 1)[0]
        assert first == "#!/bin/sh" or Path(first.removeprefix("#!")).is_absolute()
        assert "/env " not in first


def test_a_shell_of_setup_keeps_its_python_after_the_users_profile(tmp_path):
    """pyenv and conda put their own Python first in ~/.bashrc."""
    if not (ROOT / "build" / ".ready").exists():
        pytest.skip("scripts/setup has not built this tree")
    (tmp_path / "python3").write_text("#!/bin/sh\nexit 9\n")
    (tmp_path / "python3").chmod(0o755)
    (tmp_path / ".bashrc").write_text("PATH=$HOME:$PATH; unset PYTHONPATH AMENT_PREFIX_PATH\n")
    command = "python3 -c 'import tomotactile_ros.msg, numpy' && tomotactile --version; exit $?"
    terminal, end = pty.openpty()
    os.write(terminal, f"{command}\n".encode())
    done = subprocess.run(
        [ROOT / "scripts" / "setup", "bash"], stdin=end, stderr=end, stdout=subprocess.PIPE,
        env={**os.environ, "HOME": str(tmp_path)}, check=False, text=True,
    )  # fmt: skip
    os.close(end)
    os.close(terminal)
    assert done.returncode == 0 and "tomotactile 0." in done.stdout


def test_every_message_is_generated():
    listed = set(re.findall(r"msg/(\w+)\.msg", (ROOT / "CMakeLists.txt").read_text("utf-8")))
    assert listed == {path.stem for path in (ROOT / "msg").glob("*.msg")} == set(CONTRACT)


def test_installed_command_works_with_several_processes(tmp_path):
    """Each worker loads the program's file anew and must not run it."""
    pytest.importorskip("rclpy")
    from ament_index_python.packages import get_package_prefix

    program = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros", "tomotactile")
    options = "--rows 2 --cols 2 --method free --starts 2 --steps 1 --resolution 6 --workers 2"
    out = tmp_path / "layout.yaml"
    done = subprocess.run(
        [program, "optimize", *options.split(), "--out", out],
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert out.exists()


def test_the_lock_pins_every_requirement_with_hashes_and_names_no_host():
    lock = (ROOT / "scripts" / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in lock
    entries = re.split(r"\n(?=\S)", re.sub(r"^#.*\n", "", lock, flags=re.MULTILINE).strip())
    pinned = {re.split(r"==|\[", entry)[0] for entry in entries}
    assert all(re.match(r"\S+==\S+ ", entry) and "--hash=sha256:" in entry for entry in entries)
    asked = (ROOT / "scripts" / "requirements.txt").read_text(encoding="utf-8").splitlines()
    names = {re.split(r"[=<>\[]", line)[0] for line in asked if line and line[0] != "#"}
    assert {name.replace("_", "-") for name in names} <= pinned
    assert "setuptools" in pinned  # builds what comes as source


def test_a_source_tree_without_compiled_core_says_so_in_one_line(tmp_path):
    """Python that is started there takes it for the package, in the place of what is installed."""
    shutil.copytree(ROOT / "tomotactile_ros" / "core", tmp_path / "tomotactile_ros" / "core")
    words = [sys.executable, "-c", "import tomotactile_ros.core"]
    without = {key: value for key, value in os.environ.items() if key != "TOMOTACTILE_CORE"}
    environment = without | {"PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    said = ended.stderr
    (error,) = [line for line in said.splitlines() if "Error: " in line]
    assert error.startswith("ImportError: no compiled core in ") and "scripts/setup" in error
