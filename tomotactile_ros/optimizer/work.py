"""The tasks of a search: side by side on this machine or on several (joblib), what came of them kept
in a file.

A search gives the same tasks in the same order whenever it is asked the same. So a number says which
task is meant, and a search that goes on is one that begins anew and finds results that it asks for.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import struct
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import joblib
from joblib.externals.loky import get_reusable_executor

from tomotactile_ros import __version__
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import Doubt, InputError
from tomotactile_ros.support.processes import die_with_parent

FORMAT = "tomotactile-search/4"
_RESULT = struct.Struct("<QQ")
_LONGEST = 1_000_000  # bytes of the line
DASK = "dask://"
_ENVIRONMENT = {  # of processes on this machine
    "OMP_NUM_THREADS": "1",  # matrices are small
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(2**25),  # glibc keeps the memory of large temporaries:
    "MALLOC_TRIM_THRESHOLD_": str(2**30),  # a fifth of the time went into page faults
}
_LOSSES = 3  # times that workers may be killed before anything new is known
_PATIENCE = 10  # s for a scheduler
_AT_ONCE = {"batch_size": 1, "pre_dispatch": "all", "max_nbytes": None}
if tuple(map(int, joblib.__version__.split(".")[:2])) >= (1, 4):  # else all results come together
    _AT_ONCE["return_as"] = "generator_unordered"


class Work:
    """Does the tasks of one search.

    Its processes end with this one, whatever ends it.

    Parameters
    ----------
    workers : processes on this machine; 1: none but this
    backend : `dask://HOST:PORT` of a scheduler whose workers do it instead
    path : of a file for the results; None: they are not kept
    resume : go on from that file; otherwise it is written over
    """

    def __init__(
        self,
        workers: int = 1,
        backend: str | None = None,
        path: Path | None = None,
        resume: bool = False,
    ):
        self.workers, self._path = workers, path
        self._client = _client(backend) if backend else None
        self._found: dict | None = None  # what the file was begun with
        self._known: dict[int, Any] = {}
        self._given = 0  # tasks so far
        self._has_processes = self._stopped = False
        if resume:
            self._read()

    def begin(self, **asked: object) -> None:
        """To be called before the first task with what is searched for, plain values.

        Raises InputError where the file has results of another search.
        """
        self._asked = json.loads(json.dumps({"version": __version__, **asked}))
        self._given = 0
        found, self._kept = self._found, self._found is not None
        if found is None:
            return
        other = [key for key, value in self._asked.items() if found.get(key) != value]
        if "method" in other:
            other = ["method"]  # which has other settings
        if other:
            words = ", ".join(
                f"{key} ({checks.show(found.get(key))}, not {checks.show(self._asked[key])})"
                for key in other
            )
            raise InputError(
                f"resume: {self._path} is of a search with another {words}; start anew, or ask for "
                "the same"
            )

    @property
    def known(self) -> int:
        """How many results are known of tasks to come."""
        return len(self._known)

    def do(self, function: Callable, *arguments: object) -> Any:
        """What `function` makes of the arguments; here, unless it is known."""
        return self.map(function, *([each] for each in arguments))[0]

    def map(self, function: Callable, *arguments: Iterable) -> list:
        """As the built-in function; in any processes, so that all has to be sendable."""
        tasks = dict(enumerate(zip(*arguments), self._given))
        self._given += len(tasks)
        results = {number: self._known.pop(number) for number in tasks if number in self._known}
        missing = {number: tasks[number] for number in tasks if number not in results}
        for number, result in self.results(function, missing):
            self._keep(number, result)
            results[number] = result
        return [results[number] for number in tasks]

    def stop(self) -> None:
        """End the processes, in the midst of their work; for any thread."""
        self._stopped = True
        if self._client is not None:
            self._client.close()
        elif self._has_processes:
            self._has_processes = False
            get_reusable_executor(reuse=True).shutdown(wait=False, kill_workers=True)

    def forget(self) -> None:
        """There is nothing to go on with."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def results(self, function: Callable, missing: dict[int, tuple]) -> Iterator[tuple[int, Any]]:
        """Numbers and results of tasks, which are arguments, as they come; those of workers that are killed
        are done by others."""
        if self._client is None and (self.workers == 1 or len(missing) < 2):
            for number, arguments in missing.items():
                yield number, function(*arguments)
            return
        losses = 0
        while missing:
            if self._stopped:
                raise RuntimeError("stopped")
            try:
                for number, result in self._side_by_side(function, missing):
                    losses = 0
                    del missing[number]
                    yield number, result
            except BrokenProcessPool:
                losses += 1
                if losses >= _LOSSES:
                    raise InputError(
                        f"workers: they were killed {losses} times, perhaps for want of memory: "
                        "fewer of them need less"
                    ) from None
            except ModuleNotFoundError as error:  # on another machine
                raise InputError(f"backend: its workers lack the module {error.name}") from None
            except Exception as error:
                if type(error).__module__.partition(".")[0] != "distributed":
                    raise
                raise InputError(f"backend: {' '.join(str(error).split())}") from None

    def _side_by_side(self, function, missing) -> Iterable[tuple[int, Any]]:
        if self._client is None:
            for variable, value in _ENVIRONMENT.items():
                os.environ.setdefault(variable, value)  # read by new processes when they start
            self._has_processes = True
            backend, count, parent = "loky", min(self.workers, len(missing)), os.getpid()
        else:
            backend, count, parent = "dask", -1, None
        call = joblib.delayed(_task)
        tasks = [call(parent, __version__, function, *each) for each in missing.items()]
        with joblib.parallel_backend(backend, n_jobs=count):
            parallel = joblib.Parallel(**_AT_ONCE)
        return parallel(tasks)

    def _keep(self, number, result):
        if self._path is None:
            return
        with open(self._path, "ab" if self._kept else "wb") as file:
            if not self._kept:
                file.write(json.dumps({"format": FORMAT, **self._asked}).encode() + b"\n")
            kept = pickle.dumps(result)
            file.write(_RESULT.pack(number, len(kept)) + kept)
        self._kept = True

    def _read(self):
        """Take what is whole in the file; a stop may have cut it off."""
        assert self._path is not None
        try:
            self._found, kept = kept_in(self._path)
        except FileNotFoundError:
            raise InputError(f"resume: {self._path} is not there: nothing to go on with") from None
        except ValueError:
            raise InputError(
                f"resume: {self._path} is no state of a search that can go on; start anew, "
                "without resume"
            ) from None
        with open(self._path, "r+b") as file:
            file.readline(_LONGEST)
            whole = file.tell()
            for number, (start, length) in kept.items():
                file.seek(start)
                try:
                    self._known[number] = pickle.loads(file.read(length))
                except Exception:  # noqa: BLE001 - others are raised for damage, too
                    break
                whole = start + length
            file.truncate(whole)


