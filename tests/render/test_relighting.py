"""``python -m samira_warp.render`` under lights of a user's: maps, pairs, folders, lamps, turntables,
backgrounds, and materials changed."""

import functools
import itertools
import json
import subprocess
import sys

import imageio_ffmpeg
import numpy as np
import OpenImageIO
import pytest
import torch
from data.tiny import tiny_template
from subjects import camera, render_command

from samira_warp.avatar import Avatar, read_frames
from samira_warp.io.images import image_size, read_image, write_exr, write_png
from samira_warp.light import Environment, LightRig, decode_srgb
from samira_warp.light.equirect import equirect_directions
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.stage import lights
from samira_warp.stage.background import Background

FRAME = "00004_00"

AS_IT_IS = ("--exposure", 1, "--tone-map", "none")
"""A light as bright as its file says, shown without a curve: what can be compared with numbers."""


@pytest.fixture(autouse=True)
def small_environments(monkeypatch):
    """Environment maps as cubes of 64 texels, as learned lights are: the default's 256 take seconds to
    filter."""
    monkeypatch.setattr(Environment, "load", functools.partial(Environment.load, size=64))
    monkeypatch.setattr(Environment, "from_rig", functools.partial(Environment.from_rig, size=64))
    monkeypatch.setattr(lights, "SHEET_SIZE", 64)


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """A folder of three maps, bright on the right, above and straight ahead of the camera, and a file that is
    none."""
    folder = tmp_path_factory.mktemp("maps")
    directions = equirect_directions(32).numpy()
    for name, axis in {"right": (1, 0, 0), "above": (0, 1, 0), "ahead": (0, 0, -1)}.items():
        shares = np.maximum(directions @ np.array(axis, np.float32), 0.0)[..., None] ** 4
        write_exr(folder / f"{name}.exr", 0.1 + 4.0 * shares * np.array([1.0, 0.8, 0.6], np.float32))
    (folder / "README.md").write_text("three lights")
    return folder


def render(run, out, *arguments):
    assert render_command("--avatar", run, "--out", out, "--frames", "0", *arguments) == 0
    return out


def picture(folder, name=FRAME, layer="image"):
    return read_image(folder / layer / f"{name}.png", channels=3)


def background(image):
    """The upper corners, where no head is."""
    return np.concatenate([image[:6, :6], image[:6, -6:]])


def test_the_learned_light_by_its_files_is_the_learned_light(tiny_run, tmp_path):
    learned = picture(render(tiny_run, tmp_path / "learned"))
    folder = tiny_run / "avatar"
    pair = folder / "light_diffuse.exr", folder / "light_specular.exr"
    for name, env in {"run": (tiny_run,), "avatar": (folder,), "pair": pair}.items():
        # the maps are saved texel for texel in 32-bit floats: nothing is lost
        np.testing.assert_array_equal(picture(render(tiny_run, tmp_path / name, "--env", *env)), learned)


def test_any_light_turns(tiny_run, tmp_path, maps):
    """A map that is bright on the camera's right, turned, lights the face or the back of the head; the
    learned light turns as well."""
    images = {
        turn: render(tiny_run, tmp_path / str(turn), "--env", maps / "right.exr", "--rotate", turn, *AS_IT_IS)
        for turn in (-90, 0, 90)
    }
    front, side, back = (picture(images[turn]).mean() for turn in (-90, 0, 90))
    frames = read_frames(tiny_run)
    baked = Environment.load(maps / "right.exr", rotate=-90.0)
    with torch.no_grad():
        expected = Avatar.load(tiny_run).render(frames[0].parameters, frames[0].camera, baked).image
    np.testing.assert_allclose(picture(images[-90]), expected.clamp(0, 1).numpy(), atol=0.51 / 255)
    # of the mean of the whole picture, most of which is white background
    assert front > side + 0.01 > back + 0.02
    turned = picture(render(tiny_run, tmp_path / "learned", "--rotate", 90))
    assert np.abs(turned - picture(render(tiny_run, tmp_path / "unturned"))).max() > 1 / 255


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A warm lamp on the camera's right, before the face."""
    lamp = {
        "kind": "area",
        "position": [0.9, 0.2, 0.7],
        "width": 0.5,
        "height": 0.5,
        "radiance": [24, 18, 12],
    }
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    path.write_text(json.dumps({"lamps": [lamp]}))
    return path


