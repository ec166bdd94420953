"""Who does the tasks of a search makes no difference, neither does where it was stopped or who was killed."""

import os
import pickle
import signal
import sys
from functools import partial

import numpy as np
import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.layouts.arrangements import spread_electrodes
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.optimizer import work
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.request import Request
from tomotactile_ros.optimizer.step import best_of
from tomotactile_ros.optimizer.touch import touch
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support.errors import InputError

GRID = equal_grid(3, 3, (0.2, 0.2), 0.005, 1e4)
GATHERED = equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4, 0.04)
ROUND = spread_electrodes(5, Outline.circle(0.1), 0.004, 1e4)
SMALL = {"starts": 2, "resolution": 8}


def touch_at_few_places(own):
    own.begin()
    how = {"rounds": 2, "starts": 2, "places": 2, "resolution": 8}
    return touch(GATHERED, constraints=Constraints(GATHERED.outline, 0.02), work=own, **how)


SEARCHES = {
    "touch": touch_at_few_places,
    "free, two rounds and three probes": Request(GRID, "free", steps=3, **SMALL).steps_of,
    "free, finite elements": Request(ROUND, "free", steps=3, **SMALL).steps_of,
    "equalize": Request(GRID, "equalize", steps=3, resolution=16).steps_of,
}


def numbers(path):
    """Of the tasks in a file."""
    return list(work.kept_in(path)[1])


@pytest.mark.parametrize("name", SEARCHES)
def test_it_ends_where_it_would_have_ended(tmp_path, monkeypatch, name):
    """Wherever it was stopped: after its start, in the midst of writing, after its end."""
    for few, number in (("_EVALUATIONS", 0), ("_FIRST_MOVES", 1)):  # as few as can be
        monkeypatch.setattr(f"tomotactile_ros.optimizer.touch.{few}", number)
    path, states = tmp_path / "x.search", []
    search = SEARCHES[name]
    whole, best = best_of(search(Work(path=path)), lambda _: states.append(path.read_bytes()))
    done = numbers(path)
    assert len(whole) >= 3
    torn = states[0][: states[0].index(b"\n") + 9]  # in its first result
    for state in (torn, states[0], states[1][:-3], states[-1]):
        path.write_bytes(state)
        history, again = best_of(search(Work(path=path, resume=True)))
        assert [step.score for step in history] == [step.score for step in whole]
        assert again.iteration == best.iteration and again.metrics == best.metrics
        assert np.array_equal(again.layout.positions, best.layout.positions)
        assert again.layout.radius == best.layout.radius
        assert numbers(path) == done == list(range(len(done)))  # nothing was lost or done twice


def killed_once(parent, mark, function, *arguments):
    """As the function; but the first worker that is to descend is killed."""
    if getattr(function, "__name__", "") == "_descend" and os.getpid() != parent:
        try:
            mark.touch(exist_ok=False)
        except FileExistsError:
            pass
        else:
            os.kill(os.getpid(), signal.SIGKILL)
    return function(*arguments)


class Deadly(Work):
    """Kills a worker in the midst of its work."""

    def map(self, function, *arguments):
        return super().map(partial(killed_once, os.getpid(), self.mark, function), *arguments)


@pytest.fixture(params=["local", "dask"])
def others(request):
    """Who else may do it."""
    if request.param == "local":
        yield {"workers": 2}
        return
    distributed = pytest.importorskip("distributed")
    how = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**how) as cluster:
        yield {"backend": cluster.scheduler_address.replace("tcp", "dask")}


def test_the_layout_is_the_same_with_others_even_if_one_is_killed(tmp_path, others):
    request = Request(GRID, "free", **SMALL)
    alone, best = best_of(request.steps_of())
    deadly = Deadly(**others)
    deadly.mark = tmp_path / "killed"
    try:
        together, same = best_of(request.steps_of(deadly))
    finally:
        deadly.stop()
    assert deadly.mark.exists()
    assert [step.score for step in together] == [step.score for step in alone]
    assert np.array_equal(same.layout.positions, best.layout.positions)


def test_workers_that_are_killed_again_and_again_are_one_line():
    own = Work(2)
    own.begin()
    with pytest.raises(InputError, match="workers: they were killed 3 times"):
        own.map(signal.raise_signal, [signal.SIGKILL] * 2)


@pytest.mark.parametrize(
    "backend, message",
    [
        ("127.0.0.1:1", "'127.0.0.1:1' is not dask://HOST:PORT"),
        ("dask://127.0.0.1:1", "no scheduler of dask answers at dask://127.0.0.1:1"),
        ("dask://", "needs the Python package distributed"),
    ],
)
def test_no_backend_is_one_line(monkeypatch, backend, message):
    monkeypatch.setattr(work, "_PATIENCE", 0.1)
    if "distributed" in message:
        monkeypatch.setitem(sys.modules, "distributed", None)
    elif "answers" in message:
        pytest.importorskip("distributed")
    with pytest.raises(InputError, match=f"backend: {message}"):
        Work(backend=backend)


WORDS = ["optimize", "--rows", "3", "--cols", "3", "--size", "0.2", "0.2", "--resolution", "8"]
FREE = [*WORDS, "--method", "free", "--starts", "2", "--workers", "1"]


def test_the_command_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tomotactile_ros.optimizer.report.save_figure", lambda *_: None)
    whole, parts = tmp_path / "whole.yaml", tmp_path / "parts.yaml"
    assert main([*FREE, "--out", str(whole)]) == 0
    goes_on = Request.steps_of

    def stopped(request, own):
        for step in goes_on(request, own):
            yield step
            if step.iteration == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(Request, "steps_of", stopped)
    capsys.readouterr()
    assert main([*FREE, "--out", str(parts)]) == 0
    assert "--resume, with the same options, goes on" in capsys.readouterr().out
    assert (tmp_path / "parts.search").exists()
    monkeypatch.setattr(Request, "steps_of", goes_on)
    assert main([*FREE, "--resume", "--out", str(parts)]) == 0
    assert "goes on" not in capsys.readouterr().out
    assert not list(tmp_path.glob("*.search"))
    one, other = load_layout(whole), load_layout(parts)
    assert np.array_equal(one.positions, other.positions)
    assert one.provenance == other.provenance


@pytest.mark.parametrize(
    "words, message",
    [
        ([*FREE, "--seed", "3"], "another seed (0, not 3); start anew, or ask for the same"),
        ([*FREE, "--margin", "0.01", "--asymmetric"], "another margin (0.0, not 0.01), symmetric"),
        ([*FREE, "--sheet-resistance", "2e4"], "another sheet_resistance (10000.0, not 20000.0)"),
        ([*FREE, "--rows", "4"], "another start ('equal-3x3"),
        ([*WORDS, "--method", "equalize"], "another method ('free', not 'equalize'); start anew"),
        (FREE, "is no state of a search that can go on; start anew, without resume"),
    ],
)
def test_results_of_another_search_are_one_line(tmp_path, mistake, words, message):
    state = tmp_path / "x.search"
    next(Request(GRID, "free", **SMALL).steps_of(Work(path=state)))
    if words is FREE:
        state.write_bytes(pickle.dumps(("tomotactile-search/2", {})))
    before = state.read_bytes()
    line = mistake([*words, "--resume", "--out", tmp_path / "x.yaml"])
    assert line.startswith(f"tomotactile optimize: resume: {state} is ") and message in line
    assert state.read_bytes() == before
