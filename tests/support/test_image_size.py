"""Sizes that are refused before any work on them."""

import dataclasses
from pathlib import Path

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.prepare.config import PrepareConfig
from samira_warp.render.config import RenderConfig
from samira_warp.support.errors import UserError
from samira_warp.support.image_size import GBUFFER_BYTES, LARGEST_SIDE, check_side, check_size
from samira_warp.surface import LIGHT_WIDTH, SURFACE_WIDTH
from samira_warp.train.config import TrainConfig
from samira_warp.train.settings import check_config


def test_the_gbuffer_is_counted_as_it_is():
    assert GBUFFER_BYTES == 4 * (SURFACE_WIDTH + LIGHT_WIDTH + 2)
    with torch.no_grad():
        gbuffer = small_avatar().render(parameters(0), camera(32)).gbuffer
    held = [
        value
        for field in dataclasses.fields(gbuffer)
        if isinstance(value := getattr(gbuffer, field.name), torch.Tensor)
    ]
    assert sum(tensor.numel() * tensor.element_size() for tensor in held) == GBUFFER_BYTES * 32 * 32


def test_the_largest_side_passes_and_the_next_is_refused():
    check_side("--resolution", LARGEST_SIDE)
    check_size("camera", width=LARGEST_SIDE, height=16)
    with pytest.raises(UserError, match=f"--resolution: expected at most {LARGEST_SIDE} pixels"):
        check_side("--resolution", LARGEST_SIDE + 1)
    with pytest.raises(UserError, match=f"camera: .* found 16 x {LARGEST_SIDE + 1}"):
        check_size("camera", width=16, height=LARGEST_SIDE + 1)


@pytest.mark.parametrize(
    ("option", "check"),
    [
        ("--resolution", RenderConfig(Path("run"), Path("out"), resolution=200_000).check),
        ("--resolution", lambda: check_config(TrainConfig(resolution=200_000))),
        ("--size", PrepareConfig(Path("film.mp4"), out=Path("out"), size=200_000).check),
    ],
)
def test_an_option_says_what_was_asked_what_it_takes_and_how_far_one_may_go(option, check):
    with pytest.raises(UserError) as caught:
        check()
    # 200,000^2 pixels of 68 bytes
    assert str(caught.value) == (
        f"{option}: expected at most {LARGEST_SIDE} pixels along the longer side, "
        "found 200000, whose G-buffer alone is 2,533 GiB"
    )


def test_a_camera_is_refused_before_anything_is_projected():
    with pytest.raises(UserError, match=r"camera: expected at most 8192 pixels .* found 200000 x 100000"):
        small_avatar().render(parameters(0), camera(200_000, height=100_000))
