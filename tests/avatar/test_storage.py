import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from subjects import camera, parameters, small_avatar, small_canonical

from samira_warp import Avatar, UserError
from samira_warp.avatar import DrivingFrame, Gaussians, read_frames, write_frames
from samira_warp.light import Environment
from samira_warp.nets import MotionSettings
from samira_warp.surface import CHANNELS


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    avatar = small_avatar(perturb=0.3)
    with torch.no_grad():
        avatar.response_logits.normal_()
    folder = tmp_path_factory.mktemp("avatar") / "avatar"
    folder.mkdir()
    avatar.save(folder, record={"subject": "tiny", "split": "dataset"})
    write_frames(folder, [DrivingFrame("one", parameters(0), camera(32), "train")])
    return avatar, folder


@pytest.fixture
def copy(saved, tmp_path):
    return shutil.copytree(saved[1], tmp_path / "copy")


def test_a_loaded_avatar_renders_the_same_bits(saved):
    avatar, folder = saved
    loaded = Avatar.load(folder)
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        before, after = avatar.render(frame, view), loaded.render(frame, view)
    assert torch.equal(before.image, after.image)
    for name in (*CHANNELS, "depth", "alpha"):
        assert torch.equal(getattr(before.gbuffer, name), getattr(after.gbuffer, name)), name
    assert loaded.settings == avatar.settings


def test_the_saved_light_is_the_learned_one(saved):
    avatar, folder = saved
    learned, read = avatar.light.environment(), Environment.load(folder)
    assert torch.equal(read.diffuse, learned.diffuse)
    assert torch.equal(read.specular, learned.specular)
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        # 32-bit floats are written as they are: the same bits, so the same picture
        assert torch.equal(avatar.render(frame, view, read).image, avatar.render(frame, view, learned).image)


def test_every_setting_survives(tmp_path):
    avatar = small_avatar(
        motion=MotionSettings(
            width=6,
            region_width=3,
            condition_width=5,
            bands=2,
            displacement_bands=4,
            routing=False,
            displacement=False,
            wrinkles=True,
        ),
        residual_frame="head",
        displacement_frame="world",
        color_space="raw",
        response=False,
        tied_light=True,
    )
    avatar.save(tmp_path, record={})
    assert Avatar.load(tmp_path).settings == avatar.settings


def test_a_static_offset_survives(tmp_path):
    avatar = small_avatar()
    offset = torch.full_like(avatar.canonical.vertices, 1e-3)
    avatar.canonical = replace(avatar.canonical, static_offset=offset)
    avatar.save(tmp_path, record={})
    assert torch.equal(Avatar.load(tmp_path).canonical.static_offset, offset)


def test_a_run_folder_stands_for_its_avatar(saved):
    _, folder = saved
    assert torch.equal(Avatar.load(folder.parent).gaussians.means, Avatar.load(str(folder)).gaussians.means)


def test_the_files_hold_no_pickle(saved):
    _, folder = saved
    names = {
        "avatar.json",
        "avatar.safetensors",
        "frames.safetensors",
        "light_diffuse.exr",
        "light_specular.exr",
        "template.npz",
    }
    assert {path.name for path in folder.iterdir()} == names
    with np.load(folder / "template.npz", allow_pickle=False) as archive:
        assert all(archive[key].dtype.kind != "O" for key in archive)
    assert json.loads((folder / "avatar.json").read_text())["record"]["subject"] == "tiny"


def refuses(path, *fragments, load=Avatar.load):
    """Loading fails with a UserError of one line that names the file and what is wrong."""
    with pytest.raises(UserError) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    for fragment in fragments:
        assert str(fragment) in message, message


def test_no_avatar_there(tmp_path):
    refuses(tmp_path / "nowhere", tmp_path / "nowhere", "no such folder")
    refuses(tmp_path, tmp_path, "no avatar.json")


@pytest.mark.parametrize("name", ["avatar.safetensors", "template.npz"])
def test_a_missing_file_is_named(copy, name):
    (copy / name).unlink()
    refuses(copy, copy / name)


