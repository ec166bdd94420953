"""The table of profiles in the README, rewritten between two comments from a measured result."""

from __future__ import annotations

from pathlib import Path

from tomotactile_ros.bench import tables, trade
from tomotactile_ros.errors import InputError
from tomotactile_ros.yamlio import write_atomic

BEGIN, END = "<!-- bench:profiles -->", "<!-- /bench:profiles -->"
_HEADER = (
    "profile", "set-up", "frame, median", "frame, p99", "memory", "one contact: error, p95",
    "with defects", "two contacts from", "force error, one and two",
)  # fmt: skip


def rewrite(path: str | Path, result: dict) -> None:
    """Put the profiles of `result` between the comments in the file at `path`.

    Raises InputError where the file or one of the comments is missing.
    """
    path = Path(path)
    try:
        content = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    before, begin, rest = content.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"{path}: needs a line {BEGIN} and below it a line {END}")
    table = "\n".join(profile_table(result))
    write_atomic(path, f"{before}{BEGIN}\n{table}\n{END}{after}".encode())


def profile_table(result: dict) -> list[str]:
    """Lines in Markdown: the profiles on 8 x 8 electrodes and 40 x 40 pixels, and what measured them."""
    rows = [row for row in result["trade"] if trade.is_default(row)]
    machine = result["machine"]
    return [
        *tables.markdown(_HEADER, map(_cells, rows)),
        "",
        "8 × 8 electrodes on 200 mm × 200 mm, 40 × 40 pixels, contacts of 5 mm radius, 1 mV of noise, "
        + f"12 bits; one thread of {machine['processor']}, Python {machine['python']}, "
        + f"numpy {machine['libraries']['numpy']}, {machine['date']}.",
    ]


def _cells(row):
    error, force = row["contact_error"], row["force_error"]
    return (
        f"`{row['profile']}`",
        f"{row['setup']:.2f} s",
        f"{tables.milliseconds(row['frame']['median'])} ms",
        f"{tables.milliseconds(row['frame']['p99'])} ms",
        f"{tables.megabytes(row['memory']['held'])} MB",
        f"{tables.millimetres(error['mean'])} mm, {tables.millimetres(error['p95'])} mm",
        f"{tables.millimetres(row['defective']['contact_error']['mean'])} mm",
        "-" if row["two_contacts"] is None else f"{tables.millimetres(row['two_contacts'])} mm",
        f"{tables.percent(force['one']['mean'])} %, {tables.percent(force['two']['mean'])} %",
    )
