import pytest
import torch

from samira_warp.support.errors import UserError
from samira_warp.support.validation import check_tensor


@pytest.mark.parametrize("shape", [(4, 3), ("N", 3), (4, "C"), ("N", "N")])
def test_numbers_have_to_match_and_names_take_any(shape):
    check_tensor("x", torch.ones(4, 3), shape=shape)


@pytest.mark.parametrize("shape", [(), (4,), (3, 4), (4, 4), ("N",), ("N", 4), (5, "C"), ("N", 3, 1)])
def test_another_shape_is_refused(shape):
    with pytest.raises(UserError, match=r"^x: expected float32 tensor .* found float32 \(4, 3\) on cpu"):
        check_tensor("x", torch.ones(4, 3), shape=shape)


def test_dtype_and_device_count_where_they_are_asked_for():
    double = torch.ones(2, dtype=torch.float64)
    check_tensor("x", double, shape=(2,), dtype=None)
    with pytest.raises(UserError, match=r"expected float32 tensor of shape \(2\), found float64"):
        check_tensor("x", double, shape=(2,))
    with pytest.raises(UserError, match=r"on meta, found float32 \(2\,\) on cpu"):
        check_tensor("x", torch.ones(2), shape=(2,), device=torch.device("meta"))
    with pytest.raises(UserError, match="found list"):
        check_tensor("x", [1.0, 1.0], shape=(2,))