@pytest.mark.parametrize("name", ["avatar.json", "avatar.safetensors", "template.npz"])
@pytest.mark.parametrize("damage", ["cut", "empty", "other"])
def test_a_broken_file_is_named(copy, name, damage):
    content = (copy / name).read_bytes()
    (copy / name).write_bytes(
        {"cut": content[: len(content) // 2], "empty": b"", "other": b"\x00\xff" * 100}[damage]
    )
    refuses(copy, copy / name)


def as_older(folder, version):
    """Make an avatar folder what an older version would have written."""
    description = json.loads((folder / "avatar.json").read_text())
    del description["settings"]["motion"]["displacement_bands"]
    if version <= 5:
        del description["settings"]["motion"]["wrinkles"]
    if version <= 4:
        del description["settings"]["smoothing"]
        without(folder / "avatar.safetensors", "gaussians.guessed")
    if version <= 3:
        del description["settings"]["visibility"]
    if version == 1:
        del description["settings"]["tied_light"]
    (folder / "avatar.json").write_text(json.dumps({**description, "format": version}))
    if version >= 3:
        return folder
    path = folder / "frames.safetensors"
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    rotations = tensors.pop("rotations")
    tensors |= {"rotation": rotations[:, 0].clone(), "neck": rotations[:, 1].clone()}
    tensors |= {"jaw": rotations[:, 2].clone(), "eyes": rotations[:, 3:].flatten(1).clone()}
    save_file(tensors, path, metadata=metadata)
    return folder


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5, 6])
def test_folders_of_older_versions_are_read(saved, copy, version):
    avatar, folder = saved
    loaded = Avatar.load(as_older(copy, version))
    assert loaded.settings == replace(avatar.settings, visibility=version > 3)
    assert all(torch.equal(value, loaded.state_dict()[name]) for name, value in avatar.state_dict().items())
    for before, after in zip(read_frames(folder), read_frames(copy), strict=True):
        assert (before.name, before.part) == (after.name, after.part)
        for name in ("translation", "rotations", "expression"):
            assert torch.equal(getattr(before.parameters, name), getattr(after.parameters, name)), name


def test_an_older_avatar_is_smoothed_as_the_low_pass_did(copy):
    """It was trained at 64 pixels, with a camera of 2.8 times their focal length, a metre in front of it."""
    description = json.loads((as_older(copy, 4) / "avatar.json").read_text())
    description["record"]["settings"] = {"resolution": 64}
    (copy / "avatar.json").write_text(json.dumps(description))
    # the head is not quite at the origin
    assert Avatar.load(copy).settings.smoothing == pytest.approx(0.2**0.5 / (2.8 * 64), rel=0.1)


def test_an_avatar_of_the_first_version_has_two_lights(copy):
    avatar = Avatar.load(as_older(copy, 1))
    assert avatar.settings.tied_light is False
    assert avatar.light.diffuse is not None


@pytest.mark.parametrize("name", ["rotation", "neck", "jaw", "eyes", "translation", "intrinsics"])
def test_a_missing_part_of_an_older_versions_frames_is_named(copy, name):
    without(as_older(copy, 2) / "frames.safetensors", name)
    refuses(copy, copy / "frames.safetensors", name, load=read_frames)


def test_an_older_folder_is_not_written_into(copy):
    frames = read_frames(copy)
    as_older(copy, 2)
    refuses(copy, copy, "format 7", "found format 2", load=lambda folder: write_frames(folder, frames))
    assert len(read_frames(copy)) == 1
    Avatar.load(copy).save(copy, record={})
    write_frames(copy, frames)
    assert torch.equal(read_frames(copy)[0].parameters.rotations, frames[0].parameters.rotations)


def test_what_is_written_says_its_version(saved):
    assert json.loads((saved[1] / "avatar.json").read_text())["format"] == 7
    assert "rotations" in tensor_names(saved[1] / "frames.safetensors")


def test_a_tied_light_is_one_map_and_comes_back(tmp_path):
    avatar = small_avatar(tied_light=True)
    with torch.no_grad():
        avatar.light.specular.normal_()
    avatar.save(tmp_path, record={})
    assert "light.diffuse" not in tensor_names(tmp_path / "avatar.safetensors")
    loaded = Avatar.load(tmp_path)
    assert loaded.settings.tied_light
    with torch.no_grad():
        assert torch.equal(loaded.light().irradiance, avatar.light().irradiance)


