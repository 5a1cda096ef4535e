"""Torch's number of threads, where a library changes it."""

import pytest
import torch

from samira_warp.support.threads import kept_threads


def test_a_block_leaves_the_threads_as_they_were(use_threads):
    use_threads(3)
    with kept_threads():
        torch.set_num_threads(2)
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 3


def test_a_block_that_fails_leaves_them_too(use_threads):
    use_threads(3)

    @kept_threads()
    def fail():
        torch.set_num_threads(2)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert torch.get_num_threads() == 3
