"""What is read of a VHAP export: frames, their order and division, cameras and parameters."""

import json
import math
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from data.damage import change_arrays, change_json
from data.tiny import N_SHAPE, make_tiny_dataset, tiny_template

from samira_warp.data import open_listing, open_sequence
from samira_warp.data.vhap_parameters import read_parameter_file
from samira_warp.head import FLAME_JOINTS, Rig
from samira_warp.head.flame import FLAME_VERTICES
from samira_warp.head.teeth import TEETH_VERTICES
from samira_warp.support.errors import UserError

PARTS = ("transforms.json", "transforms_train.json", "transforms_test.json")


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


def change_every_list(root, change):
    for name in PARTS:
        change_json(root / name, change)


def change_every_entry(root, change):
    def each(document):
        for entry in document["frames"]:
            change(entry)

    change_every_list(root, each)


def matrix(axis, angle):
    """Rotation about a coordinate axis, written out."""
    c, s = math.cos(angle), math.sin(angle)
    about_x = [[1, 0, 0], [0, c, -s], [0, s, c]]
    about_y = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    about_z = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    return np.array({"x": about_x, "y": about_y, "z": about_z}[axis])


def test_the_datasets_own_split(tiny_dataset):
    sequence = open_sequence(tiny_dataset)
    assert [frame.name for frame in sequence.frames] == [f"{index:05d}_00" for index in range(6)]
    assert [frame.timestep for frame in sequence.frames] == list(range(6))
    assert (sequence.train, sequence.test, sequence.selected) == ((0, 1, 2, 3), (4, 5), (4, 5))
    assert open_listing(tiny_dataset, split="train").selected == (0, 1, 2, 3)
    assert [frame.albedo_path is not None for frame in sequence.frames] == [True] * 4 + [False] * 2
    assert sequence.template_path == tiny_dataset / "template.npz"


@pytest.mark.parametrize(("split", "test"), [("0.5", (3, 4, 5)), ("last:1", (5,))])
def test_a_split_of_the_users(tiny_dataset, split, test):
    listing = open_listing(tiny_dataset, split=split)
    assert listing.test == listing.selected == test
    assert sorted(listing.train + listing.test) == list(range(6))


def test_a_split_of_the_users_needs_only_the_whole_list(dataset):
    (dataset / "transforms_train.json").unlink()
    (dataset / "transforms_test.json").unlink()
    assert open_listing(dataset, split="last:2").test == (4, 5)


def test_the_datasets_own_split_needs_only_its_two_lists(dataset):
    (dataset / "transforms.json").unlink()
    (dataset / "transforms_val.json").unlink()
    assert len(open_listing(dataset).frames) == 6


def test_frames_are_ordered_by_timestep_however_they_are_listed(dataset):
    change_every_list(dataset, lambda document: document["frames"].reverse())
    listing = open_listing(dataset)
    assert [frame.timestep for frame in listing.frames] == list(range(6))
    assert listing.test == (4, 5)


def test_frames_are_ordered_by_timestep_not_by_name(dataset):
    change_every_entry(dataset, lambda entry: entry.update(timestep_index=5 - entry["timestep_index"]))
    listing = open_listing(dataset)
    assert [frame.name for frame in listing.frames] == [f"{index:05d}_00" for index in reversed(range(6))]
    assert listing.test == (0, 1)


