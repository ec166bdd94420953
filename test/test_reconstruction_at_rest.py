"""What a sensor reads at rest, and what is refused in the place of it."""

import numpy as np
import pytest
from contacts_support import DRIVE, disc, sensor

from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.at_rest import at_rest
from tomotactile_ros.scenes.channels import Channels, Rms
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.support.errors import InputError

NOISE = 0.002  # V


def frames_of(count=8, pressure=0.0, **wrong):
    """(count, 16, 16) V of a 4 x 4 sheet, pressed with a disc of 5 mm or not at all."""
    pressed = [disc(0.03, 0.02, 0.005, pressure=pressure)] if pressure else []
    defects, how = Defects(channels=Channels(**wrong)), {"noise": NOISE, "adc": None}
    made = sensor(load_layout("equal-4x4"), *pressed, defects=defects, **how)
    return np.array([made.frame(0.0, k) for k in range(count)])


def test_what_nothing_touches_is_the_offsets_of_the_channels():
    rest = at_rest(frames_of(offset=Rms(0.01, 1)), DRIVE)
    rows, columns = np.where(~np.eye(16, dtype=bool))
    offsets = np.nanmean(rest.mean, axis=0)
    assert 0.003 < np.std(offsets) < 0.03  # those that were drawn
    left = rest.mean[rows, columns] - offsets[columns]
    assert np.std(left) == pytest.approx(NOISE / np.sqrt(8), rel=0.15)
    assert rest.noise == pytest.approx(NOISE, rel=0.1)
    assert rest.median == pytest.approx(np.median(np.abs(rest.mean[rows, columns])))
    assert rest.doubt == ""


@pytest.mark.parametrize(("pressure", "is_refused"), [(250.0, False), (2000.0, True)])  # 20, 160 mN
def test_a_light_touch_is_doubted_and_a_press_refused(pressure, is_refused):
    frames = frames_of(pressure=pressure)
    if is_refused:
        with pytest.raises(InputError, match="something presses on the sheet"):
            at_rest(frames, DRIVE)
    else:
        assert "is much for a sheet that nothing touches" in at_rest(frames, DRIVE).doubt


def test_missing_readings_are_left_out_and_nothing_but_them_is_refused():
    frames = frames_of()
    frames[0, 3] = np.nan
    frames[:, :, 5] = np.nan
    rest = at_rest(frames, DRIVE)
    assert np.isnan(rest.mean[:, 5]).all() and np.isfinite(rest.mean[3, 4])
    assert rest.noise == pytest.approx(NOISE, rel=0.1)
    with pytest.raises(InputError, match="no valid reading"):
        at_rest(np.full((3, 16, 16), np.nan), DRIVE)


@pytest.fixture(scope="module")
def on_8x8():
    return Pipeline(equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4), Settings("fast", noise=1e-3))


@pytest.mark.parametrize(
    "profile, level", [("fast", 3.3), ("balanced", 0.4), ("accurate", 3.3), ("paper", 0.4)]
)
def test_a_channel_that_stands_away_from_zero_is_named_while_nothing_touches(
    on_8x8, profile, level
):
    pipeline = on_8x8.with_settings(Settings(profile, noise=1e-3))
    frame = np.abs(np.random.default_rng(1).normal(0.0, 1e-3, (64, 64)))
    frame[:, 20] = level
    result = pipeline.process(frame, np.arange(64), 3.3)
    assert result.state == "valid" and result.idle and not result.contacts
    assert result.faults == {20: "its reading never changes"}
