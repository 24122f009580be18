"""What was used last, within so many bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

Value = TypeVar("Value")


class Recent:
    """Keeps what was made: what was not asked for longest goes first. For any number of threads.

    Parameters
    ----------
    most_bytes : int
        So much is kept, and what was asked for last.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Of all that is kept."""
        with self._lock:
            return sum(size for _, size in self._kept.values())

    def get(
        self,
        key: Hashable,
        kind: type[Value],
        make: Callable[[], Value],
        size: Callable[[Value], int],
    ) -> Value:
        """What is kept under a key, or else what is made then, of a kind and of so many bytes."""
        place = (kind, key)
        with self._lock:
            if place in self._kept:
                self._kept.move_to_end(place)
                found: Value = self._kept[place][0]
                return found
        made = make()
        with self._lock:
            self._kept[place] = made, size(made)
            self._kept.move_to_end(place)
            excess = sum(size for _, size in self._kept.values()) - self._most_bytes
            while excess > 0 and len(self._kept) > 1:
                excess -= self._kept.popitem(last=False)[1][1]
        return made
