"""From a video to a dataset by the package's own tracker, against what is known of who was filmed."""

import dataclasses
import json
import shutil
import sys
import time

import av
import films
import numpy as np
import pytest
import torch
from data.damage import file_size_limit
from safetensors.torch import load_file
from subjects import train_arguments, train_command
from test_prepare import command, interrupt, prepare, refusal, times, tree

from samira_subject.head import build_template
from samira_warp.check.report import check_dataset
from samira_warp.data import open_sequence
from samira_warp.data.landmarks import read_landmarks
from samira_warp.head import Rig, save_template
from samira_warp.head.uv_layout import uv_fault
from samira_warp.io.images import read_image
from samira_warp.prepare import own_tracking, run
from samira_warp.prepare.own_tracking import FIT_FILE, read_fit
from samira_warp.support.errors import UserError
from samira_warp.tracker import render_fit, track

POINTS = 200
FRAMES = len(films.MOMENTS)


def ran(*arguments, **options):
    """The verb in a process of its own, and what it says."""
    begun = command(*arguments, **options)
    said = begun.communicate(timeout=600)[1]
    return begun.returncode, said


@pytest.fixture(scope="module")
def prepared(film, tmp_path_factory):
    """The folder of a preparation, made by the command line as a user types it."""
    out = tmp_path_factory.mktemp("prepared") / "out"
    status, said = ran(film, "--out", out, python=[sys.executable])
    assert status == 0, said
    assert "Traceback" not in said
    assert "Warning" not in said
    assert f"train --data {out / 'dataset'}" in said.splitlines()[-1]
    return out


def crop_of(out):
    return json.loads((out / "stages" / "crop.json").read_text())["result"]["crop"]


def in_the_subjects_pictures(pixels, out):
    """(..., 2) pixels of the frames as pixels of the pictures that the subject was taken in."""
    x, y, side = crop_of(out)
    width = open_sequence(out / "dataset").frames[0].camera.width
    return pixels * side / width + np.array([x - films.LEFT, y - films.TOP])


def tracked_pixels(out):
    """(N, V, 2) where the tracked vertices are seen in the subject's pictures."""
    sequence = open_sequence(out / "dataset")
    rig, pixels = Rig.build(sequence.template), []
    for frame in sequence.frames:
        vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices
        pixels.append(films.projected(vertices.numpy(), frame.camera))
    return in_the_subjects_pictures(np.stack(pixels), out)


def test_the_mesh_is_where_the_head_is(prepared, taken):
    """Points of the face are seen, in the median, as near to where they are as landmarks can tell."""
    face = taken.template.masks["face"]
    chosen = face[np.linspace(0, len(face) - 1, POINTS).round().astype(int)]
    apart = np.linalg.norm(tracked_pixels(prepared)[:, chosen] - taken.pixels[:, chosen], axis=-1)
    assert np.median(apart) < films.BIAS
    assert np.median(apart, axis=1).max() < 3.0


def test_eyes_are_closed_where_they_are(prepared, taken):
    """By the gap between the lids' points on the tracked mesh, against the same gap of the true one."""
    landmarks = taken.template.landmarks
    place = {int(number): row for row, number in enumerate(landmarks.ids)}
    gaps = []
    for pixels in (taken.pixels, tracked_pixels(prepared)):
        points = (pixels[:, taken.template.faces[landmarks.faces]] * landmarks.barycentrics[..., None]).sum(2)
        lids = [(place[386], place[374]), (place[159], place[145])]
        gaps.append(np.stack([points[:, low, 1] - points[:, high, 1] for high, low in lids], axis=1).mean(1))
    truth, found = gaps
    blink = taken.blink()
    closed, open_ = blink > 0.8, blink < 0.3
    assert closed.sum() == 2
    assert open_.sum() > 8
    own = np.median(found[open_])
    assert (found[closed] < 0.35 * own).all()
    assert (found[open_] > 0.5 * own).all()
    assert own == pytest.approx(np.median(truth[open_]), rel=0.35)


