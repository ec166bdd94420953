"""docs/robots.md: each thing that users of other drivers expect is proved by a test that exists."""

import ast
import re
from pathlib import Path

HERE = Path(__file__).resolve().parent
TEXT = (HERE.parent / "docs" / "robots.md").read_text(encoding="utf-8")


def functions_of(file):
    tree = ast.parse((HERE / file).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_row_names_a_test_that_exists():
    (table,) = re.findall(r"\| expected by users of \|.*\n\|[-|]+\n((?:\|.*\n)+)", TEXT)
    for row in table.splitlines():
        *cells, proofs = (cell.strip() for cell in row.strip("|").split("|"))
        assert len(cells) == 3 and all(cells), row
        for proof in proofs.split(", "):
            file, name = re.fullmatch(r"`([\w/]+\.py)::(test_\w+)`", proof).groups()
            assert name in functions_of(file), row
