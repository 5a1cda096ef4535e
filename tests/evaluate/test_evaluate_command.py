"""``python -m samira_warp.evaluate`` from its options to one JSON object."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from data.damage import change_json, cut
from subjects import write_lpips_weights
from warm_start import warm_python

from samira_warp.evaluate.__main__ import EvaluateConfig, main
from samira_warp.io.images import read_image, write_png
from samira_warp.support.cli import run

NAMES = [f"{index:05d}_00" for index in range(6)]


@pytest.fixture(autouse=True)
def no_weights(monkeypatch, tmp_path):
    """What this machine has in its caches is no part of the tests."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


@pytest.fixture
def predictions(dataset, tmp_path):
    """The dataset's pictures, darker by a known gain per channel."""
    folder = tmp_path / "pred"
    folder.mkdir()
    for name in NAMES:
        write_png(
            folder / f"{name}.png",
            read_image(dataset / "images" / f"{name}.png", channels=3) * np.array([0.8, 0.9, 0.7]),
        )
    return folder


def evaluate(*arguments):
    return run(
        main, EvaluateConfig, program="python -m samira_warp.evaluate", arguments=[*map(str, arguments)]
    )


def scores(capsys, *arguments):
    capsys.readouterr()
    assert evaluate(*arguments) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return json.loads(captured.out)


def refused(capsys, *arguments):
    capsys.readouterr()
    assert evaluate(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_one_json_object(dataset, predictions, capsys):
    result = scores(capsys, "--pred", predictions, "--data", dataset)
    assert list(result["frames"]) == NAMES[4:]
    ours, theirs = (
        read_image(folder / f"{NAMES[4]}.png", channels=3).astype(float)
        for folder in (predictions, dataset / "images")
    )
    first = result["frames"][NAMES[4]]
    assert first["psnr"] == pytest.approx(-10 * np.log10(((ours - theirs) ** 2).mean()), abs=1e-4)
    assert first["l1"] == pytest.approx(100 * np.abs(ours - theirs).mean(), rel=1e-5)
    # what a gain per channel leaves is 8 bits' rounding, of variance 1/12 of a level and stretched by at most
    # 1/0.7: 56 dB
    assert first["psnr_foreground"] < 25 < 54 < first["psnr_gain"]
    assert result["lpips"] is None
    assert str(result["lpips_reason"]).startswith("alexnet")
    protocol = result["protocol"]
    assert (protocol["split"], protocol["bits"], protocol["background"], protocol["frames"]) == (
        "dataset",
        "8-bit files",
        "white",
        2,
    )


def test_the_datasets_own_pictures_are_perfect(dataset, capsys):
    result = scores(capsys, "--pred", dataset / "images", "--data", dataset, "--split", "0.5")
    assert list(result["frames"]) == NAMES[3:]
    assert result["psnr"] == pytest.approx(100.0)
    assert result["ssim"] == pytest.approx(1.0)
    assert result["protocol"]["split"] == "0.5"


def test_truth_from_a_folder(dataset, predictions, capsys):
    result = scores(capsys, "--pred", predictions, "--data", dataset, "--truth", predictions)
    assert list(result["frames"]) == NAMES
    assert result["psnr"] == pytest.approx(100.0)
    assert str(predictions) in result["protocol"]["truth"]


def test_albedo_is_compared_with_the_datasets_truth(dataset, predictions, capsys):
    shutil.copytree(dataset / "images", dataset / "gt" / "albedo")
    shutil.copytree(predictions, predictions / "albedo")
    result = scores(capsys, "--pred", predictions, "--data", dataset, "--layer", "albedo")
    assert {"ssim_foreground", "l1_foreground", "psnr_gain"} <= set(result)
    assert len(result["frames"]) == 6


def test_normals_of_a_known_angle(dataset, tmp_path, capsys):
    for folder, angle in (("pred", 30.0), ("truth", 0.0)):
        (tmp_path / folder).mkdir(exist_ok=True)
        normal = [np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))]
        write_png(
            tmp_path / folder / f"{NAMES[0]}.png", np.broadcast_to((np.array(normal) + 1) / 2, (32, 32, 3))
        )
    result = scores(
        capsys,
        "--pred",
        tmp_path / "pred",
        "--data",
        dataset,
        "--truth",
        tmp_path / "truth",
        "--layer",
        "normal",
    )
    # a level of 8 bits is 2/255 of a unit vector, 0.45 degrees; half of it on each axis of both
    assert result["normal_angle"] == pytest.approx(30.0, abs=0.45)
    assert "psnr" not in result


