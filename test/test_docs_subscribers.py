"""The subscribers of docs/topics.md, as they stand there: Python runs, C++ is compiled and run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from geometry_msgs.msg import Point, Point32
from ros_checks import LATCHED

from tomotactile_ros.msg import Contact, ContactArray, SensorLayout
from tomotactile_ros.nodes.conversions import image_to_message, make_header

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "topics.md").read_text("utf-8")
SECTION = TEXT.split("## Subscribing")[1]
BLOCKS = re.findall(r"```(python|cpp)\n(.*?)```", SECTION, re.DOTALL)
PYTHON = [code for language, code in BLOCKS if language == "python"]
CPP = [code for language, code in BLOCKS if language == "cpp"]
MAIN = """
int main()
{
  tomotactile_ros::msg::ContactArray message;
  message.contacts.resize(1);
  message.contacts[0].force = 2;
  message.contacts[0].id = 3;
  message.contacts[0].position.x = 0.01;
  message.complete = true;
  std::fputs(describe(message).c_str(), stdout);
  message.contacts.clear();
  message.complete = false;
  std::fputs(describe(message).c_str(), stdout);
  message.state = message.WITHHELD;
  message.reason = "torn";
  std::puts(describe(message).c_str());
}
"""


@pytest.fixture
def run(spawn, tmp_path, probe):
    """Runs an example until it has said these lines."""

    def run_one(code, *lines):
        (tmp_path / "example.py").write_text(code)
        process = spawn(sys.executable, tmp_path / "example.py")
        for line in lines:
            probe.until(lambda line=line: line in process.output, line)

    return run_one


def test_contacts_are_written_out(probe, run):
    publisher = probe.node.create_publisher(ContactArray, "/contacts", 2)
    contacts = [Contact(position=Point(x=0.01, z=0.5), force=2.0, id=3)]
    given = (
        {"contacts": contacts, "complete": True},
        {"contacts": [Contact(force=1.0)]},
        {"state": ContactArray.WITHHELD, "reason": "torn"},
        {"complete": True},
    )
    messages = [ContactArray(header=make_header(1.0, "palm"), **each) for each in given]
    probe.node.create_timer(0.1, lambda: [*map(publisher.publish, messages)])
    run(
        PYTHON[0],
        "contact 3: 2.00 N at (0.010, 0.000, 0.500) m in palm",
        "something: 1.00 N at",
        "contact 3 was released",
        "cut by the deadline: rough",
        "not known what touches: torn",
    )


def test_the_peak_is_found_in_metres(probe, run):
    pressure = np.full((2, 3), np.nan, np.float32)
    pressure[1, 2] = 400.0
    header = make_header(1.0, "palm")
    image = image_to_message(pressure, header)
    cells = [Point32(x=0.01 * k, y=-0.02 * k, z=0.005) for k in range(6)]
    layouts = probe.node.create_publisher(SensorLayout, "/layout", LATCHED)
    layouts.publish(SensorLayout(header=header, height=2, width=3, cells=cells))
    images = probe.node.create_publisher(type(image), "/pressure", 2)
    probe.node.create_timer(0.1, lambda: images.publish(image))
    run(PYTHON[1], "400 Pa at (0.0500, -0.1000, 0.0050) m")


def includes() -> list[str]:
    """Folders of headers of this package and of ROS."""
    folders = []
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folders += [p for p in sorted(Path(prefix, "include").glob("*")) if p.is_dir()]
    return [f"-I{folder}" for folder in folders]


def compile_cpp(tmp_path, code: str, *options: str) -> Path:
    compiler = os.environ.get("CXX") or shutil.which("c++")
    source, program = tmp_path / "feel.cpp", tmp_path / "feel"
    source.write_text(code)
    command = [compiler, "-std=c++17", "-Wall", "-Werror", *includes(), *options]
    done = subprocess.run(
        [*command, str(source), "-o", str(program)], check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-5000:]
    return program


def test_the_function_in_cpp_says_the_same(tmp_path):
    program = compile_cpp(tmp_path, CPP[0] + MAIN)
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    assert said.splitlines() == [
        "contact 3: 2.00 N at (0.010, 0.000, 0.000) m",
        "cut by the deadline: rough",
        "not known what touches: torn",
    ]


def test_the_node_in_cpp_compiles(tmp_path):
    if not any(Path(word[2:], "rclcpp", "rclcpp.hpp").exists() for word in includes()):
        pytest.skip("rclcpp comes with a full ROS 2")
    compile_cpp(tmp_path, CPP[0] + CPP[1], "-fsyntax-only")
