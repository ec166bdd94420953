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


def hundredths(metres: float | None) -> str:
    """mm with two digits."""
    return "-" if metres is None else f"{1e3 * metres:.2f}"


def megabytes(count: float) -> str:
    return f"{count / 1e6:.3g}"


def percent(part: float | None) -> str:
    return "-" if part is None else f"{100 * part:.0f}"


TRADE = (
    "layout", "profile", "pixels", "grounds", "contacts", "set-up s", "MB",
    "textbook: frame ms", "p99 ms", "OSPA mm", "worn: frame ms", "p99 ms", "OSPA mm",
    "contact mm", "p95", "ghosts", "missed", "two: from mm", "ghosts", "missed",
    "worn: contact mm", "ghosts", "missed", "two: ghosts", "missed", "force %", "two %",
    "HWHM mm", "PE mm", "p95", "blur mm", "noise", "lambda",
)  # fmt: skip


def trade_row(row: dict) -> Row:
    """Cells of one row of `trade.measure`, in the order of TRADE."""
    force, scores = row["force_error"], row["scores"]
    trade = []
    for sensor, frame in row["frame"].items():
        trade += [milliseconds(frame["median"]), milliseconds(frame["p99"])]
        trade.append(hundredths(row["ospa"][sensor]))
    return (
        row["layout"],
        row["profile"],
        f"{row['resolution']}²",
        str(row["conditions"] or "all"),
        "{} + {}".format(*row["contacts"]),
        f"{row['setup']['median']:.2f}",
        megabytes(row["memory"]["held"]),
        *trade,
        millimetres(row["contact_error"]["mean"]),
        millimetres(row["contact_error"]["p95"]),
        *false_ones(scores["textbook"]["one"]),
        millimetres(row["two_contacts"]),
        *false_ones(scores["textbook"]["two"]),
        millimetres(row["worn"]["contact_error"]["mean"]),
        *false_ones(scores["worn"]["one"]),
        *false_ones(scores["worn"]["two"]),
        percent(force["one"]["mean"]),
        percent(force["two"]["mean"]),
        millimetres(row["hwhm"]["mean"]),
        millimetres(row["position_error"]["mean"]),
        millimetres(row["position_error"]["p95"]),
        millimetres(row["blur"]["mean"]),
        f"{row['noise_gain']:.2g}",
        f"{row['regularization'] ** 0.5:.2g}",
    )


def false_ones(score: dict) -> Row:
    """Ghosts and doubled contacts, and missed ones, of what `evaluation.scoring` says."""
    return str(score["ghosts"] + score["doubled"]), str(score["missed"])


LEGEND = """\
contacts: measured single ones and pairs. textbook: a sensor as the layout says; worn: the sensor of the
scene worn-sensor, with the same contacts. frame: median, p99: 99th percentile, of one frame from
voltages to contacts. OSPA: places, ghosts and missed contacts in one figure, mean of all frames,
cut-off 10 mm; a frame that is withheld counts as one without contacts. MB: held by the pipeline. contact:
reported place of one contact against the true one; ghosts: contacts that are not there or reported
twice, missed: true ones without a reported one within 10 mm, in all frames, for each kind of frames;
two: smallest distance from which on 80 % of the pairs are told apart; force: mean error of one contact
and of pairs told apart; HWHM, PE: of the image of one contact, mean (p95: 95th percentile); blur: way
from the true place to the image squared, root mean square; noise: of a pixel per noise of a reading,
V/V."""
