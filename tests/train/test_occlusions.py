"""What the head blocks in training frames: traced once, again where it moved, and the same after a break."""

from dataclasses import replace

import pytest
import torch
from subjects import parameters, small_avatar

from samira_warp.head import FrameParameters
from samira_warp.train import occlusions as module
from samira_warp.train.occlusions import FrameOcclusions
from samira_warp.train.tracking import TrackedParameters


class Counted:
    """An occluder that counts how often it traces."""

    def __init__(self, occluder):
        self.occluder, self.count = occluder, 0

    def occlude(self, head):
        self.count += 1
        return self.occluder.occlude(head)


@pytest.fixture
def case():
    avatar = small_avatar()
    frames = [parameters(seed) for seed in range(3)]
    tracked = TrackedParameters(FrameParameters.stack(frames))
    counted = Counted(avatar.occluder)
    return avatar, frames, counted, FrameOcclusions(avatar.canonical, counted, tracked)


def shown(avatar, occlusions, row, frame):
    return occlusions.of(row, frame, avatar.canonical.pose(frame))


def test_a_frame_is_traced_once_wherever_the_head_goes(case):
    avatar, frames, counted, occlusions = case
    first = shown(avatar, occlusions, 1, frames[1])
    moved = replace(frames[1], translation=frames[1].translation + 0.3)
    second = shown(avatar, occlusions, 1, moved)
    assert counted.count == 1
    assert torch.equal(first.bits, second.bits)
    assert torch.equal(second.transform, avatar.canonical.pose(moved).head_transform)


def test_a_face_that_moves_by_more_than_a_millimetre_is_traced_again(case):
    avatar, frames, counted, occlusions = case
    shown(avatar, occlusions, 0, frames[0])
    slightly, far = (replace(frames[0], expression=frames[0].expression + change) for change in (1e-5, 1.0))
    shown(avatar, occlusions, 0, slightly)
    assert counted.count == 1
    found = shown(avatar, occlusions, 0, far)
    assert counted.count == 2
    assert torch.equal(found.bits, avatar.occluder.occlude(avatar.canonical.pose(far)).bits)


def test_a_run_that_goes_on_has_the_same_bits(case):
    """A frame that has moved a little since it was traced keeps what was traced then."""
    avatar, frames, _, occlusions = case
    shown(avatar, occlusions, 2, frames[2])
    moved = replace(frames[2], expression=frames[2].expression + 1e-4)
    before = shown(avatar, occlusions, 2, moved)
    fresh = FrameOcclusions(
        avatar.canonical, avatar.occluder, TrackedParameters(FrameParameters.stack(frames))
    )
    fresh.load_state({name: values.clone() for name, values in occlusions.state().items()})
    after = shown(avatar, fresh, 2, moved)
    for name in ("bits", "normals", "openness", "transform"):
        assert torch.equal(getattr(before, name), getattr(after, name)), name


def test_what_does_not_fit_is_traced_again_from_the_same_parameters(case, monkeypatch):
    avatar, frames, counted, occlusions = case
    monkeypatch.setattr(module, "KEPT_BYTES", 1)
    first = [shown(avatar, occlusions, row, frame).bits for row, frame in enumerate(frames)]
    assert occlusions.kept_bytes == 0
    slightly = [replace(frame, expression=frame.expression + 1e-5) for frame in frames]
    again = [shown(avatar, occlusions, row, frame).bits for row, frame in enumerate(slightly)]
    assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))
    assert counted.count == 6


def test_what_does_not_fit_and_moved_is_traced_once(case, monkeypatch):
    avatar, frames, counted, occlusions = case
    monkeypatch.setattr(module, "KEPT_BYTES", 1)
    shown(avatar, occlusions, 0, frames[0])
    far = replace(frames[0], expression=frames[0].expression + 1.0)
    found = shown(avatar, occlusions, 0, far)
    assert counted.count == 2
    assert torch.equal(found.bits, avatar.occluder.occlude(avatar.canonical.pose(far)).bits)


def test_the_first_that_fit_stay(case, monkeypatch):
    """Two of three frames: the third is traced whenever it is shown, and what is kept stays in the budget."""
    avatar, frames, counted, occlusions = case
    shown(avatar, occlusions, 0, frames[0])
    budget = int(2.5 * occlusions.kept_bytes)
    monkeypatch.setattr(module, "KEPT_BYTES", budget)
    for row in (1, 2, 0, 1, 2):
        shown(avatar, occlusions, row, frames[row])
        assert occlusions.kept_bytes <= budget
    assert counted.count == 4
    assert occlusions.full


def test_what_is_kept_comes_back_to_the_bit_in_less_memory(case):
    """Bits are deflated and normals left out."""
    avatar, frames, counted, occlusions = case
    traced = shown(avatar, occlusions, 1, frames[1])
    assert 0 < occlusions.kept_bytes <= traced.bytes - traced.normals.nbytes
    kept = shown(avatar, occlusions, 1, frames[1])
    assert counted.count == 1
    for name in ("bits", "points", "normals", "openness", "transform"):
        one, other = getattr(traced, name), getattr(kept, name)
        assert one.dtype == other.dtype, name
        assert torch.equal(one, other), name
