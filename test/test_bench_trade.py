"""The benchmark: what it writes, what of it is the same every time, and where it goes."""

import argparse
import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tomotactile_ros.bench import (
    accuracy,
    cases,
    compare,
    deadlines,
    extremes,
    growth,
    machine,
    peers,
    report,
    run,
    tables,
    timing,
    trade,
    trials,
)
from tomotactile_ros.bench.sensor.parts import PARTS
from tomotactile_ros.bench.sensor.readings import untouched
from tomotactile_ros.bench.sensor.trial import Trial
from tomotactile_ros.commands import bench
from tomotactile_ros.evaluation.scoring import score
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import comparison
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import plain

CASE = cases.Case("equal-4x4")
SIZE = trials.Size(side=3, pairs=1)
EFFORT = trade.Effort(SIZE, frames=1, rounds=2, seconds=0.0, most=0.0)


@pytest.fixture(scope="module", autouse=True)
def three_separations():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trials, "SEPARATIONS", trials.SEPARATIONS[::4])
        yield


@pytest.fixture(scope="module")
def made():
    return trials.make_trials(load_layout(CASE.layout), SIZE)


@pytest.fixture(scope="module")
def grid():
    return CASE.pipeline().grid


@pytest.fixture(scope="module")
def row():
    (found,) = trade.measure([CASE], EFFORT)
    return found


def run_command(*arguments):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return bench.run(parser.parse_args([str(argument) for argument in arguments]))


def contacts(*places, force=1.0):
    return [SimpleNamespace(x=x, y=y, force=force) for x, y in places]


def truth(*places, force=1.0):
    return [{"x": x, "y": y, "force": force} for x, y in places]


def test_pairs_are_as_far_apart_as_they_say(made):
    places = [[(each["x"], each["y"]) for each in pair] for pair in made.of["worn"][1].truths]
    apart = np.linalg.norm(np.diff(places, axis=1), axis=2).ravel()
    assert apart == pytest.approx(np.repeat(made.separations, SIZE.pairs))


def test_frames_and_accuracy_are_the_same_every_time(made, row):
    again = accuracy.measure(CASE.pipeline(), made)
    assert {key: row[key] for key in again} == again


def test_a_row_says_everything_in_plain_numbers(row):
    assert row["setup"]["median"] > 0
    for sensor in accuracy.SENSORS:
        frame = row["frame"][sensor]
        assert frame["p99"] >= frame["median"] > 0 and frame["relative"] > 0
        assert 0 < row["ospa"][sensor] < 0.01
        assert row["scores"][sensor]["one"]["frames"] == 9
        assert row["scores"][sensor]["two"]["frames"] == 3
    assert row["memory"] > 0
    assert 0 < row["contact_error"]["mean"] < 0.02
    assert not {"-", "- mm"} & set(tables.cells(report.TRADE, row))
    assert json.loads(json.dumps(plain(row), allow_nan=False)) == plain(row)


def test_two_contacts_are_told_apart_and_their_forces_judged_where_both_are_found():
    places = (0.01, 0.02), (-0.03, 0.0)
    both, one = (SimpleNamespace(contacts=contacts(*places[:n])) for n in (2, 1))
    assert accuracy.told_apart([both, one], [truth(*places)] * 2).tolist() == [True, False]
    forces = truth(places[0], force=1.0) + truth(places[1], force=2.0)
    assert accuracy._all_force_errors([both, one], [forces] * 2).tolist() == [0.0, 0.5, 0.0, 1.0]
    too_strong, nothing = (
        SimpleNamespace(contacts=contacts((0, 0), force=3.0)),
        SimpleNamespace(contacts=[]),
    )
    true = [truth((0, 0), force=2.0)] * 2
    assert accuracy.force_errors([too_strong, nothing], true) == pytest.approx([0.5, 1.0])


def test_the_front_leaves_out_what_is_slower_and_worse():
    points = [(1.0, 5.0), (2.0, 6.0), (3.0, 2.0), (4.0, 2.0)]
    rows = [
        {"frame": {"worn": {"median": time}}, "ospa": {"worn": distance}}
        for time, distance in points
    ]
    assert list(trade.front(rows, "worn")) == [rows[0], rows[2]]


