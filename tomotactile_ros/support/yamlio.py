"""Strict reading and safe writing of the project's YAML files.

A :class:`Reader` wraps one mapping of a file and knows where it is, so that every complaint names
file and key: ``scene.yaml: contacts[1].radius: 'big' is not a number``. It checks types; what a
value may be is checked by the class that is built from it (see :meth:`Reader.build`).
"""

import difflib
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import MISSING, asdict, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import yaml

from tomotactile_ros.support.checks import show
from tomotactile_ros.support.errors import InputError, complaints_at
from tomotactile_ros.support.files import read_limited, write_atomic

MAX_BYTES = 1_000_000
MAX_VALUES = 100_000  # a second of work; a scan of 65535 rows and 1024 electrodes are 70,000
MAX_DEPTH = 50
MAX_DIGITS = 10_000  # what takes the square of its length: 1:2:3 is a number in YAML 1.1
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_OURS = re.compile(r"^[\"']?format[\"']?\s*:\s*[\"']?tomotactile-", re.MULTILINE)
_REQUIRED: Any = object()
T = TypeVar("T")


class _SlowParser(yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser):
    """The parser in Python, where PyYAML was built without libyaml."""

    def __init__(self, stream):
        yaml.reader.Reader.__init__(self, stream)
        yaml.scanner.Scanner.__init__(self)
        yaml.parser.Parser.__init__(self)


_Parser: Any = _SlowParser
if yaml.__with_libyaml__:
    _Parser = yaml.cyaml.CParser  # type: ignore[attr-defined] # the stubs leave it out


class _Loader(
    yaml.composer.Composer, _Parser, yaml.constructor.SafeConstructor, yaml.resolver.Resolver
):
    """Safe YAML without what only hides mistakes or bombs: repeated keys, aliases, depth."""

    def __init__(self, stream):
        _Parser.__init__(self, stream)
        yaml.composer.Composer.__init__(self)
        yaml.constructor.SafeConstructor.__init__(self)
        yaml.resolver.Resolver.__init__(self)
        self._values = self._depth = 0

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            self._refuse("aliases (*name) are not allowed")
        self._values += 1
        self._depth += 1
        if self._values > MAX_VALUES:
            self._refuse(f"more than {MAX_VALUES} values")
        if self._depth > MAX_DEPTH:
            self._refuse("nested too deeply")
        node = super().compose_node(parent, index)
        self._depth -= 1
        scalar = isinstance(node, yaml.ScalarNode)
        if scalar and len(node.value) > MAX_DIGITS and not node.tag.endswith(":str"):
            raise yaml.MarkedYAMLError(
                problem=f"a number of {len(node.value)} characters", problem_mark=node.start_mark
            )
        return node

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else None
            if name in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {show(name)} appears twice", problem_mark=key.start_mark
                )
            if name is not None:
                seen.add(name)
        return super().construct_mapping(node, deep)

    def _refuse(self, problem: str) -> None:
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=self.peek_event().start_mark)


