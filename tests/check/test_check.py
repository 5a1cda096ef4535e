"""``python -m samira_warp.check``."""

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from data.damage import change_arrays, change_json, cut, widen, with_value
from data.layouts import make_film_for, write_layout
from data.tiny import make_tiny_dataset, tiny_template
from PIL import Image

from samira_warp.check.__main__ import CheckConfig, main
from samira_warp.check.drawing import CELL, mesh_overlay
from samira_warp.check.facts import size_notes
from samira_warp.check.findings import MOST_ALIKE
from samira_warp.check.views import sampled_views
from samira_warp.data import open_listing, open_sequence
from samira_warp.data.pixels import load_pixels
from samira_warp.io.images import read_image, write_png
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError
from samira_warp.train.config import TrainConfig


@pytest.fixture
def dataset(tiny_dataset, tmp_path):
    return shutil.copytree(tiny_dataset, tmp_path / "subject")


def check(*arguments):
    return run(main, CheckConfig, program="python -m samira_warp.check", arguments=[*map(str, arguments)])


def facts(capsys, *arguments):
    assert check("--quick", *arguments) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return {name: value.strip() for name, value in (line.split(":", 1) for line in captured.out.splitlines())}


def faults(capsys, *arguments):
    """The lines of a dataset that has faults."""
    assert check("--quick", *arguments) == 2
    captured = capsys.readouterr()
    lines = [line.removeprefix("fault: ") for line in captured.out.splitlines() if line.startswith("fault: ")]
    assert "it cannot be trained on: " in verdict(captured.out)
    assert captured.err.count("\n") == 1
    return lines


def verdict(said):
    """What the last line of a report says."""
    name, _, words = said.splitlines()[-1].partition(":")
    assert name == "verdict"
    return words.strip()


def test_what_a_dataset_holds(tiny_dataset, capsys):
    said = facts(capsys, "--data", tiny_dataset)
    vertices = said.pop("template")
    assert vertices.startswith(f"{tiny_dataset / 'template.npz'}: 328 vertices, ")
    assert vertices.endswith("2 identity and 4 expression coefficients")
    overlap = said.pop("overlap")
    assert re.match(r"good: (100\.0|99\.\d) % of the head's silhouette lies in the matte", overlap)
    assert said == {
        "folder": str(tiny_dataset),
        "format": "VHAP export",
        "frames": "6 at 6 timesteps",
        "split": "dataset: 4 train, 2 test",
        "size": "32 x 32",
        "cameras": "1 pose, focal length 89.6 pixels",
        "static offset": "none",
        "identity": "coefficients from -0.10 to 0.10",
        "expression": "coefficients from -0.46 to 0.46, the largest is expression3 in 00002_00",
        "turn": "root up to 25 degrees",
        "distance": "0.96 to 0.98 metres from the camera",
        "masks": "6 of 6 frames",
        "albedo": "4 of 6 frames",
        "tracking": "good, the worst of overlap",
        "note": "train enlarges pictures of 32 x 32 to 256 (preset cpu) or 512 (preset paper), which adds no "
        "detail: --resolution 32 trains at their own size",
        "verdict": f"it can be trained on: python -m samira_warp.train --data {tiny_dataset}",
    }


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ([(512, 400), (600, 500)], None),
        ([(512, 512), (400, 300)], "pictures of 400 x 300 to 512 (preset paper)"),
        ([(200, 511)], "pictures of 200 x 511 to 512 (preset paper)"),
        ([(255, 200)], "pictures of 255 x 200 to 256 (preset cpu) or 512 (preset paper)"),
    ],
)
def test_pictures_that_training_would_enlarge(tiny_dataset, sizes, said):
    listing = open_listing(tiny_dataset)
    frames = [
        replace(frame, camera=frame.camera.resized(width=width, height=height))
        for frame, (width, height) in zip(listing.frames, sizes, strict=False)
    ]
    notes = size_notes(replace(listing, frames=tuple(frames)))
    if said is None:
        assert notes == ()
    else:
        (note,) = notes
        assert f"train enlarges {said}, which adds no detail: --resolution {max(sizes[-1])} " in note


