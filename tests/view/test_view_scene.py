"""What is chosen against the picture that is made of it: to the bit, whatever was shown before."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from subjects import parameters

from samira_warp.avatar import Avatar, MaterialEdit, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.export.config import ExportConfig
from samira_warp.export.source import ExportSource
from samira_warp.export.splats import frame_splats
from samira_warp.io.images import read_image, to_uint8, write_exr
from samira_warp.light import Environment
from samira_warp.light.cross import cube_to_cross
from samira_warp.render import RenderConfig, render
from samira_warp.stage.face_controls import expression_controls, joint_controls
from samira_warp.stage.viewpoint import Viewpoint
from samira_warp.view.carried import Carrier
from samira_warp.view.command_line import command_of, viewpoint_of
from samira_warp.view.lights import Lights
from samira_warp.view.look import Look
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Scene, Shown, Sides
from samira_warp.view.splats import SPLAT_UNITS
from samira_warp.view.stages import Stages
from samira_warp.view.state import Comparison, Lamp, Light, Pose, State

SIDE = 48


@pytest.fixture(scope="module")
def folder(tiny_run):
    return find_avatar(tiny_run)


@pytest.fixture(scope="module")
def shown(folder):
    avatar = Avatar.load(folder)
    return Shown(avatar, folder, Poser(read_frames(folder), avatar.canonical.template))


@pytest.fixture(scope="module")
def envs(tmp_path_factory):
    """Two maps that are small enough to be filtered at once: cube crosses of 16 texels a face."""
    folder, generator = tmp_path_factory.mktemp("envs"), torch.Generator().manual_seed(1)
    for name in ("day", "night"):
        cubemap = torch.rand(6, 16, 16, 3, generator=generator) ** 4
        write_exr(folder / f"{name}.exr", cube_to_cross(cubemap).numpy())
    return folder


@pytest.fixture
def scene(shown, envs):
    second = shown._replace(carrier=Carrier.between(shown.avatar, shown.avatar, source="second"))
    return Scene(shown, Lights(envs), second=second)


@pytest.fixture(scope="module")
def reference(shown, envs):
    """A scene whose lights are its own, to show everything in for the first time."""
    return Scene(shown, Lights(envs))


@pytest.fixture(scope="module")
def start(shown):
    return State(Look.of(shown.poser.frames[0].camera))


@pytest.fixture
def fresh(scene, reference):
    """The picture of a state, nothing of which was made before."""

    def picture(state):
        reference.second = scene.second
        reference.lights.forget()
        return reference.picture(state, Sides.new(), width=SIDE, height=SIDE, detail="rest")

    return picture


def test_a_look_is_the_camera_that_it_is_of(shown):
    camera = shown.poser.frames[0].camera
    again = Look.of(camera).camera(camera.width, camera.height)
    # the rotation goes through a quaternion in float64, and is rounded to float32 once
    torch.testing.assert_close(again.world_to_camera, camera.world_to_camera, rtol=0, atol=1e-6)
    assert again.fy == pytest.approx(camera.fy, rel=1e-12)


def test_the_picture_is_the_avatars_own_to_the_bit(scene, start, envs):
    avatar, frame = scene.shown.avatar, scene.shown.poser.frames[2]
    edit = MaterialEdit(albedo="x0.5", regions=("nose",))
    state = replace(start, pose=Pose(2), light=Light("day", rotate=30.0), edits=(edit,), background="#204060")
    camera = state.look.camera(SIDE, SIDE)
    light = Environment.load(envs / "day.exr", exposure="auto", rotate=30.0)
    behind = torch.tensor([0x20, 0x40, 0x60], dtype=torch.float64) / 255.0
    with torch.no_grad():
        wanted = avatar.render(
            frame.parameters, camera, light, background=behind.float(), edits=(edit,), tone_map="filmic"
        )
    got = scene.rendering(state, Stages(), camera)
    assert torch.equal(got.image, wanted.image)
    picture = scene.picture(state, Sides.new(), width=SIDE, height=SIDE)
    assert np.array_equal(picture, to_uint8(wanted.image.clamp(0, 1).numpy()))


LIVE = parameters(5, turn=0.1)
"""What a source that drives the avatar gave."""

CHANGES = {
    "frame": lambda s: replace(s, pose=Pose(3)),
    "rest": lambda s: replace(s, pose=replace(s.pose, neutral=True)),
    "expression": lambda s: replace(s, pose=replace(s.pose, expression=(("expression1", 0.8),))),
    "joints": lambda s: replace(s, pose=replace(s.pose, joints=(("neck", (0.0, 20.0, 0.0)),))),
    "live": lambda s: replace(s, pose=replace(s.pose, live=LIVE)),
    "live again": lambda s: replace(s, pose=replace(s.pose, live=None)),
    "light": lambda s: replace(s, light=Light("night")),
    "turn": lambda s: replace(s, light=replace(s.light, rotate=90.0)),
    "stops": lambda s: replace(s, light=replace(s.light, stops=-1.0)),
    "shadows": lambda s: replace(s, light=replace(s.light, shadows=False)),
    "turn without": lambda s: replace(s, light=replace(s.light, rotate=100.0)),
    "shadows again": lambda s: replace(s, light=replace(s.light, shadows=True)),
    "lamp": lambda s: replace(s, light=replace(s.light, lamp=Lamp())),
    "lamp moved": lambda s: replace(s, light=replace(s.light, lamp=Lamp(azimuth=-60.0))),
    "materials": lambda s: replace(s, edits=(MaterialEdit(roughness="x0.5", albedo="x0.7"),)),
    "layer": lambda s: replace(s, layer="albedo"),
    "atlas": lambda s: replace(s, layer="residual_position"),
    "tone map": lambda s: replace(s, tone_map="filmic", layer="image"),
    "background": lambda s: replace(s, background="black"),
    "light behind": lambda s: replace(s, background="env"),
    "turn behind": lambda s: replace(s, light=replace(s.light, rotate=10.0)),
    "camera": lambda s: replace(s, look=s.look._replace(fov=s.look.fov * 0.8)),
    "other light": lambda s: replace(s, comparison=Comparison("light", Light("night"))),
    "split": lambda s: replace(s, comparison=replace(s.comparison, split=0.25)),
    "other avatar": lambda s: replace(s, comparison=Comparison("avatar")),
}


def test_every_change_shows_what_a_fresh_start_would(scene, start, fresh):
    """One after the other, so that each finds the stages as the last one left them; and back again."""
    sides, state = Sides.new(), start
    before = scene.picture(state, sides, width=SIDE, height=SIDE, detail="rest")
    for name, change in CHANGES.items():
        state = change(state)
        picture = scene.picture(state, sides, width=SIDE, height=SIDE, detail="rest")
        assert np.array_equal(picture, fresh(state)), name
        # under one look, the same avatar twice is the same picture but for the line between
        assert not np.array_equal(picture, before), name
        before = picture
    again = scene.picture(start, sides, width=SIDE, height=SIDE, detail="rest")
    assert np.array_equal(again, fresh(start))


def test_another_size_is_another_picture(scene, start):
    sides = Sides.new()
    for width, height in ((40, 30), (30, 40), (40, 30)):
        picture = scene.picture(start, sides, width=width, height=height)
        assert picture.shape == (height, width, 3)
        assert np.array_equal(picture, scene.picture(start, Sides.new(), width=width, height=height))


def test_stages_that_nothing_touches_are_not_made_again(scene, start, monkeypatch):
    avatar, made = scene.shown.avatar, []
    of_each = {avatar: ("move", "rasterize", "shade"), avatar.occluder: ("occlude", "shares", "lobes")}
    for owner, names in of_each.items():
        for name in names:
            method = getattr(owner, name)
            monkeypatch.setattr(
                owner,
                name,
                lambda *a, _name=name, _method=method, **k: made.append(_name) or _method(*a, **k),
            )
    sides = Sides.new()

    def after(state):
        made.clear()
        scene.picture(state, sides, width=SIDE, height=SIDE, detail="rest")
        return sorted(made)

    lit = replace(start, light=Light("day"))
    assert after(lit) == ["lobes", "move", "occlude", "rasterize", "shade", "shares"]
    assert after(lit) == []
    assert after(replace(lit, layer="normal")) == []
    assert after(replace(lit, light=Light("day", stops=1.0))) == ["shade"]
    turned = replace(lit, light=Light("day", rotate=5.0))
    assert after(turned) == ["shade", "shares"]
    zoomed = replace(turned, look=lit.look._replace(fov=30.0))
    assert after(zoomed) == ["rasterize", "shade"]
    x, y, z = lit.look.position
    aside = replace(turned, look=lit.look._replace(position=(x + 0.1, y, z)))
    assert after(aside) == ["lobes", "rasterize", "shade"]
    assert after(replace(aside, pose=Pose(1))) == ["lobes", "move", "occlude", "rasterize", "shade", "shares"]


def test_two_browsers_do_not_see_each_others_choices(scene, start, fresh):
    one, other = Sides.new(), Sides.new()
    there = replace(start, pose=Pose(4), light=Light("night"), layer="normal")
    for _ in range(2):
        for state, sides in ((start, one), (there, other)):
            picture = scene.picture(state, sides, width=SIDE, height=SIDE, detail="rest")
            assert np.array_equal(picture, fresh(state))


def viewpoint_look(scene, state, viewpoint, *, fov):
    """The look of a camera at a viewpoint, as ``render --camera`` has it."""
    lens = Look.of(scene.shown.poser.frames[0].camera)._replace(fov=fov).camera(SIDE, SIDE)
    return Look.of(viewpoint.camera(scene.place(state), lens))


@pytest.mark.parametrize(
    "choose",
    [
        lambda s: s,
        lambda s: replace(s, light=Light("day", rotate=40.0, stops=0.5, shadows=False), background="#808080"),
        lambda s: replace(s, light=Light("night", lamp=Lamp(-40.0, 20.0, 0.6)), tone_map="none"),
        lambda s: replace(s, light=Light(lamp=Lamp(30.0, 40.0, 0.4)), background="env"),
        lambda s: replace(
            s,
            light=Light(rotate=-15.0, stops=-0.5),
            edits=(MaterialEdit(albedo="x0.8", roughness="x0.6", regions=("nose",)),),
        ),
        lambda s: replace(s, layer="irradiance", background="black"),
    ],
    ids=["plain", "map", "map and lamp", "learned and lamp", "materials", "layer"],
)
def test_the_command_renders_the_same_picture(scene, start, choose, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    state = choose(replace(start, pose=Pose(3)))
    state = replace(state, look=viewpoint_look(scene, state, Viewpoint(25.0, 12.0, 0.9), fov=22.0))
    said = command_of(scene, state, height=SIDE, data=None, split=None)
    assert said.missing == ()
    if said.lamp is not None:
        (tmp_path / "lamp.json").write_text(said.lamp)
    import tyro

    assert render(tyro.cli(RenderConfig, args=[*said.words, "--device", "cpu"])) == 1
    (file,) = (tmp_path / "rendered" / state.layer).glob("*.png")
    rendered = np.rint(255.0 * read_image(file, channels=3)).astype(int)
    picture = scene.picture(state, Sides.new(), width=SIDE, height=SIDE).astype(int)
    # cameras agree to the digits typed and to float32, so values may be rounded to either neighbour
    assert abs(rendered - picture).max() <= 1


def test_the_command_says_what_it_cannot(scene, start):
    state = replace(
        start,
        look=viewpoint_look(scene, start, Viewpoint(0.0, 0.0, 0.8), fov=25.0),
        pose=Pose(0, expression=(("expression0", 0.5),)),
        comparison=Comparison("light"),
    )
    said = command_of(scene, state, height=SIDE, data=None, split=None)
    assert len(said.missing) == 2
    x, y, z = state.look.position
    aside = replace(state, look=state.look._replace(position=(x + 0.1, y, z)))
    said = command_of(scene, aside, height=SIDE, data=None, split=None)
    assert len(said.missing) == 3
    assert [line.startswith("# not in the command: ") for line in said.text().splitlines()] == [True] * 3 + [
        False
    ]


def test_a_viewpoint_is_found_again(scene, start):
    for viewpoint in (Viewpoint(0.0, 0.0, 0.8), Viewpoint(-130.0, 40.0, 2.0), Viewpoint(90.0, -60.0, 0.5)):
        look = viewpoint_look(scene, start, viewpoint, fov=20.0)
        # a look comes from a float32 matrix: 1e-7 of a radian, and of some metres
        assert viewpoint_of(look, scene.place(start)) == pytest.approx(viewpoint, abs=1e-4)


def test_expressions_that_vary_most_come_first(shown):
    first, rest = expression_controls(shown.poser.frames, shown.avatar.canonical.template)
    values = torch.stack(
        [frame.parameters.expression for frame in shown.poser.frames if frame.part == "train"]
    ).numpy()
    names = shown.avatar.canonical.template.expression_names
    order = [names[index] for index in np.argsort(-values.astype(np.float64).std(axis=0), kind="stable")]
    assert [control.name for control in (*first, *rest)] == order


def test_what_is_added_comes_before_the_frames_own_rotation(shown):
    neck = shown.poser.template.joint_names.index("neck")
    own = shown.poser.frames[2].parameters.rotations[neck]
    turned = shown.poser.parameters(Pose(2, joints=(("neck", (0.0, 90.0, 0.0)),))).rotations[neck]
    from samira_warp.geometry import axis_angle_to_matrix

    quarter = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    expected = axis_angle_to_matrix(own) @ quarter
    torch.testing.assert_close(axis_angle_to_matrix(turned), expected, rtol=0, atol=1e-6)


def test_a_frame_as_it_is_keeps_its_bits(shown):
    for index, frame in enumerate(shown.poser.frames):
        assert shown.poser.parameters(Pose(index)) is frame.parameters


def test_controls_turn_joints_that_are_there(shown):
    template = shown.avatar.canonical.template
    controls = joint_controls(template)
    assert {joint for control in controls for joint in control.joints} == set(template.joint_names)
    assert [control.joints for control in controls if control.label == "head, turn"] == [("root",)]


def test_splats_are_those_that_export_writes(scene, start):
    """With the same colours under the same light, and covariances that half floats in decimetres keep."""
    state = replace(start, light=Light("day", rotate=40.0), tone_map="none")
    splats = scene.splats(state, Sides.new().left)
    avatar, frame = scene.shown.avatar, scene.shown.poser.frames[start.pose.frame]
    camera = start.look.camera(SIDE, SIDE)
    light = scene.lights.lit(avatar, state.light, detail="full").filtered
    with torch.no_grad():
        config = ExportConfig(Path("avatar"), Path("splats.ply"))
        casts = scene.casts_shadows(avatar, state.light)
        source = ExportSource(config, Path("avatar"), avatar, (frame,), (frame,), None, casts, "none")
        vars(source)["filtered"] = light  # as the viewer has it
        theirs = frame_splats(source, frame._replace(camera=camera))
    np.testing.assert_array_equal(splats.centers, theirs.means.numpy())
    colors = theirs.colors.clamp(0.0, 1.0).numpy()
    # rounded to the nearest of 256; twice the rounding of float32 in another order
    np.testing.assert_allclose(splats.colors / 255.0, colors, atol=0.5 / 255.0 + 1e-6)
    assert splats.colors.std() > 5.0
    opacities = theirs.opacity_logits.detach().sigmoid().numpy()[:, None]
    np.testing.assert_allclose(splats.opacities / 255.0, opacities, atol=0.5 / 255.0 + 1e-6)
    w, *xyz = torch.nn.functional.normalize(theirs.quaternions.double(), dim=1).unbind(dim=1)
    axis, turned = torch.stack(xyz, dim=1), []
    for unit in torch.eye(3, dtype=torch.float64):
        twice = 2.0 * torch.linalg.cross(axis, unit.expand_as(axis))
        turned.append(unit + w[:, None] * twice + torch.linalg.cross(axis, twice))
    columns = torch.stack(turned, dim=2) * theirs.scales.double()[:, None, :]
    covariances = (columns @ columns.mT).numpy()
    # eight roundings of float32, of the largest variance of a Gaussian
    bound = 8 * 2.0**-24 * np.abs(covariances).max(axis=(1, 2), keepdims=True)
    assert (np.abs(splats.covariances - covariances) <= bound).all()
    sent = (SPLAT_UNITS**2 * splats.covariances).astype(np.float16).astype(np.float64)
    # half floats move an eigenvalue by 2^-11 of the largest, which makes none of these flat splats inside out
    assert (np.linalg.eigvalsh(sent)[:, 0] > -(2.0**-10) * np.linalg.eigvalsh(sent)[:, 2]).all()