def test_lamps_light_alone_and_with_a_map_and_turn_with_it(tiny_run, tmp_path, maps, rig):
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[0]
    lamps, dim = LightRig.load(rig), Environment.load(maps / "right.exr", exposure=1.0)
    for name, options, light in [
        ("alone", ("--exposure", 1), Environment.from_rig(lamps)),
        ("turned", ("--rotate", 40, "--exposure", 2), Environment.from_rig(lamps).turned(40.0).exposed(2.0)),
        (
            "both",
            ("--env", maps / "right.exr", "--rotate", 40, "--exposure", 1),
            dim.with_rig(lamps).turned(40.0),
        ),
        ("auto", ("--env", maps / "right.exr"), dim.with_rig(lamps).exposed("auto")),
    ]:
        found = picture(render(tiny_run, tmp_path / name, "--lights", rig, "--tone-map", "none", *options))
        with torch.no_grad():
            expected = avatar.render(frame.parameters, frame.camera, light).image
        np.testing.assert_allclose(found, expected.clamp(0, 1).numpy(), atol=0.51 / 255)
    alone = picture(tmp_path / "alone")
    left, right = (half[half.min(axis=-1) < 0.98].mean() for half in np.array_split(alone, 2, axis=1))
    assert right > left + 0.05


def test_lamps_are_added_to_every_map_of_a_sheet(tiny_run, tmp_path, maps, rig):
    with_lamps = picture(
        render(tiny_run, tmp_path / "lamps", "--env", maps, "--lights", rig, *AS_IT_IS), "contact_sheet"
    )
    without = picture(render(tiny_run, tmp_path / "maps", "--env", maps, *AS_IT_IS), "contact_sheet")
    assert (with_lamps >= without - 1.01 / 255).all()
    for row in np.array_split(with_lamps - without, 2, axis=0):
        assert row.max() > 0.1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"lamps": [{"kind": "spot"}]}', "lamp 0, kind: expected one of area, directional, point"),
        ('[{"kind": "area"}]', "expected a JSON object, found list"),
        ('{"lamps": [', "expected a JSON file"),
        ('{"lamps": [{"kind": "point", "position": [0, 0, 0.1], "intensity": 1}]}', "outside the head"),
        ('{"lamps": [{"kind": "directional", "direction": [0, 0, 1], "irradiance": NaN}]}', "irradiance"),
    ],
)
def test_a_rig_that_cannot_be_used_is_one_line_of_the_command(
    tiny_run, tmp_path, monkeypatch, capfd, content, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.json").write_text("\ufeff" + content, encoding="utf-8")
    capfd.readouterr()
    assert render_command("--avatar", tiny_run, "--out", "out", "--lights", "rig.json") == 2
    printed = capfd.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert line.startswith("error: rig.json")
    assert said in line
    assert not (tmp_path / "out").exists()


def test_auto_exposure_does_not_know_how_bright_the_map_is(tiny_run, tmp_path, maps):
    bright = 50.0 * read_image(maps / "right.exr", channels=3)
    write_exr(tmp_path / "bright.exr", bright)
    images = [
        picture(render(tiny_run, tmp_path / str(index), "--env", env, *options))
        for index, (env, options) in enumerate(
            [(maps / "right.exr", ("--exposure", "auto")), (tmp_path / "bright.exr", ())]
        )
    ]
    # a map's brightness is anybody's: it is the default
    np.testing.assert_allclose(images[0], images[1], atol=1.01 / 255)
    learned = picture(render(tiny_run, tmp_path / "learned", "--exposure", "auto"))
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[0]
    with torch.no_grad():
        expected = avatar.render(
            frame.parameters, frame.camera, avatar.light.environment().exposed("auto")
        ).image
    np.testing.assert_allclose(learned, expected.clamp(0, 1).numpy(), atol=0.51 / 255)


def test_a_foreign_light_burns_nothing_out_and_a_learned_one_is_shown_as_it_was_filmed(
    tiny_run, tmp_path, maps, rig
):
    """The default of --tone-map, by the light, against the avatar itself."""
    avatar, frame = Avatar.load(tiny_run), read_frames(tiny_run)[0]
    bright = Environment.load(maps / "ahead.exr", rotate=180.0)
    learned = avatar.light.environment()
    for name, options, light, tone_map in [
        ("map", ("--env", maps / "ahead.exr", "--rotate", 180), bright.exposed("auto"), "filmic"),
        (
            "brighter",
            ("--env", maps / "ahead.exr", "--rotate", 180, "--exposure", 8),
            bright.exposed(8.0),
            "filmic",
        ),
        ("lamps", ("--lights", rig), Environment.from_rig(LightRig.load(rig)).exposed("auto"), "filmic"),
        ("learned", ("--exposure", 3), learned.exposed(3.0), "none"),
        ("its folder", ("--env", tiny_run), learned, "none"),
        ("learned, filmic", ("--tone-map", "filmic"), learned, "filmic"),
    ]:
        found = picture(render(tiny_run, tmp_path / name, *options))
        with torch.no_grad():
            rendering = avatar.render(frame.parameters, frame.camera, light, tone_map=tone_map)
        np.testing.assert_allclose(found, rendering.image.clamp(0, 1).numpy(), atol=0.51 / 255, err_msg=name)
    inside = picture(render(tiny_run, tmp_path / "alpha", "--layers", "alpha"), layer="alpha") > 0.99
    plain = picture(
        render(
            tiny_run,
            tmp_path / "plain",
            "--env",
            maps / "ahead.exr",
            "--rotate",
            180,
            "--exposure",
            8,
            "--tone-map",
            "none",
        )
    )
    # the same light: half of the head is white, and nearly none of it
    assert (plain[inside] == 1).mean() > 0.3
    assert (picture(tmp_path / "brighter")[inside] == 1).mean() < 0.1 * (plain[inside] == 1).mean()


def test_an_8_bit_map_lights_when_it_is_asked_for(tiny_run, tmp_path, capsys):
    write_png(tmp_path / "sky.png", np.full((8, 16, 3), 0.5))
    render(
        tiny_run, tmp_path / "out", "--env", tmp_path / "sky.png", "--ldr", "--background", "env", *AS_IT_IS
    )
    np.testing.assert_allclose(background(picture(tmp_path / "out")), 0.5, atol=1.5 / 255)


def test_the_environment_is_behind_the_head_as_bright_and_as_turned_as_its_light(tiny_run, tmp_path, maps):
    options = ("--env", maps / "right.exr", "--exposure", 0.4, "--background", "env")
    camera = read_frames(tiny_run)[0].camera
    for tone_map, turn in itertools.product(("none", "filmic"), (0, 65, 90)):
        out = tmp_path / f"{tone_map}{turn}"
        seen = picture(render(tiny_run, out, *options, "--rotate", turn, "--tone-map", tone_map))
        light = Environment.load(maps / "right.exr", rotate=turn, exposure=0.4)
        expected = light.background(camera, tone_map=tone_map)
        np.testing.assert_allclose(background(seen), background(expected.numpy()), atol=0.51 / 255)
    dark, bright = (background(picture(tmp_path / f"none{turn}")).mean() for turn in (0, 90))
    assert bright > dark + 0.3


def test_a_picture_behind_the_head_keeps_its_proportions(tiny_run, tmp_path):
    wide = np.zeros((32, 96, 3), np.float32)
    wide[:, 32:64] = (0.2, 0.6, 1.0)
    write_png(tmp_path / "wide.png", wide)
    # floating-point files hold linear values
    write_exr(tmp_path / "wide.exr", decode_srgb(torch.from_numpy(wide)).numpy())
    for name in ("wide.png", "wide.exr"):
        image = picture(render(tiny_run, tmp_path / f"out {name}", "--background", tmp_path / name))
        # its middle third fills the square frame
        np.testing.assert_allclose(
            background(image), np.broadcast_to((0.2, 0.6, 1.0), (12, 6, 3)), atol=1 / 255
        )


def test_a_folder_of_maps_makes_a_labelled_sheet(tiny_run, tmp_path, maps, capsys):
    render(tiny_run, tmp_path, "--env", maps, "--layers", "image", "irradiance", "--background", "env")
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["contact_sheet.png", "contact_sheet.png"]
    assert "1 picture" in capsys.readouterr().err
    sheet = picture(tmp_path, "contact_sheet")
    # sorted by name: above and ahead, then right in a row of its own
    assert sheet.shape[0] > 2 * 32
    gap = 2
    for index, name in enumerate(("above", "ahead", "right")):
        alone = picture(
            render(tiny_run, tmp_path / name, "--env", maps / f"{name}.exr", "--background", "env")
        )
        row, column = divmod(index, 2)
        top, left = gap + row * (32 + 14 + gap), gap + column * (32 + gap)
        np.testing.assert_allclose(sheet[top : top + 32, left : left + 32], alone, atol=1.01 / 255)
        label = sheet[top + 32 : top + 32 + 14, left : left + 32]
        # black letters on white
        assert label.min() < 0.5
        assert label.mean() > 0.6
    assert picture(tmp_path, "contact_sheet", "irradiance").shape == sheet.shape


def test_a_sheet_reads_each_map_once_and_tells_two_of_one_name_apart(tiny_run, tmp_path, maps, monkeypatch):
    folder = tmp_path / "maps"
    folder.mkdir()
    for name in ("right.exr", "above.exr"):
        (folder / name).write_bytes((maps / name).read_bytes())
    OpenImageIO.ImageBuf(read_image(maps / "right.exr", channels=3)).write(str(folder / "right.hdr"))
    reads, read = [], RadianceMap.read
    monkeypatch.setattr(
        RadianceMap, "read", lambda path, **options: reads.append(path.name) or read(path, **options)
    )
    render(tiny_run, tmp_path / "out", "--env", folder)
    assert reads == ["above.exr", "right.exr", "right.hdr"]
    assert lights.sheet_labels([folder / name for name in reads]) == ["above", "right.exr", "right.hdr"]


def test_a_picture_behind_the_head_is_resized_once_for_a_sequence(tmp_path):
    write_png(tmp_path / "wide.png", np.full((32, 96, 3), 0.5))
    backdrop = Background(str(tmp_path / "wide.png"))
    first = backdrop.behind(camera(16), None)
    assert backdrop.behind(camera(16), None) is first
    assert backdrop.behind(camera(16, height=12), None).shape == (12, 16, 3)
    assert first.shape == (16, 16, 3)


def test_a_folder_with_a_learned_light_is_that_light_whatever_else_is_in_it(tiny_run, tmp_path, maps):
    folder = tmp_path / "mixed"
    folder.mkdir()
    for path in (*(tiny_run / "avatar").glob("light_*.exr"), *maps.glob("*.exr")):
        (folder / path.name).write_bytes(path.read_bytes())
    render(tiny_run, tmp_path / "out", "--env", folder)
    np.testing.assert_array_equal(picture(tmp_path / "out"), picture(render(tiny_run, tmp_path / "learned")))


def video_frames(path):
    return imageio_ffmpeg.count_frames_and_secs(str(path))[0]


def test_the_light_goes_round_a_held_frame(tiny_run, tmp_path, maps, capsys):
    options = ("--env", maps / "right.exr", "--rotate", 30)
    render(tiny_run, tmp_path / "turn", *options, "--turntable", 0.5, "--fps", 8)
    assert "4 pictures" in capsys.readouterr().err
    names = [f"{FRAME}_{index:04d}" for index in range(4)]
    assert sorted(path.stem for path in (tmp_path / "turn" / "image").iterdir()) == names
    assert video_frames(tmp_path / "turn" / "image.mp4") == 4
    for index, name in enumerate(names):
        alone = render(tiny_run, tmp_path / name, *options[:2], "--rotate", 30 + 90 * index)
        np.testing.assert_array_equal(picture(tmp_path / "turn", name), picture(alone))


def test_the_light_goes_round_a_moving_head(tiny_run, tmp_path, maps):
    out = tmp_path / "turn"
    options = ("--env", maps / "right.exr", "--layers", "image", "normal")
    assert render_command("--avatar", tiny_run, "--out", out, *options, "--turntable", 1, "--fps", 4) == 0
    assert sorted(path.stem for path in (out / "image").iterdir()) == [FRAME, "00005_00"]
    assert video_frames(out / "normal.mp4") == 2
    second = tmp_path / "second"
    assert (
        render_command("--avatar", tiny_run, "--out", second, *options[:2], "--frames", 1, "--rotate", 90)
        == 0
    )
    np.testing.assert_array_equal(picture(out, "00005_00"), picture(second, "00005_00"))


def test_materials_change_where_they_are_told_to(tiny_run, tmp_path):
    layers = ("--layers", "albedo", "roughness", "specular", "alpha")
    before = render(tiny_run, tmp_path / "before", *layers)
    inside = picture(before, layer="alpha")[..., 0] > 0.99
    for layer, options, change in [
        ("roughness", ("--roughness", "x0.5"), lambda x: 0.5 * x),
        ("roughness", ("--roughness", "0.9"), lambda x: 0.9 + 0 * x),
        ("specular", ("--specular", "x2"), lambda x: 2 * x),
    ]:
        after = render(tiny_run, tmp_path / "".join(options), *layers, *options)
        # pictures lie on white where alpha is not quite 1, and are rounded to 256 levels twice
        np.testing.assert_allclose(
            picture(after, layer=layer)[inside],
            change(picture(before, layer=layer)[inside]),
            atol=0.01 + 2 / 255,
        )
        for other in {"albedo", "roughness", "specular"} - {layer}:
            np.testing.assert_array_equal(picture(after, layer=other), picture(before, layer=other))


@pytest.mark.parametrize(
    "regions",
    [("--region", "forehead"), ("--region", "forehead,nose"), ("--region", "forehead", "--region", "nose")],
)
def test_a_region_is_painted_and_the_rest_is_not(tiny_run, tmp_path, regions):
    before = picture(render(tiny_run, tmp_path / "before", "--layers", "albedo"), layer="albedo")
    after = picture(
        render(tiny_run, tmp_path / "after", "--layers", "albedo", "--albedo", "#ff0000", *regions),
        layer="albedo",
    )
    changed = np.abs(after - before).max(axis=2) > 0.03
    # the made-up head faces the camera: its forehead is above the middle, its nose in it, its neck below
    assert changed[6:13].any()
    assert changed[15:19, 12:20].any() == any("nose" in word for word in regions)
    assert not changed[24:].any()
    red = after[changed]
    assert (red[:, 0] > before[changed][:, 0] - 0.02).all()
    assert (red[:, 1] < before[changed][:, 1]).all()
    assert "forehead" in {name.removeprefix("mask_") for name in tiny_template()}


def test_materials_change_on_a_sheet_and_a_turntable_as_well(tiny_run, tmp_path, maps):
    for options in (("--env", maps), ("--turntable", 0.2, "--fps", 10)):
        plain, edited = tmp_path / f"plain{options[0]}", tmp_path / f"edited{options[0]}"
        render(tiny_run, plain, *options)
        render(tiny_run, edited, *options, "--albedo", "x0.3")
        name = next((plain / "image").iterdir()).stem
        assert picture(edited, name).mean() < picture(plain, name).mean() - 0.01
        assert image_size(edited / "image" / f"{name}.png") == image_size(plain / "image" / f"{name}.png")


def test_the_command_itself(tiny_run, tmp_path, maps):
    """A real process, with the sheet's real size."""
    options = [
        "--exposure",
        "auto",
        "--background",
        "env",
        "--albedo",
        "x1.1",
        "--region",
        "lips",
        "--device",
        "cpu",
    ]
    command = [
        sys.executable,
        "-m",
        "samira_warp.render",
        "--avatar",
        tiny_run,
        "--out",
        tmp_path / "out",
        "--env",
        maps,
        *options,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert [path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")] == [
        "image/contact_sheet.png"
    ]
