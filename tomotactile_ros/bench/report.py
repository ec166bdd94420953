"""A result as text: for the terminal, and the measured table of profiles in a document, rewritten
between two comments."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from pathlib import Path

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.cases import PROFILES, is_default
from tomotactile_ros.bench.extremes import BEYOND
from tomotactile_ros.bench.sensor import TITLES
from tomotactile_ros.bench.tables import Column
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic

_BEGIN, _END = "<!-- bench:profiles -->", "<!-- /bench:profiles -->"

TRADE: tuple[Column, ...] = (  # of `trade.measure`
    ("set-up", "{setup.median:.2f} s"),
    ("memory", "{memory:1e-6 .3g} MB"),
    ("frame: median, p99", "{frame.textbook.median:1e3 .3g} ms, {frame.textbook.p99:1e3 .3g} ms"),
    ("OSPA", "{ospa.textbook:1e3 .2f} mm"),
    ("worn sensor: frame", "{frame.worn.median:1e3 .3g} ms, {frame.worn.p99:1e3 .3g} ms"),
    ("OSPA", "{ospa.worn:1e3 .2f} mm"),
    (
        "one contact: error, p95; ghosts, missed",
        (
            "{contact_error.mean:1e3 .2f} mm, {contact_error.p95:1e3 .2f} mm; "
            "{scores.textbook.one.ghosts+doubled}, {scores.textbook.one.missed}"
        ),
    ),
    (
        "worn sensor: error; ghosts, missed",
        (
            "{worn.contact_error.mean:1e3 .2f} mm; "
            "{scores.worn.one.ghosts+doubled}, {scores.worn.one.missed}"
        ),
    ),
    ("two contacts from", "{two_contacts:1e3 .1f} mm"),
    (
        "force error, one and two",
        "{force_error.one.mean:100 .0f} %, {force_error.two.mean:100 .0f} %",
    ),
    ("image: HWHM, PE", "{hwhm.mean:1e3 .1f} mm, {position_error.mean:1e3 .1f} mm"),
)
TRADE_LEGEND = """\
frame: from voltages to contacts. OSPA: places, ghosts and missed contacts in one figure, mean of all
frames, cut-off 10 mm; a frame that is withheld counts as one without contacts. error: of the reported
place; two contacts from: smallest distance from which on 80 % of the pairs are told apart; force error:
of these pairs; HWHM, PE: of the image of one contact."""
DEADLINES: tuple[Column, ...] = (
    ("sensor", "{sensor}"),
    ("deadline ms", "{deadline:1e3 .3g}"),
    ("OSPA mm", "{ospa:1e3 .2f}"),
    ("ghosts", "{ghosts}"),
    ("missed", "{missed}"),
    ("force %", "{force:100 .1f}"),
    ("withheld", "{withheld} of {frames}"),
    ("complete", "{complete} of {frames}"),
    ("median ms", "{median:1e3 .3g}"),
    ("worst ms", "{worst:1e3 .3g}"),
)
SENSOR_LEGEND = """\
ghosts: reported contacts 10 mm or more from every true one; doubled: nearer, beside one that is paired
already; weak: below 0.02 N, not judged; missed: true contacts without a pair; place, force: of pairs;
OSPA: places, ghosts and misses in one figure, mean of the frames, cut-off 10 mm; bound: Cramer-Rao
bound of the same places, median; place: median of the errors in parts of it, 0.83 at best."""
PEERS: tuple[Column, ...] = (
    ("what", "{what}"),
    ("set-up s", "{setup:.2f}"),
    ("frame ms", "{frame.median:1e3 .3g}"),
    ("spread ms", "{frame.spread:1e3 .3g}"),
    ("OSPA mm", "{ospa.textbook:1e3 .2f}"),
    ("worn", "{ospa.worn:1e3 .2f}"),
    ("HWHM mm", "{hwhm.mean:1e3 .1f}"),
    ("PE mm", "{position_error.mean:1e3 .1f}"),
    ("p95", "{position_error.p95:1e3 .1f}"),
    ("blur mm", "{blur.mean:1e3 .1f}"),
)
COSTS: tuple[Column, ...] = (
    ("electrodes", "{electrodes}"),
    ("pixels", "{pixels}"),
    ("set-up s", "{setup:.3f}"),
    ("frame ms", "{frame:1e3 .3g}"),
    ("MB", "{memory:1e-6 .3g}"),
)


def lines(result: dict, width: float = inf) -> Iterator[str]:
    """What was measured, as tables for a terminal of `width` characters."""
    machine = result["machine"]
    cores = f"{machine['processor']}, {machine['cores']} cores"
    yield f"{cores}, {machine['system']}, {machine['date']}"
    libraries = (f"{name} {version or '-'}" for name, version in machine["libraries"].items())
    yield f"Python {machine['python']}, {', '.join(libraries)}, {machine['blas']}"
    threads = (f"{name}={value or '-'}" for name, value in machine["threads"].items())
    seconds = sum(result["seconds"].values())
    yield f"threads: {', '.join(threads)}; {seconds:.0f} s, {result['peak_memory'] / 1e6:.0f} MB"
    for title, key, section in (
        ("Speed and accuracy", "trade", _trade),
        ("What time buys: frames that follow one another, profile auto", "deadlines", _deadlines),
        ("The sensor as it is, 40 x 40 pixels", "sensor", sensor_lines),
        ("Peers on the same problem: 8 x 8 electrodes, 40 x 40 pixels", "peers", _peers),
        ("Growth of cost, profile fast: exponents of electrodes and pixels", "growth", _growth),
        ("Stability", "stability", stability_lines),
    ):
        if result.get(key):
            yield from ("", title, *section(result[key], width))


def _trade(rows, width):
    columns = (("layout", "{layout}"), ("profile", "{profile}"), *TRADE)
    yield from (*tables.of(columns, rows, width, fixed=2), TRADE_LEGEND)


def _deadlines(rows, width):
    return tables.of(DEADLINES, rows, width)


def sensor_lines(found: dict[str, list[dict] | dict], width: float = inf) -> Iterator[str]:
    """Of rows of `sensor.trial.measure` by part, or why there are none. Bounds have columns where
    there are any."""
    columns: tuple[Column, ...] = (("case", "{case}"), ("method", "{method}"), *tables.HELD)
    skipped = [rows["skipped"] for rows in found.values() if isinstance(rows, dict)]
    for part, rows in found.items():
        if isinstance(rows, dict):
            continue
        bounded = any(row["bound"] is not None for row in rows)
        bound = ("bound mm", "{bound:1e3 .3f}"), ("place / bound", _part_of_bound)
        yield TITLES[part]
        yield from tables.of((*columns, *(bound if bounded else ())), rows, width, fixed=2)
        yield ""
    yield from (SENSOR_LEGEND, *dict.fromkeys(skipped))


def _part_of_bound(row):
    bound, median = row["bound"], row["place"]["median"]
    return "-" if None in (bound, median) else f"{median / bound:.1f}"


def _peers(found, width):
    rows = [each | {"what": name} for name, each in found["problem"].items()]
    yield from tables.of(PEERS, (row for row in rows if "skipped" not in row))
    yield from (row["skipped"] for row in rows if "skipped" in row)
    yield from (f"{name}: {ratio:.3g}" for name, ratio in found["ratios"].items())


def _growth(found, width):
    for by, each in found.items():
        yield from tables.of(COSTS, each["points"])
        powers = (f"{name} n^{value:.2f}" for name, value in each["exponents"].items())
        yield f"with n {by}: {', '.join(powers)}"


def stability_lines(rows: list[dict], width: float = inf) -> Iterator[str]:
    """What every profile makes of the extremes."""
    yield "place in parts of the longer side, force in parts of the true one; [n]: refused, see below"
    refusals: dict[str, int] = {}
    lines = [_of_profiles(row, refusals) for row in rows]
    yield from tables.text(("what", "value", *PROFILES), lines, width, 2)
    yield from (f"[{number}] {text}" for text, number in refusals.items())
    yield _beyond(rows)


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
    columns = (("profile", "`{profile}`"), *TRADE)
    cells = [tables.cells(columns, row) for row in filter(is_default, result["trade"])]
    machine = result["machine"]
    said = (
        "8 × 8 electrodes on 200 mm × 200 mm, 40 × 40 pixels, contacts of 5 mm radius, "
        "1 mV of noise, 12 bits; the worn sensor is that of the scene `worn-sensor`; OSPA: places, "
        "ghosts and missed contacts of single ones and pairs in one figure; one thread of "
        f"{machine['processor']}, Python {machine['python']}, "
        f"numpy {machine['libraries']['numpy']}, {machine['date']}."
    )
    table = tables.markdown(tables.titles(columns), cells)
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