def test_regions(dataset, predictions, capsys):
    regions = dataset / "parse"
    regions.mkdir()
    (dataset / "parse.json").write_text('{"1": "face", "2": "hair"}')
    labels = np.zeros((32, 32), np.uint8)
    labels[10:20, 10:20] = 1
    for name in NAMES:
        write_png(regions / f"{name}.png", labels)
    result = scores(capsys, "--pred", predictions, "--data", dataset, "--regions", regions)
    assert set(result["regions"]) == {"face"}
    ours, theirs = (
        read_image(folder / f"{NAMES[4]}.png", channels=3) for folder in (predictions, dataset / "images")
    )
    expected = -10 * np.log10(((ours - theirs)[10:20, 10:20].astype(float) ** 2).mean())
    assert result["frames"][NAMES[4]]["regions"]["face"]["psnr"] == pytest.approx(expected, abs=1e-4)


def test_lpips_with_weights_of_the_users(dataset, predictions, tmp_path, capsys):
    weights = write_lpips_weights(tmp_path / "weights", "alex")
    result = scores(capsys, "--pred", predictions, "--data", dataset, "--lpips-weights", weights)
    assert result["lpips"] > 0
    assert "lpips_reason" not in result
    assert result["protocol"]["lpips_net"].startswith("alex")
    absent = scores(
        capsys, "--pred", predictions, "--data", dataset, "--lpips-weights", weights, "--lpips-net", "vgg"
    )
    assert absent["lpips"] is None
    assert "vgg16" in absent["lpips_reason"]


def test_without_masks_the_foreground_is_null(dataset, predictions, capsys):
    for name in ("transforms_train.json", "transforms_test.json"):
        change_json(dataset / name, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"]])
    result = scores(capsys, "--pred", predictions, "--data", dataset)
    assert result["psnr_foreground"] is result["psnr_gain"] is None


MISTAKES = {
    "no dataset": (lambda root, pred: ["--data", root / "nowhere"], "nowhere: expected a dataset's folder"),
    "no predictions": (
        lambda root, pred: ["--pred", root / "nowhere"],
        "nowhere: expected a folder of images",
    ),
    "no truth": (lambda root, pred: ["--truth", root / "nowhere"], "nowhere: expected a folder of images"),
    "truth of other names": (lambda root, pred: ["--truth", root], "expected images, found none"),
    "no regions": (lambda root, pred: ["--regions", root / "nowhere"], "nowhere"),
    "no names of regions": (lambda root, pred: ["--regions", root / "images"], "parse.json"),
    "no weights": (
        lambda root, pred: ["--lpips-weights", root / "nowhere"],
        "nowhere: expected a folder of LPIPS weights",
    ),
    "no true albedo": (lambda root, pred: ["--layer", "albedo"], "the dataset's true albedo, or --truth DIR"),
    "no true normals": (
        lambda root, pred: ["--layer", "normal"],
        "the dataset's true normal, or --truth DIR",
    ),
    "a bad split": (lambda root, pred: ["--split", "half"], "--split: expected"),
    "an empty split": (lambda root, pred: ["--split", "last:6"], "an empty part"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_in_the_options(dataset, predictions, capsys, name):
    change, fragment = MISTAKES[name]
    options = {"--pred": predictions, "--data": dataset}
    changes = change(dataset, predictions)
    options |= dict(zip(changes[::2], changes[1::2], strict=True))
    assert fragment in refused(capsys, *(word for option in options.items() for word in option))


def damage_prediction(kind, path):
    match kind:
        case "missing":
            path.unlink()
        case "text":
            path.write_text("hello")
        case "cut":
            cut(path)
        case "a folder":
            path.unlink()
            path.mkdir()


@pytest.mark.parametrize("kind", ["missing", "text", "cut", "a folder"])
@pytest.mark.parametrize("which", ["prediction", "picture", "mask"])
def test_images_that_cannot_be_read(dataset, predictions, capsys, which, kind):
    folder = {"prediction": predictions, "picture": dataset / "images", "mask": dataset / "fg_masks"}[which]
    path = folder / f"{NAMES[5]}.png"
    damage_prediction(kind, path)
    assert str(path) in refused(capsys, "--pred", predictions, "--data", dataset)


@pytest.mark.parametrize("option", [("--layer", "depth"), ("--lpips-net", "squeeze"), ("--predictions", "x")])
def test_options_that_do_not_exist(dataset, predictions, capsys, option):
    with pytest.raises(SystemExit) as caught:
        evaluate("--pred", predictions, "--data", dataset, *option)
    assert caught.value.code == 2
    assert capsys.readouterr().out == ""


def process(*arguments, python):
    command = [*python, "-m", "samira_warp.evaluate", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_process_prints_json(dataset, predictions):
    done = process("--pred", predictions, "--data", dataset, python=[sys.executable])
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["psnr"] > 0


def test_the_process_says_one_line(dataset, predictions):
    cut(predictions / f"{NAMES[5]}.png")
    done = process("--pred", predictions, "--data", dataset, python=warm_python())
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"error: {predictions / NAMES[5]}.png: expected a whole PNG image, found ")
    assert done.stderr.count("\n") == 1
