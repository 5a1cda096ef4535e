"""docs/api.md against the package: every public name, by the one path that it has."""

import ast
import importlib
import inspect
import pkgutil
import re

import pytest
from subjects import TESTS

import samira_warp

PAGE = (TESTS.parent / "docs" / "api.md").read_text(encoding="utf-8")
PACKAGE = TESTS.parent / "samira_warp"


def documented():
    """Names by room, as the page lists them."""
    rooms = {}
    for heading, body in re.findall(r"^## `(samira_warp[\w.]*)`$(.*?)(?=^## |\Z)", PAGE, flags=re.M | re.S):
        rooms[heading] = re.findall(r"^- `(\w+)`: .*\S", body, flags=re.M)
    return rooms


def not_public():
    """Packages that the page says are not; of those that have a list of their own, the ones within."""
    (section,) = re.findall(r"^## What is not public$(.*?)(?=^## |\Z)", PAGE, flags=re.M | re.S)
    return re.findall(r"`(samira_warp\.[\w.]+)`", section)


def modules():
    """The package's modules by name, and whether each is a package."""
    found = pkgutil.walk_packages(samira_warp.__path__, "samira_warp.")
    return {"samira_warp": True} | {module.name: module.ispkg for module in found}


def is_private(name):
    within = any(name.startswith(f"{private}.") for private in not_public())
    return within or (name in not_public() and name not in ROOMS)


ROOMS = documented()
SYMBOLS = [(room, name) for room, names in ROOMS.items() for name in names]


def test_every_package_is_either_listed_or_said_to_be_private():
    found = modules()
    assert {name for name, is_package in found.items() if is_package and not is_private(name)} <= set(ROOMS)
    assert {*ROOMS, *not_public()} <= set(found)
    assert not any(is_private(room) for room in ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_the_page_says(room):
    """In both directions: nothing is listed that is not there, and nothing is there that is not listed."""
    module = importlib.import_module(room)
    assert ROOMS[room] == list(module.__all__), "the page lists names in the order of __all__"
    assert len(set(module.__all__)) == len(module.__all__)


def test_each_symbol_has_one_path():
    places = {}
    for room, name in SYMBOLS:
        if not name.startswith("__"):
            places.setdefault(name, []).append(room)
    assert {name: rooms for name, rooms in places.items() if len(rooms) > 1} == {}


@pytest.mark.parametrize(("room", "name"), SYMBOLS)
def test_each_symbol_says_what_it_is(room, name):
    symbol = getattr(importlib.import_module(room), name)
    if inspect.isclass(symbol) or inspect.isfunction(symbol):
        written = docstring_in(inspect.getsourcefile(inspect.unwrap(symbol)), symbol.__name__)
    elif name == "__version__":
        return
    else:
        written = docstring_of_constant(room, name)
    assert written, f"{room}.{name} has no docstring"


def docstring_in(path, name):
    """What the source says below a class or a function; what a decorator or a base makes up is none."""
    with open(path, encoding="utf-8") as file:
        body = ast.parse(file.read()).body
    kinds = (ast.ClassDef, ast.FunctionDef)
    (node,) = [node for node in body if isinstance(node, kinds) and node.name == name]
    return ast.get_docstring(node)


def docstring_of_constant(room, name):
    """The string below an assignment, in whichever module of the package the room takes it from."""
    folder = PACKAGE / "/".join(room.split(".")[1:])
    for path in [*PACKAGE.rglob("*.py")] if not folder.is_dir() else sorted(folder.rglob("*.py")):
        with path.open(encoding="utf-8") as file:
            body = ast.parse(file.read()).body
        for node, after in zip(body, [*body[1:], None], strict=True):
            targets = getattr(node, "targets", [getattr(node, "target", None)])
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and any(
                isinstance(target, ast.Name) and target.id == name for target in targets
            ):
                is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                return after.value.value if is_text and isinstance(after.value.value, str) else None
    return None