@pytest.mark.parametrize("load", [Avatar.load, read_frames])
@pytest.mark.parametrize(
    ("version", "found"), [(99, "format 99, which a newer version"), (0, "0"), ("3", "3"), (None, "None")]
)
def test_an_unknown_version_is_refused_with_those_that_are_read(copy, version, found, load):
    description = json.loads((copy / "avatar.json").read_text())
    (copy / "avatar.json").write_text(json.dumps({**description, "format": version}))
    refuses(copy, copy / "avatar.json", "an avatar of format 1 to 7", f"found {found}", load=load)


def test_a_description_of_another_kind_is_refused(copy):
    (copy / "avatar.json").write_text("[]")
    refuses(copy, copy / "avatar.json", "JSON object")


@pytest.mark.parametrize("lacks", ["settings", "record"])
def test_a_description_without_a_part_is_refused(copy, lacks):
    description = json.loads((copy / "avatar.json").read_text())
    del description[lacks]
    (copy / "avatar.json").write_text(json.dumps(description))
    refuses(copy, copy / "avatar.json")


@pytest.mark.parametrize("tied", [False, True])
def test_a_light_of_other_sizes_comes_back(tmp_path, tied):
    sizes = {"specular_size": 32} | ({} if tied else {"diffuse_size": 8})
    avatar = small_avatar(light_sizes=sizes, tied_light=tied)
    with torch.no_grad():
        for map in avatar.light.parameters():
            map.normal_()
    avatar.save(tmp_path, record={})
    loaded = Avatar.load(tmp_path)
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        assert torch.equal(avatar.render(frame, view).image, loaded.render(frame, view).image)
    learned, read = loaded.light.environment(), Environment.load(tmp_path)
    assert torch.equal(read.diffuse, learned.diffuse)
    assert torch.equal(read.specular, learned.specular)


def other_gaussians(avatar, order):
    """An avatar of the same Gaussians in another order, or of some of them."""
    other = small_avatar(perturb=0.3)
    other.load_state_dict(avatar.state_dict())
    other.set_gaussians(Gaussians({name: value[order] for name, value in avatar.gaussians.tensors().items()}))
    return other


def test_another_avatars_state_renders_as_it_does(saved):
    """The tables of faces and UVs follow the Gaussians whose state is taken."""
    avatar, _ = saved
    order = torch.randperm(len(avatar.gaussians), generator=torch.Generator().manual_seed(0))
    other, taking = other_gaussians(avatar, order), small_avatar(perturb=0.1)
    assert not torch.equal(other.gaussians.faces, taking.gaussians.faces)
    assert taking.load_state_dict(other.state_dict()).missing_keys == []
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        assert torch.equal(taking.render(frame, view).image, other.render(frame, view).image)
        assert torch.equal(taking.region_weights(), other.region_weights())


def test_a_state_with_another_number_of_gaussians_is_refused_whole(saved):
    avatar, _ = saved
    fewer, taking = other_gaussians(avatar, torch.arange(150)), small_avatar(perturb=0.1)
    before = {name: value.clone() for name, value in taking.state_dict().items()}
    with pytest.raises(UserError, match=r"^state_dict: expected the 200 Gaussians .*, found 150$"):
        taking.load_state_dict(fewer.state_dict())
    assert all(torch.equal(value, before[name]) for name, value in taking.state_dict().items())
    taking.set_gaussians(Gaussians(fewer.gaussians.tensors()))
    taking.load_state_dict(fewer.state_dict())
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        assert torch.equal(taking.render(frame, view).image, fewer.render(frame, view).image)


def test_another_template_is_refused(copy):
    with np.load(copy / "template.npz") as archive:
        arrays = dict(archive)
    arrays["v_template"] = arrays["v_template"] * 1.01
    np.savez(copy / "template.npz", **arrays)
    refuses(copy, copy / "template.npz", "template")


