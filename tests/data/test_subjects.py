"""Made subjects: found by name, and loaded by nobody who has data of their own."""

import ast
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from subjects import TESTS, train_arguments
from warm_start import warm_python

import samira_subject
import samira_warp
from samira_subject import cache
from samira_warp import UserError
from samira_warp.data.subjects import GROUP, made_subject

PACKAGE = Path(samira_warp.__file__).parent
SIBLING = Path(samira_subject.__file__).parent


def run_python(code, *, path=(), python=(sys.executable,)):
    done = subprocess.run(
        [*python, "-c", f"import sys\nsys.path[:0] = {[*map(str, path)]}\n{textwrap.dedent(code)}"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_built_in_one_is_the_default():
    assert made_subject() == made_subject("built_in") == cache.BUILT_IN
    assert made_subject().folder() == cache.subject_folder()


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(UserError, match="subject: expected one of built_in, found 'nobody'"):
        made_subject("nobody")


def test_another_package_adds_its_own_by_an_entry_point(tmp_path):
    """A package that is installed, as pip leaves it; it is imported when its subject is asked for."""
    (tmp_path / "other_people.py").write_text(
        "from pathlib import Path\n"
        "from samira_warp.data.subjects import MadeSubject\n"
        "ADA = MadeSubject(lambda: Path('ada'), lambda: Path('made'), lambda: None)\n"
    )
    facts = tmp_path / "other_people-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: other-people\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(
        f"[{GROUP}]\nada = other_people:ADA\nbuilt_in = other_people:ADA\nzoe = other_people:ZOE\n"
    )
    said = run_python(
        """
        from samira_warp.data.subjects import made_subject
        from samira_warp import UserError
        try:
            made_subject("nobody")
        except UserError as mistake:
            print(mistake.expected)
        assert "other_people" not in sys.modules
        print(made_subject("ada").folder(), made_subject("ada").dataset())
        assert made_subject().folder().name.startswith("subject-"), "whose name is taken is not replaced"
        """,
        path=[tmp_path],
        python=warm_python(),
    )
    assert said.splitlines() == ["one of ada, built_in, zoe", "ada made"]


def test_the_package_names_the_built_in_one_once():
    users = [path for path in PACKAGE.rglob("*.py") if "samira_subject" in path.read_text("utf-8")]
    assert users == [PACKAGE / "data" / "subjects.py"]


def test_neither_training_on_data_nor_any_module_loads_the_built_in_one(tiny_dataset, tmp_path):
    """Nor what it is triangulated by: whoever asked for that would not find it."""
    arguments = train_arguments(tiny_dataset, tmp_path / "run", "--max-steps", "2")
    run_python(
        f"""
        import importlib, pkgutil
        import samira_warp
        import scipy.spatial
        del scipy.spatial.Delaunay
        from subjects import train_command
        assert train_command(*{arguments}) == 0
        assert not [name for name in sys.modules if name.partition(".")[0] == "samira_subject"]
        for module in pkgutil.walk_packages(samira_warp.__path__, "samira_warp."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
        assert not [name for name in sys.modules if name.partition(".")[0] == "samira_subject"]
        """,
        path=[TESTS],
    )
    assert (tmp_path / "run" / "avatar").is_dir()


def test_the_built_in_one_uses_what_is_public():
    """Of the package it imports names without an underscore, from modules without one."""
    imported = [
        (path.name, node.module, alias.name)
        for path in SIBLING.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] == "samira_warp"
        for alias in node.names
    ]
    assert len(imported) > 20
    private = [(*who, name) for *who, name in imported if "._" in f"{who[1]}.{name}"]
    assert private == []
