import functools
import importlib.util
import json
import shutil
import sys

import pytest
from subjects import TESTS
from test_relight_table import with_truth

from samira_warp.light import Environment

TOOLS = TESTS.parent / "tools"


@pytest.fixture
def compare(monkeypatch):
    """The tool, with environment maps as cubes of 16 texels: the default's 256 take seconds to filter."""
    monkeypatch.syspath_prepend(str(TOOLS))
    spec = importlib.util.spec_from_file_location("compare_light", TOOLS / "compare_light.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["compare_light"] = module
    spec.loader.exec_module(module)
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=16))

    def run(*arguments):
        options = [*map(str, arguments), "--steps", "2", "--resolution", "32", "--json"]
        return module.run(module.main, module.CompareConfig, program="compare_light", arguments=options)

    return run


def test_a_row_for_each_variant(tiny_run, tiny_dataset, compare, tmp_path, capsys):
    data = with_truth(tiny_dataset, tmp_path / "data")
    capsys.readouterr()
    assert compare("--avatar", tiny_run, "--data", data, "--only", "as trained", "tied light") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["variant"] for row in rows] == ["as trained", "tied light"]
    assert [row["settings"]["tied"] for row in rows] == [False, True]
    for row in rows:
        assert row["mean relit"] == row["even"] > 0


def test_the_dataset_is_divided_as_for_training(tiny_run, tiny_dataset, compare, tmp_path, capsys):
    """The avatar's record says so: with its last frame but one among those that train, a frame would be
    fitted that was never seen."""
    data = with_truth(tiny_dataset, tmp_path / "data")
    run = shutil.copytree(tiny_run, tmp_path / "run")
    description = run / "avatar" / "avatar.json"
    content = json.loads(description.read_text())
    content["record"]["split"] = "last:1"
    description.write_text(json.dumps(content))
    assert compare("--avatar", run, "--data", data, "--only", "as trained") == 2
    assert "00004_00, new to it" in capsys.readouterr().err


def test_an_unknown_variant_is_refused_before_anything_else(compare, tmp_path, capsys):
    assert (
        compare(
            "--avatar", tmp_path / "none", "--data", tmp_path / "none", "--only", "as trained", "tidy light"
        )
        == 2
    )
    error = capsys.readouterr().err
    assert "--only: expected some of as trained, tied light" in error
    assert error.endswith("found tidy light\n")
