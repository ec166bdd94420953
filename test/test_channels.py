"""Channels and wires: each defect against its formula."""

import numpy as np
import pytest
from contacts_support import DRIVE, disc, sensor

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.support.errors import InputError

E = 16
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
CONTACTS = disc(0.03, 0.02, pressure=2e4), disc(-0.05, -0.04, 0.004, pressure=1e4)
OFF = ~np.eye(E, dtype=bool)


def simulator(contacts=CONTACTS, switch=0.0, noise=0.0, own_reading=False, order=None, **channels):
    defects = Defects(switch_resistance=switch, channels=Channels(**channels))
    how = {"noise": noise, "own_reading": own_reading, "order": order}
    return sensor(LAYOUT, *contacts, defects=defects, **how)


IDEAL = simulator(own_reading=True).frame(0.0)


def electrode_impedance(sheet, law):
    """Z (E, E), ohm: what electrodes drop below the drive voltage per ampere drawn from one.

    Contacts and drawn current share one bordered system, in which the currents balance.
    """
    touching = [
        (c.patches(a), float(law.conductance(c.pressure))) for c, a in zip(CONTACTS, (4, 4))
    ]
    transfer, resistance = contact_points(sheet, touching)
    count = len(resistance)
    system = np.ones((count + 1, count + 1))
    system[:count, :count] = transfer.among(np.arange(count)) + np.diag(resistance)
    system[count, count] = 0.0
    right = np.vstack([transfer.electrode_point.T, np.ones(E)])
    solved = np.linalg.solve(system, right)
    fed, reference = solved[:count], solved[count]
    return transfer.electrode_electrode - transfer.electrode_point @ fed - reference


def test_a_resistance_to_ground_stands_in_equation_a():
    own = np.linspace(10.0, 4000.0, E)
    simulated = simulator(ground_resistance=tuple(own), switch=60.0, own_reading=True)
    z = electrode_impedance(simulated.sheet, simulated.scene.contact_law)
    np.testing.assert_allclose(z, z.T, rtol=1e-9)
    current = DRIVE / (np.diag(z) + own + 60.0)
    expected = DRIVE - z * current[:, None]
    got = simulated.frame(0.0)
    np.testing.assert_allclose(got[OFF], expected[OFF], atol=1e-8)
    np.testing.assert_allclose(np.diag(got), (own + 60.0) * current, atol=1e-8)
    np.testing.assert_allclose(np.diag(IDEAL), 0.0, atol=1e-12)
    assert np.abs(got - IDEAL)[OFF].max() > 0.1


def test_drawn_channels_have_their_range_and_spread_and_are_those_of_their_seed():
    drawn = Channels(ground_resistance=Uniform(150.0, 75.0, seed=1)).of(10_000).ground_resistance
    assert 75.0 <= drawn.min() < 76.0 and 224.0 < drawn.max() <= 225.0
    assert drawn.mean() == pytest.approx(150.0, rel=0.02)
    numbers = Channels(gain=Rms(0.02, seed=3), offset=Rms(0.005, seed=3)).of(10_000)
    assert numbers.gain.std() == pytest.approx(0.02, rel=0.03)
    assert numbers.gain.mean() == pytest.approx(1.0, abs=1e-3)
    assert numbers.offset.std() == pytest.approx(0.005, rel=0.03)
    assert abs(np.corrcoef(numbers.gain, numbers.offset)[0, 1]) < 0.05
    drawn = [simulator(gain=Rms(0.02, seed=s)).frame(0.0)[OFF] for s in (3, 3, 4)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert np.abs(drawn[0] - drawn[2]).max() > 0.01


def test_gains_and_offsets():
    gain, offset = tuple(np.linspace(0.9, 1.1, E)), tuple(np.linspace(-0.01, 0.02, E))
    got = simulator(gain=gain, offset=offset).frame(0.0)
    np.testing.assert_allclose(got[OFF], (IDEAL * gain + offset)[OFF])


@pytest.mark.parametrize("part", [0.03, tuple(np.linspace(0.0, 0.2, E))])
def test_a_row_read_too_early_keeps_a_part_of_the_row_before(part):
    share = np.asarray(part)
    got = simulator(settling=part).frame(1.0)
    expected = (1 - share) * IDEAL + share * np.roll(IDEAL, 1, axis=0)
    np.testing.assert_allclose(got[OFF], expected[OFF], atol=1e-12)
    order = [3, 12, 3, 0]
    got = simulator(settling=part, order=order, own_reading=True).frame(1.0)
    before = IDEAL[[0, 3, 12, 3]]
    np.testing.assert_allclose(got, (1 - share) * IDEAL[order] + share * before, atol=1e-12)


def test_an_open_wire_reads_the_drive_voltage_wherever_something_touches():
    got = simulator(open=(4, 9), own_reading=True).frame(0.0)
    np.testing.assert_array_equal(got[[4, 9]], DRIVE)
    closed = ~np.isin(np.arange(E), [4, 9])
    np.testing.assert_allclose(got[closed], IDEAL[closed], atol=1e-12)
    assert (simulator((), open=(4, 9), own_reading=True).frame(0.0) == 0).all()
    fast = disc(0.0, 0.0, pressure=2e4, velocity=(1.0, 0.0))
    moving = simulator((fast,), open=(4,)).frame(0.0)
    assert (np.delete(moving[4], 4) == DRIVE).all()
    high = simulator(ground_resistance=tuple(np.full(E, 1e15)), own_reading=True).frame(0.0)
    np.testing.assert_allclose(high, DRIVE, atol=1e-6)


def test_a_stuck_channel_reads_its_voltage_whatever_happens():
    got = simulator(stuck={2: 1.65, 7: 9.0}, noise=0.01).frame(0.0)
    assert set(np.delete(got[:, 2], 2)) == {1.65}
    assert set(np.delete(got[:, 7], 7)) == {3.3 * (1 - 2.0**-12)}  # clipped by the converter
    assert np.isnan(got[2, 2])


KEYS = """
gain: {rms: 0.02, seed: 4}
offset: [0.001, 0.002, 0.003, 0.004]
ground_resistance: {mean: 150.0, spread: 75.0, seed: 5}
settling: 0.01
open: [3]
stuck: {2: 1.5}
"""


def scene_with(path, keys):
    """A scene of these defects, from a file."""
    text = "format: tomotactile-scene/1\ndrive_voltage: 3.3\nown_reading: true\ndefects:\n"
    path.write_text(text + "".join(f"  {line}\n" for line in keys.strip().splitlines()))
    return load_scene(path)


def test_a_scene_file_names_them_and_is_written_back(tmp_path):
    scene = scene_with(tmp_path / "worn.yaml", KEYS)
    offset, ground = (0.001, 0.002, 0.003, 0.004), Uniform(150.0, 75.0, 5)
    expected = Channels(Rms(0.02, 4), offset, ground, 0.01, (3,), {2: 1.5})
    assert scene.own_reading and scene.defects.channels == expected
    scene.save(tmp_path / "again.yaml")
    again = load_scene(tmp_path / "again.yaml")
    assert again.defects == scene.defects and again.own_reading
    scene.check(equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4, inset=0.02))
    with pytest.raises(InputError, match="defects.offset: a list of 4 numbers, the layout has 16"):
        scene.check(LAYOUT)
