import numpy as np
import pytest
from data.tiny import tiny_template

from samira_warp.head.landmarks import LandmarkEmbedding, read_landmark_embedding
from samira_warp.head.template import read_template, save_template
from samira_warp.support.errors import UserError


@pytest.fixture
def arrays():
    return tiny_template()


def placed(count=5, faces=4, seed=0):
    generator = np.random.default_rng(seed)
    weights = generator.dirichlet(np.ones(3), count).astype(np.float32)
    return {
        "landmark_ids": generator.permutation(478)[:count].astype(np.int32),
        "landmark_faces": generator.integers(0, faces, count, dtype=np.int32),
        "landmark_barycentrics": weights,
    }


def read(arrays, folder):
    np.savez(folder / "head.npz", **arrays)
    return read_template(folder / "head.npz")


def test_points_lie_on_their_faces_of_every_head_of_a_batch():
    generator = np.random.default_rng(1)
    vertices, faces = generator.standard_normal((2, 3, 6, 3)), np.array([[0, 1, 2], [2, 3, 5], [4, 5, 0]])
    weights = generator.dirichlet(np.ones(3), 4).astype(np.float32)
    embedding = LandmarkEmbedding(np.arange(4, dtype=np.int32), np.array([2, 0, 0, 1], np.int32), weights)
    points = embedding.points(vertices, faces)
    assert points.shape == (2, 3, 4, 3)
    assert points.dtype == np.float64
    for place, face in enumerate([2, 0, 0, 1]):
        a, b, c = (vertices[..., corner, :] for corner in faces[face])
        wanted = weights[place, 0] * a + weights[place, 1] * b + weights[place, 2] * c
        # sums of three float64 products of numbers of a few units
        assert np.abs(points[..., place, :] - wanted).max() < 1e-14


def test_only_some_points_keep_their_order():
    embedding = LandmarkEmbedding(*placed(count=5).values())
    wanted = embedding.ids[[3, 1]]
    some = embedding.only(np.append(wanted, 477 if 477 not in embedding.ids else 476))
    assert some.ids.tolist() == [embedding.ids[1], embedding.ids[3]]
    assert np.array_equal(some.faces, embedding.faces[[1, 3]])
    assert np.array_equal(some.barycentrics, embedding.barycentrics[[1, 3]])


def test_a_template_keeps_its_landmarks_and_its_hash(arrays, tmp_path):
    plain = read(arrays, tmp_path)
    assert plain.landmarks is None
    keys = placed()
    template = read(arrays | keys, tmp_path)
    assert template.hash == plain.hash
    save_template(template, tmp_path / "copy.npz")
    copy = read_template(tmp_path / "copy.npz").landmarks
    assert len(copy) == 5
    for got, wanted in zip((copy.ids, copy.faces, copy.barycentrics), keys.values(), strict=True):
        assert got.dtype == wanted.dtype
        assert np.array_equal(got, wanted)
    save_template(plain, tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as archive:
        assert not any(key.startswith("landmark") for key in archive)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("landmark_ids", None, "landmark_ids: expected an array beside landmark_faces, found no such key"),
        ("landmark_barycentrics", None, "landmark_barycentrics: expected an array beside landmark_ids"),
        ("landmark_ids", np.array([0, 1, 2, 3, 478]), "landmark_ids: expected integers from 0 to 477"),
        ("landmark_ids", np.array([0, 1, 2, 3, 3]), "landmark_ids: expected ids that differ"),
        ("landmark_ids", np.zeros((5, 1), int), "landmark_ids: expected integers"),
        ("landmark_faces", np.array([0, 0, 0, 0, -1]), "landmark_faces: expected integers from 0 to"),
        ("landmark_faces", np.array([0, 0, 0, 0, 10**6]), "landmark_faces: expected integers from 0 to"),
        ("landmark_faces", np.array([0, 0]), r"landmark_faces: .* one for each landmark, found .*\(2,\)"),
        ("landmark_barycentrics", np.ones((5, 3)), "landmark_barycentrics: .* found other sums"),
        ("landmark_barycentrics", np.full((5, 3), np.nan), "landmark_barycentrics: .* found other sums"),
        ("landmark_barycentrics", np.ones((5, 2)), "landmark_barycentrics: expected finite weights of shape"),
        ("landmark_barycentrics", np.ones((5, 3), int), "landmark_barycentrics: expected finite weights"),
    ],
)
def test_landmarks_that_are_none(arrays, tmp_path, key, value, message):
    broken = arrays | placed() | {key: value}
    with pytest.raises(UserError, match=message):
        read({name: array for name, array in broken.items() if array is not None}, tmp_path)


def test_reads_the_file_that_goes_with_flame(tmp_path):
    """Its keys and shapes as public code reads them: 105 points, faces and float weights."""
    keys = placed(count=105, faces=9976)
    names = ("landmark_indices", "lmk_face_idx", "lmk_b_coords")
    file = dict(zip(names, keys.values(), strict=True))
    file["lmk_b_coords"] = file["lmk_b_coords"].astype(np.float64)
    np.savez(tmp_path / "landmarks.npz", **file, note=np.array(["of others"], object))
    embedding = read_landmark_embedding(tmp_path / "landmarks.npz", faces=9976)
    assert np.array_equal(embedding.ids, keys["landmark_ids"])
    assert np.array_equal(embedding.faces, keys["landmark_faces"])
    assert np.array_equal(embedding.barycentrics, keys["landmark_barycentrics"])
    with pytest.raises(UserError, match="lmk_face_idx: expected integers from 0 to 99"):
        read_landmark_embedding(tmp_path / "landmarks.npz", faces=100)


def test_a_landmark_file_that_is_none(tmp_path):
    with pytest.raises(UserError, match="found no such file"):
        read_landmark_embedding(tmp_path / "landmarks.npz", faces=1)
    np.savez(tmp_path / "landmarks.npz", lmk_face_idx=np.zeros(1, int))
    with pytest.raises(UserError, match="landmark_indices: expected an array, found no such key"):
        read_landmark_embedding(tmp_path / "landmarks.npz", faces=1)
