"""docs/import.md as a user follows it: the five files that it shows, its commands, and what they print."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from tomotactile_ros import InputError
from tomotactile_ros.cli import main
from tomotactile_ros.frames_file import load_frames
from tomotactile_ros.importer.frames import import_frames
from tomotactile_ros.layouts.layout import load_layout

PAGE = (Path(__file__).parents[1] / "docs/import.md").read_text(encoding="utf-8")
SECTIONS = {
    name: text
    for name, text in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
}
PLACE = (0.012, -0.006)  # m
READINGS = np.array(
    [
        [[0, 2.203, 1.702, 2.289], [1.861, 0, 2.130, 2.059],
         [1.806, 2.464, 0, 1.949], [2.183, 2.255, 1.704, 0]],
        [[0, 2.202, 1.700, 2.288], [1.861, 0, 2.129, 2.058],
         [1.804, 2.467, 0, 1.947], [2.185, 2.256, 1.707, 0]],
    ]
)  # fmt: skip
OFF = ~np.eye(4, dtype=bool)


def commands(text: str) -> list[list[str]]:
    return [shlex.split(line) for line in re.findall(r"^    tomotactile (.*)$", text, re.MULTILINE)]


def write_bag(messages, topics=("/readings",), shaped=True) -> None:
    """A folder `bag` of Float32MultiArray."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/Float32MultiArray"
    types = store.types
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(Path("bag"), version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, kind, typestore=store)
            for number, array in enumerate(messages):
                dimension = types["std_msgs/msg/MultiArrayDimension"]
                dim = [dimension(label="", size=n, stride=0) for n in array.shape if shaped]
                layout = types["std_msgs/msg/MultiArrayLayout"](dim=dim, data_offset=0)
                message = types[kind](layout=layout, data=array.astype(np.float32).ravel())
                time = round(1e9 * (1000 + 0.1 * number))
                writer.write(connection, time, store.serialize_cdr(message, kind))


def save_pyeit(section: str) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    exec(code, {"np": np, "v": READINGS[:, OFF]})  # noqa: S102 - the page's own line


MAKE = {
    "A matrix of MATLAB": lambda text: io.savemat("press.mat", {"V": READINGS.transpose(1, 2, 0)}),
    "A bag of Float32MultiArray": lambda text: write_bag(READINGS),
    "Arrays of pyEIT": save_pyeit,
}
EXAMPLES = [name for name, text in SECTIONS.items() if "tomotactile import" in text]


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch):
    """In a folder with the layout of the page."""
    monkeypatch.chdir(tmp_path)
    (command,) = commands(PAGE.split("\n## ")[0])
    assert main(command) == 0


def test_there_are_five_examples():
    assert len(EXAMPLES) == 5 and set(MAKE) < set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_of_the_page(name, capsys):
    section = SECTIONS[name]
    *shown, printed = re.findall(r"```text\n(.*?)```", section, re.DOTALL)
    if shown:
        (file,) = re.findall(r"^`([\w.]+)`", section, re.MULTILINE)
        Path(file).write_text(shown[0])
    else:
        MAKE[name](section)
    (command,) = commands(section)
    capsys.readouterr()
    assert main(command) == 0
    assert capsys.readouterr().out == printed
    frames = load_frames("frames.npz", load_layout("small.yaml").id)
    number = len(frames.voltages)
    counts = "bit" in printed
    np.testing.assert_allclose(
        frames.voltages[:, OFF], READINGS[:number, OFF], atol=4e-3 if counts else 1e-6
    )
    assert frames.grounded.tolist() == [0, 1, 2, 3]
    for command in commands(SECTIONS["Then"]):
        assert main(command) == 0
    (contact,) = json.loads(str(np.load("results.npz")["contacts"]))[-1]
    assert np.hypot(contact["x"] - PLACE[0], contact["y"] - PLACE[1]) < 0.001


def test_a_bag_of_rows_without_shape_has_their_times():
    write_bag(READINGS.reshape(-1, 4), shaped=False)
    found = import_frames("bag", load_layout("small.yaml"))
    np.testing.assert_allclose(found.frames.voltages[:, OFF], READINGS[:, OFF], atol=1e-6)
    assert found.frames.row_period == pytest.approx(0.1)
    assert found.frames.stamps == pytest.approx([1000.0, 1000.4])


def test_bags_of_several_topics_or_of_something_else():
    layout = load_layout("small.yaml")
    write_bag(READINGS, topics=("/left", "/right"))
    with pytest.raises(InputError, match=r"several topics \(/left, /right\): name one"):
        import_frames("bag", layout)
    assert len(import_frames("bag", layout, variable="right").frames.voltages) == 2
    with pytest.raises(InputError, match="no frames on up"):
        import_frames("bag", layout, variable="up")
    Path("empty").mkdir()
    with pytest.raises(InputError, match="empty: "):
        import_frames("empty", layout)
