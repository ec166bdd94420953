"""One HTML page of all figures and tables, each number beside that of the article."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from tomotactile_ros.bench.paper.article import EXPERIMENT, INDEPENDENT, MODELS, REPORTED, SIDE
from tomotactile_ros.bench.paper.contacts import AMOUNTS
from tomotactile_ros.bench.paper.experiment import CONDUCTORS, Image
from tomotactile_ros.bench.paper.simulation import COUNTS, LABELS, Run, figures, nearest, nearest_in

_STYLE = (
    "body{font-family:sans-serif;max-width:70em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:.25em .6em}"
    "img{max-width:100%}"
)
_TITLE = "Kojima, Yoshimoto and Yamamoto 2023, computed again"


def page(
    runs: Sequence[Run],
    experiment: Sequence[tuple[str, dict[str, Image]]],
    contacts: dict[int, list[tuple[str, dict]]],
) -> str:
    """The page; pictures are beside it under the names of `commands.paper`."""
    parts = [f"<h1>{_TITLE}</h1>", *_simulation(runs), *_experiment(experiment)]
    parts += _contacts(contacts)
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><title>{_TITLE}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def ratio_rows(runs: Sequence[Run], count: int) -> Iterator[list[str]]:
    """Rows of the table of N x N electrodes: equal and optimized in %, and their ratios."""
    reported = REPORTED[count]
    before = f"{reported.mean}, {reported.worst_region}, not said"
    yield ["article", before, "", _three(reported.ratios), "", ""]
    for run in runs:
        if run.count != count:
            continue
        equal, best = figures(run.steps[0]), figures(run.steps[run.best])
        yield [
            MODELS[run.model],
            ", ".join(f"{value:.2f}" for value in equal),
            ", ".join(f"{value:.2f}" for value in best) + f" (update {run.best})",
            _three(run.ratios),
            _three(INDEPENDENT[count][run.model]),
            f"{run.away:.3f}",
        ]


def _three(values) -> str:
    return " / ".join(f"{value:.3f}" for value in values)


def _simulation(runs):
    yield "<h2>Fig. 3: simulation</h2>"
    words = ", ".join(LABELS)
    for count in COUNTS:
        yield f"<h3>{count} × {count} electrodes</h3>"
        yield _table(
            (
                "model",
                f"equal: {words} / %",
                "optimized / %",
                "optimized over equal",
                "the same, measured separately",
                "mean distance of the ratios from the article's",
            ),
            ratio_rows(runs, count),
        )
        yield _figure(f"fig3-{count}x{count}-maps.png", "A, B: maps, in the nearest model")
        yield _figure(f"fig3-{count}x{count}-steps.png", "C, D: update by update")
    most = max(run.away_from_independent for run in runs if run.model == "point-nodes")
    single = ", ".join(
        f"{label}: {MODELS[nearest_in(list(runs), i)]}" for i, label in enumerate(LABELS)
    )
    yield (
        "<p>Nearest to the article in all three ratios together, over both numbers of electrodes: "
        f"<b>{MODELS[nearest(list(runs))]}</b>. By single ratios: {single}. No model has all of them.</p>"
    )
    yield (
        f"<p>With electrodes as single nodes the separate program differs by at most {most:.3f}: its mesh "
        "may have other nodes. Where it has the digits of this page in the two other models, that is no "
        "check of the mesh, on which these digits depend.</p>"
    )
    yield (
        "<p>What the article does not say: how λ² = 1000 is scaled, where the nodes of its mesh are, at "
        "which update the mean position error was taken, which region a contact outside all regions "
        "belongs to, and how far from the rim the outer electrodes are.</p>"
    )


def _experiment(experiment):
    yield "<h2>Fig. 4: experiment with 8 × 8 electrodes, here simulated</h2>"
    rows = []
    for place in CONDUCTORS:
        equal, optimized = EXPERIMENT[place]
        row = [place, f"{equal} → {optimized}"]
        for _, images in experiment:
            image = images[place]
            row.append(f"{100 / SIDE * image.hwhm:.1f}, {100 / SIDE * image.error:.1f}")
        rows.append(row)
    columns = [f"{name}: HWHM, PE / %" for name, _ in experiment]
    yield _table(("conductor", "article: HWHM, equal → optimized / %", *columns), rows)
    first, second = experiment[0][1], experiment[1][1]
    worse = [place for place in CONDUCTORS if second[place].hwhm > first[place].hwhm]
    if worse:
        yield (
            f"<p>The optimized layout has the larger HWHM here for: {', '.join(worse)}. In the article "
            "that is so for the corner alone.</p>"
        )
    yield _figure("fig4-images.png", "Images of conductors, and of wide, L-shaped and two contacts")
    yield (
        "<p>The article measured a real sheet, whose images are skewed by wrinkles and uneven joints, as it "
        "says; this one has 1 mV of noise and 12 bits only. Conductors have a radius of 2.5 mm, and the "
        "images assume 1 mm. The article shows their places and shapes in a figure only; here they are in "
        "the middle of regions of the equal grid. It gives no position errors.</p>"
    )


def _contacts(contacts):
    yield "<h2>Beyond it: other layouts</h2>"
    for count, rows in contacts.items():
        amount = AMOUNTS[count]
        yield f"<h3>{count} × {count} electrodes</h3>"
        yield _figure(f"layouts-{count}x{count}.png", "The same maps, electrodes as single nodes")
        yield _table(
            (
                "layout",
                "place: mean, p95 / mm",
                "force: median, p95 / %",
                f"pairs told apart at {1e3 * amount.apart[0]:g} mm",
            ),
            (
                [
                    name,
                    ", ".join(f"{1e3 * value:.3f}" for value in found["place"]),
                    ", ".join(f"{100 * value:.1f}" for value in found["force"]),
                    f"{100 * found['pairs']:.0f} %",
                ]
                for name, found in rows
            ),
        )
        yield (
            f"<p>Contacts that profile <code>accurate</code> finds on frames of an independent model, even "
            f"sheet: {amount.singles} single ones and {amount.pairs} pairs. So few tell a factor of two, not a "
            "tenth; docs/layouts.md has more of them.</p>"
        )


def _figure(name: str, caption: str) -> str:
    return f'<figure><img src="{name}" alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'


def _table(header: Sequence[str], rows) -> str:
    lines = ["<table>", "<tr>" + "".join(f"<th>{escape(each)}</th>" for each in header) + "</tr>"]
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(each)}</td>" for each in row) + "</tr>")
    return "\n".join([*lines, "</table>"])
