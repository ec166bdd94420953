"""One HTML page of all figures and tables, each number beside that of the article."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from tomotactile_ros.bench.paper.article import EXPERIMENT, MODELS, REPORTED, SIDE
from tomotactile_ros.bench.paper.contacts import COMPARED, EVEN, UNEVEN, Found, pairs_of, ratio
from tomotactile_ros.bench.paper.experiment import CONDUCTORS, Image, Trial
from tomotactile_ros.bench.paper.simulation import COUNTS, LABELS, Run, figures, nearest
from tomotactile_ros.evaluation import scoring

_STYLE = (
    "body{font-family:sans-serif;max-width:75em;margin:2em auto;padding:0 1em;color:#222;background:#fff}"
    "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:.25em .6em}"
    "th{background:#f2f2f2;text-align:left}figure{margin:1.5em 0}figcaption{color:#555}"
    "img{max-width:100%}"
)
_SHEETS = EVEN, UNEVEN
_TITLE = "Kojima, Yoshimoto and Yamamoto 2023, computed again"


@dataclass(frozen=True, eq=False)
class Group:
    """Layouts of one outline and what was found with each; the first is what others are relative to.

    picture : name of the file with their maps
    note : what else there is to say
    """

    title: str
    picture: str
    found: Sequence[tuple[str, Found]]
    note: str = ""


def page(
    runs: Sequence[Run],
    experiment: Sequence[tuple[str, dict[str, Image]]],
    trials: Sequence[Trial],
    groups: Sequence[Group],
) -> str:
    """The page; pictures are beside it under the names of `commands.paper`."""
    parts = [f"<h1>{_TITLE}</h1>", *_opening(), *_simulation(runs), *_experiment(experiment)]
    parts += [*_trials(trials), *_groups(groups)]
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><title>{_TITLE}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def ratio_rows(runs: Sequence[Run], count: int) -> Iterator[list[str]]:
    """Rows of the table of N x N electrodes: equal and optimized in %, their ratios, and how far these
    are from the article's."""
    reported = REPORTED[count]
    first, last = (", ".join(map(str, each)) for each in (reported.equal, reported.optimized))
    only = "in a figure only"
    given = f"{first}, {only}", f"{last}, {only} (update {reported.best})"
    yield ["article", *given, _three(reported.ratios), "", ""]
    for run in runs:
        if run.count != count:
            continue
        equal, best = figures(run.steps[0]), figures(run.steps[run.best])
        yield [
            MODELS[run.model],
            ", ".join(f"{value:.1f}" for value in equal),
            ", ".join(f"{value:.1f}" for value in best) + f" (update {run.best})",
            _three(run.ratios),
            " / ".join(f"{value:+.3f}" for value in run.differences),
            f"{run.away:.3f}",
        ]


def _three(values) -> str:
    return " / ".join(f"{value:.3f}" for value in values)


def _opening():
    yield (
        "<p>Optimization of electrode positions for equalizing local spatial performance of a tomographic "
        "tactile sensor, Frontiers in Robotics and AI 10:1157911, "
        '<a href="https://doi.org/10.3389/frobt.2023.1157911">doi 10.3389/frobt.2023.1157911</a>. '
        "Electrodes on 200 mm × 200 mm, 40 × 40 contacts, images by eq. 1 with λ² = 1000, updates by eq. 12 "
        "and Algorithm 1. HWHM: the largest distance from the centre of an image to the contour at half of "
        "its maximum. PE: from that centre to the contact. Both in % of the side.</p>"
    )