def read_mapping(
    path: str | os.PathLike, most: int = MAX_BYTES, file_format: str | None = None
) -> dict:
    """The mapping at the top of a YAML file of at most `most` bytes; InputError for anything else, which
    tells a file that is no such thing the `file_format` that is wanted, if there is one.

    What stands in a file that is none of this package is not repeated in the complaint: its path
    may have been given by somebody who must not read it.
    """
    path = Path(path)
    wanted = f"; wanted is YAML, the file must say 'format: {file_format}'" if file_format else ""
    try:
        text = read_limited(path, most).decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8{wanted}") from None
    ours = _OURS.search(text) is not None
    try:
        content = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        problem = error.problem or "no reason is given"
        if not ours:
            problem = re.sub(r"'.*'", "'...'", problem) + wanted
        raise InputError(f"{path}: {line}not valid YAML: {problem}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:
        reason = ": " + " ".join(str(error).split()) if ours else ""
        raise InputError(f"{path}: not valid YAML{reason}") from None
    if content is None:
        raise InputError(f"{path}: the file is empty")
    if not isinstance(content, dict):
        raise InputError(f"{path}: is not a mapping of keys to values{'' if ours else wanted}")
    return content


class Reader:
    """One mapping of a YAML file, read key by key.

    Parameters
    ----------
    mapping : the keys and values.
    place : where it is, the start of every error: ``"scene.yaml: "`` or ``"scene.yaml: adc."``.
    """

    def __init__(self, mapping: dict, place: str):
        self.mapping = mapping
        self.place = place

    @classmethod
    def open(
        cls,
        path: str | os.PathLike,
        file_format: str,
        most: int = MAX_BYTES,
        content: dict | None = None,
    ) -> "Reader":
        """Read a file of at most ``most`` bytes whose key ``format`` must be ``file_format``.

        ``content`` is its mapping where it was read already.
        """
        if content is None:
            content = read_mapping(path, most, file_format)
        reader = cls(content, f"{path}: ")
        found = reader.mapping.get("format")
        if found != file_format:
            ours = isinstance(found, str) and found.startswith("tomotactile-")
            is_a, wanted = (
                str(each).partition("/")[0].removeprefix("tomotactile-")
                for each in (found, file_format)
            )
            if ours and is_a != wanted:
                raise InputError(
                    f"{path}: format: {show(found)} is of a {is_a}, the file must say 'format: {file_format}': were "
                    f"a {is_a} and a {wanted} swapped?"
                )
            was = "is missing" if found is None else "is not known here"
            was = f"{show(found)} {was}" if ours else was
            raise InputError(f"{path}: format: {was}, the file must say 'format: {file_format}'")
        return reader

    def __contains__(self, key: str) -> bool:
        return self.mapping.get(key) is not None

    def only(self, *allowed: str) -> None:
        """Refuse every key that is not in ``allowed``."""
        for key in self.mapping:
            if key not in allowed:
                close = difflib.get_close_matches(str(key), allowed, n=1)
                hint = f"did you mean '{close[0]}'? " if close else ""
                raise InputError(
                    f"{self.place}{show(key).strip(chr(39))}: unknown key; {hint}"
                    f"allowed are {', '.join(allowed)}"
                )

    def the_one_of(self, *kinds: str, beside: Sequence[str] = ()) -> str:
        """The only one of these keys that is there; others may stand ``beside`` it."""
        self.only(*kinds, *beside)
        found = [kind for kind in kinds if kind in self]
        if len(found) != 1:
            raise InputError(
                f"{self.place[:-1]}: exactly one of {', '.join(kinds)} is needed; found "
                f"{' and '.join(found) or 'none'}"
            )
        return found[0]

    def number(self, key: str, default: float | None = _REQUIRED, infinite: bool = False) -> Any:
        """A finite number (or, if ``infinite``, also an infinite one), or the default."""
        value = self._value(key, default)
        return value if value is default else self._number(value, key, infinite)

    def integer(self, key: str, default: int | None = _REQUIRED) -> Any:
        """A whole number, or the default."""
        value = self._value(key, default)
        return value if value is default else self._integer(value, key)

    def flag(self, key: str) -> bool:
        """true or false; false if the key is not there."""
        value = self._value(key, False)
        if not isinstance(value, bool):
            self.refuse(key, value, "is neither true nor false")
        return value

    def text(self, key: str, default: Any = _REQUIRED) -> str:
        """A text that is not blank."""
        value = self._value(key, default)
        if value is not default and not (isinstance(value, str) and value.strip()):
            self.refuse(key, value, "is not a text")
        return value

    def choice(self, key: str, options: Sequence[str]) -> str:
        """One of a few words."""
        value = self._value(key, _REQUIRED)
        if value not in options:
            self.refuse(key, value, f"is none of {', '.join(options)}")
        return value

    def numbers(self, key: str, length: int, default: Any = _REQUIRED) -> tuple[float, ...]:
        """A list of ``length`` finite numbers."""
        value = self._value(key, default)
        return value if value is default else self._numbers(value, key, length)

    def integers(self, key: str, default: Any = _REQUIRED) -> tuple[int, ...]:
        """A list of whole numbers of any length."""
        value = self._value(key, default)
        if value is default:
            return value
        return tuple(self._integer(v, f"{key}[{i}]") for i, v in enumerate(self._list(key, value)))

    def points(self, key: str) -> np.ndarray:
        """A list of points [x, y]: ``(N, 2)`` float64."""
        value = self._list(key, self._value(key, _REQUIRED), " of points [x, y], m")
        rows = [self._numbers(point, f"{key}[{i}]", 2) for i, point in enumerate(value)]
        return np.array(rows, dtype=np.float64).reshape(-1, 2)

    def grid(self, key: str, length: int) -> np.ndarray:
        """A list of equally long lists of points: (R, C, length) float64."""
        rows = [
            [self._numbers(point, f"{key}[{i}][{j}]", length) for j, point in enumerate(row)]
            for i, row in enumerate(
                self._list(f"{key}[{k}]", row)
                for k, row in enumerate(self._list(key, self._value(key, _REQUIRED)))
            )
        ]
        for i, row in enumerate(rows):
            if len(row) != len(rows[0]):
                self.refuse(f"{key}[{i}]", len(row), f"points, {key}[0] has {len(rows[0])}")
        return np.array(rows, dtype=np.float64).reshape(len(rows), -1, length)

    def items(self, key: str, default: Any = _REQUIRED) -> list:
        """A list of anything."""
        value = self._value(key, default)
        return value if value is default else self._list(key, value)

    def entries(self, key: str) -> list[tuple[str, "Reader"]]:
        """The list under a key, if any: each entry's name, and a reader that knows it by that."""
        named = [(f"{key}[{i}]", value) for i, value in enumerate(self.items(key, []))]
        return [(name, Reader({name: value}, self.place)) for name, value in named]

    def free(self, key: str) -> dict:
        """A mapping of anything; empty if the key is not there."""
        value = self._value(key, {})
        if not isinstance(value, dict):
            self.refuse(key, value, "is not a mapping of keys to values")
        return value

    def section(self, key: str, like: str = "") -> "Reader":
        """The mapping under a key; `like` : one that is right, for who wrote something else."""
        return self._reader(self._value(key, _REQUIRED), key, like)

    def sections(self, key: str) -> list["Reader"]:
        """The mappings in the list under a key; none if the key is not there."""
        return [self._reader(v, f"{key}[{i}]") for i, v in enumerate(self.items(key, []))]

    def read(self, kind: type[T], *beside: str) -> T:
        """A dataclass whose fields are keys of this mapping; other keys may stand ``beside``."""
        self.only(*beside, *keys_of(kind))
        return self.build(kind, **self.values(kind))

    def values(self, kind: type, *left_out: str) -> dict[str, Any]:
        """The fields of a dataclass, but for some, read as their types say.

        They are numbers, flags, texts, lists of numbers, points, dataclasses and lists of these, or
        one of two, the first of which is a list. What is not there keeps its default.
        """
        hints = get_type_hints(kind)
        needed = {f.name for f in fields(kind) if f.default is f.default_factory is MISSING}
        wanted = (key for key in keys_of(kind, *left_out) if key in self or key in needed)
        return {key: self._field(key, hints[key]) for key in wanted}

    def _field(self, key: str, hint: Any) -> Any:
        kind, *other = [hint]
        if get_origin(hint) is UnionType:
            kind, *other = (each for each in get_args(hint) if each is not NoneType)
        if other and not isinstance(value := self.mapping[key], list):
            (kind,) = other
            if _has_fields(kind) and not isinstance(value, dict):
                names = ", ".join(keys_of(kind))
                self.refuse(key, value, f"is neither a list of numbers nor {{{names}}}")
        words: dict[Any, Callable[[str], Any]] = {
            float: self.number, int: self.integer, bool: self.flag, str: self.text
        }  # fmt: skip
        if kind in words:
            return words[kind](key)
        if _has_fields(kind):
            return self.section(key).read(kind)
        if kind == tuple[float, float]:
            return self.numbers(key, 2)
        inner, *_ = get_args(kind)
        if _has_fields(inner):
            return tuple(section.read(inner) for section in self.sections(key))
        if inner is float:
            values = self.items(key, [])
            return self._numbers(values, key, len(values))
        return self.integers(key) if inner is int else tuple(map(tuple, self.points(key).tolist()))

    def build(self, make: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """``make(...)``, with this mapping's place put before the complaint of a failure."""
        with complaints_at(self.place):
            return make(*args, **kwargs)

    def refuse(self, key: str, value: object, reason: str) -> NoReturn:
        """Raise the InputError for a value."""
        raise InputError(f"{self.place}{key}: {show(value)} {reason}")

    def _value(self, key: str, default: Any) -> Any:
        value = self.mapping.get(key)
        if value is not None:
            return value
        if default is _REQUIRED:
            raise InputError(f"{self.place}{key}: is missing")
        return default

    def _number(self, value: Any, key: str, infinite: bool = False) -> float:
        is_text = isinstance(value, str) and _NUMBER.fullmatch(value)  # YAML 1.1 on 1e-3
        if not (is_text or isinstance(value, (int, float))) or isinstance(value, bool):
            self.refuse(key, value, "is not a number")
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
        if math.isnan(result) or (math.isinf(result) and not infinite):
            self.refuse(key, value, "is not a finite number")
        return result

    def _integer(self, value: object, key: str) -> int:
        if not isinstance(value, int) or isinstance(value, bool):
            self.refuse(key, value, "is not a whole number")
        return value

    def _list(self, key: str, value: object, of: str = "") -> list:
        if not isinstance(value, list):
            self.refuse(key, value, f"is not a list{of}")
        return value

    def _numbers(self, value: object, key: str, length: int) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != length:
            self.refuse(key, value, f"is not a list of {length} numbers")
        return tuple(self._number(v, f"{key}[{i}]") for i, v in enumerate(value))

    def _reader(self, value: object, key: str, like: str = "") -> "Reader":
        if not isinstance(value, dict):
            such = f", such as {like}" if like else ""
            self.refuse(key, value, f"is not a mapping of keys to values{such}")
        return Reader(value, f"{self.place}{key}.")


def _has_fields(kind: Any) -> bool:
    return is_dataclass(kind)


def keys_of(kind: type, *left_out: str) -> list[str]:
    """The fields with which a dataclass is made, but for some."""
    return [each.name for each in fields(kind) if each.init and each.name not in left_out]


def mapping_of(value: Any) -> dict[str, Any]:
    """What `Reader.read` makes this dataclass of: its fields, those that are None left out."""
    return asdict(value, dict_factory=lambda items: {k: v for k, v in items if v is not None})


def plain(value: Any) -> Any:
    """The same value in plain Python types (numpy arrays as lists, tuples as lists)."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value


class _Dumper(yaml.SafeDumper):
    """Writes every value in full where it is used (aliases are not read back)."""

    def ignore_aliases(self, data):
        return True


def write_mapping(path: str | os.PathLike, content: dict) -> None:
    """Write a mapping as YAML, whole or not at all: a reader never sees half a file."""
    try:
        text = yaml.dump(
            plain(content),
            Dumper=_Dumper,
            default_flow_style=None,
            sort_keys=False,
            allow_unicode=True,
            width=100,
        )
    except yaml.YAMLError as error:
        raise InputError(f"{path}: cannot be written as YAML: {error.args[0]}") from None
    write_atomic(path, text.encode())
