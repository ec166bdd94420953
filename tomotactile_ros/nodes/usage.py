"""The command line of a node's program: its short form, `--help`, words that it does not know."""

import difflib
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence

from rclpy.utilities import remove_ros_args

from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.params_files import TYPO

_WIDTH = 100
_OF_ROS = "use_sim_time", "start_type_description_service"
_FAILED = "Failed to parse ROS arguments: "
_SOURCE = re.compile(r", at /\S+:\d+")  # where rcl found it
_SHORT = re.compile(r"[A-Za-z_][\w./:]*:=")


def ros_words(words: Sequence[str]) -> list[str]:
    """A command line without the program's name as ROS reads it.

    `NAME:=VALUE` in front of `--ros-args` is a parameter, `__ns:=/left` and `__node:=other` are
    names: what users of `ros2 launch` are used to.
    """
    own, rest = _parted(words)
    short = [word for word in own if _SHORT.match(word)]
    others = [word for word in own if word not in short]
    flagged = [w for word in short for w in ("-r" if word.startswith("__") else "-p", word)]
    return [*others, *(["--ros-args", *flagged, "--"] if flagged else []), *rest]


def _parted(words: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """Words in front of `--ros-args`, and the others."""
    end = words.index("--ros-args") if "--ros-args" in words else len(words)
    return words[:end], words[end:]


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


def refuse_unknown(words: Sequence[str], program: str, specs: Iterable[Spec]) -> None:
    """InputError for a `NAME:=VALUE` in front of `--ros-args` that is no parameter of any node of a program;
    those of ROS itself are let through, which have a dot or are few."""
    known = {*_OF_ROS, *(spec.name for spec in specs)}
    for word in filter(_SHORT.match, _parted(words)[0]):
        name = word.partition(":=")[0].rpartition(":")[2]
        if name not in known and not name.startswith("__") and "." not in name:
            close = difflib.get_close_matches(name, known, n=1, cutoff=TYPO)
            hint = f", did you mean '{close[0]}'?" if close else ""
            raise InputError(f"'{name}' is no parameter of {program}{hint} (try --help)")


def not_understood(error: Exception) -> str:
    """One line about arguments that ROS refuses."""
    reason = _SOURCE.sub("", " ".join(str(error).split()))
    return f"what follows --ros-args is not understood: {reason.removeprefix(_FAILED)}"


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
