"""What came out of the parts, as text and Markdown; places never without ghosts and misses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
_BOUND = "bound mm", "place / bound"
_COVERED = "95 % regions: place %", "force %"
HEADER = (*scoring.HEADER, *_COVERED)


def text(found: dict[str, list[dict]], width: float = inf) -> Iterator[str]:
    """Lines for a terminal; `found`: rows of `trial.measure` by part."""
    for part, rows in found.items():
        yield TITLES[part]
        header, lines = _table(rows)
        yield from tables.text(header, lines, width, fixed=2)
        yield ""
    yield LEGEND


def cells(row: dict) -> list[str]:
    """Of what `scoring.summary` says, under `HEADER`."""
    return [*scoring.cells(row), *_covered(row)]


def _covered(row):
    return [tables.percent(row["coverage"][key]) for key in ("place", "force")]


def _table(rows: Sequence[dict]):
    """Header and cells; stated uncertainties and bounds have columns where there are any."""
    covered = any(part is not None for row in rows for part in row["coverage"].values())
    bounded = any(row["bound"] is not None for row in rows)
    more = (_COVERED if covered else ()) + (_BOUND if bounded else ())
    header = ("case", "method", *scoring.HEADER, *more)
    lines = []
    for row in rows:
        line = [row["case"], row["method"], *scoring.cells(row)]
        if covered:
            line += _covered(row)
        if bounded:
            line += _bound(row)
        lines.append(line)
    return header, lines


def _bound(row):
    bound, median = row["bound"], row["place"]["median"]
    if bound is None:
        return "-", "-"
    return f"{1e3 * bound:.3f}", "-" if median is None else f"{median / bound:.1f}"
