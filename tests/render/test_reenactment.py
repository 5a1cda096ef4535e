"""Avatars that are driven by another person's sequence, from the command line."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch
from data.built_in import built_in_film, write_built_in
from data.damage import change_arrays
from data.rigs import OTHERS, with_seven_joints
from data.tiny import N_EXPRESSION, tiny_template
from subjects import pose_of, posed, render_command
from warm_start import warm_python

from samira_warp.avatar import Avatar, read_frames
from samira_warp.data import open_sequence
from samira_warp.head import read_template
from samira_warp.io.images import read_image
from samira_warp.render.config import RenderConfig
from samira_warp.render.sources import select_frames

NAMES = np.array(["jawOpen", "browsUp", "smileLeft", "smileRight"])


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Another person in every layout, who turns and opens the mouth farther than the avatar was seen to."""
    film = built_in_film(1)
    return write_built_in(
        tmp_path_factory.mktemp("somebody else"),
        replace(film, rotation=2.5 * film.rotation, jaw=2.0 * film.jaw + 0.1),
    )


@pytest.fixture(scope="module")
def other(others):
    return others["VHAP export"]


def driven_by(data, avatar_folder, **options):
    """The frames that the render verb would show."""
    folder = avatar_folder / "avatar"
    return select_frames(
        RenderConfig(avatar_folder, avatar_folder, data=data, **options), Avatar.load(folder), folder
    )


def command(*arguments):
    """The render verb in a process of its own."""
    words = [*warm_python(), "-m", "samira_warp.render", *map(str, arguments), "--device", "cpu"]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)


def with_names(folder, names):
    """The same dataset with other names for its expressions, which makes its template another one."""
    change_arrays(folder / "template.npz", expression_names=np.asarray(names))
    return folder


def renamed_avatar(run, target, names):
    """A copy of an avatar whose expressions have other names, which is another template as well."""
    shutil.copytree(run / "avatar", target)
    avatar = Avatar.load(target)
    with_names(target, names)
    avatar.canonical = replace(avatar.canonical, template=read_template(target / "template.npz"))
    avatar.save(target, record={})
    return target


def test_the_render_verb_is_driven_by_another_person(built_in_run, other, tmp_path):
    options = ("--avatar", built_in_run, "--data", other, "--neutral-frame", 1, "--expression-gain", 1.5)
    ended = command(*options, "--out", tmp_path / "held")
    assert ended.returncode == 0, ended.stderr
    assert render_command(*options, "--no-clamp", "--out", tmp_path / "free") == 0
    held, free = (
        {path.name: read_image(path, channels=3) for path in (tmp_path / name / "image").iterdir()}
        for name in ("held", "free")
    )
    assert set(held) == set(free) == {"00005.png", "00006.png", "00007.png"}
    # turned by half a radian more the head shows another side
    assert all(np.abs(held[name] - free[name]).max() > 0.1 for name in held)


@pytest.mark.parametrize("clamp", [True, False])
def test_whatever_layout_drives_the_pictures_are_the_same(built_in_run, others, clamp):
    avatar, pictures = Avatar.load(built_in_run / "avatar"), {}
    for layout, root in others.items():
        frames = driven_by(
            root, built_in_run, clamp=clamp, neutral_frame=1, expression_gain=0.8, split="last:3"
        )
        with torch.no_grad():
            pictures[layout] = torch.stack(
                [avatar.render(frame.parameters, frame.camera).image for frame in frames]
            )
    expected = pictures.pop("VHAP export")
    assert len(expected) == 3
    for layout, found in pictures.items():
        difference = (found - expected).abs()
        # Gaussians that float32 moves by some 1e-4 px
        assert difference.mean() < 0.01 / 255, layout
        # where one's alpha crosses 1/255 by that, it comes or goes as a whole
        assert difference.max() < 1.5 / 255, layout


