"""Says which parameter files of the command line look meant for a node, and are not."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from rclpy.node import Node

from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.params_files import meant_for, read_sections


def files_of(words: Sequence[str]) -> list[str]:
    """The parameter files that a command line names; InputError for one that is not there."""
    files = [file for word, file in pairwise(words) if word == "--params-file"]
    for file in files:
        if not Path(file).is_file():
            raise InputError(f"--params-file: {file}: no such file")
    return files


def warn_of_keys(node: Node, files: Sequence[str]) -> None:
    """Log the files none of whose keys fits a node, though some have a name like its own."""
    name = node.get_fully_qualified_name()
    for file in files:
        try:
            meant = meant_for([key for key, _ in read_sections(file)], name)
        except InputError:  # ROS has read it, and knows more of YAML
            continue
        if meant:
            node.get_logger().warning(
                f"{file} is ignored: it is for {', '.join(meant)}, this node is {name}"
            )
