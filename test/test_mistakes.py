"""What people get wrong in their first hour: each mistake is one line that says what was meant."""

import numpy as np
import pytest
import yaml

from tomotactile_ros import cli
from tomotactile_ros.frames_file import save_arrays
from tomotactile_ros.layouts.arrangements import electrode_ring
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.learning.recorded import learn
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import measure_conductance
from tomotactile_ros.reconstruction.mistakes import refuse_mistakes
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import Doubt, InputError

WIDE = equal_grid(6, 10, (0.3, 0.18), 0.0025, 1e4, name="wide")
TIMES = {"stamps": [0.0, 0.06]}


def frames_of(layout, scene, model="closed_form", times=(0.0, 0.2)):
    simulator = Simulator(layout, load_scene(scene), model, row_period=0.0)
    return np.stack([simulator.frame(t, n) for n, t in enumerate(times)])


@pytest.fixture
def own_frames(tmp_path):
    """Writes frames and their layout to files; returns the arguments of `reconstruct`."""
    layout, file, out = (str(tmp_path / name) for name in ("own.yaml", "own.npz", "out.npz"))

    def write(voltages, **how):
        WIDE.save(layout)
        content = {"voltages": voltages, "grounded": np.arange(60), "drive_voltage": 3.3, **how}
        save_arrays(file, content)
        return ["reconstruct", file, "--layout", layout, "--out", out]

    return write


GRID = np.arange(60).reshape(6, 10)
TO_AND_FRO = np.where(np.arange(6)[:, None] % 2, GRID[:, ::-1], GRID)
ORDERS = {
    "only if its electrodes are numbered column by column;": GRID.T.ravel(),
    "only if its electrodes are numbered row by row, to and fro;": TO_AND_FRO.ravel(),
    "from the second one on, its first one last;": np.roll(np.arange(60), -1),
    "in another order than the layout, and in none of the usual ones": (
        np.random.default_rng(1).permutation(60)
    ),
}