def test_the_verdict_is_a_command_to_type(dataset, tmp_path, capsys):
    """With the folder, the head and the division that were checked: the options of train read it back."""
    folder = dataset.rename(tmp_path / "my subject")
    flame = (folder / "template.npz").rename(tmp_path / "a head.npz")
    said = facts(capsys, "--data", folder, "--flame", flame, "--split", "last:1")
    words, command = said["verdict"].split(": ", 1)
    assert words == "it can be trained on"
    python, minus_m, module, *options = shlex.split(command)
    assert (python, minus_m, module) == ("python", "-m", "samira_warp.train")
    asked = []
    assert run(asked.append, TrainConfig, program="train", arguments=options) == 0
    (config,) = asked
    assert (config.data, config.flame, config.split) == (folder, flame, "last:1")


def test_the_verdict_counts_what_stands_against_it(dataset, capsys):
    for path in (dataset / "fg_masks").iterdir():
        write_png(path, np.roll(read_image(path, channels=3), 16, axis=1))
    assert check("--quick", "--data", dataset) == 0
    judged = "it can be trained on, once you have judged the 1 warning above: python -m samira_warp.train "
    assert verdict(capsys.readouterr().out).startswith(judged)
    for number, stand in ((0, "1 fault stands"), (1, "2 faults stand")):
        (dataset / "flame_param" / f"{number:05d}.npz").unlink()
        against = f"it cannot be trained on: {stand} against it; mend what is said above, and check again"
        assert check("--quick", "--data", dataset) == 2
        assert verdict(capsys.readouterr().out) == against
    assert check("--quick", "--json", "--data", dataset) == 2
    report = json.loads(capsys.readouterr().out)
    assert (report["verdict"], report["trainable"]) == (against, False)


