"""``python -m samira_warp.render`` on a trained avatar, and ``evaluate`` on what it wrote."""

import functools
import json
import shutil
from typing import get_args

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from data.tiny import make_tiny_dataset
from subjects import camera, parameters, small_avatar
from subjects import render_command as render

from samira_warp.evaluate.__main__ import EvaluateConfig
from samira_warp.evaluate.__main__ import main as evaluate_main
from samira_warp.io.images import read_image, write_exr, write_png
from samira_warp.light import Environment, decode_srgb, encode_srgb
from samira_warp.stage.frames import parse_frames
from samira_warp.stage.layer_names import Layer
from samira_warp.stage.layers import layer_image
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

WITH_VALUES = {
    "depth": 1,
    "irradiance": 3,
    "specular_light": 3,
    "specular": 1,
    "response_diffuse": 1,
    "response_specular": 1,
    "residual_position": 3,
    "residual_rotation": 3,
    "wrinkles": 3,
}
"""Layers that come as .exr too, and their channels."""


def first(folder, layer="image", name="00004_00"):
    return read_image(folder / layer / f"{name}.png", channels=3)


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """An environment map of one bright quarter, on the right of a camera."""
    radiance = np.full((32, 64, 3), 0.2, np.float32)
    radiance[:, 40:56] = (3.0, 2.0, 1.0)
    path = tmp_path_factory.mktemp("light") / "studio.exr"
    write_exr(path, radiance)
    return path


@pytest.fixture
def small_environments(monkeypatch):
    """Environment maps as cubes of 32 texels: the default's 256 take seconds to filter."""
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=32))


