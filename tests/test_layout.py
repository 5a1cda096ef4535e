"""Which rooms know which: the imports of every module against CONTRIBUTING.md's table."""

import ast
import re

import pytest
from subjects import TESTS

PACKAGE = TESTS.parent / "samira_warp"
TABLE = (TESTS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")


def rows():
    """Rooms by row, top to bottom."""
    (table,) = re.findall(r"^\| rooms \|.*\n\|[-|]+\n((?:\|.*\n)+)", TABLE, flags=re.MULTILINE)
    firsts = (line.split("|")[1] for line in table.splitlines())
    return [re.findall(r"`(\w+)(?:/|\.py)`", first) for first in firsts]


LEVEL = {room: number for number, row in enumerate(rows()) for room in row}


def imported_by(path):
    """Names of the modules that a file imports anywhere, functions and type checkers' branches included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            if node.module == "samira_warp":
                yield from (f"samira_warp.{alias.name}" for alias in node.names)
            else:
                yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_the_table_has_every_room():
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    modules = {path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    assert set(LEVEL) == packages | modules


@pytest.mark.parametrize("room", LEVEL)
def test_imports_point_down(room):
    files = [path for path in PACKAGE.rglob("*.py") if room_of(path) == room]
    assert files
    for path in files:
        for module in imported_by(path):
            package, _, rest = module.partition(".")
            assert package != "samira_subject", f"{path} imports the built-in person"
            if package == "samira_warp" and rest.split(".")[0] in LEVEL:
                known = rest.split(".")[0]
                assert known == room or LEVEL[known] > LEVEL[room], f"{path} imports {module}"
