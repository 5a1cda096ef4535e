import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.train.initialize import FLATNESS
from samira_warp.train.unseen import BORROWED, OPACITY, guess_unseen, seen_pixels


@pytest.fixture
def avatar(device):
    return small_avatar(gaussians=1500, residual=False, device=device)


def frontal(avatar):
    rest = parameters(0, turn=0.0).to(avatar.gaussians.means.device)
    return rest, camera(48, device=avatar.gaussians.means.device)


def middles(avatar):
    """(N, 3) of the Gaussians' triangles at rest."""
    canonical = avatar.canonical
    return canonical.vertices[canonical.topology.faces[avatar.gaussians.faces.long()].long()].mean(1)


def test_shares_of_pixels_add_up_to_coverage(avatar):
    view = frontal(avatar)
    with torch.no_grad():
        alpha = avatar.rasterize(avatar.move(view[0]), view[1]).alpha
    seen = seen_pixels(avatar, [view, view])
    # float32 sums of some thousand terms
    assert float(seen.sum()) == pytest.approx(2 * float(alpha.sum()), rel=1e-4)
    assert (seen >= 0).all()


def test_the_seen_stay_and_the_unseen_lie_on_the_surface(avatar):
    gaussians = avatar.gaussians
    with torch.no_grad():
        gaussians.means.add_(0.3)
    before = {name: values.clone() for name, values in gaussians.tensors().items()}
    seen = torch.zeros(1500, device=gaussians.means.device)
    front = middles(avatar)[:, 2]
    seen[front > front.median()] = 5.0
    guessed = guess_unseen(avatar, seen)
    changed = (gaussians.means != before["means"]).any(dim=1)
    assert int(changed.sum()) == guessed
    assert 300 < guessed < 750
    assert not (changed & (seen > 0)).any()
    for name, values in before.items():
        assert torch.equal(getattr(gaussians, name)[~changed], values[~changed]), name
    assert (gaussians.means[changed, 1] == 0).all()
    torch.testing.assert_close(gaussians.opacities[changed], torch.full_like(seen[changed], OPACITY))
    scales = gaussians.scales[changed]
    torch.testing.assert_close(scales[:, 1], FLATNESS * scales[:, 0])
    for name in BORROWED:
        donors = before[name][seen > 0].reshape(int((seen > 0).sum()), -1)
        taken = getattr(gaussians, name).detach()[changed].reshape(guessed, -1)
        # means of what was seen are within what was seen
        assert (taken <= donors.amax(dim=0) + 1e-4).all()
        assert (taken >= donors.amin(dim=0) - 1e-4).all()


def test_one_side_takes_over_the_others_colours(avatar):
    """The left half was seen and is red towards its ear: the right half comes to be so, too."""
    gaussians = avatar.gaussians
    side = middles(avatar)[:, 0]
    with torch.no_grad():
        gaussians.albedo_logits.copy_((40.0 * side.abs())[:, None].expand(-1, 3))
    seen = torch.where(side > 0, 5.0, 0.0)
    truth = gaussians.albedo_logits.detach().clone()
    with torch.no_grad():
        gaussians.albedo_logits[side <= 0] = -4.0
    guess_unseen(avatar, seen)
    far = side < -0.02
    error = (gaussians.albedo_logits.detach()[far] - truth[far]).abs().mean()
    assert float(error) < 0.1 * float(truth[far].mean())


def test_nothing_seen_or_all_seen_changes_nothing(avatar):
    before = {name: values.clone() for name, values in avatar.gaussians.tensors().items()}
    for seen in (0.0, 5.0):
        assert guess_unseen(avatar, torch.full((1500,), seen, device=avatar.gaussians.means.device)) == 0
    assert all(torch.equal(getattr(avatar.gaussians, name), values) for name, values in before.items())