@pytest.fixture(scope="module")
def everything(tiny_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "out"
    assert render("--avatar", tiny_run, "--out", folder, "--layers", *get_args(Layer)) == 0
    return folder


def test_every_layer_is_written_under_the_datasets_names(everything):
    assert {path.name for path in everything.iterdir()} == set(get_args(Layer))
    for layer in get_args(Layer):
        expected = {f"{name}.png" for name in ("00004_00", "00005_00")}
        if layer in WITH_VALUES:
            expected |= {name.replace("png", "exr") for name in expected}
        assert {path.name for path in (everything / layer).iterdir()} == expected, layer


def test_layers_have_the_images_size_and_residuals_the_maps(everything):
    for layer in get_args(Layer):
        assert first(everything, layer).shape == (32, 32, 3), (
            layer
        )  # the small preset's UV maps have the same size
    for layer, channels in WITH_VALUES.items():
        values = read_image(everything / layer / "00004_00.exr", channels=channels)
        assert values.shape == (32, 32, channels)
        assert np.isfinite(values).all()
        assert values.any()


def test_layers_mean_what_they_say(everything):
    alpha = first(everything, "alpha")
    inside = alpha[..., 0] > 0.9
    outside = alpha[..., 0] == 0
    assert inside.sum() > 100
    assert outside.sum() > 100
    for layer in ("image", "albedo", "roughness", "specular"):
        assert (first(everything, layer)[outside] == 1).all(), layer
    depth = read_image(everything / "depth" / "00004_00.exr", channels=1)[..., 0]
    assert ((depth[inside] > 0.85) & (depth[inside] < 1.05)).all()
    normal = 2 * first(everything, "normal")[inside] - 1
    assert (normal[:, 2] > 0).mean() > 0.95
    assert abs(np.linalg.norm(normal, axis=1).mean() - 1) < 0.1
    position = read_image(everything / "residual_position" / "00004_00.exr", channels=3)
    picture = first(everything, "residual_position")
    # the picture's full scale is the limit of 0.02 m, in 256 levels
    np.testing.assert_allclose(picture, 0.5 + 0.5 * position / 0.02, atol=0.51 / 255)


@pytest.mark.parametrize("color_space", ["raw", "srgb"])
def test_albedo_is_encoded_where_shading_is_linear(color_space):
    avatar = small_avatar(color_space=color_space)
    with torch.no_grad():
        rendering = avatar.render(parameters(0), camera(32))
    albedo, alpha = rendering.gbuffer.albedo, rendering.gbuffer.alpha
    shown = albedo if color_space == "raw" else encode_srgb(albedo)
    assert (albedo - encode_srgb(albedo)).abs().max() > 0.1
    assert torch.equal(layer_image(rendering, "albedo").picture, alpha * shown + (1 - alpha))


CONTRACT = """image albedo normal roughness specular alpha depth response_diffuse response_specular irradiance
    specular_light residual_position residual_rotation wrinkles"""

DRAWN = {
    "normal": (0.5, lambda normal: (normal + 1) / 2),
    "roughness": (1.0, lambda roughness: roughness),
    "specular": (1.0, lambda specular: (10 * specular).clamp(max=1)),
    "response_diffuse": (0.5, lambda response: (10 * (response - 0.95)).clamp(0, 1)),
    "response_specular": (0.5, lambda response: (10 * (response - 0.95)).clamp(0, 1)),
}
"""The grey behind a layer of the surface, and its picture."""


def test_layers_are_those_that_are_promised():
    assert set(CONTRACT.split()) <= set(get_args(Layer))


@pytest.mark.parametrize("layer", DRAWN)
def test_channels_of_the_surface_are_drawn_on_their_grey(layer):
    avatar = small_avatar()
    with torch.no_grad():
        avatar.response_logits.normal_(generator=torch.Generator().manual_seed(0))
        rendering = avatar.render(parameters(0), camera(32))
    (grey, picture), alpha = DRAWN[layer], rendering.gbuffer.alpha
    values = getattr(rendering.gbuffer, layer)
    wanted = alpha * picture(values) + (1 - alpha) * grey
    found = layer_image(rendering, layer)
    # ten times the rounding of values about 1
    torch.testing.assert_close(found.picture, wanted, atol=2e-6, rtol=0)
    # a picture that clips comes with what it shows
    assert (found.values is not None) == (layer not in ("normal", "roughness"))
    assert found.values is None or torch.equal(found.values, values)


def test_rendering_agrees_with_the_runs_own_score(everything, tiny_run, tiny_dataset, capsys):
    capsys.readouterr()
    arguments = ["--pred", str(everything), "--data", str(tiny_dataset)]
    assert run(evaluate_main, EvaluateConfig, program="evaluate", arguments=arguments) == 0
    scores = json.loads(capsys.readouterr().out)
    results = json.loads((tiny_run / "results.json").read_text())
    for name in ("psnr", "ssim", "l1", "psnr_foreground"):
        # both are 8-bit renders of the same avatar; the cache keeps the truth in 16 bits
        assert scores[name] == pytest.approx(results[name], rel=1e-3), name


def test_learned_light_is_the_default_and_exposure_one_changes_nothing(everything, tiny_run, tmp_path):
    assert render("--avatar", tiny_run / "avatar", "--out", tmp_path, "--exposure", 1, "--rotate", 0) == 0
    np.testing.assert_array_equal(first(tmp_path), first(everything))


def test_an_environment_relights(everything, tiny_run, tmp_path, light, small_environments):
    assert (
        render(
            "--avatar",
            tiny_run,
            "--out",
            tmp_path,
            "--env",
            light,
            "--layers",
            "image",
            "irradiance",
            "albedo",
        )
        == 0
    )
    assert np.abs(first(tmp_path) - first(everything)).max() > 0.05
    np.testing.assert_array_equal(first(tmp_path, "albedo"), first(everything, "albedo"))
    alpha = first(everything, "alpha")[..., 0]
    irradiance = read_image(tmp_path / "irradiance" / "00004_00.exr", channels=3)
    columns = np.where(alpha > 0.9)[1]
    left, right = (
        irradiance[(alpha > 0.9) & side]
        for side in (np.arange(32) < columns.mean() - 3, np.arange(32) > columns.mean() + 3)
    )
    # the bright quarter is to the camera's right, about +x
    assert right.mean() > 1.3 * left.mean()
    assert right[:, 0].mean() > right[:, 2].mean()


def test_a_whole_turn_is_none_and_half_a_turn_swaps_the_sides(tiny_run, tmp_path, light, small_environments):
    images = {}
    for degrees in (0, 360, 180):
        folder = tmp_path / str(degrees)
        assert (
            render(
                "--avatar",
                tiny_run,
                "--out",
                folder,
                "--env",
                light,
                "--rotate",
                degrees,
                "--layers",
                "irradiance",
            )
            == 0
        )
        images[degrees] = read_image(folder / "irradiance" / "00004_00.exr", channels=3)
    np.testing.assert_allclose(images[360], images[0], atol=1e-5)
    left, right = images[0][:, :14], images[0][:, 18:]
    turned_left, turned_right = images[180][:, :14], images[180][:, 18:]
    assert right.sum() > left.sum()
    assert turned_left.sum() > turned_right.sum()


def test_exposure_two_doubles_the_linear_light(tiny_run, tmp_path, light, small_environments):
    for name, options in {"learned": (), "map": ("--env", light)}.items():
        values = []
        for exposure in (1, 2):
            folder = tmp_path / f"{name}{exposure}"
            arguments = [
                "--tone-map",
                "none",
                "--avatar",
                tiny_run,
                "--out",
                folder,
                "--exposure",
                exposure,
                "--background",
                "black",
                *options,
            ]
            assert render(*arguments, "--layers", "irradiance", "image") == 0
            values.append((read_image(folder / "irradiance" / "00004_00.exr", channels=3), first(folder)))
        (irradiance, image), (irradiance_2, image_2) = values
        np.testing.assert_allclose(irradiance_2, 2 * irradiance, rtol=1e-4, atol=1e-6)
        unclipped = (image_2 < 0.99) & (image > 0.3)
        ratio = decode_srgb(torch.from_numpy(image_2[unclipped])) / decode_srgb(
            torch.from_numpy(image[unclipped])
        )
        # twice the linear value but for the rim, which is composited over black; half a level of 8 bits at
        # 0.3 is 1.6 % linear
        assert abs(float(ratio.median()) - 2) < 0.05


def test_backgrounds(tiny_run, tmp_path, light, everything, small_environments):
    alpha = first(everything, "alpha")
    outside, covered = alpha[..., 0] == 0, alpha[..., 0] > 0.97
    picture = tmp_path / "picture.png"
    write_png(picture, np.tile(np.array([0.2, 0.4, 0.8]), (64, 48, 1)))
    images = {}
    for name in ("white", "black", "env", "0.2,0.4,0.8", "#3366cc", picture):
        folder = tmp_path / "out" / str(getattr(name, "stem", name))
        options = ("--env", light, "--exposure", 1, "--tone-map", "none", "--background", name)
        assert render("--avatar", tiny_run, "--out", folder, *options) == 0
        images[name] = first(folder)
    assert (images["white"][outside] == 1).all()
    assert (images["black"][outside] == 0).all()
    for name in (picture, "0.2,0.4,0.8", "#3366cc"):
        np.testing.assert_allclose(
            images[name][outside], np.tile([51, 102, 204], (outside.sum(), 1)) / 255, atol=1e-6
        )
    # the narrow view straight ahead sees the dim part of the map: 0.2 linear is 0.484 in sRGB
    np.testing.assert_allclose(images["env"][outside], 0.4845, atol=0.01)
    assert all(np.abs(image[covered] - images["white"][covered]).max() < 0.04 for image in images.values())


def test_a_video_holds_every_frame(tiny_run, tmp_path, capsys):
    arguments = [
        "--avatar",
        tiny_run,
        "--out",
        tmp_path,
        "--split",
        "train",
        "--resolution",
        33,
        "--layers",
        "image",
        "alpha",
    ]
    assert render(*arguments, "--video", "--fps", 10) == 0
    for layer in ("image", "alpha"):
        count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / f"{layer}.mp4"))
        assert count == 4
        assert seconds == pytest.approx(0.4, abs=0.05)
        assert len(list((tmp_path / layer).iterdir())) == 4
    assert first(tmp_path, name="00000_00").shape == (33, 33, 3)
    said = capsys.readouterr().err.splitlines()
    assert "note: the film is 32 x 32 and its pictures 33 x 33: H.264 holds even sizes only" in said


