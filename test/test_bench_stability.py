"""The stability table: known errors come out as known, refusals as lines."""

from typing import NamedTuple

import numpy as np
import pytest

from tomotactile_ros.bench import extremes, report
from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.support.errors import InputError


class Reported(NamedTuple):
    """As much of a contact as the table asks for."""

    x: float
    y: float
    force: float
    position_covariance: tuple
    force_std: float


def row_of(what, value):
    """Of the extreme whose name begins with `what`, at this value."""
    trial = next(trial for trial in extremes.TRIALS if trial.what.startswith(what))
    return extremes.row(trial, value)


def test_no_contact_gives_no_place():
    row = row_of("contact conductance", 0.0)
    assert [each["profile"] for each in row["profiles"]] == list(PROFILES)
    assert {each["refusal"] for each in row["profiles"]} == {"idle"}


def test_a_refusal_is_a_row():
    row = row_of("electrodes", 1)
    assert row["profiles"] is None and "rows: 1" in row["refusal"]
    (line,) = [line for line in report.stability_lines([row]) if line.startswith("electrodes ")]
    assert line.split() == ["electrodes", "1", *["[1]"] * len(PROFILES)]


def test_place_and_force_of_every_profile():
    row = row_of("contact conductance", 3.0)
    for each in row["profiles"]:
        assert each["place"] < 0.005 and abs(each["force"]) < 0.1 and each["ghosts"] == 0
    (line,) = [line for line in report.stability_lines([row]) if line.startswith("contact cond")]
    assert line.count("%") == len(PROFILES)


def test_a_value_beyond_its_own_deviation_is_marked():
    """A contact that is told 2 mm and 40 % beside the truth, with deviations of 0.1 mm and 1 %."""
    true, force = np.array([[0.02, 0.03]]), 2.0
    sure = Reported(0.02, 0.032, 1.2, (1e-8, 0, 0, 1e-8), 0.02)
    unsure = Reported(0.02, 0.032, 1.2, (4e-6, 0, 0, 4e-6), np.inf)
    untold = Reported(0.02, 0.032, 1.2, (np.nan,) * 4, np.nan)
    found = {"fast": untold, "balanced": unsure, "accurate": sure}
    outcomes = [extremes._row(name, lambda name: [found[name]], true, 0.2, force) for name in found]
    assert outcomes[0]["place_off"] is None and outcomes[0]["force_off"] is None
    assert outcomes[1]["place_off"] == pytest.approx(1.0) and outcomes[1]["force_off"] == 0.0
    assert outcomes[2]["place_off"] == pytest.approx(20.0)
    assert outcomes[2]["force_off"] == pytest.approx(40.0)
    row = {"what": "w", "value": 1, "warnings": []}
    *_, line, told = report.stability_lines([{**row, "profiles": outcomes, "refusal": None}])
    assert line.endswith("  1.0e-02 !20, -40 % !40") and line.count("!") == 2
    assert "1 of the 2 outcomes" in told


def test_the_contact_law_stays_while_the_sheet_changes():
    """A contact on a sheet of a millionth of the resistance cannot be seen; it was as easy
    before."""
    row = row_of("sheet resistance", 0.01)
    assert {each["refusal"] for each in row["profiles"]} == {"idle"}


def test_what_no_number_can_say_is_text():
    def outcome(value):
        if value == 1:
            return []
        raise InputError("no")

    trial = extremes.Trial("what", (1, np.inf), outcome)
    first, second = (extremes.row(trial, value) for value in trial.values)
    assert first["profiles"] == [] and first["refusal"] is None
    assert second["value"] == "inf" and second["refusal"] == "no"


@pytest.mark.parametrize("step", [1, 3, 100])
def test_every_extreme_keeps_its_ends(step):
    for trial in extremes.TRIALS:
        kept = extremes.values(trial, step)
        assert kept[0] == trial.values[0] and kept[-1] == trial.values[-1]