def test_the_verdict_is_the_last_that_a_person_sees(dataset, tmp_path, monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setattr(sys, "stderr", screen)
    assert check("--data", dataset, "--out", tmp_path / "sheet.png") == 0
    assert "sheet.png" in screen.getvalue()
    assert verdict(screen.getvalue()).startswith("it can be trained on: ")


def test_a_full_disk_loses_the_sheet_and_not_the_report(dataset, tmp_path, capsys, monkeypatch):
    def fail(path, pixels):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("samira_warp.io.images.write_png", fail)
    monkeypatch.setattr("samira_warp.check.__main__.write_png", fail, raising=False)
    assert check("--data", dataset, "--out", tmp_path / "sheet.png") == 2
    said = capsys.readouterr()
    assert "sheet.png" in said.err
    assert verdict(said.out).startswith("it can be trained on: ")


def test_what_was_done_about_a_folder_is_said(tmp_path, capsys):
    film = make_film_for("IMavatar")
    film.world_to_camera[:] = film.world_to_camera[0]
    root = write_layout("IMavatar", film, tmp_path / "subject")
    np.savez(root / "template.npz", **tiny_template())
    check("--quick", "--data", root)
    said = capsys.readouterr().out
    assert "format:        IMavatar's flame_params.json\n" in said
    assert (
        "note:          the dataset has no division of its own: the first 70 % of its timesteps train\n"
        in said
    )


def test_another_split(tiny_dataset, capsys):
    assert facts(capsys, "--data", tiny_dataset, "--split", "last:1")["split"] == "last:1: 5 train, 1 test"


def test_what_is_absent_is_said(tmp_path, capsys):
    root = make_tiny_dataset(tmp_path / "subject", frames=4, static_offset=True)
    for name in ("transforms_train.json", "transforms_test.json"):
        change_json(root / name, lambda d: [entry.pop("fg_mask_path") for entry in d["frames"]])
    shutil.rmtree(root / "albedo")
    said = facts(capsys, "--data", root)
    assert (said["masks"], said["albedo"], said["static offset"]) == (
        "0 of 4 frames",
        "0 of 4 frames",
        "present",
    )


@pytest.mark.parametrize("quick", [True, False])
def test_albedo_files_without_a_matte_are_a_warning(dataset, tmp_path, capsys, quick):
    """One frame has lost its mask; without decoding that is seen as well."""
    change_json(dataset / "transforms_train.json", lambda d: d["frames"][1].pop("fg_mask_path"))
    options = ("--quick",) if quick else ("--out", tmp_path / "sheet.png")
    assert check("--data", dataset, *options) == 0
    said = capsys.readouterr().out
    warnings = [line for line in said.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1
    assert f"{dataset / 'albedo'}: expected a matte for every frame with an albedo" in warnings[0]
    assert "neither a mask nor an alpha channel for 1 of the albedo files" in warnings[0]
    assert warnings[0].count("00001_00.png") == 1
    assert "once you have judged the 1 warning above" in said


@pytest.mark.parametrize("alpha", [True, False])
def test_albedo_files_under_a_matte_of_everything_are_a_warning(dataset, tmp_path, capsys, alpha):
    opaque = np.ones((32, 32, 1), np.float32)
    if alpha:
        change_json(dataset / "transforms_train.json", lambda d: d["frames"][1].pop("fg_mask_path"))
        path = dataset / "images" / "00001_00.png"
        write_png(path, np.concatenate([read_image(path, channels=3), opaque], axis=2))
    else:
        write_png(dataset / "fg_masks" / "00001_00.png", opaque[..., 0])
    assert check("--data", dataset, "--out", tmp_path / "sheet.png") == 0
    said = capsys.readouterr().out
    path = dataset / "albedo" / "00001_00.png"
    assert f"warning: {path}: expected a matte for every frame with an albedo" in said
    assert "one that covers everything, so that the albedo is not used" in said


def test_a_head_model_from_elsewhere(dataset, tmp_path, capsys):
    (dataset / "template.npz").rename(tmp_path / "flame.npz")
    assert facts(capsys, "--data", dataset, "--flame", tmp_path / "flame.npz")["template"].startswith(
        str(tmp_path / "flame.npz")
    )


FIRST = "flame_param/00000.npz"
DAMAGES = {
    "no list": ("transforms_train.json", os.unlink, "export the dataset again"),
    "a list that is none": ("transforms_test.json", lambda path: path.write_text("{"), "correct it there"),
    "no image": ("images/00001_00.png", os.unlink, "take what names it out of the lists"),
    "an image of another size": ("images/00001_00.png", widen, "bring it to that size"),
    "a mask of another size": ("fg_masks/00001_00.png", widen, "bring it to that size"),
    "an image that is text": (
        "images/00001_00.png",
        lambda path: path.write_text("hello"),
        "copy or export the picture again",
    ),
    "no key": (FIRST, lambda path: change_arrays(path, expr=None), "track or export this frame again"),
    "another shape": (FIRST, lambda path: change_arrays(path, expr=lambda a: a[:, 1:]), "--flame"),
    "NaN": (
        FIRST,
        lambda path: change_arrays(path, expr=with_value(float("nan"))),
        "track or export this frame again",
    ),
    "no template": ("template.npz", os.unlink, "flame.is.tue.mpg.de"),
    "a broken template": (
        "template.npz",
        lambda path: path.write_text("hello"),
        "get or write the file again",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_fault_is_one_line_with_its_file_and_remedy(dataset, capsys, name):
    file, damage, remedy = DAMAGES[name]
    damage(dataset / file)
    (line,) = faults(capsys, "--data", dataset)
    assert line.startswith(str(dataset / file))
    assert remedy in line


def test_every_fault_is_told(dataset, capsys):
    """Those of lists, entries, pictures and parameters, together with what is wrong with the head's place."""
    files = ["images/00000_00.png", "fg_masks/00000_00.png", "images/00005_00.png", "flame_param/00001.npz"]
    for file in files[:3]:
        (dataset / file).unlink()
    change_arrays(dataset / files[3], expr=with_value(float("nan")), jaw_pose=None)
    change_json(dataset / "transforms_train.json", lambda d: d["frames"][2].update(transform_matrix=None))
    for path in (dataset / "fg_masks").iterdir():
        write_png(path, 1 - read_image(path, channels=1))
    lines = faults(capsys, "--data", dataset)
    places = [
        *(str(dataset / file) for file in files[:2]), f"{dataset / 'transforms_train.json'}: frames[2]",
        str(dataset / files[2]),
        f"{dataset / files[3]}: expr: expected finite", f"{dataset / files[3]}: expected the key jaw_pose",
        f"{dataset / 'fg_masks'}: expected masks that are white on the head",
    ]  # fmt: skip
    assert len(lines) == len(places)
    for place in places:
        assert sum(line.startswith(place) for line in lines) == 1, (place, lines)


def test_a_list_that_is_missing_hides_nothing_else(dataset, capsys):
    (dataset / "transforms_train.json").unlink()
    change_arrays(dataset / FIRST, expr=with_value(float("nan")))
    first, second = faults(capsys, "--data", dataset)
    assert first.startswith(f"{dataset / 'transforms_train.json'}: expected the dataset's list of frames")
    assert second.startswith(f"{dataset / FIRST}: expr")


def test_a_film_with_many_faults(tmp_path, capsys):
    root = write_layout("metrical-tracker", make_film_for("metrical-tracker"), tmp_path / "subject")
    np.savez(root / "template.npz", **tiny_template())
    broken = [
        root / file for file in ("checkpoint/00001.frame", "checkpoint/00003.frame", "images/00004.png")
    ]
    for path in broken:
        path.write_bytes(b"hello")
    lines = faults(capsys, "--data", root)
    assert [line.split(":")[0] for line in lines[:3]] == [*map(str, broken)]


def test_broken_pixels_are_found_by_decoding(dataset, capsys):
    files = ("albedo/00001_00.png", "images/00002_00.png", "fg_masks/00003_00.png")
    for file in files:
        cut(dataset / file)
    assert check("--quick", "--data", dataset) == 0
    capsys.readouterr()
    assert check("--data", dataset, "--out", dataset.parent / "sheet.png") == 2
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("fault: ")]
    for file in files:
        assert sum(str(dataset / file) in line for line in lines) == 1


@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".bmp", ".tif"])
def test_a_picture_that_was_cut_is_told_and_not_trained(dataset, capsys, suffix):
    """Most decoders fill up what is missing, with grey or with what came before."""
    for path in list((dataset / "images").iterdir()):
        Image.open(path).convert("RGB").save(path.with_suffix(suffix), quality=95)
        path.unlink()
    victim = dataset / "images" / f"00002_00{suffix}"
    (frame,) = [frame for frame in open_sequence(dataset).frames if frame.image_path == victim]
    whole = victim.read_bytes()
    victim.write_bytes(whole[: 2 * len(whole) // 3])
    assert check("--data", dataset, "--out", dataset.parent / "sheet.png") == 2
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("fault: ")]
    assert len(lines) == 1
    assert lines[0].startswith(f"fault: {victim}: expected a ")
    assert "copy or export the picture again" in lines[0]
    with pytest.raises(UserError, match=victim.name):
        load_pixels(frame, width=32, height=32)


def test_many_alike_are_summed_up(tmp_path, capsys):
    root = make_tiny_dataset(tmp_path / "subject", frames=20)
    shutil.rmtree(root / "flame_param")
    lines = faults(capsys, "--data", root)
    assert len(lines) == MOST_ALIKE + 1
    assert lines[-1] == f"{root / 'flame_param'}: {20 - MOST_ALIKE} more like these; --json names them all"
    assert check("--quick", "--json", "--data", root) == 2
    report = json.loads(capsys.readouterr().out)
    assert len(report["findings"]) == 20
    assert not report["trainable"]


def test_the_sheet_shows_the_mesh_on_its_head(dataset, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert check("--data", dataset) == 0
    assert "subject_check.png" in capsys.readouterr().err
    sheet = read_image(tmp_path / "subject_check.png", channels=3)
    assert min(sheet.shape[:2]) > CELL
    frame = open_sequence(dataset).frames[0]
    (view,) = sampled_views(open_sequence(dataset), [0])
    drawn = mesh_overlay(view, open_sequence(dataset).template.faces, width=32, height=32)[..., 3] > 0.02
    mask = read_image(frame.mask_path, channels=1)[..., 0] > 0.5
    # the mesh is a sphere's of 20 columns, the mask the sphere's: they differ by less than a pixel along the
    # border of some 60
    assert np.count_nonzero(drawn ^ mask) < 60


def test_a_sheet_that_cannot_be(tiny_dataset, tmp_path, capsys):
    for out in (tmp_path / "sheet.jpg", tmp_path / "nowhere" / "sheet.png"):
        assert check("--data", tiny_dataset, "--out", out) == 2
        assert (
            capsys.readouterr().err
            == f"error: --out: expected a .png in a folder that is there, found {out}\n"
        )


@pytest.mark.parametrize("options", [("--data", "nowhere"), ("--split", "half")])
def test_what_cannot_be_read_at_all_is_one_line(tiny_dataset, capsys, options):
    assert check("--data", tiny_dataset, *options) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1


def test_an_unknown_option_is_status_2(tiny_dataset, capsys):
    with pytest.raises(SystemExit) as caught:
        check("--data", tiny_dataset, "--spilt", "0.5")
    assert caught.value.code == 2
    assert "--spilt" in capsys.readouterr().err


def test_the_process_ends_with_one_line_and_status_2(dataset):
    change_arrays(dataset / FIRST, jaw_pose=with_value(float("nan")))
    command = [sys.executable, "-m", "samira_warp.check", "--quick", "--data", str(dataset)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert (
        f"fault: {dataset / FIRST}: jaw_pose: expected finite numbers, found 1 that are not; " in done.stdout
    )
    assert done.stderr == f"error: {dataset}: expected a dataset to train on, found 1 fault\n"
