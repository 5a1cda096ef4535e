"""`read_head`: which reader a path belongs to, and what is said where there is none."""

import numpy as np
import pytest
from data.tiny import tiny_template

from samira_subject.head import build_template
from samira_warp.head import read_head
from samira_warp.head.flame_companions import read_landmarks
from samira_warp.head.landmarks import EMBEDDING_FILE, LandmarkEmbedding
from samira_warp.head.models import missing_landmarks
from samira_warp.head.template import read_template, save_template
from samira_warp.support.errors import UserError


def test_a_template_is_read_as_it_is(tmp_path):
    np.savez(tmp_path / "head.npz", **tiny_template())
    assert read_head(tmp_path / "head.npz").hash == read_template(tmp_path / "head.npz").hash


@pytest.mark.parametrize("name", ["nowhere.npz", "nowhere.pkl", "nowhere"])
def test_nothing_there(tmp_path, name):
    with pytest.raises(UserError, match=rf"{name}: expected .*found no such file"):
        read_head(tmp_path / name)


def test_another_archive_is_taken_for_flames(tmp_path):
    np.savez(tmp_path / "other.npz", weights=np.zeros(3))
    with pytest.raises(UserError, match=r"other.npz: expected the key v_template"):
        read_head(tmp_path / "other.npz")


def test_a_head_without_landmarks_is_told_how_to_get_them(tmp_path):
    assert missing_landmarks(build_template(), "head.npz") is None
    np.savez(tmp_path / "head.npz", **tiny_template())
    said = missing_landmarks(read_head(tmp_path / "head.npz"), tmp_path / "head.npz")
    assert f"python tools/place_landmarks.py --head {tmp_path / 'head.npz'} --out" in said
    assert "\n" not in said


def test_landmarks_survive_a_copy(tmp_path):
    save_template(build_template(), tmp_path / "template.npz")
    copy = read_head(tmp_path / "template.npz").landmarks
    assert np.array_equal(copy.faces, build_template().landmarks.faces)


def test_flames_landmarks_follow_its_faces_into_another_order(tmp_path):
    """A mesh file that orders the faces its own way, corners turned round: the points stay where they are."""
    generator = np.random.default_rng(2)
    vertices = generator.standard_normal((12, 3))
    faces = generator.permuted(np.tile(np.arange(12), (30, 1)), axis=1)[:, :3]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    own = LandmarkEmbedding(
        np.array([3, 0, 7, 100], np.int32),
        np.array([5, 2, 0, 9], np.int32),
        generator.dirichlet(np.ones(3), 4).astype(np.float32),
    )
    assert read_landmarks(tmp_path, faces, faces) is None
    np.savez(
        tmp_path / EMBEDDING_FILE,
        landmark_indices=own.ids,
        lmk_face_idx=own.faces,
        lmk_b_coords=own.barycentrics,
    )
    same = read_landmarks(tmp_path, faces, faces)
    assert np.array_equal(same.faces, own.faces)
    other = np.roll(faces[generator.permutation(len(faces))], 1, axis=1)
    found = read_landmarks(tmp_path, faces, np.concatenate([other, [[12, 13, 14]]]))
    assert np.array_equal(found.ids, own.ids)
    assert np.abs(found.points(vertices, other) - own.points(vertices, faces)).max() < 1e-12
