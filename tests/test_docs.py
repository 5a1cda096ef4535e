"""The documentation against the repository: what it links to, names and tells one to type is there."""

import dataclasses
import importlib
import importlib.util
import re
import sys
import typing

import pytest
from subjects import TESTS

ROOT = TESTS.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
VERBS = (
    *("check", "prepare", "train", "render", "view", "export", "evaluate", "fleet", "ablate", "compare"),
    "bench",
)

COMMAND = re.compile(r"(?:samira-warp |python -m samira_warp\.)(?P<verb>\w+)(?P<rest>[^`\n]*)")
TOOL = re.compile(r"python (?P<path>(?:tools|examples)/\w+\.py)(?P<rest>[^`\n]*)")
PATH = re.compile(r"`([\w./]+/[\w./]*\w\.(?:py|md)|[\w/]+/)`")


def page_ids(path):
    return path.relative_to(ROOT).as_posix()


def text_of(page):
    return page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=page_ids)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", text_of(page))
    local = [target for target in targets if not target.startswith(("http://", "https://"))]
    missing = [target for target in local if not (page.parent / target.split("#")[0]).exists()]
    assert missing == []


def test_every_page_is_in_the_index():
    index = text_of(ROOT / "docs" / "README.md")
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages <= set(re.findall(r"\]\(([\w.]+\.md)\)", index))


@pytest.mark.parametrize("page", PAGES, ids=page_ids)
def test_files_of_the_repository_that_are_named_are_there(page):
    """Paths from the repository's root or the package's; a user's folders begin with none of its rooms."""
    rooms = {path.name for base in (ROOT, ROOT / "samira_warp") for path in base.iterdir() if path.is_dir()}
    rooms -= {"runs", "build", "dist"}
    named = [path for path in PATH.findall(text_of(page)) if path.split("/")[0] in rooms]
    missing = [
        path for path in named if not any((base / path).exists() for base in (ROOT, ROOT / "samira_warp"))
    ]
    if page.name == "CHANGELOG.md":  # it names what is no longer there, too
        missing = [path for path in missing if not path.startswith("tools/")]
    assert missing == []


def options_of(config_type):
    """The options of a dataclass as its command line has them."""
    hints = typing.get_type_hints(config_type)
    options = set()
    for field in dataclasses.fields(config_type):
        name = field.name.replace("_", "-")
        options |= {f"--{name}"} | ({f"--no-{name}"} if hints[field.name] is bool else set())
    return options


def config_of(module):
    """The one dataclass of options that a module of a command defines."""
    (found,) = (
        value
        for name, value in vars(module).items()
        if dataclasses.is_dataclass(value) and isinstance(value, type)
        if name.endswith(("Config", "Options")) and value.__module__ == module.__name__
    )
    return found


def verb_options(verb):
    for place in ("config", "__main__"):
        name = f"samira_warp.{verb}.{place}"
        if importlib.util.find_spec(name) is not None:
            return options_of(config_of(importlib.import_module(name)))
    raise AssertionError(verb)


def tool_options(path):
    name = f"documented_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return options_of(config_of(module))


def typed_options(rest):
    return set(re.findall(r"(?<![\w-])--[a-z][\w-]*", rest.split("#")[0])) - {"--help"}


@pytest.mark.parametrize("page", PAGES, ids=page_ids)
def test_commands_have_the_options_that_they_are_shown_with(page, monkeypatch):
    """Commands may be broken over lines within a pair of backticks."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    text = re.sub(r"`[^`]*`", lambda code: code[0].replace("\n", " "), text_of(page))
    for command in COMMAND.finditer(text):
        verb, typed = command["verb"], typed_options(command["rest"])
        if verb in VERBS:
            assert typed <= verb_options(verb), command[0]
        else:
            assert verb == "VERB", command[0]
    for command in TOOL.finditer(text):
        assert typed_options(command["rest"]) <= tool_options(ROOT / command["path"]), command[0]