def test_views_of_one_moment_stay_in_one_part(dataset):
    """Timesteps 0, 0, 1, 1, 2, 2: the last timestep is two frames."""
    change_every_entry(dataset, lambda entry: entry.update(timestep_index=entry["timestep_index"] // 2))
    assert open_listing(dataset, split="last:1").test == (4, 5)


def test_masks_may_be_absent(dataset):
    shutil.rmtree(dataset / "fg_masks")
    change_every_entry(dataset, lambda entry: entry.pop("fg_mask_path"))
    assert all(frame.mask_path is None for frame in open_sequence(dataset).frames)


def test_listing_reads_no_parameters(dataset):
    (dataset / "template.npz").unlink()
    for path in (dataset / "flame_param").iterdir():
        path.write_bytes(b"")
    assert len(open_listing(dataset).frames) == 6


def test_keys_that_are_not_known_are_passed_over(dataset):
    change_every_entry(dataset, lambda entry: entry.update(k1=0.1, note="mine"))
    assert len(open_listing(dataset).frames) == 6


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_projects_a_known_point_where_it_should(dataset, seed):
    """A point a right of, b above and d before an OpenGL camera lands at (cx + fx a / d, cy - fy b / d)."""
    rng = np.random.default_rng(seed)
    rotation = (
        matrix("y", rng.uniform(-1, 1)) @ matrix("x", rng.uniform(-1, 1)) @ matrix("z", rng.uniform(-1, 1))
    )
    position = rng.uniform(-1, 1, 3)
    camera_to_world = np.eye(4)
    camera_to_world[:3, :3], camera_to_world[:3, 3] = rotation, position
    intrinsics = {"fl_x": 100.0, "fl_y": 80.0, "cx": 15.0, "cy": 20.5}
    change_every_entry(
        dataset, lambda entry: entry.update(intrinsics, transform_matrix=camera_to_world.tolist())
    )
    camera = open_listing(dataset).frames[0].camera
    a, b, d = 0.2, 0.1, 1.6
    world = rotation @ [a, b, -d] + position
    x, y, z = (camera.world_to_camera.double() @ torch.tensor([*world, 1.0], dtype=torch.float64))[
        :3
    ].tolist()
    # float32 rounding of a transform whose entries are near 1
    assert z == pytest.approx(d, abs=1e-6)
    assert camera.cx + camera.fx * x / z == pytest.approx(15.0 + 100.0 * a / d, abs=1e-4)
    assert camera.cy + camera.fy * y / z == pytest.approx(20.5 - 80.0 * b / d, abs=1e-4)
    torch.testing.assert_close(camera.center, torch.tensor(position, dtype=torch.float32), atol=1e-6, rtol=0)
    assert (camera.world_to_camera.dtype, camera.width, camera.height) == (torch.float32, 32, 32)


def test_a_camera_of_four_decimals_is_accepted(dataset):
    rounded = np.eye(4)
    rounded[:3, :3] = np.round(matrix("y", 0.4), 4)
    change_every_entry(dataset, lambda entry: entry.update(transform_matrix=rounded.tolist()))
    open_listing(dataset)


def test_each_frame_has_its_own_intrinsics(dataset):
    change_every_entry(
        dataset,
        lambda entry: entry.update(fl_x=50.0 + entry["timestep_index"], cx=10.0 + entry["timestep_index"]),
    )
    cameras = [frame.camera for frame in open_listing(dataset).frames]
    assert [camera.fx for camera in cameras] == [50.0 + index for index in range(6)]
    assert [camera.cx for camera in cameras] == [10.0 + index for index in range(6)]
    assert {camera.fy for camera in cameras} == {2.8 * 32}


def test_intrinsics_at_the_top_of_the_file_hold_for_all_frames(dataset):
    def to_top(document):
        for entry in document["frames"]:
            for key in ("cx", "cy", "fl_x", "fl_y", "w", "h", "camera_angle_x", "camera_angle_y"):
                del entry[key]
        document.update(fl_x=70.0, fl_y=60.0, cx=12.0, cy=13.0)

    change_every_list(dataset, to_top)
    camera = open_listing(dataset).frames[-1].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height) == (
        70.0,
        60.0,
        12.0,
        13.0,
        32,
        32,
    )


def without(document, *keys):
    for values in (document, *document["frames"]):
        for key in keys:
            values.pop(key, None)


def test_without_a_focal_length_the_field_of_view_gives_it(dataset):
    change_every_list(dataset, lambda document: without(document, "fl_x", "fl_y"))
    camera = open_listing(dataset).frames[0].camera
    # the tiny dataset's angle is that of a focal length of 2.8 widths
    assert camera.fx == camera.fy == pytest.approx(2.8 * 32)


def test_a_frames_own_field_of_view_outweighs_the_files_focal_length(dataset):
    def change(document):
        document["fl_x"] = document["fl_y"] = 1.0
        for entry in document["frames"]:
            del entry["fl_x"], entry["fl_y"]
            entry["camera_angle_x"] = math.pi / 2

    change_every_list(dataset, change)
    assert open_listing(dataset).frames[0].camera.fx == pytest.approx(16.0)


def test_without_a_principal_point_it_is_the_centre(dataset):
    change_every_list(dataset, lambda document: without(document, "cx", "cy"))
    camera = open_listing(dataset).frames[0].camera
    assert (camera.cx, camera.cy) == (16.0, 16.0)


def test_without_fl_y_pixels_are_square(dataset):
    change_every_list(dataset, lambda document: without(document, "fl_y"))
    camera = open_listing(dataset).frames[0].camera
    assert camera.fy == camera.fx == 2.8 * 32


def test_parameters_are_those_of_the_file_that_the_list_names(dataset):
    """VHAP names files by the original timestep: here the listed paths run backwards."""
    change_every_entry(
        dataset,
        lambda entry: entry.update(flame_param_path=f"flame_param/{5 - entry['timestep_index']:05d}.npz"),
    )
    sequence = open_sequence(dataset)
    for frame in sequence.frames:
        with np.load(dataset / "flame_param" / f"{5 - frame.timestep:05d}.npz") as arrays:
            ours = frame.parameters
            for key, values in (
                ("translation", ours.translation),
                ("rotation", ours.rotations[0]),
                ("neck_pose", ours.rotations[1]),
                ("jaw_pose", ours.rotations[2]),
                ("eyes_pose", ours.rotations[3:].flatten()),
                ("expr", ours.expression),
            ):
                assert values.dtype == torch.float32
                np.testing.assert_array_equal(values.numpy(), arrays[key][0])
    assert sequence.shape.shape == (N_SHAPE,)
    np.testing.assert_allclose(sequence.shape.numpy(), [0.1, -0.1], rtol=1e-7)
    assert sequence.static_offset is None


def test_float64_parameters_are_accepted(dataset):
    change_arrays(dataset / "flame_param" / "00000.npz", expr=lambda array: array.astype(np.float64))
    assert open_sequence(dataset).frames[0].parameters.expression.dtype == torch.float32


def test_a_repeated_static_offset_is_the_subjects(tmp_path):
    root = make_tiny_dataset(tmp_path / "subject", frames=4, size=32, static_offset=True)
    change_arrays(root / "flame_param" / "00002.npz", static_offset=None)  # said of the subject is enough
    sequence = open_sequence(root)
    assert sequence.static_offset.shape == (len(sequence.template.v_template), 3)
    assert all(frame.parameters.dynamic_offset is None for frame in sequence.frames)


def test_offsets_of_zero_are_none(dataset):
    """Exports write them where nothing was tracked; 20,000 of FLAME's vertices would take more than 1 GB."""
    offset = np.zeros((1, len(tiny_template()["v_template"]), 3), np.float32)
    for path in (dataset / "flame_param").iterdir():
        change_arrays(path, dynamic_offset=offset)
    assert all(frame.parameters.dynamic_offset is None for frame in open_sequence(dataset).frames)


@pytest.mark.parametrize("has_dynamic", [True, False])
@pytest.mark.parametrize("subject_has_one", [True, False])
def test_a_frames_own_static_offset_moves_its_head(tmp_path, subject_has_one, has_dynamic):
    """What differs from the subject's is the frame's: its vertices are where its tracker had them."""
    root = make_tiny_dataset(tmp_path / "subject", frames=4, size=32, static_offset=True)
    count = len(tiny_template()["v_template"])
    own = 1e-3 * np.random.default_rng(0).normal(size=(1, count, 3)).astype(np.float32)
    change_arrays(root / "flame_param" / "00001.npz", static_offset=own)
    if has_dynamic:
        change_arrays(root / "flame_param" / "00001.npz", dynamic_offset=own[:, ::-1].copy())
    if not subject_has_one:
        change_arrays(root / "canonical_flame_param.npz", static_offset=None)
    sequence = open_sequence(root)
    assert (sequence.static_offset is not None) is subject_has_one
    rig, frame = Rig.build(sequence.template), sequence.frames[1]
    found = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
    whole = torch.from_numpy(own[0] + (own[0, ::-1] if has_dynamic else 0))
    expected = rig.pose(replace(frame.parameters, dynamic_offset=whole), sequence.shape).vertices
    # offsets of 1e-4 to 4e-3 m subtracted and added again, on vertices of 0.1 m
    torch.testing.assert_close(found, expected, atol=5e-8, rtol=0)


def test_frames_of_one_moment_share_their_parameters(dataset):
    change_every_entry(dataset, lambda entry: entry.update(flame_param_path="flame_param/00003.npz"))
    offset = np.full((1, len(tiny_template()["v_template"]), 3), 1e-3, np.float32)
    change_arrays(dataset / "flame_param" / "00003.npz", dynamic_offset=offset)
    frames = [frame.parameters for frame in open_sequence(dataset).frames]
    for name in ("rotations", "expression", "dynamic_offset"):
        assert len({getattr(frame, name).data_ptr() for frame in frames}) == 1


def test_a_sequence_gives_batches(dataset):
    sequence = open_sequence(dataset)
    batch = sequence.batch((4, 1))
    assert batch.batch_shape == (2,)
    for row, index in enumerate((4, 1)):
        frame = sequence.frames[index].parameters
        for name in ("translation", "rotations", "expression"):
            assert torch.equal(getattr(batch[row], name), getattr(frame, name))


def test_the_template_may_come_from_elsewhere(dataset, tmp_path):
    (dataset / "template.npz").rename(tmp_path / "flame.npz")
    assert open_sequence(dataset, flame=tmp_path / "flame.npz").template_path == tmp_path / "flame.npz"


WITH_TEETH = FLAME_VERTICES + TEETH_VERTICES


def stand_in(vertices):
    """What of a template a parameter file is measured by."""
    return SimpleNamespace(
        v_template=np.zeros((vertices, 3)),
        n_expression=4,
        n_shape=2,
        names_expressions=True,
        joint_names=FLAME_JOINTS,
    )


@pytest.mark.parametrize("vertices", [FLAME_VERTICES, WITH_TEETH])
@pytest.mark.parametrize("rows", [FLAME_VERTICES, WITH_TEETH])
def test_flames_teeth_are_added_or_left_out(dataset, vertices, rows):
    path = dataset / "canonical_flame_param.npz"
    offset = np.random.default_rng(0).normal(size=(1, rows, 3)).astype(np.float32)
    change_arrays(path, static_offset=offset)
    ours = read_parameter_file(path, stand_in(vertices)).static_offset.numpy()
    assert ours.shape == (vertices, 3)
    common = min(rows, vertices)
    np.testing.assert_array_equal(ours[:common], offset[0, :common])
    assert not ours[common:].any()


@pytest.mark.parametrize("rows", [FLAME_VERTICES - 1, WITH_TEETH + 1])
def test_an_offset_of_any_other_count_is_refused(dataset, rows):
    path = dataset / "canonical_flame_param.npz"
    change_arrays(path, static_offset=np.zeros((1, rows, 3), np.float32))
    with pytest.raises(UserError, match=rf"static_offset: expected .*{FLAME_VERTICES}.* found .*{rows}"):
        read_parameter_file(path, stand_in(FLAME_VERTICES))


@pytest.mark.subject
def test_the_real_subject(subject):
    listing = open_listing(subject)
    document = json.loads((subject / "transforms_test.json").read_text())
    assert len(listing.test) == len(document["frames"])


# --- lists as other systems and other recordings write them


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_lists_with_a_byte_order_mark_are_read(dataset, encoding):
    for name in PARTS:
        (dataset / name).write_text((dataset / name).read_text(), encoding=encoding)
    assert len(open_sequence(dataset).frames) == 6


def test_backslashes_are_slashes(dataset):
    paths = ("file_path", "fg_mask_path", "flame_param_path")
    change_every_entry(
        dataset, lambda entry: entry.update({key: entry[key].replace("/", "\\") for key in paths})
    )
    before, after = open_listing(dataset), open_listing(dataset)
    assert [frame.image_path for frame in after.frames] == [frame.image_path for frame in before.frames]
    assert all(frame.mask_path.is_file() for frame in after.frames)


@pytest.fixture
def union(tiny_dataset, tmp_path):
    """Two recordings of one person, listed as GaussianAvatars lists them: names of pictures repeat."""
    root = tmp_path / "UNION"
    root.mkdir()
    for name in ("EMO-1", "EXP-2"):
        shutil.copytree(tiny_dataset, tmp_path / name)
    for name in ("template.npz", "canonical_flame_param.npz"):
        shutil.copy(tiny_dataset / name, root / name)
    for part in PARTS:
        frames = []
        for number, name in enumerate(("EMO-1", "EXP-2")):
            for entry in json.loads((tiny_dataset / part).read_text())["frames"]:
                paths = {
                    key: f"../{name}/{entry[key]}"
                    for key in ("file_path", "fg_mask_path", "flame_param_path")
                }
                frames.append({**entry, **paths, "timestep_index": entry["timestep_index"] + 6 * number})
        (root / part).write_text(json.dumps({"frames": frames}))
    return root


def test_a_union_of_recordings_names_its_frames_apart(union, tiny_dataset):
    sequence, alone = open_sequence(union), open_sequence(tiny_dataset)
    names = [frame.name for frame in alone.frames]
    expected = [f"{recording}_{name}" for recording in ("EMO-1", "EXP-2") for name in names]
    assert [frame.name for frame in sequence.frames] == expected
    assert (len(sequence.train), len(sequence.test)) == (2 * len(alone.train), 2 * len(alone.test))
    for frame in sequence.frames:
        assert frame.image_path.resolve().parent.parent.name == frame.name.split("_")[0]
    with_albedo = [frame.albedo_path is not None for frame in alone.frames]
    assert [frame.albedo_path is not None for frame in sequence.frames] == 2 * with_albedo


def test_one_recording_twice_in_a_list_is_refused(dataset):
    change_every_list(dataset, lambda document: document["frames"].append(document["frames"][0]))
    with pytest.raises(UserError, match="image names that differ"):
        open_listing(dataset, split="0.5")