def test_what_an_earlier_rendering_left_is_said(tiny_run, tmp_path, capsys):
    arguments = ["--avatar", tiny_run, "--out", tmp_path, "--resolution", 32]

    def notes(*more):
        assert render(*arguments, *more) == 0
        return [line for line in capsys.readouterr().err.splitlines() if line.startswith("note: ")]

    notes("--layers", "image", "alpha", "--video")
    (tmp_path / "image" / "notes.txt").write_text("mine, and no picture")
    kept = f"note: {tmp_path} keeps {{}} of an earlier rendering, such as {{}}"
    # the alphas of two frames and their film, and the film of the images
    assert notes("--layers", "image") == [kept.format("4 files", "alpha/00004_00.png")]
    assert notes("--layers", "image", "alpha", "--video") == []
    assert notes("--layers", "image", "alpha", "--video", "--frames", "1:") == [
        kept.format("2 files", "alpha/00004_00.png")
    ]
    assert notes("--layers", "image", "alpha", "--video", "--frames", "1:") == [
        kept.format("2 files", "alpha/00004_00.png")
    ]
    assert (tmp_path / "image" / "notes.txt").exists()


def test_frames_are_sliced(tiny_run, tmp_path):
    assert (
        render(
            "--avatar",
            tiny_run,
            "--out",
            tmp_path,
            "--split",
            "train",
            "--frames",
            "1::2",
            "--resolution",
            16,
        )
        == 0
    )
    assert sorted(path.stem for path in (tmp_path / "image").iterdir()) == ["00001_00", "00003_00"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "012345"),
        ("1:4", "123"),
        ("::2", "024"),
        ("-2:", "45"),
        ("2", "2"),
        ("-1", "5"),
        ("::-1", "543210"),
        (":", "012345"),
    ],
)
def test_frame_grammar(text, expected):
    assert "012345"[parse_frames(text)] == expected


