"""The command line of a node's program: its short form, `--help`, words that it does not know."""

import re
import textwrap
from collections.abc import Mapping, Sequence

from rclpy.utilities import remove_ros_args

from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.support.errors import InputError

_WIDTH = 100
_SHORT = re.compile(r"[A-Za-z_][\w./:]*:=")


def ros_words(words: Sequence[str]) -> list[str]:
    """A command line without the program's name as ROS reads it.

    `NAME:=VALUE` in front of `--ros-args` is a parameter, `__ns:=/left` and `__node:=other` are
    names: what users of `ros2 launch` are used to.
    """
    end = words.index("--ros-args") if "--ros-args" in words else len(words)
    short = [word for word in words[:end] if _SHORT.match(word)]
    others = [word for word in words[:end] if word not in short]
    flagged = [w for word in short for w in ("-r" if word.startswith("__") else "-p", word)]
    return [*others, *(["--ros-args", *flagged, "--"] if flagged else []), *words[end:]]


def asks_for_help(words: Sequence[str]) -> bool:
    """Whether a command line, as `ros_words` makes it, asks for help.

    Raises InputError for words that nobody reads.
    """
    try:
        others = remove_ros_args(args=list(words))
    except RuntimeError as error:
        raise InputError(not_understood(error)) from None
    if any(word in ("-h", "--help") for word in others):
        return True
    if others:
        raise InputError(
            f"'{others[0]}' is not known: parameters are given as NAME:=VALUE (try --help)"
        )
    return False


def not_understood(error: Exception) -> str:
    """One line about arguments that ROS refuses."""
    return f"what follows --ros-args is not understood: {' '.join(str(error).split())}"


def usage(program: str, about: str, specs: Mapping[str, Sequence[Spec]]) -> str:
    """Text of the help: what the program is, and the parameters of its nodes, by node."""
    lines = [
        f"usage: {program} [NAME:=VALUE ...] [__ns:=NAMESPACE] [--ros-args WORD ...]",
        "NAME: a parameter, below. WORD: --params-file FILE, -r TOPIC:=OTHER, and all else of ROS",
        "",
        about.strip(),
    ]
    for node, of_node in specs.items():
        several = (
            f", given as {node}:NAME:=VALUE, or NAME:=VALUE for all nodes" if len(specs) > 1 else ""
        )
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
