"""Files that people have become frames: what is guessed is told, what is refused says what would be
right; the five files that docs/import.md shows, its commands, and what they print."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from devices_support import write_bag
from scipy import io

from tomotactile_ros import InputError
from tomotactile_ros.cli import main
from tomotactile_ros.frames_file import load_frames
from tomotactile_ros.importer.frames import import_frames
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.scenes.defects import Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator

COUNT = 5  # frames
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4, inset=0.02)
E = LAYOUT.electrodes
PLACE = (0.031, -0.022)  # m


@pytest.fixture(scope="module")
def measured():
    """(N, E, E) V of one contact, with noise of 1 mV, and what grounded electrodes read."""
    contact = Contact(shape="disc", center=PLACE, radius=0.008, force=5.0)
    scene = Scene("press", 3.3, (contact,), ContactLaw(1e-4, 1.0), Noise(0.001), own_reading=True)
    simulator = Simulator(LAYOUT, scene, row_period=0.0)
    return np.stack([simulator.frame(0.1 * n, n) for n in range(COUNT)])


def without_own(frames):
    frames = np.array(frames)
    frames[:, np.arange(E), np.arange(E)] = np.nan
    return frames


def imported(source, frames, told=(), atol=1e-6, **how):
    """Import, and compare with `frames`; all of `told` is told."""
    found = import_frames(source, LAYOUT, **how)
    np.testing.assert_allclose(found.frames.voltages, without_own(frames), atol=atol)
    text = "\n".join(found.told)
    for each in told:
        assert each in text
    return found


def write(path, lines, separator, header=(), number="{:.7g}"):
    rows = [separator.join(header)] * bool(header)
    rows += [separator.join(number.format(value) for value in line) for line in lines]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_csv_file_with_the_times_of_its_rows(tmp_path, measured):
    """Rows of electrodes in mV below a header."""
    times = np.arange(COUNT * E) * 0.8  # ms
    lines = np.column_stack([times, 1e3 * measured.reshape(-1, E)])
    write(tmp_path / "press.csv", lines, ",", ["time_ms", *(f"ch{e}" for e in range(E))])
    told = [
        "80 lines of 17 numbers, separated by commas, below a header",
        "5 frames of 16 rows, axes frames x rows x electrodes",
        "unit mV (guessed, --unit)",
        "rows 0.8 ms apart",
        "grounded assumed",
    ]
    frames = imported(tmp_path / "press.csv", measured, told).frames
    assert frames.row_period == pytest.approx(8e-4)
    np.testing.assert_allclose(frames.stamps, np.arange(COUNT) * E * 8e-4)


def test_an_array_alone_may_be_one_frame(measured):
    imported(measured[0], measured[:1], ["1 frames of 16 rows", "unit V (guessed"])


@pytest.mark.parametrize("column", [True, False])
def test_it_is_told_what_is_grounded(tmp_path, measured, column):
    """By a column, or where readings are missing."""
    order = [7, 3, 0, 12]
    few = (measured if column else without_own(measured))[:, order].reshape(-1, E)
    lines = np.column_stack([np.tile(order, COUNT), few]) if column else few
    found = import_frames(write(tmp_path / "few.csv", lines, ","), LAYOUT)
    assert found.frames.grounded.tolist() == order
    how = "from their column" if column else "where readings are missing"
    assert f"grounded {how}: 7 3 0 12" in found.told
    np.testing.assert_allclose(found.frames.voltages, without_own(measured)[:, order], atol=1e-6)


@pytest.mark.parametrize("mark", ["x", "-1", "9999"])
def test_marks_of_missing_readings(tmp_path, measured, mark):
    spoilt = np.array(measured)
    spoilt[1, 3, 9] = np.nan
    path = write(tmp_path / "marked.csv", spoilt.reshape(-1, E), ",")
    path.write_text(path.read_text().replace("nan", mark))
    if mark == "x":
        with pytest.raises(InputError, match=r"line 20: 'x' is not a number.*--missing 'x'"):
            import_frames(path, LAYOUT)
    imported(path, spoilt, missing=[mark])


@pytest.mark.parametrize("axes", ["NLE", "LEN", "ENL"])
def test_axes_are_told_from_shape_diagonal_and_currents(tmp_path, measured, axes):
    """As many frames as electrodes: the shape alone tells nothing."""
    many = np.concatenate([measured] * 4)[:E]
    turned = many.transpose(["NLE".index(letter) for letter in axes])
    np.save(tmp_path / "cube.npy", turned)
    imported(tmp_path / "cube.npy", many)
    imported(tmp_path / "cube.npy", many, axes=axes)


@pytest.mark.parametrize(
    ("name", "place", "force", "known"),
    [
        ("equal-8x8", (0.02, 0.013), 1.0, True),
        ("hex-37", (-0.03, 0.01), 1.0, True),
        ("ring-16", (0.012, -0.021), 1.0, False),  # exchanged, a mirrored contact fits as well
        ("equal-4x4", PLACE, 0.0, False),
    ],
)
@pytest.mark.parametrize("axes", ["NLE", "NEL"])
def test_rows_are_told_from_electrodes_or_said_to_be_assumed(name, place, force, known, axes):
    """With noise of 1 mV, 2 % between channels, and a reading that is stuck."""
    layout = load_layout(name)
    contact = Contact(shape="disc", center=place, radius=0.006, force=max(force, 1.0))
    scene = Scene("press", 3.3, (contact,) * bool(force), ContactLaw(1e-4, 1.0), Noise(0.001))
    frame = Simulator(layout, scene, row_period=0.0).frame(0.0, 0)
    frame = frame * (1 + 0.02 * np.random.default_rng(0).normal(size=layout.electrodes))
    frame[:, 5] = 0.7 * bool(force)
    np.fill_diagonal(frame, np.nan)
    given = frame if axes == "NLE" else frame.T
    found = import_frames(given, layout)
    (told,) = (line for line in found.told if "axes" in line)
    assert ("by the readings" in told, "assumed, not known" in told) == (known, not known)
    np.testing.assert_array_equal(found.frames.voltages[0], frame if known else given)
    assert "--axes NEL" in told or (known and axes == "NLE")
    meant = import_frames(given, layout, axes=axes)
    np.testing.assert_array_equal(meant.frames.voltages[0], frame)


@pytest.mark.parametrize("end", ["", ","])
@pytest.mark.parametrize(("frames", "timed"), [(1, False), (5, False), (E, False), (5, True)])
def test_lines_of_frames_may_end_with_nothing(tmp_path, measured, frames, end, timed):
    """The last electrode's own reading is missing, or each line ends with a separator."""
    many = np.concatenate([measured] * 4)[:frames]
    lines = without_own(many).reshape(frames, -1)
    if timed:
        lines = np.column_stack([0.1 * np.arange(frames), lines])
    path = write(tmp_path / "lines.csv", lines, ",")
    path.write_text(path.read_text().replace("nan", "").replace("\n", end + "\n"))
    imported(path, many)


