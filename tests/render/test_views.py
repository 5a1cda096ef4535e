"""``render`` from cameras of a user's own, round the head, and without a background."""

import functools
import json
import shutil
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from subjects import render_command

from samira_warp.avatar import Avatar, read_frames
from samira_warp.evaluate.__main__ import EvaluateConfig
from samira_warp.evaluate.__main__ import main as evaluate_main
from samira_warp.io.images import read_image, read_rgba, write_exr
from samira_warp.light import Environment
from samira_warp.stage.viewpoint import HeadPlace, Viewpoint, distance_to
from samira_warp.support.cli import run

FRAME = "00004_00"


def render(avatar, out, *arguments):
    assert render_command("--avatar", avatar, "--out", out, *arguments) == 0
    return out


def picture(folder, name=FRAME, layer="image"):
    return read_image(folder / layer / f"{name}.png", channels=3)


def place_of(avatar, frame):
    return HeadPlace.of(avatar.canonical, avatar.canonical.pose(frame.parameters))


def test_a_camera_about_the_first_frames_head(tiny_run, tmp_path):
    """Every frame before one camera, that of the head's own axes in the first frame."""
    avatar, frames = Avatar.load(tiny_run), read_frames(tiny_run)
    render(tiny_run, tmp_path / "one", "--camera", "-40,20,0.9", "--fov", 15)
    lens = frames[0].camera.with_field_of_view(15.0)
    placed = Viewpoint(-40.0, 20.0, 0.9).camera(place_of(avatar, frames[0]), lens)
    for frame in frames[:2]:
        with torch.no_grad():
            expected = avatar.render(frame.parameters, placed).image.clamp(0, 1).numpy()
        np.testing.assert_allclose(picture(tmp_path / "one", frame.name), expected, atol=0.51 / 255)


def test_distance_and_lens_are_the_training_cameras_where_nothing_is_said(tiny_run, tmp_path):
    avatar, frames = Avatar.load(tiny_run), read_frames(tiny_run)
    usual = distance_to(frames[0].camera, place_of(avatar, frames[0]))
    given = ("--camera", f"25,0,{usual!r}", "--fov", repr(frames[0].camera.field_of_view))
    options = ("--frames", 1, "--resolution", 48)
    left_out = picture(render(tiny_run, tmp_path / "default", *options, "--camera", "25,0"), "00005_00")
    said = picture(render(tiny_run, tmp_path / "given", *options, *given), "00005_00")
    # the frame is another, its head elsewhere: the distance is still the training camera's
    np.testing.assert_allclose(left_out, said, atol=1.01 / 255)
    assert left_out.shape == (48, 48, 3)


def test_a_narrower_view_from_the_frames_own_cameras(tiny_run, tmp_path):
    own = read_frames(tiny_run)[0].camera.field_of_view
    plain = picture(render(tiny_run, tmp_path / "plain", "--frames", 0, "--layers", "alpha"), layer="alpha")
    wide = ("--frames", 0, "--layers", "alpha", "--fov", 2 * own)
    seen = picture(render(tiny_run, tmp_path / "wide", *wide), layer="alpha")
    # half as high and half as wide, but for the tangents of some 20 degrees
    assert 0.15 < seen.mean() / plain.mean() < 0.35


def test_positive_yaw_shows_the_heads_left_side(tiny_run, tmp_path):
    """By the normals that are seen: +x is the left of a head at rest, and the frames are nearly at rest."""
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[0]
    left = place_of(avatar, frame).axes[:, 0].numpy()
    facing = {}
    for yaw in (-60, 0, 60):
        out = render(
            tiny_run,
            tmp_path / str(yaw),
            "--frames",
            0,
            "--camera",
            f"{yaw},0",
            "--layers",
            "normal",
            "alpha",
        )
        inside = picture(out, layer="alpha")[..., 0] > 0.9
        facing[yaw] = float((2 * picture(out, layer="normal")[inside] - 1).mean(axis=0) @ left)
    assert facing[60] > 0.3 > facing[0] > -0.3 > facing[-60]


def test_the_camera_goes_round_a_held_frame_from_where_it_stands(tiny_run, tmp_path, capsys):
    options = ("--frames", 0, "--camera", "30,10,1.1")
    render(tiny_run, tmp_path / "orbit", *options, "--orbit", 0.5, "--fps", 8)
    assert "4 pictures" in capsys.readouterr().err
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "orbit" / "image.mp4"))[0] == 4
    for index in range(4):
        alone = render(tiny_run, tmp_path / str(index), *options[:3], f"{30 + 90 * index},10,1.1")
        np.testing.assert_array_equal(picture(tmp_path / "orbit", f"{FRAME}_{index:04d}"), picture(alone))


def test_camera_and_light_go_round_together(tiny_run, tmp_path):
    options = ("--fps", 8, "--frames", 0)
    render(tiny_run, tmp_path / "both", *options, "--orbit", 0.5, "--turntable", 0.25)
    names = sorted(path.stem for path in (tmp_path / "both" / "image").iterdir())
    assert names == [f"{FRAME}_{index:04d}" for index in range(4)]
    alone = render(tiny_run, tmp_path / "alone", "--frames", 0, "--camera", "90,0", "--rotate", 180)
    np.testing.assert_array_equal(picture(tmp_path / "both", names[1]), picture(alone))


