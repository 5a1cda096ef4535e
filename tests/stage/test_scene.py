"""The stage from Python, as a viewer uses it: no command line, no configuration."""

from pathlib import Path

import numpy as np
import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.avatar import DrivingFrame, MaterialEdit
from samira_warp.io.images import write_exr
from samira_warp.light import Environment, equirect_directions
from samira_warp.stage import Background, Scene, plan_shots, read_light
from samira_warp.stage.frames import frame_at
from samira_warp.stage.lights import read_sheet_light, sheet_labels, sheet_paths
from samira_warp.support.errors import UserError

FRAME = DrivingFrame("one", parameters(0), camera(32), "test")


@pytest.fixture(scope="module")
def environment():
    return Environment.from_panorama(1.0 + 0.9 * equirect_directions(16), size=32)


@pytest.fixture(scope="module")
def scene():
    avatar = small_avatar().requires_grad_(False)
    return Scene(avatar, (), Background("env", color_space=avatar.settings.color_space))


def test_a_scene_is_the_avatar_before_the_light(scene, environment):
    view, light = scene.view(FRAME), scene.light(environment.turned(20.0))
    for degrees in (0.0, 70.0):
        turned = environment.turned(20.0).turned(degrees)
        expected = scene.avatar.render(
            FRAME.parameters, FRAME.camera, turned, background=turned.background(FRAME.camera)
        )
        found = scene.relight(view, light.turned(degrees))
        assert torch.equal(found.image, expected.image)
        # for a single picture, what is behind it can be had without the rest
        assert torch.equal(scene.behind(view, turned), turned.background(FRAME.camera))
    assert found.gbuffer.albedo is view.gbuffer.albedo
    assert found.gbuffer.splats is view.gbuffer.splats


def test_a_light_is_filtered_and_encoded_once(scene, environment, monkeypatch):
    calls = []
    for name in ("filtered", "display_map"):
        method = getattr(Environment, name)
        monkeypatch.setattr(
            Environment,
            name,
            lambda self, *args, name=name, method=method, **options: (
                calls.append(name) or method(self, *args, **options)
            ),
        )
    view, light = scene.view(FRAME), scene.light(environment)
    for degrees in range(0, 360, 90):
        scene.relight(view, light.turned(degrees))
    assert sorted(calls) == ["display_map", "filtered"]


def test_edits_and_greys_are_the_scenes(scene):
    edited = Scene(scene.avatar, (MaterialEdit(albedo="x0.1"),), Background("black"))
    light = scene.light(scene.avatar.light.environment())
    plain = scene._replace(background=Background("black"))
    pictures = [each.relight(each.view(FRAME), light._replace(seen=None)).image for each in (plain, edited)]
    assert (pictures[0][0, 0] == 0).all()
    assert pictures[1].mean() < 0.7 * pictures[0].mean()


def test_shots_go_round_once():
    frames = [FRAME._replace(name=name) for name in "abc"]
    still = plan_shots(frames, frames_per_second=25.0)
    assert [shot.pictures for shot in still] == [((name, FRAME.camera, 0.0),) for name in "abc"]
    # held: the end of the turn meets its beginning
    (held,) = plan_shots(frames[:1], turntable=0.5, frames_per_second=8.0)
    assert held.pictures == tuple((f"a_{index:04d}", FRAME.camera, 90.0 * index) for index in range(4))
    # moving: as long as the sequence, at the same speed
    moving = plan_shots(frames, turntable=1.0, frames_per_second=4.0)
    turned = [((name, FRAME.camera, 90.0 * index),) for index, name in enumerate("abc")]
    assert [shot.pictures for shot in moving] == turned
    assert [shot.frame.name for shot in moving] == list("abc")


def test_a_frame_by_its_number():
    assert frame_at("abc", 2) == "c"
    for number in (-1, 3):
        with pytest.raises(UserError, match=f"--frame: expected 0 to 2, found {number}"):
            frame_at("abc", number)


def test_lights_by_their_paths(tmp_path):
    for name in ("b.exr", "a.exr", ".hidden.exr"):
        write_exr(tmp_path / name, np.ones((8, 16, 3), np.float32))
    (tmp_path / "a.jpg").write_bytes(b"")
    one = [tmp_path / "a.exr"]
    assert sheet_paths(one) is None
    assert sheet_paths([]) is None
    assert sheet_paths([tmp_path]) == [tmp_path / "a.exr", tmp_path / "b.exr"]
    assert sheet_paths([tmp_path], ldr=True) == [tmp_path / name for name in ("a.exr", "a.jpg", "b.exr")]
    assert sheet_labels([Path("x/a.exr"), Path("x/a.jpg"), Path("x/b.exr")]) == ["a.exr", "a.jpg", "b"]
    light = read_sheet_light(one[0], rotate=30.0, exposure=2.0)
    assert (light.rotate, light.exposure, light.specular.shape[1]) == (30.0, 2.0, 128)
    with pytest.raises(UserError, match=r"--env: expected one map, two .* found 3 files"):
        read_light(3 * one)
    with pytest.raises(UserError, match=r"--env: .* found 0 files"):
        read_light([])
