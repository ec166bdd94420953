"""Two results side by side: are their ratios the same?

Milliseconds follow the machine's mood; ratios of times that were measured in turn do not. Accuracy
has fixed seeds and must be the same to the last digit.
"""

from __future__ import annotations

from collections.abc import Iterator

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.cases import Case
from tomotactile_ros.support.errors import InputError

MOST = 0.1  # by which ratios may differ
_MEASURED = ("setup", "frame", "memory")  # all else in a row of the trade is accuracy


def lines(one: dict, other: dict) -> Iterator[str]:
    """The ratios of both, and how far they are apart."""
    common = _common(one, other)
    rows = [(name, f"{a:.3g}", f"{b:.3g}", f"{100 * (b / a - 1):+.1f} %") for name, a, b in common]
    yield from tables.text(("ratio", "first", "second", "change"), rows)
    yield from _different_machine(one["machine"], other["machine"])
    apart = {name: abs(b / a - 1) for name, a, b in common}
    name = max(apart, key=apart.__getitem__)
    yield (
        f"{sum(each <= MOST for each in apart.values())} of {len(apart)} ratios are the same "
        f"within {100 * MOST:g} %; most apart: {name}, {100 * apart[name]:.1f} %"
    )
    changed = list(different_accuracy(one, other))
    yield (
        f"accuracy: {len(changed)} rows differ" if changed else "accuracy: every figure is the same"
    )
    yield from changed


def agree(one: dict, other: dict) -> bool:
    """Whether all ratios are the same within `MOST`, and accuracy exactly."""
    same = all(abs(b / a - 1) <= MOST for _, a, b in _common(one, other))
    return same and not any(different_accuracy(one, other))


def ratios(result: dict) -> dict[str, float]:
    """All ratios of times in a result, by name."""
    out = {}
    for row in result["trade"]:
        for sensor, frame in row["frame"].items():
            words = "frame" if sensor == "textbook" else f"{sensor} frame"
            out[f"{words}, {_name(row)}"] = frame["relative"]
        out[f"set-up, {row['layout']}"] = row["setup"]["relative"]
    return out | result["peers"]["ratios"]


def different_accuracy(one: dict, other: dict) -> Iterator[str]:
    """A line for each row of the trade and of the sensor's parts whose accuracy is not the same."""
    rows = _accuracy(other)
    for name, row in _accuracy(one).items():
        keys = [key for key in row if row[key] != rows.get(name, row).get(key)]
        if keys:
            yield f"{name}: {', '.join(keys)}"


def _accuracy(result):
    """By the name of each row what is no measured time or memory."""
    parts = (part for part in result.get("sensor", {}).values() if "skipped" not in part)
    rows = {f"{row['case']}, {row['method']}": row for part in parts for row in part}
    for row in result["trade"]:
        rows[_name(row)] = {key: row[key] for key in row if key not in _MEASURED}
    return rows


def _common(one, other):
    """Name and both values of the ratios that are in both results."""
    first, second = ratios(one), ratios(other)
    found = [(name, first[name], second[name]) for name in first if name in second]
    if not found:
        raise InputError("the two results have no ratio in common")
    return found


def _different_machine(one, other):
    keys = [key for key in one if key != "date" and one[key] != other[key]]
    if keys:
        yield f"not the same {', '.join(keys)}: ratios and last digits may differ for that"


def _name(row):
    return str(Case(row["layout"], row["profile"]))