def test_ghosts_misses_and_withheld_frames_enter_the_accuracy():
    def scored(found, there, state="valid"):
        result = SimpleNamespace(contacts=contacts(*((x, 0.0) for x in found)), state=state)
        return score([result], [truth(*((x, 0.0) for x in there))])

    near, ghost = scored([0.001], [0.0]), scored([0.001, 0.05], [0.0])
    missed, withheld = scored([0.001], [0.0, 0.05]), scored([], [0.0], "withheld")
    assert accuracy.ospa([near]) == pytest.approx(0.001)
    assert accuracy.ospa([ghost]) == accuracy.ospa([missed]) == pytest.approx(0.0055)
    assert accuracy.ospa([withheld]) == pytest.approx(0.010)
    assert accuracy.ospa([near, withheld]) == pytest.approx(0.0055)


def test_peaks_of_images_are_scored_as_contacts(grid):
    places = np.array([[0.03, 0.02], [-0.05, -0.03]])
    away = np.linalg.norm(grid.pixels[:, None] - places, axis=2)
    two = np.exp(-((away / 0.015) ** 2)).sum(axis=1)
    one = np.exp(-((away[:, 0] / 0.015) ** 2))
    found = accuracy.image_scores(np.array([two, one]), [truth(*places)] * 2, grid)
    assert (found["ghosts"], found["missed"], found["true"]) == (0, 1, 4)
    assert found["place"]["worst"] < 0.002


def test_greit_is_the_matrix_of_least_mean_squared_error(made, grid):
    """Against its normal equations, and on contacts that it was not trained with."""
    trained = comparison.Greit(made.layout, grid)
    readings, wanted = trained._readings[trained.read], trained._wanted
    size = np.sqrt(np.mean(readings**2, axis=0))
    data, noise = readings / size, 10.0 * 3e-4**2 * np.mean(size**-2.0)
    normal = data @ data.T / data.shape[1] + noise * np.eye(len(data))
    expected = np.linalg.solve(normal, data @ wanted.T / data.shape[1]).T
    matrix = trained.matrix(trained.read, 10.0)
    np.testing.assert_allclose(matrix, expected, atol=1e-5 * np.abs(expected).max())
    images = trained.images(made.singles.frames, 10.0)
    merit = accuracy.merit(images, made.singles.truths, grid)
    assert merit["position_error"]["mean"] < 0.012  # electrodes are 67 mm apart
    assert merit["hwhm"]["mean"] < 0.05
    worn = made.of["worn"][0].frames  # a channel has no readings
    assert trained.images(worn, 10.0).shape == images.shape


def test_jac_is_the_damped_least_squares_image(made, grid):
    """Against a stack of both sums of squares, and on contacts."""
    step = comparison.Jac(made.layout, grid)
    sensitivity = step._sensitivity[step.read]
    frame = made.singles.frames[0]
    damped = np.diag(np.sqrt(0.3) * np.linalg.norm(sensitivity, axis=0))
    wanted = np.concatenate([frame[step.read], np.zeros(len(damped))])
    expected = np.linalg.lstsq(np.vstack([sensitivity, damped]), wanted, rcond=None)[0]
    np.testing.assert_allclose(step.images(frame[None], 0.3)[0], expected, atol=1e-6)
    images = step.images(made.singles.frames, comparison.DAMPING)
    merit = accuracy.merit(images, made.singles.truths, grid)
    assert merit["position_error"]["mean"] < 0.02


def test_a_table_for_a_narrow_terminal_loses_nothing():
    header, rows = ("name", "first", "second", "third"), [("a", "1", "22", "3" * 9)]
    assert len(list(tables.text(header, rows))) == 3
    lines = list(tables.text(header, rows, width=14))
    assert lines == [
        "name  first", "----  -----", "a     1", "",
        "name  second", "----  ------", "a     22", "",
        "name  third", "----  ---------", "a     333333333",
    ]  # fmt: skip


def test_fitted_exponent():
    sizes = np.array([4.0, 16.0, 64.0])
    assert growth.exponent(sizes, 3 * sizes**1.5) == pytest.approx(1.5)


