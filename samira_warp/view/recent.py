"""Results that several browsers ask for, the latest used of them kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Made = TypeVar("Made")


class Recent(Generic[Made]):
    """As many results as are worth their memory."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._made: OrderedDict[Hashable, Made] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._made

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The result of ``key``, made where it is not kept."""
        if key not in self._made:
            self._made[key] = make()
            while len(self._made) > self._count:
                self._made.popitem(last=False)
        self._made.move_to_end(key)
        return self._made[key]

    def clear(self) -> None:
        """Keep nothing."""
        self._made.clear()
