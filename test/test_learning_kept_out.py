"""What touches that were kept out say of what was learned: a part of it that does not predict them is
left out."""

import numpy as np
import pytest

import tomotactile_ros as tt
from tomotactile_ros.estimation.information import Information
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.findings import lines
from tomotactile_ros.learning.kept_out import GROUPS, Predicted
from tomotactile_ros.learning.recorded import Learned
from tomotactile_ros.learning.state import SensorState

OPERATOR = SheetOperator(tt.equal_grid(3, 3, (0.1, 0.1), sheet_resistance=1e4, radius=0.002))
START = SensorState.unknown(OPERATOR)
WIDTH, SIZE = START.expected, len(START.mean)


def touches(random, count, varying=()):
    """Parts of `count` touches of one sensor, each of which tells all of it to a tenth of what was
    expected; but in each of them what is `varying` is another one."""
    told = 100 / WIDTH**2
    true = random.multivariate_normal(START.mean, START.covariance)
    parts = []
    for _ in range(count):
        seen = true + np.sqrt(1 / told) * random.normal(size=SIZE)
        for part in varying:
            where = START.slice(part)
            seen[where] = START.mean[where] + WIDTH[where] * random.normal(size=len(WIDTH[where]))
        apart = seen - START.mean  # chi-squared is 0 where the touch has the sensor
        parts.append((Information(np.diag(told), told * apart, told @ apart**2, SIZE), 1.0))
    return parts


def judged(parts, of=None):
    def learned(some):
        inverse = np.linalg.inv(START.covariance)
        matrix = inverse + sum(weight * each.matrix for each, weight in some)
        vector = sum(weight * each.vector for each, weight in some)
        covariance = np.linalg.inv(matrix)
        return START.learned(START.mean + covariance @ vector, covariance)

    where = np.arange(SIZE)
    of = range(len(parts)) if of is None else of
    return Predicted(parts, of, START.mean, where, learned, START, np.zeros(SIZE)).judged()


def test_what_all_touches_have_is_kept_and_predicts_the_others():
    found = judged(touches(np.random.default_rng(0), 20))
    assert found.left_out == () and found.gained > 0
    assert found.found == pytest.approx(found.predicted, rel=0.3)
    assert found.layout > 3 * found.found


@pytest.mark.parametrize("name", GROUPS)
def test_what_each_touch_has_of_its_own_is_left_out(name):
    found = judged(touches(np.random.default_rng(1), 20, GROUPS[name]))
    assert found.left_out == (name,)


def test_where_touches_agree_in_nothing_the_layout_is_left():
    found = judged(touches(np.random.default_rng(2), 20, ["sheet", *sum(GROUPS.values(), ())[:5]]))
    assert set(found.left_out) == set(GROUPS) and found.gained == 0


def test_frames_of_one_touch_do_not_predict_each_other():
    """Each touch has gains of its own: those of one predict its own frames, and not the others."""
    parts = touches(np.random.default_rng(4), 5, GROUPS["gains"])
    repeated = [each for each in parts for _ in range(10)]
    found = judged(repeated, [touch for touch in range(5) for _ in range(10)])
    assert found.touches == 5 and found.left_out == ("gains",)
    assert judged(repeated[:10]).left_out == ()


def test_the_evidence_is_that_of_the_readings():
    """Of one number with one reading: a normal distribution of variance 1 + its own."""
    parts = touches(np.random.default_rng(3), 5)
    at = START.mean, np.arange(SIZE)
    whole = Predicted(parts, range(5), *at, lambda some: START, START, 0 * WIDTH)
    evidence = whole.without(())[0]
    direct = 0.0
    for found, _ in parts:
        told = found.matrix.diagonal()
        spread = np.diag(1 / told) + START.covariance
        seen = found.vector / told
        direct -= (seen @ np.linalg.solve(spread, seen) + np.linalg.slogdet(spread)[1]) / 2
        direct -= np.log(told).sum() / 2
    assert evidence == pytest.approx(direct)


def test_the_file_says_what_was_left_out(tmp_path):
    layout, path = OPERATOR.layout, tmp_path / "sensor.yaml"
    state = SensorState(
        START.modes, START.mean, START.covariance, WIDTH, 9, 9, 1, left_out=("gains",)
    )
    save_sensor(path, layout, OPERATOR, state)
    assert load_sensor(path, layout).left_out == ("gains",)
    path.write_text(path.read_text().replace("gains", "gain"))
    with pytest.raises(tt.InputError, match="left_out.*gain.*is none of gains, offsets"):
        load_sensor(path, layout)


def test_the_report_says_how_well_touches_are_predicted():
    kept = judged(touches(np.random.default_rng(1), 20, GROUPS["places of electrodes"]))
    said = "\n".join(lines(Learned(START, OPERATOR, kept_out=kept)))
    assert "touches predicted from the others" in said
    assert "not kept, as other touches are predicted better without: places of electrodes" in said
