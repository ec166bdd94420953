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


def milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.3g}"


def millimetres(metres: float | None) -> str:
    return "-" if metres is None else f"{1e3 * metres:.1f}"


def megabytes(count: float) -> str:
    return f"{count / 1e6:.3g}"


def percent(part: float | None) -> str:
    return "-" if part is None else f"{100 * part:.0f}"


TRADE = (
    "layout", "profile", "pixels", "grounds", "contacts", "set-up s", "frame ms", "p99 ms", "MB",
    "HWHM mm", "PE mm", "p95", "blur mm", "contact mm", "p95", "ghosts", "missed",
    "defects mm", "ghosts", "missed", "two mm", "ghosts", "missed", "force %", "two %", "noise", "lambda",
)  # fmt: skip


def trade_row(row: dict) -> Row:
    """Cells of one row of `trade.measure`, in the order of TRADE."""
    frame, force = row["frame"], row["force_error"]
    return (
        row["layout"],
        row["profile"],
        f"{row['resolution']}²",
        str(row["conditions"] or "all"),
        "{} + {}".format(*row["contacts"]),
        f"{row['setup']['median']:.2f}",
        milliseconds(frame["median"]),
        milliseconds(frame["p99"]),
        megabytes(row["memory"]["held"]),
        millimetres(row["hwhm"]["mean"]),
        millimetres(row["position_error"]["mean"]),
        millimetres(row["position_error"]["p95"]),
        millimetres(row["blur"]["mean"]),
        millimetres(row["contact_error"]["mean"]),
        millimetres(row["contact_error"]["p95"]),
        *false_ones(row["scores"]["one"]),
        millimetres(row["defective"]["contact_error"]["mean"]),
        *false_ones(row["scores"]["defects"]),
        millimetres(row["two_contacts"]),
        *false_ones(row["scores"]["two"]),
        percent(force["one"]["mean"]),
        percent(force["two"]["mean"]),
        f"{row['noise_gain']:.2g}",
        f"{row['regularization'] ** 0.5:.2g}",
    )


def false_ones(score: dict) -> Row:
    """Ghosts and doubled contacts, and missed ones, of what `evaluation.scoring` says."""
    return str(score["ghosts"] + score["doubled"]), str(score["missed"])


LEGEND = """\
contacts: measured single ones and pairs; frame: median, p99: 99th percentile, of one frame from
voltages to contacts; MB: held by the pipeline; HWHM, PE: of the image of one contact, mean (p95:
95th percentile); blur: way from the true place to the image squared, root mean square; contact:
reported place of one contact against the true one; ghosts: contacts that are not there or reported
twice, missed: true ones without a reported one within 10 mm, in all frames, for each kind of frames; defects: the same with dead channels, drift,
hum, switch resistance and a sheet that varies by 20 %; two: smallest distance from which on 80 % of
the pairs are told apart; force: mean error of one contact and of pairs told apart; noise: of a
pixel per noise of a reading, V/V."""
