"""Several processes that train one avatar: which of them this is, and what they tell each other.

``torchrun`` starts them, on one machine or on several, and says so in the environment. A step of training is
a frame: N processes take N steps at once, each of them one, in the order in which one process would have
taken them; what one learns from its frame all learn. All of them hold the whole avatar, to the same bits, and
the first alone writes.

What is exchanged is a sum over all ranks, which every rank gets to the same bits, what each has to say, by
rank, or what the first has. One process alone is a rank of one, and exchanges nothing.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
from torch import Tensor

from samira_warp.support.errors import UserError

Result = TypeVar("Result")

PATIENCE = timedelta(hours=12)
"""How long a rank waits for another: a video is prepared, and a long test split scored, by the first alone.
A process that has died is not waited for; torchrun ends the others."""

_LAUNCHED = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
"""What torchrun sets in the environment, and other launchers that torch can be started by."""


@dataclass(frozen=True)
class Ranks:
    """One of several processes.

    Attributes:
        index: Which one, 0 for the first.
        count: How many there are.
        local: Which of those on this machine.
        here: How many there are on this machine.
    """

    index: int = 0
    count: int = 1
    local: int = 0
    here: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the one that writes and speaks."""
        return self.index == 0

    def say(self, text: str) -> None:
        """Print on standard error, once for all ranks."""
        if self.first:
            print(text, file=sys.stderr)

    def device_name(self, name: str | None) -> str | None:
        """How this rank names its device where one for all is named ``name``: each GPU is one rank's.

        Raises:
            UserError: One GPU is asked for by its number, or there are fewer than ranks on this machine.
        """
        if self.count == 1 or name == "cpu" or not torch.cuda.is_available():
            return name
        if name is not None and ":" in name:
            expected = f"cpu, cuda or auto for {self.count} processes, each of which has a GPU of its own"
            raise UserError("--device", expected=expected, found=name)
        if self.here > torch.cuda.device_count():
            expected = f"a GPU for each of the {self.here} processes on this machine, or --device cpu"
            raise UserError("--device", expected=expected, found=f"{torch.cuda.device_count()} GPUs")
        return f"cuda:{self.local}"

    def by_first(self, work: Callable[[], Result]) -> Result:
        """Have the first rank do something, while the others wait for its result.

        Args:
            work: What to do; its result, or the mistake that it finds, is pickled for the others.

        Raises:
            UserError: ``work`` did, on every rank.
        """
        if self.count == 1:
            return work()
        outcome: list[Any] = [None, None]
        failure: BaseException | None = None
        if self.first:
            try:
                outcome[0] = work()
            except UserError as mistake:
                outcome[1] = vars(mistake)
            except BaseException as error:
                failure = error
                outcome[1] = {"subject": "the first process", "expected": "its result"}
                outcome[1]["found"] = type(error).__name__
        torch.distributed.broadcast_object_list(outcome, src=0, device=torch.device("cpu"))
        if failure is not None:
            raise failure
        if outcome[1] is not None:
            raise UserError(**outcome[1])
        return outcome[0]

    def any(self, flag: bool) -> bool:
        """Whether a flag is set on some rank; all ranks have come here when it returns."""
        if self.count == 1:
            return flag
        flags = torch.tensor([flag], dtype=torch.uint8)
        torch.distributed.all_reduce(flags, torch.distributed.ReduceOp.MAX)
        return bool(flags)

    def gathered(self, values: Tensor) -> Tensor:
        """What every rank has.

        Args:
            values: (...) of the same shape on all of them.

        Returns:
            (R, ...) by rank.
        """
        if self.count == 1:
            return values[None]
        parts = [torch.empty_like(values) for _ in range(self.count)]
        torch.distributed.all_gather(parts, values.contiguous())
        return torch.stack(parts)

    def average_gradients(self, optimizer: torch.optim.Optimizer, *, counts: bool, frames: int) -> None:
        """Make every parameter's gradient that of the mean of the frames' objectives.

        Args:
            optimizer: Whose parameters; those without a gradient on any rank keep none.
            counts: Whether this rank's frame is counted.
            frames: How many are.
        """
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        shapes = [parameter.shape for parameter in parameters]
        sums = self.summed_where_any([parameter.grad for parameter in parameters], shapes, counts=counts)
        for parameter, total in zip(parameters, sums, strict=True):
            parameter.grad = None if total is None else total / frames

    def summed(self, values: Sequence[Tensor], *, counts: bool = True) -> list[Tensor]:
        """Sums over all ranks, of as many things as there are values, in one exchange.

        Args:
            values: float32, of the same shapes on all ranks.
            counts: Whether this rank's are added; else they are here to take part.

        Returns:
            The sums, the same bits on every rank.
        """
        if self.count == 1:
            return list(values)
        together = torch.cat([value.reshape(-1) for value in values]) * float(counts)
        torch.distributed.all_reduce(together)
        parts = together.split([value.numel() for value in values])
        return [part.reshape(value.shape) for part, value in zip(parts, values, strict=True)]

    def summed_where_any(
        self, values: Sequence[Tensor | None], shapes: Sequence[torch.Size], *, counts: bool = True
    ) -> list[Tensor | None]:
        """`summed`, of what some ranks may not have.

        Args:
            values: None where this rank has none; one at least is there.
            shapes: Theirs, which all ranks agree on.
            counts: Whether this rank's are added.

        Returns:
            The sums; None for what no rank has that counts.
        """
        if self.count == 1:
            return list(values)
        device = next(value.device for value in values if value is not None)
        having = torch.tensor([value is not None for value in values], dtype=torch.float32, device=device)
        there = [
            torch.zeros(shape, device=device) if value is None else value
            for value, shape in zip(values, shapes, strict=True)
        ]
        *sums, numbers = self.summed([*there, having], counts=counts)
        return [total if number else None for total, number in zip(sums, numbers.tolist(), strict=True)]

    def take_firsts(self, tensors: Sequence[Tensor]) -> None:
        """Put what the first rank has into every rank's tensors, which are of the same shapes everywhere."""
        if self.count > 1:
            for values in tensors:
                whole = values.detach().contiguous()
                torch.distributed.broadcast(
                    whole.view(torch.uint8) if whole.dtype == torch.bool else whole, src=0
                )
                values.detach().copy_(whole)

    def check_equal(self, what: str, number: int) -> None:
        """Raise RuntimeError unless all ranks have the same number of something.

        Equal machines with as many threads do; others may round differently.
        """
        numbers = self.gathered(torch.tensor([number])).flatten().tolist()
        if len(set(numbers)) > 1:
            raise RuntimeError(
                f"the processes of this training have gone apart: {numbers} {what}, by rank. They compute "
                "the same where their machines, versions and numbers of threads (OMP_NUM_THREADS) are equal"
            )


