"""Paths and names of 0.1: each is what has another name now, with a warning."""

import importlib
import subprocess
import sys

import pytest
import torch
from subjects import parameters, small_canonical

from samira_warp.head import HeadModel, Rig
from samira_warp.support.moved import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_an_old_path_is_the_module_itself(old):
    sys.modules.pop(f"samira_warp.{old}", None)
    new = importlib.import_module(f"samira_warp.{MOVED[old]}")
    with pytest.warns(DeprecationWarning, match=f"samira_warp.{old} is samira_warp.{MOVED[old]} now"):
        found = importlib.import_module(f"samira_warp.{old}")
    assert found is new
    assert (found.__name__, found.__spec__.name) == (f"samira_warp.{MOVED[old]}",) * 2


def test_what_was_never_there_is_not_there():
    with pytest.raises(ModuleNotFoundError, match="nowhere"):
        importlib.import_module("samira_warp.nowhere")


def test_old_errors_are_caught_by_new_ones():
    script = (
        "from samira_warp.errors import UserError as old; "
        "from samira_warp import UserError; print(old is UserError)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_a_head_model_is_a_rig():
    canonical = small_canonical()
    frame = parameters(0)
    posed = Rig.build(canonical.template).pose(frame, canonical.shape)
    with pytest.warns(DeprecationWarning, match="Rig.pose"):
        found = HeadModel.build(canonical.template).vertices(frame, canonical.shape)
    assert torch.equal(found.vertices, posed.vertices)
    assert torch.equal(frame.rotation, frame.rotations[0])
