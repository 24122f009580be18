"""Exceptions of segloc; all are a :class:`SeglocError`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

_MORE_LINES = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_LONGEST = 3000

INSTALL_LAB = "run `pip install ./lab` in a clone of segloc"
"""Remedy if something of ``segloc-lab`` is missing."""


class SeglocError(Exception):
    """Base of all errors of segloc; the message is one line.

    Line breaks in names of files, topics and fields are replaced.
    """

    def __init__(self, message: object = "", *others: object) -> None:
        line = _MORE_LINES.sub(" ", str(message))
        if len(line) > _LONGEST:
            line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
        super().__init__(line, *others)


class InvalidScan(SeglocError, ValueError):
    """A point cloud has the wrong shape or dtype."""


class DatasetError(SeglocError):
    """A scan, trajectory or sequence cannot be read; names the file and the position in it."""


class MapFormatError(SeglocError):
    """A map file is truncated, corrupt, of a newer version, or not a map at all."""


class MapMismatch(SeglocError):
    """Two maps, or a map and a localizer, were made by different descriptors."""


class WeightsError(SeglocError):
    """Network weights are missing, corrupt, or do not fit the network."""


class ConfigError(SeglocError, ValueError):
    """A configuration value is unknown or out of range."""


class MissingDependency(SeglocError, ImportError):
    """An optional package is missing; the message has the command to install it.

    The command names the package itself: it works however segloc was installed.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        distribution = "segloc-lab" if extra == "lab" else "segloc"
        requirement = _requirement(distribution, package)
        source = distribution if extra == "lab" else f"extra {extra}"
        super().__init__(f"{purpose} needs {package} ({source}): pip install '{requirement}'")
        self._needed = (package, extra, purpose)

    def __reduce__(self) -> tuple[type[MissingDependency], tuple[str, str, str]]:
        return type(self), self._needed  # picklable, for other processes


@contextmanager
def requires(package: str, extra: str, purpose: str) -> Iterator[None]:
    """Report an import that fails in a ``with`` block as a :class:`MissingDependency`."""
    try:
        yield
    except ImportError as error:
        raise MissingDependency(package, extra, purpose) from error


class LiveError(SeglocError):
    """A live localizer has stopped; the exception that stopped it is its cause."""


def _requirement(distribution: str, package: str) -> str:
    """Return a package with the versions that a distribution declares for it."""
    from importlib import metadata

    try:
        declared = metadata.requires(distribution) or []
    except metadata.PackageNotFoundError:
        declared = []
    found = (each.partition(";")[0].strip() for each in declared)
    return next((each for each in found if each.startswith(package)), package)
