"""What the programs under benchmark/ have in common: options, and cells of tables."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from tomotactile_ros.bench.machine import use_one_thread


def options(doc: str, *cases: str, **known: Any) -> argparse.Namespace:
    """What is asked for, of a program that `doc` describes, held to one thread.

    cases : names of which any may be given before the options, as `cases`
    known : of each option its default, or that and a text, or also what may be chosen; a list takes
        several, False is a switch, a type in the place of the default means that there is none
    """
    use_one_thread()
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    if cases:
        parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(cases))
    for name, given in known.items():
        default, text, chosen = (
            (*given, None)[:3] if isinstance(given, tuple) else (given, None, None)
        )
        how: dict[str, Any] = {"default": default, "type": type(default)}
        if default is False:
            how = {"action": "store_true"}
        elif isinstance(default, type):
            how = {"type": default}
        elif isinstance(default, list):
            how |= {"nargs": "+", "type": type(default[0])}
        if chosen is not None:
            how["choices"] = chosen
        parser.add_argument(f"--{name.replace('_', '-')}", help=text, **how)
    found = parser.parse_args()
    if cases and not set(found.cases) <= set(cases):
        parser.error(f"CASE: one of {', '.join(cases)} is needed")
    return found


def spread(values, digits: int = 1, shares=(0.5, 0.95)) -> str:
    """Median and 95th percentile, or other quantiles, as a cell."""
    found = np.quantile(values, shares) if len(values) else ()
    return " / ".join(f"{each:.{digits}f}" for each in found) or "-"