def test_memory_counts_what_is_held_alone():
    def make():
        scratch = np.ones(3_000_000)
        return scratch[:1_000_000].copy()

    made, held = timing.memory(make)
    assert len(made) == 1_000_000
    assert held == pytest.approx(8e6, rel=0.01)


def _result(row):
    default = plain(row) | {"layout": cases.DEFAULT_LAYOUT}
    made_by = {"processor": "some CPU", "python": "3.12", "libraries": {"numpy": "2"}}
    return {
        "format": run.FORMAT,
        "trade": [default, plain(row)],
        "machine": made_by | {"date": "2026-01-01"},
        "peers": {"ratios": {"dense / fast": 9.0}},
        "sensor": {"crowd": [{"case": "3 contacts", "method": "fast", "ghosts": 0}]},
    }


def test_readme_is_rewritten_between_the_comments_only(tmp_path, row):
    path = tmp_path / "README.md"
    path.write_text(
        "before\n<!-- bench:profiles -->\nold table\n<!-- /bench:profiles -->\nafter\n",
        encoding="utf-8",
    )
    report.rewrite(path, _result(row))
    text = path.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("<!-- /bench:profiles -->\nafter\n")
    assert "old table" not in text and "| `fast` |" in text
    assert text.count("`fast`") == 1  # other layouts are not profiles
    assert "some CPU" in text and "2026-01-01" in text
    report.rewrite(path, _result(row))
    assert path.read_text(encoding="utf-8") == text


def test_the_lattice_has_two_triangles_in_every_pixel(made, grid):
    nodes, triangles = peers.lattice(made.layout, 40)
    centres = nodes[triangles].mean(axis=1)
    for half in np.split(centres, 2):
        assert (np.abs(half - grid.pixels) < np.divide(grid.cell_size, 2)).all()


def test_calls_are_measured_in_turn_until_there_are_enough():
    order = []
    calls = {key: [lambda name=name: order.append(name) for name in key] for key in ("ab", "c")}
    times = timing.in_turn(calls, least=3, seconds=0.0)
    assert "".join(order) == 3 * "aabcc"  # the first of each once more, to warm up
    assert {key: np.shape(each) for key, each in times.items()} == {
        "ab": (3, 1, 2, 2),
        "c": (3, 1, 1, 2),
    }


def _round(seconds, waited=0.0):
    """One pass of a call of each duration; by the clock it `waited` longer for the processor."""
    return np.stack([np.add(seconds, waited), seconds], axis=-1)[None]


def test_slow_calls_are_measured_twice_and_leave_the_others_their_rounds(monkeypatch):
    order, clock = [], iter(np.arange(100.0))
    calls = {key: [lambda name=key: order.append(name)] for key in "ab"}
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    times = timing.in_turn(calls, least=4, seconds=0.0, most=0.0, warm=False)
    monkeypatch.undo()
    assert "".join(order) == "abab"
    assert {key: len(each) for key, each in times.items()} == {"a": 2, "b": 2}


_SLOWER = [_round(speed * np.ones(4)) for speed in (1.0, 1.5, 2.0)]
_QUIET = 9 * [_round([1.0, 2.0, 4.0])]
_CROWDED = [_round([3.0, 6.0], waited=10.0)]


@pytest.mark.parametrize(
    ("times", "others", "ratio"),
    [
        pytest.param([8 * each for each in _SLOWER], _SLOWER, 8.0, id="a machine slows down"),
        pytest.param(
            [each * (3.0 if i % 2 else 1.0) for i, each in enumerate(_QUIET)],
            _QUIET,
            1.0,
            id="single calls are disturbed",
        ),
        pytest.param(_CROWDED, [_round([1.0, 2.0])], 3.0, id="others use the processor"),
    ],
)
def test_ratios_do_not_see_that(times, others, ratio):
    assert timing.ratio(times, others) == ratio
    assert timing.summary(_CROWDED)["median"] == 14.5  # durations are by the clock


