"""Every layout of a tracked film gives back the heads and cameras that were written, whatever its units and
axes."""

import json
import shutil

import numpy as np
import pytest
import torch
from data.damage import change_arrays, change_json
from data.layouts import WRITERS, joint_rotations, make_film_for, take, write_layout
from data.tiny import N_EXPRESSION, tiny_template
from PIL import Image

from samira_warp.check.opening import open_checked
from samira_warp.check.report import check_dataset
from samira_warp.data import load_pixels, open_listing, open_sequence
from samira_warp.data.metrical_tracker import rotation_vectors
from samira_warp.data.pictures import natural
from samira_warp.geometry.camera import Camera
from samira_warp.geometry.rotation import axis_angle_to_matrix
from samira_warp.head import FrameParameters, Rig, read_template
from samira_warp.head.flame import EYELIDS
from samira_warp.io.images import write_png
from samira_warp.support.errors import UserError

TRACKERS = [name for name in WRITERS if name != "VHAP export"]


def with_eyelids(arrays):
    """The tiny template with two more shapes, named as FLAME's eyelids are."""
    lids = np.zeros((*arrays["v_template"].shape, 2), np.float32)
    for side, name in enumerate(("left", "right")):
        lids[arrays[f"mask_{name}_eye_region"], 1, side] = -0.004
    names = [*arrays["expression_names"], *EYELIDS]
    return arrays | {
        "shapedirs": np.concatenate([arrays["shapedirs"], lids], axis=2),
        "expression_names": np.array(names),
    }


def write(layout, root, film=None, *, eyelids=True, **options):
    film = film or make_film_for(layout)
    write_layout(layout, film, root, **options)
    lids = eyelids and film.eyelids is not None
    np.savez(root / "template.npz", **(with_eyelids(tiny_template()) if lids else tiny_template()))
    return film


def truth(film, row, template):
    """The frame as the film has it, before its own camera; float64."""
    expression = film.expression[row]
    if template.expression_names[-2:] == EYELIDS:
        expression = np.concatenate([expression, film.eyelids[row]])
    values = (film.translation[row], joint_rotations(film, row), expression)
    parameters = FrameParameters(*map(torch.from_numpy, values))
    pose = torch.from_numpy(film.world_to_camera[row])
    camera = Camera(pose, *film.focal[row].tolist(), *film.center[row].tolist(), film.width, film.height)
    return parameters, camera


def projected(rig, parameters, camera, shape, static_offset):
    offset = None if static_offset is None else static_offset.double()
    vertices = rig.pose(parameters.to(dtype=torch.float64), shape.double(), offset).vertices
    seen = vertices @ camera.world_to_camera[:3, :3].double().T + camera.world_to_camera[:3, 3].double()
    assert (seen[:, 2] > 0).all()
    focal, center = torch.tensor([camera.fx, camera.fy]), torch.tensor([camera.cx, camera.cy])
    return seen[:, :2] / seen[:, 2:] * focal + center


def check_projections(sequence, film):
    rig = Rig.build(sequence.template).to(dtype=torch.float64)
    offset = None if film.static_offset is None else torch.from_numpy(film.static_offset)
    assert [frame.name for frame in sequence.frames] == sorted(film.names, key=natural)
    for frame in sequence.frames:
        parameters, camera = truth(film, film.names.index(frame.name), sequence.template)
        expected = projected(rig, parameters, camera, torch.from_numpy(film.shape), offset)
        ours = projected(rig, frame.parameters, frame.camera, sequence.shape, sequence.static_offset)
        # a picture of 512 pixels, at which 0.05 px were asked for, is 12.8 times as wide as these
        torch.testing.assert_close(ours, expected, atol=0.05 * film.width / 512, rtol=0)