def _simulation(runs):
    yield "<h2>Fig. 3: simulation</h2>"
    words = ", ".join(LABELS)
    for count in COUNTS:
        yield f"<h3>{count} × {count} electrodes</h3>"
        header = (
            *("model", f"equal: {words} / %", "optimized / %", "optimized over equal"),
            *("that minus the article's", "mean distance from the article's"),
        )
        yield _table(header, ratio_rows(runs, count))
        name = f"fig3-{count}x{count}"
        yield _figure(f"{name}-spreads.png", "Point spreads, electrodes as single nodes")
        yield _figure(f"{name}-maps.png", "A, B: maps of HWHM and PE after each update")
        yield _figure(f"{name}-steps.png", "C, D: update by update, and what the article gives")
    yield "<h3>Which model is nearest</h3>"
    single = "; ".join(f"{label}: {MODELS[nearest(runs, i)]}" for i, label in enumerate(LABELS))
    by_count = "; ".join(
        f"{count} × {count}: {MODELS[nearest([run for run in runs if run.count == count])]}"
        for count in COUNTS
    )
    first = nearest(runs)
    off = max(np.abs(run.differences).max() for run in runs if run.model == first)
    yield (
        "<p>In all three ratios together, over both numbers of electrodes: "
        f"<b>{MODELS[first]}</b>, which is up to {off:.3f} away from the article's. {by_count}. "
        f"By single ratios over both: {single}.</p>"
    )
    yield (
        "<p>What the article does not say, and what may move the ratios: how λ² = 1000 "
        "is scaled (by the square of a voltage, by the number of readings or of nodes); where the nodes of its mesh "
        "are besides electrodes; how large a contact is; at which update the mean PE was "
        "taken; which region a contact outside all regions, or on the line between two, belongs to; how far "
        "from the rim the outer electrodes and the outer contacts are; what the centre of an image is (here: "
        "of all pixels above half of the maximum).</p>"
    )


def _experiment(experiment):
    yield "<h2>Fig. 4: experiment with 8 × 8 electrodes, here simulated</h2>"
    rows = []
    for place in CONDUCTORS:
        equal, optimized = EXPERIMENT[place]
        row = [place, f"{equal} → {optimized} (× {optimized / equal:.2f})"]
        mine = [images[place] for _, images in experiment]
        row += [f"{100 / SIDE * each.hwhm:.1f}, {100 / SIDE * each.error:.1f}" for each in mine]
        row.append(f"× {mine[1].hwhm / mine[0].hwhm:.2f}")
        rows.append(row)
    columns = [f"{name}: HWHM, PE / %" for name, _ in experiment]
    header = ("conductor", "article: HWHM, equal → optimized / %", *columns, "HWHM, ratio")
    yield _table(header, rows)
    yield _figure("fig4-images.png", "Images of conductors, and of wide, L-shaped and two contacts")
    yield (
        "<p>Frames are those of discs on finite elements, with 1 mV of noise and 12 bits; images are made with "
        "electrodes as single nodes, and optimized is the update of that model with the best mean HWHM, as above; the "
        f"article took its {REPORTED[8].best}th. Conductors have a radius of 2.5 mm and 5 V. The article shows their places "
        "and shapes in a figure only; here they are in the middle of regions of the equal grid. It "
        "gives position errors in a figure only.</p>"
    )


def _trials(trials):
    yield "<h3>Is the gain of the experiment there?</h3>"
    reported = REPORTED[8]
    equal, optimized = EXPERIMENT["centre"]
    yield (
        f"<p>The article's experiment has × {optimized / equal:.2f} in the centre ({equal} → {optimized} %), at "
        "twice the HWHM that its own simulation has in any region: "
        f"{reported.equal[1]} → {reported.optimized[1]} % (× {reported.optimized[1] / reported.equal[1]:.2f}) in the worst "
        "region. So one thing after the other was changed here, for conductors all over a region: median of "
        "HWHM on the equal grid, median of the ratio optimized / equal, and in brackets where 90 % of the ratios "
        "lie.</p>"
    )
    yield _table(
        ("what is changed", *(f"{place}: HWHM of equal / %, ratio" for place in CONDUCTORS)),
        ([trial.words, *(_trial(trial, place) for place in CONDUCTORS)] for trial in trials),
    )
    plain, joints = trials[0], trials[-1]
    article = {place: after / before for place, (before, after) in EXPERIMENT.items()}
    closest = min(
        trials, key=lambda each: max(abs(each.ratio(place) - article[place]) for place in article)
    )
    by_place, by_joints = (
        ", ".join(f"{_range(trial, place)} ({place})" for place in CONDUCTORS)
        for trial in (plain, joints)
    )
    within = {}
    for place, value in article.items():
        low, high = joints.limits(place)
        within.setdefault(low <= value <= high, {})[place] = value
    yield (
        "<p>The drive voltage changes nothing: images are in proportion to it. Of all three ratios of the article "
        f"({_each(article)}), “{escape(closest.words)}” changed leaves the least to explain: "
        f"{_each({place: closest.ratio(place) for place in article})}. Where in its region a conductor lies changes "
        f"the ratio, too, with nothing else changed: {by_place}. With bad joints, which the article "
        f"names, the ratio of two boards is partly chance: {by_joints}. The article's ratio lies within "
        f"these limits at {_each(within.get(True, {})) or 'no place'}: one conductor there on one pair "
        "of boards does not tell a layout's gain from chance. It lies outside at "
        f"{_each(within.get(False, {})) or 'no place'}: that is neither the layout nor the joints as "
        "they are here. Not known: the places of the conductors, the joints, "
        "the wrinkles, and how the article's λ² is scaled for measured voltages.</p>"
    )