def test_counts_need_their_bits(tmp_path, measured):
    counts = np.round(np.clip(measured, 0, None) / 3.3 * 4096)
    np.save(tmp_path / "counts.npy", counts.astype(np.uint16))
    with pytest.raises(
        InputError, match=r"counts of a converter \(--unit counts --bits 1\d or more\) or mill"
    ):
        import_frames(tmp_path / "counts.npy", LAYOUT)
    told = ["unit counts of 12 bits, 4096 for 3.3 V"]
    imported(tmp_path / "counts.npy", measured, told, atol=4e-3, bits=12)


def measurements(frame, rotated, own, differences=0):
    """What pyEIT and EIDORS list of a frame, in the words of their documentation."""
    listed = []
    for ground in range(E):
        for k in range(E):
            electrode = (k + ground * rotated) % E
            if electrode == ground and not own:
                continue
            value = frame[ground, electrode]
            if differences:
                value = differences * (frame[ground, (electrode + 1) % E] - value)
            listed.append(value)
    return listed


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("kind", ["own", "others", "differences of neighbours"])
@pytest.mark.parametrize("order", ["pyeit", "eidors"])
def test_the_measurement_orders_of_pyeit_and_eidors(tmp_path, measured, order, kind, rotated):
    """Differences are added up from the ground."""
    frames, sign = measured, 0
    if kind == "differences of neighbours":
        frames = measured - np.stack([np.diag(frame) for frame in measured])[:, :, None]
        sign = 1 if order == "pyeit" else -1
    listed = np.array([measurements(frame, rotated, kind != "others", sign) for frame in frames])
    if order == "pyeit":
        np.save(tmp_path / "file.npy", listed)
    else:
        io.savemat(tmp_path / "file.mat", {"vi": {"meas": listed.T, "type": "data"}})
    told = [kind if sign else f"of {order}"]
    imported(next(tmp_path.iterdir()), frames, told, order=order, rotated=rotated)


