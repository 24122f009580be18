"""Interface of descriptors, and their registry."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..system.plugins import plugins, require_attributes
from ..types import Descriptors, Float32, Int64, Segments


class Pruner(ABC):
    """Estimates the probability of candidate matches, better than their distance does.

    Attributes
    ----------
    fingerprint : str
        Hash of all that determines its results.
    """

    fingerprint: str

    @abstractmethod
    def probability(
        self, query: Float32, mapped: Float32, rows: Int64, columns: Int64, threads: int = 0
    ) -> Float32:
        """Return the probability that pairs show the same object, (M,) float32 in [0, 1].

        Parameters
        ----------
        query : (P, dim) float32
            Vectors of the query segments.
        mapped : (N, dim) float32
            Vectors of the map.
        rows, columns : (M,) int64
            Pairs, as indices into `query` and `mapped`.
        """


class Descriptor(ABC):
    """Describes segments by vectors that are close for views of the same object.

    Attributes
    ----------
    name : str
        Registered name.
    dim : int
        Length of a vector; vectors are compared by Euclidean distance.
    fingerprint : str
        Hash of weights and preprocessing; it must be equal for maps and queries.
    rates : bool
        True if each vector has a quality.
    pruner : Pruner or None
        Orders and prunes candidate matches, if the method has such a stage.
    """

    name: str
    dim: int
    fingerprint: str
    rates: bool = False
    pruner: Pruner | None = None

    def prepare(self, segments: Segments) -> Any:
        """Prepare segments for :meth:`encode`; by default they are returned unchanged.

        A network's input is aligned and sampled to a fixed number of points: preprocessing, in the
        terms of the paper.
        """
        return segments

    @abstractmethod
    def encode(self, prepared: Any) -> Descriptors:
        """Describe prepared segments."""

    def describe(self, segments: Segments) -> Descriptors:
        """Describe segments; deterministic, and the same for any number of threads."""
        return self.encode(self.prepare(segments))


Factory = Callable[..., Descriptor]
"""Takes the number of threads and, for methods with weights, ``weights=PATH``."""


@dataclass(frozen=True)
class _Entry:
    factory: Factory
    preset: Mapping[str, Any] = field(default_factory=dict)


PLUGINS = "segloc.descriptors"
"""Entry point group of descriptors of other packages: ``name = "module:factory"``."""

_entries: dict[str, _Entry] = {}


AS_PUBLISHED: Mapping[str, Any] = {"growth": 0.0, "escalation": 1}
"""Matching of the published methods: as many neighbours in any map and for any query."""


def register(name: str, preset: Mapping[str, Any] | None = None) -> Callable[[Factory], Factory]:
    """Register a factory ``(threads) -> Descriptor`` under ``name``.

    A factory with weights also takes ``weights``, a path or None for the shipped ones.

    ``preset`` holds the method's deviations from the default configuration, by section. A new
    descriptor is one file in this package: its modules are imported automatically.
    """

    def decorate(factory: Factory) -> Factory:
        _entries[name] = _Entry(factory, preset or {})
        return factory

    return decorate


@cache
def _discover() -> None:
    """Import the modules of this package and the entry points of other packages."""
    package = importlib.import_module(__package__ or "segloc.descriptors")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    for name, factory in plugins(PLUGINS)[0].items():
        if name not in _entries:
            register(name, getattr(factory, "preset", None))(factory)


def available() -> list[str]:
    """Return the names of all descriptors, sorted."""
    _discover()
    return sorted(_entries)


def create(name: str, threads: int = 0, weights: Path | None = None) -> Descriptor:
    """Create the descriptor of a name.

    Parameters
    ----------
    name : str
    threads : int
        0 is all cores.
    weights : Path, optional
        Trained weights, by default the shipped ones.

    Raises
    ------
    ConfigError
        If there is none, it takes no weights, or it is no descriptor of that name.
    WeightsError
        If the weights are missing or damaged.
    """
    factory = _entry(name).factory
    if weights is None:
        made = factory(threads)
    elif "weights" in inspect.signature(factory).parameters:
        made = factory(threads, weights=weights)
    else:
        raise ConfigError(f"{weights}: {name} takes no weights; leave out --weights")
    require_attributes(f"descriptor {name!r}", made, ("name", "dim", "fingerprint", "encode"))
    if made.name != name:  # maps name the descriptor by which they are found again
        raise ConfigError(f"descriptor {name!r} calls itself {made.name!r}: rename one of them")
    return made


def preset(name: str) -> Mapping[str, Any]:
    """Return the deviations of a method from the default configuration.

    Raises
    ------
    ConfigError
        If there is no such method.
    """
    return _entry(name).preset


def _entry(name: str) -> _Entry:
    _discover()
    if name not in _entries and (fault := plugins(PLUGINS)[1].get(name)):
        raise ConfigError(f"descriptor {name!r} cannot be loaded ({fault})")
    if name not in _entries:
        known = ", ".join(sorted(_entries))
        raise ConfigError(
            f"no method {name!r}: install its plug-in, or choose of {known}; maps of some plug-ins "
            "are for their own commands (segloc --help)"
        )
    return _entries[name]
