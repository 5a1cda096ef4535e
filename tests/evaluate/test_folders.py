"""Which files are compared, and at which size."""

import shutil

import numpy as np
import pytest
from data.damage import change_json
from PIL import Image

from samira_warp.data import load_pixels, open_listing
from samira_warp.evaluate.folders import find_comparisons, read_pair, read_pairs, read_region_names
from samira_warp.io.images import read_image, resize_box, write_png
from samira_warp.support.errors import UserError

NAMES = [f"{index:05d}_00" for index in range(6)]


@pytest.fixture
def listing(tiny_dataset):
    return open_listing(tiny_dataset)


@pytest.fixture
def folder(tmp_path):
    """Makes folders of random images of given names."""
    random = np.random.default_rng(0)

    def make(name, stems, *, width=32, height=32, suffix=".png"):
        path = tmp_path / name
        path.mkdir(parents=True)
        for stem in stems:
            pixels = random.integers(0, 256, (height, width, 3), dtype=np.uint8)
            if suffix == ".png":
                write_png(path / f"{stem}.png", pixels)
            else:
                Image.fromarray(pixels).save(path / f"{stem}{suffix}")
        return path

    return make


def find(listing, predictions, truth=None, layer="image", regions=None):
    return find_comparisons(listing, predictions=predictions, truth=truth, layer=layer, regions=regions)


def test_without_truth_the_splits_frames_are_compared(tiny_dataset, folder):
    predictions = folder("pred", NAMES)
    for split, names in (("dataset", NAMES[4:]), ("train", NAMES[:4]), ("last:1", NAMES[5:])):
        found = find(open_listing(tiny_dataset, split=split), predictions)
        assert [comparison.frame.name for comparison in found] == names
        assert [comparison.prediction for comparison in found] == [
            predictions / f"{name}.png" for name in names
        ]
        assert {comparison.truth for comparison in found} == {None}


def test_with_truth_its_names_are_compared_whatever_the_split(listing, folder):
    truth = folder("truth", [NAMES[1], NAMES[4]])
    (truth / "readme.txt").write_text("not an image")
    found = find(listing, folder("pred", NAMES), truth)
    assert [comparison.frame.name for comparison in found] == [NAMES[1], NAMES[4]]
    assert [comparison.truth for comparison in found] == [
        truth / f"{NAMES[1]}.png",
        truth / f"{NAMES[4]}.png",
    ]


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg"])
def test_truth_may_be_jpeg(listing, folder, suffix):
    truth = folder("truth", NAMES[:1], suffix=suffix)
    assert find(listing, folder("pred", NAMES), truth)[0].truth == truth / f"{NAMES[0]}{suffix}"


def test_an_output_folder_of_render_has_one_folder_a_layer(listing, folder):
    images = folder("out/image", NAMES)
    albedo = folder("out/albedo", NAMES)
    out = images.parent
    assert find(listing, out)[0].prediction.parent == images
    assert find(listing, out, layer="albedo")[0].prediction.parent == albedo


def test_truth_is_box_resized_to_the_predictions_size(listing, folder):
    truth = folder("truth", NAMES[4:5], width=24, height=36)
    pair = read_pair(find(listing, folder("pred", NAMES, width=16, height=12), truth)[0], layer="image")
    assert pair.prediction.shape == pair.truth.shape == (12, 16, 3)
    assert pair.mask.shape == (12, 16)
    expected = resize_box(read_image(truth / f"{NAMES[4]}.png", channels=3), width=16, height=12)
    np.testing.assert_allclose(pair.truth.numpy(), expected, atol=1e-7)


def test_the_datasets_pictures_are_box_resized_too(listing, folder):
    pair = read_pair(find(listing, folder("pred", NAMES, width=20, height=20))[0], layer="image")
    pixels = load_pixels(listing.frames[4], width=20, height=20)
    np.testing.assert_array_equal(pair.truth.numpy(), pixels.image.numpy())
    np.testing.assert_array_equal(pair.mask.numpy(), pixels.mask.numpy())
    assert pair.labels is None
    assert pair.name == NAMES[4]


def test_alpha_is_laid_on_white(listing, folder):
    predictions, truth = folder("pred", NAMES), folder("truth", NAMES[4:5])
    rgba = np.zeros((32, 32, 4), np.uint8)
    rgba[..., 3] = 51
    for path in (predictions, truth):
        write_png(path / f"{NAMES[4]}.png", rgba)
    pair = read_pair(find(listing, predictions, truth)[0], layer="image")
    np.testing.assert_allclose(pair.prediction.numpy(), 0.8, atol=1e-6)
    np.testing.assert_allclose(pair.truth.numpy(), 0.8, atol=1e-6)


