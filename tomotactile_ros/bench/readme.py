"""The measured table of profiles in a document, rewritten between two comments."""

from __future__ import annotations

from pathlib import Path

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.cases import is_default
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic

_BEGIN, _END = "<!-- bench:profiles -->", "<!-- /bench:profiles -->"


def rewrite(path: str | Path, result: dict) -> None:
    """Fill the file at `path` between `_BEGIN` and `_END`. Raises InputError as `check` does."""
    before, after = check(path)
    text = "\n".join([f"{before}{_BEGIN}", *profile_table(result), f"{_END}{after}"])
    write_atomic(path, text.encode())


def check(path: str | Path) -> tuple[str, str]:
    """What is before and behind; InputError where the file at `path` is no text, or lacks a comment."""
    try:
        before, begin, rest = Path(path).read_text(encoding="utf-8").partition(_BEGIN)
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8") from None
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise InputError(f"{path}: needs a line {_BEGIN} and below it {_END}")
    return before, after


def profile_table(result: dict) -> list[str]:
    """Lines in Markdown: the profiles on 8 x 8 electrodes and 40 x 40 pixels, and what measured
    them."""
    rows = [row for row in result["trade"] if is_default(row)]
    machine = result["machine"]
    return [
        *tables.markdown(
            ("profile", *tables.TRADE),
            [(f"`{row['profile']}`", *tables.trade_cells(row)) for row in rows],
        ),
        "",
        "8 × 8 electrodes on 200 mm × 200 mm, 40 × 40 pixels, contacts of 5 mm radius, "
        + "1 mV of noise, 12 bits; the worn sensor is that of the scene `worn-sensor`; OSPA: places, "
        + f"ghosts and missed contacts of single ones and pairs in one figure; one thread of {machine['processor']}, "
        + f"Python {machine['python']}, "
        + f"numpy {machine['libraries']['numpy']}, {machine['date']}.",
    ]
