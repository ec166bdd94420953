"""Each number that estimation, learning and reconstruction name has its unit and reason beside it."""

import itertools
import re
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "tomotactile_ros"
NUMBER = re.compile(r"^[A-Z_][A-Z0-9_, ]*(: [\w.\[\], ]+)? = \(?-?[\d.]")


def test_every_number_has_a_comment():
    bare = []
    for room in ("estimation", "learning", "reconstruction"):
        for path in sorted((PACKAGE / room).glob("*.py")):
            lines = path.read_text(encoding="utf-8").splitlines()
            bare += [
                f"{room}/{path.name}:{number}: {line}"
                for number, (before, line) in enumerate(itertools.pairwise(lines), 2)
                if NUMBER.match(line) and "  # " not in line and not before.startswith("# ")
            ]
    assert bare == []