@pytest.mark.parametrize("text", ["", "a", "1:2:3:4", "1:2:0", "1.5:", "1-2"])
def test_what_is_no_frame_range(text):
    with pytest.raises(UserError, match="--frames"):
        parse_frames(text)


def test_another_sequence_drives_the_avatar(tiny_run, tmp_path, everything):
    """Another person's sequence on the same template: its pose, the avatar's own shape."""
    driver = make_tiny_dataset(tmp_path / "driver", frames=4, size=48)
    for path in [*driver.glob("flame_param/*.npz"), driver / "canonical_flame_param.npz"]:
        with np.load(path) as archive:
            arrays = dict(archive)
        np.savez(path, **{**arrays, "shape": arrays["shape"] + 0.3, "expr": arrays["expr"] * 0})
    assert (
        render(
            "--avatar",
            tiny_run,
            "--out",
            tmp_path / "out",
            "--data",
            driver,
            "--split",
            "0.5",
            "--layers",
            "image",
            "alpha",
        )
        == 0
    )
    assert sorted(path.stem for path in (tmp_path / "out" / "image").iterdir()) == ["00002_00", "00003_00"]
    # rendered at the size that the avatar was trained at, by the driver's camera
    assert first(tmp_path / "out", name="00002_00").shape == (32, 32, 3)
    assert (first(tmp_path / "out", "alpha", "00002_00") > 0.9).sum() > 300


def test_its_own_sequence_by_its_folder_gives_the_same_images(tiny_run, tiny_dataset, tmp_path, everything):
    assert render("--avatar", tiny_run, "--out", tmp_path, "--data", tiny_dataset) == 0
    np.testing.assert_array_equal(first(tmp_path), first(everything))


def refused(capsys, *arguments):
    capsys.readouterr()
    assert render(*arguments) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1, message
    return message[0]


def test_another_template_is_refused(tiny_run, tiny_dataset, tmp_path, capsys):
    driver = shutil.copytree(tiny_dataset, tmp_path / "driver")
    with np.load(driver / "template.npz") as archive:
        arrays = dict(archive)
    np.savez(driver / "template.npz", **{**arrays, "v_template": arrays["v_template"] * 1.01})
    message = refused(capsys, "--avatar", tiny_run, "--out", tmp_path / "out", "--data", driver)
    assert str(driver / "template.npz") in message
    assert not (tmp_path / "out").exists()


