"""The formats that recordings come in, and which of them is at a path."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, cast

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
)
from .packets import ouster, velodyne
from .recorded import Found
from .ros import bags


class Format(Protocol):
    """What each module of a format offers."""

    NAME: str
    # where scans lie inside a recording: a path to there means the recording
    INNER: tuple[str, ...]

    @staticmethod
    def recognises(path: Path) -> bool: ...
    @staticmethod
    def find(path: Path, topic: str | None) -> Found: ...


_MODULES = (
    bags, kitti_raw, kitti, robotcar, newer_college, nclt, boreas, helipr, mulran, nuscenes,
    ouster, velodyne,
)  # fmt: skip
FORMATS = tuple(cast(Format, module) for module in _MODULES)
"""The first that recognises a path reads it."""


def identify(path: Path) -> tuple[Format, Path, str | None] | None:
    """The format at a path, the recording's own path, and the sensor that the path names, if any.

    None for a path of no known format: a plain folder of scans. The folder of a recording's scans
    stands for the recording: its files read as a plain folder's could be taken for others.
    """
    for known in FORMATS:
        if known.recognises(path):
            return known, path, None
    if not path.is_dir():
        return None
    inside = path.resolve()
    for known in FORMATS:
        for inner in known.INNER:
            depth = len(Path(inner).parts)
            root = inside.parents[depth - 1] if len(inside.parents) >= depth else inside
            if inside.is_relative_to(root / inner) and known.recognises(root):
                return known, root, inside.name
    return None