def test_pyeit_itself_lists_measurements_so():
    protocol = pytest.importorskip("pyeit.eit.protocol")
    sources = np.column_stack([np.arange(E), np.arange(E)])
    for parser, rotated in (("std", False), ("rotate_meas", True)):
        pairs, _ = protocol.build_meas_pattern_std(sources, E, 1, [parser, "meas_current"])
        numbers = np.reshape(measurements(np.tile(np.arange(E), (E, 1)), rotated, True), (E, E))
        assert np.array_equal(pairs[..., 1], numbers)
        assert np.array_equal(pairs[..., 0], (numbers + 1) % E)


@pytest.mark.parametrize(
    ("shape", "how", "what"),
    [
        ((E * (E - 1),), {}, "without the grounded electrode.*--order pyeit or --order eidors"),
        ((E * (E - 3),), {"order": "pyeit"}, "currents between pairs are another"),
        ((2,), {}, "2 numbers are too few: a frame of this layout is 16 lines.*of 16 readings"),
        ((1, E), {}, "16 numbers are too few.*are fewer electrodes grounded .--grounded"),
        ((31, E), {}, "15 rows are left over; are fewer electrodes grounded"),
        ((37, 11), {}, "is it the right layout"),
        ((2, E, E), {"axes": "NLX"}, "is not N .frames., L .rows. and E"),
        ((2, E, E), {"rotated": True}, "order of pyeit or eidors"),
        ((E, E), {"grounded": [0, 16]}, "electrode 16 does not exist"),
    ],
)
def test_what_is_no_frame_is_refused_with_what_would_be_right(shape, how, what):
    values = np.random.default_rng(0).random(shape)
    with pytest.raises(InputError, match=what):
        import_frames(values, LAYOUT, **how)


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.csv", b"", "holds no numbers"),
        ("a.csv", b"a,b\n", "a header and no numbers"),
        ("a.csv", b"1,2,3\n1,2\n", "line 2 has 2 values, line 1 has 3"),
        ("a.csv", b"t,a\n2026-11-29T12:00:00,1\n", "line 2: '2026-.*' is a date: write times as"),
        ("a.csv", b"1.18 V,1.2 V\n1.2 V,1.3 V\n", "line 1: '1.18 V' has a unit: leave it out"),
        ("a.csv", b"1,5;2\n1.180,3;2\n", "line 2: '1.180,3' has points and commas"),
        ("a.csv", b"1,2\n--,2\n", "line 2: '--' is not a number; .*--missing='--'"),
        ("a.csv", b"\xff\xfe1", "is not a text in UTF-8"),
        ("a.npy", b"\x93NUMPY", "is not a plain array"),
        ("a.mat", b"MATLAB 5.0", "is not a file of MATLAB"),
        ("a.xlsx", b"PK", "is none of .csv"),
    ],
)
def test_files_that_are_damaged_or_of_another_kind(tmp_path, name, content, what):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=what):
        import_frames(tmp_path / name, LAYOUT)


@pytest.mark.parametrize(
    ("left_out", "what"),
    [
        (slice(27, 32), "grounded: the last frame has 11 of 16 rows"),
        (slice(20, 22), "grounded: row 21 of the readings has electrode 6 where 4 is due"),
    ],
)
def test_a_column_of_grounded_electrodes_with_rows_left_out(tmp_path, left_out, what):
    readings = np.random.default_rng(0).random((2 * E, E))
    lines = np.column_stack([np.tile(np.arange(E), 2), readings])
    np.savetxt(tmp_path / "a.csv", np.delete(lines, left_out, axis=0), delimiter=",")
    with pytest.raises(InputError, match=what):
        import_frames(tmp_path / "a.csv", LAYOUT)


def test_lines_above_the_header_and_utf_16(tmp_path, measured):
    path = write(tmp_path / "a.csv", measured.reshape(-1, E), ";", [f"ch{e}" for e in range(E)])
    text = "Device: x\nDate: 2026-01-01\nrate;1000\n\n" + path.read_text()
    path.write_bytes(text.encode("utf-16"))
    imported(
        path, measured, ["80 lines of 16 numbers, separated by semicolons, below a header of 4"]
    )


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        (lambda v: 5.0 / 3.3 * v, "V of a sensor .* more than 3.3 V .--drive-voltage., or mV"),
        (lambda v: 5e3 / 3.3 * v, "mV of a sensor .* or uV .*--unit uV"),
        (lambda v: 3.3 - v, "the grounded electrodes read most"),
        (lambda v: 1.0 - v / 3.3, "are these V0 - v, or 1 - v / V0"),
        (
            lambda v: np.roll(v, -1, axis=2) - v,
            "differences of neighbours .--order pyeit or eidors.",
        ),
    ],
)
def test_readings_that_are_no_voltages_below_the_drive_are_refused(measured, changed, what):
    with pytest.raises(InputError, match=what):
        import_frames(changed(measured), LAYOUT)