def test_all_files_are_there(prepared):
    tracking, dataset = prepared / "tracking", prepared / "dataset"
    facts = json.loads((tracking / "tracking.json").read_text())
    assert facts["frames"] == FRAMES
    assert facts["frames_per_second"] == pytest.approx(films.RATE, rel=1e-3)
    assert facts["width"] == facts["height"] == open_sequence(dataset).frames[0].camera.width
    assert facts["left_out"] == {}
    assert facts["focal_length_pixels"] > 0 < facts["focal_length_before"]
    for stage in ("landmarks", "pixels"):
        errors = facts["error_pixels"][stage]
        assert len(errors["by_frame"]) == FRAMES
        assert 0.0 < errors["median"] < 2.5
        assert max(errors["by_frame"]) < 5.0
    assert any("focal length" in note for note in facts["notes"])
    assert read_image(tracking / "curves.png", channels=3).std() > 0.02
    with av.open(tracking / "mesh.mp4") as shown:
        assert sum(1 for _ in shown.decode(video=0)) == FRAMES
    sheet = read_image(dataset / "tracking.png", channels=3)
    assert min(sheet.shape[:2]) > 200
    detected = read_landmarks(dataset)
    assert np.isfinite(detected.of("00000_00")).all()
    with np.load(dataset / "appearance.npz") as appearance:
        vertices = len(open_sequence(dataset).template.v_template)
        assert appearance["albedo"].shape == (vertices, 3)
        assert appearance["light"].shape == (9, 3)
        assert (appearance["albedo"] > 0).all()
    for name in ("template.npz", "transforms.json", "transforms_train.json", "transforms_test.json"):
        assert (dataset / name).is_file()
    assert not list(prepared.rglob(".*"))


