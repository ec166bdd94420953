"""The benchmark: what it writes, what of it is the same every time, and where it goes."""

import argparse
import json
import sys

import numpy as np
import pytest

from tomotactile_ros.bench import (
    accuracy,
    peers,
    readme,
    report,
    run,
    stability,
    tables,
    timing,
    trade,
    trials,
)
from tomotactile_ros.bench.conditions import spread_conditions
from tomotactile_ros.bench.growth import exponent
from tomotactile_ros.commands import bench
from tomotactile_ros.errors import InputError
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.yamlio import plain

CASE = trade.Case("equal-4x4", "fast", 20, None)
SIZE = trials.Size(side=3, pairs=2)


@pytest.fixture(scope="module")
def made():
    return trials.make_trials(trade.find_layout(CASE.layout), SIZE)


@pytest.fixture(scope="module")
def row(made):
    return trade.measure(CASE, made, 0.0)


def run_command(*arguments):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    bench.run(parser.parse_args([str(argument) for argument in arguments]))


def test_trials_are_the_same_every_time(made):
    again = trials.make_trials(made.layout, SIZE)
    for kind in ("singles", "defective", "pairs", "repeats"):
        one, other = getattr(made, kind), getattr(again, kind)
        assert np.array_equal(one.frames, other.frames, equal_nan=True)
        assert np.array_equal(np.concatenate(one.positions), np.concatenate(other.positions))


def test_pairs_are_as_far_apart_as_they_say(made):
    apart = [np.linalg.norm(one - other) for one, other in made.pairs.positions]
    assert apart == pytest.approx(np.repeat(made.separations, SIZE.pairs))


def test_repeats_differ_by_the_noise_alone(made):
    spread = np.std(made.repeats.frames, axis=0)
    assert np.nanmedian(spread) == pytest.approx(trials.NOISE, rel=0.2)


def test_accuracy_is_the_same_every_time(made, row):
    conditions = spread_conditions(made.layout, None)
    again = accuracy.measure(Pipeline(made.layout, trade.settings_of(CASE)), made, conditions)
    assert {key: row[key] for key in again} == again


def test_a_row_says_everything_in_plain_numbers(row):
    assert row["setup"] > 0 and row["frame"]["p99"] >= row["frame"]["median"] > 0
    assert row["memory"]["peak"] >= row["memory"]["held"] > 0
    assert 0 < row["contact_error"]["mean"] < 0.02
    assert len(tables.trade_row(row)) == len(tables.TRADE)
    assert json.loads(json.dumps(plain(row), allow_nan=False)) == plain(row)


def test_a_perfect_result_has_no_error():
    class Perfect:
        def __init__(self, positions):
            self.contacts = [
                type("Contact", (), {"x": x, "y": y, "force": 2.0}) for x, y in positions
            ]

    positions = [np.array([[0.01, 0.02], [-0.03, 0.0]])]
    recording = trials.Recording(np.empty(0), positions, [np.array([2.0, 4.0])])
    assert accuracy._resolved([Perfect(positions[0])], recording).tolist() == [True]
    assert accuracy._resolved([Perfect(positions[0][:1])], recording).tolist() == [False]
    assert accuracy._force_error([Perfect(positions[0])], recording).tolist() == [0.0, 0.5]


@pytest.mark.parametrize("count", [8, 16, 32])
def test_chosen_conditions_are_distinct_and_spread(count):
    layout = trade.find_layout("equal-8x8")
    chosen = spread_conditions(layout, count)
    assert len(set(chosen)) == count
    points = layout.positions[chosen]
    apart = np.linalg.norm(points[:, None] - points, axis=2)[~np.eye(count, dtype=bool)].min()
    pitch = 0.2 / 7
    assert apart >= pitch * np.sqrt(64 / count) * 0.7


def test_full_mode_covers_every_choice():
    cases = trade.full_cases()
    assert {case.profile for case in cases} == set(trade.PROFILES)
    assert {case.resolution for case in cases} == set(trade.RESOLUTIONS)
    assert {case.conditions for case in cases} == set(trade.CONDITIONS)
    assert {"equal-4x4", "equal-8x8", "equal-16x16"} <= {case.layout for case in cases}
    assert set(trade.quick_cases()) <= set(cases)


