"""Where submaps and the maps of parts are kept between tasks: in memory, or in a folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..errors import DatasetError
from ..files import replacing
from ..map.segment_map import SegmentMap
from ..segmentation import Segmentation
from ..types import Descriptors, Segments
from .submaps import Submap

_SUBMAPS_AT_HAND, _MAPS_AT_HAND = 256, 2


class SubmapStore(Protocol):
    """Submaps by their number, maps by their name."""

    def put(self, number: int, submap: Submap) -> None:
        """Keep a submap."""
        ...

    def __getitem__(self, number: int, /) -> Submap: ...

    def put_map(self, name: str, prior_map: SegmentMap) -> None:
        """Keep a map."""
        ...

    def map(self, name: str) -> SegmentMap:
        """A map that was kept."""
        ...


class MemoryStore:
    """For tasks of this process."""

    def __init__(self) -> None:
        self._submaps: dict[int, Submap] = {}
        self._maps: dict[str, SegmentMap] = {}

    def put(self, number: int, submap: Submap) -> None:
        self._submaps[number] = submap

    def __getitem__(self, number: int, /) -> Submap:
        return self._submaps[number]

    def put_map(self, name: str, prior_map: SegmentMap) -> None:
        self._maps[name] = prior_map

    def map(self, name: str) -> SegmentMap:
        return self._maps[name]


@dataclass(frozen=True)
class FolderStore:
    """For tasks of several processes or machines, which all see the folder; no bit is lost.

    Raises
    ------
    DatasetError
        If what is taken from it is missing or damaged; names the file.
    SeglocError
        If a file cannot be written.
    """

    folder: Path

    def put(self, number: int, submap: Submap) -> None:
        file = BytesIO()
        np.savez(file, allow_pickle=False, **_arrays_of(submap))
        with replacing(self._submap(number), sweep=False) as stream:
            stream.write(file.getbuffer())

    def __getitem__(self, number: int, /) -> Submap:
        return _read_submap(self._submap(number))

    def put_map(self, name: str, prior_map: SegmentMap) -> None:
        prior_map.save(self._map(name))

    def map(self, name: str) -> SegmentMap:
        return _read_map(self._map(name))

    def _submap(self, number: int) -> Path:
        return self.folder / f"submap_{number}.npz"

    def _map(self, name: str) -> Path:
        return self.folder / f"{name}.segmap"


def _arrays_of(submap: Submap) -> dict[str, Any]:
    segments, described = submap.scene.segments, submap.descriptors
    arrays: dict[str, Any] = {
        "T_odom_local": submap.T_odom_local,
        "centroids": segments.centroids,
        "heights": segments.heights,
        "offsets": segments.offsets,
        "points": segments.points,
        "above_ground": submap.scene.structure,
        "ground": submap.scene.ground,
        "vectors": described.vectors,
        "structure": submap.structure,
        "surface": submap.surface,
    }
    return arrays if described.quality is None else arrays | {"quality": described.quality}


@lru_cache(maxsize=_SUBMAPS_AT_HAND)
def _read_submap(path: Path) -> Submap:
    try:
        with np.load(path, allow_pickle=False) as file:
            a = dict(file)
            segments = Segments(a["points"], a["offsets"], a["centroids"], a["heights"])
            scene = Segmentation(segments, a["above_ground"], a["ground"])
            described = Descriptors(a["vectors"], a.get("quality"))
            return Submap(a["T_odom_local"], scene, described, a["structure"], a["surface"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


@lru_cache(maxsize=_MAPS_AT_HAND)
def _read_map(path: Path) -> SegmentMap:
    return SegmentMap.load(path)
