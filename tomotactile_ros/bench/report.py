"""A result as text for the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.extremes import BEYOND
from tomotactile_ros.bench.sensor import tables as sensor


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
    yield ""
    yield "Speed and accuracy"
    rows = [(row["layout"], row["profile"], *tables.trade_cells(row)) for row in result["trade"]]
    yield from tables.text(("layout", "profile", *tables.TRADE), rows, width, fixed=2)
    yield tables.LEGEND
    yield ""
    yield "What time buys: frames that follow one another, profile auto"
    header = (
        *("sensor", "deadline ms", "OSPA mm", "ghosts", "missed", "force %"),
        *("withheld", "complete", "median ms", "worst ms"),
    )
    yield from tables.text(header, map(_deadline, result["deadlines"]), width)
    yield ""
    yield "The sensor as it is, 40 x 40 pixels"
    measured = {part: rows for part, rows in result["sensor"].items() if "skipped" not in rows}
    yield from sensor.text(measured, width)
    yield from dict.fromkeys(
        rows["skipped"] for rows in result["sensor"].values() if "skipped" in rows
    )
    yield ""
    yield "Peers on the same problem: 8 x 8 electrodes, 40 x 40 pixels"
    yield from _peers(result["peers"])
    yield ""
    yield "Growth of cost, profile fast: exponents of electrodes and pixels"
    yield from _growth(result["growth"])
    yield ""
    yield "Stability"
    yield from stability_lines(result["stability"], width)


def stability_lines(rows: list[dict], width: float = inf) -> Iterator[str]:
    """What every profile makes of the extremes."""
    yield "place in parts of the longer side, force in parts of the true one; [n]: refused, see below"
    refusals: dict[str, int] = {}
    lines = [_of_profiles(row, refusals) for row in rows]
    yield from tables.text(("what", "value", *PROFILES), lines, width, 2)
    yield from (f"[{number}] {text}" for text, number in refusals.items())
    yield _beyond(rows)


def _deadline(row):
    force = "-" if row["force"] is None else f"{100 * row['force']:.1f}"
    counts = f"{row['withheld']} of {row['frames']}", f"{row['complete']} of {row['frames']}"
    times = (tables.milliseconds(row[key]) for key in ("median", "worst"))
    place = f"{1e3 * row['ospa']:.2f}", str(row["ghosts"]), str(row["missed"]), force
    return row["sensor"], tables.milliseconds(row["deadline"]), *place, *counts, *times


def _peers(peers):
    problem = peers["problem"]
    header = (
        "what",
        "set-up s",
        "frame ms",
        "spread ms",
        "OSPA mm",
        "worn",
        "HWHM mm",
        "PE mm",
        "p95",
        "blur mm",
    )
    measured = ((name, found) for name, found in problem.items() if "skipped" not in found)
    yield from tables.text(header, (_peer(*each) for each in measured))
    yield from (found["skipped"] for found in problem.values() if "skipped" in found)
    yield from (f"{name}: {ratio:.3g}" for name, ratio in peers["ratios"].items())


def _peer(name, found):
    hwhm, error, blur = (found.get(key, {}) for key in ("hwhm", "position_error", "blur"))
    return (
        name,
        f"{found['setup']:.2f}" if "setup" in found else "-",
        tables.milliseconds(found["frame"]["median"]),
        tables.milliseconds(found["frame"]["spread"]),
        *(tables.hundredths(found.get("ospa", {}).get(sensor)) for sensor in SENSORS),
        tables.millimetres(hwhm.get("mean")),
        tables.millimetres(error.get("mean")),
        tables.millimetres(error.get("p95")),
        tables.millimetres(blur.get("mean")),
    )


def _growth(growth):
    header = ("electrodes", "pixels", "set-up s", "frame ms", "MB")
    for by, found in growth.items():
        yield from tables.text(header, map(_cost, found["points"]))
        powers = (
            f"{name} n^{found['exponents'][key]:.2f}"
            for key, name in (("setup", "set-up"), ("frame", "frame"), ("memory", "memory"))
        )
        yield f"with n {by}: {', '.join(powers)}"


def _cost(point):
    return (
        str(point["electrodes"]),
        str(point["pixels"]),
        f"{point['setup']:.3f}",
        tables.milliseconds(point["frame"]),
        tables.megabytes(point["memory"]),
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
