"""The map on disk: loaded when it comes, and again when it changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Localizer, SeglocError, SegmentMap
from segloc.config import map_config
from segloc.tiles import holds_tiles
from segloc.types import Float32


class MapFile:
    """A map that may be missing, late or replaced.

    Parameters
    ----------
    path : str
    threads : int
        Of the localizer.

    Attributes
    ----------
    fault : str
        Why there is none; "" where there is.
    """

    def __init__(self, path: str, threads: int) -> None:
        self._path, self._threads = path, threads
        self._seen: tuple[int, int, int] | None = None
        self.fault = "the map is being read"

    def newer(self) -> Localizer | None:
        """One in the map, if it was not there before or has changed; None where all is as it was.

        Files are replaced whole, so what is there can be read; what cannot is read again only once
        it has changed.
        """
        if not self._path:
            self.fault = "no map: set the parameter map to a .segmap"
            return None
        if holds_tiles(self._path):
            self.fault = f"{self._path} holds tiles: a robot is followed in one map"
            return None
        try:
            found = Path(self._path).stat()
        except OSError as error:
            self.fault, self._seen = f"no map: {self._path}: {error.strerror}", None
            return None
        signature = (found.st_mtime_ns, found.st_size, found.st_ino)
        if signature == self._seen:
            return None
        self._seen = signature
        return self._loaded()

    def _loaded(self) -> Localizer | None:
        try:
            prior_map = SegmentMap.load(self._path)
            config = map_config(prior_map).model_copy(update={"threads": self._threads})
            localizer = Localizer(prior_map, config)
        except (SeglocError, OSError) as error:
            self.fault = f"no map: {error}"
            return None
        self.fault = ""
        return localizer


def map_points(prior_map: SegmentMap, most: int) -> Float32:
    """Points of a map in its frame, evenly thinned, (N, 3) float32."""
    every = max(1, -(-len(prior_map.cloud) // max(1, most)))
    return (prior_map.cloud[::every] + prior_map.origin).astype(np.float32)
