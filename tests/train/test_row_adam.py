"""Rows of the tracked parameters step when their frame is shown, and rest when it is not."""

import torch

from samira_warp.train.row_adam import RowAdam

EPS = 1e-15


def written_out(values, grads, *, lr):
    """Adam of one row, in float64, from its paper's formulas."""
    value, first, second = (
        values.double(),
        torch.zeros_like(values).double(),
        torch.zeros_like(values).double(),
    )
    for number, grad in enumerate(grads, start=1):
        first = 0.9 * first + 0.1 * grad.double()
        second = 0.999 * second + 0.001 * grad.double() ** 2
        value = value - lr * (first / (1 - 0.9**number)) / ((second / (1 - 0.999**number)).sqrt() + EPS)
    return value


def test_each_row_is_adam_of_its_own_steps(generator):
    start = torch.randn(5, 2, 3, generator=generator)
    table = torch.nn.Parameter(start.clone())
    optimizer = RowAdam([{"params": [table], "rows": True}], lr=1e-2, eps=EPS)
    shown, seen = [2, 0, 2, 2, 4, 0, 2], {row: [] for row in range(5)}
    for row in shown:
        grad = torch.zeros_like(table)
        grad[row] = torch.randn(2, 3, generator=generator)
        seen[row].append(grad[row])
        before = table.detach().clone()
        table.grad = grad
        optimizer.step(rows=[row])
        others = [other for other in range(5) if other != row]
        assert torch.equal(table.detach()[others], before[others]), "a row that is not shown rests"
    for row, grads in seen.items():
        # float32 of a few steps of 1e-2 from values of order 1
        torch.testing.assert_close(
            table.detach()[row].double(), written_out(start[row], grads, lr=1e-2), atol=1e-6, rtol=0
        )
    assert optimizer.state[table]["step"].tolist() == [2.0, 0.0, 4.0, 0.0, 1.0]


def test_several_rows_at_once_are_each_alone(generator):
    start, grad = torch.randn(4, 3, generator=generator), torch.randn(4, 3, generator=generator)
    together, alone = torch.nn.Parameter(start.clone()), torch.nn.Parameter(start.clone())
    for table, steps in ((together, [[1, 3]]), (alone, [[1], [3]])):
        optimizer = RowAdam([{"params": [table], "rows": True}], lr=1e-3, eps=EPS)
        table.grad = grad.clone()
        for rows in steps:
            optimizer.step(rows=rows)
    assert torch.equal(together, alone)
    assert torch.equal(together[[0, 2]], start[[0, 2]])


def test_other_parameters_are_torch_s_own(generator):
    start, grads = torch.randn(3, 2, generator=generator), torch.randn(4, 3, 2, generator=generator)
    ours, theirs = torch.nn.Parameter(start.clone()), torch.nn.Parameter(start.clone())
    table = torch.nn.Parameter(torch.zeros(5, 2))
    optimizers = (
        RowAdam([{"params": [ours]}, {"params": [table], "rows": True}], lr=1e-2, eps=EPS, fused=True),
        torch.optim.Adam([theirs], lr=1e-2, eps=EPS, fused=True),
    )
    for number, grad in enumerate(grads):
        ours.grad, theirs.grad, table.grad = grad.clone(), grad.clone(), torch.ones(5, 2)
        optimizers[0].step(rows=[number])
        optimizers[1].step()
        assert torch.equal(table.grad, torch.ones(5, 2)), "the gradients are the caller's"
    assert torch.equal(ours, theirs)
    assert (table[:4] < 0.0).all()
    assert (table[4] == 0.0).all()
