"""What the fit takes of what networks saw: made-up tracks whose eyes and lips are known."""

import numpy as np
import pytest
import torch
from tracked_heads import head

from samira_warp.head.landmarks import LANDMARKS, MESH_LANDMARKS
from samira_warp.tracker.faces import GAPS, LIDS, LIPS, landmarks_of
from samira_warp.vision.faces import FaceTrack

FRAMES, OPEN, SHUT = 6, 0.30, 0.12
"""Gaps of lids in widths of the eye: 0.12 is what the network says of lids that touch."""

EYE = 40.0
"""Width of an eye, pixels."""


def track(*, openness=(OPEN,) * FRAMES, mouth=(0.3,) * FRAMES, unseen=()):
    """A face that looks at the camera, its eyes and mouth open by shares of their widths."""
    template = head().template
    points = template.landmarks.points(template.v_template, template.faces)
    pixels = np.zeros((LANDMARKS, 3), np.float32)
    pixels[template.landmarks.ids] = 1000.0 * points * (1.0, -1.0, -1.0) + (300.0, 300.0, 0.0)
    landmarks = np.repeat(pixels[None, :MESH_LANDMARKS], FRAMES, axis=0)
    width = np.linalg.norm(pixels[78] - pixels[308])
    for upper, lower in LIPS:
        middle = landmarks[:, [upper, lower]].mean(axis=1)
        for point, sign in ((upper, -0.5), (lower, 0.5)):
            landmarks[:, point] = middle
            landmarks[:, point, 1] += sign * width * np.array(mouth)
    lids = np.zeros((FRAMES, 2, 16, 2), np.float32)
    along = np.linspace(0.0, 1.0, 9) * EYE
    for eye, outwards in enumerate((1.0, -1.0)):
        lids[:, eye, :9, 0] = outwards * along
        lids[:, eye, 9:, 0] = outwards * along[1:8]
        lids[:, eye, 9:, 1] = -EYE * np.array(openness)[:, None]
    irises = np.zeros((FRAMES, 2, 5, 2), np.float32)
    for eye, outwards in enumerate((1.0, -1.0)):
        centre = np.array([100.0 * outwards, 50.0])
        rim = np.array([[outwards, 0], [0, -1], [-outwards, 0], [0, 1]]) * 6.0
        irises[:, eye] = np.concatenate([centre[None], centre + rim])
    seen = np.array([frame not in unseen for frame in range(FRAMES)])
    for values in (landmarks, irises, lids):
        values[~seen] = np.nan
    return FaceTrack(
        landmarks=landmarks,
        irises=irises,
        lids=lids,
        presence=seen.astype(np.float32),
        seen=seen,
        reasons=tuple("" if each else "no face is found" for each in seen),
        person=np.where(seen, 0, -1).astype(np.int32),
        colours=np.zeros((FRAMES, 64), np.float32),
        notes=(),
    )


def test_all_of_a_face_is_taken_and_nothing_of_none():
    found = landmarks_of(track(unseen=(2,)))
    assert found.points.shape == (FRAMES, LANDMARKS, 2)
    assert found.gaps.shape == (FRAMES, len(GAPS), 2)
    for trust in (found.seen, found.gaps_seen):
        assert (trust[2] == 0).all()
        assert (trust[[0, 1, 3, 4, 5]] == 1).all()
    assert all(bool(torch.isfinite(values).all()) for values in vars(found).values())


def test_irises_are_in_the_order_of_the_heads_own():
    """Of the built-in head, an iris's points go the same ways from its middle as those seen."""
    found = landmarks_of(track())
    template = head().template
    own = np.zeros((LANDMARKS, 3))
    own[template.landmarks.ids] = template.landmarks.points(template.v_template, template.faces)
    for first in (MESH_LANDMARKS, MESH_LANDMARKS + 5):
        seen = (found.points[0, first + 1 : first + 5] - found.points[0, first]).numpy()
        expected = (own[first + 1 : first + 5] - own[first])[:, :2] * (1.0, -1.0)
        cosines = (seen * expected).sum(axis=1) / np.linalg.norm(seen, axis=1)
        assert cosines == pytest.approx(np.linalg.norm(expected, axis=1), rel=1e-3)
        assert np.sign(found.points[0, first, 0]) == np.sign(own[first, 0])


def test_closed_lids_have_no_gap_and_show_no_iris():
    found = landmarks_of(track(openness=(OPEN, OPEN, SHUT, OPEN, OPEN, OPEN)))
    lids = slice(0, 2 * len(LIDS[0]))
    assert (found.gaps[2, lids] == 0).all()
    assert (found.seen[2, MESH_LANDMARKS:] == 0).all()
    assert (found.seen[:, :MESH_LANDMARKS] == 1).all()
    assert (found.seen[1, MESH_LANDMARKS:] == 1).all()
    # a person's own open eyes are as open as they are seen, upwards from the lower lid
    torch.testing.assert_close(found.gaps[1, lids, 1], torch.full((14,), -EYE * OPEN), rtol=1e-5, atol=0)


def test_lids_half_way_down_are_less_open_than_they_are_seen():
    """What the network leaves open of closed lids is taken off, by what it leaves of open ones nothing."""
    half = 0.22
    found = landmarks_of(track(openness=(OPEN, half, OPEN, OPEN, OPEN, OPEN)))
    gaps = -found.gaps[1, :14, 1] / EYE
    assert (gaps > 0.05).all()
    assert (gaps < half).all()


@pytest.mark.parametrize(("mouth", "low", "high"), [(0.01, 0.0, 0.0), (0.08, 0.0, 0.999), (0.3, 1.0, 1.0)])
def test_lips_that_nearly_meet_meet(mouth, low, high):
    faces = track(mouth=(mouth,) * FRAMES)
    upper, lower = np.array(LIPS[0])
    seen = faces.landmarks[0, upper, :2] - faces.landmarks[0, lower, :2]
    share = landmarks_of(faces).gaps[0, 14].numpy()[1] / seen[1]
    assert low - 1e-6 <= share <= high + 1e-6
    assert share > 0.0 or mouth != 0.08
