"""What the program of a node says to `--help`, and to words that it does not know."""

import textwrap
from collections.abc import Mapping, Sequence

from rclpy.utilities import remove_ros_args

from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.support.errors import InputError

_WIDTH = 100


def asks_for_help(words: Sequence[str]) -> bool:
    """Whether a command line without the program's name asks for help.

    Raises InputError for words that are not ROS's: a parameter without `-p` would do nothing.
    """
    try:
        others = remove_ros_args(args=list(words))
    except RuntimeError as error:
        raise InputError(f"ROS does not start: {' '.join(str(error).split())}") from None
    if any(word in ("-h", "--help") for word in others):
        return True
    if others:
        raise InputError(
            f"'{others[0]}' is not known: parameters are given as --ros-args -p NAME:=VALUE "
            "(try --help)"
        )
    return False


def usage(program: str, about: str, specs: Mapping[str, Sequence[Spec]]) -> str:
    """Text of the help: what the program is, and the parameters of its nodes, by node."""
    lines = [
        f"usage: {program} [--ros-args WORD ...]",
        "words: -p NAME:=VALUE, --params-file FILE, -r __ns:=NAMESPACE, -r TOPIC:=OTHER",
        "",
        about.strip(),
    ]
    for node, of_node in specs.items():
        several = f", given as -p {node}:NAME:=VALUE" if len(specs) > 1 else ""
        lines += ["", f"parameters of {node}{several}:"]
        for spec in of_node:
            lines += _described(spec)
    return "\n".join(lines)


def _described(spec: Spec) -> list[str]:
    """Name, default and meaning of a parameter."""
    default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
    shown = str(default).lower() if isinstance(default, bool) else str(default) or "''"
    text = spec.description
    if spec.choices:
        text += f" ({', '.join(spec.choices)})"
    elif spec.low is not None:
        text += f" ({spec.low:.10g} to {spec.high:.10g})"
    head = f"  {spec.name}:={shown}"
    return [head, *textwrap.wrap(text, _WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)]
