"""`tomotactile evaluate`: how sharply and how accurately a layout images single contacts."""

from __future__ import annotations

import json
from argparse import (
    ArgumentParser,
    BooleanOptionalAction,
    Namespace,
    RawDescriptionHelpFormatter,
)

from tomotactile_ros.bench import tables
from tomotactile_ros.evaluation.layout_quality import MODELS, evaluate_layout
from tomotactile_ros.evaluation.paper_model import CONTACT_RADIUS
from tomotactile_ros.evaluation.places import CONTACT_RADIUS as TOUCH_RADIUS
from tomotactile_ros.evaluation.places import has_room
from tomotactile_ros.evaluation.point_spread import (
    LEAST_REGULARIZATION,
    MOST_CELLS,
    REGULARIZATION,
    RESOLUTION,
)
from tomotactile_ros.evaluation.posterior import (
    PAIRS_APART,
    PRESSURE,
    SEPARATION,
    Conditions,
    expected,
)
from tomotactile_ros.evaluation.profile_quality import evaluate_profile
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, doubt
from tomotactile_ros.support.progress import track

HELP = "measure the resolution of a layout: HWHM and position error all over the sheet"
_LINES = {"hwhm": "HWHM", "position_error": "position error", "blur": "blur"}
_REGIONAL = ("hwhm", "position_error")
_TOUCH_PLACES = 6  # contacts along the longer side
# electrodes; beyond, what is expected of a contact takes a minute and is asked for
_MOST_FOR_TOUCH = 64
_SHOWN = 12  # regions in the text; --json has all
TERMS = f"""\
what is printed:
  HWHM             from the middle of a contact's image to where it has fallen to half of its peak
  position error   from that middle to the contact
  blur             how far the image spreads around the contact, rms: width and error in one
  %                of the longer side of the sheet
  worst tenth      the mean of the largest tenth; worst region: of the mean of a region
  noise gain       noise of a pixel that noise of the readings makes
  place, force     what a contact can be known to at best, by readings with that noise
  d'               {SEPARATION.removeprefix("d' is ")}
  ghosts           reported, and no contact is within 10 mm; doubled: a second one within 10 mm
  weak, missed     reported with less than 0.02 N; not reported
  p95              the value that 95 % are below
  OSPA             distance to the true contacts, ghosts and misses counted as 10 mm
more: docs/layouts.md, docs/glossary.md"""


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = TERMS, RawDescriptionHelpFormatter
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument(
        "--profile",
        choices=PROFILES,
        help="reconstruct with this profile contacts that lie on no lattice, frames by finite "
        "elements with 1 mV noise (default: the paper's one-step image, without noise)",
    )
    parser.add_argument(
        "--regularization", type=float, help="lambda^2 of the one-step image (default: 1000)"
    )
    parser.add_argument(
        "--model",
        choices=MODELS,
        help="of the one-step image; auto (the default): paper for a uniform rectangle, otherwise fem",
    )
    parser.add_argument(
        "--contact-radius",
        type=float,
        help=f"m (default: {CONTACT_RADIUS:g}, with a profile several, none of them the one that it "
        "assumes)",
    )
    parser.add_argument(
        "--resolution",
        type=int,
        default=RESOLUTION,
        help="contact positions along the longer side (default: 40)",
    )
    parser.add_argument(
        "--touch",
        action=BooleanOptionalAction,
        help="expected errors of a contact, by the estimator's own model (default: up to "
        f"{_MOST_FOR_TOUCH} electrodes, without --profile)",
    )
    parser.add_argument(
        "--apart",
        type=float,
        default=PAIRS_APART,
        help=f"with --touch: distance of two contacts, m (default: {PAIRS_APART:g})",
    )
    parser.add_argument(
        "--touch-radius",
        type=float,
        default=TOUCH_RADIUS,
        help=f"with --touch: radius of the contacts, m (default: {TOUCH_RADIUS:g})",
    )
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    checks.integer(args.resolution, "--resolution", 2, MOST_CELLS)
    if args.regularization is not None:
        checks.positive(args.regularization, "--regularization", "number", LEAST_REGULARIZATION)
    if args.profile:
        for option in ("regularization", "model"):
            if getattr(args, option) is not None:
                raise InputError(
                    f"--{option}: belongs to the one-step image; a profile has its own"
                )
        result = evaluate_profile(
            layout,
            args.profile,
            radius=args.contact_radius,
            resolution=args.resolution,
            track=lambda contacts: track(contacts, "imaging contacts"),
        )
    else:
        result = evaluate_layout(
            layout,
            model=args.model or "auto",
            regularization=REGULARIZATION if args.regularization is None else args.regularization,
            contact_radius=args.contact_radius,
            resolution=args.resolution,
        )
    content = as_dict(result)
    if _wants_touch(args, layout):
        content["touch"] = _touch(layout, Conditions(apart=args.apart, radius=args.touch_radius))
    print(json.dumps(content, indent=1) if args.json else "\n".join(as_text(content)))