@pytest.mark.parametrize("layout", WRITERS)
def test_vertices_project_where_they_were_tracked(tmp_path, layout):
    film = write(layout, tmp_path / "subject")
    sequence = open_sequence(tmp_path / "subject")
    check_projections(sequence, film)
    assert len(sequence.frames) == len(film)
    assert sequence.train
    assert sequence.test
    for frame in sequence.frames:
        values = (
            frame.camera.width,
            frame.camera.height,
            frame.camera.world_to_camera.dtype,
            frame.parameters.rotations.dtype,
        )
        assert values == (film.width, film.height, torch.float32, torch.float32)


@pytest.mark.parametrize("layout", TRACKERS)
def test_the_camera_stands_still_and_the_head_moves(tmp_path, layout):
    write(layout, tmp_path / "subject")
    frames = open_sequence(tmp_path / "subject").frames
    assert all(
        torch.equal(frame.camera.world_to_camera, frames[0].camera.world_to_camera) for frame in frames
    )
    assert not torch.equal(frames[0].parameters.rotations, frames[1].parameters.rotations)
    assert torch.equal(
        open_listing(tmp_path / "subject").frames[0].camera.world_to_camera, frames[0].camera.world_to_camera
    )


def test_the_cameras_of_an_export_are_its_own(tmp_path):
    film = write("VHAP export", tmp_path / "subject")
    for frame, pose in zip(open_sequence(tmp_path / "subject").frames, film.world_to_camera, strict=True):
        np.testing.assert_allclose(frame.camera.world_to_camera.numpy(), pose, atol=1e-6)


@pytest.mark.parametrize("layout", ["metrical-tracker", "HRAvatar v1"])
def test_eyelids_without_their_shapes_are_left_out_and_said(tmp_path, layout):
    film = write(layout, tmp_path / "subject", eyelids=False)
    sequence = open_sequence(tmp_path / "subject")
    assert any("eyelids are left out" in note for note in sequence.notes)
    film.eyelids = None
    check_projections(sequence, film)


def test_six_numbers_are_two_rows():
    """A matrix is given by its rows, not its columns; what is not orthonormal is made so."""
    angle = np.array([[0.3, -0.2, 0.5]])
    matrix = axis_angle_to_matrix(torch.from_numpy(angle)).numpy()
    np.testing.assert_allclose(rotation_vectors(matrix[:, :2].reshape(1, 6)), angle, atol=1e-12)
    skewed = matrix[:, :2] * [[[2.0], [1.0]]] + [[[0.0], [0.3]]] * matrix[:, :1]
    np.testing.assert_allclose(rotation_vectors(skewed.reshape(1, 6)), angle, atol=1e-12)


