"""Attributes that are computed on first use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class once(Generic[T]):  # noqa: N801
    """A property that is computed once, without a lock: concurrent callers may compute it twice.

    Before Python 3.12 ``functools.cached_property`` holds one lock for all instances: a fork may
    copy it locked.
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, _: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, _: type | None = None) -> T:
        found = instance.__dict__[self._name] = self._compute(instance)
        return found