def test_pose_is_held_to_the_training_frames(built_in_run, other):
    seen = [frame.parameters for frame in read_frames(built_in_run) if frame.part == "train"]
    free = driven_by(other, built_in_run, clamp=False)
    held = driven_by(other, built_in_run)
    for kept, loose in zip(held, free, strict=True):
        values = torch.stack([parameters.rotations for parameters in seen])
        expected = torch.minimum(torch.maximum(loose.parameters.rotations, values.amin(0)), values.amax(0))
        assert torch.equal(kept.parameters.rotations, expected)
        assert torch.equal(kept.parameters.expression, loose.parameters.expression)
        assert torch.equal(kept.parameters.translation, loose.parameters.translation)
    for name in ("root", "jaw"):
        assert any(
            not torch.equal(pose_of(kept.parameters, name), pose_of(loose.parameters, name))
            for kept, loose in zip(held, free, strict=True)
        )


def test_the_neutral_frame_is_counted_over_the_whole_sequence(built_in_run, other):
    neutral = open_sequence(other).frames[1].parameters
    plain = driven_by(other, built_in_run, clamp=False)
    relative = driven_by(other, built_in_run, clamp=False, neutral_frame=1, expression_gain=2.0)
    assert neutral.expression.any()
    for before, after in zip(plain, relative, strict=True):
        assert torch.equal(
            after.parameters.expression, 2.0 * (before.parameters.expression - neutral.expression)
        )
        jaw = pose_of(before.parameters, "jaw") - pose_of(neutral, "jaw")
        assert torch.equal(after.parameters.rotations, posed(before.parameters, jaw=jaw).rotations)


def test_the_avatars_own_person_is_not_held(built_in_run, built_in_datasets):
    tracked = open_sequence(built_in_datasets["VHAP export"])
    for driven, index in zip(driven_by(tracked.root, built_in_run), tracked.test, strict=True):
        for name in ("rotations", "expression"):
            assert torch.equal(
                getattr(driven.parameters, name), getattr(tracked.frames[index].parameters, name)
            )


def test_a_gain_works_without_another_sequence(built_in_run):
    own = [frame for frame in read_frames(built_in_run) if frame.part == "test"]
    for before, after in zip(own, driven_by(None, built_in_run, expression_gain=0.5), strict=True):
        assert torch.equal(after.parameters.expression, 0.5 * before.parameters.expression)