def _wants_touch(args, layout):
    if args.touch is None:
        wanted = not args.profile and layout.electrodes <= _MOST_FOR_TOUCH
        if wanted and not has_room(layout, args.touch_radius):
            doubt(
                f"--touch-radius: no disc of {args.touch_radius:g} m has room on the sheet, what is "
                "expected of contacts is left out"
            )
            return False
        return wanted
    return args.touch


def _touch(layout, conditions):
    """What is expected of contacts: figures, and for which."""
    found = expected(layout, conditions, _TOUCH_PLACES)
    return found.metrics | {
        "rows": len(layout.grounded),
        "contact_radius": conditions.radius,
        "pressure": PRESSURE,
        "noise": conditions.noise,
        "apart": conditions.apart,
        "positions": len(found.places),
        "pairs": len(found.pairs),
    }


def as_dict(result) -> dict:
    """Everything that an evaluation found, in m and in parts of the longer side times 100 (%)."""
    side = max(result.layout.outline.size)
    metrics = dict(result.metrics)
    noise_gain = metrics.pop("noise_gain", None)
    percent = {
        name: {key: 100 * value / side for key, value in values.items()}
        for name, values in metrics.items()
    }
    return {
        "layout": result.layout.name,
        "side": side,
        "settings": result.settings,
        "metrics": metrics,
        "percent": percent,
        "noise_gain": noise_gain,
        "contacts": result.contacts,
        "regions": [
            region | {"percent": {key: 100 * region[key] / side for key in _REGIONAL}}
            for region in result.by_region()
        ],
        "regions_are": "between electrodes" if result.regions.electrodes else "equal blocks",
    }


def as_text(content):
    """Lines of a table."""
    settings = ", ".join(f"{key} {_short(value)}" for key, value in content["settings"].items())
    yield f"layout {content['layout']}: {settings}"
    yield f"{'':16}{'mean':>18}{'worst tenth':>18}{'worst':>18}{'worst region':>18}"
    for name, label in _LINES.items():
        line = ""
        for key in ("mean", "worst_tenth", "worst", "worst_region"):
            if key in content["metrics"][name]:
                value, percent = content["metrics"][name][key], content["percent"][name][key]
                line += f"{1e3 * value:9.2f} mm{percent:5.1f} %"
        yield f"{label:16}{line}"
    if content["noise_gain"] is not None:
        yield f"noise gain      {1e3 * content['noise_gain']:.3g} mV of a pixel per V of a reading"
    if "touch" in content:
        yield from _touch_lines(content["touch"])
    if content["contacts"] is not None:
        yield "reported contacts, ghosts and misses with a cut-off of 10 mm:"
        yield from ("  " + line for line in tables.of(tables.SCORES, [content["contacts"]]))
    regions = sorted(content["regions"], key=lambda region: -region["hwhm"])
    yield f"{len(regions)} regions ({content['regions_are']}), the worst first:"
    yield "  row col  contacts  area/cm2              HWHM    position error"
    for region in regions[:_SHOWN]:
        yield (
            f"  {region['row']:3d} {region['col']:3d} {region['contacts']:9d}"
            f" {1e4 * region['area']:9.2f}"
            + "".join(
                f" {1e3 * region[key]:8.2f} mm{region['percent'][key]:5.1f} %" for key in _REGIONAL
            )
        )
    if len(regions) > _SHOWN:
        yield f"  and {len(regions) - _SHOWN} more (--json lists all)"
    yield "what these are: tomotactile evaluate --help"


def _touch_lines(touch):
    place, force, pair = touch["place"], touch["force"], touch["separation"]
    yield (
        f"expected errors of a contact ({1e3 * touch['contact_radius']:g} mm, "
        f"{1e-3 * touch['pressure']:g} kPa, noise {1e3 * touch['noise']:g} mV, {touch['rows']} rows), "
        "by the estimator's own model:"
    )
    for label, figures, unit, scale in (("place", place, "mm", 1e3), ("force", force, "%", 100)):
        mean, tenth = scale * figures["mean"], scale * figures["worst_tenth"]
        yield f"  {label:12} {mean:8.3f} {unit}, worst tenth {tenth:8.3f} {unit}"
    if pair:
        yield (
            f"  two {1e3 * touch['apart']:g} mm apart: d' {pair['mean']:.4g}, worst tenth "
            f"{pair['worst_tenth']:.4g} ({touch['pairs']} pairs); {SEPARATION}"
        )
    else:
        yield f"  two {1e3 * touch['apart']:g} mm apart: none of the pairs tried has room on the sheet"


def _short(value):
    return " ".join(f"{each:g}" for each in value) if isinstance(value, list) else value
