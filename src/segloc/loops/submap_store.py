"""Where submaps and the maps of parts are kept between tasks: files of a folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DatasetError
from ..frontend.segmentation import Segmentation
from ..map.segment_map import SegmentMap
from ..system.files import replacing
from ..types import Descriptors, Segments
from .submaps import Submap

_SUBMAPS_AT_HAND, _MAPS_AT_HAND = 256, 2


@dataclass(frozen=True)
class SubmapStore:
    """Submaps by their number, maps by their name, for tasks that all see the folder.

    No bit is lost. A process keeps those at hand that it used last, until :func:`forget`.

    Raises
    ------
    DatasetError
        If what is taken from it is missing or damaged; names the file.
    SeglocError
        If a file cannot be written.
    """

    folder: Path

    def put(self, number: int, submap: Submap) -> None:
        """Keep a submap."""
        file = BytesIO()
        np.savez(file, allow_pickle=False, **_arrays_of(submap))
        with replacing(self._submap(number), sweep=False) as stream:
            stream.write(file.getbuffer())

    def __getitem__(self, number: int, /) -> Submap:
        return _read_submap(self._submap(number))

    def put_map(self, name: str, prior_map: SegmentMap) -> None:
        """Keep a map."""
        prior_map.save(self._map(name))

    def map(self, name: str) -> SegmentMap:
        """A map that was kept."""
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


def forget() -> None:
    """Let go of what this process has at hand."""
    _read_submap.cache_clear()
    _read_map.cache_clear()