def test_every_result_counts_at_the_time_for_which_it_holds(monkeypatch):
    """Two discs of the default scene, 4 x 4: with as much time as there is, all is found and complete."""
    monkeypatch.setattr(deadlines, "FRAMES", 3)
    monkeypatch.setattr(deadlines, "DEADLINES", (60.0,))
    monkeypatch.setattr(deadlines, "SENSORS", {"4 x 4": deadlines.SENSORS["4 x 4"]})
    (row,) = deadlines.measure()
    assert (row["ghosts"], row["missed"], row["withheld"], row["complete"]) == (0, 0, 0, 3)
    assert 0 < row["ospa"] < 1e-3 and row["force"] < 0.2


def test_results_with_the_same_ratios_agree(tmp_path, row, capsys):
    one, other = tmp_path / "one.json", tmp_path / "other.json"
    one.write_text(json.dumps(_result(row)))
    twin = _result(row)
    for each in twin["trade"]:
        for frame in each["frame"].values():
            frame["median"] *= 3  # a slower machine
            frame["relative"] *= 1.09
    other.write_text(json.dumps(twin))
    assert run_command("--compare", one, other) == 0
    shown = capsys.readouterr().out
    assert "+9.0 %" in shown and "accuracy: every figure is the same" in shown


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("ratio", "-20.0 %"),
        ("accuracy", "equal-8x8, fast: two_contacts"),
        ("sensor", "3 contacts, fast: ghosts"),
    ],
)
def test_results_that_differ_are_told(row, key, said):
    one, other = _result(row), _result(row)
    if key == "ratio":
        other["peers"]["ratios"]["dense / fast"] *= 0.8
    elif key == "sensor":
        other["sensor"]["crowd"][0]["ghosts"] = 1
    else:
        other["trade"][0]["two_contacts"] = 0.1 + 1e-9
    assert not compare.agree(one, other)
    assert said in "\n".join(compare.lines(one, other))


def test_two_machines_are_told_and_results_without_a_common_ratio_refused(row):
    one, other = _result(row), _result(row)
    other["machine"] |= {"processor": "another CPU", "date": "2026-02-02"}
    (told,) = [line for line in compare.lines(one, other) if line.startswith("not the same")]
    assert told.startswith("not the same processor: ")
    other["trade"], other["peers"]["ratios"] = [], {}
    with pytest.raises(InputError, match="no ratio in common"):
        compare.agree(one, other)


def _stopped(tick):
    raise KeyboardInterrupt


def _parts(*names):
    """The names of those that were measured, and parts that find their names."""
    done = []

    def part(name):
        return run.Part(name, 1.0, lambda tick: done.append(name) or [name])

    return done, [part(name) for name in names]


def test_a_stopped_benchmark_goes_on_where_it_was(tmp_path):
    done, todo = _parts("trade", "deadlines", "peers", "growth", "stability")
    stopped = [*todo[:3], run.Part("growth", 1.0, _stopped), todo[4]]
    with pytest.raises(KeyboardInterrupt):
        run.measure(stopped, tmp_path / "bench.part")
    result = run.measure(todo, tmp_path / "bench.part")
    assert done == [part.name for part in todo]
    assert (result["trade"], result["growth"]) == (["trade"], ["growth"])


def test_parts_count_on_the_same_machine_with_the_same_code_only(tmp_path, monkeypatch):
    (done, todo), described = _parts("peers"), machine.describe()

    def measured(*methods):
        done.clear()
        assert run.measure(todo, tmp_path / "bench.part", methods)["peers"] == ["peers"]
        return bool(done)

    assert measured()
    monkeypatch.setattr(machine, "describe", lambda: described | {"date": "2001-01-01"})
    assert not measured() and measured("mine:all") and measured()
    monkeypatch.setattr(machine, "describe", lambda: described | {"processor": "other"})
    assert measured() and not measured()
    monkeypatch.setattr(run, "_code", lambda: "other")
    assert measured() and not measured()


def test_a_broken_file_of_parts_is_begun_anew(tmp_path):
    (tmp_path / "bench.part").write_text('{"made by"')
    assert run.measure(_parts("peers")[1], tmp_path / "bench.part")["peers"] == ["peers"]


RESULT = "bench.json --compare README.md README.md"
BOTH = "bench.json --readme README.md"


