"""Going on after a user's mistake, to find the next one.

For reading what has many parts, each of which may be at fault on its own. Readers read their parts by `each`,
`all_of` and `unless_at_fault`. Elsewhere these raise the first fault; within `collected_faults` they keep it
and go on. So the same code says what is wrong, whether the first fault is wanted or every one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from functools import partial
from typing import Any, TypeVar

from samira_warp.support.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

_collected: ContextVar[list[UserError] | None] = ContextVar("collected faults", default=None)


@contextlib.contextmanager
def collected_faults() -> Iterator[list[UserError]]:
    """A context that keeps the faults of single parts in a list, in order.

    It ends with a fault after which nothing can go on.
    """
    faults: list[UserError] = []
    token = _collected.set(faults)
    try:
        yield faults
    except UserError as fault:
        _keep(fault)
    finally:
        _collected.reset(token)


def each(read: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``read`` of each item; where faults are collected, items at fault are left out.

    Raises:
        UserError: An item is at fault; where faults are collected, every one of them is.
    """
    results, last = _tried([partial(read, item) for item in items])
    if last is not None and not results:
        raise last
    return results


def all_of(*reads: Callable[[], Any]) -> list[Any]:
    """Results of reads that are all needed; where faults are collected, each is tried.

    Raises:
        UserError: One of them is at fault.
    """
    results, last = _tried(reads)
    if last is not None:
        raise last
    return results


def unless_at_fault(read: Callable[[], Result], *, otherwise: Result) -> Result:
    """What ``read`` gives; where faults are collected and it has one, ``otherwise``.

    Raises:
        UserError: As ``read``, where faults are not collected.
    """
    results, last = _tried([read])
    return results[0] if last is None else otherwise


def _tried(reads: Iterable[Callable[[], Result]]) -> tuple[list[Result], UserError | None]:
    """Results of the reads without fault, and the last fault; all are kept.

    Where none are to be kept, the first is raised.
    """
    results: list[Result] = []
    last: UserError | None = None
    for read in reads:
        try:
            results.append(read())
        except UserError as fault:
            if _collected.get() is None:
                raise
            _keep(fault)
            last = fault
    return results, last


def _keep(fault: UserError) -> None:
    """Keep a fault, if a reading within this one has not kept it before raising it again."""
    faults = _collected.get()
    if faults is not None and not (faults and faults[-1] is fault):
        faults.append(fault)
