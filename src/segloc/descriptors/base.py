"""What every descriptor offers, and the registry that finds them by name."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..types import Descriptors, Float32, Int64, Segments


class Pruner(ABC):
    """Judges candidate matches more closely than the distance of their descriptors does.

    Attributes
    ----------
    fingerprint : str
        Hash of what decides its answers.
    """

    fingerprint: str

    @abstractmethod
    def probability(
        self, query: Float32, mapped: Float32, rows: Int64, columns: Int64, threads: int = 0
    ) -> Float32:
        """How likely pairs are to show the same object, (M,) float32 in [0, 1].

        Parameters
        ----------
        query : (P, dim) float32
            Vectors of the query segments.
        mapped : (N, dim) float32
            Vectors of the map.
        rows, columns : (M,) int64
            The pairs, as indices into `query` and `mapped`.
        """


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
    rates : bool
        Whether it gives each of its vectors a quality.
    pruner : Pruner or None
        Orders candidate matches and sorts some out, for a method that has such a stage.
    """

    name: str
    dim: int
    fingerprint: str
    rates: bool = False
    pruner: Pruner | None = None

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


Factory = Callable[..., Descriptor]
"""Called with the number of threads and, for methods that have them, ``weights=PATH``."""


@dataclass(frozen=True)
class _Entry:
    factory: Factory
    preset: Mapping[str, Any] = field(default_factory=dict)


PLUGINS = "segloc.descriptors"
"""The entry point group by which other packages offer descriptors: ``name = "module:factory"``."""

_entries: dict[str, _Entry] = {}
_broken: dict[str, str] = {}


def register(name: str, preset: Mapping[str, Any] | None = None) -> Callable[[Factory], Factory]:
    """Register a factory ``(threads) -> Descriptor`` under ``name``.

    One whose descriptor has weights also takes ``weights``, a path or None for its own.

    ``preset`` holds what the method's configuration sets differently from the defaults, by section.
    A new descriptor is one file in this package: its modules are found by themselves.
    """

    def decorate(factory: Factory) -> Factory:
        _entries[name] = _Entry(factory, preset or {})
        return factory

    return decorate


@cache
def _discover() -> None:
    """Import the modules of this package, and what other packages name by entry points."""
    package = importlib.import_module(__package__ or "segloc.descriptors")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    for plugin in entry_points(group=PLUGINS):
        try:
            factory = plugin.load()
        except Exception as error:  # whatever another package does must not end ours
            _broken[plugin.name] = f"{plugin.value}: {error}"
            continue
        if plugin.name not in _entries:
            register(plugin.name, getattr(factory, "preset", None))(factory)


def available() -> list[str]:
    """Names of all descriptors, sorted."""
    _discover()
    return sorted(_entries)


def create(name: str, threads: int = 0, weights: Path | None = None) -> Descriptor:
    """The descriptor of that name.

    Parameters
    ----------
    name : str
    threads : int
        0: all cores.
    weights : Path, optional
        Trained ones, in place of those that are shipped.

    Raises
    ------
    ConfigError
        If there is none, or it has no weights.
    WeightsError
        If the weights are missing or damaged.
    """
    factory = _entry(name).factory
    if weights is None:
        return factory(threads)
    if "weights" not in inspect.signature(factory).parameters:
        raise ConfigError(f"{weights}: {name} has no weights")
    return factory(threads, weights=weights)


def preset(name: str) -> Mapping[str, Any]:
    """What a method sets differently from the defaults of the configuration.

    Raises
    ------
    ConfigError
        If there is no such method.
    """
    return _entry(name).preset


def _entry(name: str) -> _Entry:
    _discover()
    if name in _broken:
        raise ConfigError(f"descriptor {name!r} cannot be loaded ({_broken[name]})")
    if name not in _entries:
        raise ConfigError(f"no method {name!r}; there are {', '.join(sorted(_entries))}")
    return _entries[name]
