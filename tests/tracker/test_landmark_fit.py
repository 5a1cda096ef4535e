"""Stages (a) and (b) on landmarks whose head is known."""

import torch
from scipy.spatial.transform import Rotation
from tracked_heads import FOCAL, VIEW, head, model, performed, pixels_of, seen_landmarks, vertices_in_picture

from samira_warp.tracker.first_pose import first_pose
from samira_warp.tracker.landmark_fit import Started, fit_frames, fit_subject, key_frames, landmark_errors
from samira_warp.tracker.unknowns import Unknowns

FRAMES, NOISE, RATE = 9, 0.5, 25.0


def fitted(truth, landmarks):
    said = []
    started = fit_subject(model(), landmarks, VIEW, focal=1.1 * FOCAL, say=said.append)
    assert len(said) == 1
    return fit_frames(model(), landmarks, VIEW, started, rate=RATE)


def test_the_head_is_found_to_below_the_noise():
    """478 landmarks, each wrong by half a pixel either way and on its own, tell where the face is to less."""
    truth = performed(FRAMES)
    landmarks = seen_landmarks(truth, noise=NOISE)
    found = fitted(truth, landmarks)
    face = torch.from_numpy(head().template.masks["face"]).long()
    apart = (vertices_in_picture(found) - vertices_in_picture(truth))[:, face].norm(dim=-1)
    assert apart.median() < NOISE
    assert apart.quantile(0.95) < 3 * NOISE
    errors = landmark_errors(model(), found, landmarks, VIEW)
    # two coordinates of so much noise: the median of Rayleigh's distribution is 1.18 of it
    assert 0.8 * 1.18 * NOISE < errors.median() < 1.2 * 1.18 * NOISE


def test_frames_without_a_face_lie_between_their_neighbours():
    truth = performed(FRAMES)
    landmarks = seen_landmarks(truth)
    whole = fitted(truth, landmarks)
    landmarks.seen[4], landmarks.gaps_seen[4] = 0.0, 0.0
    landmarks.points[4], landmarks.gaps[4] = 0.0, 0.0
    found = fitted(truth, landmarks)
    assert landmark_errors(model(), found, landmarks, VIEW)[4].isnan().all()
    turn = head().layout.turn(0)
    # 0.06 radians from frame to frame
    assert (found.frames[4, turn] - whole.frames[4, turn]).norm() < 0.01
    assert (found.frames[4, :3] - whole.frames[4, :3]).norm() < 0.005


def test_the_film_in_chunks_is_the_film(monkeypatch):
    truth = performed(FRAMES)
    landmarks = seen_landmarks(truth, noise=NOISE)
    whole = landmark_errors(model(), truth, landmarks, VIEW)
    monkeypatch.setattr("samira_warp.tracker.landmark_terms.chunks.__defaults__", (4,))
    torch.testing.assert_close(landmark_errors(model(), truth, landmarks, VIEW), whole, rtol=0, atol=1e-4)


def test_a_first_pose_is_exact_for_a_rigid_head_far_away():
    """Where perspective is weak the similarity is the projection: at 100 m it bends by a thousandth."""
    far, frames = 100.0, 5
    focal = FOCAL * far
    truth = Unknowns.at_rest(head().layout, frames=frames, focal=focal)
    turn = head().layout.turn(0)
    truth.frames[:, turn] = torch.linspace(-0.3, 0.4, frames, dtype=torch.float64)[:, None]
    truth.frames[:, 2] = 1.0 - far
    landmarks = seen_landmarks(truth)
    landmarks.seen[2] = 0.0
    root = head().rig.joint_regressor[0] @ head().rig.v_template
    seen = landmarks.only(model().ids)
    found, scales = first_pose(head().layout, model().rest, root, seen, VIEW, focal=focal)
    apart = Rotation.from_rotvec(found.frames[:, turn].numpy()).inv() * Rotation.from_rotvec(
        truth.frames[:, turn].numpy()
    )
    assert apart.magnitude().max() < 2e-3
    torch.testing.assert_close(scales, torch.full((frames,), focal / far), rtol=2e-3, atol=0)
    off = pixels_of(model().points, found)[0] - pixels_of(model().points, truth)[0]
    assert off.norm(dim=-1).max() < 0.5


def test_key_frames_are_even_and_seen():
    landmarks = seen_landmarks(performed(FRAMES))
    landmarks.seen[:3] = 0.0
    assert key_frames(landmarks, 3).tolist() == [3, 5, 8]
    assert key_frames(landmarks, 100).tolist() == list(range(3, FRAMES))


def test_a_start_of_key_frames_alone_reaches_all(monkeypatch):
    """Of a long film a few frames find the subject, and the others begin between them."""
    monkeypatch.setattr("samira_warp.tracker.landmark_fit.KEY_FRAMES", 3)
    truth = performed(FRAMES)
    landmarks = seen_landmarks(truth)
    started = fit_subject(model(), landmarks, VIEW, focal=FOCAL, say=lambda text: None)
    assert isinstance(started, Started)
    assert len(started.unknowns.frames) == FRAMES
    found = fit_frames(model(), landmarks, VIEW, started, rate=RATE)
    assert landmark_errors(model(), found, landmarks, VIEW).median() < NOISE
