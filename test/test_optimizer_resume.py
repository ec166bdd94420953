"""A search that was stopped goes on from its file and ends where it would have ended, to the bit."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.layouts.arrangements import spread_electrodes
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.optimizer.checkpoint import Checkpoint
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.request import Request
from tomotactile_ros.optimizer.step import best_of
from tomotactile_ros.optimizer.touch import touch

GRID = equal_grid(3, 3, (0.2, 0.2), 0.005, 1e4)
GATHERED = equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4, 0.04)
ROUND = spread_electrodes(5, Outline.circle(0.1), 0.004, 1e4)
SMALL = {"starts": 2, "resolution": 8}


def touch_at_few_places(checkpoint):
    how = {"rounds": 2, "starts": 2, "places": 2, "resolution": 8}
    constraints = Constraints(GATHERED.outline, 0.02)
    return touch(GATHERED, constraints=constraints, checkpoint=checkpoint, **how)


SEARCHES = {
    "touch": touch_at_few_places,
    "free, two rounds and three probes": Request(GRID, "free", steps=3, **SMALL),
    "free, finite elements": Request(ROUND, "free", steps=3, **SMALL),
    "equalize": Request(GRID, "equalize", steps=3, resolution=16),
}


def steps_of(search, path, resume=False):
    if isinstance(search, Request):
        return replace(search, state_file=path, resume=resume).steps_of()
    return search(Checkpoint(path, {}, resume))


def leave_after_one(request, path):
    for step in steps_of(request, path):
        if step.iteration == 1:
            return


@pytest.mark.parametrize("name", SEARCHES)
def test_it_ends_where_it_would_have_ended(tmp_path, monkeypatch, name):
    """Wherever it was stopped, after its last step, too."""
    for few, number in (("_EVALUATIONS", 0), ("_FIRST_MOVES", 1)):  # as few as can be
        monkeypatch.setattr(f"tomotactile_ros.optimizer.touch.{few}", number)
    path, states = tmp_path / "x.search.json", {}

    def watch(step):
        if step.iteration:
            states[step.iteration] = path.read_bytes()  # as a stop leaves it

    whole, best = best_of(steps_of(SEARCHES[name], path), watch)
    assert list(states) == [step.iteration for step in whole[1:]] and len(states) >= 2
    for done, state in states.items():
        path.write_bytes(state)
        assert json.loads(state)["done"] == done
        history, again = best_of(steps_of(SEARCHES[name], path, resume=True))
        assert [step.iteration for step in history] == [0, *range(done, len(whole))]
        assert np.array_equal(again.layout.positions, best.layout.positions)
        assert (again.score, again.layout.radius) == (best.score, best.layout.radius)
        assert again.metrics["hwhm"] == best.metrics["hwhm"]
        assert again.iteration == max(best.iteration, done if best.iteration else 0)
        assert [step.score for step in history[2:]] == [step.score for step in whole[done + 1 :]]
        assert path.read_bytes() == states[len(whole) - 1]
        assert history[-1].eta == 0


def test_what_is_hardly_better_does_not_take_the_place_of_what_was_handed_over(tmp_path):
    """All scores are the same to 1e-6: the start is kept, also by a search that goes on."""
    aims = {"central": (1e7,) * 3, "other": (1e7,) * 3, "noise_gain": 1e7}
    request = Request(GRID, "free", **SMALL)
    request = replace(request, aims=replace(request.aims, **aims))
    path = tmp_path / "s.json"
    leave_after_one(request, path)
    history, best = best_of(steps_of(request, path, resume=True))
    assert best.iteration == 0 and len({step.score for step in history}) == 1
    assert np.array_equal(history[-1].layout.positions, GRID.positions)


WORDS = ["optimize", "--rows", "3", "--cols", "3", "--size", "0.2", "0.2", "--resolution", "8"]
METHODS = {
    "free": ["--method", "free", "--starts", "2", "--workers", "1"],
    "equalize": ["--method", "equalize"],
}


def stop_after(monkeypatch, iteration):
    """Ctrl-C after that step of the next search."""
    goes_on = Request.steps_of

    def stopped(request, executor):
        for step in goes_on(request, executor):
            yield step
            if step.iteration == iteration:
                monkeypatch.setattr(Request, "steps_of", goes_on)
                raise KeyboardInterrupt

    monkeypatch.setattr(Request, "steps_of", stopped)


@pytest.mark.parametrize("method", METHODS)
def test_the_command_goes_on(tmp_path, monkeypatch, capsys, method):
    monkeypatch.setattr("tomotactile_ros.optimizer.report.save_figure", lambda *_: None)
    whole, parts = tmp_path / "whole.yaml", tmp_path / "parts.yaml"
    words = [*WORDS, "--rows", "2", "--cols", "2", *METHODS[method], "--steps", "2"]
    assert main([*words, "--out", str(whole)]) == 0
    stop_after(monkeypatch, 1)
    capsys.readouterr()
    assert main([*words, "--out", str(parts)]) == 0
    assert "--resume, with the same options, goes on" in capsys.readouterr().out
    state = tmp_path / "parts.search.json"
    assert state.exists()
    assert main([*words, "--resume", "--out", str(parts)]) == 0
    assert "goes on" not in capsys.readouterr().out
    assert not state.exists() and not whole.with_suffix(".search.json").exists()
    one, other = load_layout(whole), load_layout(parts)
    assert np.array_equal(one.positions, other.positions)
    assert one.provenance["metrics"] == other.provenance["metrics"]
    assert one.provenance["settings"] == other.provenance["settings"]


def cut(text):
    return text[: len(text) // 2]


def changed(*way, value):
    """The content with another value at one place; None: without it."""

    def change(text):
        content = place = json.loads(text)
        for key in way[:-1]:
            place = place[key]
        if value is None:
            del place[way[-1]]
        else:
            place[way[-1]] = value
        return json.dumps(content)

    return change


@pytest.fixture(scope="module")
def a_state(tmp_path_factory):
    """Content of a file of the first round of the command for `free`."""
    path = tmp_path_factory.mktemp("state") / "kept.json"
    leave_after_one(Request(GRID, "free", **SMALL), path)
    return path.read_text()


@pytest.mark.parametrize(
    "damage, message",
    [
        (cut, "is no state of a search: "),
        (lambda text: "[]", "something in it is of another kind"),
        (changed("format", value="tomotactile-search/1"), "is not tomotactile-search/2"),
        (changed("asked", value=[1]), "something in it is of another kind"),
        (changed("done", value=3), "done: 3 is none of 1 to 2"),
        (changed("trials", value=[]), "trials: there are none"),
        (changed("trials", 0, "best", value=[0.1] * 50), "best: not 2 finite numbers"),
        (changed("trials", 0, "gradient", 0, value=float("nan")), "gradient: not 2 finite"),
        (changed("trials", 0, "score", value="low"), "could not convert"),
        (changed("best", "positions", value=[[0.0, 0.0]]), "positions: not 9 x 2 finite"),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, capsys, a_state, damage, message):
    out = tmp_path / "x.yaml"
    words = [*WORDS, *METHODS["free"], "--out", str(out)]
    state = out.with_suffix(".search.json")
    state.write_text(damage(a_state))
    before = state.read_text()
    assert main([*words, "--resume"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"tomotactile optimize: resume: {state}")
    assert message in line and line.endswith("; start anew, without resume")
    assert state.read_text() == before and not out.exists()


@pytest.mark.parametrize(
    "more, message",
    [
        (["--seed", "3"], "another seed (0, not 3); start anew, or ask for the same"),
        (["--margin", "0.01", "--asymmetric"], "another margin (0.0, not 0.01), symmetric (True"),
        (["--sheet-resistance", "2e4"], "another sheet_resistance (10000.0, not 20000.0)"),
        (["--rows", "4"], "another start ('equal-3x3"),
        (["--method", "equalize"], "another method ('free', not 'equalize'); start anew"),
    ],
)
def test_the_state_of_another_search_is_one_line(tmp_path, capsys, a_state, more, message):
    out = tmp_path / "x.yaml"
    out.with_suffix(".search.json").write_text(a_state)
    words = WORDS if "equalize" in more else [*WORDS, *METHODS["free"]]
    assert main([*words, *more, "--resume", "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    said = f"tomotactile optimize: resume: {out.with_suffix('.search.json')} is of a search with "
    assert line.startswith(said + message)
