"""Adam that lets a row of a table rest while it is not shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor
from torch.optim.adam import adam


class RowAdam(torch.optim.Adam):
    """torch's Adam, and in groups with ``rows`` one Adam a row, its moments and number of steps its own.

    torch's Adam steps all rows of a table whenever one has a gradient: the others go on by their momentum,
    which for a row in three hundred is nine tenths of its way, and forget their second moments meanwhile. Its
    SparseAdam lets them rest, but corrects the bias of a row's first moments as if it had taken part in every
    step.

    State of such a table (T, ...): ``exp_avg`` and ``exp_avg_sq`` like it, and ``step`` (T,).
    """

    @torch.no_grad()
    def step(  # type: ignore[override]  # torch declares one signature for a closure, one for none
        self, closure: Callable[[], Any] | None = None, *, rows: Iterable[int] = ()
    ) -> None:
        """Step every parameter but the tables, and of those the rows that were shown.

        Args:
            closure: As torch's.
            rows: Indices along the first dimension of every table.
        """
        shown = list(rows)
        tables = [
            (table, group) for group in self.param_groups if group.get("rows") for table in group["params"]
        ]
        grads = [table.grad for table, _ in tables]
        for table, _ in tables:
            table.grad = None
        super().step(closure)
        for (table, group), grad in zip(tables, grads, strict=True):
            table.grad = grad
            if grad is not None and shown:
                self._step_rows(table, grad, shown, group)

    def _step_rows(self, table: Tensor, grad: Tensor, rows: list[int], group: dict[str, Any]) -> None:
        state = self.state[table]
        if not state:
            state["step"] = torch.zeros(len(table), device=table.device)
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(table), torch.zeros_like(table)
        # views of rows: what is written into them is written into the tables
        parameters, grads, first_moments, second_moments, steps = (
            [values[row] for row in rows]
            for values in (table, grad, state["exp_avg"], state["exp_avg_sq"], state["step"])
        )
        first_decay, second_decay = group["betas"]
        adam(
            parameters, grads, first_moments, second_moments, [], steps, amsgrad=False, beta1=first_decay,
            beta2=second_decay, lr=group["lr"], weight_decay=0.0, eps=group["eps"], maximize=False,
        )  # fmt: skip