ALONE = Ranks()
"""One process, as without torchrun."""


@contextlib.contextmanager
def joined() -> Iterator[Ranks]:
    """Meet the other processes of this training, where torchrun has started several.

    Each gets the GPU of its number on its machine as torch's current one, where there are GPUs.

    Raises:
        UserError: The environment says that there are several, and not which of them this is.
    """
    count = _number("WORLD_SIZE", 1)
    if count == 1:
        yield ALONE
        return
    for name in _LAUNCHED:
        if name not in os.environ:
            expected = f"to be set beside WORLD_SIZE={count}, as torchrun sets it"
            raise UserError(name, expected=expected, found="no such variable in the environment")
    ranks = Ranks(_number("RANK", 0), count, _number("LOCAL_RANK", 0), _number("LOCAL_WORLD_SIZE", 1))
    several_gpus = torch.cuda.is_available() and ranks.local < torch.cuda.device_count()
    if several_gpus:
        torch.cuda.set_device(ranks.local)
    torch.distributed.init_process_group(
        "cpu:gloo,cuda:nccl" if several_gpus else "gloo", rank=ranks.index, world_size=count, timeout=PATIENCE
    )
    try:
        yield ranks
    finally:
        torch.distributed.destroy_process_group()


def _number(name: str, default: int) -> int:
    """An environment variable's number.

    Raises:
        UserError: It is none.
    """
    value = os.environ.get(name, str(default))
    if not value.isascii() or not value.isdigit():
        raise UserError(name, expected="a number, as torchrun sets it", found=value)
    return int(value)
