"""What a search has reached, in a file, so that one that was stopped goes on where it was."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic

FORMAT = "tomotactile-search/2"


class Kept(Protocol):
    """Something that is being improved and can be written down."""

    def plain(self) -> dict:
        """Plain values, from which it can be made again to the last bit."""


@dataclass(frozen=True)
class Trial:
    """A layout that is being improved; plain numbers, so that it can be sent and kept.

    positions (E, 2), m; radius, m; score; reach : of the next moves, in parts of the first ones
    """

    positions: np.ndarray
    radius: float
    score: float
    reach: float = 1.0

    def plain(self) -> dict:
        return asdict(self) | {"positions": self.positions.tolist()}

    @classmethod
    def read(cls, plain: dict, electrodes: int) -> Trial:
        """From plain values; ValueError, KeyError or TypeError where they are none of a trial."""
        positions = numbers(plain, "positions", (electrodes, 2))
        rest = (float(numbers(plain, name)) for name in ("radius", "score", "reach"))
        return cls(positions, *rest)


@dataclass(frozen=True)
class State:
    """What a search has reached.

    done : steps that are over
    trials : what they left to be improved
    best : of the layouts that were handed over, the start not counted
    """

    done: int
    trials: Sequence
    best: Trial


@dataclass(frozen=True)
class Checkpoint:
    """A file that holds the state of one search.

    path : of the file
    asked : what was asked for, plain values: a state is taken for the same question alone
    resume : whether to take the state that is there; otherwise it is written over
    """

    path: Path
    asked: dict
    resume: bool = False

    def keep(self, done: int, trials: Sequence[Kept], best: Trial) -> None:
        """Write the state after `done` steps."""
        content = {
            "format": FORMAT,
            "asked": self.asked,
            "done": done,
            "trials": [each.plain() for each in trials],
            "best": best.plain(),
        }
        write_atomic(self.path, json.dumps(content).encode())

    def taken(
        self, total: int, electrodes: int, read: Callable[[int, list], Sequence] | None = None
    ) -> State | None:
        """The state to go on from; None where nothing is to be taken.

        total, electrodes : steps and electrodes that it can have
        read : makes the trials of the number of steps done and a list of plain values; None: each
            is a `Trial`. It raises ValueError, KeyError or TypeError for values that cannot be.

        Raises InputError where there is no state, or that of another search.
        """
        if not self.resume:
            return None
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            kind = content["format"]
        except FileNotFoundError:
            raise InputError(f"resume: {self.path} is not there: nothing to go on with") from None
        except OSError as error:
            raise InputError(f"resume: {self.path} cannot be read: {error.strerror}") from None
        except (ValueError, KeyError, TypeError) as error:
            raise self._damaged(error) from None
        if kind != FORMAT:
            raise InputError(
                f"resume: {self.path}: format {checks.show(kind)} is not {FORMAT}; start anew, "
                "without resume"
            )
        self._refuse_other(content.get("asked"))
        try:
            done = content["done"]
            if type(done) is not int or not 1 <= done <= total:
                raise ValueError(f"done: {checks.show(done)} is none of 1 to {total}")
            plain = content["trials"]
            if not isinstance(plain, list) or not plain:
                raise ValueError("trials: there are none")
            if read is None:
                trials: Sequence = [Trial.read(each, electrodes) for each in plain]
            else:
                trials = read(done, plain)
            return State(done, trials, Trial.read(content["best"], electrodes))
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise self._damaged(error) from None

    def _refuse_other(self, asked: object) -> None:
        """InputError where something else was asked for."""
        if not isinstance(asked, dict):
            raise self._damaged(TypeError())
        wanted = json.loads(json.dumps(self.asked))
        other = [key for key in wanted if (key, wanted[key]) not in asked.items()]
        if "method" in other:
            other = ["method"]  # which has other settings
        if other:
            what = ", ".join(
                f"{key} ({checks.show(asked.get(key))}, not {checks.show(wanted[key])})"
                for key in other
            )
            raise InputError(
                f"resume: {self.path} is of a search with another {what}; start anew, or ask for the "
                "same"
            )

    def _damaged(self, error: Exception) -> InputError:
        what = str(error)
        if isinstance(error, KeyError):
            what = f"{error.args[0]} is missing"
        elif isinstance(error, TypeError):
            what = "something in it is of another kind"
        return InputError(
            f"resume: {self.path} is no state of a search: {what}; start anew, without resume"
        )


def numbers(plain: dict, name: str, shape: tuple[int | None, ...] = ()) -> np.ndarray:
    """Finite numbers of a shape, of which None may be any; ValueError, KeyError or TypeError for
    others."""
    found = np.array(plain[name], float)
    fits = found.ndim == len(shape) and all(
        size in (None, length) for size, length in zip(shape, found.shape)
    )
    if not fits or not np.isfinite(found).all():
        many = " x ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: not {f'{many} finite numbers' if many else 'a finite number'}")
    return found


def state_file_of(out: str | os.PathLike) -> Path:
    """Where the search for a layout that is to be written to `out` keeps its state."""
    return Path(out).with_suffix(".search.json")
