"""What a tracked film's dataset keeps below the neck."""

import films
import numpy as np
import pytest
import torch

from samira_subject.head import build_template
from samira_warp.data import open_sequence
from samira_warp.head import FrameParameters, Rig
from samira_warp.io.images import read_image, write_png
from samira_warp.prepare.export import export
from samira_warp.prepare.own_tracking import Filmed, Fit, camera_of
from samira_warp.tracker.observed import View
from samira_warp.vision.faces import FaceTrack

SIDE, FRAMES, FOCAL = 96, 3, 200.0


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A head that tilts, far enough away that its neck ends in the picture, and mattes that cover all."""
    folder, template = tmp_path_factory.mktemp("film"), build_template()
    rig = Rig.build(template)
    turns = torch.zeros(FRAMES, len(rig.joint_names), 3)
    turns[:, 0, 2] = torch.tensor([0.0, 0.2, -0.2])
    parameters = FrameParameters(torch.zeros(FRAMES, 3), turns, torch.zeros(FRAMES, rig.n_expression))
    fit = Fit(
        parameters,
        torch.zeros(rig.n_shape),
        torch.zeros(len(rig.v_template), 3),
        FOCAL,
        torch.full((len(rig.v_template), 3), 0.5),
        torch.ones(9, 3),
    )
    pictures, mattes = [], []
    for number in range(FRAMES):
        for name, kept, values in (
            ("images", pictures, np.full((SIDE, SIDE, 3), 0.3)),
            ("mattes", mattes, np.ones((SIDE, SIDE))),
        ):
            (folder / name).mkdir(exist_ok=True)
            kept.append(folder / name / f"{number}.png")
            write_png(kept[-1], values)
    view = View(SIDE, SIDE, SIDE / 2, SIDE / 2)
    filmed = Filmed(tuple(pictures), tuple(mattes), view, 25.0, FOCAL, (0, 2, 3), {1: "no face is found"}, ())
    nothing = np.full((FRAMES, 468, 3), np.nan, np.float32)
    faces = FaceTrack(
        nothing,
        np.full((FRAMES, 2, 5, 2), np.nan, np.float32),
        np.full((FRAMES, 2, 16, 2), np.nan, np.float32),
        np.zeros(FRAMES, np.float32),
        np.zeros(FRAMES, bool),
        ("",) * FRAMES,
        np.zeros(FRAMES, np.int32),
        np.zeros((FRAMES, 64), np.float32),
        (),
    )
    vertices = rig.pose(parameters, fit.shape, fit.static_offset).vertices.numpy()
    pixels = np.stack([films.projected(each, camera_of(view, FOCAL)) for each in vertices])
    return template, fit, filmed, faces, pixels


def masks(case, folder, **options):
    template, fit, filmed, faces, _ = case
    folder.mkdir()
    export(template, fit, filmed, faces, folder, **options)
    return np.stack(
        [read_image(path, channels=1)[..., 0] for path in sorted((folder / "fg_masks").iterdir())]
    )


def test_what_is_below_the_neck_is_left_out_unless_it_is_kept(case, tmp_path):
    template, *_, pixels = case
    cut = masks(case, tmp_path / "cut", keep_shoulders=False)
    for number in range(FRAMES):
        rim = pixels[number, template.masks["boundary"]]
        chin = pixels[number, template.masks["face"]]
        chin = chin[chin[:, 1].argmax()].astype(int)
        assert rim[:, 1].max() < SIDE - 4
        assert cut[number, : chin[1], chin[0]].min() == 1.0
        assert cut[number, -1].max() == 0.0
        left, right = cut[number, :, 30].sum(), cut[number, :, SIDE - 30].sum()
        # it ends along a line as the head tilts: 0.2 radians over 36 pixels are 7
        expected = np.tan([0.0, 0.2, -0.2][number]) * (SIDE - 60)
        assert abs((left - right) - expected) < 3.0
    kept = masks(case, tmp_path / "kept", keep_shoulders=True)
    assert kept.min() == 1.0


def test_the_dataset_is_the_fit(case, tmp_path):
    template, *_, pixels = case
    masks(case, tmp_path / "out", keep_shoulders=False)
    sequence = open_sequence(tmp_path / "out")
    assert [len(sequence.train), len(sequence.test)] == [2, 1]
    rig = Rig.build(sequence.template)
    for number, frame in enumerate(sequence.frames):
        vertices = rig.pose(frame.parameters, sequence.shape, sequence.static_offset).vertices.numpy()
        np.testing.assert_allclose(films.projected(vertices, frame.camera), pixels[number], atol=1e-3)
    assert sequence.template.hash == template.hash
