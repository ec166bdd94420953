"""Files that people have become frames: what is guessed is told, what is refused says what would be
right."""

import json

import numpy as np
import pytest
from scipy import io

from tomotactile_ros import InputError
from tomotactile_ros.cli import main
from tomotactile_ros.frames_file import load_frames
from tomotactile_ros.importer.frames import import_frames
from tomotactile_ros.layouts.layout import equal_grid
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


@pytest.fixture(scope="module")
def layout_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("layout") / "sheet.yaml"
    LAYOUT.save(path)
    return path


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


def test_a_csv_file_becomes_contacts_by_two_commands(tmp_path, measured, layout_file, capsys):
    """The way of a user: rows of electrodes in mV below a header, with the times of the rows."""
    times = np.arange(COUNT * E) * 0.8  # ms
    lines = np.column_stack([times, 1e3 * measured.reshape(-1, E)])
    header = ["time_ms", *(f"ch{e}" for e in range(E))]
    csv, frames, result = tmp_path / "press.csv", tmp_path / "f.npz", tmp_path / "r.npz"
    write(csv, lines, ",", header)
    words = ["--layout", str(layout_file)]
    assert main(["import", str(csv), *words, "--out", str(frames)]) == 0
    told = capsys.readouterr().out
    for part in (
        "80 lines of 17 numbers, separated by commas, below a header",
        "5 frames of 16 rows, axes frames x rows x electrodes",
        "unit mV (guessed, --unit)",
        "rows 0.8 ms apart",
        "grounded assumed",
    ):
        assert part in told
    loaded = load_frames(frames, LAYOUT.id)
    assert loaded.row_period == pytest.approx(8e-4)
    np.testing.assert_allclose(loaded.stamps, np.arange(COUNT) * E * 8e-4)
    assert loaded.lawless
    how = ["--profile", "balanced", "--out", str(result)]
    assert main(["reconstruct", str(frames), *words, *how]) == 0
    assert main(["inspect", str(result)]) == 0
    assert "no contact law" in capsys.readouterr().out
    (contact,) = json.loads(str(np.load(result)["contacts"]))[-1]
    assert np.hypot(contact["x"] - PLACE[0], contact["y"] - PLACE[1]) < 0.002


@pytest.mark.parametrize("ending", ["csv", "tsv", "npy", "mat"])
def test_a_frame_alone_in_every_kind_of_file(tmp_path, measured, ending):
    path = tmp_path / f"one.{ending}"
    frame = measured[0]
    if ending == "npy":
        np.save(path, frame)
    elif ending == "mat":
        io.savemat(path, {"V": frame, "comment": "by hand"})
    else:
        write(path, frame, "," if ending == "csv" else "\t")
    imported(path, [frame], ["1 frames of 16 rows", "unit V (guessed"])


def test_a_column_says_what_is_grounded(tmp_path, measured):
    order = [7, 3, 0, 12]
    few = measured[:, order]
    lines = np.column_stack([np.tile(order, COUNT), few.reshape(-1, E)])
    path = write(tmp_path / "few.csv", lines, ",")
    found = import_frames(path, LAYOUT)
    assert found.frames.grounded.tolist() == order
    assert "grounded from their column: 7 3 0 12" in found.told
    assert found.frames.voltages.shape == (COUNT, 4, E)


def test_missing_readings_tell_which_electrode_is_grounded(tmp_path, measured):
    order = [7, 3, 0, 12]
    few = without_own(measured)[:, order]
    text = "\n".join(
        ",".join("" if np.isnan(v) else f"{v:.6g}" for v in row) for row in few.reshape(-1, E)
    )
    (tmp_path / "few.csv").write_text(text)
    found = import_frames(tmp_path / "few.csv", LAYOUT)
    assert found.frames.grounded.tolist() == order
    assert "grounded where readings are missing: 7 3 0 12" in found.told


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
@pytest.mark.parametrize("own", [False, True])
def test_the_measurement_order_of_pyeit_and_eidors(tmp_path, measured, rotated, own):
    listed = np.array([measurements(frame, rotated, own) for frame in measured])
    np.save(tmp_path / "pyeit.npy", listed)
    io.savemat(tmp_path / "eidors.mat", {"vi": {"meas": listed.T, "type": "data"}})
    imported(tmp_path / "pyeit.npy", measured, ["of pyeit"], order="pyeit", rotated=rotated)
    imported(tmp_path / "eidors.mat", measured, ["of eidors"], order="eidors", rotated=rotated)


@pytest.mark.parametrize(("order", "sign"), [("pyeit", 1), ("eidors", -1)])
@pytest.mark.parametrize("rotated", [False, True])
def test_differences_of_neighbours_are_added_up_from_the_ground(measured, order, sign, rotated):
    frames = measured - np.stack([np.diag(frame) for frame in measured])[:, :, None]
    listed = np.array([measurements(frame, rotated, True, sign) for frame in frames])
    listed = listed if order == "pyeit" else listed.T
    imported(listed, frames, ["differences of neighbours"], order=order, rotated=rotated)


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
    readings, told = np.array(measured), "infinite readings taken for missing: 2"
    readings[1, 3, 5], readings[2, 7, 0] = np.inf, -np.inf
    path, out = tmp_path / "inf.npy", tmp_path / "frames.npz"
    np.save(path, readings)
    found = imported(path, np.where(np.isinf(readings), np.nan, readings), [told])
    found.save(out)
    assert np.isnan(load_frames(out).voltages[1, 3, 5])
