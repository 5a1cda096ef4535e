import math

import pytest
import torch
from subjects import camera, parameters, small_avatar

from samira_warp.head import FrameParameters
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.train.initialize import FLATNESS
from samira_warp.train.neighbours import neighbourhood
from samira_warp.train.optimizer import forget_gaussians, make_optimizer, set_rates
from samira_warp.train.tracking import TrackedParameters
from samira_warp.train.unseen import BORROWED, LEFT_OUT, OPACITY, Seen, guess_unseen, hold_guesses, look

COUNT = 1500


@pytest.fixture
def avatar(device):
    return small_avatar(gaussians=COUNT, residual=False, device=device)


def middles(avatar):
    """(F, 3) of the triangles at rest."""
    canonical = avatar.canonical
    return canonical.vertices[canonical.topology.faces.long()].mean(1)


def seen_where(avatar, faces, *, coverage=1.0):
    """As if the pictures had shown those triangles, and each of their Gaussians in a dozen pixels."""
    facing = faces.float()
    return Seen(12.0 * facing[avatar.gaussians.faces.long()], faces, coverage * facing)


def guessed_from(avatar, seen):
    return guess_unseen(avatar, seen, neighbourhood(avatar.gaussians, avatar.canonical))


def copied(avatar):
    return {name: values.clone() for name, values in avatar.gaussians.tensors().items()}


def test_shares_of_pixels_add_up_to_coverage_and_only_the_front_is_seen(avatar, device):
    view = parameters(0, turn=0.0, device=device), camera(192, device=device)
    with torch.no_grad():
        motion = avatar.move(view[0])
        alpha = avatar.rasterize(motion, view[1]).alpha
    seen = look(avatar, [view, view])
    # float32 sums of some thousand terms
    assert float(seen.pixels.sum()) == pytest.approx(2 * float(alpha.sum()), rel=1e-4)
    corners = motion.head.vertices[avatar.canonical.topology.faces.long()]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosines = torch.nn.functional.cosine_similarity(normals, view[1].center - corners.mean(dim=1), dim=1)
    assert seen.faces.sum() > 20
    assert (cosines[seen.faces] > math.cos(math.radians(80.5))).all()
    # the forehead hides nothing of itself
    forehead = torch.zeros(len(motion.head.vertices), dtype=torch.bool, device=device)
    forehead[torch.from_numpy(avatar.canonical.template.masks["forehead"]).long()] = True
    bare = forehead[avatar.canonical.topology.faces.long()].all(dim=1) & (cosines > 0.5)
    assert bare.any()
    assert seen.faces[bare].all()
    assert seen.coverage.max() <= 1.0 + 1e-5
    assert (seen.coverage[~seen.faces] == 0).all()


def test_the_seen_stay_and_the_unseen_become_discs(avatar):
    gaussians = avatar.gaussians
    with torch.no_grad():
        gaussians.means.add_(0.3)
    before, depth = copied(avatar), middles(avatar)[:, 2]
    front = depth > depth.median()
    guessed = guessed_from(avatar, seen_where(avatar, front))
    changed = (gaussians.log_scales != before["log_scales"]).any(dim=1)
    donors = front[gaussians.faces.long()]
    assert int(changed.sum()) == guessed
    assert 0.2 * COUNT < guessed < 0.8 * COUNT
    assert not (changed & donors).any()
    for name, values in before.items():
        assert torch.equal(getattr(gaussians, name)[~changed], values[~changed]), name
    assert torch.equal(gaussians.guessed, changed)
    torch.testing.assert_close(
        gaussians.opacities[changed], torch.full((guessed,), OPACITY, device=donors.device)
    )
    scales = gaussians.scales[changed]
    torch.testing.assert_close(scales[:, 1], FLATNESS * scales[:, 0])
    face_scales = triangle_frames(avatar.canonical.vertices, avatar.canonical.topology).scale
    heights = gaussians.means[:, 1] * face_scales[gaussians.faces.long()]
    borrowed = {name: getattr(gaussians, name).detach() for name in BORROWED}
    for name, values in {**borrowed, "heights": heights.detach()}.items():
        lent, taken = (values[which].reshape(int(which.sum()), -1) for which in (donors, changed))
        # means of what was seen are within what was seen
        assert (taken <= lent.amax(dim=0) + 1e-4).all(), name
        assert (taken >= lent.amin(dim=0) - 1e-4).all(), name


def test_one_side_takes_over_the_others_colours(avatar):
    """Only one half was seen, the brighter the farther to the side: the other comes to be so, too."""
    gaussians, across = avatar.gaussians, middles(avatar)[:, 0]
    side = across[gaussians.faces.long()]
    truth = (40.0 * side.abs())[:, None].expand(-1, 3)
    with torch.no_grad():
        gaussians.albedo_logits.copy_(torch.where(side[:, None] > 0, truth, -4.0))
    guessed_from(avatar, seen_where(avatar, across > 0))
    far = side < -0.02
    error = (gaussians.albedo_logits.detach()[far] - truth[far]).abs().mean()
    assert float(error) < 0.1 * float(truth[far].mean())


def test_what_mattes_leave_out_stays_left_out(avatar):
    """Triangles that were seen and covered by nothing lend what is next to them nothing."""
    gaussians, height = avatar.gaussians, middles(avatar)[:, 1]
    low, middle = height.quantile(0.2), height.quantile(0.5)
    seen = seen_where(avatar, height > low)
    seen = seen._replace(coverage=torch.where(height > middle, 1.0, 0.0))
    place = height[gaussians.faces.long()]
    guessed_from(avatar, seen)
    opacities = gaussians.opacities.detach()
    torch.testing.assert_close(opacities[(place > low) & (place < middle)].max().item(), LEFT_OUT)
    assert (opacities[place < low - 0.02] <= 1.01 * LEFT_OUT).all()
    assert (opacities[place > middle] > 0.5).all()


def test_nothing_seen_or_all_seen_changes_nothing(avatar):
    before, faces = copied(avatar), len(avatar.canonical.topology.faces)
    for is_seen in (False, True):
        everywhere = torch.full((faces,), is_seen, device=avatar.gaussians.means.device)
        assert guessed_from(avatar, seen_where(avatar, everywhere)) == 0
    assert all(torch.equal(getattr(avatar.gaussians, name), values) for name, values in before.items())


def test_guesses_rest_while_the_others_learn(avatar):
    """Three steps of Adam with moments from before the guess."""
    gaussians = avatar.gaussians
    front = middles(avatar)[:, 2] > 0.0
    frames = FrameParameters.stack([parameters(0), parameters(1)])
    optimizer = make_optimizer(avatar, TrackedParameters(frames))
    set_rates(optimizer, step=1000, steps=3000)

    def step():
        sum(getattr(gaussians, name).square().sum() for name in gaussians.PARAMETERS).backward()
        hold_guesses(gaussians)
        optimizer.step()
        optimizer.zero_grad()

    step()
    guessed_from(avatar, seen_where(avatar, front))
    forget_gaussians(optimizer, gaussians.guessed)
    before = copied(avatar)
    for _ in range(3):
        step()
    for name in gaussians.PARAMETERS:
        moved = (getattr(gaussians, name) != before[name]).flatten(1 if before[name].dim() > 1 else 0)
        moved = moved.any(dim=1) if moved.dim() > 1 else moved
        assert not moved[gaussians.guessed].any(), name
        assert moved[~gaussians.guessed].any(), name
