"""Which of torch's sums have the same bits from call to call and for any number of threads, and which do not:
docs/scale.md has the table, and the package is written by it."""

import pytest
import torch

from samira_warp.kernels.gathering.gather import bilinear_table, gather

MANY = 1_000_000
CALLS = 200
"""Until two results differ; that two threads never meet in so many calls has not been seen."""


def gradient_of(read, values, weights):
    values = values.clone().requires_grad_()
    (read(values) * weights).sum().backward()
    return values.grad


@pytest.fixture
def corners(generator):
    """Vertices, faces that share them, and a gradient for each corner."""
    vertices, faces = torch.randn(5_023, 3, generator=generator), 9_976
    return (
        vertices,
        torch.randint(len(vertices), (faces, 3), generator=generator),
        torch.randn(faces, 3, 3, generator=generator),
    )


def all_equal(results):
    return all(torch.equal(results[0], other) for other in results[1:])


def test_a_sum_of_many_values_has_the_same_bits_with_as_many_threads(generator, use_threads):
    """With another number of threads it may have others: how torch divides it is torch's own affair."""
    values = torch.randn(MANY, generator=generator)
    sums = {}
    for threads in (1, 2, 8):
        use_threads(threads)
        sums[threads] = values.sum()
        assert all_equal([values.sum() for _ in range(5)])
    # the roundings of a million additions
    assert max(sums.values()) - min(sums.values()) < 1e-2


def test_scattered_writes_meet_in_another_order_at_every_call(corners, use_threads):
    """``v[faces]``'s gradient, and ``index_put_`` that adds: two threads come to a vertex in any order."""
    use_threads(2)
    vertices, faces, weights = corners
    first = gradient_of(lambda values: values[faces], vertices, weights)
    differs = any(
        not torch.equal(gradient_of(lambda values: values[faces], vertices, weights), first)
        for _ in range(CALLS)
    )

    def put():
        sums = torch.zeros_like(vertices)
        return sums.index_put_((faces.flatten(),), weights.view(-1, 3), accumulate=True)

    first = put()
    assert differs and any(not torch.equal(put(), first) for _ in range(CALLS))  # noqa: PT018


def test_rows_that_are_selected_have_the_same_gradient(corners, use_threads):
    vertices, faces, weights = corners
    results = []
    for threads in (1, 2, 8):
        use_threads(threads)
        for _ in range(5):
            rows = gradient_of(
                lambda values: values.index_select(0, faces.flatten()), vertices, weights.view(-1, 3)
            )
            results += [rows]
    assert all_equal(results)


def test_the_packages_own_gathering_has_the_same_gradient(generator, use_threads):
    uv, weights = torch.rand(20_000, 2, generator=generator), torch.randn(20_000, 8, generator=generator)
    texels, table = torch.randn(64 * 64, 8, generator=generator), bilinear_table(uv, width=64, height=64)
    results = []
    for threads in (1, 2, 8):
        use_threads(threads)
        results += [gradient_of(lambda values: gather(values, table), texels, weights) for _ in range(3)]
    assert all_equal(results)
