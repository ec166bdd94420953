"""What a search has reached, in a file, so that one that was stopped goes on where it was."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic

FORMAT = "tomotactile-search/1"


@dataclass(frozen=True)
class Trial:
    """A layout that is being improved; plain numbers, so that it can be sent and kept.

    positions (E, 2), m; radius, m; score; reach : of the next moves, in parts of the first ones
    """

    positions: np.ndarray
    radius: float
    score: float
    reach: float = 1.0


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

    def keep(self, done: int, trials: list[Trial]) -> None:
        """Write the state after `done` rounds."""
        content = {
            "format": FORMAT,
            "asked": self.asked,
            "done": done,
            "trials": [asdict(t) | {"positions": t.positions.tolist()} for t in trials],
        }
        write_atomic(self.path, json.dumps(content).encode())

    def taken(self) -> tuple[int, list[Trial]]:
        """Rounds that are done, and what they left; (0, []) where nothing is to be taken.

        Raises InputError where there is no state, or that of another search.
        """
        if not self.resume:
            return 0, []
        try:
            content = json.loads(self.path.read_text())
            trials = [
                Trial(**each | {"positions": np.array(each["positions"])})
                for each in content["trials"]
            ]
            done, asked, kind = int(content["done"]), content["asked"], content["format"]
        except OSError:
            raise InputError(f"resume: {self.path} is not there: nothing to go on with") from None
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"resume: {self.path} is no state of a search: {error}") from None
        if kind != FORMAT:
            raise InputError(f"resume: {self.path}: format {kind!r} is not {FORMAT}")
        wanted = json.loads(json.dumps(self.asked))
        other = [key for key in wanted if asked.get(key) != wanted[key]]
        if other:
            raise InputError(
                f"resume: {self.path} is of a search with another {', '.join(other)}; start anew, or "
                "ask for the same"
            )
        return done, trials


def state_file_of(out: str | os.PathLike) -> Path:
    """Where the search for a layout that is to be written to `out` keeps its state."""
    return Path(out).with_suffix(".search.json")
