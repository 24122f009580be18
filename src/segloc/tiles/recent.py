"""Cache of tiles and their localizers, by memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

Value = TypeVar("Value")


class Recent:
    """Thread-safe cache that drops the least recently used.

    Parameters
    ----------
    most_bytes : int
        Maximum size, apart from the latest entry.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Total size of the entries."""
        with self._lock:
            return sum(size for _, size in self._kept.values())

    def get(self, key: Hashable, make: Callable[[], Value], size: Callable[[Value], int]) -> Value:
        """Return the entry of a key, or create it."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                found: Value = self._kept[key][0]
                return found
        made = make()
        with self._lock:
            self._kept[key] = made, size(made)
            self._kept.move_to_end(key)
            excess = sum(size for _, size in self._kept.values()) - self._most_bytes
            while excess > 0 and len(self._kept) > 1:
                excess -= self._kept.popitem(last=False)[1][1]
        return made