def test_mattes_are_the_heads(prepared, taken):
    """Above the neck, by the truth's own coverage."""
    sequence = open_sequence(prepared / "dataset")
    x, y, side = crop_of(prepared)
    for number in (0, FRAMES // 2, FRAMES - 1):
        frame = sequence.frames[number]
        matte = read_image(frame.mask_path, channels=1)[..., 0]
        scale = matte.shape[0] / side
        rows, columns = np.indices(matte.shape)
        across = np.rint((columns + 0.5) / scale + x - films.LEFT - 0.5).astype(int)
        down = np.rint((rows + 0.5) / scale + y - films.TOP - 0.5).astype(int)
        inside = (across >= 0) & (across < films.SIZE) & (down >= 0) & (down < films.SIZE)
        truth = np.zeros_like(matte)
        truth[inside] = taken.coverage[number][down[inside], across[inside]]
        chin = taken.pixels[number][taken.template.masks["face"], 1].max()
        above = down < chin
        overlap = np.minimum(matte, truth)[above].sum() / np.maximum(matte, truth)[above].sum()
        assert overlap > 0.95


def test_check_grades_it_and_train_takes_it(prepared, tmp_path):
    report = check_dataset(prepared / "dataset")
    assert report.faults == 0
    grades = {grade.subject: grade for grade in report.grades}
    assert set(grades) == {"landmarks", "overlap", "steadiness"}
    assert {grade.word for grade in grades.values()} <= {"good", "fair"}
    assert train_command(*train_arguments(prepared / "dataset", tmp_path / "run")) == 0


def test_a_second_run_does_nothing(prepared, film):
    before = times(prepared)
    assert prepare(film, "--out", prepared) == 0
    assert times(prepared) == before


def test_a_lost_dataset_is_written_again(prepared, film, tmp_path, capsys):
    out = shutil.copytree(prepared, tmp_path / "out")
    shutil.rmtree(out / "dataset")
    tracked = times(out / "tracking")
    assert prepare(film, "--out", out) == 0
    assert times(out / "tracking") == tracked
    assert tree(out / "dataset") == tree(prepared / "dataset")


def test_a_tracking_is_not_lost_unasked(prepared, film, tmp_path, capsys):
    before = times(prepared)
    for options in (("--size", 200), ("--fps", 12.5), ("--crop", "0,0,100")):
        assert "--restart" in refusal(capsys, film, "--out", prepared, *options)
        assert times(prepared) == before


def without(out, *stages):
    """A preparation in which some stages were not run yet."""
    for stage in stages:
        (out / "stages" / f"{stage}.json").unlink()
        shutil.rmtree(out / stage, ignore_errors=True)
    return out


def test_a_head_whose_charts_lie_over_each_other_is_packed_anew(
    prepared, film, tmp_path, monkeypatch, capsys
):
    template = build_template()
    overlapping = dataclasses.replace(template, vt=np.abs(2.0 * template.vt - 1.0))
    assert uv_fault(overlapping.vt, overlapping.ft) is not None
    save_template(overlapping, tmp_path / "head.npz")
    heads = []

    def end(template, *arguments, **options):
        heads.append(template)
        raise UserError("tracking", expected="to be asked for", found="this test")

    monkeypatch.setattr(run, "track_film", end)
    out = without(shutil.copytree(prepared, tmp_path / "out"), "tracking", "dataset")
    assert prepare(film, "--out", out, "--head", tmp_path / "head.npz") == 2
    assert "this test" in capsys.readouterr().err
    (head,) = heads
    assert uv_fault(head.vt, head.ft) is None
    assert np.array_equal(head.faces, template.faces)


def test_a_tracking_goes_on_after_the_parts_that_are_done(prepared, taken, film, tmp_path, monkeypatch):
    """What was found from landmarks and by rendering is not looked for again."""
    out = without(shutil.copytree(prepared, tmp_path / "out"), "tracking", "dataset")
    monkeypatch.setattr(render_fit, "LEVELS", films.FEW_STEPS)

    def end(*arguments, **options):
        raise UserError("this part", expected="another time", found="none")

    with monkeypatch.context() as patch:
        patch.setattr(track, "fit_pixels", end)
        assert prepare(film, "--out", out) == 2
    assert sorted(path.stem for path in (out / "stages" / "tracking").iterdir()) == ["landmarks", "rendering"]
    assert not (out / "tracking").exists()
    rendered = load_file(out / "stages" / "tracking" / "rendering.safetensors")
    for part in ("fit_subject", "_refine_subject"):
        monkeypatch.setattr(track, part, end)
    assert prepare(film, "--out", out) == 0
    assert not (out / "stages" / "tracking").exists()
    found = read_fit(out / "tracking" / FIT_FILE)
    assert torch.equal(found.albedo, rendered["albedo"])
    assert found.focal == pytest.approx(float(rendered["subject"][-1].exp()), rel=1e-12)
    face = taken.template.masks["face"][:: len(taken.template.masks["face"]) // POINTS]
    apart = np.linalg.norm(tracked_pixels(out)[:, face] - taken.pixels[:, face], axis=-1)
    assert np.median(apart) < films.BIAS


def test_ctrl_c_while_tracking_leaves_nothing_half(prepared, film, tmp_path):
    out = without(shutil.copytree(prepared, tmp_path / "out"), "tracking", "dataset")
    begun = command(film, "--out", out)
    deadline = time.monotonic() + 300
    while not (out / ".tracking.new").exists():
        assert time.monotonic() < deadline
        assert begun.poll() is None, begun.communicate()[1]
        time.sleep(0.02)
    time.sleep(1.0)
    said = interrupt(begun)
    assert begun.returncode == 130, said
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "stopped; the same command goes on"
    assert not [path.name for path in out.iterdir() if "tracking" in path.name]


@pytest.mark.parametrize("stage", ["faces", "tracking", "dataset"])
def test_a_full_disk_is_one_line_and_leaves_nothing_half(
    prepared, film, tmp_path, capsys, stage, monkeypatch
):
    out = shutil.copytree(prepared, tmp_path / "out")
    without(
        out,
        *{"faces": ("mattes", "tracking", "dataset"), "tracking": ("tracking", "dataset")}.get(
            stage, ("dataset",)
        ),
    )
    if stage == "faces":
        (out / "stages" / "faces.json").unlink()
        (out / "film" / "faces.npz").unlink()
    # what is tracked is known; writing it is what fails
    monkeypatch.setattr(own_tracking, "track", lambda *_, **__: read_fit(prepared / "tracking" / FIT_FILE))
    before = set(out.rglob("*"))
    with file_size_limit(6000):  # enough for the stages' files, too little for what the stage writes
        message = refusal(capsys, film, "--out", out)
    assert "too large" in message or "cannot be written" in message
    left = {path for path in set(out.rglob("*")) - before if path.is_file()}
    assert {path.parent.name for path in left} <= {"stages"}
    assert not [path for path in out.rglob(".*") if path.name != ".tracking.new"]
    assert not (out / stage).exists()