def colour_of(frame):
    """Which row of its film a picture was made of."""
    pixels = load_pixels(frame, width=frame.camera.width, height=frame.camera.height)
    return round(float(pixels.image[frame.camera.height // 2, frame.camera.width // 2, 0] * 255 - 40) / 20)


def check_pictures(sequence, film):
    for frame in sequence.frames:
        assert colour_of(frame) == film.names.index(frame.name)
        mask = load_pixels(frame, width=film.width, height=film.height).mask
        assert mask[0, 0] == 0
        assert mask[film.height // 2, film.width // 2] == 1


NAMES = {
    "out of order": ["00004", "00001", "00005", "00000", "00003", "00002"],
    "gaps": ["00002", "00003", "00017", "00040", "00041", "01000"],
    "no zeros in front": ["8", "9", "10", "11", "100", "99"],
    "spaces": ["a 1", "a 2", "a  3", "a 4", "a 5 ", "a 6"],
    "other alphabets": ["лицо 1", "顔 2", "tête 3", "Größe 4", "चेहरा 5", "وجه 6"],
    "dots": ["v1.0 1", "v1.0 2", "v1.0 3", "v1.0 4", "v1.0 5", "v1.0 6"],
}


@pytest.mark.parametrize("naming", NAMES)
@pytest.mark.parametrize("layout", WRITERS)
def test_frames_are_matched_by_name(tmp_path, layout, naming):
    film = make_film_for(layout)
    film.names = NAMES[naming]
    write(layout, tmp_path / "subject ü", film)
    sequence = open_sequence(tmp_path / "subject ü")
    if layout == "VHAP export":  # its own order is that of its timesteps
        assert [frame.name for frame in sequence.frames] == film.names
    else:
        check_projections(sequence, film)
    check_pictures(sequence, film)
    assert all(frame.mask_path is not None or layout == "metrical-tracker" for frame in sequence.frames)


@pytest.mark.parametrize("suffix", [".png", ".PNG", ".jpg", ".JPG", ".jpeg", ".webp", ".WebP"])
@pytest.mark.parametrize("layout", WRITERS)
def test_pictures_of_any_format(tmp_path, layout, suffix):
    film = write(layout, tmp_path / "subject", suffix=suffix)
    sequence = open_sequence(tmp_path / "subject")
    assert {frame.image_path.suffix for frame in sequence.frames} == {suffix}
    for frame in sequence.frames:
        assert colour_of(frame) == film.names.index(frame.name)


def test_an_export_whose_pictures_were_converted(tmp_path):
    """transforms.json still says .png."""
    root = tmp_path / "subject"
    film = write("VHAP export", root)
    for path in [*(root / "images").iterdir(), *(root / "fg_masks").iterdir()]:
        Image.open(path).save(path.with_suffix(".WEBP"), lossless=True)
        path.unlink()
    sequence = open_sequence(root)
    assert {path.suffix for frame in sequence.frames for path in (frame.image_path, frame.mask_path)} == {
        ".WEBP"
    }
    check_pictures(sequence, film)


def test_accents_in_one_or_two_characters(tmp_path):
    """A Mac writes the names of files in its own spelling."""
    film = make_film_for("HRAvatar v1", frames=2)
    film.names = ["t\u00eate 1", "t\u00eate 2"]
    write("HRAvatar v1", tmp_path / "subject", film)
    for folder in ("image", "mask"):
        for path in (tmp_path / "subject" / folder).iterdir():
            path.rename(path.with_name(path.name.replace("\u00ea", "e\u0302")))
    sequence = open_sequence(tmp_path / "subject")
    assert len(sequence.frames) == 2
    assert all(frame.mask_path is not None for frame in sequence.frames)


@pytest.mark.parametrize("scale", [0.5, 2, 3.2])
@pytest.mark.parametrize("layout", ["VHAP export", "HRAvatar v2"])
def test_masks_of_another_size(tmp_path, layout, scale):
    root = tmp_path / "subject"
    write(layout, root)
    for path in (root / ("fg_masks" if layout == "VHAP export" else "mask")).iterdir():
        mask = Image.open(path)
        mask.resize((round(scale * mask.width), round(scale * mask.height)), Image.Resampling.BOX).save(path)
    for frame in open_sequence(root).frames:
        pixels = load_pixels(frame, width=20, height=16)
        assert pixels.mask.shape == (16, 20)
        assert pixels.mask[8, 10] == 1
        assert pixels.mask[0, 0] == 0
        assert (pixels.image[0, 0] == 1).all()  # the scene behind the head is cut away


def test_pictures_smaller_than_those_that_were_tracked(tmp_path):
    root = tmp_path / "subject"
    film = write("metrical-tracker", root)
    for path in (root / "images").iterdir():
        Image.open(path).resize((film.width // 2, film.height // 2)).save(path)
    film.focal, film.center, film.width, film.height = (
        film.focal / 2,
        film.center / 2,
        film.width // 2,
        film.height // 2,
    )
    check_projections(open_sequence(root), film)


@pytest.mark.parametrize("layout", TRACKERS)
def test_pictures_and_parameters_without_each_other_are_left_out_and_said(tmp_path, layout):
    root = tmp_path / "subject"
    film = write(layout, root)
    folder = next(root / name for name in ("images", "image") if (root / name).is_dir())
    gone = next(folder.glob(f"{film.names[2]}.*"))
    gone.rename(folder / f"unknown{gone.suffix}")
    sequence = open_sequence(root)
    assert len(sequence.frames) == len(film) - 1
    assert any("1 pictures" in note and "unknown" in note for note in sequence.notes)
    assert any("1 tracked frames" in note for note in sequence.notes)
    check_projections(sequence, take(film, [0, 1, 3, 4, 5]))


def test_instas_division(tmp_path):
    film = write("metrical-tracker", tmp_path / "subject", transforms=True)
    assert open_listing(tmp_path / "subject").test == (4, 5)
    assert open_listing(tmp_path / "subject", split="last:1").test == (5,)
    for part in ("train", "test"):
        change_json(
            tmp_path / "subject" / f"transforms_{part}.json", lambda document: document["frames"].pop(0)
        )
    sequence = open_sequence(tmp_path / "subject")
    assert [frame.name for frame in sequence.frames] == ["00001", "00002", "00003", "00005"]
    assert sequence.test == (3,)
    # where the camera is held does not depend on the division: light that was learned by one must do for the
    # other
    whole = open_sequence(tmp_path / "subject", split="0.5")
    assert torch.equal(sequence.frames[0].camera.world_to_camera, whole.frames[0].camera.world_to_camera)
    assert torch.equal(sequence.frames[0].parameters.rotations, whole.frames[1].parameters.rotations)
    check_projections(whole, film)
    check_projections(sequence, take(film, [1, 2, 3, 5]))


def test_without_a_division_the_last_third_tests_and_it_is_said(tmp_path):
    write("IMavatar", tmp_path / "subject")
    listing = open_listing(tmp_path / "subject")
    assert listing.test == (4, 5)
    assert any("no division of its own" in note for note in listing.notes)


@pytest.mark.parametrize("keys", ["name", "file"])
def test_hravatars_keys_are_names_or_files(tmp_path, keys):
    film = write("HRAvatar v1", tmp_path / "subject", keys=keys, folder="images")
    check_projections(open_sequence(tmp_path / "subject"), film)


def test_imavatars_early_intrinsics_are_pixels_of_512(tmp_path):
    film = write("IMavatar", tmp_path / "subject", old=True)
    check_projections(open_sequence(tmp_path / "subject"), film)


def test_vhaps_last_epoch_counts_and_pictures_may_be_named_by_number(tmp_path):
    root = tmp_path / "subject"
    film = write("VHAP tracked", root, epoch=30, named=False)
    shutil.copy(root / "tracked_flame_params_30.npz", root / "tracked_flame_params_9.npz")
    change_arrays(root / "tracked_flame_params_9.npz", focal_length=lambda array: 2 * array)
    check_projections(open_sequence(root), film)


def test_vhaps_offsets(tmp_path):
    film = make_film_for("VHAP tracked")
    count = len(tiny_template()["v_template"])
    film.static_offset = 1e-3 * np.random.default_rng(0).normal(size=(count, 3))
    write("VHAP tracked", tmp_path / "subject", film)
    dynamic = 1e-3 * np.random.default_rng(1).normal(size=(len(film), count, 3)).astype(np.float32)
    change_arrays(tmp_path / "subject" / "tracked_flame_params_30.npz", dynamic_offset=dynamic)
    sequence = open_sequence(tmp_path / "subject")
    np.testing.assert_allclose(sequence.static_offset.numpy(), film.static_offset, atol=1e-8)
    for row, frame in enumerate(sequence.frames):
        np.testing.assert_array_equal(frame.parameters.dynamic_offset.numpy(), dynamic[row])


def test_albedo_is_found_in_any_layout(tmp_path):
    for number, layout in enumerate(WRITERS):
        film = write(layout, tmp_path / str(number))
        (tmp_path / str(number) / "albedo").mkdir()
        Image.new("RGB", (film.width, film.height), (9, 9, 9)).save(
            tmp_path / str(number) / "albedo" / f"{film.names[1]}.JPG"
        )
        frames = open_sequence(tmp_path / str(number)).frames
        assert [frame.albedo_path is not None for frame in frames] == [
            False,
            True,
            False,
            False,
            False,
            False,
        ]


def test_named_expressions_are_not_filled_up(tmp_path):
    film = make_film_for("IMavatar", n_expression=N_EXPRESSION - 1)
    write("IMavatar", tmp_path / "subject", film)
    with pytest.raises(UserError, match=r"flame_params\.json: expression: expected 4 coefficients.* found 3"):
        open_sequence(tmp_path / "subject")


def test_unnamed_shapes_are_filled_up_with_zeros(tmp_path):
    film = make_film_for("IMavatar", n_expression=N_EXPRESSION - 1, n_shape=1)
    root = tmp_path / "subject"
    write("IMavatar", root, film)
    arrays = tiny_template()
    del arrays["expression_names"]
    np.savez(root / "template.npz", **arrays)
    sequence = open_sequence(root)
    film.expression, film.shape = np.pad(film.expression, ((0, 0), (0, 1))), np.pad(film.shape, (0, 1))
    check_projections(sequence, film)
    assert read_template(root / "template.npz").names_expressions is False


def test_more_coefficients_than_shapes_are_refused(tmp_path):
    write("HRAvatar v2", tmp_path / "subject", make_film_for("HRAvatar v2", n_shape=3), eyelids=False)
    with pytest.raises(
        UserError, match=r"tracked_params_v2\.json: identity: expected 2 coefficients.* found 3"
    ):
        open_sequence(tmp_path / "subject")


def test_check_says_what_a_folder_is(tmp_path):
    for number, layout in enumerate(WRITERS):
        write(layout, tmp_path / str(number))
        listing = open_listing(tmp_path / str(number))
        assert layout.split()[0].lower() in listing.format.lower()
    assert json.loads((tmp_path / "5" / "flame_params.json").read_text())["intrinsics"][0] < 0


@pytest.mark.parametrize("layout", WRITERS)
def test_hidden_files_of_archives_made_on_macos_are_passed_over(tmp_path, layout):
    """A ._NAME lies beside every NAME."""
    write(layout, tmp_path / "subject")
    expected = open_sequence(tmp_path / "subject")
    for path in [path for path in (tmp_path / "subject").rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\26\7\0\2\0\0Mac OS X        " + bytes(120))
    found = open_sequence(tmp_path / "subject")
    assert [frame.name for frame in found.frames] == [frame.name for frame in expected.frames]
    assert not [finding for finding in check_dataset(tmp_path / "subject").findings if "._" in str(finding)]


def test_pictures_of_another_shape_than_were_tracked(tmp_path):
    """metrical-tracker crops a square, which it leaves in input/; whole frames may lie beside it."""
    root = tmp_path / "subject"
    write("metrical-tracker", root)
    expected = open_sequence(root)
    folder = expected.frames[0].image_path.parent
    folder.rename(root / "input")
    (root / "images").mkdir()
    for frame in expected.frames:
        write_png(root / "images" / frame.image_path.name, np.full((72, 200, 3), 0.5))
    found = open_sequence(root)
    assert found.frames[0].image_path.parent.name == "input"
    assert found.frames[0].camera.fx == expected.frames[0].camera.fx
    shutil.rmtree(root / "input")
    doubtful = open_sequence(root)  # may drive, does not train
    camera, tracked = doubtful.frames[0].camera, expected.frames[0].camera
    assert camera.fx / camera.fy == pytest.approx(tracked.fx / tracked.fy)
    assert len(doubtful.doubts) == len(doubtful.frames)
    with pytest.raises(UserError, match=r"of the shape 40 x 32 .*input/.*found 200 x 72"):
        open_checked(root)
    assert any("input/" in str(finding) for finding in check_dataset(root).findings)