def test_the_camera_goes_round_a_moving_head(tiny_run, tmp_path):
    out = render(tiny_run, tmp_path / "orbit", "--orbit", 1, "--fps", 4)
    assert sorted(path.stem for path in (out / "image").iterdir()) == [FRAME, "00005_00"]
    second = render(tiny_run, tmp_path / "second", "--camera", "90,0")
    np.testing.assert_array_equal(picture(out, "00005_00"), picture(second, "00005_00"))


@pytest.mark.parametrize(
    ("options", "times"),
    [
        (("--resolution", 64), None),
        (("--resolution", 65), "2.0"),
        (("--camera", "0,0", "--resolution", 64), None),
        (("--camera", "0,0,0.3"), "3."),
        (("--fov", 5), "4."),
    ],
)
def test_a_head_much_larger_than_in_training_is_warned_of(tiny_run, tmp_path, capsys, options, times):
    """The run's pictures are 32 pixels, its camera a metre away, its lens 20 degrees."""
    render(tiny_run, tmp_path, "--frames", 0, *options)
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == (times is not None)
    for line in warnings:
        assert f"drawn {times}" in line
        assert "training pictures (32 x 32)" in line


LAID = ("image", "albedo", "normal", "specular", "irradiance")
"""Layers on a background of some kind, and its grey where it is not --background's."""


def test_without_a_background_pictures_have_the_heads_own_colour_and_its_alpha(tiny_run, tmp_path):
    options = ("--frames", 0, "--tone-map", "none", "--layers")
    clear = render(tiny_run, tmp_path / "clear", *options, *LAID, "--background", "transparent")
    laid = render(tiny_run, tmp_path / "laid", *options, *LAID, "alpha", "--background", "0.2,0.5,0.9")
    coverage = picture(laid, layer="alpha")
    assert ((coverage > 0.05) & (coverage < 0.95)).sum() > 50
    for layer, behind in zip(LAID, ((0.2, 0.5, 0.9), 1.0, 0.5, 1.0, 1.0), strict=True):
        color, alpha = read_rgba(clear / layer / f"{FRAME}.png")
        np.testing.assert_array_equal(alpha, coverage[..., 0], err_msg=layer)
        assert (color[alpha == 0] == 0).all()
        # colour, alpha and the picture itself are each rounded to 256 levels; what is clipped is not compared
        found = alpha[..., None] * color + (1 - alpha[..., None]) * np.asarray(behind)
        unclipped = (color < 1).all(axis=2)
        np.testing.assert_allclose(
            found[unclipped], picture(laid, layer=layer)[unclipped], atol=1.6 / 255, err_msg=layer
        )


def test_a_tone_map_holds_for_pictures_without_a_background(tiny_run, tmp_path):
    options = ("--frames", 0, "--tone-map", "filmic")
    clear = render(tiny_run, tmp_path / "clear", *options, "--background", "transparent")
    color, alpha = read_rgba(clear / "image" / f"{FRAME}.png")
    white = picture(render(tiny_run, tmp_path / "white", *options))
    found = alpha[..., None] * color + 1 - alpha[..., None]
    np.testing.assert_allclose(found, white, atol=1.6 / 255)


def scores_of(capsys, folder, data, *more):
    capsys.readouterr()
    arguments = ["--pred", str(folder), "--data", str(data), *map(str, more)]
    assert run(evaluate_main, EvaluateConfig, program="evaluate", arguments=arguments) == 0
    return json.loads(capsys.readouterr().out)


def test_what_has_no_background_is_scored_as_on_its_own(tiny_run, tiny_dataset, tmp_path, capsys):
    """Pictures on white, as the dataset's are, and normals on their grey."""
    layers = ("--layers", "image", "normal")
    clear = render(tiny_run, tmp_path / "clear", *layers, "--background", "transparent")
    laid = render(tiny_run, tmp_path / "laid", *layers)
    found, expected = (scores_of(capsys, out, tiny_dataset)["psnr"] for out in (clear, laid))
    # pixels at the edge are rounded three times instead of once
    assert found == pytest.approx(expected, abs=0.01)
    for normals in (tmp_path / "clear", tmp_path / "laid"):
        truth = ("--layer", "normal", "--truth", laid / "normal")
        scores = scores_of(capsys, normals, tiny_dataset, *truth)
        # a level and a half of a unit normal's 127 is 0.7 degrees, of the shorter ones at the edge more
        assert scores["normal_angle"] < 1.0


def test_an_avatar_that_works_in_image_values_has_no_tone_map(tiny_run, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=32))
    avatar = Avatar.load(tiny_run)
    folder = shutil.copytree(tiny_run / "avatar", tmp_path / "avatar")
    avatar.settings = replace(avatar.settings, color_space="raw")
    avatar.save(folder, record={})
    write_exr(tmp_path / "grey.exr", np.full((8, 16, 3), 0.3, np.float32))
    light = ("--frames", 0, "--env", tmp_path / "grey.exr", "--layers", "image", "alpha")
    capsys.readouterr()
    out = ("--avatar", folder, "--out", tmp_path / "filmic")
    assert render_command(*out, *light, "--tone-map", "filmic") == 2
    assert "--tone-map: expected none for an avatar that shades in image values" in capsys.readouterr().err
    assert not (tmp_path / "filmic").exists()
    # where nothing is said, it is none
    plain = picture(render(folder, tmp_path / "none", *light, "--tone-map", "none"))
    np.testing.assert_array_equal(picture(render(folder, tmp_path / "auto", *light)), plain)