def test_the_front_leaves_out_what_is_slower_and_worse():
    points = [(1.0, 5.0), (2.0, 6.0), (3.0, 2.0), (4.0, 2.0)]
    rows = [{"frame": {"median": t}, "contact_error": {"mean": e}} for t, e in points]
    assert list(trade.front(rows)) == [rows[0], rows[2]]


def test_fitted_exponent():
    sizes = np.array([4.0, 16.0, 64.0])
    assert exponent(sizes, 3 * sizes**1.5) == pytest.approx(1.5)


def test_memory_counts_what_is_held_and_what_was_in_use():
    def make():
        scratch = np.ones(3_000_000)
        return scratch[:1_000_000].copy()

    found = timing.memory(make)
    assert found["held"] == pytest.approx(8e6, rel=0.01)
    assert found["peak"] == pytest.approx(32e6, rel=0.01)


def _result(row):
    default = plain(row) | {"layout": trade.DEFAULT_LAYOUT, "resolution": 40}
    machine = {
        "processor": "some CPU",
        "python": "3.12",
        "libraries": {"numpy": "2"},
        "date": "2026-01-01",
    }
    return {"format": "tomotactile-bench/1", "trade": [default, plain(row)], "machine": machine}


def test_readme_is_rewritten_between_the_comments_only(tmp_path, row):
    path = tmp_path / "README.md"
    path.write_text(
        "before\n<!-- bench:profiles -->\nold table\n<!-- /bench:profiles -->\nafter\n",
        encoding="utf-8",
    )
    readme.rewrite(path, _result(row))
    text = path.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("<!-- /bench:profiles -->\nafter\n")
    assert "old table" not in text and "| `fast` |" in text
    assert text.count("`fast`") == 1  # other layouts are not profiles
    assert "some CPU" in text and "2026-01-01" in text
    readme.rewrite(path, _result(row))
    assert path.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("content", ["nothing here", "<!-- bench:profiles --> without an end"])
def test_readme_without_the_comments_is_refused_and_kept(tmp_path, row, content):
    path = tmp_path / "README.md"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="README.md: .*/bench:profiles"):
        readme.rewrite(path, _result(row))
    assert path.read_text(encoding="utf-8") == content


def test_a_missing_peer_is_a_line(made, monkeypatch):
    for name in ("pyeit", "pyeit.eit.jac", "skfem"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(peers, "_ROUNDS", 1)
    found = peers.compare(made)
    assert "not installed" in found["pyeit"]["skipped"]
    assert "not installed" in found["forward"]["scikit-fem"]["skipped"]
    assert found["dense / fast"]["median"] > 0
    shown = "\n".join(report._peers(found))
    assert shown.count("is not installed: python3 -m pip install") == 2


@pytest.mark.parametrize("content", ["{}", "[]", "not json"])
def test_other_files_are_refused_as_results(tmp_path, content):
    path = tmp_path / "bench.json"
    path.write_text(content)
    with pytest.raises(InputError, match="bench.json: not"):
        run_command("--from", path)


def _not_installed(*_):
    raise ImportError


def test_a_whole_run_of_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(trade, "DEFAULT_LAYOUT", "equal-4x4")
    monkeypatch.setattr(trade, "quick_cases", lambda: [trade.Case("equal-4x4", "fast", 40, None)])
    monkeypatch.setattr(trials, "QUICK", SIZE)
    monkeypatch.setattr(run, "QUICK_GROWTH", ((3, 4), (20, 30)))
    monkeypatch.setattr(peers, "_pyeit", _not_installed)
    monkeypatch.setattr(peers, "_ROUNDS", 1)
    some = stability.trials()[-2:]
    monkeypatch.setattr(stability, "trials", lambda: some)
    out, text = tmp_path / "new" / "bench.json", tmp_path / "README.md"
    text.write_text("<!-- bench:profiles -->\n<!-- /bench:profiles -->\n")
    run_command("--out", out, "--readme", text)
    result = json.loads(out.read_text())
    assert set(result) == {
        "format", "mode", "machine", "seconds", "peak_memory", "trade", "auto", "peers", "growth",
        "stability",
    }  # fmt: skip
    assert result["machine"]["threads"]["OMP_NUM_THREADS"] == "1"
    assert (out.parent / "bench-front.png").read_bytes()[:4] == b"\x89PNG"
    assert (out.parent / "bench-growth.png").read_bytes()[:4] == b"\x89PNG"
    assert "| `fast` |" in text.read_text()
    shown = capsys.readouterr().out
    assert "\n".join(report.lines(result)) in shown
