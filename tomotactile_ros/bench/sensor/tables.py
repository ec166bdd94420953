"""What came out of the parts, as text and Markdown; places never without ghosts and misses."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from tomotactile_ros.bench import tables
from tomotactile_ros.evaluation import scoring

TITLES = {
    "time": "Time: touches that begin, end or move while rows are scanned",
    "channels": "Channels and wiring",
    "sheets": "Sheets",
    "layouts": "Layouts",
    "crowd": "Crowd: the strongest with ten times the force of the weakest",
    "wide": "Wide contacts",
    "wide-channels": "Wide contacts on channels that nobody knows",
}
LEGEND = """\
ghosts: reported contacts 10 mm or more from every true one; doubled: nearer, beside one that is paired
already; weak: below 0.02 N, not judged; missed: true contacts without a pair; place, force: of pairs;
OSPA: places, ghosts and misses in one figure, mean of the frames, cut-off 10 mm; bound: Cramer-Rao
bound of the same places, median; place: median of the errors in parts of it, 0.83 at best."""
HEADER = (*scoring.HEADER, "95 % regions: place %", "force %")
_BOUND = "bound mm", "place / bound"


def text(found: dict[str, list[dict]], width: float = inf) -> Iterator[str]:
    """Lines for a terminal; `found`: rows of `trial.measure` by part. Bounds have columns where
    there are any."""
    for part, rows in found.items():
        bounded = any(row["bound"] is not None for row in rows)
        header = ("case", "method", *HEADER, *(_BOUND if bounded else ()))
        lines = [
            (row["case"], row["method"], *cells(row), *(_bound(row) if bounded else ()))
            for row in rows
        ]
        yield TITLES[part]
        yield from tables.text(header, lines, width, fixed=2)
        yield ""
    yield LEGEND


def cells(row: dict) -> list[str]:
    """Of what `scoring.summary` says, under `HEADER`."""
    covered = (tables.number(row["coverage"][key], 100, ".0f") for key in ("place", "force"))
    return [*scoring.cells(row), *covered]


def _bound(row):
    bound, median = row["bound"], row["place"]["median"]
    part = None if None in (bound, median) else median / bound
    return tables.number(bound, 1e3, ".3f"), tables.number(part, 1, ".1f")