def test_most_of_the_built_in_names_are_enough(built_in_run, other, tmp_path, capsys):
    """Eight of ten expressions carry over; what is left out of a driver's is said, with less it is
    refused."""
    names = read_template(other / "template.npz").expression_names
    for count, status in ((len(names) // 5, 0), (len(names) // 5 + 1, 2)):
        driver = shutil.copytree(other, tmp_path / str(count))
        strangers = [f"stranger{index}" for index in range(count)]
        with_names(driver, [*strangers, *names[count:]])
        capsys.readouterr()
        assert (
            render_command("--avatar", built_in_run, "--data", driver, "--out", tmp_path / f"out {count}")
            == status
        )
        said = capsys.readouterr().err
        assert (f"note: the avatar has no expressions {', '.join(strangers)}" in said) == (status == 0)
    assert said.splitlines()[-1].startswith(f"error: {driver / 'template.npz'}: ")
    assert f"{len(names) - count} of its {len(names)}" in said


def test_another_template_drives_by_the_names_of_its_expressions(tiny_run, tiny_dataset, tmp_path, capsys):
    avatar = renamed_avatar(tiny_run, tmp_path / "avatar", NAMES)
    driver = with_names(shutil.copytree(tiny_dataset, tmp_path / "driver"), NAMES[::-1])
    assert render_command("--avatar", avatar, "--data", driver, "--out", tmp_path / "out") == 0
    assert "note:" not in capsys.readouterr().err
    config = RenderConfig(avatar, tmp_path, data=driver)
    for driven, tracked in zip(
        select_frames(config, Avatar.load(avatar), avatar), open_sequence(driver).frames[4:], strict=True
    ):
        assert torch.equal(driven.parameters.expression, tracked.parameters.expression.flip(0))


def test_what_names_do_not_carry_over_is_said(tiny_run, tiny_dataset, tmp_path, capsys):
    """Four of five expressions."""
    names = [*NAMES, "puff"]
    avatar = renamed_avatar(tiny_run, tmp_path / "avatar", NAMES)
    driver = shutil.copytree(tiny_dataset, tmp_path / "driver")
    change_arrays(
        driver / "template.npz", shapedirs=lambda dirs: np.concatenate([dirs, dirs[:, :, -1:]], axis=2)
    )
    with_names(driver, names)
    for path in [*driver.glob("flame_param/*.npz"), driver / "canonical_flame_param.npz"]:
        change_arrays(
            path,
            expr=lambda values: np.pad(values, [(0, 0), (0, len(names) - N_EXPRESSION)], constant_values=0.5),
        )
    assert render_command("--avatar", avatar, "--data", driver, "--out", tmp_path / "out") == 0
    assert "note: the avatar has no expressions puff" in capsys.readouterr().err


def test_another_rig_drives_by_the_names_of_its_joints(tiny_run, tiny_dataset, tmp_path, capsys):
    """Seven joints drive five: what the avatar has no joint for is left out, and said."""
    avatar = renamed_avatar(tiny_run, tmp_path / "avatar", NAMES)
    driver = shutil.copytree(tiny_dataset, tmp_path / "driver")
    template = with_seven_joints(tiny_template()) | {"expression_names": NAMES}
    np.savez(driver / "template.npz", **template)
    for row, path in enumerate([*driver.glob("flame_param/*.npz"), driver / "canonical_flame_param.npz"]):
        poses = {f"pose_{name}": np.full((1, 3), 0.1, np.float32) for name in OTHERS}
        change_arrays(path, **poses, jaw_pose=np.full((1, 3), 0.01 * row, np.float32))
    options = ("--avatar", avatar, "--data", driver, "--no-clamp")
    assert render_command(*options, "--out", tmp_path / "out") == 0
    assert "note: the avatar has no joints head, tongue" in capsys.readouterr().err
    config = RenderConfig(avatar, tmp_path, data=driver, clamp=False)
    for driven, tracked in zip(
        select_frames(config, Avatar.load(avatar), avatar), open_sequence(driver).frames[4:], strict=True
    ):
        # base, neck, head, jaw, left_eye, right_eye, tongue
        expected = tracked.parameters.rotations[[0, 1, 3, 4, 5]]
        assert torch.equal(driven.parameters.rotations, expected)
        assert expected[2].any()


def refusal(capsys, *arguments):
    capsys.readouterr()
    assert render_command(*arguments) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    assert message.count("\n") == 1
    return message


def test_another_template_without_names_is_refused(tiny_run, tiny_dataset, tmp_path):
    driver = with_names(
        shutil.copytree(tiny_dataset, tmp_path / "driver"),
        [f"expr_{index:03d}" for index in range(N_EXPRESSION)],
    )
    ended = command("--avatar", tiny_run, "--data", driver, "--out", tmp_path / "out")
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last.startswith(f"error: {driver / 'template.npz'}: ")
    assert "numbers for names" in last
    assert not (tmp_path / "out").exists()


def test_wrong_options_are_one_line(tiny_run, tiny_dataset, tmp_path, capsys):
    common = ("--avatar", tiny_run, "--out", tmp_path / "out")
    assert "--data DIR" in refusal(capsys, *common, "--neutral-frame", 0)
    assert "from 0 to 5, found 6" in refusal(capsys, *common, "--data", tiny_dataset, "--neutral-frame", 6)
    assert "found -1" in refusal(capsys, *common, "--data", tiny_dataset, "--neutral-frame", -1)
    assert "--expression-gain" in refusal(capsys, *common, "--data", tiny_dataset, "--expression-gain", "nan")
    assert not (tmp_path / "out").exists()
