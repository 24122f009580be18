"""Formats of recordings, and the detection of the format at a path."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Protocol, cast

from .layout import locations
from .loaders import (
    boreas,
    helipr,
    kitti,
    kitti_raw,
    mulran,
    nclt,
    newer_college,
    nuscenes,
    robotcar,
    wild_places,
)
from .packets import ouster, velodyne
from .recorded import Found
from .ros import bags


class Format(Protocol):
    """Reader of one format."""

    NAME: str
    # folders of scans inside a recording; a path to one means the recording
    INNER: tuple[str, ...]

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a path is a recording of this format."""
        ...

    @staticmethod
    def find(path: Path, topic: str | None) -> Found:
        """List the scans and read what describes them; no scan is read."""
        ...


_MODULES = (
    bags, kitti_raw, kitti, robotcar, newer_college, nclt, boreas, helipr, mulran, nuscenes,
    wild_places, ouster, velodyne,
)  # fmt: skip
FORMATS = tuple(cast(Format, module) for module in _MODULES)
"""In order of precedence."""


def identify(path: Path) -> tuple[Format, Path, str | None] | None:
    """Return the format at a path, the recording's root, and the sensor named by the path.

    Return None for an unknown format, such as a plain folder of scans. A path to the scan folder
    of a recording means the recording.
    """
    for known in FORMATS:
        if known.recognises(path):
            return known, path, None
    if not path.is_dir():
        return None
    for known, inside in product(FORMATS, locations(path)):
        for inner in known.INNER:
            depth = len(Path(inner).parts)
            root = inside.parents[depth - 1] if len(inside.parents) >= depth else inside
            if inside.is_relative_to(root / inner) and known.recognises(root):
                return known, root, inside.name
    return None