def test_normals_are_decoded(listing, folder):
    predictions, truth = folder("pred", NAMES), folder("truth", NAMES[4:5])
    pair = read_pair(find(listing, predictions, truth)[0], layer="normal")
    np.testing.assert_allclose(
        pair.prediction.numpy(), 2 * read_image(predictions / f"{NAMES[4]}.png", channels=3) - 1, atol=1e-6
    )
    np.testing.assert_allclose(
        pair.truth.numpy(), 2 * read_image(truth / f"{NAMES[4]}.png", channels=3) - 1, atol=1e-6
    )


def test_labels_keep_their_values_at_another_size(listing, folder):
    regions = folder("regions", [])
    labels = np.zeros((64, 64), np.uint8)
    labels[:, 31:] = 9  # the border lies within a new pixel: an average would be 4
    write_png(regions / f"{NAMES[4]}.png", labels)
    write_png(regions / f"{NAMES[5]}.png", labels)
    pair = read_pair(find(listing, folder("pred", NAMES), regions=regions)[0], layer="image")
    assert (pair.labels[:, :15] == 0).all()
    assert (pair.labels[:, 15:] == 9).all()
    assert pair.labels.shape == (32, 32)


def test_a_dataset_without_masks_has_none(tiny_dataset, tmp_path, folder):
    root = shutil.copytree(tiny_dataset, tmp_path / "subject")
    for name in ("transforms_train.json", "transforms_test.json"):
        change_json(root / name, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"]])
    pairs = list(read_pairs(find(open_listing(root), folder("pred", NAMES)), layer="image"))
    assert [pair.mask for pair in pairs] == [None, None]


def test_names_of_labels_here_or_one_folder_up(tmp_path):
    (tmp_path / "parse").mkdir()
    (tmp_path / "parse.json").write_text('{"1": "eye", "2": "lips"}')
    assert read_region_names(tmp_path / "parse") == {1: "eye", 2: "lips"}
    (tmp_path / "parse" / "parse.json").write_text('{"3": "ear"}')
    assert read_region_names(tmp_path / "parse") == {3: "ear"}


@pytest.mark.parametrize("content", ["", "{", "[]", '"eye"', "3", '{"eye": 1}'])
def test_names_that_are_none(tmp_path, content):
    (tmp_path / "parse.json").write_text(content)
    with pytest.raises(UserError, match="labels and their names") as caught:
        read_region_names(tmp_path)
    assert str(tmp_path / "parse.json") in str(caught.value)


def test_absent_names(tmp_path):
    with pytest.raises(UserError, match="one folder up") as caught:
        read_region_names(tmp_path)
    assert str(tmp_path / "parse.json") in str(caught.value)


@pytest.mark.parametrize("which", ["predictions", "truth", "regions"])
@pytest.mark.parametrize("kind", ["absent", "a file"])
def test_folders_that_are_none(listing, folder, tmp_path, which, kind):
    folders = {name: folder(name, NAMES) for name in ("predictions", "truth", "regions")}
    folders[which] = tmp_path / "other"
    if kind == "a file":
        folders[which].write_text("mine")
    with pytest.raises(UserError, match="no such folder" if kind == "absent" else "found a file") as caught:
        find_comparisons(listing, layer="image", **folders)
    assert str(folders[which]) in str(caught.value)


def test_a_missing_prediction(listing, folder):
    predictions = folder("pred", NAMES[:5])
    with pytest.raises(UserError, match="the frame's prediction, found no such file") as caught:
        find(listing, predictions)
    assert str(predictions / f"{NAMES[5]}.png") in str(caught.value)


def test_missing_labels(listing, folder):
    regions = folder("regions", NAMES[:5])
    with pytest.raises(UserError, match="the frame's region labels") as caught:
        find(listing, folder("pred", NAMES), regions=regions)
    assert str(regions / f"{NAMES[5]}.png") in str(caught.value)


def test_a_truth_folder_without_images(listing, folder):
    with pytest.raises(UserError, match="expected images, found none"):
        find(listing, folder("pred", NAMES), folder("truth", []))


def test_a_true_image_that_is_no_frames(listing, folder):
    truth = folder("truth", ["portrait"])
    with pytest.raises(UserError, match="the name of a frame") as caught:
        find(listing, folder("pred", NAMES), truth)
    assert str(truth / "portrait.png") in str(caught.value)


def test_labels_that_are_none(listing, folder):
    found = find(listing, folder("pred", NAMES), regions=folder("regions", NAMES))
    with pytest.raises(UserError, match="8-bit grey labels"):
        read_pair(found[0], layer="image")
