"""A result as text: for the terminal, and the measured table of profiles in a document, rewritten
between two comments."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from pathlib import Path

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import PROFILES, is_default
from tomotactile_ros.bench.extremes import BEYOND
from tomotactile_ros.bench.sensor import tables as sensor
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic

_BEGIN, _END = "<!-- bench:profiles -->", "<!-- /bench:profiles -->"

DEADLINES = (
    *("sensor", "deadline ms", "OSPA mm", "ghosts", "missed", "force %"),
    *("withheld", "complete", "median ms", "worst ms"),
)
PEERS = (
    *("what", "set-up s", "frame ms", "spread ms", "OSPA mm", "worn"),
    *("HWHM mm", "PE mm", "p95", "blur mm"),
)
COSTS = "electrodes", "pixels", "set-up s", "frame ms", "MB"


def lines(result: dict, width: float = inf) -> Iterator[str]:
    """Everything that was measured, as tables for a terminal of `width` characters."""
    machine = result["machine"]
    cores = f"{machine['processor']}, {machine['cores']} cores"
    yield f"{cores}, {machine['system']}, {machine['date']}"
    libraries = (f"{name} {version or '-'}" for name, version in machine["libraries"].items())
    yield f"Python {machine['python']}, {', '.join(libraries)}, {machine['blas']}"
    threads = (f"{name}={value or '-'}" for name, value in machine["threads"].items())
    seconds = sum(result["seconds"].values())
    yield f"threads: {', '.join(threads)}; {seconds:.0f} s, {result['peak_memory'] / 1e6:.0f} MB"
    yield from ("", "Speed and accuracy")
    rows = [(row["layout"], row["profile"], *tables.trade_cells(row)) for row in result["trade"]]
    yield from tables.text(("layout", "profile", *tables.TRADE), rows, width, fixed=2)
    yield from (tables.LEGEND, "")
    yield "What time buys: frames that follow one another, profile auto"
    yield from tables.text(DEADLINES, map(_deadline, result["deadlines"]), width)
    yield from ("", "The sensor as it is, 40 x 40 pixels")
    skipped = {
        rows["skipped"]: part for part, rows in result["sensor"].items() if "skipped" in rows
    }
    measured = {p: rows for p, rows in result["sensor"].items() if p not in skipped.values()}
    yield from (*sensor.text(measured, width), *skipped, "")
    yield "Peers on the same problem: 8 x 8 electrodes, 40 x 40 pixels"
    found = result["peers"]["problem"]
    skipped = {name: each["skipped"] for name, each in found.items() if "skipped" in each}
    yield from tables.text(PEERS, (_peer(n, each) for n, each in found.items() if n not in skipped))
    yield from skipped.values()
    yield from (f"{name}: {ratio:.3g}" for name, ratio in result["peers"]["ratios"].items())
    yield from ("", "Growth of cost, profile fast: exponents of electrodes and pixels")
    for by, found in result["growth"].items():
        yield from tables.text(COSTS, map(_cost, found["points"]))
        powers = (f"{name} n^{value:.2f}" for name, value in found["exponents"].items())
        yield f"with n {by}: {', '.join(powers)}"
    yield from ("", "Stability", *stability_lines(result["stability"], width))


def stability_lines(rows: list[dict], width: float = inf) -> Iterator[str]:
    """What every profile makes of the extremes."""
    yield "place in parts of the longer side, force in parts of the true one; [n]: refused, see below"
    refusals: dict[str, int] = {}
    lines = [_of_profiles(row, refusals) for row in rows]
    yield from tables.text(("what", "value", *PROFILES), lines, width, 2)
    yield from (f"[{number}] {text}" for text, number in refusals.items())
    yield _beyond(rows)


def _deadline(row):
    counts = (f"{row[key]} of {row['frames']}" for key in ("withheld", "complete"))
    return (
        row["sensor"],
        tables.milliseconds(row["deadline"]),
        *(f"{1e3 * row['ospa']:.2f}", str(row["ghosts"]), str(row["missed"])),
        tables.number(row["force"], 100, ".1f"),
        *counts,
        *(tables.milliseconds(row[key]) for key in ("median", "worst")),
    )


def _peer(name, found):
    merits = (
        ("hwhm", "mean"),
        ("position_error", "mean"),
        ("position_error", "p95"),
        ("blur", "mean"),
    )
    return (
        name,
        tables.number(found.get("setup"), 1, ".2f"),
        *(tables.milliseconds(found["frame"][key]) for key in ("median", "spread")),
        *(tables.number(found.get("ospa", {}).get(each), 1e3, ".2f") for each in SENSORS),
        *(tables.number(found.get(key, {}).get(which), 1e3, ".1f") for key, which in merits),
    )


def _cost(point):
    return (
        *(str(point["electrodes"]), str(point["pixels"]), f"{point['setup']:.3f}"),
        *(tables.milliseconds(point["frame"]), f"{point['memory'] / 1e6:.3g}"),
    )


def _of_profiles(row, refusals):
    """Place and force of each profile at one value; `refusals` numbers the reasons where there are
    none."""
    found = row["profiles"] or [{"refusal": row["refusal"]}] * len(PROFILES)
    cells = []
    for each in found:
        if each["refusal"]:
            cells.append(f"[{refusals.setdefault(each['refusal'], len(refusals) + 1)}]")
            continue
        place = f"{each['place']:.1e}{_mark(each.get('place_off'))}"
        force = ""
        if each["force"] is not None:
            force = f", {100 * each['force']:+.0f} %{_mark(each.get('force_off'))}"
        ghosts = f", {each['ghosts']} ghosts" if each["ghosts"] else ""
        cells.append(f"{place}{force}{ghosts}")
    warned = [f"warning: {each}" for each in row["warnings"]]
    return row["what"], f"{float(row['value']):g}", *cells[:-1], "; ".join([cells[-1], *warned])


def _beyond(rows):
    """What the mark means, and how much of what could be marked has it."""
    cells = [each for row in rows for each in row["profiles"] or [] if not each["refusal"]]
    stated = [each for each in cells if each.get("place_off") is not None]
    marked = [each for each in stated if _mark(each["place_off"]) or _mark(each["force_off"])]
    return (
        f"!n: n times the deviation stated with it, wrong beyond what it says ({len(marked)} of "
        f"the {len(stated)} outcomes with deviations, more than {BEYOND:g})"
    )


def _mark(off):
    """A value beyond the deviations that were stated with it looks right and is not."""
    return "" if off is None or off <= BEYOND else f" !{off:.0f}"


def rewrite(path: str | Path, result: dict) -> None:
    """Fill the file at `path` between `_BEGIN` and `_END` with the profiles on 8 x 8 electrodes and
    40 x 40 pixels, and what measured them. Raises InputError as `check` does."""
    before, after = check(path)
    rows = filter(is_default, result["trade"])
    cells = [(f"`{row['profile']}`", *tables.trade_cells(row)) for row in rows]
    machine = result["machine"]
    said = (
        "8 × 8 electrodes on 200 mm × 200 mm, 40 × 40 pixels, contacts of 5 mm radius, "
        "1 mV of noise, 12 bits; the worn sensor is that of the scene `worn-sensor`; OSPA: places, "
        "ghosts and missed contacts of single ones and pairs in one figure; one thread of "
        f"{machine['processor']}, Python {machine['python']}, "
        f"numpy {machine['libraries']['numpy']}, {machine['date']}."
    )
    table = tables.markdown(("profile", *tables.TRADE), cells)
    text = "\n".join([f"{before}{_BEGIN}", *table, "", said, f"{_END}{after}"])
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
