"""What every descriptor offers, and the registry that finds them by name."""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from ..errors import ConfigError
from ..types import Descriptors, Segments


class Descriptor(ABC):
    """Turns segments into vectors that lie close together for views of the same object.

    Attributes
    ----------
    name : str
        The name it is registered under.
    dim : int
        Length of a vector; vectors are compared by Euclidean distance.
    fingerprint : str
        Hash of weights and preprocessing: maps and queries must agree on it.
    """

    name: str
    dim: int
    fingerprint: str

    def prepare(self, segments: Segments) -> Any:
        """What :meth:`encode` works on; the segments themselves where nothing is to be prepared.

        Alignment and reduction to a fixed number of points, for a network: the paper counts them
        as preprocessing.
        """
        return segments

    @abstractmethod
    def encode(self, prepared: Any) -> Descriptors:
        """Describe prepared segments."""

    def describe(self, segments: Segments) -> Descriptors:
        """Describe segments; deterministic, and the same for any number of threads."""
        return self.encode(self.prepare(segments))


Factory = Callable[[int], Descriptor]
_factories: dict[str, Factory] = {}


def register(name: str) -> Callable[[Factory], Factory]:
    """Register a factory ``(threads) -> Descriptor`` under ``name``.

    A new descriptor is one file in this package: its modules are found by themselves.
    """

    def decorate(factory: Factory) -> Factory:
        _factories[name] = factory
        return factory

    return decorate


def _discover() -> None:
    package = importlib.import_module(__package__ or "segloc.descriptors")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")


def available() -> list[str]:
    """Names of all descriptors, sorted."""
    _discover()
    return sorted(_factories)


def create(name: str, threads: int = 0) -> Descriptor:
    """The descriptor of that name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    _discover()
    if name not in _factories:
        raise ConfigError(f"no descriptor {name!r}; there are {', '.join(sorted(_factories))}")
    return _factories[name](threads)
