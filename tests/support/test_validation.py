import pytest
import torch

from samira_warp.support.errors import UserError
from samira_warp.support.validation import FLOATS, INTEGERS, check_ids, check_tensor, check_tensors


@pytest.mark.parametrize("shape", [(4, 3), ("N", 3), (4, "C"), ("N", "C")])
def test_numbers_have_to_match_and_names_take_any(shape):
    check_tensor("x", torch.ones(4, 3), shape=shape)


@pytest.mark.parametrize(
    "shape", [(), (4,), (3, 4), (4, 4), ("N",), ("N", 4), (5, "C"), ("N", 3, 1), ("N", "N")]
)
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


def test_a_name_means_one_number_in_all_tensors():
    check_tensors(("x", torch.ones(4, 3), ("N", "C")), ("y", torch.ones(3, 4), ("C", "N")))
    with pytest.raises(
        UserError, match=r"^y: expected float32 tensor of shape \(3, 4\), found float32 \(4, 3\)"
    ):
        check_tensors(("x", torch.ones(4, 3), ("N", "C")), ("y", torch.ones(4, 3), ("C", "N")))


def test_tensors_are_where_the_first_is_and_where_kernels_run():
    here, nowhere = torch.ones(2), torch.ones(2, device="meta")
    with pytest.raises(UserError, match=r"^y: expected float32 tensor of shape \(2\) on cpu, .* on meta$"):
        check_tensors(("x", here, ("N",)), ("y", nowhere, ("N",)))
    with pytest.raises(UserError, match=r"^x: expected float32 tensor of shape \(N\) on cpu or cuda, "):
        check_tensors(("x", nowhere, ("N",)), ("y", here, ("N",)))


def test_several_dtypes_may_do():
    check_tensors(("x", torch.ones(2, dtype=torch.float64), (2,), FLOATS))
    check_tensors(("x", torch.ones(2, dtype=torch.uint8), (2,), INTEGERS))
    with pytest.raises(UserError, match=r"expected integer tensor of shape \(2\), found float32"):
        check_tensors(("x", torch.ones(2), (2,), INTEGERS))
    with pytest.raises(UserError, match=r"expected floating tensor of shape \(2\), found int64"):
        check_tensors(("x", torch.ones(2, dtype=torch.int64), (2,), FLOATS))


@pytest.mark.parametrize("dtype", INTEGERS)
def test_ids_point_at_something(dtype):
    check_ids("x", torch.tensor([0, 2], dtype=dtype), shape=("N",), count=3)
    check_ids("x", torch.tensor([], dtype=dtype), shape=("N",), count=0)
    with pytest.raises(UserError, match=r"^x: expected ids 0 to 2, found 1 to 3$"):
        check_ids("x", torch.tensor([1, 3], dtype=dtype), shape=("N",), count=3)
    if dtype.is_signed:
        with pytest.raises(UserError, match=r"^x: expected ids 0 to 2, found -1 to 2$"):
            check_ids("x", torch.tensor([2, -1], dtype=dtype), shape=("N",), count=3)
