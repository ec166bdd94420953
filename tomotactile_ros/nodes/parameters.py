"""Typed parameters: declared with type, range and description, refused with a reason.

A whole number where a decimal one is meant (``rate: 50`` in YAML) is taken as such: these
parameters are declared with dynamic typing and converted here. Everything else keeps its type.
"""

import difflib
import math
import reprlib
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tomotactile_ros.support.checks import show
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.params_files import TYPO

OFF = "off"  # among choices; YAML takes it for false where it has no quotes
ALLOW_PATH_CHANGES = "allow_path_changes"
# by all nodes of this process: what a command line gives without a node's name is given to each of them
_DECLARED: set[str] = set()
_KINDS = {bool: "true or false", int: "a whole number", str: "text"}
_ITEMS = {
    int: ("whole numbers", Parameter.Type.INTEGER_ARRAY),
    float: ("numbers", Parameter.Type.DOUBLE_ARRAY),
    str: ("texts", Parameter.Type.STRING_ARRAY),
}


@dataclass(frozen=True)
class Spec:
    """One parameter.

    Parameters
    ----------
    name : as in the YAML file.
    default : its type is the parameter's type; a tuple stands for an array of `items`.
    description : one line, with the unit.
    low, high : range of a number, ends included.
    choices : the words allowed for a text.
    read_only : cannot be changed while the node runs.
    frame : names a frame of tf2; empty only where the default is.
    items : `int`, `float` or `str`, what an array holds; whole numbers are taken for decimal ones.
    path : names a file or a port; cannot be changed while the node runs either, unless it was
        started with `allow_path_changes`: whoever may set parameters could else let the node open
        what he must not open himself.
    """

    name: str
    default: bool | int | float | str | tuple[int, ...] | tuple[float, ...] | tuple[str, ...]
    description: str
    low: float | None = None
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False
    path: bool = False
    frame: bool = False
    items: type = int

    def descriptor(self) -> ParameterDescriptor:
        """What `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.read_only,
            dynamic_typing=isinstance(self.default, (float, tuple)) or OFF in self.choices,
        )
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(self.choices)
        if self.path:
            descriptor.additional_constraints = "fixed at the start without allow_path_changes"
        if self.low is not None and isinstance(self.default, tuple):
            descriptor.additional_constraints = f"each from {self.low:g} to {self.high:g}"
        elif self.low is not None and isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
            ]
        elif self.low is not None and isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high))
            ]
        return descriptor

    def convert(self, value: Any) -> Any:
        """The value in the type of the default; InputError if it is not allowed."""
        if isinstance(self.default, tuple):
            return self._convert_array(value)
        if isinstance(self.default, float):
            return self._convert_number(value)
        if value is False and OFF in self.choices:
            return OFF
        if self.choices and value not in self.choices:
            raise InputError(
                f"{self.name}: {reprlib.repr(value)} is none of {', '.join(self.choices)}"
            )
        if self.frame and (value.startswith("/") or bool(self.default) and not value):
            raise InputError(
                f"{self.name}: {reprlib.repr(value)} is no frame of tf2, which is not empty and does "
                f"not begin with /; {value.lstrip('/') or self.default} would be one"
            )
        return value

    def _convert_number(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"{self.name}: {reprlib.repr(value)} is not a number")
        self.check_range(value)
        return float(value)

    def _convert_array(self, value: Any) -> tuple[int, ...] | tuple[float, ...] | tuple[str, ...]:
        kinds = (int, float) if self.items is float else (self.items,)
        if not isinstance(value, (list, array)) or any(type(v) not in kinds for v in value):
            kind = _ITEMS[self.items][0]
            raise InputError(f"{self.name}: {reprlib.repr(value)} is not a list of {kind}")
        for v in value:
            self.check_range(v)
        return tuple(map(self.items, value))

    def check_range(self, value: float) -> None:
        """InputError for a number that is not allowed."""
        if self.low is not None and not self.low <= value <= self.high:
            raise InputError(
                f"{self.name}: {value:.10g} is out of range, {self.low:.10g} to {self.high:.10g} is allowed"
            )


HARDWARE_ID = Spec(
    "hardware_id", "", "Name of the sensor in diagnostics; empty: frame_id", read_only=True
)
PATH_CHANGES = Spec(
    ALLOW_PATH_CHANGES, False, "Paths and ports can be changed while the node runs", read_only=True
)


class Parameters:
    """The parameters of a node, always valid.

    Parameters
    ----------
    node : declares them.
    specs : what to declare.
    on_change : called with the names that change and all values as they would be, before they
        count; it puts them into effect, or raises InputError, and nothing has changed. Without it
        all are read-only.
    """

    def __init__(
        self,
        node: Node,
        specs: Sequence[Spec],
        on_change: Callable[[set[str], dict[str, Any]], None] = lambda changed, values: None,
    ):
        self._node = node
        self._specs = {spec.name: spec for spec in specs}
        self._on_change = on_change
        self.values: dict[str, Any] = {spec.name: self._declare(spec) for spec in specs}
        node.add_on_set_parameters_callback(self._on_set)

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    @property
    def given(self) -> dict[str, Parameter]:
        """What was given at the start, by names."""
        # rclpy offers no public look at it
        return getattr(self._node, "_parameter_overrides", {})

    def warn_of_typos(self) -> None:
        """Log every given parameter that nobody declared and that looks like one of these."""
        for name in self.given:
            close = difflib.get_close_matches(name, self._specs, n=1, cutoff=TYPO)
            if close and not self._node.has_parameter(name) and name not in _DECLARED:
                self._node.get_logger().warning(
                    f"parameter '{name}' is unknown and ignored; did you mean '{close[0]}'?"
                )

    def _declare(self, spec: Spec) -> Any:
        _DECLARED.add(spec.name)
        default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        try:
            parameter = self._node.declare_parameter(spec.name, default, spec.descriptor())
        except ParameterException as error:
            reason = str(error).removesuffix(f": {spec.name}")
            raise InputError(
                f"parameter {self._refusal(spec) or f'{spec.name}: {reason}'}"
            ) from None
        try:
            value = spec.convert(default if parameter.value is None else parameter.value)
        except InputError as error:
            raise InputError(f"parameter {error}") from None
        if value == ():  # in YAML it sets nothing, and rclpy takes it for one of bytes
            self._node.set_parameters([Parameter(spec.name, _ITEMS[spec.items][1], [])])
        if value == OFF and parameter.value is False:
            self._node.set_parameters([Parameter(spec.name, Parameter.Type.STRING, OFF)])
        return value

    def _refusal(self, spec: Spec) -> str:
        """Why the value that was given is refused, in other words than those of rclpy; empty: not known."""
        given = self.given.get(spec.name)
        if given is None:
            return ""
        kind = type(spec.default)
        if kind in _KINDS and type(given.value) is not kind:
            return f"{spec.name}: {reprlib.repr(given.value)} is not {_KINDS[kind]}"
        try:
            spec.convert(given.value)
            if kind is int:
                spec.check_range(given.value)
        except InputError as error:
            return str(error)
        return ""

    def _check_paths(self, changed: set[str]) -> None:
        fixed = sorted(name for name in changed if self._specs[name].path)
        if fixed and not self.values[ALLOW_PATH_CHANGES]:
            raise InputError(
                f"{fixed[0]}: is read-only while the node runs, as every path is unless it was "
                f"started with {ALLOW_PATH_CHANGES}:=true"
            )

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        mine = [p for p in parameters if p.name in self._specs]
        try:
            given = {p.name: self._specs[p.name].convert(p.value) for p in mine}
            changed = {name for name, value in given.items() if value != self.values[name]}
            self._check_paths(changed)
            values = {**self.values, **given}
            if changed:
                self._on_change(changed, values)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.values = values
        for name in sorted(changed):
            self._node.get_logger().info(f"{name} is now {show(values[name], 200)}")
        return SetParametersResult(successful=True)
