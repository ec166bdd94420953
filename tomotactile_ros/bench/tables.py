"""Measured rows as text: aligned columns for the terminal, Markdown for documents."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import inf

Row = Sequence[str]


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


def number(value: float | None, unit: float, form: str) -> str:
    """In parts of 1 / `unit`, as 1e3 for ms and mm; a dash where there is none."""
    return "-" if value is None else f"{unit * value:{form}}"


def milliseconds(seconds: float | None) -> str:
    return number(seconds, 1e3, ".3g")


TRADE = (
    "set-up", "memory", "frame: median, p99", "OSPA", "worn sensor: frame", "OSPA",
    "one contact: error, p95; ghosts, missed", "worn sensor: error; ghosts, missed",
    "two contacts from", "force error, one and two", "image: HWHM, PE",
)  # fmt: skip
LEGEND = """\
frame: from voltages to contacts. OSPA: places, ghosts and missed contacts in one figure, mean of all
frames, cut-off 10 mm; a frame that is withheld counts as one without contacts. error: of the reported
place; two contacts from: smallest distance from which on 80 % of the pairs are told apart; force error:
of these pairs; HWHM, PE: of the image of one contact."""


def trade_cells(row: dict) -> Row:
    """Of one row of `trade.measure`, in the order of TRADE."""
    error, force, scores = row["contact_error"], row["force_error"], row["scores"]
    trade = []
    for sensor, frame in row["frame"].items():
        median, p99 = (milliseconds(frame[key]) for key in ("median", "p99"))
        trade += [f"{median} ms, {p99} ms", f"{_mm(row['ospa'][sensor])} mm"]
    apart = row["two_contacts"]
    one, two = (number(force[key]["mean"], 100, ".0f") for key in ("one", "two"))
    return (
        f"{row['setup']['median']:.2f} s",
        f"{number(row['memory'], 1e-6, '.3g')} MB",
        *trade,
        f"{_mm(error['mean'])} mm, {_mm(error['p95'])} mm; {_false_ones(scores['textbook'])}",
        f"{_mm(row['worn']['contact_error']['mean'])} mm; {_false_ones(scores['worn'])}",
        "-" if apart is None else f"{_mm(apart, 1)} mm",
        f"{one} %, {two} %",
        f"{_mm(row['hwhm']['mean'], 1)} mm, {_mm(row['position_error']['mean'], 1)} mm",
    )


def _mm(metres, digits=2):
    return number(metres, 1e3, f".{digits}f")


def _false_ones(scores: dict) -> str:
    """Ghosts and doubled contacts, and missed ones, of one contact (`evaluation.scoring`)."""
    one = scores["one"]
    return f"{one['ghosts'] + one['doubled']}, {one['missed']}"