@pytest.mark.parametrize(
    "words, content, said",
    [
        (BOTH, "nothing here", "README.md: .*/bench:profiles"),
        (BOTH, "<!-- bench:profiles --> without an end", "README.md: .*/bench:profiles"),
        (".", "", "has to end in .json"),
        ("README.md/bench.json", "", "README.md"),
        (RESULT, "{}", "README.md: format: is missing"),
        (RESULT, "[]", "README.md: format: is missing"),
        (RESULT, '{"format": "old/1"}', "README.md: format: 'old/1' is of another version"),
        (RESULT, "not json", "README.md: not valid JSON"),
    ],
)
def test_files_that_cannot_be_are_told_before_anything_is_measured_and_kept(
    tmp_path, monkeypatch, words, content, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "README.md").write_text(content, encoding="utf-8")
    monkeypatch.setattr(run, "measure", lambda *_: pytest.fail("measured"))
    with pytest.raises((InputError, OSError), match=said):
        run_command("--out", *words.split())
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == content


def test_a_whole_run_of_the_command(tmp_path, monkeypatch, capsys):
    """Libraries that are missing are a line each."""
    small = cases.Case("equal-4x4")
    for module in (cases, run):
        monkeypatch.setattr(module, "DEFAULT_LAYOUT", small.layout)
    monkeypatch.setattr(deadlines, "FRAMES", 1)
    monkeypatch.setattr(deadlines, "DEADLINES", (0.1,))
    monkeypatch.setattr(deadlines, "SENSORS", {"4 x 4": deadlines.SENSORS["4 x 4"]})
    monkeypatch.setattr(run, "CASES", [small])
    monkeypatch.setattr(run, "EFFORT", replace(EFFORT, size=trials.Size(2, 1)))
    monkeypatch.setattr(trials, "SEPARATIONS", (0.3, 0.4))
    monkeypatch.setattr(growth, "ELECTRODES", (3, 4))
    monkeypatch.setattr(growth, "RESOLUTIONS", (20, 30))
    monkeypatch.setattr(growth, "_DEFAULT", (4, 20))
    for name in ("pyeit", "pyeit.eit.jac"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setenv("COLUMNS", "1000")
    turns = {"least": 2, "seconds": 0.0, "turn": 0.0}
    in_turn = timing.in_turn
    monkeypatch.setattr(timing, "in_turn", lambda calls, **how: in_turn(calls, **{**how, **turns}))
    monkeypatch.setattr(peers, "_SENSORS", 1)
    monkeypatch.setattr(run, "SENSOR", ("crowd",))
    nothing = Trial("nothing", load_layout("equal-4x4"), untouched(16)[None], [[]])
    monkeypatch.setitem(PARTS, "crowd", lambda step: iter([nothing]))
    some = [replace(extremes.TRIALS[1], values=(0.0,))]  # no contact
    monkeypatch.setattr(extremes, "TRIALS", some)
    out, text = tmp_path / "new" / "bench.json", tmp_path / "README.md"
    text.write_text("<!-- bench:profiles -->\n<!-- /bench:profiles -->\n")
    assert run_command("--out", out, "--readme", text) == 0
    result = json.loads(out.read_text())
    parts = {"trade", "deadlines", "peers", "growth", "stability", "sensor"}
    assert set(result) == parts | {"format", "machine", "seconds", "peak_memory"}
    assert {row["method"] for row in result["sensor"]["crowd"]} == set(cases.PROFILES)
    assert result["machine"]["threads"]["OMP_NUM_THREADS"] == "1"
    assert {path.name for path in out.parent.iterdir()} == {"bench.json", "bench-front.png"}
    assert (out.parent / "bench-front.png").read_bytes()[:4] == b"\x89PNG"
    assert "| `fast` |" in text.read_text()
    found = result["peers"]
    assert "not installed" in found["problem"]["pyeit"]["skipped"]
    assert found["ratios"]["dense / fast"] > 0
    shown = capsys.readouterr().out
    assert "\n".join(report.lines(result)) in shown
    assert shown.count("is not installed: python3 -m pip install") == 1
    assert run_command("--compare", out, out) == 0
