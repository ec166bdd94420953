"""What a benchmark has measured so far, on disk: stopped, it goes on where it was."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import tomotactile_ros.bench
from tomotactile_ros.bench import machine
from tomotactile_ros.support.files import write_atomic
from tomotactile_ros.support.yamlio import plain


class Store:
    """Parts of a benchmark by their names, kept in the file at `path`.

    Parts of another machine or version of the code are forgotten.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._made_by = {"machine": machine.describe() | {"date": None}, "code": _code()}
        self.parts: dict[str, Any] = self._load()

    def add(self, name: str, found: Any) -> None:
        """Keep a part, on disk too."""
        self.parts[name] = plain(found)
        self.save()

    def save(self) -> None:
        """Write the file; InputError where that is not possible."""
        content = {"made by": self._made_by, "parts": self.parts}
        write_atomic(self.path, json.dumps(content, allow_nan=False).encode())

    def remove(self) -> None:
        """Nothing is left on disk."""
        self.path.unlink(missing_ok=True)

    def _load(self):
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            return content["parts"] if content["made by"] == self._made_by else {}
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return {}


def _code() -> str:
    """Digest of all modules of the package."""
    digest = hashlib.sha256()
    for path in sorted(Path(tomotactile_ros.bench.__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
