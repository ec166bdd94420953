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


@pytest.mark.parametrize(
    ("what", "value"),
    # on a sheet of a millionth of the resistance a contact cannot be seen, the law being the same
    [("contact conductance", 0.0), ("sheet resistance", 0.01)],
)
def test_what_cannot_be_seen_has_no_place(what, value):
    row = row_of(what, value)
    assert [each["profile"] for each in row["profiles"]] == list(PROFILES)
    assert {each["refusal"] for each in row["profiles"]} == {"idle"}


def test_a_refusal_is_a_row():
    row = row_of("electrodes", 1)
    assert row["profiles"] is None and "rows: 1" in row["refusal"]
    (line,) = [line for line in report.stability_lines([row]) if line.startswith("electrodes ")]
    assert line.split() == ["electrodes", "1", *["[1]"] * len(PROFILES)]

    def refuse(value):
        raise InputError("no")

    row = extremes.row(extremes.Trial("what", (np.inf,), refuse), np.inf)
    assert (row["value"], row["refusal"]) == ("inf", "no")  # JSON knows no other


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
    assert [each["place_off"] for each in outcomes] == [None, pytest.approx(1), pytest.approx(20)]
    assert [each["force_off"] for each in outcomes] == [None, 0.0, pytest.approx(40)]
    row = {"what": "w", "value": 1, "warnings": [], "profiles": outcomes, "refusal": None}
    *_, line, told = report.stability_lines([row])
    assert line.endswith("  1.0e-02 !20, -40 % !40") and line.count("!") == 2
    assert "1 of the 2 outcomes" in told


@pytest.mark.parametrize("step", [1, 3, 100])
def test_every_extreme_keeps_its_ends(step):
    for trial in extremes.TRIALS:
        kept = extremes.values(trial, step)
        assert kept[0] == trial.values[0] and kept[-1] == trial.values[-1]
