"""Results that are kept: for as long as their tensors are what they were."""

import copy

import pytest
import torch

from samira_warp.support.unchanged import WhileUnchanged


class Doubler:
    """Twice the sum of its tensors, and how often that was made."""

    def __init__(self):
        self.kept, self.made = WhileUnchanged(), 0

    def of(self, *tensors):
        def make():
            self.made += 1
            return 2 * sum(tensor.detach().sum() for tensor in tensors)

        return self.kept.get(tensors, make)


def replaced(tensors):
    return [tensors[0], torch.full((3,), 4.0)]


def written_into(tensors):
    with torch.no_grad():
        tensors[1][0] = 4.0
    return tensors


def stepped(tensors):
    """By an optimizer whose changes torch does not count."""
    tensors[0].grad = torch.ones(2)
    torch.optim.Adam([tensors[0]], lr=0.1, fused=True).step()
    return tensors


def given_other_memory(tensors):
    """As `torch.nn.Module.to` does."""
    tensors[0].data = torch.full((2,), 7.0)
    return tensors


def written_behind(tensors):
    tensors[0].data[0] = 7.0
    return tensors


@pytest.mark.parametrize("change", [replaced, written_into, stepped, given_other_memory, written_behind])
def test_a_change_is_seen(change):
    tensors, doubler = [torch.nn.Parameter(torch.ones(2)), torch.ones(3)], Doubler()
    for _ in range(2):
        assert doubler.of(*tensors) == 10.0
    assert doubler.made == 1
    tensors = change(tensors)
    for _ in range(2):
        assert doubler.of(*tensors) == 2 * sum(tensor.detach().sum() for tensor in tensors)
    assert doubler.made == 2


def test_nothing_is_kept_of_tensors_that_count_no_changes():
    doubler = Doubler()
    with torch.inference_mode():
        tensor = torch.ones(3)
        assert doubler.of(tensor) == 6.0
        tensor[0] = 4.0
        assert doubler.of(tensor) == 12.0


def test_a_copy_keeps_its_own():
    tensor, doubler = torch.ones(3), Doubler()
    doubler.of(tensor)
    other, twin = copy.deepcopy((tensor, doubler))
    other[0] = 4.0
    assert twin.of(other) == 12.0
    assert doubler.of(tensor) == 6.0