@pytest.mark.parametrize(("meant", "order"), ORDERS.items())
def test_electrodes_in_another_order(own_frames, capsys, mistake, meant, order):
    measured = frames_of(WIDE, "default")[:, order][:, :, order]
    if "usual" not in meant:  # a channel that is not read hides nothing
        measured[:, 7] = measured[:, :, 7] = np.nan
    words = own_frames(measured)
    assert meant in mistake(words)
    if "second" in meant:
        assert cli.main(["inspect", *words[1:4]]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert "reads most: wide has it at" in shown
        assert "numbered from the second one on, its first one last" in shown


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_a_pipeline_withholds_frames_of_another_order_at_once_and_says_what_was_meant(profile):
    """Without a search among contacts, which takes seconds and finds none."""
    (voltages,) = frames_of(WIDE, "default", times=(0.2,))
    order = np.arange(60).reshape(6, 10).T.ravel()
    pipeline = Pipeline(WIDE, Settings(profile))
    for number in range(2):
        result = pipeline.process(voltages[np.ix_(order, order)], np.arange(60), 3.3)
        assert result.state == "withheld" and "are numbered column by column" in result.reason
    right = pipeline.process(voltages, np.arange(60), 3.3)
    assert right.state == "valid" and right.contacts


@pytest.mark.parametrize("scene", ["worn-sensor", "defects", "idle", "hand", "slide", "two-points"])
def test_right_frames_are_not_doubted_however_worn_the_sensor_is(scene):
    layout = load_layout("equal-8x8")
    voltages = frames_of(layout, scene, "fem" if scene in ("worn-sensor", "defects") else "auto")
    refuse_mistakes(layout, voltages, np.arange(64), 3.3, 0.001)


def test_a_touch_that_begins_while_rows_are_read_is_no_other_order():
    """Rows before it and after it contradict each other, as those of another order seem to."""
    layout = load_layout("equal-8x8")
    touched, idle = frames_of(layout, "hand", times=(0.5,))[0], np.zeros((64, 64))
    for row in (5, 20, 32, 50, 60):
        frame = np.vstack([idle[:row], touched[row:]])
        refuse_mistakes(layout, [frame], np.arange(64), 3.3, 0.001)


def counts(volts):
    return np.nan_to_num(volts / 3.3 * 4096).astype(np.int32)


@pytest.mark.parametrize(
    ("make", "how", "meant"),
    [
        (lambda volts: volts, {}, ""),
        (lambda volts: 1e3 * volts, {}, "are they in mV? Divide by 1000"),
        (counts, {}, "counts of a conv"),
        (lambda volts: volts, {"drive_voltage": 1.8}, "is the drive voltage right"),
        (lambda volts: -volts, {}, "are two inputs exchanged?"),
        (lambda volts: volts * np.nan, {}, "none is a valid reading, all are NaN"),
        (lambda volts: volts.transpose(0, 2, 1), {}, "was voltages.transpose(0, 2, 1) meant?"),
        (lambda volts: volts, {"grounded": np.arange(1, 61)}, "numbered from 0, not from 1"),
        # results would hold a minute after their frames
        (lambda volts: volts, TIMES | {"row_period": 1e-3}, ""),
        (lambda volts: volts, TIMES | {"row_period": 1.0}, "rows of a frame would take 60 s"),
    ],
)
def test_frames_that_are_written_otherwise(own_frames, mistake, make, how, meant):
    words = own_frames(make(frames_of(WIDE, "default")), **how)
    if meant:
        assert meant in mistake(words)
    else:
        assert cli.main(words) == 0


@pytest.mark.parametrize(("scale", "meant"), [(1e3, "are they in mV"), (2.0, "is that the right")])
def test_frames_of_a_device_in_another_unit(scale, meant):
    """The unit is the reason, not that readings beyond 1000 V are none and channels seem dead."""
    voltages = scale * frames_of(WIDE, "default")[0]
    result = Pipeline(WIDE, Settings("fast")).process(voltages, np.arange(WIDE.electrodes), 3.3)
    assert result.reason.startswith("readings up to") and meant in result.reason


def test_millimetres_elsewhere(tmp_path, mistake):
    words = ["layout", "--rows", "2", "--cols", "3", "--size", "300", "180"]
    words += ["--out", str(tmp_path / "large.yaml")]
    assert "a sheet of 300 m x 180 m" in mistake(words)
    assert cli.main([*words, "--unusual-size"]) == 0
    assert load_layout(tmp_path / "large.yaml").outline.size == (300.0, 180.0)
    contact = {"shape": "disc", "center": [30.0, -20.0], "radius": 0.005}
    scene = {"format": "tomotactile-scene/1", "drive_voltage": 3.3, "contacts": [contact]}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    with pytest.raises(InputError, match=r"contacts\[0\]: never touches .*; is it in mm?"):
        load_scene(tmp_path / "scene.yaml").check(WIDE)


@pytest.mark.parametrize(
    "make",
    [
        lambda **how: Outline.rectangle(200, 200, **how),
        lambda **how: Outline.circle(100, **how),
        lambda **how: equal_grid(4, 4, (200, 200), 5, 1e4, **how).outline,
        lambda **how: electrode_ring(8, 100, 5, 1e4, **how).outline,
    ],
)
def test_sheets_in_millimetres_in_python(make):
    """Constructors and files share one check."""
    with pytest.raises(InputError, match="was 0.2 m x 0.2 m meant.*set unusual_size"):
        make()
    assert make(unusual_size=True).size == pytest.approx((200, 200), rel=1e-3)


def test_radii_in_millimetres_in_python():
    with pytest.raises(InputError, match="contact_radius.*was 5 mm meant. That is 0.005"):
        Pipeline(WIDE, Settings(contact_radius=5.0))
    with pytest.raises(InputError, match="radius.*was 5 mm meant"):
        learn(WIDE, np.zeros((1, 60, 60)), np.arange(60), 3.3, noise=1e-3, radius=5.0)
    with pytest.raises(InputError, match="foot_radius.*was 8 mm meant"):
        measure_conductance(WIDE, np.zeros((1, 60, 60)), np.arange(60), 3.3, foot_radius=8.0)


def test_sheet_resistance_in_kilo_ohms(tmp_path, capsys):
    path = tmp_path / "own.yaml"
    with pytest.warns(Doubt, match="was 10 kohm/sq meant\\? That is 10000"):
        equal_grid(2, 2, (0.3, 0.18), 0.0025, 10.0).save(path)
    assert cli.main(["inspect", str(path)]) == 0
    line = capsys.readouterr().err.strip()
    assert line.startswith("tomotactile inspect: ") and "10 ohm/sq is low" in line