def kept_in(path: Path) -> tuple[dict, dict[int, tuple[int, int]]]:
    """What the search was asked for whose results a file keeps, and where each whole one begins and how long it
    is, by the number of its task; ValueError where the file is of something else."""
    with open(path, "rb") as file:
        asked = json.loads(file.readline(_LONGEST))
        if not isinstance(asked, dict) or asked.pop("format", None) != FORMAT:
            raise ValueError(path)
        kept, size = {}, os.fstat(file.fileno()).st_size
        while len(head := file.read(_RESULT.size)) == _RESULT.size:
            number, length = _RESULT.unpack(head)
            if file.tell() + length > size:
                break
            kept[number] = file.tell(), length
            file.seek(length, os.SEEK_CUR)
    return asked, kept


def _client(backend):
    """The connection to a scheduler; it is that of joblib's backend from now on."""
    if not backend.startswith(DASK):
        raise InputError(f"backend: {checks.show(backend)} is not {DASK}HOST:PORT")
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "backend: needs the Python package distributed: pip install distributed"
        ) from None
    try:
        return Client(f"tcp://{backend.removeprefix(DASK)}", timeout=_PATIENCE)
    except (OSError, ValueError):
        raise InputError(f"backend: no scheduler of dask answers at {backend}") from None


def _task(parent, version, function, number, arguments):
    """In a worker; parent : the process that started it, of this machine."""
    if version != __version__:
        raise InputError(f"backend: a worker has tomotactile_ros {__version__}, not {version}")
    if parent is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: the parent ends its workers
        die_with_parent(parent)
    warnings.simplefilter("ignore", Doubt)  # who gave the task has said it
    return number, function(*arguments)
