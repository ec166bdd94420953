"""docs/architecture.md: its plan names every room of the package, and imports go down it. Each number that
estimation, learning and reconstruction name has its unit and reason beside it."""

import itertools
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tomotactile_ros"


def plan():
    """{room: line} from the top down, and the modules that are named within rooms."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    drawn = re.search(r"\n\n((?: {4,}\S.*\n)+)", text).group(1)
    rooms, modules, inside = {}, {}, None
    for number, line in enumerate(drawn.splitlines()):
        if not line[:60].strip(" -"):
            continue
        indent, names = re.match(r"( +)((?:[\w/]+, )*[\w/]+)(?: |$)", line + " ").groups()
        names = names.rstrip(",").replace("/", "").split(", ")
        if len(indent) == 4:
            rooms |= {name: number for name in names}
            inside = names[0]
        elif len(indent) == 8:
            modules.setdefault(inside, set()).update(names)
    return rooms, modules


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_every_room_is_in_the_plan_and_every_name_in_the_plan_is_there():
    rooms, modules = plan()
    there = {room_of(path) for path in PACKAGE.rglob("*.py")}
    assert set(rooms) == there
    for room, names in modules.items():
        files = {path.stem for path in (PACKAGE / room).glob("*.py")} - {"__init__"}
        assert names == files, room


def test_rooms_import_only_what_is_below_them():
    rooms, _ = plan()
    for path in PACKAGE.rglob("*.py"):
        here = room_of(path)
        for name in re.findall(r"(?:from|import) tomotactile_ros\.(\w+)", path.read_text()):
            if name in rooms and name != here:
                assert rooms[name] >= rooms[here], f"{path.name} imports {name}"


def test_only_nodes_know_ros():
    ros = re.compile(r"^\s*(?:from|import) (?:rclpy|rosbag2_py|tf2_ros|\w+_msgs)\b", re.MULTILINE)
    outside = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if room_of(path) != "nodes" and ros.search(path.read_text())
    }
    assert outside <= {"devices/bag.py"}


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