def test_tensors_of_another_avatar_are_refused(copy, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    small_avatar(motion=MotionSettings(width=4, region_width=2)).save(other, record={})
    shutil.copy(other / "avatar.safetensors", copy / "avatar.safetensors")
    refuses(copy, copy / "avatar.safetensors")


def tensor_names(path):
    with safe_open(path, framework="pt") as file:
        return sorted(file.keys())


def without(path, name):
    """Write a safetensors file again without one tensor."""
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    del tensors[name]
    save_file(tensors, path, metadata=metadata)


def test_a_missing_tensor_is_noticed_whichever_it_is(copy):
    path = copy / "avatar.safetensors"
    whole = path.read_bytes()
    names = tensor_names(path)
    assert {"shape", "gaussians.means", "gaussians.faces", "response_logits", "light.diffuse"} <= set(names)
    for name in names:
        path.write_bytes(whole)
        without(path, name)
        refuses(copy, path)


@pytest.mark.parametrize("part", ["settings", "motion"])
def test_a_missing_or_unknown_setting_is_noticed_whichever_it_is(copy, part):
    path = copy / "avatar.json"
    whole = json.loads(path.read_text())

    def part_of(description):
        return description["settings"] if part == "settings" else description["settings"]["motion"]

    for name in [*part_of(whole), None]:
        description = json.loads(json.dumps(whole))
        if name is None:
            part_of(description)["unheard_of"] = 1
        else:
            del part_of(description)[name]
        path.write_text(json.dumps(description))
        refuses(copy, path, name or "unheard_of")


def test_missing_parts_of_the_frames_are_named(copy):
    path = copy / "frames.safetensors"
    whole = path.read_bytes()
    for name in tensor_names(path):
        path.write_bytes(whole)
        without(path, name)
        refuses(copy, path, name, load=read_frames)
    path.write_bytes(whole)
    tensors = load_file(path)
    for metadata in ({"names": "one"}, {"parts": "train"}, None, {"names": "one\ntwo", "parts": "train"}):
        save_file(tensors, path, metadata=metadata)
        refuses(copy, path, load=read_frames)
    save_file(tensors, path, metadata={"names": "one\ntwo", "parts": "train\ntest"})
    refuses(copy, path, load=read_frames)


@pytest.mark.parametrize("has_offset", [(True, True), (True, False), (False, False)])
def test_dynamic_offsets_come_back(copy, has_offset, generator):
    offsets = [
        torch.randn(len(small_canonical().vertices), 3, generator=generator) if has else None
        for has in has_offset
    ]
    frames = [
        DrivingFrame(f"{index}", replace(parameters(index), dynamic_offset=offset), camera(32), "train")
        for index, offset in enumerate(offsets)
    ]
    write_frames(copy, frames)
    avatar = Avatar.load(copy)
    for before, after, offset in zip(frames, read_frames(copy), offsets, strict=True):
        if offset is not None:
            assert torch.equal(after.parameters.dynamic_offset, offset)
        with torch.no_grad():
            assert torch.equal(
                avatar.move(after.parameters).gaussians.means, avatar.move(before.parameters).gaussians.means
            )


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine")
def test_what_drives_an_avatar_may_be_on_another_device(copy):
    avatar = Avatar.load(copy, device="cuda")
    frame, view = parameters(1), camera(32)
    with torch.no_grad():
        light = Avatar.load(copy).light.environment()
        unfiltered = avatar.render(frame, view, light)
        assert torch.equal(avatar.render(frame, view, light.to("cuda").filtered()).image, unfiltered.image)
        there = avatar.render(frame.to("cuda"), view.to("cuda"))
        here = avatar.render(frame, view)
    assert here.image.device.type == "cuda"
    assert torch.equal(here.image, there.image)


def test_frames_come_back(tmp_path, saved):
    folder = shutil.copytree(saved[1], tmp_path / "avatar")
    frames = [
        DrivingFrame(f"{index:05d}_00", parameters(index), camera(48, height=32), part)
        for index, part in enumerate(["test", "train", "train"])
    ]
    write_frames(folder, frames)
    found = read_frames(folder)
    assert [(frame.name, frame.part) for frame in found] == [
        ("00000_00", "test"),
        ("00001_00", "train"),
        ("00002_00", "train"),
    ]
    for before, after in zip(frames, found, strict=True):
        for name in ("translation", "rotations", "expression"):
            assert torch.equal(getattr(before.parameters, name), getattr(after.parameters, name))
        assert torch.equal(before.camera.world_to_camera, after.camera.world_to_camera)
        assert replace(before.camera, world_to_camera=None) == replace(after.camera, world_to_camera=None)


def test_missing_and_broken_frames_are_named(copy):
    path = copy / "frames.safetensors"
    path.write_bytes(path.read_bytes()[:50])
    refuses(copy, path, load=read_frames)
    path.unlink()
    refuses(copy, path, load=read_frames)