def _each(ratios: dict[str, float]) -> str:
    return ", ".join(f"{place} × {value:.2f}" for place, value in ratios.items())


def _trial(trial: Trial, place: str) -> str:
    equal, _ = trial.hwhm[place]
    middle = f"{100 / SIDE * np.median(equal):.1f}, × {trial.ratio(place):.2f}"
    return f"{middle} ({_range(trial, place)})"


def _range(trial: Trial, place: str) -> str:
    low, high = trial.limits(place)
    return f"{low:.2f} to {high:.2f}"


def _groups(groups):
    yield "<h2>Beyond it: other layouts, and what counts at the end</h2>"
    for group in groups:
        yield f"<h3>{escape(group.title)}</h3>"
        yield _figure(group.picture, "The same maps, electrodes as single nodes")
        yield _table(_contact_header(group.found), contact_rows(group.found))
        singles = len(group.found[0][1].place[EVEN])
        yield (
            f"<p>Contacts that profile <code>accurate</code> finds on frames of an independent model: {singles} "
            f"single ones on each kind of sheet, {pairs_of(singles)} pairs at each distance, the same for all "
            "layouts. In brackets what 95 % of samples of as many contacts come to: a ratio whose interval "
            "contains 1 says nothing, and of a dozen contacts the intervals themselves are too narrow; "
            "<code>--contacts</code> takes more of them, docs/layouts.md has what more of them said. "
            f"{escape(group.note)}</p>"
        )


def _contact_header(found):
    first, measured = found[0]
    return (
        "layout",
        *(f"place, {sheet}: mean, p95 / mm" for sheet in _SHEETS),
        *(f"relative to {first}, {sheet}: mean, p95" for sheet in _SHEETS),
        *(f"force, {sheet}: median, p95 / %" for sheet in _SHEETS),
        *(f"pairs told apart at {1e3 * apart:g} mm" for apart in measured.told),
    )


def contact_rows(found: Sequence[tuple[str, Found]]) -> Iterator[list[str]]:
    """Rows of the table of contacts; the first layout is what the others are relative to."""
    _, first = found[0]
    for name, measured in found:
        row = [name]
        for sheet in _SHEETS:
            values = scoring.figures(1e3 * measured.place[sheet], COMPARED)
            row.append(", ".join(f"{value:.3f}" for value in values.values()))
        for sheet in _SHEETS:
            if measured is first:
                row.append("")
                continue
            parts = (
                ratio(measured.place[sheet], first.place[sheet], figure) for figure in COMPARED
            )
            row.append(", ".join("× {:.2f} ({:.2f} to {:.2f})".format(*part) for part in parts))
        for sheet in _SHEETS:
            values = np.percentile(100 * measured.force[sheet], (50, 95))
            row.append(", ".join(f"{value:.1f}" for value in values))
        yield [*row, *(f"{100 * part:.0f} %" for part in measured.told.values())]


def _figure(name: str, caption: str) -> str:
    return f'<figure><img src="{name}" alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'


def _table(header: Sequence[str], rows) -> str:
    lines = ["<table>", "<tr>" + "".join(f"<th>{escape(each)}</th>" for each in header) + "</tr>"]
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(each)}</td>" for each in row) + "</tr>")
    return "\n".join([*lines, "</table>"])
