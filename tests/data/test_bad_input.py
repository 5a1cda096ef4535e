"""What a dataset can have wrong, one by one: found on opening, and named with what was expected and what was
found."""

import json
import os
import shutil

import numpy as np
import pytest
import torch
from data.damage import change_arrays, change_json, cut, widen, with_value

from samira_warp.data import open_listing, open_sequence
from samira_warp.io.images import write_png
from samira_warp.support.errors import UserError


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


def refused(root, **options):
    with pytest.raises(UserError) as caught:
        open_sequence(root, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert ": expected " in message
    assert ", found " in message
    return message


def document(change):
    return lambda path: change_json(path, change)


def entry(**values):
    """Change the second entry's values."""
    return document(lambda d: d["frames"][1].update(values))


def missing(*keys):
    """Take keys away from the second entry and the top of the file."""

    def change(d):
        for key in keys:
            d["frames"][1].pop(key, None)
            d.pop(key, None)

    return document(change)


def arrays(**changes):
    return lambda path: change_arrays(path, **changes)


def text(content):
    return lambda path: path.write_text(content)


def skewed():
    matrix = np.eye(4)
    matrix[0, 1] = 0.1
    return matrix.tolist()


def scaled():
    return np.diag([2.0, 2.0, 2.0, 1.0]).tolist()


def mirrored():
    return np.diag([-1.0, 1.0, 1.0, 1.0]).tolist()


def matrix_with(value):
    matrix = np.eye(4).tolist()
    matrix[0][3] = value
    return matrix


LIST, TEST = "transforms_train.json", "transforms_test.json"
PLACE = "frames[1]"
# what is wrong: (file, how it came about, what the message says besides the file's path)
LISTS = {
    "no list of training frames": (LIST, os.unlink, "no such file"),
    "no list of test frames": (TEST, os.unlink, "no such file"),
    "an empty file": (LIST, text(""), "JSON"),
    "no JSON": (LIST, text("{"), "JSON"),
    "no text": (LIST, lambda path: path.write_bytes(b"\xff\xfe\x00"), "JSON"),
    "a list at the top": (LIST, text("[]"), "expected a JSON object, found list"),
    "no frames": (LIST, document(lambda d: d.pop("frames")), "'frames'"),
    "frames that are no list": (LIST, document(lambda d: d.update(frames={})), "'frames'"),
    "an empty training split": (LIST, document(lambda d: d["frames"].clear()), "at least one frame"),
    "an empty test split": (TEST, document(lambda d: d["frames"].clear()), "at least one frame"),
    "a frame that is no object": (
        LIST,
        document(lambda d: d["frames"].insert(1, "00001_00.png")),
        f"{PLACE}, found str",
    ),
    "no file_path": (LIST, missing("file_path"), f"{PLACE}: expected the key file_path"),
    "no flame_param_path": (LIST, missing("flame_param_path"), f"{PLACE}: expected the key flame_param_path"),
    "no timestep_index": (LIST, missing("timestep_index"), f"{PLACE}: expected the key timestep_index"),
    "no transform_matrix": (LIST, missing("transform_matrix"), f"{PLACE}: expected the key transform_matrix"),
    "no w": (LIST, missing("w"), f"{PLACE}: expected the key w"),
    "no h": (LIST, missing("h"), f"{PLACE}: expected the key h"),
    "neither focal length nor field of view": (
        LIST,
        missing("fl_x", "fl_y", "camera_angle_x"),
        "the key camera_angle_x",
    ),
    "a path that is none": (LIST, entry(file_path=3), "file_path to be a path, found 3"),
    "a null path": (LIST, entry(flame_param_path=None), "flame_param_path to be a path, found None"),
    "a timestep in words": (LIST, entry(timestep_index="1"), "timestep_index to be a"),
    "a timestep between two": (LIST, entry(timestep_index=0.5), "timestep_index to be a whole number"),
    "a width in words": (LIST, entry(w="32"), "w to be a positive number, found '32'"),
    "no width": (LIST, entry(w=0), "w to be a positive number"),
    "a height below zero": (LIST, entry(h=-32), "h to be a positive number"),
    "half a pixel": (LIST, entry(w=32.5), "w to be a whole number"),
    "a width that is true": (LIST, entry(w=True), "w to be a positive number"),
    "a focal length of zero": (LIST, entry(fl_x=0), "fl_x to be a positive number"),
    "a focal length below zero": (LIST, entry(fl_y=-90.0), "fl_y to be a positive number"),
    "a focal length of NaN": (LIST, entry(fl_x=float("nan")), "fl_x to be a positive number"),
    "an infinite principal point": (LIST, entry(cx=float("inf")), "cx to be a finite number"),
    "a null principal point": (LIST, entry(cy=None), "cy to be a finite number"),
    "a matrix of 3 x 4": (LIST, entry(transform_matrix=np.eye(4)[:3].tolist()), "shape (4, 4), found (3, 4)"),
    "a ragged matrix": (LIST, entry(transform_matrix=[[1.0], [1.0, 2.0]]), "4 x 4 matrix"),
    "a matrix in words": (LIST, entry(transform_matrix="identity"), "4 x 4 matrix"),
    "a null matrix": (LIST, entry(transform_matrix=None), "4 x 4 matrix"),
    "NaN in a matrix": (
        LIST,
        entry(transform_matrix=matrix_with(float("nan"))),
        "finite numbers in transform_matrix",
    ),
    "a skewed camera": (LIST, entry(transform_matrix=skewed()), "transform_matrix: expected a rotation"),
    "a scaled camera": (LIST, entry(transform_matrix=scaled()), "transform_matrix: expected a rotation"),
    "a mirrored camera": (LIST, entry(transform_matrix=mirrored()), "transform_matrix: expected a rotation"),
}
FIELD_OF_VIEW = {"zero": 0.0, "a half turn": 3.1416, "NaN": float("nan"), "words": "wide"}
PICTURES = {
    "no image": ("images/00001_00.png", os.unlink, "file_path of frames[1], found no such file"),
    "no mask": ("fg_masks/00001_00.png", os.unlink, "fg_mask_path of frames[1], found no such file"),
    "a wider image": (
        "images/00001_00.png",
        widen,
        "32 x 32 pixels as transforms_train.json says, found 64 x 32",
    ),
    "a wider mask": ("fg_masks/00001_00.png", widen, "found 64 x 32"),
    "a wider albedo": ("albedo/00001_00.png", widen, "found 64 x 32"),
    "a wider test image": (
        "images/00005_00.png",
        widen,
        "32 x 32 pixels as transforms_test.json says, found 64 x 32",
    ),
    "a flat mask": (
        "fg_masks/00002_00.png",
        lambda path: write_png(path, np.ones((16, 24))),
        "found 24 x 16",
    ),
    "an empty image": ("images/00001_00.png", lambda path: path.write_bytes(b""), "PNG"),
    "an image that is text": ("images/00001_00.png", text("hello"), "PNG"),
    "a mask that is text": ("fg_masks/00001_00.png", text("hello"), "PNG"),
    "an albedo that is text": ("albedo/00001_00.png", text("hello"), "PNG"),
    "an image cut off in its pixels": ("images/00001_00.png", lambda path: cut(path, end=40), "whole PNG"),
}
FIRST, CANONICAL, TEMPLATE = "flame_param/00000.npz", "canonical_flame_param.npz", "template.npz"
SHAPES = {
    "translation": 3,
    "rotation": 3,
    "neck_pose": 3,
    "jaw_pose": 3,
    "eyes_pose": 6,
    "expr": 4,
    "shape": 2,
}
PARAMETERS = {
    "no parameters": (FIRST, os.unlink, "flame_param_path of frames[0], found no such file"),
    "parameters that are no archive": (FIRST, lambda path: path.write_bytes(b"zip?"), ".npz of plain arrays"),
    "empty parameters": (FIRST, lambda path: path.write_bytes(b""), ".npz of plain arrays"),
    "parameters cut off": (FIRST, lambda path: cut(path, end=100), ".npz of plain arrays"),
    "pickled parameters": (
        FIRST,
        arrays(expr=lambda a: np.array([{"expr": a}], dtype=object)),
        f"{FIRST}: expr: expected an .npz of plain arrays",
    ),
    "one array where an archive should be": (
        FIRST,
        lambda path: np.save(path.open("wb"), np.zeros(3)),
        ".npz of plain arrays",
    ),
    "an empty archive": (FIRST, lambda path: np.savez(path), "an empty archive"),
    "another identity": (
        FIRST,
        arrays(shape=lambda a: a + 1),
        f"shape: expected the identity of {CANONICAL}",
    ),
    "an offset of another count": (
        FIRST,
        arrays(static_offset=np.zeros((1, 7, 3), np.float32)),
        "found float32 of shape (1, 7, 3)",
    ),
    "an offset of another rank": (
        FIRST,
        arrays(dynamic_offset=np.zeros((7, 3), np.float32)),
        "found float32 of shape (7, 3)",
    ),
    "infinity in the parameters": (
        FIRST,
        arrays(translation=with_value(np.inf)),
        "translation: expected finite numbers, found 1",
    ),
    "words for numbers": (
        FIRST,
        arrays(expr=lambda a: a.astype(str)),
        "expr: expected numbers of shape (1, 4)",
    ),
    "complex numbers": (
        FIRST,
        arrays(expr=lambda a: a.astype(np.complex64)),
        "expr: expected numbers of shape (1, 4)",
    ),
    "no canonical parameters": (CANONICAL, os.unlink, "no such file"),
    "no shape in the canonical parameters": (CANONICAL, arrays(shape=None), "the key shape"),
    "NaN in the canonical parameters": (
        CANONICAL,
        arrays(jaw_pose=with_value(np.nan)),
        "jaw_pose: expected finite numbers",
    ),
}
for _key, _size in SHAPES.items():
    PARAMETERS[f"no {_key}"] = (FIRST, arrays(**{_key: None}), f"the key {_key}")
    PARAMETERS[f"too short a {_key}"] = (
        FIRST,
        arrays(**{_key: lambda a: a[..., :-1]}),
        f"{_key}: expected numbers of shape",
    )
    PARAMETERS[f"NaN in {_key}"] = (
        FIRST,
        arrays(**{_key: with_value(np.nan)}),
        f"{_key}: expected finite numbers, found 1",
    )
TEMPLATES = {
    "a template that is no archive": (TEMPLATE, text("hello"), "npz"),
    "a template of other vertices": (
        TEMPLATE,
        arrays(v_template=lambda a: a[:-1]),
        "shapedirs: expected shape",
    ),
    "NaN in the template": (
        TEMPLATE,
        arrays(v_template=with_value(np.nan)),
        "v_template: expected finite numbers",
    ),
    "faces beyond the vertices": (TEMPLATE, arrays(f=lambda a: a + 1000), "f: expected integers"),
    "a mask beyond the vertices": (
        TEMPLATE,
        arrays(mask_face=lambda a: a + 1000),
        "mask_face: expected integers",
    ),
    "weights that do not sum to 1": (
        TEMPLATE,
        arrays(weights=lambda a: 2 * a),
        "weights: expected rows that sum to 1",
    ),
    "more identity than shapes": (TEMPLATE, arrays(n_shape=np.int64(99)), "n_shape: expected integers"),
}
for _key in (
    "v_template",
    "shapedirs",
    "n_shape",
    "posedirs",
    "J_regressor",
    "kintree_table",
    "weights",
    "f",
    "vt",
    "ft",
):
    TEMPLATES[f"a template without {_key}"] = (TEMPLATE, arrays(**{_key: None}), f"{_key}: expected")
DAMAGES = LISTS | PICTURES | PARAMETERS | TEMPLATES


@pytest.mark.parametrize("name", DAMAGES)
def test_a_fault_is_found_on_opening_and_named(dataset, capfd, name):
    file, damage, fragment = DAMAGES[name]
    damage(dataset / file)
    message = refused(dataset)
    assert str(dataset / file) in message
    assert fragment in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", LISTS | PICTURES)
def test_scoring_finds_the_same_faults_in_what_it_reads(dataset, name):
    file, damage, fragment = DAMAGES[name]
    damage(dataset / file)
    with pytest.raises(UserError) as caught:
        open_listing(dataset)
    assert str(dataset / file) in str(caught.value)
    assert fragment in str(caught.value)


@pytest.mark.parametrize("name", FIELD_OF_VIEW)
def test_fields_of_view_that_no_camera_has(dataset, name):
    def change(d):
        for key in ("fl_x", "fl_y"):
            d["frames"][1].pop(key)
            d.pop(key)
        d["frames"][1]["camera_angle_x"] = FIELD_OF_VIEW[name]

    change_json(dataset / LIST, change)
    message = refused(dataset)
    assert str(dataset / LIST) in message
    assert f"{PLACE}: expected camera_angle_x" in message


@pytest.mark.parametrize("folder", ["images", "fg_masks", "flame_param"])
def test_a_missing_folder_is_seen_in_its_first_file(dataset, folder):
    shutil.rmtree(dataset / folder)
    assert f"{dataset / folder}{os.sep}" in refused(dataset)


def test_no_dataset_at_all(tmp_path):
    assert f"{tmp_path / 'nowhere'}: expected a dataset's folder, found no such folder" in refused(
        tmp_path / "nowhere"
    )


def test_a_dataset_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    assert "found a file" in refused(tmp_path / "file")


def test_a_folder_of_another_format_says_what_was_looked_for(tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    message = refused(tmp_path)
    assert f"{tmp_path}: expected a dataset" in message
    for mark in (
        f"{CANONICAL} (VHAP export)",
        "tracked_params.json",
        "flame_params.json",
        "checkpoint/*.frame",
        "tracked_flame_params*.npz",
    ):
        assert mark in message


def test_a_dataset_within_the_folder_is_pointed_at(dataset):
    assert f"the folder {dataset.name} in it is a dataset" in refused(dataset.parent)


def test_no_template_asks_for_one(dataset):
    (dataset / TEMPLATE).unlink()
    message = refused(dataset)
    assert str(dataset / TEMPLATE) in message
    assert "--flame FILE" in message


def test_a_flame_file_that_is_missing_is_named(dataset, tmp_path):
    (dataset / TEMPLATE).unlink()
    assert f"{tmp_path / 'flame2023.npz'}: expected" in refused(dataset, flame=tmp_path / "flame2023.npz")


def test_a_frame_that_trains_and_tests(dataset):
    first = json.loads((dataset / LIST).read_text())["frames"][0]
    change_json(dataset / TEST, lambda d: d["frames"].append(first))
    message = refused(dataset)
    assert str(dataset / TEST) in message
    assert "00000_00 in both" in message


def test_two_images_of_one_name(dataset):
    """Outputs carry the image's stem: a second one would overwrite the first."""
    change_json(dataset / LIST, lambda d: d["frames"].append(d["frames"][0]))
    message = refused(dataset)
    assert "image names that differ" in message
    assert "00000_00" in message


@pytest.mark.parametrize(
    ("split", "fragment"),
    [
        ("half", "'half'"),
        ("1.5", "'1.5'"),
        ("last:0", "'last:0'"),
        ("last:6", "an empty part of 6 timesteps"),
        ("0.01", "an empty part"),
    ],
)
def test_a_split_that_cannot_be(dataset, split, fragment):
    message = refused(dataset, split=split)
    assert "--split" in message
    assert fragment in message


def test_a_split_of_the_users_without_the_whole_list(dataset):
    (dataset / "transforms.json").unlink()
    assert str(dataset / "transforms.json") in refused(dataset, split="0.5")


def test_entries_that_nobody_needs_change_nothing(dataset, tiny_dataset):
    pickled = np.array([{"tracker": "VHAP"}], dtype=object)
    for path in (*dataset.glob("flame_param/*.npz"), dataset / CANONICAL, dataset / TEMPLATE):
        change_arrays(path, config=pickled, note=np.array("by hand"))
    ours, plain = open_sequence(dataset), open_sequence(tiny_dataset)
    assert ours.template.hash == plain.template.hash
    assert torch.equal(ours.shape, plain.shape)
    first, second = (sequence.batch(range(6)) for sequence in (ours, plain))
    for name in ("translation", "rotations", "expression"):
        assert torch.equal(getattr(first, name), getattr(second, name))
