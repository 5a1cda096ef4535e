import numpy as np
import pytest
import torch
from subjects import small_avatar

from samira_warp.train.neighbours import NEIGHBOURS, NORMAL_METRES, neighbourhood, rest_places


@pytest.fixture
def avatar(device):
    return small_avatar(gaussians=500, device=device)


def test_they_are_the_nearest_by_brute_force(avatar):
    found = neighbourhood(avatar.gaussians, avatar.canonical).table
    places = rest_places(avatar.gaussians, avatar.canonical)
    apart = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = np.sort(apart, axis=1)[:, :NEIGHBOURS]
    indices = found.indices.cpu().numpy()
    assert not (indices == np.arange(500)[:, None]).any()
    chosen = np.sort(np.take_along_axis(apart, indices.astype(np.int64), axis=1), axis=1)
    np.testing.assert_allclose(chosen, nearest, rtol=1e-12)
    assert (found.weights == 1.0 / NEIGHBOURS).all()


def test_places_are_on_the_surface(avatar):
    """The position map is bilinear in texels of a 32-wide atlas: within a texel of the Gaussian itself."""
    places = rest_places(avatar.gaussians, avatar.canonical)
    vertices = avatar.canonical.vertices.cpu().numpy()
    corners = vertices[
        avatar.canonical.topology.faces.cpu().long()[avatar.gaussians.faces.cpu().long()].numpy()
    ]
    reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    off = np.linalg.norm(places[:, :3] - corners.mean(axis=1), axis=1)
    assert np.median(off / reach) < 1.0
    np.testing.assert_allclose(np.linalg.norm(places[:, 3:6], axis=1), NORMAL_METRES, rtol=1e-5)


def test_an_eyeball_is_not_its_lids_neighbour(avatar):
    table = neighbourhood(avatar.gaussians, avatar.canonical).table
    places = rest_places(avatar.gaussians, avatar.canonical)
    pieces = places[:, 6]
    assert len(np.unique(pieces)) > 1
    crowded = np.isin(pieces, [piece for piece in np.unique(pieces) if (pieces == piece).sum() > NEIGHBOURS])
    own, others = pieces[crowded], pieces[table.indices.cpu().numpy()[crowded]]
    assert (own[:, None] == others).all()


def test_constant_values_have_no_contrast(avatar):
    found = neighbourhood(avatar.gaussians, avatar.canonical)
    values = torch.full((500, 2), 0.3, device=avatar.gaussians.means.device)
    # eight eighths in float32
    assert found.contrast(values).abs().max() < 1e-6


def test_gaussians_in_one_place_have_others_for_neighbours(device):
    avatar = small_avatar(gaussians=30, device=device)
    gaussians = avatar.gaussians
    for name in ("faces", "uv", "initial_normals"):
        getattr(gaussians, name)[:] = getattr(gaussians, name)[:1].clone()
    indices = neighbourhood(gaussians, avatar.canonical).table.indices.cpu()
    assert not (indices == torch.arange(30)[:, None]).any()
