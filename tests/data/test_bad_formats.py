"""What a tracker's folder can have wrong: found on opening, and named with its file, what was expected and
what was found."""

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from data.damage import change_arrays, change_json, with_value
from data.layouts import make_film_for, write_layout
from data.tiny import tiny_template
from PIL import Image

from samira_warp.data import open_listing, open_sequence
from samira_warp.support.errors import UserError


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("originals")
    for layout in ("VHAP tracked", "metrical-tracker", "HRAvatar v1", "IMavatar"):
        film = make_film_for(layout)
        film.eyelids = None
        write_layout(layout, film, folder / layout)
        np.savez(folder / layout / "template.npz", **tiny_template())
    return folder


def document(change):
    return lambda path: change_json(path, change)


def arrays(**changes):
    return lambda path: change_arrays(path, **changes)


def payload(*keys, value=None):
    """Set or take away one entry of a checkpoint."""

    def change(path):
        content = torch.load(path, weights_only=False)
        inner = content
        for key in keys[:-1]:
            inner = inner[key]
        if value is None:
            del inner[keys[-1]]
        else:
            inner[keys[-1]] = value
        torch.save(content, path)

    return change


class Calls:
    def __reduce__(self):
        return os.system, ("true",)


def mirrored():
    return np.diag([-1.0, 1.0, 1.0])[None].astype(np.float32)


