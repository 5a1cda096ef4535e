"""What importing the stage brings in: no verb, and where only names are wanted, no torch."""

import subprocess
import sys
from pathlib import Path

import pytest

import samira_warp.stage

VERBS = ("bench", "check", "evaluate", "export", "prepare", "render", "train")


def imported_with(module):
    """Every module that a fresh interpreter holds after importing one."""
    code = f"import sys, {module}; print('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_stage_stands_below_the_verbs():
    modules = [path.stem for path in Path(samira_warp.stage.__file__).parent.glob("[a-z]*.py")]
    assert {"background", "layers", "lights", "scene", "turntable"} <= set(modules)
    imported = imported_with(", ".join(f"samira_warp.stage.{module}" for module in modules))
    assert "samira_warp.avatar" in imported
    assert not {f"samira_warp.{verb}" for verb in VERBS} & imported


@pytest.mark.parametrize("module", ["stage.layer_names", "stage.frames", "support.exposure"])
def test_options_are_typed_without_torch(module):
    imported = imported_with(f"samira_warp.{module}")
    assert f"samira_warp.{module}" in imported
    assert "torch" not in imported
