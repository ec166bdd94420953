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

# what others build on: the fields of each message and their types
CONTRACT = """
VoltageFrame:
    std_msgs/Header header
    uint32 sequence
    string layout_id
    float drive_voltage row_period
    uint16 electrodes
    sequence<uint16> grounded
    sequence<float> voltages
Contact:
    geometry_msgs/Point position
    float force pressure area radius
    double[4] position_covariance
    float force_std probability
    uint32 id
    float age
    geometry_msgs/Vector3 velocity normal tangent
SensorState:
    std_msgs/Header header
    string layout_id
    uint32 touches frames untouched
    sequence<double> gain gain_deviation offset offset_deviation resistance resistance_deviation
    sequence<double> aside_x aside_x_deviation aside_y aside_y_deviation
    sequence<string> unknown
    sequence<double> evidence
    double[4] outline outline_deviation
    double radius radius_deviation
    sequence<double> tears
    sequence<geometry_msgs/Point32> places
    sequence<double> logarithm logarithm_deviation
    double anisotropy anisotropy_deviation anisotropy_direction
SensorLayout:
    std_msgs/Header header
    string layout_id surface
    uint32 height width
    double cell_width cell_height first_x first_y
    sequence<geometry_msgs/Point32> cells electrodes
    float electrode_radius
ContactArray:
    std_msgs/Header header
    sequence<tomotactile_ros/Contact> contacts
    uint8 state
    boolean complete
    string reason
    boolean ambiguous
    sequence<tomotactile_ros/Contact> alternative
"""


def fields_of(name: str) -> dict[str, str]:
    """Field -> type."""
    (text,) = re.findall(rf"^{name}:\n((?: {{4}}.*\n)+)", CONTRACT, re.MULTILINE)
    lines = (line.split() for line in text.splitlines())
    return {field: kind for kind, *fields in lines for field in fields}


MESSAGES = re.findall(r"^(\w+):", CONTRACT, re.MULTILINE)


@pytest.mark.parametrize("name", MESSAGES)
def test_messages_have_the_fields_of_the_contract(name):
    messages = pytest.importorskip("tomotactile_ros.msg")
    assert getattr(messages, name).get_fields_and_field_types() == fields_of(name)


def test_manifest_names_every_message_package_in_use():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("license") == "Apache-2.0"
    named = {element.text for element in package if element.tag.endswith("depend")}
    imports = re.compile(r"^\s*(?:from|import) (\w+(?:_msgs|_interfaces|_srvs))\b", re.MULTILINE)
    used = set()
    for source in (ROOT / "tomotactile_ros").rglob("*.py"):
        used.update(imports.findall(source.read_text(encoding="utf-8")))
    assert used <= named


def test_dependencies_are_the_same_everywhere():
    """package.xml for rosdep, pyproject.toml for pip, scripts/requirements.txt for scripts/setup."""
    manifest = ElementTree.parse(ROOT / "package.xml")
    keys = (e.text for e in manifest.iter("exec_depend") if "3-" in e.text)
    renamed = {"serial": "pyserial", "yaml": "pyyaml"}
    by_rosdep = {renamed.get(key, key) for key in (key.removeprefix("python3-") for key in keys)}
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    needed = set(json.loads(re.search(r"^dependencies = (.*)$", project, re.MULTILINE)[1]))
    optional = project.split("[project.optional-dependencies]")[1].split("\n[")[0]
    groups = {name: set(json.loads(each)) for name, each in re.findall(r"(\w+) = (.*)", optional)}
    chosen = needed.union(
        *(each for name, each in groups.items() if name not in ("completion", "dask"))
    )
    parts = (ROOT / "scripts" / "requirements.txt").read_text("utf-8").split("\n# ")
    own, tests = ({*part.splitlines()[1:]} for part in parts[-2:])
    named = {re.split("[<>=~]", each)[0] for each in needed}
    assert by_rosdep == named, "package.xml, pyproject.toml"
    assert own == chosen - tests, "scripts/requirements.txt, pyproject.toml"


def test_version_is_the_same_everywhere_and_the_article_is_cited():
    manifest = ElementTree.parse(ROOT / "package.xml").findtext("version")

    def named(file, line):
        return re.search(line, (ROOT / file).read_text("utf-8"), re.MULTILINE)[1]

    project = named("pyproject.toml", r'^version = "([^"]+)"')
    changelog = named("CHANGELOG.rst", r"^(\d+\.\d+\.\d+)\b")
    citation = named("CITATION.cff", r"^version: (\S+)$")
    assert manifest == project == changelog == citation == tomotactile_ros.__version__
    # the article that a user is to cite
    assert "10:1157911" in (ROOT / "README.md").read_text("utf-8")
    assert named("CITATION.cff", r"doi: \S+(\.2023\.1157911)$")
    assert named("CITATION.cff", r"^license: (\S+)$") == "Apache-2.0"


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
    assert listed == {path.stem for path in (ROOT / "msg").glob("*.msg")} == set(MESSAGES)


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