@pytest.fixture
def files(tmp_path):
    """Names of files that cannot be used, by what is wrong with them."""
    write_png(tmp_path / "eight.png", np.zeros((8, 16, 3)))
    write_exr(tmp_path / "square.exr", np.zeros((8, 8, 3)))
    write_exr(tmp_path / "nan.exr", np.full((8, 16, 3), np.nan))
    write_exr(tmp_path / "half.exr", np.ones((8, 16, 3)))
    write_exr(tmp_path / "black.exr", np.zeros((8, 16, 3)))
    (tmp_path / "text.hdr").write_text("no radiance")
    (tmp_path / "empty").mkdir()
    (tmp_path / "maps").mkdir()
    (tmp_path / "dark").mkdir()
    write_exr(tmp_path / "dark" / "a.exr", np.ones((8, 16, 3)))
    write_exr(tmp_path / "dark" / "b.exr", np.zeros((8, 16, 3)))
    write_exr(tmp_path / "maps" / "a.exr", np.ones((8, 16, 3)))
    (tmp_path / "maps" / "broken.hdr").write_text("no radiance")
    (tmp_path / "text.png").write_text("no picture")
    return tmp_path


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--env", "missing.hdr"], "missing.hdr"),
        (["--env", "eight.png"], "8-bit"),
        (["--env", "square.exr"], "twice as wide"),
        (["--env", "nan.exr"], "finite"),
        (["--env", "text.hdr"], "text.hdr"),
        (["--background", "text.png"], "text.png"),
        (["--background", "missing.png"], "missing.png"),
        (["--background", "grey"], "grey"),
        (["--background", "255,255,255"], "from 0 to 1, or #rrggbb"),
        (["--background", "0.5,0.5"], "--background: expected white"),
        (["--background", "0,0,nan"], "'0,0,nan'"),
        (["--background", "#12345"], "'#12345'"),
        (["--background", "transparent", "--video"], "films hold no alpha, found --video"),
        (["--background", "transparent", "--orbit", "1"], "films hold no alpha, found --orbit"),
        (["--background", "transparent", "--turntable", "1"], "films hold no alpha, found --turntable"),
        (["--background", "transparent", "--layers", "image", "depth"], "found --layers depth"),
        (["--background", "transparent", "--env", "maps"], "which makes a contact sheet"),
        (["--camera", "30"], "--camera: expected YAW,PITCH"),
        (["--camera", "30,10,1,2"], "'30,10,1,2'"),
        (["--camera", "30,x"], "'30,x'"),
        (["--camera", "nan,0"], "'nan,0'"),
        (["--camera=-30,91"], "degrees from -90 to 90"),
        (["--camera", "0,0,0.1"], "metres from 0.25 to 100"),
        (["--camera", "0,0,inf"], "'0,0,inf'"),
        (["--fov", "0"], "--fov: expected degrees from 1 to 150"),
        (["--fov", "180"], "--fov"),
        (["--fov", "nan"], "--fov"),
        (["--orbit", "0"], "--orbit: expected a positive number of seconds"),
        (["--orbit", "nan"], "--orbit"),
        (["--env", "maps", "--orbit", "1"], "--orbit: expected one light"),
        (["--data", "missing"], "missing"),
        (["--frames", "9:"], "--frames"),
        (["--frames", "x"], "--frames"),
        (["--split", "0.5"], "--split"),
        (["--exposure", "-1"], "--exposure"),
        (["--exposure", "nan"], "--exposure"),
        (["--exposure", "inf"], "--exposure"),
        (["--rotate", "nan"], "--rotate"),
        (["--turntable", "0"], "--turntable"),
        (["--turntable", "-2"], "--turntable"),
        (["--turntable", "inf"], "--turntable"),
        (["--env", "square.exr", "square.exr", "square.exr"], "3 files"),
        (["--env", "half.exr", "square.exr"], "square.exr"),
        (["--env", "empty"], "empty: expected environment maps"),
        (["--env", "maps"], "broken.hdr"),
        (["--env", "maps", "--turntable", "1"], "--turntable"),
        (["--env", "maps", "--video"], "--video"),
        (["--env", "black.exr", "--exposure", "auto"], "black"),
        (["--env", "dark", "--exposure", "auto"], "b.exr"),
        (["--roughness", "rough"], "roughness"),
        (["--roughness", "1.5"], "0 to 1"),
        (["--roughness", "x-1"], "roughness"),
        (["--specular", "xinf"], "specular"),
        (["--albedo", "#12345"], "#rrggbb"),
        (["--albedo", "1,2"], "albedo"),
        (["--albedo", "1,2,nan"], "albedo"),
        (["--albedo", "x1.2", "--region", "hair"], "'hair'"),
        (["--albedo", "x1.2", "--region", "nose,hair"], "'hair'"),
        (["--region", "nose"], "--region"),
        (["--resolution", "0"], "--resolution"),
        (["--resolution", "-8"], "--resolution"),
        (["--resolution", "200000"], "at most 8192 pixels"),
        (["--fps", "0"], "--fps"),
    ],
    ids=lambda value: "=".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_used_is_named_before_anything_is_written(
    tiny_run, files, capsys, options, named, monkeypatch
):
    monkeypatch.chdir(files)
    message = refused(capsys, "--avatar", tiny_run, "--out", files / "out", *options)
    assert named in message
    assert not (files / "out").exists()


def test_no_avatar(tmp_path, capsys):
    assert str(tmp_path / "none") in refused(capsys, "--avatar", tmp_path / "none", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
