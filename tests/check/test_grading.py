"""A tracking that is right, and damaged by known amounts: the grades say which, and by how much."""

import json
import re
import shutil

import numpy as np
import pytest
import torch
from data.damage import change_arrays
from data.tiny import make_tiny_dataset

from samira_warp.check.__main__ import CheckConfig, main
from samira_warp.check.drawing import marks_of, mesh_sheet
from samira_warp.check.report import check_dataset
from samira_warp.check.views import sampled_views
from samira_warp.data import open_sequence
from samira_warp.data.landmarks import read_landmarks
from samira_warp.head import Rig
from samira_warp.io.images import read_image, write_png
from samira_warp.support.cli import run

SIZE, FRAMES, MARKS = 64, 30, 40
HEAD = 37.0
"""Pixels that the tiny head is high: 2.8 times its diameter of 0.2 metres in the picture's 64."""


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A film whose template has landmarks, on vertices, and whose detector saw them where they are."""
    root = make_tiny_dataset(tmp_path_factory.mktemp("good") / "subject", frames=FRAMES, size=SIZE)
    ids = np.sort(np.random.default_rng(0).choice(478, MARKS, replace=False)).astype(np.int32)
    with np.load(root / "template.npz") as template:
        vertices = template["f"][3 * np.arange(MARKS), 0]
    corner = np.tile(np.float32([1, 0, 0]), (MARKS, 1))
    change_arrays(
        root / "template.npz",
        landmark_ids=ids,
        landmark_faces=3 * np.arange(MARKS, dtype=np.int32),
        landmark_barycentrics=corner,
    )
    sequence = open_sequence(root)
    with torch.no_grad():
        posed = Rig.build(sequence.template).pose(sequence.batch(range(FRAMES)), sequence.shape).vertices
    # the camera is a metre before the origin, its focal length 2.8 widths
    x, y, z = posed[:, vertices].double().numpy().transpose(2, 0, 1)
    pixels = 2.8 * SIZE * np.stack([x, -y], axis=-1) / (1 - z)[..., None] + SIZE / 2
    points = np.full((FRAMES, 478, 3), 7.0)
    points[:, ids, :2] = pixels
    np.savez(
        root / "landmarks.npz",
        landmarks=points[:, :468].astype(np.float32),
        irises=points[:, 468:, :2].reshape(FRAMES, 2, 5, 2).astype(np.float32),
        seen=np.ones(FRAMES, bool),
        stems=np.array([f"{index:05d}_00" for index in range(FRAMES)]),
    )
    return root


@pytest.fixture
def dataset(original, tmp_path):
    return shutil.copytree(original, tmp_path / "subject")


def grades(root, **options):
    return {grade.subject: grade for grade in check_dataset(root, **{"quick": True, **options}).grades}


def move_landmarks(root, change):
    def both(array):
        array = array.copy()
        change(array)
        return array

    change_arrays(root / "landmarks.npz", landmarks=both, irises=both)


def move_heads(root, offsets):
    """Other translations, by (N, 3) metres."""
    for index, offset in enumerate(offsets):
        path = root / "flame_param" / f"{index:05d}.npz"
        change_arrays(path, translation=lambda array, offset=offset: (array + offset).astype(np.float32))


def hold_still(root):
    for path in (root / "flame_param").iterdir():
        change_arrays(path, **dict.fromkeys(("translation", "rotation", "expr"), np.zeros_like))


def test_what_is_right_is_good(original, capsys):
    found = grades(original)
    assert {subject: grade.word for subject, grade in found.items()} == {
        "landmarks": "good", "overlap": "good", "steadiness": "good",
    }  # fmt: skip
    # float32 pixels of up to 64
    assert found["landmarks"].overall["median_pixels"] < 1e-4
    assert list(found["landmarks"].frames) == [f"{index:05d}_00" for index in range(FRAMES)]
    assert found["overlap"].overall["median_inside"] > 0.99
    assert found["steadiness"].overall["jitter_pixels"] < 0.01
    assert run(main, CheckConfig, program="check", arguments=["--quick", "--data", str(original)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^tracking: +good, the worst of landmarks, overlap, steadiness$", said, re.MULTILINE)
    assert re.search(r"^landmarks: +good: the mesh lies 0\.0 pixels beside ", said, re.MULTILINE)
    arguments = ["--quick", "--json", "--data", str(original)]
    assert run(main, CheckConfig, program="check", arguments=arguments) == 0
    tracking = json.loads(capsys.readouterr().out)["tracking"]
    assert {subject: grade["word"] for subject, grade in tracking.items()} == dict.fromkeys(found, "good")
    assert len(tracking["steadiness"]["frames"]) == FRAMES


@pytest.mark.parametrize(("pixels", "word"), [(0.15, "good"), (0.35, "fair"), (3.0, "poor")])
def test_landmarks_beside_the_mesh(dataset, pixels, word):
    """Thresholds are 0.006 and 0.012 of a head of 37 pixels: 0.22 and 0.44."""

    def shift(points):
        points[..., 0] += 0.6 * pixels
        points[..., 1] -= 0.8 * pixels

    move_landmarks(dataset, shift)
    grade = grades(dataset)["landmarks"]
    assert grade.word == word
    assert grade.overall["median_pixels"] == pytest.approx(pixels, abs=1e-4)
    assert grade.overall["median_share_of_height"] == pytest.approx(pixels / HEAD, rel=0.1)
    warnings = [str(finding) for finding in check_dataset(dataset, quick=True).findings]
    assert len(warnings) == (word == "poor")
    assert all("3.0 pixels beside the detected landmarks" in warning for warning in warnings)


def test_the_worst_frame_is_named_and_the_rest_is_not_judged_by_it(dataset):
    def spoil(points):
        points[17, ..., 0] += 9

    move_landmarks(dataset, spoil)
    grade = grades(dataset)["landmarks"]
    assert grade.word == "good"
    assert "worst in 00017_00: 9.0 pixels" in grade.text


def test_frames_without_a_face_are_left_out(dataset):
    def spoil(points):
        points[3] = np.nan
        points[4] += 50

    move_landmarks(dataset, spoil)
    change_arrays(dataset / "landmarks.npz", seen=np.arange(FRAMES) != 4)
    grade = grades(dataset)["landmarks"]
    assert grade.word == "good"
    assert len(grade.frames) == FRAMES - 2
    assert not {"00003_00", "00004_00"} & set(grade.frames)


def test_jitter_is_said_in_pixels(dataset):
    generator = np.random.default_rng(1)
    hold_still(dataset)
    assert grades(dataset)["steadiness"].overall["jitter_pixels"] == 0
    for metres, word in ((0.0001, "good"), (0.0005, "fair"), (0.002, "poor")):
        root = shutil.copytree(dataset, dataset.parent / word)
        move_heads(root, metres * generator.standard_normal((FRAMES, 3)) * [1, 1, 0])
        grade = grades(root)["steadiness"]
        assert grade.word == word
        pixels = 2.8 * SIZE * metres
        # a median of 27 windows, neighbours of which share frames, of the length of a vector of two numbers,
        # whose median is 0.83 standard deviations
        assert grade.overall["jitter_pixels"] == pytest.approx(0.83 * pixels, rel=0.4)
        assert (f"it jitters by {grade.overall['jitter_pixels']:.1f} pixels" in grade.text) == (
            word != "good"
        )
        assert grade.overall["jitter_degrees"] < 1e-4
    (finding,) = [f for f in check_dataset(root, quick=True).findings if "jitters" in f.found]
    assert finding.severity == "warning"


def test_turns_that_jitter_are_said_in_degrees(dataset):
    generator = np.random.default_rng(1)
    hold_still(dataset)
    for index in range(FRAMES):
        path, noise = dataset / "flame_param" / f"{index:05d}.npz", generator.standard_normal(3)
        change_arrays(
            path, rotation=lambda array, noise=noise: (array + np.deg2rad(noise)).astype(np.float32)
        )
    # the median length of three numbers, in the root of their mean square's third: 0.89
    degrees = grades(dataset)["steadiness"].overall["jitter_degrees"]
    assert degrees == pytest.approx(np.sqrt(3) * 0.89, rel=0.3)


def test_smooth_motion_is_no_jitter(dataset):
    """A head that swings by four fifths of its own width, twice in the film."""
    phase = 4 * np.pi * np.arange(FRAMES) / FRAMES
    move_heads(dataset, 0.04 * np.stack([np.sin(phase), np.cos(phase), 0 * phase], axis=1))
    shutil.rmtree(dataset / "fg_masks")
    for name in ("transforms", "transforms_train", "transforms_test"):
        text = (dataset / f"{name}.json").read_text()
        (dataset / f"{name}.json").write_text(re.sub(r'"fg_mask_path": "[^"]*", ', "", text))
    grade = grades(dataset)["steadiness"]
    assert grade.overall["motion_pixels"] > 2
    assert grade.word == "good"


def test_frames_that_are_no_film_are_not_graded(dataset):
    """A head that is elsewhere in every frame, by more than heads move."""
    hold_still(dataset)
    offsets = np.zeros((FRAMES, 3))
    offsets[::2, 0], offsets[1::2, 0] = 0.02, -0.02
    move_heads(dataset, offsets)
    assert "steadiness" not in grades(dataset)


def test_one_bad_frame_is_the_worst_and_not_its_neighbours(dataset):
    offsets = np.zeros((FRAMES, 3))
    offsets[12, 0] = 0.02
    move_heads(dataset, offsets)
    grade = grades(dataset)["steadiness"]
    assert grade.word == "good"
    assert "worst in 00012_00" in grade.text
    others = [value for name, value in grade.frames.items() if name != "00012_00"]
    assert grade.frames["00012_00"] > 10 * max(others)


def test_a_head_beside_its_matte(dataset):
    for path in (dataset / "fg_masks").iterdir():
        write_png(path, np.roll(read_image(path, channels=3), 3, axis=1))
    grade = grades(dataset)["overlap"]
    assert grade.word == "poor"
    # two circles of a diameter of 37, three pixels apart: 4 / pi * 3 / 37 = 0.10 of one is beside the other
    assert grade.overall["median_inside"] == pytest.approx(0.9, abs=0.02)
    assert grade.overall["median_overlap"] == pytest.approx(0.82, abs=0.03)


def test_hair_and_shoulders_are_no_fault_and_a_cut_neck_is_none(dataset, original):
    for path in (dataset / "fg_masks").iterdir():
        mask = read_image(path, channels=3)
        hair = np.maximum(mask, np.roll(mask, -4, axis=0))
        hair[48:] = 1
        write_png(path, hair)
    grade = grades(dataset)["overlap"]
    assert grade.word == "good"
    assert grade.overall["median_overlap"] < 0.95
    for path in (dataset / "fg_masks").iterdir():
        mask = read_image(original / "fg_masks" / path.name, channels=3)
        mask[40:] = 0
        write_png(path, mask)
    assert grades(dataset)["overlap"].word == "good"


def test_all_mattes_are_measured_where_pictures_are_decoded(original):
    assert len(grades(original)["overlap"].frames) == 12
    assert len(grades(original, quick=False)["overlap"].frames) == FRAMES


def test_what_cannot_be_told_is_not(tmp_path):
    root = make_tiny_dataset(tmp_path / "subject", frames=8, size=SIZE)
    # eight frames are five windows
    assert set(grades(root)) == {"overlap"}


def test_films_of_two_cameras_are_two_films(dataset):
    """Their frames come in turns; a head does not jump between them."""
    for name in ("transforms", "transforms_train", "transforms_test"):
        document = json.loads((dataset / f"{name}.json").read_text())
        for entry in document["frames"]:
            entry["camera_index"] = entry["timestep_index"] % 2
            entry["timestep_index"] //= 2
            if entry["camera_index"]:
                entry["transform_matrix"][0][3] = 0.03
        (dataset / f"{name}.json").write_text(json.dumps(document))
    assert grades(dataset)["steadiness"].word == "good"


BROKEN = {
    "no array of a kind": {"irises": None},
    "too few points": {"landmarks": lambda points: points[:, :400]},
    "a frame too many": {"seen": np.ones(FRAMES + 1, bool)},
    "numbers for names": {"stems": np.arange(FRAMES)},
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_of_landmarks_is_a_warning(dataset, name):
    change_arrays(dataset / "landmarks.npz", **BROKEN[name])
    report = check_dataset(dataset, quick=True)
    (finding,) = report.findings
    assert finding.severity == "warning"
    assert str(dataset / "landmarks.npz") in finding.subject
    assert "landmarks" not in {grade.subject for grade in report.grades}
    (dataset / "landmarks.npz").write_bytes(b"no archive")
    (finding,) = check_dataset(dataset, quick=True).findings
    assert finding.subject == str(dataset / "landmarks.npz")


def test_the_sheet_shows_landmarks_where_they_are(dataset):
    """Three pixels apart, in yellow and in blue."""

    def shift(points):
        points[..., 0] += 3

    move_landmarks(dataset, shift)
    sequence = open_sequence(dataset)
    (view,) = sampled_views(sequence, [0])
    marks = marks_of(sequence, [view], read_landmarks(dataset))
    plain, marked = (
        mesh_sheet([view], sequence.template.faces, parts={}, marks=some) for some in ({}, marks)
    )
    changed = np.abs(plain - marked).max(axis=2) > 0.1
    scale = 360 / SIZE
    for points, color in (
        (marks["00000_00"].detected, (1.0, 0.82, 0.0)),
        (marks["00000_00"].fitted, (0.12, 0.24, 1.0)),
    ):
        places = (points * scale).astype(int)
        gap = 11  # of the sheet, a 33rd of the picture's width
        seen = marked[places[:, 1] + gap, places[:, 0] + gap]
        assert changed[places[:, 1] + gap, places[:, 0] + gap].mean() > 0.9
        # other marks lie over some
        assert (np.abs(seen - color).max(axis=1) < 0.1).mean() > 0.7
