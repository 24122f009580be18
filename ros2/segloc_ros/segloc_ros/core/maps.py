"""The map: a file, tiles or a cloud, loaded when it appears or changes, or another on request."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from segloc import Localizer, SeglocError, SegmentMap
from segloc.robot import Float32, map_config
from segloc.tiles import INDEX, holds_tiles, localizer_in, open_map

from .cloud_map import Note, cloud_signature, holds_cloud, is_url, map_of_cloud

_Signature = tuple[int, int, int]


class _Seen(NamedTuple):
    """A file that was read, by what changes when it is replaced, and its fault."""

    signature: _Signature
    fault: str


class MapFile:
    """A map that may be missing, late or replaced.

    Attributes
    ----------
    path : str
        The file that is watched.
    fault : str
        Why it cannot be loaded; "" if it is loaded.
    request_fault : str
        Why the last map on request could not be loaded; "" if it was.
    progress : str
        What is being done to a cloud; "" otherwise.
    note : callable
        Called with each remark on a cloud of which a map is built, one line.
    on_progress : callable
        Called when ``progress`` has changed; an exception that it raises ends the work.
    """

    def __init__(self, path: str, threads: int) -> None:
        self.path, self._threads = path, threads
        self.progress = self.fault = self.request_fault = ""
        self.note: Note = lambda remark: None
        self.on_progress: Callable[[], None] = lambda: None
        self._seen: _Seen | None = None

    @property
    def missing(self) -> str:
        """Why there is no map yet."""
        return self.progress or self.fault or "the map is being read"

    def newer(self) -> Localizer | None:
        """Return a localizer if the map is new or has changed; None otherwise.

        Files are replaced whole. One that cannot be read is tried again once it has changed; one
        that was away and is there again has not. A URL is tried until it can be read: the network
        may come up later than the robot.
        """
        signature: _Signature | None = None
        try:
            if not self.path:
                raise SeglocError(
                    "set the parameter map to a .segmap, a point cloud, a folder of tiles or its "
                    "URL"
                )
            signature = _signature(self.path)
            if self._seen is not None and signature == self._seen.signature:
                self.fault = self._seen.fault
                if not (self.fault and is_url(self.path)):
                    return None
            localizer = self._opened(self.path)
        except (SeglocError, OSError) as error:
            self.fault = f"no map: {_named(self.path, error)}"
            if signature is not None:
                self._seen = _Seen(signature, self.fault)
            return None
        self._seen, self.fault = _Seen(signature, ""), ""
        return localizer

    def switch(self, path: str) -> Localizer:
        """Load another map, and watch that from now on; on a fault the one before stays.

        Raise SeglocError, which names the fault, if it cannot be loaded.
        """
        try:
            signature = _signature(path)
            localizer = self._opened(path)
        except (SeglocError, OSError) as error:
            self.request_fault = _named(path, error)
            raise SeglocError(self.request_fault) from error
        self.path, self._seen, self.fault, self.request_fault = path, _Seen(signature, ""), "", ""
        return localizer

    def _opened(self, path: str) -> Localizer:
        """Return a localizer in the map at a path: a file, a cloud, or a folder or URL of tiles.

        Raise SeglocError or OSError if it cannot be loaded.
        """
        try:
            prior_map = (
                map_of_cloud(path, self._threads, self._report, self.note)
                if holds_cloud(path)
                else open_map(path)
            )
        finally:
            self.progress = ""
        whole = prior_map if isinstance(prior_map, SegmentMap) else prior_map.coarse()
        config = map_config(whole).model_copy(update={"threads": self._threads})
        return localizer_in(prior_map, config)

    def _report(self, progress: str) -> None:
        is_news, self.progress = progress != self.progress, progress
        if is_news:
            self.on_progress()


def _named(path: str, error: Exception) -> str:
    return f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)


def _signature(path: str) -> _Signature:
    """What changes whenever a map is replaced; a URL is not watched."""
    if is_url(path):
        return (0, 0, 0)
    if holds_cloud(path):
        return cloud_signature(path)
    file = Path(path) / INDEX if holds_tiles(path) else Path(path)
    found = file.stat()
    return (found.st_mtime_ns, found.st_size, found.st_ino)


def grid_beside(path: str) -> str:
    """Return Nav2's map.yaml of a map; "" if there is none.

    It is ``site.yaml`` or ``site/map.yaml`` beside ``site.segmap``, and ``map.yaml`` in a folder.
    """
    where = Path(path)
    if is_url(path):
        return ""
    stem = where if where.is_dir() else where.with_suffix("")
    beside = stem / "map.yaml", stem.with_name(f"{stem.name}.yaml")
    return next((str(file.resolve()) for file in beside if file.is_file()), "")


def map_points(prior_map: SegmentMap, most: int) -> Float32:
    """Points of a map in its frame, evenly thinned, (N, 3) float32; of tiles the centroids."""
    points = prior_map.cloud + prior_map.origin if len(prior_map.cloud) else prior_map.centroids
    return points[:: max(1, -(-len(points) // max(1, most)))].astype(np.float32)
