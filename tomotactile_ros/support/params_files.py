"""Which nodes a parameter file of ROS names; without ROS, so that launch files can ask, too.

ROS takes no notice of a key that fits no node: with ``driver:`` where the node is ``/left/driver``,
or ``drivr:``, every parameter silently has its default.
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from tomotactile_ros.support.errors import InputError

TYPO = 0.75  # likeness of two names, by difflib, from which one may be meant for the other
_PARAMETERS = "ros__parameters"


def read_sections(file: str | Path) -> list[tuple[str, dict[str, Any]]]:
    """Key of each node or pattern of nodes, from the root on, and its parameters, in file order.

    InputError for a file that is not there, or no YAML.
    """
    try:
        content = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"{file}: {' '.join(str(error).split())}") from None
    return list(_sections(content, ""))


def fits(key: str, node: str) -> bool:
    """Whether a key stands for a node, by its full name; `*` is one part of a name, `**` any."""
    pattern = re.escape(key).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(pattern, node) is not None


def parameters_of(file: str | Path, node: str) -> dict[str, Any]:
    """What a file gives a node, by its full name: of several values the last one."""
    given: dict[str, Any] = {}
    for key, parameters in read_sections(file):
        if fits(key, node):
            given |= parameters
    return given


def meant_for(keys: Iterable[str], node: str) -> list[str]:
    """Keys that look as if a node were meant, where none of them fits it; empty where one does."""
    keys = list(keys)
    if any(fits(key, node) for key in keys):
        return []
    name = _last(node)
    return [key for key in keys if difflib.get_close_matches(_last(key), [name], 1, TYPO)]


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _sections(content: object, above: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Sections of a mapping whose keys are names, and names of names."""
    if not isinstance(content, Mapping):
        return
    for key, values in content.items():
        if key == _PARAMETERS:
            yield above, dict(values) if isinstance(values, Mapping) else {}
        else:
            yield from _sections(values, f"{above}/{str(key).strip('/')}")