NPZ, FRAME = "tracked_flame_params_30.npz", "checkpoint/00002.frame"
TRACKED, FLAME = "tracked_params.json", "flame_params.json"
ENTRY = "00002"
SIZES = {"expr": 4, "rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "translation": 3}
longer = arrays(timestep_id=None, **{key: np.zeros((9, size)) for key, size in SIZES.items()})
# layout, what is wrong: file, how it came about, what the message says besides the file's path
FAULTS = {
    ("VHAP tracked", "no focal length"): (
        NPZ,
        arrays(focal_length=None),
        "expected the key focal_length, found none: the cameras were calibrated",
    ),
    ("VHAP tracked", "a focal length of zero"): (
        NPZ,
        arrays(focal_length=np.zeros(1)),
        "focal_length: expected a positive number, found 0.0",
    ),
    ("VHAP tracked", "no jaw"): (NPZ, arrays(jaw_pose=None), "expected the key jaw_pose"),
    ("VHAP tracked", "fewer necks"): (
        NPZ,
        arrays(neck_pose=lambda a: a[:-1]),
        "neck_pose: expected numbers of shape (6, 3), found float32 of shape (5, 3)",
    ),
    ("VHAP tracked", "NaN"): (
        NPZ,
        arrays(expr=with_value(np.nan)),
        "expr: expected finite numbers, found 1 that are not",
    ),
    ("VHAP tracked", "no shape"): (
        NPZ,
        arrays(shape=None),
        "shape: expected a vector of numbers, found none",
    ),
    ("VHAP tracked", "too few pictures"): (
        NPZ,
        longer,
        "expected 9 pictures, one a tracked timestep, found 6",
    ),
    ("VHAP tracked", "no archive"): (NPZ, lambda path: path.write_bytes(b"hello"), ".npz of plain arrays"),
    ("VHAP tracked", "an offset of another head"): (
        NPZ,
        arrays(static_offset=np.zeros((1, 9, 3))),
        "static_offset: expected numbers of shape (1, ",
    ),
    ("metrical-tracker", "no archive"): (
        FRAME,
        lambda path: path.write_bytes(b"hello"),
        "expected an archive of torch.save (torch 1.6 or later)",
    ),
    ("metrical-tracker", "a cut archive"): (
        FRAME,
        lambda path: path.write_bytes(path.read_bytes()[:300]),
        "expected an archive of torch.save",
    ),
    ("metrical-tracker", "a call"): (
        FRAME,
        lambda path: torch.save({"flame": Calls()}, path),
        "found the name posix.system, which is not loaded",
    ),
    ("metrical-tracker", "a pickle"): (
        FRAME,
        lambda path: path.write_bytes(pickle.dumps({})),
        "expected an archive of torch.save",
    ),
    ("metrical-tracker", "no flame"): (FRAME, payload("flame"), "expected the key flame, found none"),
    ("metrical-tracker", "no expression"): (FRAME, payload("flame", "exp"), "expected the key exp"),
    ("metrical-tracker", "a short jaw"): (
        FRAME,
        payload("flame", "jaw", value=np.zeros((1, 3))),
        "flame.jaw: expected numbers of shape (6,), found shape (1, 3)",
    ),
    ("metrical-tracker", "no turn"): (
        FRAME,
        payload("flame", "eyes", value=np.zeros((1, 12))),
        "flame.eyes: expected two rows of a rotation",
    ),
    ("metrical-tracker", "words"): (FRAME, payload("flame", "exp", value="smile"), "exp: expected an array"),
    ("metrical-tracker", "NaN"): (
        FRAME,
        payload("opencv", "t", value=np.full((1, 3), np.nan)),
        "opencv.t: expected finite numbers, found 3",
    ),
    ("metrical-tracker", "a mirrored camera"): (
        FRAME,
        payload("opencv", "R", value=mirrored()),
        "opencv.R: expected a rotation",
    ),
    ("metrical-tracker", "no focal length"): (
        FRAME,
        payload("opencv", "K", value=np.zeros((1, 3, 3))),
        "opencv.K: expected positive numbers",
    ),
    ("metrical-tracker", "another identity"): (
        FRAME,
        payload("flame", "shape", value=np.ones((1, 2))),
        "flame.shape: expected the identity of 00000.frame",
    ),
    ("metrical-tracker", "fewer expressions"): (
        FRAME,
        payload("flame", "exp", value=np.ones((1, 3))),
        "exp: expected 4 numbers in every frame, found 3 in one",
    ),
    ("HRAvatar v1", "no entries"): (
        TRACKED,
        lambda path: path.write_text("{}"),
        "expected an entry with fullposecode for each picture, found 0 others",
    ),
    ("HRAvatar v1", "no JSON"): (TRACKED, lambda path: path.write_text("{"), "a JSON file"),
    ("HRAvatar v1", "no shape"): (
        TRACKED,
        document(lambda d: d.pop("shapecode")),
        "shapecode: expected a vector of numbers, found none",
    ),
    ("HRAvatar v1", "no intrinsics"): (
        TRACKED,
        document(lambda d: d.pop("intrinsics")),
        "intrinsics: expected numbers of shape (4,), found none",
    ),
    ("HRAvatar v1", "no focal length"): (
        TRACKED,
        document(lambda d: d.update(intrinsics=[0, 1, 1, 1])),
        "intrinsics: expected [fx, fy, cx, cy] other than zero",
    ),
    ("HRAvatar v1", "no camera"): (
        TRACKED,
        document(lambda d: d[ENTRY].pop("world_mat")),
        "00002: world_mat: expected numbers of shape (3, 4), found none",
    ),
    ("HRAvatar v1", "a short pose"): (
        TRACKED,
        document(lambda d: d[ENTRY].update(fullposecode=[[0.0] * 6])),
        "00002: fullposecode: expected numbers of shape (15,)",
    ),
    ("HRAvatar v1", "words"): (
        TRACKED,
        document(lambda d: d[ENTRY].update(expcode="smile")),
        "00002: expcode: expected a vector of numbers",
    ),
    ("HRAvatar v1", "a ragged list"): (
        TRACKED,
        document(lambda d: d[ENTRY].update(expcode=[[1], [1, 2]])),
        "found rows of unequal length",
    ),
    ("HRAvatar v1", "fewer expressions"): (
        TRACKED,
        document(lambda d: d[ENTRY].update(expcode=[[1.0] * 3])),
        "expression: expected 4 numbers in every frame",
    ),
    ("HRAvatar v1", "infinity"): (
        TRACKED,
        document(lambda d: d[ENTRY].update(translation=[[float("inf"), 0, 0]])),
        "translation: expected finite numbers",
    ),
    ("IMavatar", "no frames"): (
        FLAME,
        document(lambda d: d.pop("frames")),
        "expected a list 'frames' of tracked frames, found none",
    ),
    ("IMavatar", "a frame that is a name"): (
        FLAME,
        document(lambda d: d["frames"].insert(2, "1")),
        "frames[2]: expected an object with a file_path, found str",
    ),
    ("IMavatar", "a scaled camera"): (
        FLAME,
        document(lambda d: d["frames"][2].update(world_mat=(2 * np.eye(4)).tolist())),
        "frames[2]: world_mat: expected a rotation",
    ),
    ("IMavatar", "no pose"): (
        FLAME,
        document(lambda d: d["frames"][2].pop("pose")),
        "frames[2]: pose: expected numbers of shape (15,), found none",
    ),
    ("IMavatar", "a frame twice"): (
        FLAME,
        document(lambda d: d["frames"].append(d["frames"][0])),
        "expected tracked frames that differ in name, found two named 00000",
    ),
}


def refused(root, open_it=open_sequence):
    with pytest.raises(UserError) as caught:
        open_it(root)
    message = str(caught.value)
    assert "\n" not in message
    assert ": expected " in message
    assert ", found " in message
    return message


@pytest.mark.parametrize(("layout", "name"), FAULTS)
def test_a_fault_is_named(originals, tmp_path, layout, name):
    file, damage, said = FAULTS[layout, name]
    root = shutil.copytree(originals / layout, tmp_path / "subject")
    damage(root / file)
    message = refused(root)
    assert said in message
    assert (
        str(root / file)
        if name != "fewer expressions" or layout == "HRAvatar v1"
        else str(root / Path(file).parent)
    ) in message


@pytest.mark.parametrize("layout", ["VHAP tracked", "metrical-tracker", "HRAvatar v1", "IMavatar"])
def test_faults_of_pictures(originals, tmp_path, layout):
    root = shutil.copytree(originals / layout, tmp_path / "subject")
    folder = next(root / name for name in ("images", "image") if (root / name).is_dir())
    picture = sorted(folder.iterdir())[2]
    whole = picture.read_bytes()
    picture.write_bytes(b"hello")
    assert str(picture) in refused(root, open_listing)
    picture.write_bytes(whole)
    double = picture.with_suffix(".webp")
    Image.open(picture).save(double)
    assert f"expected one picture of a name, found {min(picture, double).name} as well" in refused(
        root, open_listing
    )
    double.unlink()
    (root / "fg_masks").mkdir(exist_ok=True)
    masks = next(root / name for name in ("mask", "alpha_maps", "fg_masks") if (root / name).is_dir())
    mask = next(masks.glob(f"{picture.stem}.*"), masks / f"{picture.stem}.png")
    Image.new("L", (10, 10)).save(mask)
    message = refused(root, open_listing)
    assert str(mask) in message
    assert "or another size of that shape, found 10 x 10" in message
    for other in folder.iterdir():
        other.rename(other.with_stem(f"other {other.stem}"))
    if layout != "VHAP tracked":  # whose pictures may have names of their own
        found = "found none of 6; the first tracked frame is '00000'"
        assert f"expected pictures named as the tracked frames, {found}" in refused(root)
    shutil.rmtree(folder)
    assert "pictures" in refused(root)


def test_no_template_and_no_flame(originals, tmp_path):
    root = shutil.copytree(originals / "IMavatar", tmp_path / "subject")
    (root / "template.npz").unlink()
    assert "expected the dataset's own head template, or --flame FILE, found neither" in refused(root)


def test_instas_lists_must_name_what_is_there(originals, tmp_path):
    root = shutil.copytree(originals / "metrical-tracker", tmp_path / "subject")
    for part in ("train", "test"):
        (root / f"transforms_{part}.json").write_text('{"frames": [{"file_path": "images/999.png"}]}')
    assert f"{root}: expected frames that train and frames that test, found 0 of 0 that train" in refused(
        root
    )
    (root / "transforms_test.json").write_text('{"frames": [{"file_path": 3}]}')
    assert "transforms_test.json: expected a list 'frames' of objects with a file_path" in refused(root)
    (root / "transforms_test.json").write_text('{"frames": [{"file_path": "images/00001.png"}]}')
    assert "expected frames that train and frames that test, found 0 of 1" in refused(root)


class Trap:
    """Unpickled, it would say so."""

    def __reduce__(self):
        return pytest.fail, ("a pickle was loaded",)


EXTRA = {
    "tracker": np.array([Trap()], dtype=object),
    "n_processed_frames": np.int64(7),
    "note": np.array("by hand"),
}


def test_entries_that_nobody_needs_change_nothing(originals, tmp_path):
    root = shutil.copytree(originals / "VHAP tracked", tmp_path / "subject")
    for name in (NPZ, "template.npz"):
        change_arrays(root / name, **EXTRA)
    same_sequences(open_sequence(root), open_sequence(originals / "VHAP tracked"))


def same_sequences(first, second):
    assert first.template.hash == second.template.hash
    assert torch.equal(first.shape, second.shape)
    parameters = [sequence.batch(range(len(sequence.frames))) for sequence in (first, second)]
    for name in ("translation", "rotations", "expression"):
        assert torch.equal(*(getattr(each, name) for each in parameters))


@pytest.mark.parametrize("key", ["expr", "focal_length", "timestep_id", "static_offset", "pose_jaw"])
def test_an_entry_that_is_needed_and_cannot_be_read_is_named(originals, tmp_path, key):
    root = shutil.copytree(originals / "VHAP tracked", tmp_path / "subject")
    change_arrays(root / NPZ, **{key: np.array([Trap()], dtype=object)})
    assert f"{root / NPZ}: {key}: expected an .npz of plain arrays" in refused(root)
