import pytest
import torch

from samira_warp.kernels.gathering.grouping import group_by
from samira_warp.kernels.gathering.sums import sum_groups


@pytest.mark.parametrize("channels", [1, 3, 5])
@pytest.mark.parametrize("together", [1, 4])
def test_sums_are_those_of_a_product_with_the_groups(device, generator, channels, together):
    """Group 7 is empty; vectors go another way than other numbers of channels."""
    keys = torch.randint(7, (200,), generator=generator).to(device)
    values = torch.randn(4, 200, channels, generator=generator).to(device)
    member = torch.nn.functional.one_hot(keys, 8).double()
    expected = torch.einsum("mg,bmc->bgc", member, values.double())
    if together == 4:
        expected = expected.sum(dim=0, keepdim=True)
    found = sum_groups(values, group_by(keys, 8), together=together)
    # sums of up to some 120 numbers of about 1: partial sums of 30, each rounded to 2e-6, that many times
    assert torch.allclose(found.double(), expected, rtol=0, atol=1e-4)
    assert not found[:, 7].any()


def test_no_frames_have_a_sum_together_and_none_apart(device):
    groups = group_by(torch.tensor([0, 1, 1], device=device), 2)
    values = torch.empty(0, 3, 3, device=device)
    assert sum_groups(values, groups).shape == (0, 2, 3)
    together = sum_groups(values, groups, together=0)
    assert together.shape == (1, 2, 3)
    assert not together.any()