def test_shares_of_the_drive_voltage_are_pointed_out(measured):
    imported(measured / 3.3, measured / 3.3, ["--drive-voltage 1"])
    found = import_frames(measured / 3.3, LAYOUT, drive_voltage=1.0)
    assert "shares" not in "".join(found.told)


def test_infinite_readings_are_missing_ones(measured, tmp_path):
    """A file that its own reader refuses."""
    readings = np.array(measured)
    readings[1, 3, 5], readings[2, 7, 0] = np.inf, -np.inf
    np.save(tmp_path / "inf.npy", readings)
    wanted = np.where(np.isinf(readings), np.nan, readings)
    told = ["infinite readings taken for missing: 2"]
    imported(tmp_path / "inf.npy", wanted, told).save(tmp_path / "frames.npz")
    assert np.isnan(load_frames(tmp_path / "frames.npz").voltages[1, 3, 5])


PAGE = (Path(__file__).parents[1] / "docs/import.md").read_text(encoding="utf-8")
SECTIONS = {
    name: text
    for name, text in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
}
TOUCH = (0.012, -0.006)  # m
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


def a_bag(arrays, topics=("/readings",), shaped=True) -> None:
    """A folder `bag` of Float32MultiArray."""
    kind = "std_msgs/msg/Float32MultiArray"

    def messages(types):
        dimension = types["std_msgs/msg/MultiArrayDimension"]
        for number, array in enumerate(arrays):
            dim = [dimension(label="", size=n, stride=0) for n in array.shape if shaped]
            layout = types["std_msgs/msg/MultiArrayLayout"](dim=dim, data_offset=0)
            message = types[kind](layout=layout, data=array.astype(np.float32).ravel())
            yield round(1e9 * (1000 + 0.1 * number)), message

    write_bag(Path("bag"), kind, messages, topics)


def save_pyeit(section: str) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    exec(code, {"np": np, "v": READINGS[:, OFF]})  # noqa: S102 - the page's own line


MAKE = {
    "A matrix of MATLAB": lambda text: io.savemat("press.mat", {"V": READINGS.transpose(1, 2, 0)}),
    "A bag of Float32MultiArray": lambda text: a_bag(READINGS),
    "Arrays of pyEIT": save_pyeit,
}
EXAMPLES = [name for name, text in SECTIONS.items() if "tomotactile import" in text]


@pytest.fixture
def small(tmp_path, monkeypatch):
    """In a folder with the layout of the page."""
    monkeypatch.chdir(tmp_path)
    (command,) = commands(PAGE.split("\n## ")[0])
    assert main(command) == 0


def test_there_are_five_examples():
    assert len(EXAMPLES) == 5 and set(MAKE) < set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_of_the_page(small, name, capsys):
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
    assert np.hypot(contact["x"] - TOUCH[0], contact["y"] - TOUCH[1]) < 0.001


def test_a_bag_of_rows_without_shape_has_their_times(small):
    a_bag(READINGS.reshape(-1, 4), shaped=False)
    found = import_frames("bag", load_layout("small.yaml"))
    np.testing.assert_allclose(found.frames.voltages[:, OFF], READINGS[:, OFF], atol=1e-6)
    assert found.frames.row_period == pytest.approx(0.1)
    assert found.frames.stamps == pytest.approx([1000.0, 1000.4])


def test_bags_of_several_topics_or_of_something_else(small):
    layout = load_layout("small.yaml")
    a_bag(READINGS, topics=("/left", "/right"))
    with pytest.raises(InputError, match=r"several topics \(/left, /right\): name one"):
        import_frames("bag", layout)
    assert len(import_frames("bag", layout, variable="right").frames.voltages) == 2
    with pytest.raises(InputError, match="no frames on up"):
        import_frames("bag", layout, variable="up")
    Path("empty").mkdir()
    with pytest.raises(InputError, match="empty: "):
        import_frames("empty", layout)
