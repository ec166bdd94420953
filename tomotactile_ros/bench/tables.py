"""Measured rows as text: aligned columns for the terminal, Markdown for documents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import inf
from string import Formatter

Row = Sequence[str]
Column = tuple[str, str | Callable[[dict], str]]  # its title, and its cell as `cells` takes it


class _Fields(Formatter):
    def get_field(self, field_name, args, kwargs):
        found, (*path, last) = kwargs, field_name.split(".")
        for key in path:
            found = found.get(key, {})
        if "+" in last:
            return sum(found[key] for key in last.split("+")), field_name
        return found.get(last), field_name

    def format_field(self, value, format_spec):
        factor, _, form = format_spec.rpartition(" ")
        if value is None:
            return "-"
        return format(float(factor) * value if factor else value, form)


def cells(columns: Iterable[Column], row: dict) -> list[str]:
    """What the columns say of a row of plain data.

    A cell is a function of the row, or a text in which `{place.p95:1e3 .2f}` is what the row has under
    `place` and there under `p95`, times 1e3, with two digits, a dash where it has nothing, and
    `{ghosts+doubled}` the sum of both.
    """
    return [
        cell(row) if callable(cell) else _Fields().vformat(cell, (), row) for _, cell in columns
    ]


def titles(columns: Iterable[Column]) -> list[str]:
    return [title for title, _ in columns]


def of(
    columns: Sequence[Column], rows: Iterable[dict], width: float = inf, fixed: int = 1
) -> Iterator[str]:
    """`text` of rows of plain data."""
    return text(titles(columns), (cells(columns, row) for row in rows), width, fixed)


def text(header: Row, rows: Iterable[Row], width: float = inf, fixed: int = 1) -> Iterator[str]:
    """Lines with aligned columns; those for which `width` characters are too few stand below the
    others, beside the first `fixed` columns again."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(header, *rows)]
    for number, part in enumerate(_fitting(widths, width, fixed)):
        if number:
            yield ""
        for row in (header, ["-" * each for each in widths], *rows):
            yield "  ".join(row[i].ljust(widths[i]) for i in part).rstrip()


def _fitting(widths, width, fixed):
    """Numbers of the columns that stand beside each other, for each part of a table."""
    parts = [list(range(fixed))]
    for column in range(fixed, len(widths)):
        wider = [*parts[-1], column]
        fits = sum(widths[i] + 2 for i in wider) - 2 <= width
        if fits or len(wider) == fixed + 1:
            parts[-1] = wider
        else:
            parts.append([*range(fixed), column])
    return parts


def markdown(header: Row, rows: Iterable[Row]) -> list[str]:
    """Lines of a table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]


class Table:
    """A table in Markdown, of which every row is printed as soon as it is known."""

    def __init__(self, *header: str):
        print(*markdown(header, []), sep="\n", flush=True)

    def add(self, *row: str) -> None:
        print(f"| {' | '.join(row)} |", flush=True)


def _frames(row: dict) -> str:
    withheld = f" + {row['withheld']} withheld" if row["withheld"] else ""
    return f"{row['frames']}{withheld}"


SCORES: tuple[Column, ...] = (  # of what `evaluation.scoring.summary` says
    ("frames", _frames),
    ("ghosts", "{ghosts}"),
    ("doubled", "{doubled}"),
    ("weak", "{weak}"),
    ("missed", "{missed} of {true}"),
    ("place mm: median", "{place.median:1e3 .2f}"),
    ("p95", "{place.p95:1e3 .2f}"),
    ("worst", "{place.worst:1e3 .2f}"),
    ("force %: median", "{force.median:100 .1f}"),
    ("p95", "{force.p95:100 .1f}"),
    ("OSPA mm", "{ospa.mean:1e3 .2f}"),
)
HELD: tuple[Column, ...] = (
    *SCORES,
    ("95 % regions: place %", "{coverage.place:100 .0f}"),
    ("force %", "{coverage.force:100 .0f}"),
)
